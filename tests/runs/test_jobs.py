"""The contract of jobs: stopped anywhere, they continue to the same bytes; and their progress."""

import functools
import itertools
import queue

import numpy as np
import pytest
from helpers import files_below

from musebot.controller import BRAINS, Parameters
from musebot.controller.creative_memory import NoisePatterns
from musebot.protocols.compare.jobs import ArrayJob, simulate_cohort
from musebot.protocols.errors import RunError
from musebot.protocols.runs import jobs
from musebot.protocols.runs.checkpoints import read_lives
from musebot.protocols.runs.cohort import Cohort
from musebot.protocols.runs.conditions import CohortKey, Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.jobs import CohortJob, execute, run_job
from musebot.tasks.batch import CapacityError

SHORT = Experiment(cohort_size=2, time_scale=0.0005, body="kinematic")
FIXED, CREATIVE = (CohortKey(Condition("wall_avoidance", p), 0) for p in ("fixed", "creative"))
LEARNER = Condition("spot_finding", "musebot:sarsa_lambda")


def cohort_job(folder, key=FIXED, save_every=60.0, experiment=SHORT):
    (folder / "checkpoints").mkdir(parents=True, exist_ok=True)
    return CohortJob(folder, experiment, key, save_every)


def evaluation(folder):
    folder.mkdir(parents=True, exist_ok=True)
    cost = SHORT.robot_seconds(sum(SHORT.life_of(LEARNER.life).steps()))
    work = functools.partial(simulate_cohort, SHORT, LEARNER)
    return ArrayJob(folder / "one.safetensors", work, cost, {"seed": SHORT.seed})


def of(proposer, task="wall_avoidance", body="kinematic", **changes):
    """Returns a function that makes the job of a cohort in a folder."""
    experiment = Experiment(cohort_size=2, time_scale=0.0005, body=body, **changes)
    key = CohortKey(Condition(task, proposer), 1)
    return lambda folder: cohort_job(folder, key, experiment=experiment)


JOBS = {
    "fixed": of("fixed"),
    "random": of("random", "spot_finding"),
    "steady in MuJoCo": of("creative", body="mujoco", brain=BRAINS["steady"]),
    "noise held": of("creative", brain=Parameters(noise_steps=7)),
    "noise for life": of("creative", brain=Parameters(noise_steps=0)),
    "of a learner": of(LEARNER.proposer, LEARNER.life),
    "of networks of a learner": of("musebot:dqn_no_replay", "spot_finding"),
    "on tensors": of("creative"),
    "saved often": lambda folder: cohort_job(folder, CREATIVE, save_every=0.0),
    "of a study": evaluation,
}


@pytest.fixture(params=JOBS)
def make(request, monkeypatch):
    """Makes a job of one kind in a folder."""
    monkeypatch.setattr(jobs, "_CHUNK", 7)
    monkeypatch.setattr(NoisePatterns, "LIFETIME", 40)  # less than a life
    if request.param == "on tensors":
        monkeypatch.setattr(Experiment, "on_tensors", True)
    return JOBS[request.param]


def never():
    return False


def run(job, stops=never):
    """Runs a job; returns whether it is done, the amounts it reported, and its messages."""
    reports = []
    done = run_job(job, stops, lambda *report: reports.append(report))
    return done, [amount for amount, _ in reports], [text for _, text in reports if text]


def test_a_job_stopped_anywhere_continues_to_the_same_bytes(make, tmp_path):
    whole, cut = make(tmp_path / "whole"), make(tmp_path / "cut")
    done, amounts, messages = run(whole)
    assert done and whole.done() and not messages
    assert amounts[0] == 0 and amounts[-1] == pytest.approx(whole.cost)
    if isinstance(whole, CohortJob):  # simulated seconds of robots, 160 or 360 minutes times 0.0005
        seconds = 4.8 if whole.key.condition.life == "wall_avoidance" else 10.8
        assert whole.cost == pytest.approx(2 * seconds)
    assert amounts == sorted(amounts)
    assert [path.name for path in files_below(tmp_path / "whole")] == [whole.path.name]

    reached = 0.0
    for looks in itertools.count(1):
        calls = itertools.count()
        done, amounts, _ = run(cut, lambda: next(calls) >= looks)  # noqa: B023
        if amounts:  # it has begun
            assert amounts[0] >= reached - 1e-9  # where it was stopped
            reached = amounts[-1]
        if done:
            break
        assert not cut.done()
    assert files_below(tmp_path / "cut") == files_below(tmp_path / "whole")


def test_a_job_that_is_done_is_not_run_again_and_one_that_must_stop_does_not_begin(make, tmp_path):
    job = make(tmp_path)
    before = files_below(tmp_path)
    assert run(job, lambda: True) == (False, [], []) and files_below(tmp_path) == before
    assert run(job)[0]
    content = files_below(tmp_path)
    assert run(job) == (True, [job.cost], []) and files_below(tmp_path) == content


def test_the_time_between_two_checkpoints_is_counted_from_the_last_one(tmp_path, monkeypatch):
    saved, seconds = [], itertools.count()
    monkeypatch.setattr(jobs, "save_checkpoint", lambda *_: saved.append(next(seconds)))
    monkeypatch.setattr(jobs, "_CHUNK", 1)
    monkeypatch.setattr(jobs.time, "monotonic", lambda: next(seconds))  # a second a look
    assert run(cohort_job(tmp_path, save_every=10))[0]
    assert len(saved) > 3 and {*np.diff(saved)} <= {11, 12, 13, 14}


# Robots that are stopped, and simulations that cannot go on


@pytest.fixture
def disturbed(monkeypatch):
    """Lets a function treat a job's cohort after each stretch that it simulates."""

    def disturb(function):
        advance = Cohort.advance

        def advance_disturbed(cohort, steps):
            advance(cohort, steps)
            function(cohort)

        monkeypatch.setattr(Cohort, "advance", advance_disturbed)

    monkeypatch.setattr(jobs, "_CHUNK", 20)
    return disturb


def test_robots_that_are_stopped_are_reported_once_with_the_cause(tmp_path, disturbed):
    def broken(cohort):
        if cohort.step == 20:
            cohort.batch.stop([1])
        if cohort.step == 40:
            weights = next(iter(cohort.agent.weights().values()))
            weights[0] = np.nan
            cohort.batch.stop(np.flatnonzero(cohort.unsound()))

    disturbed(broken)
    job = cohort_job(tmp_path)
    where, looks = f"in {tmp_path.name}/{FIXED}: robots", itertools.count()
    assert run(job, lambda: next(looks) == 2)[2] == [
        f"unstable simulation {where} [1] stopped by step 20"
    ]
    assert run(job)[2] == [f"weights that are not finite {where} [0] stopped by step 40"]
    assert read_lives(job.path, SHORT, FIXED).valid.tolist() == [False, False]


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (RunError("the agent failed"), "the agent failed, in {run}/{key} at step 20"),
        (CapacityError("full"), "full, in {run}/{key} at step 20"),
        (OSError(28, "No space"), "a file could not be read or written .*No space"),
        (SystemExit(3), r"^a process ended itself \(status 3\)$"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_stops_a_job_is_one_sentence(error, words, tmp_path, disturbed):
    def fail(cohort):
        raise error

    disturbed(fail)
    with pytest.raises(RunError, match=words.format(run=tmp_path.name, key=FIXED)):
        run(cohort_job(tmp_path))


# Execution


class Number:
    """A job of no work."""

    cost = 1.0


def test_jobs_are_watched_and_counted_as_robots_where_every_one_is_a_cohort(tmp_path, capfd):
    def executor(jobs, progress):
        progress.show(reports_of(jobs))
        for job in jobs:
            progress.show(reports_of([]))
            yield job

    execute("nothing", [], pytest.fail)
    for own, words in (
        ([cohort_job(tmp_path)], "2 of 2 robots done"),
        ([cohort_job(tmp_path), Number()], "2 of 2 jobs done"),
    ):
        events = []
        execute("work", own, executor, events.append, watcher=lambda: events.append("watched"))  # noqa: B023
        assert events == ["watched", *(event for job in own for event in ("watched", job))]
        assert words in capfd.readouterr().err
    execute("work", own, executor, quiet=True)
    assert "work" not in capfd.readouterr().err


def reports_of(jobs):
    reports = queue.Queue()
    for number, job in enumerate(jobs):
        reports.put((number, job.cost, ""))
    return reports
