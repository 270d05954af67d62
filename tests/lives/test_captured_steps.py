"""Steps that a GPU captures and replays, emulated on the host: a replay repeats the captured
operations of PyTorch, with the tensors that they had, and nothing of the code around them.
"""

import dataclasses

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from musebot.controller import BRAINS, NoisePatterns, Parameters
from musebot.models import Kinematics
from musebot.protocols.lives.cohort import Cohort, advance_together
from musebot.protocols.lives.conditions import CohortKey, Condition
from musebot.protocols.lives.device import CapturedWork, StepWork, robots_on_device
from musebot.protocols.lives.experiment import Experiment
from musebot.tasks.tensors import capture

# Copies of numbers between the host and a device, or results whose shape depends on numbers; a
# capture cannot hold them.
ON_HOST = (
    *("lift_fresh", "scalar_tensor", "_local_scalar_dense", "nonzero", "where.Scalar"),
    *("masked_select", "unique"),
)


class Tape(TorchDispatchMode):
    """Keeps operations, and the numbers that tensors had before any of them."""

    def __init__(self):
        super().__init__()
        self.operations, self.before, self.made = [], {}, set()

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        name = str(function)
        indices = (
            tensors_of(args[1:2]) if name.startswith(("aten.index.", "aten.index_put")) else []
        )
        masks = any(index.dtype == torch.bool for index in indices)
        assert not masks and not any(word in name for word in ON_HOST), f"{name} needs the host"
        for tensor in tensors_of((args, kwargs)):
            place = tensor.untyped_storage()
            if place.data_ptr() not in self.made | self.before.keys():
                self.before[place.data_ptr()] = place, place.clone()
        out = function(*args, **(kwargs or {}))
        self.made |= {tensor.untyped_storage().data_ptr() for tensor in tensors_of(out)}
        self.made -= self.before.keys()
        self.operations.append((function, args, kwargs or {}, out))
        return out

    def undo(self):
        for place, numbers in self.before.values():
            place.copy_(numbers)

    def play(self):
        for function, args, kwargs, out in self.operations:
            again = function(*args, **kwargs)
            for old, new in zip(tensors_of(out), tensors_of(again), strict=True):
                if old.data_ptr() != new.data_ptr():
                    old.copy_(new)


def tensors_of(tree):
    return [leaf for leaf in tree_leaves(tree) if isinstance(leaf, torch.Tensor)]


@pytest.fixture
def tapes(monkeypatch):
    """Cohorts on tensors that capture as on a GPU; holds the tapes."""
    tapes = []

    def captured(work, device, generator=None):
        state = None if generator is None else generator.get_state()
        with torch.inference_mode(), Tape() as tape:
            work()
        tape.undo()
        if state is not None:
            generator.set_state(state)
        tapes.append(tape)
        return torch.inference_mode()(tape.play)

    monkeypatch.setattr(Experiment, "on_tensors", True)
    monkeypatch.setattr(capture, "capture", captured)
    monkeypatch.setattr(capture, "captures", lambda device: True)
    monkeypatch.setattr(NoisePatterns, "LIFETIME", 40)  # less than a life
    return tapes


STEADY = BRAINS["steady"]
WAYS = {
    "paper": Parameters(),
    "steady": STEADY,
    "recurrent": BRAINS["recurrent"],
    "held-noise": Parameters(noise_steps=7),
    "noise-for-life": Parameters(noise_steps=0, test_epsilon=0.1),
    "noise-on-biases": Parameters(noise_on_biases=True),
    "main-idea": dataclasses.replace(STEADY, keep_main_idea=True),
}
LIKE_MUJOCO = Kinematics(felt="pushed", wall="turns", lag=0.08)


def cohort(brain, proposer="creative", task="wall_avoidance", kinematics=LIKE_MUJOCO, **changes):
    experiment = Experiment(
        seed=3,
        cohort_size=3,
        time_scale=0.002,
        brain=brain,
        **{"body": "kinematic", "kinematics": kinematics} | changes,
    )
    task = task or experiment.tasks[0]
    made = Cohort(experiment, CohortKey(Condition(task, proposer), 0))
    for schedule in (made.agent.controller.epsilon, made.agent.controller.learn_rate):
        if schedule.decays:  # as on another device
            schedule.value = torch.zeros((), dtype=torch.float64)
    return made


def direct(monkeypatch, *args, steps=10**9, **fields):
    with monkeypatch.context() as patch:
        patch.setattr(capture, "captures", lambda device: False)
        made = cohort(*args, **fields)
    made.advance(steps)
    return made


def assert_equal(ours, theirs):
    ours, theirs = ours.checkpoint()[0], theirs.checkpoint()[0]
    assert ours.keys() == theirs.keys()
    for name, array in ours.items():
        assert array.tobytes() == theirs[name].tobytes(), name  # also NaN


@pytest.mark.parametrize("way", WAYS)
def test_a_life_of_replayed_steps_equals_one_of_direct_steps(way, tapes, monkeypatch):
    ours = cohort(WAYS[way])
    assert isinstance(ours._work, CapturedWork)
    ours.advance(ours.steps)
    assert_equal(ours, direct(monkeypatch, WAYS[way]))
    assert len(tapes) == 6  # training and test, each twice; events; physics


@pytest.mark.parametrize("task", ["wall_avoidance", "spot_finding"])
@pytest.mark.parametrize("proposer", ["fixed", "random", "creative"])
def test_replayed_steps_equal_direct_ones_in_both_tasks(task, proposer, tapes, monkeypatch):
    ideal = Kinematics()
    ours = cohort(Parameters(), proposer, task, ideal)
    ours.advance(ours.steps)
    assert_equal(ours, direct(monkeypatch, Parameters(), proposer, task, ideal))


def test_a_life_cut_anywhere_goes_on_from_its_checkpoint(tapes, monkeypatch):
    whole = direct(monkeypatch, STEADY)
    ours = cohort(STEADY)
    while not ours.finished:
        ours.advance(37)
        arrays, notes = ours.checkpoint()
        arrays = {name: array.copy() for name, array in arrays.items()}
        ours = cohort(STEADY)
        ours.restore(arrays, notes)
    assert_equal(ours, whole)


def test_cohorts_on_one_batch_replay_their_own_steps(tapes, monkeypatch):
    proposers = ("fixed", "random", "creative")
    experiment = cohort(Parameters()).experiment
    parts = robots_on_device(experiment, "wall_avoidance", len(proposers))
    keys = [CohortKey(Condition("wall_avoidance", proposer), 0) for proposer in proposers]
    ours = [Cohort(experiment, *pair) for pair in zip(keys, parts, strict=True)]
    while not ours[0].finished:
        advance_together(ours, 50)
    for mine, proposer in zip(ours, proposers, strict=True):
        assert_equal(mine, direct(monkeypatch, Parameters(), proposer))


def test_a_number_that_changes_on_the_host_only_would_be_found(tapes, monkeypatch):
    """The comparisons above can fail: here a replay does not see the learn rate."""
    ours = cohort(STEADY)
    ours.agent.controller.learn_rate.value = 0.0
    ours.advance(ours.steps)
    with pytest.raises(AssertionError):
        assert_equal(ours, direct(monkeypatch, STEADY))


def test_an_operation_that_needs_the_host_would_be_found():
    yes = torch.ones(2, dtype=torch.bool)
    for work in (
        lambda: torch.where(yes, torch.zeros(2), 1.0),
        lambda: yes.nonzero(),
        lambda: torch.zeros(2)[yes],
        lambda: torch.zeros(2).masked_select(yes),
        lambda: bool(yes.any()),
    ):
        with pytest.raises(AssertionError, match="needs the host"), Tape():
            work()


def test_a_life_in_mujoco_warp_equals_one_of_direct_steps(tapes, monkeypatch):
    pytest.importorskip("mujoco_warp")
    changes = {"body": "mujoco", "physics": "warp", "kinematics": Kinematics()}
    ours = cohort(Parameters(), **changes)
    ours.advance(60)
    assert_equal(ours, direct(monkeypatch, Parameters(), steps=60, **changes))
    assert len(tapes) > 4  # before and after the physics, too


@pytest.mark.parametrize("protocol", ["continual", "walls"])
def test_lives_of_other_protocols_with_a_stopped_robot_are_equal(protocol, tapes, monkeypatch):
    def lived(made):
        made.advance(30)
        made.batch.stop(np.array([1]))
        made.agent.controller.evaluation.networks.output_biases[2] = torch.nan
        made.advance(90)
        return made

    changes = {"protocol": protocol}
    with monkeypatch.context() as patch:
        patch.setattr(capture, "captures", lambda device: False)
        theirs = lived(cohort(STEADY, task=None, **changes))
    assert_equal(lived(cohort(STEADY, task=None, **changes)), theirs)


def test_on_a_device_that_cannot_capture_steps_are_direct(monkeypatch):
    monkeypatch.setattr(Experiment, "on_tensors", True)
    assert type(cohort(Parameters())._work) is StepWork


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("name", ["paper", "steady"])
def test_on_a_gpu_replayed_lives_equal_direct_ones(name, monkeypatch):
    experiment = Experiment(
        seed=3, cohort_size=64, time_scale=0.01, body="kinematic", device="cuda", brain=BRAINS[name]
    )

    def lived():
        made = Cohort(experiment, CohortKey(Condition("spot_finding", "creative"), 0))
        made.advance(made.steps)
        return made

    ours = lived()
    monkeypatch.setattr(capture, "captures", lambda device: False)
    assert_equal(ours, lived())
