"""The fingerprint of the physics: what moves it."""

import numpy as np

from musebot.models import Kinematics, arena_spec, kinematic
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.physics_probe import is_physics_of, physics_probe
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


def test_the_probe_moves_with_the_walls_of_the_kinematic_simulator(monkeypatch):
    slips = Kinematics(wall="slips")
    ours = probe("kinematic", slips)
    assert len(ours) > len(probe("kinematic"))
    slides = Experiment(body="kinematic", kinematics=Kinematics(wall="slides"))
    assert not is_physics_of(ours, slides)
    monkeypatch.setattr(kinematic, "GRIP", 0.3)
    assert np.abs(np.subtract(probe("kinematic", slips), ours)).max() > 1e-5
