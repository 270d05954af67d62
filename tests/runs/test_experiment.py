"""What an experiment is: its parameters, its lives, and its random streams."""

import dataclasses
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import CONDITIONS, experiments

from musebot.controller import BRAINS, Parameters
from musebot.models import Kinematics
from musebot.protocols.compare.benchmark import Benchmark
from musebot.protocols.compare.ppo import PPOTraining
from musebot.protocols.compare.tune import Tune
from musebot.protocols.errors import InputError
from musebot.protocols.runs.cohort import random_streams
from musebot.protocols.runs.conditions import CohortKey
from musebot.protocols.runs.experiment import Experiment, differing
from musebot.tasks.lives import LIVES, WALL_AVOIDANCE

# Parameters


def test_fields_that_exclude_each_other_are_refused_in_a_sentence():
    kinematic = {"body": "kinematic"}
    for fields, sentence in (
        ({"seed": 10**5000}, "got a number of too many digits"),
        ({"settings": ["rate=1"]}, "settings must be words NAME=VALUE, got ['rate=1']"),
        ({"settings": (1,)}, "settings must be words NAME=VALUE, got (1,)"),
        (
            kinematic | {"motor_torque": "scaled"},
            "torque needs the body 'mujoco' and a motor speed",
        ),
        ({"motor_torque": "scaled"}, "torque needs the body 'mujoco' and a motor speed"),
        ({"kinematics": Kinematics(wall="slides")}, "kinematics need the body 'kinematic'"),
        ({"nose": "printed", "signals": "raw"}, "raw signals need the nose 'inverse'"),
        ({"device": "cuda"}, "only the body 'kinematic' or the physics 'warp'"),
        (kinematic | {"physics": "warp"}, "the physics 'warp' needs the body 'mujoco'"),
        ({"nose": "printed", "brain": BRAINS["steady-raw_reward"]}, "maximal smell needs the nose"),
        ({"nose": "printed", "brain": BRAINS["steady-raw_signals"]}, "maximal smell needs"),
    ):
        with pytest.raises(InputError) as caught:
            Experiment(**fields)
        assert sentence in str(caught.value)


def test_an_experiment_has_all_lives_those_of_newborns_and_one_of_its_own():
    own = dataclasses.replace(WALL_AVOIDANCE, name="mine")
    experiment = Experiment(time_scale=0.5, life=own)
    for life in (*LIVES.values(), own):
        assert experiment.life_of(life.name) == life.scaled(0.5)
        assert experiment.life_of(f"{life.name}@2") == life.newborn(2).scaled(0.5)
    assert sum(experiment.life_of("mine").steps()) == 48_000
    for name in ("mine", "@1"):
        with pytest.raises(InputError, match="there is no life"):
            Experiment().life_of(name)
    for name in ("body@0", "body@13", "body@²"):
        with pytest.raises(InputError, match=f"the life body has the phases 1 to 12, got '{name}'"):
            Experiment().life_of(name)


@pytest.mark.parametrize("study", [Experiment, Benchmark, partial(Tune, agent="dqn"), PPOTraining])
def test_every_declared_field_refuses_a_wrong_value_in_one_line(study):
    names = [f.name for f in dataclasses.fields(getattr(study, "func", study)) if f.metadata]
    needed = {"task": "spot_finding"} if study is PPOTraining else {}
    for name in names:
        with pytest.raises(InputError, match=f"^{name} must be .*, got an object") as caught:
            study(**needed, **{name: object()})
        assert "\n" not in str(caught.value)
    assert len(names) > 1


@pytest.mark.parametrize(
    ("field", "usual"),
    [
        ({"nose": "printed"}, {}),
        ({"nose_place": "centre"}, {}),
        ({"motor_speed": 0.1}, {}),
        ({"motor_torque": "scaled", "motor_speed": 0.1}, {"motor_speed": 0.1}),
        ({"body": "kinematic"}, {}),
        ({"body": "kinematic", "kinematics": Kinematics(lag=0.1)}, {"body": "kinematic"}),
    ],
    ids=str,
)
def test_every_field_of_the_body_changes_what_robots_sense(field, usual):
    def sensed(**fields):
        batch = Experiment(**fields).batch("spot_finding", 1)
        batch.place_spot(np.array([0]), np.array([[0.2, 0.0]]))
        batch.place(np.array([0]), np.zeros((1, 3)))
        for _ in range(2):
            batch.step(np.full((1, 2), 0.5))
        return batch.rules.state(batch.sensordata)

    assert not np.allclose(sensed(**field), sensed(**usual), atol=1e-4)


# Comparison of experiments


def test_differing_fields_have_dotted_names_and_both_values():
    one = Experiment(body="kinematic", kinematics=Kinematics(lag=0.1))
    other = Experiment(body="kinematic", seed=2, brain=Parameters(epsilon=0.1))
    assert differing(one, other) == {
        "seed": (1, 2),
        "kinematics.lag": (0.1, 0.0),
        "brain.epsilon": (0.01, 0.1),
    }
    assert differing(one, one) == {}
    mine = Experiment(life=dataclasses.replace(WALL_AVOIDANCE, name="mine"))
    assert differing(Experiment(), mine) == {"life": (None, "mine")}


# Random streams


def streams(experiment, key):
    brains, world = random_streams(experiment.seed, key)
    return brains, tuple(world.integers(2**63, size=4))


def test_no_two_cohorts_conditions_or_seeds_share_a_stream():
    found = [
        streams(Experiment(seed=seed), CohortKey(condition, index))
        for seed in (0, 1, 2)
        for condition in CONDITIONS
        for index in range(20)
    ]
    assert len({brains for brains, _ in found}) == len(found)
    assert len({world for _, world in found}) == len(found)


@given(experiments, st.sampled_from(CONDITIONS), st.integers(0, 1000))
def test_a_stream_depends_on_seed_condition_and_number_alone(experiment, condition, index):
    key = CohortKey(condition, index)
    assert streams(experiment, key) == streams(Experiment(seed=experiment.seed), key)
    assert 0 <= streams(experiment, key)[0] < 2**63  # what torch accepts as a seed
