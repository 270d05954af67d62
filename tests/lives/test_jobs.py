"""Jobs: a cohort as a piece of work that stops and continues, and jobs with progress."""

import itertools
import queue

import numpy as np
import pytest

from musebot.protocols.errors import Interrupted
from musebot.protocols.lives import jobs
from musebot.protocols.lives.checkpoints import checkpoint_file, read_lives
from musebot.protocols.lives.cohort import Cohort
from musebot.protocols.lives.conditions import CohortKey, Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.jobs import CohortJob, execute, run_job

KEY = CohortKey(Condition("wall_avoidance", "fixed"), 0)
SHORT = Experiment(cohort_size=2, time_scale=0.004, body="kinematic")
SECONDS = 2 * 38.4  # two robots, 160 minutes times 0.004


def job_in(directory, save_every=60.0):
    (directory / "checkpoints").mkdir(parents=True, exist_ok=True)
    return CohortJob(directory, SHORT, (KEY,), save_every)


def never():
    return False


def test_the_cost_of_a_cohort_is_the_simulated_seconds_of_its_robots(tmp_path):
    assert job_in(tmp_path).cost == pytest.approx(SECONDS)
    assert str(job_in(tmp_path / "run")) == "run/wall_avoidance-fixed-0000"


def test_a_job_leaves_its_file_and_no_checkpoint(tmp_path):
    job, reports = job_in(tmp_path, save_every=0), []
    assert not job.done()
    assert job.run(never, lambda done, message: reports.append((done, message)))
    assert job.done()
    assert [path.name for path in (tmp_path / "checkpoints").iterdir()] == [job.path.name]
    assert reports[0] == (0, "") and reports[-1] == (pytest.approx(SECONDS), "")
    assert [done for done, _ in reports] == sorted(done for done, _ in reports)


@pytest.mark.parametrize(("save_every", "least", "most"), [(0, 2, 100), (60, 0, 0)])
def test_a_job_saves_as_often_as_it_is_told(tmp_path, monkeypatch, save_every, least, most):
    saved = []
    monkeypatch.setattr(jobs, "save_checkpoint", lambda *_: saved.append(1))
    job_in(tmp_path, save_every).run(never, lambda *_: None)
    assert least <= len(saved) <= most


def test_the_time_between_two_saves_is_counted_from_the_last_one(tmp_path, monkeypatch):
    saved, seconds = [], itertools.count()
    monkeypatch.setattr(jobs, "save_checkpoint", lambda *_: saved.append(next(seconds)))
    monkeypatch.setattr(jobs, "_CHUNK", 1)
    monkeypatch.setattr(jobs.time, "monotonic", lambda: next(seconds))  # a second a look
    job_in(tmp_path, save_every=20).run(never, lambda *_: None)
    assert len(saved) > 5
    assert set(np.diff(saved)) <= {21, 22, 23, 24}


def test_an_executor_is_closed_where_the_reader_of_its_jobs_fails(tmp_path):
    closed = []

    def executor(jobs, progress):
        try:
            yield jobs[0]
            yield jobs[0]
        finally:
            closed.append(True)

    def fail(job):
        raise ValueError("full")

    with pytest.raises(ValueError, match="full") as caught:  # it keeps the reader's frame alive
        execute("x", [job_in(tmp_path)], executor, fail, quiet=True)
    assert closed == [True] and caught


def test_a_stopped_job_leaves_a_checkpoint_and_continues_to_the_same_file(tmp_path):
    whole, cut = job_in(tmp_path / "whole"), job_in(tmp_path / "cut")
    assert whole.run(never, lambda *_: None)
    calls = 0

    def after_a_chunk():
        nonlocal calls
        calls += 1
        return calls == 2

    assert not cut.run(after_a_chunk, lambda *_: None)
    assert not cut.done() and checkpoint_file(tmp_path / "cut", KEY).exists()
    reports = []
    assert cut.run(never, lambda done, message: reports.append(done))
    assert reports[0] == pytest.approx(50 * 2 * 0.1)  # the steps before it was stopped
    assert cut.path.read_bytes() == whole.path.read_bytes()


def test_a_job_that_is_stopped_before_it_begins_leaves_nothing(tmp_path):
    job = job_in(tmp_path)
    assert not run_job(job, lambda: True, lambda *_: None)
    assert list((tmp_path / "checkpoints").iterdir()) == []


def test_a_job_that_is_done_does_nothing_and_reports_its_cost(tmp_path):
    job, reports = job_in(tmp_path), []
    job.run(never, lambda *_: None)
    before = job.path.read_bytes()
    job.path.write_bytes(b"not read")
    assert run_job(job, never, lambda *report: reports.append(report))
    assert reports == [(pytest.approx(SECONDS), "")]
    job.path.write_bytes(before)
    assert read_lives(job.path, job.experiment, job.keys[0]).valid.all()


def test_a_damaged_checkpoint_is_reported(tmp_path):
    job, messages = job_in(tmp_path), []
    checkpoint_file(tmp_path, KEY).write_bytes(b"nonsense")
    assert job.run(never, lambda done, message: messages.append(message))
    assert f"set aside, cohort {KEY} starts anew" in messages[0]
    assert not any(messages[1:])


def reported(directory, broken):
    """Returns what the job reports if `broken` treats the cohort after each of its chunks."""
    messages = []

    class Broken(Cohort):
        def advance(self, steps):
            super().advance(steps)
            broken(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            jobs, "restored_cohorts", lambda folder, what, keys: ([Broken(what, keys[0])], "")
        )
        job_in(directory).run(never, lambda done, message: messages.append(message))
    return [message for message in messages if message]


def test_an_unstable_robot_is_reported_once(tmp_path):
    def broken(cohort):
        if cohort.step == 100:
            cohort.batch.stop([1])

    assert reported(tmp_path, broken) == [
        f"unstable simulation in {tmp_path.name}/{KEY}: robots [1] stopped by step 100"
    ]
    job = job_in(tmp_path)
    assert read_lives(job.path, job.experiment, job.keys[0]).valid.tolist() == [True, False]


@pytest.mark.parametrize("later", [np.nan, 0.0], ids=["still", "no longer"])
def test_a_robot_whose_weights_are_not_finite_is_not_called_unstable(tmp_path, later):
    def broken(cohort):
        if cohort.step == 50:
            cohort.batch.stop([1])
        if cohort.step == 100:
            weights = next(iter(cohort.agent.weights().values()))
            weights[0] = np.nan
            cohort._stop_unsound()
            weights[0] = later

    where = f"{tmp_path.name}/{KEY}"
    assert reported(tmp_path, broken) == [
        f"unstable simulation in {where}: robots [1] stopped by step 50",
        f"weights that are not finite in {where}: robots [0] stopped by step 100",
    ]


# Execution


class Number:
    """A job of no work."""

    cost = 1.0

    def __init__(self, number):
        self.number = number


def test_without_jobs_nothing_is_executed():
    def refuse(jobs, progress):
        raise AssertionError("it executes")

    execute("nothing", [], refuse)


def test_every_job_is_handed_on_as_soon_as_it_is_done(capfd):
    numbers, events = [Number(n) for n in range(3)], []

    def executor(jobs, progress):
        for job in jobs:
            events.append(f"ran {job.number}")
            yield job

    execute("numbers", numbers, executor, lambda job: events.append(f"got {job.number}"))
    assert events == ["ran 0", "got 0", "ran 1", "got 1", "ran 2", "got 2"]
    assert "numbers" in capfd.readouterr().err


def test_messages_are_shown_first_and_nothing_is_shown_quietly(capfd):
    def executor(jobs, progress):
        progress.tell("a message of a job")
        yield from jobs

    execute("numbers", [Number(0)], executor, messages=["a damaged file"])
    shown = capfd.readouterr().err
    assert 0 <= shown.index("a damaged file") < shown.index("a message of a job")
    execute("numbers", [Number(0)], lambda jobs, progress: iter_generator(jobs), quiet=True)
    assert "numbers" not in capfd.readouterr().err


def iter_generator(jobs):
    yield from jobs


@pytest.mark.parametrize("error", [Interrupted, OSError, KeyboardInterrupt])
def test_the_executor_is_closed_where_a_job_cannot_be_handed_on(error):
    events = []

    def executor(jobs, progress):
        try:
            for job in jobs:
                events.append(f"ran {job.number}")
                yield job
        except GeneratorExit:
            events.append("closed")
            raise

    def refuse(job):
        raise error

    with pytest.raises(error):
        execute("numbers", [Number(n) for n in range(3)], executor, refuse, quiet=True)
    assert events == ["ran 0", "closed"]


def test_progress_counts_robots_where_every_job_is_a_cohort_and_jobs_otherwise(tmp_path, capfd):
    def executor(jobs, progress):
        progress.show(iter_reports(jobs))
        yield from jobs

    for own, words in (
        ([job_in(tmp_path)], "2 of 2 robots done"),
        ([job_in(tmp_path), Number(3)], "2 of 2 jobs done"),
    ):
        execute("work", own, executor)
        assert words in capfd.readouterr().err


def iter_reports(jobs):
    reports = queue.Queue()
    for number, job in enumerate(jobs):
        reports.put((number, job.cost, ""))
    return reports
