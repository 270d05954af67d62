"""Progress of several jobs together: how far they are, how fast, and what they say."""

import errno
import io
import os
import queue

import pytest

from musebot.protocols import progress as module
from musebot.protocols.exit_status import exit_status
from musebot.protocols.progress import JobProgress
from musebot.protocols.terminal import notice, printable


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands at the seconds of its only entry."""
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    return now


def reports_of(*reports):
    own = queue.Queue()
    for report in reports:
        own.put(report)
    return own


def test_a_log_gets_lines_with_robots_speed_and_time_left(capfd, clock):
    costs = [3600.0, 3600.0]
    with JobProgress("two cohorts", costs, robots=[5, 5]) as progress:
        clock[0] = 4.9
        progress.show(reports_of((0, 0.0, ""), (1, 0.0, ""), (0, 3600.0, ""), (1, 2000.0, "")))
        assert len(capfd.readouterr().err.splitlines()) == 1
        clock[0] = 100.0
        progress.show(reports_of())
        progress.show(reports_of())
        (line,) = capfd.readouterr().err.splitlines()
    assert line == "musebot: 77.8 %, 5 of 10 robots done, 56 x real time, 0:00:29 left"


def test_the_last_line_of_a_log_is_not_printed_twice(capfd, clock):
    for wait, shares in ((60, ["50.0", "100.0"]), (0, ["100.0"])):
        with JobProgress("two cohorts", [3600.0, 3600.0]) as progress:
            for number in range(2):
                clock[0] += wait
                progress.show(reports_of((number, 3600.0, "")))
        lines = capfd.readouterr().err.splitlines()[1:]
        assert [line.split(",")[0] for line in lines] == [f"musebot: {n} %" for n in shares]


def test_jobs_are_weighed_by_cost_and_what_an_earlier_call_did_is_not_this_ones_speed(clock):
    with JobProgress("one cohort", [4000.0, 1000.0], quiet=True) as progress:
        progress.show(reports_of((0, 3000.0, ""), (1, 1000.0, "")))
        assert progress.line() == "80.0 %, 1 of 2 jobs done"
        clock[0] += 10
        progress.show(reports_of((0, 3100.0, "")))
        assert progress.line() == "82.0 %, 1 of 2 jobs done, 10 x real time, 0:01:30 left"


def test_lines_of_a_log_come_soon_at_first_and_then_a_minute_apart(capfd, clock):
    due = []
    with JobProgress("one cohort", [4000.0]) as progress:
        capfd.readouterr()
        for second in range(300):
            clock[0] = float(second)
            progress.show(reports_of((0, float(second), "")))
            if capfd.readouterr().err:
                due.append(second)
    assert due == [5, 15, 35, 75, 135, 195, 255]


def test_a_log_gets_lines_of_steps_that_take_long(capfd, clock):
    for steps, count in ((range(20), None), (iter(range(20)), 20)):
        began = clock[0]
        for step in module.tracked(steps, "observing", count):
            clock[0] = began + step + 1.0
        lines = capfd.readouterr().err.splitlines()
        assert lines == [
            "musebot: observing: 25.0 %, 0:00:15 left",
            "musebot: observing: 75.0 %, 0:00:05 left",
        ]


def test_bars_are_drawn_on_terminals_only(monkeypatch):
    for tty, variables, bars in (
        (False, {}, False),
        (False, {"FORCE_COLOR": "1"}, False),
        (True, {"TERM": "dumb"}, False),
        (True, {"TERM": "xterm"}, True),
    ):
        stream = io.StringIO()
        stream.isatty = lambda tty=tty: tty
        with monkeypatch.context() as patch:
            patch.setattr("sys.stderr", stream)
            for name in ("TERM", "FORCE_COLOR"):
                patch.delenv(name, raising=False)
            for name, value in variables.items():
                patch.setenv(name, value)
            with JobProgress("jobs", [1.0]) as progress:
                progress.tell("a message")
            assert [*module.tracked(range(3), "[red]steps\n")] == [0, 1, 2]
        assert ("\x1b" in stream.getvalue()) == bars and "a message" in stream.getvalue()
        assert (r"[red]steps\n" in stream.getvalue()) == bars


class Failing(io.StringIO):
    """A stream on a full disk, or without a reader."""

    def __init__(self, number):
        super().__init__()
        self.number = number

    def write(self, text):
        raise OSError(self.number, os.strerror(self.number))  # a BrokenPipeError where it is EPIPE


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EPIPE])
@pytest.mark.parametrize("quiet", [False, True])
def test_a_failing_stderr_stops_no_work(number, quiet, monkeypatch):
    monkeypatch.setattr("sys.stderr", Failing(number))
    with JobProgress("jobs", [1.0], quiet) as progress:
        progress.tell("a message")
        progress.show(queue.Queue())
    assert exit_status(lambda: notice("unheard")) == 0


def test_a_terminal_that_goes_during_the_work_stops_none(monkeypatch):
    stream = io.StringIO()
    stream.isatty = lambda: True
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    with JobProgress("jobs", [1.0]) as progress:
        stream.write = Failing(errno.EIO).write
        progress.tell("a message")
        progress.show(queue.Queue())


def test_messages_are_shown_in_quiet_too(capfd):
    for quiet in (False, True):
        with JobProgress("three cohorts", [7200.0], quiet) as progress:
            progress.show(reports_of((0, 0.0, "a robot was stopped")))
        shown = capfd.readouterr().err
        assert "a robot was stopped" in shown
        assert ("three cohorts, 2 robot-hours" in shown) != quiet


def test_no_character_controls_the_terminal(capfd):
    for text, shown in (
        ("a[/]b [red]c", "a[/]b [red]c"),
        ("\x1b[2J\x07\r\n", r"\x1b[2J\x07\r\n"),
        ("a\u202eb\u2028c", r"a\u202eb\u2028c"),
        ("runs/\udcff", r"runs/\udcff"),
        ("10 µs – 20 µs", "10 µs – 20 µs"),
    ):
        assert printable(text) == shown
        notice(text)
        with JobProgress(text, [1.0]) as progress:
            progress.tell(text)
        out, err = capfd.readouterr()
        lines = err.splitlines()
        assert out == "" and lines[0] == f"musebot: {shown}" and shown in lines
        assert f"musebot: {shown}, 0.00028 robot-hours" in lines


def test_a_sentence_has_a_bounded_length_and_a_page_has_none():
    assert len(printable("9" * 5000)) < 2100
    assert printable("9\n" * 5000, lines=True) == "9\n" * 5000


def test_the_exit_status_follows_the_cause_and_not_the_type_of_an_error(capsys):
    def failing(error):
        def fail():
            raise error

        return fail

    for name in "EISDIR ENOTDIR ENAMETOOLONG ELOOP ENOSPC EIO EACCES EROFS".split():
        error = OSError(getattr(errno, name), "so it is", "runs\n")
        bad_path = name in ("EISDIR", "ENOTDIR", "ENAMETOOLONG", "ELOOP")
        assert exit_status(failing(error)) == (2 if bad_path else 1)
        assert len(capsys.readouterr().err.splitlines()) == 1
    assert exit_status(failing(MemoryError())) == 1
    assert capsys.readouterr().err == "musebot: there is not enough memory\n"
