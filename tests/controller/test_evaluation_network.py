"""Values of the evaluation network, who learns, and the target of Eq. 1 by hand."""

import itertools
import math

import pytest
import torch
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from musebot.controller import EvaluationNetwork, Parameters
from musebot.controller.evaluation_network import td_target
from musebot.controller.step import Step

quick = settings(deadline=None, max_examples=30)


@quick
@given(st.integers(1, 4), st.integers(1, 5), st.integers(1, 30), st.integers(0, 2**31))
def test_values_of_several_actions_equal_the_values_of_single_ones(robots, sensors, count, seed):
    generator = torch.Generator().manual_seed(seed)
    network = EvaluationNetwork(Parameters(), robots, sensors, generator)
    state = torch.rand(robots, sensors, generator=generator) * 2 - 1
    actions = torch.rand(robots, count, 2, generator=generator) - 0.5
    values = network.values(state, actions)
    assert values.shape == (robots, count)
    for index in range(count):
        _, one = network.networks.forward(torch.cat([state, actions[:, index]], dim=1))
        torch.testing.assert_close(values[:, index], one[:, 0], atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("name", ["sgd", "adam"])
@quick
@given(st.lists(st.sampled_from([0.0, 1.0]), min_size=1, max_size=4), st.integers(0, 2**31))
def test_a_robot_that_does_not_learn_keeps_its_weights_and_does_not_affect_others(name, mask, seed):
    networks = []
    for learning in (torch.tensor(mask), torch.ones(len(mask))):
        generator = torch.Generator().manual_seed(seed)
        network = EvaluationNetwork(Parameters(optimizer=name), len(mask), 3, generator)
        before = network.networks.weights.clone()
        state, target = torch.rand(len(mask), 3, generator=generator), torch.ones(len(mask))
        error = network.learn(state, state[:, :2] - 0.5, target, learning, 0.1)
        networks.append((network.networks.weights, error))
    (weights, error), (all_weights, all_errors) = networks
    for robot, learns in enumerate(mask):
        assert torch.equal(weights[robot], (all_weights if learns else before)[robot])
        assert error[robot] == (all_errors[robot] if learns else 0)


# The target of Eq. 1


TERMS = {
    "bootstrap": ("on_policy", "max"),
    "clipped_bootstrap": (False, True),
    "reward_form": ("signal", "difference"),
    "advantage_scale": (0.0, 0.8),
    "raw_reward": (False, True),
}
ALL_TARGETS = [
    dict(zip(TERMS, chosen, strict=True)) for chosen in itertools.product(*TERMS.values())
]
ODOUR = 10.0


@st.composite
def lives(draw):
    """Some steps of a robot, each with its reward, values, and what happens before the next."""
    value = st.integers(-16, 16).map(lambda eighths: eighths / 8)
    step = st.fixed_dictionaries(
        {
            "reward": st.integers(-8, 8).map(lambda eighths: eighths / 8),
            "value": value,
            "best": value,
            "learns": st.sampled_from([True, True, True, False]),
            "placed": st.sampled_from([False, False, False, True]),
        }
    )
    return draw(st.lists(step, min_size=2, max_size=6))


class Scalar:
    """Eq. 1's target for one robot, in plain arithmetic, with each term that can be changed.

    r is the reward, or its raw value; V' the value in the next step of the selected action, or of
    the best one. A reward that fell to 0 or below clips V' to the reward lost. With differences
    the last reward is subtracted; with an advantage, alpha times what the action was worse.
    """

    def __init__(self, terms, discount):
        self.terms, self.discount = terms, discount

    def reward(self, signal):
        if not self.terms["raw_reward"]:
            return signal
        signal = min(max(signal, 0), ODOUR / (1 + ODOUR))
        return signal / (1 - signal) / ODOUR

    def target(self, before, now):
        """Returns the target; None if the robot must not learn."""
        difference = self.terms["reward_form"] == "difference"
        clipped = self.terms["clipped_bootstrap"]
        if before is None or before["placed"]:
            return None
        if (difference or clipped) and not before["learns"]:
            return None  # its reward was not sensed
        last, reward = self.reward(before["reward"]), self.reward(now["reward"])
        ahead = now["best"] if self.terms["bootstrap"] == "max" else now["value"]
        if clipped and reward < last and reward <= 0:
            ahead = min(ahead, max(last, 0))
        worse = max(before["best"] - before["value"], 0)
        return (
            reward
            - (last if difference else 0)
            - self.terms["advantage_scale"] * worse
            + self.discount * ahead
        )


def recorded(step, sensed):
    values = torch.tensor([[sensed["value"], sensed["best"]]] * 2)
    one = torch.zeros(2, dtype=torch.int64)
    step.record(torch.zeros(2, 1), torch.zeros(2, 2, 2), values, one, one + 1)


# A life of six steps is short enough to read; to shrink it takes minutes.
@settings(quick, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(life=lives(), discount=st.floats(0, 1))
def test_the_target_of_every_combination_equals_its_equation(life, discount):
    for terms in ALL_TARGETS:
        parameters = Parameters(discount=discount, **terms)
        detailed = parameters.needs_best or parameters.compares_rewards
        before, now = (Step(2, 1, detailed) for _ in range(2))
        maximal = torch.tensor(ODOUR) if terms["raw_reward"] else None
        scalar, last = Scalar(terms, discount), None
        for sensed in life:
            before, now = now, before
            recorded(now, sensed)
            if sensed["learns"]:
                reward = torch.tensor([sensed["reward"]] * 2)
                target, learning = td_target(parameters, maximal, reward, before, now)
                reward.fill_(math.nan)  # the caller may overwrite its own
                expected = scalar.target(last, sensed)
                assert learning.tolist() == [float(expected is not None)] * 2, terms
                if expected is not None:
                    assert target.tolist() == pytest.approx([expected] * 2, abs=1e-5), terms
            if sensed["placed"]:
                now.forget()
            last = sensed
