"""Cohorts on another device: their loop, their checkpoints, and what is refused before work."""

import dataclasses

import numpy as np
import pytest
import torch

from musebot.protocols import cli
from musebot.protocols.errors import InputError
from musebot.protocols.experiment.conditions import CohortKey, Condition
from musebot.protocols.experiment.experiment import Experiment
from musebot.protocols.experiment.overrides import named_brain
from musebot.protocols.experiment.plan import Plan
from musebot.protocols.simulation import cohort as module
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.simulation.jobs import CohortJob
from musebot.protocols.simulation.runs import check_device
from musebot.tasks.tensors.kinematic import KinematicTensors

SPOT, WALLS = (Condition(task, "creative") for task in ("spot_finding", "wall_avoidance"))
SHORT = Experiment(
    seed=5, cohort_size=4, time_scale=0.01, body="kinematic", brain=named_brain("steady")
)
CUDA = Experiment(cohort_size=4, body="kinematic", device="cuda:1")


@pytest.fixture
def tensors(monkeypatch):
    """Cohorts whose robots are tensors, on the host, as there may be no GPU."""
    monkeypatch.setattr(
        module,
        "robots_on_device",
        lambda experiment, task, make: (
            KinematicTensors(experiment.batch(task, experiment.cohort_size)),
            make(),
        ),
    )


def lived(experiment=SHORT, condition=WALLS, steps=None):
    cohort = Cohort(experiment, CohortKey(condition, 0))
    cohort.advance(cohort.steps if steps is None else steps)
    return cohort


@pytest.mark.parametrize("condition", [SPOT, WALLS], ids=str)
def test_a_life_on_tensors_begins_as_the_life_in_numpy_does(condition, tensors, monkeypatch):
    """Rounding differs, so that lives part in the end: the first two minutes are compared."""
    ours = lived(condition=condition, steps=1200)
    assert isinstance(ours.batch, KinematicTensors)
    monkeypatch.undo()
    theirs = lived(condition=condition, steps=1200)
    for name in ("events", "minutes"):
        assert np.array_equal(ours.checkpoint()[0][name], theirs.checkpoint()[0][name]), name
    np.testing.assert_allclose(ours.batch.pose, theirs.batch.pose, atol=1e-4)
    for name, weights in ours.agent.weights().items():
        np.testing.assert_allclose(weights, theirs.agent.weights()[name], atol=1e-3, err_msg=name)


def test_a_cohort_on_tensors_continues_bit_exactly(tensors):
    whole = lived()
    first = lived(steps=whole.steps // 2 + 17)
    arrays, notes = first.checkpoint()
    arrays = {name: array.copy() for name, array in arrays.items()}
    second = Cohort(SHORT, CohortKey(WALLS, 0))
    second.restore(arrays, notes)
    second.advance(whole.steps)
    ours, theirs = second.checkpoint()[0], whole.checkpoint()[0]
    for name, array in ours.items():
        assert np.array_equal(array, theirs[name]), name


def test_a_job_on_another_device_looks_at_its_robots_once_a_minute(tensors, tmp_path, monkeypatch):
    experiment = Experiment(cohort_size=2, time_scale=0.01, body="kinematic", device="cuda")
    chunks = []
    advance = Cohort.advance

    def spy(cohort, steps):
        chunks.append(steps)
        advance(cohort, steps)

    monkeypatch.setattr(Cohort, "advance", spy)
    (tmp_path / "checkpoints").mkdir()
    job = CohortJob(tmp_path, experiment, CohortKey(WALLS, 0), 60.0)
    assert job.run(lambda: False, lambda cost, message: None)
    assert {*chunks} == {600} and job.done()


def test_events_within_a_minute_are_counted_once(tensors):
    """However a life is cut, each event counts in its own part and minute."""
    whole, cut = lived(), Cohort(SHORT, CohortKey(WALLS, 0))
    while not cut.finished:
        cut.advance(37)
    for name in ("events", "minutes"):
        assert np.array_equal(whole.checkpoint()[0][name], cut.checkpoint()[0][name])
    assert whole.checkpoint()[0]["events"].sum() == whole.checkpoint()[0]["minutes"].sum()


def test_a_life_in_mujoco_warp_begins_as_in_c_mujoco_and_continues_bit_exactly(tmp_path):
    pytest.importorskip("mujoco_warp")
    from musebot.tasks.tensors.warp import WarpTensors

    ours, warp = (
        dataclasses.replace(SHORT, body="mujoco", physics=physics) for physics in ("c", "warp")
    )
    whole = lived(warp, SPOT, 900)
    assert isinstance(whole.batch, WarpTensors)
    theirs = lived(ours, SPOT, 600)
    np.testing.assert_allclose(lived(warp, SPOT, 600).batch.pose, theirs.batch.pose, atol=0.01)
    first = lived(warp, SPOT, 617)
    arrays, notes = first.checkpoint()
    arrays = {name: array.copy() for name, array in arrays.items()}
    second = Cohort(warp, CohortKey(SPOT, 0))
    second.restore(arrays, notes)
    second.advance(900 - 617)
    for name, array in second.checkpoint()[0].items():
        assert np.array_equal(array, whole.checkpoint()[0][name]), name


# ---- What is refused ----


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--device", "tpu"], "the device must be cpu, cuda or cuda:N, got 'tpu'"),
        (["--physics", "mjx"], "the physics must be one of c, warp, got 'mjx'"),
        (
            ["--physics", "warp", "--body", "kinematic"],
            "the physics 'warp' is one of the body 'mujoco' only",
        ),
        (["--device", "cuda:x"], "the device must be cpu, cuda or cuda:N"),
        (
            ["--device", "cuda"],
            "only the body 'kinematic' or the physics 'warp' can be simulated on a GPU",
        ),
    ],
)
def test_a_device_that_cannot_be_is_one_sentence_and_writes_nothing(
    words, sentence, tmp_path, capsys
):
    assert cli.main(["run", str(tmp_path / "out"), *words]) == 2
    complaint = capsys.readouterr().err
    assert sentence in complaint and complaint.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_without_a_gpu_the_sentence_says_so(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    words = ["--body", "kinematic", "--device", "cuda", "--robots", "2"]
    assert cli.main(["run", str(tmp_path / "out"), *words]) == 2
    assert "there is no GPU that PyTorch can use" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_gpu_that_is_missing_or_too_small_is_refused(monkeypatch):
    plan = Plan.of(CUDA, [SPOT], 4)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    with pytest.raises(InputError, match="there is no device cuda:1: there are 1"):
        check_device(plan)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda number: (1000, 10**9))
    with pytest.raises(InputError, match="a cohort of 4 robots would need about"):
        check_device(plan)
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda number: (10**10, 10**11))
    check_device(plan)
    agents = Plan.of(CUDA, [Condition("spot_finding", "hand_coded:make")], 4)
    with pytest.raises(InputError, match="only robots with a brain are simulated on cuda:1"):
        check_device(agents)


def test_a_run_is_not_continued_on_another_device(tmp_path, capsys):
    out = tmp_path / "out"
    words = ["run", str(out), "--robots", "2", "--time-scale", "0.002", "--body", "kinematic"]
    assert cli.main([*words, "--task", "wall_avoidance", "--proposer", "fixed"]) == 0
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert cli.main(["run", str(out), "--device", "cuda"]) == 2
    assert "device" in capsys.readouterr().err
    assert before == {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
