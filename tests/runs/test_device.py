"""Cohorts on tensors, and steps of theirs that a GPU captures.

There may be no GPU. So tensors are on the host, and captured steps are emulated: a replay repeats
the captured operations of PyTorch, with the tensors that they had, and nothing of the code around.
"""

import contextlib
import dataclasses

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from musebot.controller import BRAINS, Parameters
from musebot.controller.creative_memory import NoisePatterns
from musebot.models import Kinematics
from musebot.protocols.errors import InputError
from musebot.protocols.runs.cohort import Cohort
from musebot.protocols.runs.conditions import CohortKey, Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.plan import Plan
from musebot.protocols.runs.simulation import check_device
from musebot.tasks.tensors import capture

LIKE_MUJOCO = Kinematics(felt="pushed", wall="slips", lag=0.08)
PAPER, STEADY = Parameters(), BRAINS["steady"]
SHORT = Experiment(
    seed=3, cohort_size=3, time_scale=0.0006, body="kinematic", kinematics=LIKE_MUJOCO
)
WARP = dataclasses.replace(SHORT, body="mujoco", physics="warp", kinematics=Kinematics())


@pytest.fixture
def tensors(monkeypatch):
    """Cohorts whose robots are tensors."""
    monkeypatch.setattr(Experiment, "on_tensors", True)


def cohort(brain=PAPER, proposer="creative", task="wall_avoidance", base=SHORT, **changes):
    experiment = dataclasses.replace(base, brain=brain, **changes)
    return Cohort(experiment, CohortKey(Condition(task, proposer), 0))


def lived(made, steps=10**9):
    made.advance(steps)
    return made


def assert_equal(ours, theirs):
    ours, theirs = ours.checkpoint()[0], theirs.checkpoint()[0]
    assert ours.keys() == theirs.keys()
    for name, array in ours.items():
        assert array.tobytes() == theirs[name].tobytes(), name  # also NaN


def copied(checkpoint):
    arrays, notes = checkpoint
    return {name: array.copy() for name, array in arrays.items()}, notes


def cut(make, stride):
    """Returns a cohort that was replaced by its checkpoint every `stride` steps."""
    made = make()
    while not made.finished:
        made.advance(stride)
        checkpoint = copied(made.checkpoint())
        made = make()
        made.restore(*checkpoint)
    return made


# Tensors


@pytest.mark.parametrize(
    ("base", "steps", "atol"), [(SHORT, 150, 1e-4), (WARP, 50, 0.01)], ids=["kinematic", "warp"]
)
@pytest.mark.parametrize("task", ["spot_finding", "wall_avoidance"])
def test_a_life_on_tensors_begins_as_on_the_host(task, base, steps, atol, tensors, monkeypatch):
    """Rounding differs, so that longer lives part."""
    if base is WARP:
        pytest.importorskip("mujoco_warp")
    ours = lived(cohort(STEADY, task=task, base=base, time_scale=0.01), steps)
    assert isinstance(ours.batch.sensordata, torch.Tensor)
    monkeypatch.undo()
    theirs = lived(cohort(STEADY, task=task, base=base, time_scale=0.01, physics="c"), steps)
    assert isinstance(theirs.batch.sensordata, np.ndarray)
    np.testing.assert_allclose(ours.batch.pose, theirs.batch.pose, atol=atol)
    if base is SHORT:
        held, wanted = ours.checkpoint()[0], theirs.checkpoint()[0]
        for name in ("events", "minutes"):
            assert np.array_equal(held[name], wanted[name]), name
        for name, weights in ours.agent.weights().items():
            np.testing.assert_allclose(weights, theirs.agent.weights()[name], atol=1e-3)


# Captured steps

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
        indexes = name.startswith(("aten.index.", "aten.index_put"))
        masks = indexes and any(t.dtype == torch.bool for t in tensors_of(args[1:2]))
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
def tapes(tensors, monkeypatch):
    """Cohorts that capture as on a GPU; holds the tapes."""
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

    monkeypatch.setattr(capture, "capture", captured)
    monkeypatch.setattr(capture, "captures", lambda device: True)
    monkeypatch.setattr(NoisePatterns, "LIFETIME", 40)  # less than a life
    return tapes


def captured_cohort(*args, **changes):
    made = cohort(*args, **changes)
    brain = made.agent.controller
    for schedule in (brain.epsilon, brain.learn_rate):
        if schedule._initial is not None:  # as on another device
            schedule.value = torch.zeros((), dtype=torch.float64)
    return made


def direct(monkeypatch, *args, **changes):
    with monkeypatch.context() as patch:
        patch.setattr(capture, "captures", lambda device: False)
        return captured_cohort(*args, **changes)


SPOT = {"task": "spot_finding", "time_scale": 0.0003}
CASES = {
    "paper": {"brain": PAPER},
    "recurrent": {"brain": BRAINS["recurrent"]},
    "held-noise": {"brain": Parameters(noise_steps=7)},
    "noise-for-life": {"brain": Parameters(noise_steps=0, test_epsilon=0.1)},
    "fixed": {"proposer": "fixed"},
    "random": SPOT | {"proposer": "random"},
    "ideal": SPOT | {"kinematics": Kinematics()},
    "walls": {"brain": STEADY, "task": "spot_finding_walls"},
    "warp": {"base": dataclasses.replace(WARP, time_scale=0.0005)},
}


@pytest.mark.parametrize("case", CASES)
def test_a_life_of_replayed_steps_equals_one_of_direct_steps(case, tapes, monkeypatch):
    if case == "warp":
        pytest.importorskip("mujoco_warp")

    def broken(made):
        made.advance(25)
        made.batch.stop(np.array([1]))
        made.agent.controller.evaluation.networks.output_biases[2] = torch.nan
        return lived(made)

    ours = broken(captured_cohort(**CASES[case]))
    assert len(tapes) >= 6  # training and test, each twice; events; physics
    assert_equal(ours, broken(direct(monkeypatch, **CASES[case])))


def test_a_captured_life_cut_anywhere_goes_on_from_its_checkpoint(tapes, monkeypatch):
    ours = cut(lambda: captured_cohort(STEADY), 37)
    assert_equal(ours, lived(direct(monkeypatch, STEADY)))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("name", ["paper", "steady"])
def test_on_a_gpu_replayed_lives_equal_direct_ones(name, monkeypatch):
    gpu = Experiment(seed=3, cohort_size=64, time_scale=0.01, body="kinematic", device="cuda")
    ours = lived(cohort(BRAINS[name], task="spot_finding", base=gpu))
    monkeypatch.setattr(capture, "captures", lambda device: False)
    assert_equal(ours, lived(cohort(BRAINS[name], task="spot_finding", base=gpu)))


# What is refused


def test_a_gpu_that_is_missing_or_too_small_is_refused(monkeypatch):
    gpu = Experiment(cohort_size=4, body="kinematic", device="cuda:1")
    brains, agents = (
        Plan.of(gpu, [Condition("spot_finding", proposer)], 4)
        for proposer in ("creative", "hand_coded:make")
    )
    for plan, gpus, free, words in (
        (brains, 0, 0, "there is no GPU that PyTorch can use"),
        (brains, 1, 0, "there is no device cuda:1: there are 1"),
        (brains, 2, 1000, "cohorts of 4 robots would need about"),
        (agents, 2, 10**10, "only robots with a brain are simulated on cuda:1"),
        (brains, 2, 10**10, ""),
    ):
        monkeypatch.setattr(torch.cuda, "is_available", lambda gpus=gpus: gpus > 0)
        monkeypatch.setattr(torch.cuda, "device_count", lambda gpus=gpus: gpus)
        monkeypatch.setattr(torch.cuda, "mem_get_info", lambda number, free=free: (free, 10**11))
        with pytest.raises(InputError, match=words) if words else contextlib.nullcontext():
            check_device(plan)
