"""TensorBoard's log holds each minute once, however often a run is stopped, and changes nothing."""

import importlib
import shutil

import numpy as np
import pytest

import musebot
from musebot.protocols.errors import InputError, Interrupted
from musebot.protocols.lives import tensorboard_log
from musebot.protocols.lives.checkpoints import checkpoint_file, save_checkpoint
from musebot.protocols.lives.cohort import Cohort
from musebot.protocols.lives.conditions import CohortKey, Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.run import collect
from musebot.protocols.lives.runs import UnfinishedRun, simulate

CONDITIONS = (Condition("wall_avoidance", "fixed"), Condition("spot_finding", "fixed"))
TAGS = {"wall_avoidance": "contact", "spot_finding": "in_spot"}


def plan(robots=4, **changes):
    settings = {"cohort_size": 2, "time_scale": 0.014, "body": "kinematic"} | changes
    return Plan.of(Experiment(**settings), CONDITIONS, robots)


def files(folder):
    """Returns the content of every file of a run but the log."""
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {
        path.relative_to(folder): path.read_bytes()
        for path in paths
        if tensorboard_log.FOLDER not in path.parts
    }


def logged(folder, condition, robots=4):
    """Returns the steps and values of a condition's log, in the order in which they are stored."""
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    path = folder / "tensorboard" / f"{condition.task}-{condition.proposer}-{robots}"
    events = accumulator.EventAccumulator(str(path)).Reload()
    assert events.Tags()["scalars"] == [TAGS[condition.task]]
    scalars = events.Scalars(TAGS[condition.task])
    return [one.step for one in scalars], np.array([one.value for one in scalars])


def check(folder, run, robots=4):
    highest = []
    for condition in run.conditions():
        steps, values = logged(folder, condition, robots)
        wanted = run.curves(condition).mean(axis=0)
        assert steps == [*range(1, len(wanted) + 1)] and len(steps) > 2
        np.testing.assert_allclose(values, wanted, rtol=1e-6)
        highest.append(values.max())
    assert max(highest) > 0


@pytest.fixture(scope="module")
def plain(tmp_path_factory, in_process):
    pytest.importorskip("tensorboard", reason="needs the extra `tensorboard`")
    folder = tmp_path_factory.mktemp("plain")
    return folder, simulate(folder, plan(), in_process(), quiet=True)


def test_a_resumed_run_continues_its_log_and_leaves_the_same_files(plain, tmp_path, in_process):
    for most in (1, 2):
        with pytest.raises(Interrupted):
            simulate(tmp_path, plan(), in_process(most), quiet=True, log=True)
    kept = {path: path.read_bytes() for path in tmp_path.rglob("events.out.*")}
    assert kept
    run = simulate(tmp_path, plan(), in_process(), quiet=True, log=True)
    check(tmp_path, run)
    assert all(path.read_bytes() == content for path, content in kept.items())
    ours, theirs = files(tmp_path), files(plain[0])
    assert ours.keys() == theirs.keys()
    differ = {str(name) for name, content in theirs.items() if ours[name] != content}
    assert differ <= {"experiment.json"}  # which has the time of the beginning


def test_finished_and_enlarged_runs_get_the_whole_log_once(plain, tmp_path, in_process):
    folder = tmp_path / "run"
    shutil.copytree(plain[0], folder)
    for _ in range(2):
        simulate(folder, plan(), in_process(), quiet=True, log=True)
        check(folder, plain[1])
    run = simulate(folder, plan(6), in_process(), quiet=True, log=True)
    check(folder, run, 6)


def test_the_curve_of_running_cohorts_ends_where_the_slowest_is(plain, tmp_path):
    condition = CONDITIONS[0]
    the_plan = plan()
    for index, minutes in enumerate((3, 2)):
        cohort = Cohort(the_plan.experiment, key := CohortKey(condition, index))
        cohort.advance(600 * minutes + 30)
        (tmp_path / "checkpoints").mkdir(exist_ok=True)
        save_checkpoint(checkpoint_file(tmp_path, key), cohort)
        unfinished = UnfinishedRun(tmp_path, the_plan, {}, the_plan.cohorts(), {})
        assert len(unfinished.curve(condition)) == (0, 2)[index]
    wanted = plain[1].curves(condition)[:, :2].mean(axis=0, dtype=float)
    np.testing.assert_array_equal(unfinished.curve(condition), wanted)
    (tmp_path / "checkpoints" / f"{key}.safetensors").write_bytes(b"damaged")
    assert len(unfinished.curve(condition)) == 0


def test_a_robot_that_was_stopped_is_in_no_part_of_the_curve(tmp_path):
    condition, the_plan = CONDITIONS[0], plan()
    (tmp_path / "checkpoints").mkdir()
    cohorts = []
    for index in range(2):
        cohort = Cohort(the_plan.experiment, key := CohortKey(condition, index))
        cohorts.append((key, cohort))
        cohort.advance(30)
        cohort.batch.stop(np.array([1]))
        cohort.advance(600 * 2)
        save_checkpoint(checkpoint_file(tmp_path, key), cohort)
    (first, lives), (second, _) = cohorts
    valid = lives.lives()
    running = UnfinishedRun(tmp_path, the_plan, {}, the_plan.cohorts(), {})
    one_finished = UnfinishedRun(tmp_path, the_plan, {}, the_plan.cohorts(), {first: valid})
    rows = collect(the_plan.experiment, [(key, one.lives()) for key, one in cohorts])[condition]
    collected = UnfinishedRun(tmp_path, the_plan, {condition: rows}, the_plan.cohorts(), {})
    wanted = rows.curves[[0, 2]].mean(axis=0, dtype=float)
    everybody = rows.curves.mean(axis=0, dtype=float)
    for unfinished in (running, one_finished, collected):
        found = unfinished.curve(condition)
        assert len(found) >= 2
        np.testing.assert_allclose(found[:2], wanted[:2])
        assert not np.allclose(found[:2], everybody[:2])


def test_the_log_is_updated_while_jobs_run(tmp_path):
    pytest.importorskip("tensorboard", reason="needs the extra `tensorboard`")
    curve = np.zeros(2)
    log = tensorboard_log.TensorBoardLog(
        tmp_path / "tensorboard", {CONDITIONS[0]: 4}, lambda condition: curve, every=0
    )
    watchers = []

    class Progress:
        def watch(self, watcher):
            watchers.append(watcher)

    def executor(jobs, progress):
        yield from jobs

    assert [*log.watching(executor)([], Progress())] == []
    watchers[0]()
    assert logged(tmp_path, CONDITIONS[0])[0] == [1, 2]
    curve = np.zeros(3)
    watchers[0]()
    assert logged(tmp_path, CONDITIONS[0])[0] == [1, 2, 3]
    log.close()


def test_a_log_that_cannot_be_written_does_not_end_the_run(plain, tmp_path, in_process, capsys):
    elsewhere, folder = tmp_path / "elsewhere", tmp_path / "run"
    elsewhere.mkdir()
    shutil.copytree(plain[0], folder)
    (folder / "tensorboard").symlink_to(elsewhere)
    simulate(folder, plan(), in_process(), quiet=True, log=True)
    said = capsys.readouterr().err
    assert said.count("the log of TensorBoard ends here") == 1 and "is a link" in said
    assert [*elsewhere.iterdir()] == []


def test_without_the_extra_nothing_is_written(tmp_path, monkeypatch):
    find = importlib.import_module

    def missing(name, *package):
        if name.startswith("tensorboard"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return find(name, *package)

    monkeypatch.setattr(importlib, "import_module", missing)
    out = tmp_path / "out"
    with pytest.raises(InputError, match=r"^tensorboard is not installed; pip install 'musebot\["):
        musebot.run(out, log="tensorboard")
    assert not out.exists()


def test_an_unknown_log_is_refused(tmp_path):
    with pytest.raises(InputError, match="^log must be one of none, tensorboard, got 'wandb'$"):
        musebot.run(tmp_path / "out", log="wandb")
    assert not (tmp_path / "out").exists()
