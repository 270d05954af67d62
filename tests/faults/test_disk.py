"""Every call on the disk fails in turn: the same bytes in the end, or one sentence."""

import builtins
import collections
import contextlib
import errno
import fcntl
import io
import itertools
import math
import os
import random
import re
import shutil
from unittest import mock

import pytest
from matplotlib.figure import Figure

from musebot.protocols.cli.run import RunCommand
from musebot.protocols.cli.tables import TablesCommand
from musebot.protocols.compare.study import conduct
from musebot.protocols.exit_status import exit_status
from musebot.protocols.lives import jobs
from musebot.protocols.lives.run_files import ROBOTS_FILE, read_results, read_run
from musebot.protocols.pages import film as films
from musebot.protocols.pages import measured_behaviour, report, tables
from musebot.protocols.storage import write_atomically
from musebot.protocols.studies.ablation import Ablation

ERRORS = (errno.ENOSPC, errno.EIO, errno.EACCES)
GROWING = {"mkdir", "create", "write", "fsync", "replace"}  # what a full disk refuses
PROGRESS = re.compile(r"robot-hours$|^musebot: [\d.]+ %, ")  # where stderr is no terminal
SHARE = float(os.environ.get("MUSEBOT_NIGHT_SHARE", "1"))  # of all failures, drawn at random
MODES = (*ERRORS, "full", "short", "dead")


class Dead(BaseException):
    """The process was killed: nothing catches this, and nothing is cleaned up."""


class Disk:
    """Counts the calls on the files below a folder, and lets the n-th one fail.

    Attributes:
      calls: Names of the calls made.
      left: Names of the whole files at the failure.
    """

    PATHS = ("mkdir", "listdir", "replace", "rmdir", "unlink")

    def __init__(self, folder, fails_at=10**9, mode=errno.EIO):
        self.calls, self.left = [], None
        self._folder, self._fails_at, self._mode = folder, fails_at, mode
        self._handles = set()

    @contextlib.contextmanager
    def mounted(self):
        with pytest.MonkeyPatch.context() as patch:
            for name in self.PATHS:
                patch.setattr(os, name, self._call(name, getattr(os, name)))
            patch.setattr(os, "open", self._call("open", os.open))
            patch.setattr(os, "write", self._call("write", os.write))
            patch.setattr(os, "fsync", self._call("fsync", lambda handle: None))  # for speed
            patch.setattr(fcntl, "flock", self._call("flock", fcntl.flock))
            patch.setattr(os, "close", self._closed(os.close))
            reading = self._call("read", io.open)
            patch.setattr(io, "open", reading)
            patch.setattr(builtins, "open", reading)
            yield self

    def _ours(self, args, kwargs):
        if kwargs.keys() & {"dir_fd", "src_dir_fd"}:
            return True
        first = args[0]
        if isinstance(first, int):
            return first in self._handles
        return str(first).startswith(str(self._folder))

    def _closed(self, real):
        def close(handle):
            self._handles.discard(handle)
            real(handle)

        return close

    def _call(self, name, real):
        def call(*args, **kwargs):
            if not self._ours(args, kwargs):
                return real(*args, **kwargs)
            own = "create" if name == "open" and args[1] & os.O_CREAT else name
            number = len(self.calls)
            self.calls.append(own)
            if number >= self._fails_at and (done := self._fail(own, number, args, real)):
                return done
            result = real(*args, **kwargs)
            if name == "open":
                self._handles.add(result)
            return result

        return call

    def _fail(self, name, number, args, real):
        """Raises the error of a call; returns the bytes that a short write has written."""
        now = number == self._fails_at
        if now:
            self.left = whole_files(self._folder)
        if self._mode == "short":
            return real(args[0], args[1][: len(args[1]) // 2]) if now and name == "write" else None
        if self._mode == "dead":
            if now and name == "write":
                real(args[0], args[1][: len(args[1]) // 2])
            raise Dead
        if self._mode == "full":
            if name in GROWING:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        elif now:
            raise OSError(self._mode, os.strerror(self._mode))
        return None


def whole_files(folder):
    """Returns the names of the files below a folder, without drafts."""
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.suffix != ".musebot"}


# What is done


class Run:
    """A run with two conditions; `before` robots are finished already."""

    def __init__(self, body, before):
        self.before, self._body = before, body

    def work(self, out, executor, robots=2):
        settings = {"task": ("wall_avoidance",), "proposer": ("fixed", "creative")}
        command = RunCommand(
            out, **settings, robots=robots, cohort_size=1, time_scale=0.0001, body=self._body,
            save_every=1e-9,
        )  # fmt: skip
        command()

    def prepare(self, out, executor):
        if self.before:
            self.work(out, executor, self.before)


class TwoRuns(Ablation):
    """The study of the ingredients, with two runs only."""

    def variants(self):
        return super().variants()[:2]


class AblationOfTwo:
    """A study of two runs."""

    def work(self, out, executor):
        options = {"robots": 1, "task": ("wall_avoidance",), "body": "kinematic"}
        study = TwoRuns(**options, time_scale=0.0001)
        conduct(study, out, executor)

    def prepare(self, out, executor):
        del out, executor


class Report:
    """The page of a run, with empty figures and an empty film."""

    def work(self, out, executor):
        del executor
        with mock.patch.object(films, "film", film):
            report.report(read_run(out), out, None)

    def prepare(self, out, executor):
        Run("kinematic", 0).work(out, executor)


class Tables(Report):
    """The tables of a run, which change nothing."""

    def work(self, out, executor):
        TablesCommand(out)()
        TablesCommand(out, json=True)()


CASES = {
    "run": Run("kinematic", 0),
    "larger": Run("mujoco", 1),
    "study": AblationOfTwo(),
    "report": Report(),
    "tables": Tables(),
}


def film(episode, output, *, seconds, speed):
    write_atomically(output, b"film")


def figures(run, behaviour):
    for name in ("first", "second"):
        yield name, Figure()


@pytest.fixture
def quick(monkeypatch, commands_in_process):
    """Checkpoints after four steps, empty figures, robots observed and tables made once."""
    seen = []

    def observe(run):
        seen.extend([] if seen else [real(run)])
        return seen[0]

    def markdown(run, *args):
        """Makes the tables of equal rows once: they take a fifth of the time."""
        rows = [part.robots for part in run.results.values()]
        key = repr((run.name, run.experiment, rows, args))
        if key not in texts:
            texts[key] = made(run, *args)
        return texts[key]

    real, made, texts = measured_behaviour.observe, tables.markdown, {}
    monkeypatch.setattr(tables, "markdown", markdown)
    monkeypatch.setattr(measured_behaviour, "observe", observe)
    monkeypatch.setattr(jobs, "_CHUNK", 4)
    monkeypatch.setattr(report, "_figures", figures)
    monkeypatch.setattr(Figure, "savefig", lambda self, file, **_: file.write(b"figure"))


class Sweep:
    """Does a case again and again, each time with another failure.

    Attributes:
      ends: How often a failure ended in what.
    """

    def __init__(self, case, folder, executor, capsys):
        self.ends = collections.Counter()
        self._case, self._folder, self._executor, self._capsys = case, folder, executor, capsys
        case.prepare(self._made("before"), executor())
        out = self._fresh("out")  # a report has the name of its folder
        whole, status, self._said = self._done(out)
        assert status == 0
        self.calls, self._whole = whole.calls, files(out)
        shutil.rmtree(out)

    def _made(self, name):
        (self._folder / name).mkdir()
        return self._folder / name

    def _fresh(self, name):
        out = self._folder / name
        shutil.copytree(self._folder / "before", out)
        return out

    def _done(self, out, *failure):
        """Does the case once; returns the disk, the exit status and what was printed."""
        self._capsys.readouterr()
        with Disk(out, *failure).mounted() as disk:
            status = None
            with contextlib.suppress(Dead):
                status = exit_status(lambda: self._case.work(out, self._executor()), check=False)
        out, err = self._capsys.readouterr()
        return disk, status, (out, err)

    def fails(self, number, mode, again=()):
        """Checks one failure: what is said, what stays, and what a repetition leaves.

        Args:
          number: Call that fails.
          mode: How it fails.
          again: Number and mode of a failure of the repetition, which is then repeated.
        """
        name = self.calls[number] if number < len(self.calls) else ""
        where = f"{mode} at call {number}, {name}"
        out = self._fresh("out")
        before = files(out)
        disk, status, (printed, said) = self._done(out, number, mode)
        assert disk.left is not None, f"{where}: nothing failed"
        if status is None:
            self.ends["killed"] += 1
        elif status == 0:
            self.ends["no harm"] += 1
            # An empty folder may have stayed, which the next call removes.
            left = {name: content for name, content in files(out).items() if content is not None}
            assert left == {n: c for n, c in self._whole.items() if c is not None}, where
            assert printed == self._said[0], where
        else:
            self.ends[f"status {status}"] += 1
            sentences = re.findall("^musebot: .*", said, re.MULTILINE)
            sentences = [line for line in sentences if not PROGRESS.search(line)]
            assert len(sentences) == 1 and "Traceback" not in said, f"{where}: {said}"
            assert "None" not in said, f"{where}: {said}"
            self.stays(out, before, disk.left, where)
        if again:
            self._done(out, *again)
        _, status, (printed, said) = self._done(out)
        assert status == 0, f"after {where}: {said}"
        assert files(out) == self._whole, f"after {where}"
        assert printed == self._said[0], f"after {where}"
        shutil.rmtree(out)

    def stays(self, out, before, left, where):
        """Checks that what was complete is still there, or has been replaced by the end."""
        for folder in {(out / name).parent for name in before if name.endswith(ROBOTS_FILE)}:
            assert read_results(folder), where
        finished = {name for name in left if name.endswith(".finished.safetensors")}
        for name in finished:
            done = (out / name).parents[1] / ROBOTS_FILE
            assert (out / name).is_file() or done.is_file(), f"{name} is gone: {where}"


def files(folder):
    """Returns the content of every file below a folder, and the names of empty folders."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }


@pytest.fixture
def sweep(tmp_path, in_process, capsys, quick):
    return lambda case: Sweep(CASES[case], tmp_path, in_process, capsys)


def failing(calls, mode):
    """Returns the numbers of the calls that can fail in a mode: only a write is cut short."""
    return [number for number, call in enumerate(calls) if mode != "short" or call == "write"]


@pytest.mark.parametrize(("case", "count"), [(case, 10) for case in CASES])
def test_a_failing_call_leaves_the_same_bytes_in_the_end_or_one_sentence(case, count, sweep):
    swept = sweep(case)
    assert len(swept.calls) >= 10
    draw = random.Random(case)
    for mode in itertools.islice(itertools.cycle(MODES), count):
        if numbers := failing(swept.calls, mode):
            swept.fails(draw.choice(numbers), mode)
    assert swept.ends["killed"] and any(end.startswith("status") for end in swept.ends)


@pytest.mark.night
@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_every_failing_call_leaves_the_same_bytes_in_the_end_or_one_sentence(case, sweep):
    swept, draw = sweep(case), random.Random(case)
    failures = [(number, mode) for mode in MODES for number in failing(swept.calls, mode)]
    chosen = sorted(draw.sample(failures, math.ceil(SHARE * len(failures))), key=str)
    for number, mode in chosen:
        again = draw.randrange(len(swept.calls)), draw.choice(MODES)
        swept.fails(number, mode, again if draw.random() < 0.5 else ())
    print(f"\n{case}: {len(swept.calls)} calls, {dict(collections.Counter(swept.calls))}")
    print(f"{case}: {len(chosen)} of {len(failures)} failures, {dict(swept.ends)}")
