"""The doctor's report."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import mujoco
import pytest

import musebot
from musebot import tasks
from musebot.protocols import doctor


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is drawn, and everything else is here."""
    monkeypatch.setitem(doctor._LOOKS, "EGL", lambda: "a picture")


def finding(name: str) -> doctor.Finding:
    return next(found for found in doctor.examine() if found.name == name)


def test_command_exits_0_exactly_where_nothing_is_missing(tmp_path) -> None:
    command = [sys.executable, "-m", "musebot", "doctor"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode in (0, 1), done.stderr
    assert (done.returncode == 1) == ("MISSING" in done.stdout)
    for name in doctor._LOOKS:
        assert name in done.stdout


def test_sound_machine_is_called_sound(quick: None, capsys: pytest.CaptureFixture) -> None:
    assert doctor.report() == 0
    printed = capsys.readouterr().out
    assert "MISSING" not in printed
    assert "Everything that musebot needs is here." in printed
    assert mujoco.__version__ in printed


def requirements() -> dict[str, str]:
    """What pyproject.toml asks for, by the name of the package."""
    project = tomllib.loads((Path(musebot.__file__).parent / "pyproject.toml").read_text())
    return {re.split("[<>=]", line)[0]: line for line in project["project"]["dependencies"]}


@pytest.mark.parametrize("package", requirements())
def test_missing_package_is_named_with_the_command_that_gets_it(
    quick: None, monkeypatch: pytest.MonkeyPatch, package: str
) -> None:
    module = {
        "dm-control": "dm_control.suite.base",
        "matplotlib": "matplotlib.figure",
        "pillow": "PIL.Image",
        "safetensors": "safetensors.numpy",
        "scipy": "scipy.stats",
    }.get(package, package.replace("-", "_"))
    monkeypatch.setitem(sys.modules, module, None)
    found = finding(package)
    assert not found.good
    assert "cannot be imported" in found.text
    assert found.remedy == f"pip install '{requirements()[package]}'"


def test_what_is_missing_ends_the_report_with_its_remedy(
    quick: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    assert doctor.report() == 1
    printed = capsys.readouterr().out
    assert "imageio-ffmpeg is missing; to get it: pip install 'imageio-ffmpeg'" in printed


def test_dm_control_that_cannot_read_the_arena_is_told(
    quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise AttributeError("'MjModel' object has no attribute 'flex_vertedge'")

    monkeypatch.setattr(tasks, "load", fail)
    found = finding("physics")
    assert not found.good
    assert "does not compile (AttributeError: 'MjModel' object has no" in found.text


def test_ray_is_told_and_never_missing(quick: None, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(name: str) -> str:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(doctor.metadata, "version", lambda name: "2.9")
    assert finding("ray") == doctor.Finding("ray", "2.9")
    monkeypatch.setattr(doctor, "_LOOKS", {"ray": doctor._ray})
    monkeypatch.setattr(doctor.metadata, "version", none)
    found = finding("ray")
    assert found.good
    assert "musebot[cluster]" in found.text


def test_mujoco_that_dm_control_breaks_with_is_missing(
    quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mujoco, "__version__", "4.0.0")
    found = finding("mujoco")
    assert not found.good
    assert "got 4.0.0" in found.text
    assert found.remedy == "pip install 'mujoco>=3.17,<3.18'"
    assert not finding("physics").good


@pytest.mark.parametrize(
    ("done", "text"),
    [
        (SimpleNamespace(returncode=-11, stderr=""), "the driver crashed (signal 11)"),
        (SimpleNamespace(returncode=1, stderr="noise\nno EGL here\n"), "no EGL here"),
        (SimpleNamespace(returncode=1, stderr=""), "no reason given"),
    ],
)
@pytest.mark.skipif(sys.platform != "linux", reason="EGL is Linux's")
def test_driver_that_fails_or_crashes_is_survived(
    monkeypatch: pytest.MonkeyPatch, done: SimpleNamespace, text: str
) -> None:
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: done)
    found = finding("EGL")
    assert (found.good, found.text) == (False, text)
    assert found.remedy == "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri"


@pytest.mark.skipif(sys.platform != "linux", reason="EGL is Linux's")
def test_driver_that_hangs_is_not_waited_for_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    def hang(*_: object, timeout: float, **__: object) -> None:
        raise subprocess.TimeoutExpired("probe", timeout)

    monkeypatch.setattr(subprocess, "run", hang)
    found = finding("EGL")
    assert not found.good
    assert found.text == f"no picture within {doctor._PROBE_SECONDS} s"


def test_display_is_told_and_never_missing(quick: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("DISPLAY", ":7")
    assert "DISPLAY=:7" in finding("display").text
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    found = finding("display")
    assert found.good
    assert "none" in found.text
