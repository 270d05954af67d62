"""What every brain promises: robots apart, checkpoints, loading, and no foreign imports."""

import dataclasses
import os
import subprocess
import sys

import pytest
import torch
from helpers import same, snapshot

from musebot.controller import (
    BRAINS,
    PROPOSERS,
    Neurocontroller,
    NoisePatterns,
    Parameters,
    Senses,
    Signal,
)

every_proposer = pytest.mark.parametrize("proposer", PROPOSERS)
SENSES = Senses((Signal(0.0, 1.0, 10.0), *[Signal(-1.0, 1.0)] * 4), Signal(0.0, 1.0, 10.0))
READINGS = {
    "noise-held": Parameters(noise_steps=3, ideas=3),
    "noise-for-life": Parameters(noise_steps=0, test_epsilon=0.3),
    "noise-on-biases": Parameters(noise_on_biases=True, keep_main_idea=True),
}
ALL_BRAINS = BRAINS | READINGS


def states(steps, robots, sensors, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(steps, robots, sensors, generator=generator) * 2 - 1


@pytest.mark.parametrize("placed", [[1], [0, 3], None])
@pytest.mark.parametrize("name", ["paper", "steady"])
def test_a_robot_placed_elsewhere_does_not_learn_across_and_others_do(name, placed):
    across, anew = (
        Neurocontroller(BRAINS[name], "fixed", 4, 5, seed=2, senses=SENSES) for _ in range(2)
    )
    sensed = states(4, 4, 5)
    reward = torch.tensor([0.3, -0.7, 0.5, -0.2])
    for brain in (across, anew):
        for state in sensed[:2]:
            brain.act(state, explore=False)
            brain.learn(reward)
    before = snapshot(anew.networks())
    anew.forget_step(None if placed is None else torch.tensor(placed))
    errors = []
    for brain in (across, anew):
        brain.act(sensed[2], explore=False)
        errors.append(brain.learn(reward))
    for robot in range(4):
        moved = placed is None or robot in placed
        source = before if moved else across.networks()
        assert errors[1][robot] == (0 if moved else errors[0][robot])
        for name, tensor in anew.networks().items():
            assert torch.equal(tensor[robot], source[name][robot])
    anew.act(sensed[3], explore=False)
    assert anew.learn(reward).abs().min() > 0


@pytest.mark.parametrize("name", BRAINS)
def test_changing_what_was_given_or_returned_does_not_affect_learning(name):
    careful, careless = (
        Neurocontroller(BRAINS[name], "creative", 2, 5, seed=3, senses=SENSES) for _ in range(2)
    )
    for state in states(5, 2, 5):
        careful.act(state.clone(), explore=False)
        sensed, reward = state.clone(), state[:, 0].clone()
        careless.act(sensed, explore=False).fill_(9)
        sensed.fill_(9)
        careful.learn(state[:, 0])
        careless.learn(reward)
        reward.fill_(9)
    assert same(careful.networks(), careless.networks())


# Independence


@pytest.mark.usefixtures("double_precision")
@pytest.mark.parametrize("name", ["paper", "steady"])
def test_robots_behave_the_same_alone_and_in_a_batch(name):
    never = {"epsilon": 0.0, "initial_epsilon": None, "exploration_steps": 1}
    parameters = dataclasses.replace(BRAINS[name], **never)  # draws would differ
    together = Neurocontroller(parameters, "fixed", 4, 5, seed=5, senses=SENSES)
    alone = [Neurocontroller(parameters, "fixed", 1, 5, 0, SENSES) for _ in range(4)]
    for robot, brain in enumerate(alone):
        brain.load_networks({k: t[robot : robot + 1] for k, t in together.networks().items()})
    for state in states(30, 4, 5).double():
        actions = together.act(state, explore=True)
        errors = together.learn(state[:, 0])
        for robot, brain in enumerate(alone):
            row = slice(robot, robot + 1)
            torch.testing.assert_close(brain.act(state[row], explore=True), actions[row])
            torch.testing.assert_close(brain.learn(state[row, 0]), errors[row], atol=1e-9, rtol=0)


@pytest.mark.parametrize("name", ["paper", "steady", "recurrent"])
def test_signals_of_one_robot_do_not_affect_others(name):
    one, other = (
        Neurocontroller(BRAINS[name], "creative", 3, 5, seed=5, senses=SENSES) for _ in range(2)
    )
    for state in states(50, 3, 5):
        changed = state.clone()
        changed[1] = -changed[1]
        first, second = one.act(state, explore=True), other.act(changed, explore=True)
        assert torch.equal(first[[0, 2]], second[[0, 2]])
        one.learn(state[:, 0])
        other.learn(changed[:, 0])
    for name, tensor in one.networks().items():
        assert torch.equal(tensor[[0, 2]], other.networks()[name][[0, 2]])
        assert torch.equal(tensor[1], other.networks()[name][1]) is name.startswith("context.")


# Initial brains, and checkpoints


@every_proposer
def test_only_creative_robots_have_a_memory(proposer):
    brain = Neurocontroller(Parameters(), proposer, 3, 5, seed=1)
    owners = {name.split(".")[0] for name in brain.networks()}
    assert owners == ({"evaluation", "memory"} if proposer == "creative" else {"evaluation"})
    assert brain.networks()["evaluation.hidden_weights"].shape == (3, 7, 7)
    if proposer == "creative":
        assert brain.networks()["memory.hidden_weights"].shape == (3, 5, 5)
        assert brain.networks()["memory.output_weights"].shape == (3, 2, 5)


def test_an_unknown_proposer_is_refused_by_name():
    with pytest.raises(ValueError, match="got 'oracle'"):
        Neurocontroller(Parameters(), "oracle", 1, 1, seed=1)


def run(brain, sensed, start=0):
    """Lets brains act in tests and in training, and places some of them elsewhere in between."""
    actions = []
    for index, state in enumerate(sensed, start):
        if index % 7 == 3:
            brain.forget_step(torch.tensor([index % 3]))
        actions.append(brain.act(state, explore=index % 2 == 0))
        if index % 5:
            brain.learn(state[:, 0])
    return actions


@every_proposer
@pytest.mark.parametrize("name", ALL_BRAINS)
def test_a_seed_and_a_checkpoint_determine_the_rest_of_a_life(name, proposer, monkeypatch):
    monkeypatch.setattr(NoisePatterns, "LIFETIME", 6)  # so that the pool is redrawn
    monkeypatch.setattr(NoisePatterns, "POOL", 64)
    sensed = states(26, 3, 5)  # the last step is not learned from
    first, twin, other = (
        Neurocontroller(ALL_BRAINS[name], proposer, 3, 5, seed, SENSES) for seed in (10, 10, 999)
    )
    assert not same(first.networks(), other.networks())
    whole = run(twin, sensed)
    run(other, sensed[:3])
    for start, end in ((0, 1), (1, 6), (6, 17), (17, 25)):
        assert all(map(torch.equal, run(first, sensed[start:end], start), whole[start:end]))
        kept = snapshot(first.state())
        other.load_state(kept)
        assert same(other.state(), kept)
        assert all(map(torch.equal, run(other, sensed[end:], end), whole[end:]))
        assert same(other.state(), twin.state())


@pytest.mark.parametrize("proposer", ["fixed", "creative"])
def test_a_state_with_a_missing_or_misshapen_tensor_is_refused_and_changes_nothing(proposer):
    brain = Neurocontroller(Parameters(), proposer, 3, 5, seed=10)
    other = Neurocontroller(Parameters(), proposer, 3, 5, seed=11)
    run(brain, states(4, 3, 5))
    before, kept = snapshot(brain.state()), snapshot(other.state())
    assert {"generator", "now.state", "now.action", "now.value", "now.chained"} < kept.keys()
    assert ({"noise.pool", "noise.age"} < kept.keys()) == (proposer == "creative")
    for name in kept:
        with pytest.raises(ValueError, match=f"{name} is missing"):
            brain.load_state({k: t for k, t in kept.items() if k != name})
        with pytest.raises(ValueError, match=f"{name} must have shape"):
            brain.load_state(kept | {name: torch.stack([kept[name], kept[name]])})
        assert same(brain.state(), before)


def test_networks_of_another_brain_can_be_loaded():
    brain, other = (Neurocontroller(Parameters(), "creative", 3, 5, seed) for seed in (1, 2))
    brain.load_networks(snapshot(other.networks()))
    assert same(brain.networks(), other.networks())
    state = states(1, 3, 5)[0]
    actions = torch.zeros(3, 1, 2)
    assert torch.equal(brain.values(state, actions), other.values(state, actions))
    with pytest.raises(ValueError, match=r"memory\.\w+ is missing"):
        fixed = Neurocontroller(Parameters(), "fixed", 3, 5, seed=3)
        brain.load_networks(fixed.networks())
    with pytest.raises(ValueError, match=r"evaluation\.hidden_weights must have shape \(3, 7, 7\)"):
        brain.load_networks(Neurocontroller(Parameters(), "creative", 3, 1, seed=3).networks())


@pytest.mark.parametrize("given", [None, Senses(SENSES.state[:2], SENSES.reward)])
def test_a_brain_that_needs_senses_refuses_a_wrong_number_of_signals(given):
    with pytest.raises(
        ValueError, match="senses must give the range of all 3 signals, got (none|2)"
    ):
        Neurocontroller(BRAINS["steady"], "creative", 1, 3, seed=1, senses=given)


# Imports


def test_the_controller_imports_neither_mujoco_nor_other_packages_of_musebot():
    code = "import sys, musebot.controller; print(*sys.modules)"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    result = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    modules = set(result.stdout.split())
    assert "torch" not in modules  # `list` and `doctor` work without it
    assert not {"mujoco", "dm_control", "dm_env"} & {name.split(".")[0] for name in modules}
    ours = {name.split(".")[1] for name in modules if name.startswith("musebot.")}
    assert ours == {
        "controller",
        "fields",
        "gymnasium_registration",
    }  # the last by `import musebot`
