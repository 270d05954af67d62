"""The numbers that identify a physics move with the body and not with its decoration."""

import numpy as np

from musebot.models import Kinematics, arena_spec, kinematic
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.manifest import is_physics_of, physics_probe
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
    turns, slides = Kinematics(wall="turns"), Kinematics(wall="slides")
    ours = probe("kinematic", turns)
    assert len(ours) == len(probe("kinematic", slides)) > len(probe("kinematic"))
    monkeypatch.setattr(kinematic, "_TURNS", (0, *kinematic._TURNS[:-1]))
    assert np.abs(np.subtract(probe("kinematic", turns), ours)).max() > 1e-5
    assert not is_physics_of(ours, Experiment(body="kinematic", kinematics=slides))


def test_a_stored_probe_is_compared_within_a_millionth():
    ours = np.array(physics_probe())
    assert is_physics_of(ours.tolist(), Experiment())
    assert is_physics_of((ours + 1e-7).tolist(), Experiment(seed=5))
    assert not is_physics_of((ours + 1e-5).tolist(), Experiment())
    assert not is_physics_of(ours[:-1].tolist(), Experiment())
    assert not is_physics_of(ours.tolist(), Experiment(body="kinematic"))
