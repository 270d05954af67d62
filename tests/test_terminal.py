"""Progress of several jobs together: how far they are, how fast, and what they say."""

import queue

import pytest

from musebot.protocols.terminal import JobProgress, notice


def task_of(progress):
    (task,) = progress._progress.tasks
    return task


def test_jobs_are_weighed_by_their_costs():
    reports = queue.Queue()
    with JobProgress("jobs", [2.0, 40.0], quiet=True) as progress:
        assert task_of(progress).total == 42.0
        reports.put((1, 20.0, ""))
        progress.show(reports)
        assert task_of(progress).completed == 20.0
        reports.put((0, 1.0, ""))
        reports.put((1, 25.0, ""))
        progress.show(reports)
        assert task_of(progress).completed == 26.0


def test_what_an_earlier_call_did_is_not_this_ones_speed():
    reports = queue.Queue()
    with JobProgress("jobs", [3600.0], quiet=True) as progress:
        reports.put((0, 1800.0, ""))
        progress.show(reports)
        assert task_of(progress).completed == 1800.0
        assert task_of(progress).fields["speed"] == ""
        progress._began -= 10  # ten seconds later
        reports.put((0, 2800.0, ""))
        progress.show(reports)
        assert task_of(progress).fields["speed"] == "100 x real time"


@pytest.mark.parametrize("quiet", [False, True])
def test_messages_are_shown_above_the_bar(quiet, capfd):
    reports = queue.Queue()
    with JobProgress("three cohorts", [7200.0], quiet) as progress:
        reports.put((0, 0.0, "a robot was stopped"))
        progress.show(reports)
    shown = capfd.readouterr().err
    assert "a robot was stopped" in shown
    assert ("three cohorts, 2 robot-hours" in shown) != quiet


def test_a_notice_is_a_sentence_on_stderr(capsys):
    notice("the physics is another version's")
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "musebot: the physics is another version's\n")
