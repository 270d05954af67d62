"""Cohorts on another device: their loop, their checkpoints, and what is refused before work."""

import dataclasses
import json

import numpy as np
import pytest
import torch

from musebot.protocols.cli import parser as cli
from musebot.protocols.errors import InputError, RunError
from musebot.protocols.lives import budget
from musebot.protocols.lives import cohort as module
from musebot.protocols.lives.budget import cohort_bytes
from musebot.protocols.lives.checkpoints import checkpoint_file, finished_file, read_lives
from musebot.protocols.lives.cohort import Cohort
from musebot.protocols.lives.conditions import CohortKey, Condition
from musebot.protocols.lives.device import on_tensors, robots_on_device
from musebot.protocols.lives.executor_choice import Workers
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.jobs import CohortJob
from musebot.protocols.lives.local import Local
from musebot.protocols.lives.manifest import same_physics
from musebot.protocols.lives.overrides import named_brain
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.run_files import read_run
from musebot.protocols.lives.runs import UnfinishedRun, check_device
from musebot.protocols.storage import load_arrays
from musebot.tasks.batch import CapacityError
from musebot.tasks.tensors.robots import KinematicTensors, parts

SPOT, WALLS = (Condition(task, "creative") for task in ("spot_finding", "wall_avoidance"))
SHORT = Experiment(
    seed=5, cohort_size=4, time_scale=0.01, body="kinematic", brain=named_brain("steady")
)
CUDA = Experiment(cohort_size=4, body="kinematic", device="cuda:1")


@pytest.fixture
def tensors(monkeypatch):
    """Cohorts whose robots are tensors, on the host, as there may be no GPU."""
    monkeypatch.setattr(Experiment, "on_tensors", True)


def lived(experiment=SHORT, condition=WALLS, steps=None):
    cohort = Cohort(experiment, CohortKey(condition, 0))
    cohort.advance(cohort.steps if steps is None else steps)
    return cohort


@pytest.mark.parametrize("condition", [SPOT, WALLS], ids=str)
def test_a_life_on_tensors_begins_as_the_life_in_numpy_does(condition, tensors, monkeypatch):
    """Rounding differs, so that longer lives part: short ones are compared."""
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
    whole = on_tensors(experiment.batch("wall_avoidance", 2))
    monkeypatch.setattr(module, "robots_on_device", lambda *of: [whole])
    monkeypatch.setattr(module, "agent_on_device", lambda experiment, make: make())
    chunks = []
    advance = Cohort.advance

    def spy(cohort, steps):
        chunks.append(steps)
        advance(cohort, steps)

    monkeypatch.setattr(Cohort, "advance", spy)
    (tmp_path / "checkpoints").mkdir()
    job = CohortJob(tmp_path, experiment, (CohortKey(WALLS, 0),), 60.0)
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


# ---- Cohorts that share their physics ----

PROPOSERS = ("fixed", "random", "creative")
KEYS = [CohortKey(Condition("wall_avoidance", proposer), 0) for proposer in PROPOSERS]
TRIO = Experiment(seed=5, cohort_size=3, time_scale=0.01, body="kinematic")


def finished(folder, *groups, stop=lambda: False):
    (folder / "checkpoints").mkdir(parents=True, exist_ok=True)
    for keys in groups:
        job = CohortJob(folder, TRIO, tuple(keys), 60.0)
        job.run(stop, lambda done, message: None)
    return {key: read_lives(finished_file(folder, key), TRIO, key) for key in KEYS}


def assert_equal_lives(ours, theirs):
    for key in KEYS:
        for name in ("events", "minutes", "valid"):
            one, other = getattr(ours[key], name), getattr(theirs[key], name)
            assert np.array_equal(one, other), (key, name)
        for name, weights in ours[key].after.items():
            assert np.array_equal(weights, theirs[key].after[name]), (key, name)


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Experiment, "on_tensors", True)
        return finished(tmp_path_factory.mktemp("alone"), *([key] for key in KEYS))


def test_cohorts_live_together_as_they_live_alone(tensors, tmp_path, alone):
    assert_equal_lives(finished(tmp_path, KEYS), alone)
    assert {path.suffixes[0] for path in (tmp_path / "checkpoints").iterdir()} == {".finished"}


def test_cohorts_that_were_saved_at_different_steps_catch_up(tensors, tmp_path, alone):
    """A process may be killed after it has saved one of the cohorts."""
    chunks = iter([False] * 6 + [True])
    with pytest.raises(FileNotFoundError):
        finished(tmp_path, KEYS, stop=lambda: next(chunks))
    middle = checkpoint_file(tmp_path, KEYS[1]).read_bytes()
    chunks = iter([False] * 6 + [True])
    with pytest.raises(FileNotFoundError):
        finished(tmp_path, KEYS, stop=lambda: next(chunks))
    late = load_arrays(checkpoint_file(tmp_path, KEYS[1]))[1]["step"]
    checkpoint_file(tmp_path, KEYS[1]).write_bytes(middle)
    assert load_arrays(checkpoint_file(tmp_path, KEYS[1]))[1]["step"] < late
    assert_equal_lives(finished(tmp_path, KEYS), alone)


def test_a_damaged_checkpoint_starts_its_cohort_anew_and_the_others_continue(
    tensors, tmp_path, alone
):
    chunks = iter([False] * 6 + [True])
    with pytest.raises(FileNotFoundError):
        finished(tmp_path, KEYS, stop=lambda: next(chunks))
    checkpoint_file(tmp_path, KEYS[2]).write_bytes(b"damaged")
    assert_equal_lives(finished(tmp_path, KEYS), alone)


def test_a_cohort_that_catches_up_can_be_stopped(tensors, tmp_path, alone):
    chunks = iter([False] * 12 + [True])
    with pytest.raises(FileNotFoundError):
        finished(tmp_path, KEYS, stop=lambda: next(chunks))
    checkpoint_file(tmp_path, KEYS[1]).unlink()
    chunks = iter([False] * 2 + [True])
    with pytest.raises(FileNotFoundError):
        finished(tmp_path, KEYS, stop=lambda: next(chunks))
    steps = [load_arrays(checkpoint_file(tmp_path, key))[1]["step"] for key in KEYS]
    assert 0 < steps[1] < steps[0] == steps[2]
    assert_equal_lives(finished(tmp_path, KEYS), alone)


def test_in_mujoco_warp_cohorts_live_together_as_they_live_alone(tmp_path):
    pytest.importorskip("mujoco_warp")
    warp = Experiment(seed=5, cohort_size=2, time_scale=0.004, physics="warp")
    lives = []
    for name, groups in (("alone", [[key] for key in KEYS]), ("together", [KEYS])):
        folder = tmp_path / name
        (folder / "checkpoints").mkdir(parents=True)
        for keys in groups:
            job = CohortJob(folder, warp, tuple(keys), 60.0)
            assert job.run(lambda: False, lambda done, message: None)
        lives.append([read_lives(finished_file(folder, key), warp, key) for key in KEYS])
    for one, other in zip(*lives, strict=True):
        assert np.array_equal(one.minutes, other.minutes)
        for name, weights in one.after.items():
            assert np.array_equal(weights, other.after[name]), name


def test_dropped_contacts_end_a_run_with_a_sentence_that_names_the_robot(tmp_path, monkeypatch):
    pytest.importorskip("mujoco_warp")
    from musebot.tasks.tensors.warp import WarpTensors

    def full(self, motors):
        raise CapacityError("MuJoCo Warp dropped contacts", [5])

    warp = Experiment(cohort_size=2, time_scale=0.004, physics="warp")
    monkeypatch.setattr(WarpTensors, "step", full)
    (tmp_path / "checkpoints").mkdir()
    job = CohortJob(tmp_path, warp, tuple(KEYS), 60.0)
    with pytest.raises(RunError, match=f"in .*{KEYS[2]} this is robot 1"):
        job.run(lambda: False, lambda done, message: None)


def test_conditions_of_a_task_are_one_job(tensors, tmp_path):
    plan = Plan.of(TRIO, [*(key.condition for key in KEYS), SPOT], 6)
    jobs = UnfinishedRun.read(tmp_path, plan).jobs(60.0)
    assert [len(job.keys) for job in jobs] == [1, 1, 3, 3]
    assert str(jobs[2]).count(" with ") == 2
    assert jobs[2].cost == 3 * dataclasses.replace(jobs[2], keys=jobs[2].keys[:1]).cost


def test_a_part_takes_no_step_of_its_own(tensors):
    first, second = robots_on_device(TRIO, "spot_finding", 2)
    with pytest.raises(TypeError, match="a part takes no step of its own"):
        first.step(torch.zeros(3, 2))
    second.place(np.array([0]), np.array([[0.1, 0.2, 0.3]]))
    assert second.pose[0].tolist() == pytest.approx([0.1, 0.2, 0.3]) and not first.pose.any()
    before = first.spot.tolist()
    second.place_spot(np.array([1]), np.array([[-0.1, 0.25]]))
    assert second.spot[1].tolist() == pytest.approx([-0.1, 0.25]) and first.spot.tolist() == before
    second.stop(np.array([2]))
    assert first.valid.tolist() == [True] * 3 and second.valid.tolist() == [True, True, False]
    with pytest.raises(ValueError, match=r"robots must lie in \[0, 2\]"):
        first.place(np.array([3]), np.zeros((1, 3)))
    with pytest.raises(ValueError, match="6 robots cannot be 4 equal parts"):
        parts(first.whole, 4)


def test_a_run_in_mujoco_warp_simulates_all_conditions_of_a_task_together(tmp_path, capsys):
    pytest.importorskip("mujoco_warp")
    words = ["--physics", "warp", "--robots", "3", "--time-scale", "0.002"]
    assert cli.main(["run", str(tmp_path / "out"), *words, "--task", "spot_finding"]) == 0
    assert "3 cohorts" in capsys.readouterr().err
    rows = (tmp_path / "out" / "robots.csv").read_text().splitlines()
    assert len(rows) == 10
    manifest = json.loads((tmp_path / "out" / "experiment.json").read_text())
    assert manifest["experiment"]["physics"] == "warp"


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
    with pytest.raises(InputError, match="cohorts of 4 robots would need about"):
        check_device(plan)
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda number: (10**10, 10**11))
    check_device(plan)
    agents = Plan.of(CUDA, [Condition("spot_finding", "hand_coded:make")], 4)
    with pytest.raises(InputError, match="only robots with a brain are simulated on cuda:1"):
        check_device(agents)


def test_cohorts_that_share_a_device_need_its_memory_together(monkeypatch):
    conditions = [key.condition for key in KEYS]
    plan = Plan.of(dataclasses.replace(CUDA, cohort_size=1000), conditions, 1000)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    largest = max(cohort_bytes(plan.experiment, condition) for condition in conditions)
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda number: (largest + 10, 10**11))
    with pytest.raises(InputError, match="would need about"):
        check_device(plan)
    monkeypatch.setattr(budget, "machine_bytes", lambda: largest + 10)
    with pytest.raises(InputError, match="a cohort of wall_avoidance would need about"):
        budget.check_memory(plan)


def test_a_run_of_another_version_of_mujoco_warp_has_another_physics(short_warp):
    assert same_physics(short_warp)
    manifest = short_warp / "experiment.json"
    content = json.loads(manifest.read_text())
    del content["files"], content["digest"]  # as an older version wrote it
    content["made_with"][0]["warp-lang"] = "1.18.0"
    manifest.write_text(json.dumps(content))
    assert not same_physics(short_warp)


def test_brains_of_a_run_in_mujoco_warp_are_replayed_in_c_mujoco_which_is_said(short_warp, capsys):
    assert read_run(short_warp).experiment.physics == "warp"
    assert read_run(short_warp, replay=True).experiment.physics == "c"
    assert "its brains now run in C MuJoCo" in capsys.readouterr().err


@pytest.fixture
def short_warp(tmp_path):
    """A short run in MuJoCo Warp."""
    pytest.importorskip("mujoco_warp")
    words = ["run", str(tmp_path / "out"), "--physics", "warp", "--robots", "2"]
    words += ["--time-scale", "0.002", "--task", "wall_avoidance", "--proposer", "fixed"]
    assert cli.main(words) == 0
    return tmp_path / "out"


def test_a_run_is_not_continued_on_another_device(tmp_path, capsys):
    out = tmp_path / "out"
    words = ["run", str(out), "--robots", "2", "--time-scale", "0.002", "--body", "kinematic"]
    assert cli.main([*words, "--task", "wall_avoidance", "--proposer", "fixed"]) == 0
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert cli.main(["run", str(out), "--device", "cuda"]) == 2
    assert "holds an experiment with device cpu, not cuda" in capsys.readouterr().err
    assert before == {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}


def test_on_a_gpu_one_job_runs_at_a_time_and_ray_is_refused():
    assert Workers(processes=4).executor() == Local(4)
    assert Workers(processes=4).executor("cuda") == Local(1)
    with pytest.raises(InputError, match="the device cuda is this machine's"):
        Workers(engine="ray").executor("cuda")
    with pytest.raises(InputError, match="--processes is for the engine local"):
        Workers(processes=4, engine="ray").executor()
    with pytest.raises(InputError, match="engine must be local or ray, got 'Ray'"):
        Workers(engine="Ray").executor()  # type: ignore[arg-type]
