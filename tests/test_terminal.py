"""Progress of several jobs together: how far they are, how fast, and what they say."""

import errno
import io
import queue
import time

from musebot.protocols import progress as module
from musebot.protocols.exit_status import exit_status
from musebot.protocols.progress import JobProgress
from musebot.protocols.terminal import notice, printable, say


def later(progress, seconds, monkeypatch):
    """Lets a progress display believe that some seconds have passed."""
    now = time.monotonic() + seconds
    monkeypatch.setattr(module.time, "monotonic", lambda: now)


def test_a_log_gets_lines_with_robots_speed_and_time_left(capfd, monkeypatch):
    reports = queue.Queue()
    with JobProgress("two cohorts", [3600.0, 3600.0], robots=[5, 5]) as progress:
        progress.show(reports)
        progress._began -= 100
        reports.put((0, 0.0, ""))
        reports.put((1, 0.0, ""))
        reports.put((0, 3600.0, ""))
        reports.put((1, 2000.0, ""))
        progress.show(reports)  # within the first five seconds
        assert len(capfd.readouterr().err.splitlines()) == 1
        later(progress, 5, monkeypatch)
        progress._began += 5
        progress.show(reports)
        progress.show(reports)
        (line,) = capfd.readouterr().err.splitlines()
    assert line == "musebot: 77.8 %, 5 of 10 robots done, 56 x real time, 0:00:29 left"


def test_the_last_line_of_a_log_is_not_printed_twice(capfd, monkeypatch):
    reports = queue.Queue()
    with JobProgress("two cohorts", [3600.0, 3600.0]) as progress:
        for number, done in ((0, 3600.0), (1, 3600.0)):
            reports.put((number, done, ""))
            later(progress, 60 + number, monkeypatch)
            progress.show(reports)
    lines = capfd.readouterr().err.splitlines()
    assert [line.split(",")[0] for line in lines[1:]] == ["musebot: 50.0 %", "musebot: 100.0 %"]
    with JobProgress("two cohorts", [3600.0]) as progress:
        reports.put((0, 3600.0, ""))
        progress.show(reports)
    assert capfd.readouterr().err.splitlines()[1:] == ["musebot: 100.0 %, 1 of 1 jobs done"]


def test_jobs_are_weighed_by_cost_and_what_an_earlier_call_did_is_not_this_ones_speed():
    reports = queue.Queue()
    with JobProgress("one cohort", [4000.0, 1000.0], quiet=True) as progress:
        for number, done in ((0, 3000.0), (1, 500.0), (1, 1000.0)):
            reports.put((number, done, ""))
        progress.show(reports)
        assert progress.line().startswith("80.0 %, 1 of 2 jobs done, ")
    with JobProgress("one cohort", [4000.0], quiet=True) as progress:
        reports.put((0, 3000.0, ""))
        progress.show(reports)
        assert progress.line() == "75.0 %, 0 of 1 jobs done"
        progress._began -= 10  # ten seconds later
        reports.put((0, 3100.0, ""))
        progress.show(reports)
        assert progress.line() == "77.5 %, 0 of 1 jobs done, 10 x real time, 0:01:30 left"


def test_lines_of_a_log_come_soon_at_first_and_then_a_minute_apart(monkeypatch):
    now = 0.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    pace, due = module._Pace(), []
    for second in range(300):
        now = float(second)
        if pace.due():
            due.append(second)
    assert due == [5, 15, 35, 75, 135, 195, 255]


def test_steps_of_one_process_leave_lines_with_the_time_left(capfd, monkeypatch):
    now = 0.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    with module.StepProgress("watching\n", 40) as progress:
        for _ in range(8):
            now += 1
            progress.advance()
    lines = capfd.readouterr().err.splitlines()
    assert lines == [r"musebot: watching\n: 12.5 %, 0:00:35 left"]
    with module.StepProgress("nothing", 0):
        pass
    assert capfd.readouterr().err == ""


def test_bars_are_drawn_on_terminals_only(monkeypatch):
    for tty, variables, bars in (
        (False, {}, False),
        (False, {"FORCE_COLOR": "1"}, False),
        (True, {"TERM": "dumb"}, False),
        (True, {"TERM": "xterm"}, True),
    ):
        with monkeypatch.context() as patch:
            check_bars(patch, tty, variables, bars)


def check_bars(monkeypatch, tty, variables, bars):
    stream = io.StringIO()
    stream.isatty = lambda: tty
    monkeypatch.setattr("sys.stderr", stream)
    for name in ("TERM", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert module._draws_bars() == bars
    with JobProgress("jobs", [1.0]) as progress:
        progress.tell("a message")
    assert ("\x1b" in stream.getvalue()) == bars and "a message" in stream.getvalue()


class Full(io.StringIO):
    """A stream on a full disk."""

    def write(self, text):
        raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_under_stderr_stops_no_work(monkeypatch):
    monkeypatch.setattr("sys.stderr", Full())
    with JobProgress("jobs", [1.0]) as progress:
        progress.tell("a message")
        progress.show(queue.Queue())
    with module.StepProgress("steps", 1) as steps:
        steps._pace._wait = 0.0
        steps.advance()
    assert exit_status(lambda: notice("unheard"), check=False) == 0


def test_messages_are_shown_above_the_bar_and_in_quiet_too(capfd):
    for quiet in (False, True):
        reports = queue.Queue()
        with JobProgress("three cohorts", [7200.0], quiet) as progress:
            reports.put((0, 0.0, "a robot was stopped"))
            progress.show(reports)
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


def test_a_stream_without_the_characters_gets_escapes():
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    say("10 µs", stream)
    stream.flush()
    assert stream.buffer.getvalue() == b"10 \\xb5s\n"


def test_the_exit_status_follows_the_cause_and_not_the_type_of_an_error(capsys):
    def failing(error):
        def fail():
            raise error

        return fail

    for name in "EISDIR ENOTDIR ENAMETOOLONG ELOOP ENOSPC EIO EACCES EROFS".split():
        error = OSError(getattr(errno, name), "so it is", "runs\n")
        bad_path = name in ("EISDIR", "ENOTDIR", "ENAMETOOLONG", "ELOOP")
        assert exit_status(failing(error), check=False) == (2 if bad_path else 1)
        assert len(capsys.readouterr().err.splitlines()) == 1
    assert exit_status(failing(MemoryError()), check=False) == 1
    assert capsys.readouterr().err == "musebot: there is not enough memory\n"
