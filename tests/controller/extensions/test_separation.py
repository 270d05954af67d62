"""Hidden neurons that receive either the smell or the other signals: the value is a sum."""

import pytest
import torch

from musebot.controller import Neurocontroller, Parameters
from musebot.controller.brains import BRAINS
from musebot.controller.extensions.encoding import separated
from musebot.controller.senses import Senses, Signal

SMELL, DISTANCE, TOUCH = Signal(0, 1, maximal=10.0), Signal(0, 1), Signal(-1, 0)


def test_each_half_receives_its_own_signals_and_all_motors():
    connected = separated(4, 3, [0, 2], 5)
    assert connected is not None
    assert connected.tolist() == [[1, 0, 1, 1, 1]] * 2 + [[0, 1, 0, 1, 1]] * 2


@pytest.mark.parametrize("smell", [[], [0, 1]])
def test_without_smell_or_without_other_signals_nothing_is_separated(smell):
    assert separated(4, 2, smell, 4) is None


def learned(steps, **changes):
    """Brains after some steps on random signals."""
    senses = Senses((SMELL, DISTANCE, DISTANCE, TOUCH), Signal(0, 1, maximal=10.0))
    steady = BRAINS["steady"]
    parameters = Parameters(**{**vars(steady), **changes})
    random = torch.Generator().manual_seed(3)
    brain = Neurocontroller(parameters, "creative", robots=5, seed=1, sensors=4, senses=senses)
    for _ in range(steps):
        state = torch.rand(5, 4, generator=random)
        brain.act(state, explore=True)
        brain.learn(torch.rand(5, generator=random))
    return brain


@pytest.mark.parametrize("optimizer", ["adam", "sgd"])
def test_the_value_stays_a_sum_of_smell_and_walls_while_it_is_learned(optimizer):
    rate = {"learn_rate": 0.01, "initial_learn_rate": None}

    def interaction(separate):
        brain = learned(40, optimizer=optimizer, separate_smell=separate, **rate)
        actions = torch.tensor([[[0.3, -0.8], [1.0, 1.0]]]).expand(5, 2, 2)
        value = {}
        for smell in (0, 1):
            for walls in (0, 1):
                state = torch.full((5, 5), -1.0)
                state[:, [0, 4]] += 1.5 * smell
                state[:, 1:4] += 1.5 * walls
                value[smell, walls] = brain.evaluation.values(state, actions)
        return value[1, 1] - value[1, 0] - value[0, 1] + value[0, 0]

    assert interaction(True).abs().max() < 1e-5
    assert interaction(False).abs().max() > 0.01


def test_a_loaded_brain_has_no_removed_connection():
    whole, separate = learned(40), learned(40, separate_smell=True)
    separate.load_networks(whole.networks())
    networks = separate.evaluation.networks
    weights, connected = networks.hidden_weights, networks.connected
    assert (weights[:, connected == 0] == 0).all()
    kept = whole.evaluation.networks.hidden_weights[:, connected == 1]
    assert torch.equal(weights[:, connected == 1], kept)


def test_robots_that_only_smell_are_unchanged():
    senses = Senses((SMELL,), Signal(0, 1, maximal=10.0))
    weights = []
    for separate in (False, True):
        parameters = Parameters(**{**vars(BRAINS["steady"]), "separate_smell": separate})
        brain = Neurocontroller(parameters, "creative", robots=2, seed=1, sensors=1, senses=senses)
        weights.append(brain.evaluation.networks.hidden_weights)
        assert brain.evaluation.networks.connected is None
    assert torch.equal(*weights)
