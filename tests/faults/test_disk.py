"""Every call on the disk fails in turn: the same bytes in the end, or one sentence."""

import builtins
import collections
import contextlib
import errno
import fcntl
import io
import math
import os
import random
import re
import shutil

import pytest
from helpers import files_below
from matplotlib.figure import Figure

from musebot.protocols.cli import parser as cli
from musebot.protocols.pages import film, measured_behaviour, report
from musebot.protocols.runs import jobs
from musebot.protocols.runs.run_files import RESULTS_FILE, read_run

GROWING = {"mkdir", "create", "write", "fsync", "replace"}  # what a full disk refuses
MODES = (errno.ENOSPC, errno.EIO, errno.EACCES, "full", "dead")
PROGRESS = re.compile(r"robot-hours$|^musebot: [\d.]+ %, ")  # where stderr is no terminal
SHARE = float(os.environ.get("MUSEBOT_NIGHT_SHARE", "1"))  # of all failures, drawn at random


class Dead(BaseException):
    """The process was killed: nothing catches this, and nothing is cleaned up."""


class Disk:
    """Counts the `calls` on the files below a folder, and lets the n-th one fail.

    The whole files at the failure are `left`.
    """

    PATHS = ("mkdir", "listdir", "replace", "rmdir", "unlink")

    def __init__(self, folder, fails_at=10**9, mode=errno.EIO):
        self.calls, self.left = [], None
        self._folder, self._fails_at, self._mode = folder, fails_at, mode

    @contextlib.contextmanager
    def mounted(self):
        with pytest.MonkeyPatch.context() as patch:
            for name in self.PATHS:
                patch.setattr(os, name, self._call(name, getattr(os, name)))
            patch.setattr(os, "open", self._call("open", os.open))
            patch.setattr(os, "fsync", lambda handle: self._count("fsync"))  # for speed
            patch.setattr(fcntl, "flock", self._call("flock", fcntl.flock, always=True))
            opened = self._opened(io.open)
            for place in (io, builtins):
                patch.setattr(place, "open", opened)
            yield self

    def _call(self, name, real, always=False):
        def call(*args, **kwargs):
            if always or str(args[0]).startswith(str(self._folder)):
                self._count(name)
            return real(*args, **kwargs)

        return call

    def _opened(self, real):
        def opened(path, mode="r", *args, **kwargs):
            if not str(path).startswith(str(self._folder)):
                return real(path, mode, *args, **kwargs)
            self._count("create" if "x" in mode else "read")
            file = real(path, mode, *args, **kwargs)
            if "x" in mode:
                write = file.write
                file = Writer(file, lambda content: self._written(write, content))
            return file

        return opened

    def _written(self, write, content):
        if len(self.calls) == self._fails_at and self._mode != "full":
            write(content[: len(content) // 2])  # a part is on the disk
        self._count("write")
        return write(content)

    def _count(self, name):
        number = len(self.calls)
        self.calls.append(name)
        if number < self._fails_at:
            return
        if number == self._fails_at:
            self.left = {str(p.relative_to(self._folder)) for p in self._folder.rglob("[!.]*")}
        if self._mode == "dead":
            raise Dead
        if self._mode == "full":
            if name in GROWING:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        elif number == self._fails_at:
            raise OSError(self._mode, os.strerror(self._mode))


class Writer:
    """A file that is written through a function."""

    def __init__(self, file, write):
        self._file, self.write, self.flush, self.fileno = file, write, file.flush, file.fileno

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._file.close()


# What is done: words of commands, first those that prepare OUT

RUN = "run OUT --life wall_avoidance --proposer fixed creative --set cohort_size=1 "
RUN += "--time-scale 0.0001 --save-every 1e-9 --robots {} --body {}"
TUNE = "benchmark tune OUT --agent q_learner --robots 2 --time-scale 0.0005 --trials 2 --kept 1"
CASES = {
    "run": ([], [RUN.format(2, "kinematic")]),
    "larger": ([RUN.format(1, "mujoco")], [RUN.format(2, "mujoco")]),
    "tune": ([], [TUNE]),
    "report": ([RUN.format(2, "kinematic")], ["report OUT"]),
    "tables": ([RUN.format(2, "kinematic")], ["tables OUT", "tables OUT --compare OUT"]),
}


@pytest.fixture
def quick(monkeypatch, commands_in_process):
    """Checkpoints after four steps, empty figures, no films, robots observed once."""
    seen = []

    def observe(run):
        seen.extend([] if seen else [real(run)])
        return seen[0]

    def figures(run, behaviour):
        for name in ("first", "second"):
            yield name, Figure()

    real = measured_behaviour.observe
    monkeypatch.setattr(measured_behaviour, "observe", observe)
    monkeypatch.setattr(jobs, "_CHUNK", 4)
    monkeypatch.setattr(report, "_figures", figures)
    monkeypatch.setattr(film, "film", lambda episode, path, **_: path.write_bytes(b"film"))
    monkeypatch.setattr(Figure, "savefig", lambda self, file, **_: file.write(b"figure"))


class Sweep:
    """Does a case again and again, each time with another failure; counts how they end."""

    def __init__(self, case, folder, capsys):
        self.ends = collections.Counter()
        prepare, self._lines = CASES[case]
        self._folder, self._capsys = folder, capsys
        (folder / "before").mkdir()
        for line in prepare:
            assert cli.main(line.replace("OUT", str(folder / "before")).split()) == 0
        out = self._fresh()
        whole, status, self._said = self._done(out)
        assert status == 0, self._said
        self.calls, self._whole = whole.calls, files_below(out, folders=True)

    def _fresh(self):
        out = self._folder / "out"  # always the same: a report has the name of its folder
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(self._folder / "before", out)
        return out

    def _done(self, out, *failure):
        """Does the case once; returns the disk, the exit status and what was printed."""
        self._capsys.readouterr()
        with Disk(out, *failure).mounted() as disk:
            status = 0
            for line in self._lines:
                if status == 0:
                    status = None  # that of a killed command
                    with contextlib.suppress(Dead):
                        status = cli.main(line.replace("OUT", str(out)).split())
        return disk, status, self._capsys.readouterr()

    def fails(self, number, mode, again=()):
        """Checks one failure: what is said, what stays, and what a repetition leaves.

        The repetition can have a failure of its own, `again`, and is then repeated.
        """
        where = f"{mode} at call {number}, {self.calls[number]}"
        out = self._fresh()
        held = {path.parent for path in out.rglob(RESULTS_FILE)}
        disk, status, (printed, said) = self._done(out, number, mode)
        assert disk.left is not None, f"{where}: nothing failed"
        self.ends["killed" if status is None else f"status {status}"] += 1
        if status == 0:  # no harm; an empty folder may have stayed, which the next call removes
            whole = {path: content for path, content in self._whole.items() if content is not None}
            assert files_below(out) == whole, where
            assert printed == self._said.out, where
        elif status is not None:
            sentences = re.findall("^musebot: .*", said, re.MULTILINE)
            sentences = [line for line in sentences if not PROGRESS.search(line)]
            assert len(sentences) == 1 and "Traceback" not in said, f"{where}: {said}"
            assert "None" not in said, f"{where}: {said}"
        for folder in held:  # what was complete is still there
            assert read_run(folder).results, where
        for name in disk.left:  # or has been replaced by the end
            if name.endswith(".finished.safetensors"):
                end = (out / name).parents[1] / RESULTS_FILE
                assert (out / name).is_file() or end.is_file(), f"{name} is gone: {where}"
        if again:
            self._done(out, *again)
        _, status, (printed, said) = self._done(out)
        assert status == 0, f"after {where}: {said}"
        assert files_below(out, folders=True) == self._whole, f"after {where}"
        assert printed == self._said.out, f"after {where}"


@pytest.fixture
def sweep(tmp_path, capsys, quick):
    return lambda case: Sweep(case, tmp_path, capsys)


@pytest.mark.parametrize("case", CASES)
def test_a_failing_call_leaves_the_same_bytes_in_the_end_or_one_sentence(case, sweep):
    swept, draw = sweep(case), random.Random(case)
    assert len(swept.calls) >= 4
    for mode in (*MODES, *MODES):
        swept.fails(draw.randrange(len(swept.calls)), mode)
    assert swept.ends["killed"] and any(end > "status 0" for end in swept.ends)


@pytest.mark.night
@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_every_failing_call_leaves_the_same_bytes_in_the_end_or_one_sentence(case, sweep):
    swept, draw = sweep(case), random.Random(case)
    failures = [(number, mode) for mode in MODES for number in range(len(swept.calls))]
    chosen = draw.sample(failures, math.ceil(SHARE * len(failures)))
    for number, mode in sorted(chosen, key=str):
        again = draw.randrange(len(swept.calls)), draw.choice(MODES)
        swept.fails(number, mode, again if draw.random() < 0.5 else ())
    print(f"\n{case}: {len(swept.calls)} calls, {dict(collections.Counter(swept.calls))}")
    print(f"{case}: {len(chosen)} of {len(failures)} failures, {dict(swept.ends)}")
