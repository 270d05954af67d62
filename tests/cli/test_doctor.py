"""The doctor's report."""

import io
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import mujoco
import pytest
from packaging.requirements import Requirement

import musebot
from musebot import tasks
from musebot.protocols.cli import doctor
from musebot.protocols.cli import parser as cli

PROJECT = tomllib.loads((Path(musebot.__file__).parent / "pyproject.toml").read_text())["project"]
LINES = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["brain"]]
REQUIREMENTS = {
    needed.name: f"{needed.name}{needed.specifier}"
    for needed in map(Requirement, LINES)
    if needed.marker is None or needed.marker.evaluate()
}
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="EGL is Linux's")


def package(line):
    """Returns what the doctor finds of a requirement."""
    [probe] = doctor.package_probes([line]).values()
    return probe()


def refused(probe):
    """Returns the problem that a probe reports."""
    with pytest.raises(doctor.Missing) as caught:
        probe()
    return caught.value


def test_command_exits_with_0_exactly_if_nothing_is_missing_and_prints_ascii(monkeypatch):
    out = io.TextIOWrapper(io.BytesIO(), encoding="ascii", errors="strict")
    monkeypatch.setattr(sys, "stdout", out)
    status = cli.main(["doctor"])
    out.seek(0)
    printed = out.read()
    assert printed.isascii() and status == ("MISSING" in printed)
    for name in doctor.all_probes():
        assert name in printed
    assert mujoco.__version__ in printed


def test_what_musebot_requires_is_checked_and_other_extras_are_not(monkeypatch):
    found = set(doctor.package_probes(metadata.requires("musebot")))
    assert found == set(REQUIREMENTS) | set(doctor._OPTIONAL)
    lines = ["numpy>=2", "rare; extra == 'cluster'", "old; python_version < '3.2'"]
    lines += ["tomli; python_version >= '3.2'", "scipy; extra == 'brain'"]
    assert list(doctor.package_probes(lines)) == ["numpy", "tomli", "scipy"]
    monkeypatch.setattr(doctor.importlib.util, "find_spec", lambda name: None)  # without torch
    assert list(doctor.package_probes(lines)) == ["numpy", "tomli"]


@pytest.mark.parametrize(
    ("line", "sentence", "remedy"),
    [
        ("no-such-package[fast]>=2,<3", "not installed", "no-such-package[fast]<3,>=2"),
        ("numpy>=999", "version must be >=999, got ", "numpy>=999"),
    ],
)
def test_a_missing_package_ends_the_report_with_its_remedy(line, sentence, remedy, capsys):
    assert doctor.report(doctor.package_probes(["scipy", line])) == 1
    printed = capsys.readouterr().out
    assert sentence in printed and f"Remedy: pip install '{remedy}'\n" in printed
    assert "scipy: " not in printed


def test_optional_packages_are_reported_and_never_missing(monkeypatch, capsys):
    probes = {name: doctor.all_probes()[name] for name in ("ray", "gymnasium")}
    monkeypatch.setattr(metadata, "version", lambda name: "0.29.1")
    assert "got 0.29.1" in str(refused(probes["gymnasium"]))
    assert doctor.report(probes) == 0 and "WARNING" in capsys.readouterr().out
    monkeypatch.setattr(metadata, "version", Mock(side_effect=metadata.PackageNotFoundError))
    assert doctor.report(probes) == 0
    printed = capsys.readouterr().out
    assert "musebot[cluster]" in printed and "musebot[gym]" in printed


def test_a_mujoco_that_breaks_dm_control_or_an_arena_is_missing(monkeypatch):
    fail = Mock(side_effect=AttributeError("'MjModel' object has no attribute 'flex_vertedge'"))
    with monkeypatch.context() as patch:
        patch.setattr(tasks, "load", fail)
        problem = refused(doctor.all_probes()["physics"])
    assert "does not compile (AttributeError: 'MjModel' object has no" in str(problem)
    monkeypatch.setattr(mujoco, "__version__", "4.0.0")
    refused(doctor.all_probes()["physics"])


@LINUX
def test_a_driver_that_fails_crashes_or_hangs_is_missing(monkeypatch):
    for status, stderr, text in (
        (-11, "", "the driver crashed (signal 11)"),
        (1, "noise\nno EGL here\n", "no EGL here"),
        (1, "", "no reason given"),
    ):
        done = SimpleNamespace(returncode=status, stderr=stderr)
        monkeypatch.setattr(subprocess, "run", lambda *_, done=done, **__: done)
        problem = refused(doctor.all_probes()["EGL"])
        assert str(problem) == text and "libegl1" in problem.remedy
    hang = Mock(side_effect=subprocess.TimeoutExpired("probe", 1))
    monkeypatch.setattr(subprocess, "run", hang)
    assert "no image within" in str(refused(doctor.all_probes()["EGL"]))
    assert hang.call_args.kwargs["timeout"] > 0
