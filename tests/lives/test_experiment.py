"""What an experiment is: its parameters, its schedules, and its random streams."""

import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import CONDITIONS, experiments, quick

from musebot.controller import BRAINS, Parameters
from musebot.models import Kinematics
from musebot.protocols.errors import InputError
from musebot.protocols.lives.conditions import PAPER_TASKS, CohortKey, Condition
from musebot.protocols.lives.experiment import Experiment, check_same, differing
from musebot.protocols.lives.random_streams import random_streams
from musebot.protocols.lives.schedules import PROTOCOLS, SCHEDULES

# Parameters


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"seed": -1}, "the seed must not be negative, got -1"),
        ({"settings": ["rate=1"]}, "settings must be words NAME=VALUE, got ['rate=1']"),
        ({"settings": (1,)}, "settings must be words NAME=VALUE, got (1,)"),
        ({"seed": "one"}, "seed must be a whole number, got 'one'"),
        ({"seed": True}, "seed must be a whole number, got True"),
        ({"seed": 2**128}, f"the seed must be below 2^128, got {2**128}"),
        pytest.param(
            {"seed": 10**5000},
            "the seed must be below 2^128, got a number of too many digits",
            id="digits",
        ),
        ({"cohort_size": 10**8}, "the cohort size must be at most 1000000, got 100000000"),
        ({"time_scale": "1"}, "time_scale must be a number, got '1'"),
        ({"turned_start": True}, "turned_start must be a number, got True"),
        ({"turned_start": 1e300}, "the turn at the start must lie in [-360, 360], got 1e+300"),
        ({"arena_scale": 0.9}, "the arena's scale must lie in [1, 10], got 0.9"),
        ({"arena_scale": float("nan")}, "the arena's scale must lie in [1, 10], got nan"),
        ({"arena_scale": "big"}, "arena_scale must be a number, got 'big'"),
        ({"motor_speed": "fast"}, "motor_speed must be a number, got 'fast'"),
        ({"motor_speed": 11}, "the motor speed must be at most 10 m/s, got 11"),
        ({"learn_across_placement": 1}, "learn_across_placement must be true or false, got 1"),
        ({"cohort_size": 0}, "the cohort size must be at least 1, got 0"),
        ({"cohort_size": 1.5}, "cohort_size must be a whole number, got 1.5"),
        ({"time_scale": 0}, "the time scale must lie in (0, 1], got 0"),
        ({"time_scale": 1.5}, "the time scale must lie in (0, 1], got 1.5"),
        ({"time_scale": float("nan")}, "the time scale must lie in (0, 1], got nan"),
        (
            {"protocol": "night"},
            "the protocol must be one of paper, continual, walls, got 'night'",
        ),
        ({"nose": "big"}, "the nose must be one of inverse, printed, got 'big'"),
        ({"body": "ghost"}, "the body must be one of mujoco, kinematic, got 'ghost'"),
        (
            {"motor_torque": "great"},
            "the motor torque must be one of constant, scaled, got 'great'",
        ),
        (
            {"motor_torque": "scaled", "body": "kinematic"},
            "the motor torque is a parameter of the body 'mujoco' only",
        ),
        ({"motor_speed": 0}, "the motor speed must be positive, got 0"),
        ({"motor_speed": float("inf")}, "the motor speed must be positive, got inf"),
        (
            {"turned_start": float("nan")},
            "the turn at the start must lie in [-360, 360], got nan",
        ),
        (
            {"kinematics": Kinematics(wall="slides")},
            "kinematics are parameters of the body 'kinematic' only",
        ),
        (
            {"body": "kinematic", "kinematics": Kinematics(radius=0.4)},
            "the radius must be less than 0.1 m, got 0.4",
        ),
        *(
            (
                {"body": "kinematic", "kinematics": Kinematics(**{name: 10**9})},
                f"{name} must be at most {most}, got 1000000000",
            )
            for name, most in (("pieces", 1000), ("lag", 1000), ("wheel_base", 10))
        ),
        ({"nose": "printed", "signals": "raw"}, "raw signals need the nose 'inverse'"),
        *(
            (
                {"nose": "printed", "brain": BRAINS[name]},
                "a brain that uses the maximal smell needs the nose 'inverse'",
            )
            for name in ("steady", "steady-raw_reward", "steady-raw_signals")
        ),
    ],
)
def test_an_invalid_experiment_is_refused_in_a_sentence(fields, sentence):
    with pytest.raises(InputError) as caught:
        Experiment(**fields)
    assert str(caught.value) == sentence


def test_the_default_experiment_is_the_papers():
    experiment = Experiment()
    assert experiment.brain == Parameters()
    assert experiment.tasks == PAPER_TASKS
    assert {task: experiment.schedule(task) for task in PAPER_TASKS} == SCHEDULES
    assert sum(Experiment(time_scale=0.5).schedule("wall_avoidance").steps()) == 48_000


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_an_experiment_has_the_tasks_and_schedules_of_its_protocol(protocol):
    experiment = Experiment(protocol=protocol)
    assert experiment.tasks == tuple(PROTOCOLS[protocol])
    for task, schedule in PROTOCOLS[protocol].items():
        assert experiment.schedule(task) == schedule
        assert experiment.arena_task(task) == schedule.task


def test_a_task_without_a_schedule_is_simulated_under_its_own_name():
    assert Experiment(protocol="walls").arena_task("spot_finding") == "spot_finding_walls"
    assert Experiment(protocol="walls").arena_task("wall_avoidance") == "wall_avoidance"


def test_turned_starts_turn_fixed_poses_only():
    plain, turned = Experiment(), Experiment(turned_start=90.0)
    for before, after in zip(
        plain.schedule("wall_avoidance").phases,
        turned.schedule("wall_avoidance").phases,
        strict=True,
    ):
        if isinstance(before.robot, tuple):
            assert after.robot[:2] == before.robot[:2]
            assert after.robot[2] == pytest.approx(before.robot[2] + np.pi / 2)
        else:
            assert after == before


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


def test_an_experiment_that_differs_is_refused_with_its_first_field():
    check_same("OUT holds a run", Experiment(), Experiment())
    with pytest.raises(InputError) as caught:
        check_same("OUT holds a run", Experiment(), Experiment(seed=2, nose="printed"))
    assert str(caught.value) == "OUT holds a run with seed 1, not 2"


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


@quick
@given(experiments, st.sampled_from(CONDITIONS), st.integers(0, 1000))
def test_a_stream_depends_on_seed_condition_and_number_alone(experiment, condition, index):
    key = CohortKey(condition, index)
    assert streams(experiment, key) == streams(Experiment(seed=experiment.seed), key)
    assert 0 <= streams(experiment, key)[0] < 2**63  # what torch accepts as a seed


def test_the_brains_and_the_world_have_streams_of_their_own():
    brains, world = random_streams(1, CohortKey(Condition("wall_avoidance", "fixed"), 0))
    again = np.random.default_rng(brains)
    assert tuple(again.integers(2**63, size=4)) != tuple(world.integers(2**63, size=4))


def test_another_process_draws_the_same_streams():
    code = (
        "from musebot.protocols.lives.conditions import *\n"
        "from musebot.protocols.lives.random_streams import *\n"
        "key = CohortKey(Condition('spot_finding', 'creative'), 5)\n"
        "brains, world = random_streams(3, key)\n"
        "print(brains, *world.integers(2**63, size=4))"
    )
    path = os.pathsep.join(filter(None, sys.path))
    environment = os.environ | {"PYTHONPATH": path, "PYTHONHASHSEED": "12345", "MUJOCO_GL": "off"}
    result = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    key = CohortKey(Condition("spot_finding", "creative"), 5)
    brains, world = streams(Experiment(seed=3), key)
    assert [int(word) for word in result.stdout.split()] == [brains, *world]


@pytest.mark.parametrize("body", ["mujoco", "kinematic"])
def test_corners_of_a_larger_arena_stay_at_ten_centimetres_from_its_walls(body):
    experiment = Experiment(body=body, arena_scale=4 / 3)
    size = experiment.batch("spot_finding", 1).dimensions
    assert (size.half_length, size.half_width) == pytest.approx((0.70, 0.35 * 4 / 3))
    before, training, after = experiment.schedule("spot_finding").phases
    heading = SCHEDULES["spot_finding"].phases[0].robot[2]
    corner = (size.half_length - 0.1, size.half_width - 0.1)
    assert before.robot == pytest.approx((-corner[0], corner[1], heading))
    assert before.spot == after.spot == pytest.approx(corner)
    assert training.spot == "random" and training.robot is None
