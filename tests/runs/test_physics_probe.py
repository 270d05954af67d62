"""The fingerprint of the physics: what moves it."""

from pathlib import Path

import numpy as np
import pytest

from musebot.models import Kinematics, arena_spec, kinematic
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.manifest import MANIFEST, read_manifest
from musebot.protocols.runs.physics_probe import is_physics_of, physics_probe
from musebot.protocols.storage import read_json
from musebot.tasks import arena

probe = physics_probe.__wrapped__  # without the cache


def test_the_probe_moves_with_a_mass_and_not_with_a_colour(monkeypatch):
    ours = probe()
    assert any(value != 0 for value in ours)

    def edit(part, name, **changes):
        def spec(*args, **kwargs):
            edited = arena_spec(*args, **kwargs)
            for attribute, value in changes.items():
                setattr(getattr(edited, part)(name), attribute, value)
            return edited

        monkeypatch.setattr(arena, "arena_spec", spec)

    edit("body", "robot", mass=0.08)
    assert np.abs(np.subtract(probe(), ours)).max() > 1e-5
    edit("site", "lid", rgba=[1, 1, 1, 1])
    assert probe() == ours


@pytest.mark.parametrize("name", ["mujoco", "kinematic-1000", "plain", "lives/drift-paper"])
def test_kept_runs_are_of_this_versions_physics(name):
    run = Path(__file__).parents[2] / "docs" / "results" / name
    experiment = read_manifest(run).experiment
    assert is_physics_of(read_json(run / MANIFEST)["physics"], experiment)


def test_the_probe_moves_with_the_walls_of_the_kinematic_simulator(monkeypatch):
    slips = Kinematics(wall="slips")
    ours = probe("kinematic", slips)
    assert len(ours) > len(probe("kinematic"))
    slides = Experiment(body="kinematic", kinematics=Kinematics(wall="slides"))
    assert not is_physics_of(ours, slides)
    monkeypatch.setattr(kinematic, "GRIP", 0.3)
    assert np.abs(np.subtract(probe("kinematic", slips), ours)).max() > 1e-5
