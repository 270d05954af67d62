"""TensorBoard's log holds each minute once, however often a run is stopped, and changes nothing."""

import shutil
import sys

import numpy as np
import pytest
from helpers import files_below

import musebot
from musebot.protocols.errors import Interrupted
from musebot.protocols.runs.checkpoints import checkpoint_file, save_checkpoint
from musebot.protocols.runs.cohort import Cohort
from musebot.protocols.runs.conditions import CohortKey, Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.plan import Plan
from musebot.protocols.runs.simulation import UnfinishedRun, simulate

WALLS, SPOT = Condition("wall_avoidance", "fixed"), Condition("spot_finding", "fixed")
SHORT = {"cohort_size": 2, "time_scale": 0.0065, "body": "kinematic", "backend": "numba"}
TAGS = {WALLS: "contact", SPOT: "in_spot"}


def plan(robots=2):
    return Plan.of(Experiment(**SHORT), TAGS, robots)


def check_log(folder, run, robots=2):
    """Checks that TensorBoard shows the mean curves of a run, each minute once."""
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    for condition, tag in TAGS.items():
        path = folder / "tensorboard" / f"{condition.life}-{condition.proposer}-{robots}"
        events = accumulator.EventAccumulator(str(path)).Reload()
        assert events.Tags()["scalars"] == [tag]
        wanted = run.curves(condition).mean(axis=0)
        minutes, values = zip(*((s.step, s.value) for s in events.Scalars(tag)), strict=True)
        assert minutes == (*range(1, len(wanted) + 1),)
        np.testing.assert_allclose(values, wanted, rtol=1e-6)
        assert len(wanted) > 1 and (condition == SPOT or wanted.max() > 0)


def files(folder):
    return {
        path: content
        for path, content in files_below(folder).items()
        if "tensorboard" not in path.parts and path.name != "experiment.json"
    }


@pytest.fixture(scope="module")
def plain(tmp_path_factory, in_process):
    pytest.importorskip("tensorboard", reason="needs the extra `tensorboard`")
    folder = tmp_path_factory.mktemp("plain")
    return folder, simulate(folder, plan(), in_process(), quiet=True)


def test_a_run_that_is_resumed_and_enlarged_has_each_minute_once(plain, tmp_path, in_process):
    with pytest.raises(Interrupted):
        simulate(tmp_path, plan(), in_process(1), quiet=True, log=True)
    for _ in range(2):  # the second time it is finished
        check_log(tmp_path, simulate(tmp_path, plan(), in_process(), quiet=True, log=True))
    assert files(tmp_path) == files(plain[0])
    with pytest.raises(Interrupted):
        simulate(tmp_path, plan(4), in_process(1), quiet=True, log=True)
    check_log(tmp_path, simulate(tmp_path, plan(4), in_process(), quiet=True, log=True), 4)


def test_the_curve_of_running_cohorts_ends_where_the_slowest_is_without_stopped_robots(tmp_path):
    (tmp_path / "checkpoints").mkdir()
    cohorts = [Cohort(plan().experiment, CohortKey(SPOT, index)) for index in range(2)]
    run = UnfinishedRun(tmp_path, plan(4), {}, plan(4).cohorts(), {})
    for cohort, minutes, reached in zip(cohorts, (2, 1), (0, 1), strict=True):
        cohort.batch.stop(np.array([1]))
        cohort.advance(600 * minutes + 30)
        save_checkpoint(checkpoint_file(tmp_path, cohort.key), cohort)
        assert len(run.curve(SPOT)) == reached
    counts = [cohort.lives().minutes[0, :1] for cohort in cohorts]
    np.testing.assert_allclose(run.curve(SPOT), np.mean(counts, axis=0) / 600, rtol=1e-6)
    cohorts[0].advance(10**9)
    run.lives[cohorts[0].key] = cohorts[0].lives()
    run.left.remove(cohorts[0].key)
    np.testing.assert_allclose(run.curve(SPOT), np.mean(counts, axis=0) / 600, rtol=1e-6)
    checkpoint_file(tmp_path, cohorts[1].key).write_bytes(b"damaged")
    assert len(run.curve(SPOT)) == 0


def test_the_log_is_updated_while_jobs_run_where_it_is_due(tmp_path, monkeypatch):
    pytest.importorskip("tensorboard")
    from musebot.protocols.runs import tensorboard_log

    now, curve = [0.0], np.zeros(2)
    run = UnfinishedRun(tmp_path, plan(), {}, [], {})
    monkeypatch.setattr(tensorboard_log.time, "monotonic", lambda: now[0])
    run.curve = lambda condition: curve
    log = tensorboard_log.TensorBoardLog(run, every=60)
    log.update()
    assert not (tmp_path / "tensorboard").exists()
    now[0] = 60.0
    log.update()
    sizes = [path.stat().st_size for path in tmp_path.rglob("events.*")]
    assert len(sizes) == 2
    curve = np.zeros(3)
    log.update(now=True)
    assert all(p.stat().st_size > size for p, size in zip(tmp_path.rglob("events.*"), sizes))  # noqa: B905


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
    for name in [name for name in sys.modules if "tensorboard" in name]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    words = r"^tensorboard is not installed; pip install 'musebot\["
    with pytest.raises(ModuleNotFoundError, match=words):
        musebot.run(tmp_path / "out", tensorboard=True)
    assert not (tmp_path / "out").exists()
