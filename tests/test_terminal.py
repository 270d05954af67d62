"""Progress of several jobs together: how far they are, how fast, and what they say."""

import errno
import io
import queue

import pytest

from musebot.protocols.exit_status import exit_status
from musebot.protocols.terminal import JobProgress, notice, printable, say


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


def test_a_log_gets_a_line_a_minute_with_robots_speed_and_time_left(capfd):
    reports = queue.Queue()
    with JobProgress("two cohorts", [3600.0, 3600.0], robots=[5, 5]) as progress:
        progress.show(reports)
        progress._began -= 100
        reports.put((0, 0.0, ""))
        reports.put((1, 0.0, ""))
        reports.put((0, 3600.0, ""))
        reports.put((1, 2000.0, ""))
        progress.show(reports)  # within the first minute
        assert len(capfd.readouterr().err.splitlines()) == 1
        progress._said -= 60
        progress.show(reports)
        progress.show(reports)  # within the second minute
        (line,) = capfd.readouterr().err.splitlines()
    assert line == "musebot: 77.8 %, 5 of 10 robots done, 56 x real time, 0:00:29 left"


def test_a_run_continued_counts_the_time_left_by_this_calls_speed():
    reports = queue.Queue()
    with JobProgress("one cohort", [4000.0], quiet=True) as progress:
        reports.put((0, 3000.0, ""))
        progress.show(reports)
        assert progress.line() == "75.0 %, 0 of 1 jobs done"
        progress._began -= 10
        reports.put((0, 3100.0, ""))
        progress.show(reports)
        assert progress.line() == "77.5 %, 0 of 1 jobs done, 10 x real time, 0:01:30 left"


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


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a[/]b [red]c", "a[/]b [red]c"),
        ("\x1b[2J\x07\r\n", r"\x1b[2J\x07\r\n"),
        ("a\u202eb\u2028c", r"a\u202eb\u2028c"),
        ("runs/\udcff", r"runs/\udcff"),
        ("10 µs – 20 µs", "10 µs – 20 µs"),
    ],
)
def test_no_character_controls_the_terminal(text, shown, capfd):
    assert printable(text) == shown
    notice(text)
    with JobProgress(text, [1.0]) as progress:
        progress.tell(text)
    lines = capfd.readouterr().err.splitlines()
    assert lines[0] == f"musebot: {shown}"
    assert shown in lines
    assert any(line == f"musebot: {shown}, 0 robot-hours" for line in lines)


def test_a_sentence_has_a_bounded_length_and_a_page_has_none():
    assert len(printable("9" * 5000)) < 2100
    assert printable("9\n" * 5000, lines=True) == "9\n" * 5000


def test_a_stream_without_the_characters_gets_escapes():
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    say("10 µs", stream)
    stream.flush()
    assert stream.buffer.getvalue() == b"10 \\xb5s\n"


@pytest.mark.parametrize(
    ("number", "status"),
    [
        (errno.EISDIR, 2), (errno.ENOTDIR, 2), (errno.ENAMETOOLONG, 2), (errno.ELOOP, 2),
        (errno.ENOSPC, 1), (errno.EIO, 1), (errno.EACCES, 1), (errno.EROFS, 1),
    ],
)  # fmt: skip
def test_the_exit_status_follows_the_cause_and_not_the_type_of_an_error(number, status, capsys):
    def fail():
        raise OSError(number, "so it is", "runs\n")

    assert exit_status(fail, check=False) == status
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_too_little_memory_is_one_sentence(capsys):
    def fail():
        raise MemoryError

    assert exit_status(fail, check=False) == 1
    assert capsys.readouterr().err == "musebot: there is not enough memory\n"
