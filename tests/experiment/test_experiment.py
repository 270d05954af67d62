"""What an experiment is: its numbers, its random streams, and its file."""

import dataclasses
import json
import os
import random
import shutil
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot import __version__
from musebot.controller import BRAINS, PROPOSERS, Parameters
from musebot.models import Kinematics, arena_spec, kinematic
from musebot.protocols.errors import DamagedFileError
from musebot.protocols.experiment import experiment as experiment_module
from musebot.protocols.experiment.experiment import (
    TASKS,
    CohortKey,
    Experiment,
    InputError,
    Plan,
    default_cohort_size,
    load_plan,
    named_brain,
    save_plan,
)
from musebot.protocols.experiment.schedules import SCHEDULES
from musebot.tasks import suite

quick = settings(deadline=None, max_examples=50)
CONDITIONS = tuple((task, proposer) for task in TASKS for proposer in PROPOSERS)

experiments = st.builds(
    Experiment,
    seed=st.integers(0, 2**64),
    cohort_size=st.integers(1, 300),
    time_scale=st.floats(0, 1, exclude_min=True),
    nose=st.sampled_from(["inverse", "printed"]),
    learn_across_placement=st.booleans(),
    brain=st.builds(
        Parameters,
        learn_rate=st.floats(0, 1),
        fixed_motors=st.lists(st.floats(-0.5, 0.5), min_size=1).map(tuple),
        noise_on_biases=st.booleans(),
    ),
)


@st.composite
def plans(draw):
    experiment = draw(experiments)
    conditions = draw(st.lists(st.sampled_from(CONDITIONS), min_size=1, unique=True))
    return Plan.of(experiment, tuple(conditions), draw(st.integers(1, 5)) * experiment.cohort_size)


# Numbers


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"seed": -1}, "the seed must not be negative, got -1"),
        ({"cohort_size": 0}, "the cohort size must be at least 1, got 0"),
        ({"time_scale": 0}, "the time scale must lie in (0, 1], got 0"),
        ({"time_scale": 1.5}, "the time scale must lie in (0, 1], got 1.5"),
        ({"time_scale": float("nan")}, "the time scale must lie in (0, 1], got nan"),
        ({"nose": "big"}, "the nose must be 'inverse' or 'printed', got 'big'"),
        *(
            (
                {"nose": "printed", "brain": BRAINS[name]},
                "a brain that knows a full load knows none of the printed Eq. 3",
            )
            for name in ("steady", "steady-raw_reward", "steady-raw_signals", "paper-content")
        ),
    ],
)
def test_an_experiment_that_makes_no_sense_is_refused_in_a_sentence(fields, sentence):
    with pytest.raises(InputError) as caught:
        Experiment(**fields)
    assert str(caught.value) == sentence


@pytest.mark.parametrize(
    ("conditions", "robots", "sentence"),
    [
        (
            (("swimming", "fixed"),),
            50,
            "the task must be one of wall_avoidance, spot_finding, got 'swimming'",
        ),
        (
            (*CONDITIONS, ("spot_finding", "divine")),
            50,
            "the proposer must be one of fixed, random, creative, or an agent's factory as "
            "package.module:factory, got 'divine'",
        ),
        ((), 50, "at least one task and one proposer are needed"),
        (CONDITIONS, 0, "the number of robots must be at least 1, got 0"),
        (CONDITIONS, -50, "the number of robots must be at least 1, got -50"),
        (
            CONDITIONS,
            75,
            "the number of robots must be a multiple of the cohort size, 50, got 75",
        ),
    ],
)
def test_a_plan_that_makes_no_sense_is_refused_in_a_sentence(conditions, robots, sentence):
    with pytest.raises(InputError) as caught:
        Plan.of(Experiment(cohort_size=50), conditions, robots)
    assert str(caught.value) == sentence


def test_an_experiment_is_the_papers_unless_told_otherwise():
    experiment = Experiment()
    assert experiment.brain == Parameters()
    assert {task: experiment.schedule(task) for task in TASKS} == SCHEDULES
    assert sum(Experiment(time_scale=0.5).schedule("wall_avoidance").steps()) == 48_000


@quick
@given(st.integers(1, 5000), st.integers(1, 300))
def test_the_default_cohort_size_is_the_largest_divisor_up_to_the_most(robots, most):
    largest = max(size for size in range(1, min(most, robots) + 1) if robots % size == 0)
    if robots > most and largest < most / 10:
        with pytest.raises(InputError, match="do not split into a few equal cohorts"):
            default_cohort_size(robots, most)
    else:
        assert default_cohort_size(robots, most) == largest


def test_500_robots_live_in_two_cohorts():
    assert default_cohort_size(500) == 250
    assert default_cohort_size(60) == 60


# Cohorts


@quick
@given(plans())
def test_cohorts_hold_every_robot_once_and_the_longest_lives_come_first(plan):
    keys = plan.cohorts()
    assert len(set(keys)) == len(keys)
    assert len(keys) * plan.experiment.cohort_size == sum(plan.robots.values())
    assert {(key.task, key.proposer) for key in keys} == set(plan.conditions)
    lengths = [sum(plan.experiment.schedule(key.task).steps()) for key in keys]
    assert lengths == sorted(lengths, reverse=True)


@quick
@given(plans(), st.integers(1, 5))
def test_more_robots_are_more_cohorts(plan, more):
    extra = more * plan.experiment.cohort_size
    robots = {condition: count + extra for condition, count in plan.robots.items()}
    larger = dataclasses.replace(plan, robots=robots)
    assert set(plan.cohorts()) < set(larger.cohorts())


@quick
@given(plans(), plans())
def test_a_merged_plan_asks_for_the_lives_of_both(plan, other):
    other = Plan.of(plan.experiment, other.conditions, plan.experiment.cohort_size * 3)
    merged = plan.merged_with(other)
    assert set(merged.cohorts()) == {*plan.cohorts(), *other.cohorts()}
    assert merged.conditions == tuple(
        c for c in CONDITIONS if c in {*plan.conditions, *other.conditions}
    )
    assert merged == other.merged_with(plan)


def test_plans_of_two_experiments_do_not_merge():
    first, second = (Plan.of(Experiment(seed=seed), CONDITIONS, 50) for seed in (1, 2))
    with pytest.raises(InputError, match="two experiments cannot be merged"):
        first.merged_with(second)


def test_a_run_of_another_physics_is_refused_and_left_alone(sound):
    content = json.loads(sound.read_text())
    content["physics"][0] += 1e-5
    sound.write_text(json.dumps(content))
    before = sound.read_bytes()
    with pytest.raises(InputError, match="was lived in another physics"):
        save_plan(sound, load_plan(sound))
    assert sound.read_bytes() == before


def test_the_physics_probe_tells_a_changed_body_and_not_a_changed_colour(monkeypatch):
    probe = experiment_module.physics_probe.__wrapped__
    ours = probe()
    assert any(value != 0 for value in ours)

    def with_a(part, name, **changes):
        def spec(**kwargs):
            edited = arena_spec(**kwargs)
            for attribute, value in changes.items():
                setattr(getattr(edited, part)(name), attribute, value)
            return edited

        monkeypatch.setattr(suite, "arena_spec", spec)

    with_a("body", "robot", mass=0.08)
    assert np.abs(np.subtract(probe(), ours)).max() > 1e-5
    with_a("site", "lid", rgba=[1, 1, 1, 1])
    assert probe() == ours


def test_the_physics_probe_tells_other_walls_of_the_stand_in(monkeypatch):
    probe = experiment_module.physics_probe.__wrapped__
    turns, slides = Kinematics(wall="turns"), Kinematics(wall="slides")
    ours = probe("kinematic", turns)
    assert len(ours) == len(probe("kinematic", slides)) > len(probe("kinematic"))
    monkeypatch.setattr(kinematic, "_TURNS", (0, *kinematic._TURNS[:-1]))
    assert np.abs(np.subtract(probe("kinematic", turns), ours)).max() > 1e-5
    assert not experiment_module.is_physics_of(ours, "kinematic", slides)


def test_the_name_of_a_cohort_tells_its_condition_and_number():
    assert str(CohortKey("spot_finding", "random", 12)) == "spot_finding-random-0012"


# Random streams


def streams(experiment, key):
    brains, world = experiment.seeds(key)
    return brains, tuple(world.integers(2**63, size=4))


def test_no_two_cohorts_conditions_or_seeds_share_a_stream():
    found = [
        streams(Experiment(seed=seed), CohortKey(task, proposer, index))
        for seed in (0, 1, 2)
        for task, proposer in CONDITIONS
        for index in range(20)
    ]
    assert len({brains for brains, _ in found}) == len(found)
    assert len({world for _, world in found}) == len(found)


@quick
@given(experiments, st.sampled_from(CONDITIONS), st.integers(0, 1000))
def test_a_stream_depends_on_seed_condition_and_number_alone(experiment, condition, index):
    key = CohortKey(*condition, index)
    assert streams(experiment, key) == streams(Experiment(seed=experiment.seed), key)
    assert 0 <= streams(experiment, key)[0] < 2**63  # what torch takes for a seed


def test_the_brains_and_the_world_have_streams_of_their_own():
    brains, world = Experiment().seeds(CohortKey("wall_avoidance", "fixed", 0))
    again = np.random.default_rng(brains)
    assert tuple(again.integers(2**63, size=4)) != tuple(world.integers(2**63, size=4))


def test_another_process_draws_the_same_streams():
    code = (
        "from musebot.protocols.experiment.experiment import *\n"
        "brains, world = Experiment(seed=3).seeds(CohortKey('spot_finding', 'creative', 5))\n"
        "print(brains, *world.integers(2**63, size=4))"
    )
    path = os.pathsep.join(filter(None, sys.path))
    environment = os.environ | {"PYTHONPATH": path, "PYTHONHASHSEED": "12345", "MUJOCO_GL": "off"}
    result = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    brains, world = streams(Experiment(seed=3), CohortKey("spot_finding", "creative", 5))
    assert [int(word) for word in result.stdout.split()] == [brains, *world]


# The file


@quick
@given(plans())
def test_experiment_json_gives_back_the_plan(tmp_path_factory, plan):
    path = tmp_path_factory.mktemp("plan") / "experiment.json"
    save_plan(path, plan)
    assert load_plan(path) == plan


def test_experiment_json_tells_what_it_was_made_with(tmp_path):
    save_plan(tmp_path / "experiment.json", Plan.of(Experiment(), CONDITIONS, 50))
    (made_with,) = json.loads((tmp_path / "experiment.json").read_text())["made_with"]
    assert made_with["musebot"] == __version__
    assert made_with["numpy"] == np.__version__
    assert made_with["commit"] == experiment_module._commit()
    assert {"python", "mujoco", "dm-control", "torch", "cpu", "cores"} < made_with.keys()


def git(folder, *words):
    identity = ["-c", "user.name=somebody", "-c", "user.email=nobody@example.org"]
    command = ["git", *identity, *words]
    return subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout


@pytest.mark.skipif(not shutil.which("git"), reason="there is no Git here")
def test_experiment_json_tells_the_commit_and_whether_it_was_changed(tmp_path, monkeypatch):
    def commit(root):
        path = root / "protocols" / "experiment.py"
        monkeypatch.setattr(experiment_module, "__file__", str(path))
        return experiment_module._commit.__wrapped__()

    git(tmp_path, "init")
    (tmp_path / "file").write_text("one")
    git(tmp_path, "add", "file")
    git(tmp_path, "commit", "--message", "one")
    head = git(tmp_path, "rev-parse", "HEAD").strip()
    assert commit(tmp_path) == head[:12]
    (tmp_path / "file").write_text("two")
    assert commit(tmp_path) == f"{head[:12]}-dirty"
    # Installed inside somebody else's repository: its commit is not ours.
    (tmp_path / "packages" / "musebot").mkdir(parents=True)
    assert commit(tmp_path / "packages" / "musebot") is None


def test_experiment_json_tells_of_every_machine_that_went_on_with_it(sound, monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 1000)
    for _ in range(2):
        save_plan(sound, load_plan(sound))
    here, there = json.loads(sound.read_text())["made_with"]
    assert there["cores"] == 1000 != here["cores"]
    save_plan(sound, load_plan(sound), begun=False)  # neither has lived a life of it
    (there,) = json.loads(sound.read_text())["made_with"]
    assert there["cores"] == 1000


@pytest.fixture
def sound(tmp_path):
    path = tmp_path / "experiment.json"
    save_plan(path, Plan.of(Experiment(), CONDITIONS, 100))
    return path


def assert_damaged(path):
    with pytest.raises(DamagedFileError) as caught:
        load_plan(path)
    assert str(path) in str(caught.value)


def test_a_run_from_before_there_were_other_brains_is_the_papers(sound):
    content = json.loads(sound.read_text())
    first = list(content["experiment"]["brain"]).index("activation")
    for name in list(content["experiment"]["brain"])[first:]:
        del content["experiment"]["brain"][name]
    assert len(content["experiment"]["brain"]) == 13
    sound.write_text(json.dumps(content))
    assert load_plan(sound).experiment.brain == Parameters()


@pytest.mark.parametrize("name", BRAINS)
def test_an_experiment_keeps_its_brain(name, tmp_path):
    path = tmp_path / "experiment.json"
    save_plan(path, Plan.of(Experiment(brain=named_brain(name)), CONDITIONS, 50))
    kept = load_plan(path).experiment
    assert kept.brain == BRAINS[name]
    assert kept.brain_name == name


@pytest.mark.parametrize(("name", "count"), [("paper", 0), ("steady", 8)])
def test_random_ideas_that_were_counted_are_read_as_their_share(name, count, tmp_path):
    path = tmp_path / "experiment.json"
    save_plan(path, Plan.of(Experiment(brain=named_brain(name)), CONDITIONS, 50))
    content = json.loads(path.read_text())
    content["experiment"]["brain"]["random_ideas"] = count
    del content["experiment"]["brain"]["random_share"]
    path.write_text(json.dumps(content))
    assert load_plan(path).experiment.brain == BRAINS[name]


@pytest.mark.parametrize(
    ("said", "readable"),
    [
        ({"judge_rate": 1.0, "noticed_signals": False, "capped": False, "ages_with": "time"}, True),
        ({"judge_rate": 0.02}, False),
        ({"noticed_signals": True}, False),
        ({"capped": True}, False),
        ({"ages_with": "reward"}, False),
        ({"ages_with": "time_and_reward"}, False),
    ],
)
def test_what_brains_no_longer_have_is_read_where_it_was_not_had(said, readable, sound):
    content = json.loads(sound.read_text())
    content["experiment"]["brain"] |= said
    sound.write_text(json.dumps(content))
    if readable:
        assert load_plan(sound).experiment.brain == Parameters()
    else:
        assert_damaged(sound)


def test_a_brain_with_a_number_changed_is_named_by_it():
    for name in ("paper", "steady"):
        brain = dataclasses.replace(BRAINS[name], discount=0.8, keep_main_idea=True)
        assert Experiment(brain=brain).brain_name == f"{name} discount=0.8 keep_main_idea=true"


def test_a_truncated_experiment_json_is_damaged(sound):
    whole = sound.read_bytes()
    for length in range(len(whole.rstrip())):
        sound.write_bytes(whole[:length])
        assert_damaged(sound)


def test_a_flipped_bit_in_experiment_json_ends_in_a_plan_or_a_sentence_and_nothing_else(sound):
    whole = sound.read_bytes()
    bits = random.Random(0)
    for index in range(len(whole)):
        flipped = bytearray(whole)
        flipped[index] ^= 1 << bits.randrange(8)
        sound.write_bytes(flipped)
        try:
            assert isinstance(load_plan(sound), Plan)
        except DamagedFileError as error:
            assert str(sound) in str(error)
        except InputError:
            pass


@pytest.mark.parametrize(
    "content", [b"", b"null", b"[]", b"{}", b'{"experiment": 1}', b"\xff\xfe", b'"experiment"']
)
def test_a_file_of_another_kind_is_damaged(tmp_path, content):
    path = tmp_path / "experiment.json"
    path.write_bytes(content)
    assert_damaged(path)


@pytest.mark.parametrize(
    ("group", "changes", "error"),
    [
        ("experiment", {"time_scale": 2}, InputError),
        ("experiment", {"seed": "one"}, InputError),
        ("experiment", {"mood": "good"}, DamagedFileError),
        ("plan", {"robots": 75}, InputError),
        ("plan", {"robots": 1.5}, InputError),
        ("plan", {"proposer": "divine"}, InputError),
        ("made_with", "nothing", DamagedFileError),
        ("physics", ["heavy"], DamagedFileError),
    ],
)
def test_an_experiment_json_whose_numbers_make_no_sense_is_refused(sound, group, changes, error):
    content = json.loads(sound.read_text())
    if group == "plan":
        content["plan"][0] |= changes
    elif group == "experiment":
        content["experiment"] |= changes
    else:
        content[group] = changes
    sound.write_text(json.dumps(content))
    with pytest.raises(error):
        load_plan(sound)


def test_a_missing_experiment_json_is_missing_and_not_damaged(tmp_path):
    with pytest.raises(FileNotFoundError):
        load_plan(tmp_path / "experiment.json")
