"""The compiled step: its second definitions are held to the first ones, and its lives to theirs."""

import copy
import dataclasses
import importlib
import itertools

import numpy as np
import pytest
import torch
from helpers import unit_senses
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot import compiled_equations as equations
from musebot.controller import BRAINS, Neurocontroller, Parameters
from musebot.controller.compiled import CompiledNeurocontroller
from musebot.controller.networks import load_into
from musebot.models import Kinematics
from musebot.models.kinematic import WALLS
from musebot.protocols.compare.tune import LIKE_MUJOCO
from musebot.protocols.errors import InputError
from musebot.protocols.runs import manifest
from musebot.protocols.runs.cohort import Cohort
from musebot.protocols.runs.compiled_life import compilable, world_numbers
from musebot.protocols.runs.conditions import CohortKey, Condition
from musebot.protocols.runs.config import READINGS
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.plan import Plan
from musebot.protocols.runs.simulation import check_device
from musebot.tasks.kinematic import make_kinematic_batch
from musebot.tasks.world import World

PROPOSERS = ("fixed", "random", "creative")
TASKS = ("wall_avoidance", "spot_finding", "spot_finding_walls")
OTHER = Parameters(
    evaluation_hidden=3, memory_hidden=4, ideas=9, noise=0.3, noisy_share=0.6, initial_range=2.0,
    fixed_motors=(-0.5, 0.1, 0.5), learn_rate=0.1, discount=0.5, epsilon=0.3,
)  # fmt: skip
LONG = Experiment(backend="numba", cohort_size=3, time_scale=0.005, **READINGS["plain"])


@given(st.floats(-1e6, 1e6, width=32))
def test_the_logistic_function_is_exact_to_3e_7(x):
    wanted = 1 / (1 + np.exp(-np.clip(x, -700, 700)))
    assert equations.logistic(np.float32(x)) == pytest.approx(wanted, abs=3e-7)


@pytest.mark.parametrize("sensors", [1, 5])
@pytest.mark.parametrize(
    ("parameters", "proposer"),
    [
        *itertools.product([Parameters(), OTHER], PROPOSERS),
        (Parameters(noisy_connections="fixed"), "creative"),
    ],
)
def test_a_step_from_an_equal_state_is_pytorchs_to_1e_5(parameters, proposer, sensors):
    arguments = parameters, proposer, 30, unit_senses(sensors), 7
    first, second = Neurocontroller(*arguments), CompiledNeurocontroller(*arguments)
    random, worst = torch.Generator().manual_seed(1), 0.0
    for step in range(100):  # 1,000 gave no larger difference
        if step == 20:
            first.forget_step(torch.tensor([2]))
        of_step = {k: v for k, v in first.state().items() if "noise" not in k and k != "generator"}
        load_into({k: v for k, v in second.state().items() if k in of_step}, of_step)
        state = torch.rand(30, sensors, generator=random)
        reward = torch.rand(30, generator=random) - 0.5
        learning = step % 5 != 0
        wanted, found = (brain.act(state, explore=learning) for brain in (first, second))
        # Of actions of almost equal values either may be selected.
        values = [brain.state()["now.value"] for brain in (first, second)]
        torch.testing.assert_close(*values, rtol=1e-5, atol=1e-6)
        same = (wanted - found).abs().amax(dim=1) < 1e-6
        assert same.float().mean() > 0.9
        if learning:
            errors = first.learn(reward), second.learn(reward)
            torch.testing.assert_close(*errors, rtol=1e-5, atol=2e-6)
            for name, weights in first.networks().items():
                apart = (weights - second.networks()[name])[same].abs()
                worst = max(worst, float((apart / weights[same].abs().clamp(min=0.1)).max()))
    print("largest relative difference of a weight after a step:", worst)
    assert worst < 1e-5
    assert torch.equal(first.generator.get_state(), second.generator.get_state())


WORLDS = st.builds(
    Kinematics,
    wall=st.sampled_from(WALLS),
    felt=st.sampled_from(["near", "pushed"]),
    any_contact=st.booleans(),
    lag=st.sampled_from([0.0, 0.08]),
    path=st.sampled_from(["arc", "euler"]),
    pieces=st.integers(1, 5),
    radius=st.none() | st.floats(0.01, 0.08),
    wheel_base=st.none() | st.floats(0.02, 0.1),
)


@settings(max_examples=20)
@given(WORLDS, st.sampled_from(TASKS), st.sampled_from(["inverse", "printed"]), st.data())
def test_a_compiled_robot_moves_and_senses_as_the_batch(how, task, nose, data):
    speed = data.draw(st.sampled_from([None, 0.1, 0.4]))
    batch = make_kinematic_batch(task, 40, how, nose=nose, motor_speed=speed)
    twin = make_kinematic_batch(task, 40, how, nose=nose, motor_speed=speed)
    twin.compile()
    twin = copy.deepcopy(twin)
    assert compilable(twin) and not compilable(batch)
    angle = data.draw(st.sampled_from([0.0, 90.0, 180.0])) if task != "wall_avoidance" else 0.0
    for robots in (batch, twin):
        robots.enter(World(nose=angle))
    rules, _, turn = world_numbers(twin)
    random = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    ends = np.array([batch.dimensions.half_length, batch.dimensions.half_width]) * 0.999
    ends -= batch.dimensions.radius
    spots, places = random.uniform(-ends, ends, (2, 40, 2))
    headings = random.uniform(-4, 4, 40)
    for robots in (batch, twin):
        robots.place_spot(np.arange(40), spots)
        robots.place(np.arange(40), np.column_stack([places, headings]))
    state = np.zeros(batch.rules.state(batch.sensordata).shape[1], np.float32)
    for _ in range(8):
        motors = random.uniform(-0.5, 0.5, (40, 2)) * random.choice([0, 1, 1], (40, 1))
        twin.set_state(batch.get_state())
        for robots in (batch, twin):
            robots.step(motors)
        for name, array in batch.arrays().items():
            np.testing.assert_allclose(twin.arrays()[name], array, rtol=1e-9, atol=1e-9)
        states, rewards = batch.rules.state(batch.sensordata), batch.rules.reward(batch.sensordata)
        events = batch.rules.event(batch.sensordata)
        for robot, sensors in enumerate(batch.sensordata):
            reward, event = equations.sense(rules, turn, sensors, state)
            np.testing.assert_allclose(state, states[robot], rtol=1e-6, atol=1e-7)
            assert reward == pytest.approx(rewards[robot], abs=1e-9) and event == events[robot]


@pytest.mark.parametrize("task", ["wall_avoidance", "spot_finding"])
@pytest.mark.parametrize("proposer", PROPOSERS)
def test_a_compiled_life_is_that_of_single_steps_until_rounding_separates_them(proposer, task):
    key = CohortKey(Condition(task, proposer), 0)
    one, other = (Cohort(dataclasses.replace(LONG, cohort_size=40), key) for _ in range(2))
    other._compiled = None
    for cohort in (one, other):
        cohort.advance(40)
    assert compilable(one.batch)
    np.testing.assert_allclose(one.batch.pose, other.batch.pose, atol=1e-4)
    for cohort in (one, other):
        cohort.advance(1000)
    arrays, wanted = one.checkpoint()[0], other.checkpoint()[0]
    assert {*arrays} == {*wanted}
    for name in ("brain.generator", "brain.age", "batch.spots"):
        np.testing.assert_array_equal(arrays[name], wanted[name])


@pytest.mark.parametrize("task", ["wall_avoidance", "senses"])  # half of the second is compiled
def test_a_compiled_life_that_stops_anywhere_continues_to_the_same_bytes(task):
    key, random = CohortKey(Condition(task, "creative"), 0), np.random.default_rng(2)
    whole, parts = Cohort(LONG, key), Cohort(LONG, key)
    whole.advance(whole.steps)
    while not parts.finished:
        parts.advance(int(random.integers(1, 300)))
        arrays, notes = copy.deepcopy(parts.checkpoint())
        parts = Cohort(LONG, key)
        parts.restore(arrays, notes)
    for name, array in whole.checkpoint()[0].items():
        np.testing.assert_array_equal(array, parts.checkpoint()[0][name])
    assert whole.lives().events.any() or task == "senses"


@pytest.mark.parametrize("life", ["body", "drift", "senses"])
def test_worlds_are_compiled_as_they_are_stepped_bit_for_bit(life):
    kinematics = dataclasses.replace(LIKE_MUJOCO, pieces=1)
    experiment = Experiment(
        backend="numba", body="kinematic", kinematics=kinematics, cohort_size=5, time_scale=0.005
    )
    compiled, stepped = (
        Cohort(experiment, CohortKey(Condition(life, "creative"), 0)) for _ in range(2)
    )
    stepped._compiled = None
    loops = 0
    while not compiled.finished:
        loops += compilable(compiled.batch)
        for cohort in (compiled, stepped):
            cohort.advance(37)
        for name, array in compiled.checkpoint()[0].items():
            np.testing.assert_array_equal(array, stepped.checkpoint()[0][name], name)
    assert loops > 20


@pytest.mark.parametrize("proposer", PROPOSERS)
def test_the_numbers_drawn_at_once_are_limited_for_any_number_of_actions(proposer, monkeypatch):
    motors = tuple(np.linspace(-0.5, 0.5, 40).tolist())
    brain = Parameters(ideas=len(motors) ** 2, fixed_motors=motors)
    drawn, draw = [], CompiledNeurocontroller.draw

    def drawing(self, steps, explore):
        drawn.append(steps)
        return draw(self, steps, explore)

    monkeypatch.setattr(CompiledNeurocontroller, "draw", drawing)
    experiment = dataclasses.replace(LONG, brain=brain)
    cohort = Cohort(experiment, CohortKey(Condition("spot_finding", proposer), 0))
    cohort.advance(cohort.steps)
    assert sum(drawn) == cohort.steps
    assert (max(drawn) - 1) * LONG.cohort_size * brain.ideas <= 500_000


def test_a_robot_whose_weights_are_not_finite_stops_alone():
    cohort = Cohort(LONG, CohortKey(Condition("wall_avoidance", "creative"), 0))
    cohort.advance(20)
    cohort.agent.weights()["evaluation.output_weights"][1] = np.nan
    cohort.advance(cohort.steps)
    assert cohort.valid.tolist() == [True, False, True]
    assert not cohort.batch.sensordata[1].any() and cohort.batch.sensordata[[0, 2]].any()


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        (dict(brain=BRAINS["steady"]), "compiles the paper's brain only"),
        (dict(brain=Parameters(keep_main_idea=True)), "compiles the paper's brain only"),
        (dict(device="cuda", body="kinematic"), "does not compute on a GPU"),
    ],
)
def test_what_the_compiled_step_does_not_compute_is_refused(fields, words):
    with pytest.raises(InputError, match=f"^the backend 'numba' {words}"):
        Experiment(backend="numba", **fields)


def test_without_numba_and_with_another_version_of_it_nothing_is_simulated(tmp_path, monkeypatch):
    plan = Plan.of(LONG, [Condition("wall_avoidance", "fixed")], 3)
    manifest.write_manifest(tmp_path, plan)
    assert manifest.same_physics(tmp_path)
    with monkeypatch.context() as patch:
        ours = manifest.made_with()
        patch.setattr(manifest, "made_with", lambda: ours | {"numba": "0.1"})
        assert not manifest.same_physics(tmp_path)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"^numba is not installed; pip install 'musebot"):
        check_device(plan)
