"""The doctor's report."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import mujoco
import pytest
from packaging.requirements import Requirement

import musebot
from musebot import tasks
from musebot.protocols.cli import diagnosis as doctor

PROJECT = tomllib.loads((Path(musebot.__file__).parent / "pyproject.toml").read_text())["project"]
LINES = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["brain"]]
REQUIREMENTS = {
    needed.name: f"{needed.name}{needed.specifier}"
    for needed in map(Requirement, LINES)
    if needed.marker is None or needed.marker.evaluate()
}


def check(name: str) -> doctor.Check:
    [found] = doctor.examine({name: doctor.all_probes()[name]})
    return found


def package(line: str) -> doctor.Check:
    [found] = doctor.examine(doctor.package_probes([line]))
    return found


def test_command_exits_with_0_exactly_if_nothing_is_missing(tmp_path) -> None:
    command = [sys.executable, "-m", "musebot", "doctor"]
    # A locale without UTF-8, in which Python would not switch to UTF-8 by itself.
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, env={**os.environ, **plain}
    )
    assert "Traceback" not in done.stderr and done.stdout.isascii()
    assert done.returncode in (0, 1), done.stderr
    assert (done.returncode == 1) == ("MISSING" in done.stdout)
    for name in doctor.all_probes():
        assert name in done.stdout


def test_report_without_missing_packages_returns_0(capsys: pytest.CaptureFixture) -> None:
    probes = doctor.all_probes() | {"EGL": lambda: "an image"}
    assert doctor.report(probes) == 0
    printed = capsys.readouterr().out
    assert "MISSING" not in printed
    assert "Nothing that musebot requires is missing." in printed
    assert mujoco.__version__ in printed


def test_every_package_that_musebot_requires_is_checked() -> None:
    lines = metadata.requires("musebot") or []
    assert {"mujoco", "imageio", "torch", "tyro"} < REQUIREMENTS.keys()
    assert set(REQUIREMENTS) == set(doctor.package_probes(lines))
    assert set(REQUIREMENTS) < doctor.all_probes().keys()


def test_requirements_of_extras_and_of_other_platforms_are_not_checked() -> None:
    lines = ["numpy>=2", "ray; extra == 'cluster'", "old; python_version < '3.2'"]
    lines += ["tomli; python_version >= '3.2'", "torch; extra == 'brain'"]
    assert list(doctor.package_probes(lines)) == ["numpy", "tomli", "torch"]


@pytest.mark.parametrize("name", REQUIREMENTS)
def test_package_that_cannot_be_imported_has_a_remedy(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    module = doctor._MODULES.get(name, name.replace("-", "_"))
    monkeypatch.setitem(sys.modules, module, None)
    found = package(REQUIREMENTS[name])
    assert not found.passed
    assert "cannot be imported" in found.text
    specifier = Requirement(REQUIREMENTS[name]).specifier
    assert found.remedy == f"pip install '{name}{specifier}' --force-reinstall"


def test_packages_that_python_3_13_needs_are_imported_by_their_own_names() -> None:
    lines = [line.partition(";")[0] for line in PROJECT["dependencies"] if ">= '3.13'" in line]
    assert len(lines) == 11
    for line in lines:
        assert package(line).passed, line


@pytest.mark.parametrize("name", REQUIREMENTS)
def test_required_package_of_this_environment_passes(name: str) -> None:
    found = package(REQUIREMENTS[name])
    assert found.passed, found.text
    assert metadata.version(name) in found.text


def test_package_that_is_not_installed_has_a_remedy() -> None:
    found = package("no-such-package[fast]>=2,<3")
    assert (found.passed, found.text) == (False, "not installed")
    assert found.remedy == "pip install 'no-such-package[fast]<3,>=2'"


def test_package_of_another_version_has_a_remedy() -> None:
    found = package("numpy>=999")
    assert (found.passed, found.remedy) == (False, "pip install 'numpy>=999'")
    assert found.text == f"version must be >=999, got {metadata.version('numpy')}"


def test_missing_package_ends_the_report_with_its_remedy(capsys: pytest.CaptureFixture) -> None:
    assert doctor.report(doctor.package_probes(["numpy", "no-such-package"])) == 1
    printed = capsys.readouterr().out
    assert "no-such-package: not installed. Remedy: pip install 'no-such-package'\n" in printed
    assert "numpy: " not in printed


def test_musebot_that_is_not_installed_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(name: str) -> list[str]:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "requires", none)
    found = check("musebot")
    assert (found.passed, found.remedy) == (False, "pip install -e .")


def test_arena_that_does_not_compile_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise AttributeError("'MjModel' object has no attribute 'flex_vertedge'")

    monkeypatch.setattr(tasks, "load", fail)
    found = check("physics")
    assert not found.passed
    assert "does not compile (AttributeError: 'MjModel' object has no" in found.text


def test_optional_packages_are_reported_and_never_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(name: str) -> str:
        raise metadata.PackageNotFoundError(name)

    probes = doctor.all_probes()
    monkeypatch.setattr(metadata, "version", lambda name: "2.59.1")
    [found] = doctor.examine({"ray": probes["ray"]})
    assert found == doctor.Check("ray", "2.59.1")
    monkeypatch.setattr(metadata, "version", lambda name: "0.29.1")
    [found] = doctor.examine({"gymnasium": probes["gymnasium"]})
    assert found.passed and found.text.endswith(", got 0.29.1")
    assert found.remedy == "pip install 'musebot[gym]'"
    monkeypatch.setattr(metadata, "version", none)
    optional = list(doctor.examine({name: probes[name] for name in ("ray", "gymnasium")}))
    assert all(found.passed for found in optional)
    assert "musebot[cluster]" in optional[0].text
    assert "musebot[gym]" in optional[1].text


def test_mujoco_version_that_breaks_dm_control_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mujoco, "__version__", "4.0.0")
    found = check("mujoco")
    assert not found.passed
    assert "got 4.0.0" in found.text
    assert found.remedy == "pip install 'mujoco<3.18,>=3.17'"
    assert not check("physics").passed


@pytest.mark.parametrize(
    ("done", "text"),
    [
        (SimpleNamespace(returncode=-11, stderr=""), "the driver crashed (signal 11)"),
        (SimpleNamespace(returncode=1, stderr="noise\nno EGL here\n"), "no EGL here"),
        (SimpleNamespace(returncode=1, stderr=""), "no reason given"),
    ],
)
@pytest.mark.skipif(sys.platform != "linux", reason="EGL is Linux's")
def test_driver_that_fails_or_crashes_is_missing(
    monkeypatch: pytest.MonkeyPatch, done: SimpleNamespace, text: str
) -> None:
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: done)
    found = check("EGL")
    assert (found.passed, found.text) == (False, text)
    assert found.remedy == "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri"


@pytest.mark.parametrize(
    ("status", "text"),
    [(0, "no crash"), (1, "not tested"), (-11, r"importing torch\._dynamo .* \(signal 11\)")],
)
def test_crash_of_torch_after_egl_is_a_warning_that_says_what_helps(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture, status: int, text: str
) -> None:
    done = SimpleNamespace(returncode=status)
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: done)
    name = "torch after EGL"
    found = check(name)
    assert found.passed and re.match(text, found.text)
    assert doctor.report({name: doctor.all_probes()[name]}) == 0
    printed = capsys.readouterr().out
    assert ("WARNING" in printed) == (status < 0)
    assert (". Remedy: import triton before the first" in printed) == (status < 0)


@pytest.mark.slow
def test_torch_after_egl_is_tested_in_a_process_of_its_own(egl) -> None:
    found = check("torch after EGL")
    assert found.passed
    assert (found.text == "no crash") == (not found.remedy)


@pytest.mark.skipif(sys.platform != "linux", reason="EGL is Linux's")
def test_driver_that_hangs_ends_after_a_timeout(monkeypatch: pytest.MonkeyPatch) -> None:
    def hang(*_: object, timeout: float, **__: object) -> None:
        raise subprocess.TimeoutExpired("probe", timeout)

    monkeypatch.setattr(subprocess, "run", hang)
    found = check("EGL")
    assert not found.passed
    assert found.text == f"no image within {doctor._PROBE_SECONDS} s"


def test_display_is_reported_and_never_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("DISPLAY", ":7")
    assert "DISPLAY=:7" in check("display").text
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    found = check("display")
    assert found.passed
    assert "none" in found.text
