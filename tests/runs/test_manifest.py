"""The file `experiment.json`: written, read, refused where damaged; and whose a file is."""

import dataclasses
import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from strategies import CONDITIONS, plans

from musebot.controller import BRAINS
from musebot.models import Kinematics
from musebot.protocols.errors import DamagedFileError
from musebot.protocols.runs import manifest
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.manifest import (
    MANIFEST,
    check_identity,
    made_with,
    read_manifest,
    same_physics,
    write_manifest,
)
from musebot.protocols.runs.plan import Plan
from musebot.protocols.storage import write_json


@pytest.fixture
def sound(tmp_path):
    """A folder with a sound manifest."""
    write_manifest(tmp_path, Plan.of(Experiment(), CONDITIONS, 100))
    return tmp_path


def content_of(folder):
    return json.loads((folder / MANIFEST).read_text())


# Writing and reading


@given(plans())
def test_a_plan_survives_its_manifest(tmp_path_factory, plan):
    folder = tmp_path_factory.mktemp("plan")
    write_manifest(folder, plan)
    assert read_manifest(folder) == plan


def test_a_manifest_names_its_plan_and_every_machine_that_continued_the_run(tmp_path, monkeypatch):
    write_manifest(tmp_path, Plan(Experiment(cohort_size=2), {CONDITIONS[0]: 4, CONDITIONS[5]: 2}))
    assert content_of(tmp_path)["format"] == 1
    assert content_of(tmp_path)["plan"] == [
        {"task": "wall_avoidance", "proposer": "fixed", "robots": 4},
        {"task": "spot_finding", "proposer": "creative", "robots": 2},
    ]
    (here,) = content_of(tmp_path)["made_with"]
    assert here == made_with()
    monkeypatch.setattr(os, "cpu_count", lambda: 1000)
    for _ in range(2):
        write_manifest(tmp_path, read_manifest(tmp_path))
    assert content_of(tmp_path)["made_with"] == [here, here | {"cores": 1000}]
    write_manifest(tmp_path, read_manifest(tmp_path), begun=False)  # nobody simulated any of it
    assert content_of(tmp_path)["made_with"] == [here | {"cores": 1000}]


# Damage


def test_a_manifest_with_an_invalid_value_is_refused(sound):
    content = content_of(sound)
    rows = content["plan"]
    wrong = [
        *({"experiment": content["experiment"] | {name: value}} for name, value in (
            ("time_scale", 2), ("seed", "one"), ("mood", "good"), ("brain", 1),
            ("kinematics", [1]), ("motor_speed", 10**400),
        )),
        *({"plan": [rows[0] | {name: value}, *rows[1:]]} for name, value in (
            ("robots", 75), ("robots", True), ("proposer", "divine"), ("task", "Swim"),
        )),
        *({"format": number} for number in (0, 2, "1", [1])),
    ]  # fmt: skip
    for changes in wrong:
        write_json(sound / MANIFEST, content | changes)
        with pytest.raises(DamagedFileError) as caught:
            read_manifest(sound)
        words = str(caught.value)
        assert words.startswith(str(sound / MANIFEST)) and len(words) < 600 and "\n" not in words
        assert ("must have the format 1, got" in words and "9e668f6" in words) == (
            "format" in changes
        )
    (sound / MANIFEST).unlink()
    with pytest.raises(FileNotFoundError):  # missing, not damaged
        read_manifest(sound)


# Whose it is


def test_every_parameter_that_differs_or_is_missing_is_named():
    sound = dataclasses.asdict(Experiment())
    check_identity(Path("x"), sound, {"seed": 1, "brain": Experiment().brain})
    for field in dataclasses.fields(BRAINS["paper"]):
        held = sound | {"brain": sound["brain"] | {field.name: "other"}}
        with pytest.raises(DamagedFileError, match=f"a study with brain.{field.name} other, not "):
            check_identity(Path("x"), held, {"brain": Experiment().brain}, "a study")
        check_identity(Path("x"), held, {"seed": 1, "kinematics": Kinematics()})
    two = sound | {"settings": ["rate=0.1", "decay=0.5"]}
    check_identity(Path("x"), two, {"settings": ("decay=0.5", "rate=0.1")})  # in any order
    with pytest.raises(DamagedFileError, match="with settings .*, not "):
        check_identity(Path("x"), two, {"settings": ("decay=0.5", "rate=0.2")})
    with pytest.raises(DamagedFileError, match="^x holds an experiment with mood .*, not good"):
        check_identity(Path("x"), sound, {"mood": "good"})


def test_a_run_of_another_physics_is_refused_and_one_within_a_millionth_is_not(sound):
    physics = content_of(sound)["physics"]
    for change, same in ((0.0, True), (1e-7, True), (1e-5, False), (None, False)):
        changed = physics[1:] if change is None else [physics[0] + change, *physics[1:]]
        write_json(sound / MANIFEST, content_of(sound) | {"physics": changed})
        before = (sound / MANIFEST).read_bytes()
        assert same_physics(sound) == same
        assert (sound / MANIFEST).read_bytes() == before


# Versions


@pytest.mark.parametrize("there", [False, True])
def test_versions_processor_and_optional_packages_are_named(there, monkeypatch):
    version = manifest.metadata.version

    def known(name):
        if name == "numba" and not there:
            raise manifest.metadata.PackageNotFoundError
        return "9.8" if name == "numba" else version(name)

    monkeypatch.setattr(manifest.metadata, "version", known)
    found = made_with()
    assert found.get("numba") == ("9.8" if there else None)
    assert found["numpy"] == np.__version__ and found["cores"] == os.cpu_count()
    assert {"python", "musebot", "mujoco", "torch", "scipy", "cpu", "platform"} < {*found}


@pytest.mark.skipif(not shutil.which("git"), reason="there is no Git here")
def test_the_commit_is_this_packages_and_says_whether_files_were_changed(tmp_path, monkeypatch):
    assert (Path(manifest.__file__).parents[2] / "__main__.py").exists()  # `_commit` asks Git there

    def commit(root):
        monkeypatch.setattr(manifest, "__file__", str(root / "protocols" / "runs" / "manifest.py"))
        return manifest._commit.__wrapped__()

    script = "git init -q; echo 1 > file; git add file; git commit -qm one; git rev-parse HEAD"
    environment = os.environ | {"GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_NOSYSTEM": "1"}
    for who in ("AUTHOR", "COMMITTER"):
        environment |= {f"GIT_{who}_NAME": "somebody", f"GIT_{who}_EMAIL": "nobody@example.org"}
    head = subprocess.check_output(script, shell=True, cwd=tmp_path, env=environment, text=True)
    assert commit(tmp_path) == head[:12]
    (tmp_path / "file").write_text("two")
    assert commit(tmp_path) == f"{head[:12]}-dirty"
    # Installed inside somebody else's repository: its commit is not ours.
    (tmp_path / "packages" / "musebot").mkdir(parents=True)
    assert commit(tmp_path / "packages" / "musebot") is None
