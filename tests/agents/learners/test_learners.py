"""What holds for every online learner, beside the contract of agents."""

import numpy as np
import pytest

from musebot.controller.senses import Senses, Signal
from musebot.protocols.agents.factory import factory_of
from musebot.protocols.agents.names import OWN
from musebot.protocols.agents.settings import settings_of

INGREDIENTS = ("dqn_l2", "dqn_shrink_perturb", "dqn_continual", "dqn_centred")
LEARNERS = tuple(name for name in OWN if name not in ("hand_coded", "newborn"))
SENSES = Senses((Signal(0, 1), Signal(-1, 0)), Signal(0, 1))
pytestmark = pytest.mark.parametrize("name", LEARNERS)


def made(name, robots=3, seed=1, **settings):
    agent = factory_of(name)(robots, SENSES, seed, **settings)
    agent.reset()
    return agent


def lived(agent, steps, learning=True, start=0):
    """Lets an agent of three robots live on a fixed stream; returns its actions."""
    random = np.random.default_rng(0)
    states = random.uniform((0, -1), (1, 0), size=(60, 3, 2)).astype(np.float32)
    rewards = random.uniform(size=(60, 3)).astype(np.float32)
    motors, which = [], slice(start, start + steps)
    for state, reward in zip(states[which], rewards[which], strict=True):
        motors.append(agent.act(state, learning))
        if learning:
            agent.learn(reward)
    return np.array(motors)


def normalised(agent):
    """Returns the signals as the networks receive them, shape (3, 2)."""
    return agent.now.get("features", agent.now["inputs"])[:, :2].numpy().copy()


def test_a_signal_that_first_varies_in_a_test_stays_within_the_bound_of_training(name):
    agent = made(name)
    silent = np.full((3, 2), (0.5, 0.0), np.float32)
    for _ in range(50):
        agent.act(silent, True)
        agent.learn(np.zeros(3, np.float32))
    assert np.isfinite(agent.act(np.full((3, 2), (0.5, -1.0), np.float32), False)).all()
    assert np.abs(normalised(agent)).max() <= np.sqrt(51) + 1e-3


def test_a_newborn_chooses_by_what_it_senses_before_anything_is_learned(name):
    agent, random, inputs, motors = made(name), np.random.default_rng(8), [], []
    for state in random.uniform((0, -1), (1, 0), (20, 3, 2)).astype(np.float32):
        motors.append(agent.act(state, False))
        inputs.append(normalised(agent))
    assert np.std(inputs, axis=0).min() > 0.1
    varies = np.std(motors, axis=0).max() > 0
    assert varies or name in ("q_learner", "sarsa_lambda")  # whose newborns prefer one action


def test_what_a_test_chooses_depends_on_the_state_alone(name):
    agent = made(name)
    lived(agent, 40)
    first, second = (lived(agent, 20, learning=False) for _ in range(2))
    if name != "amortised_q":  # its candidates are drawn anew
        assert np.array_equal(first, second)
    assert first.std() > 0


def test_the_seed_decides_weights_which_are_refused_in_another_shape(name):
    agent, other = made(name), made(name, seed=2)
    assert any(not np.array_equal(w, other.weights()[k]) for k, w in agent.weights().items())
    with pytest.raises(ValueError, match="must have shape"):
        agent.load_weights({k: w[1:] for k, w in other.weights().items()})


def test_every_setting_of_a_robot_changes_what_it_learns(name):
    settings = {k: one for k, one in settings_of(factory_of(name)).items() if one.each}
    chosen = {k: np.full(3, one.at(0.4)) for k, one in settings.items()}
    if "epsilon_steps" in chosen:
        chosen["epsilon_steps"][:] = 1.0  # random actions would hide the other settings
    usual = made(name, **chosen)
    lived(usual, 40)
    for word, setting in settings.items():
        if word == "replaced":  # no neuron is old enough: see test_plasticity.py
            continue
        agent = made(name, **chosen | {word: np.array([chosen[word][0], setting.at(1.0), 0.0])})
        lived(agent, 40)
        pairs = [(agent.weights()[k], w) for k, w in usual.weights().items()]
        assert any(not np.array_equal(ours[1], theirs[1]) for ours, theirs in pairs), word


def test_both_ends_of_every_setting_stay_stable_on_signals_that_last(name):
    """One robot has the lowest values of all settings, two the highest."""
    settings = settings_of(factory_of(name))
    chosen = {
        word: np.array([one.at(0.0), one.at(1.0), one.at(1.0)])
        for word, one in settings.items()
        if one.tuned
    }
    if "epsilon_steps" in chosen:
        chosen["epsilon_steps"][:] = 1.0  # random actions would hide what diverges
    agent, random = made(name, **chosen), np.random.default_rng(2)
    for _ in range(12):
        smell = random.uniform(size=3).astype(np.float32)
        state = np.stack([smell, -smell], axis=1)
        for _ in range(int(random.integers(5, 60))):
            agent.act(state, True)
            agent.learn(smell)
    learned = [w for k, w in agent.weights().items() if "signals" not in k]  # no moments
    largest = max(np.abs(weights).max() for weights in learned)
    assert np.isfinite(largest) and largest < 1000


def test_a_robot_with_broken_weights_harms_no_other(name):
    agent = made(name)
    lived(agent, 10)
    state = {key: array.copy() for key, array in agent.state().items()}
    for key in agent.weights():
        state[key][1] = np.nan
    agent.load_state(state)
    lived(agent, 20, start=10)
    for weights in agent.weights().values():
        assert np.isfinite(weights[[0, 2]]).all() and not np.isfinite(weights[1]).all()


# Settings with which a learner finds the better action in a few hundred steps.
FAST = {
    "q_learner": {"discount": 0.6, "epsilon": 0.2},
    "sarsa_lambda": {"discount": 0.6, "epsilon": 0.2},
    "stream_q": {"discount": 0.6, "epsilon": 0.2, "epsilon_steps": 300.0},
    "stream_ac": {"discount": 0.6},
    "avg": {"discount": 0.6},
    "amortised_q": {"discount": 0.6, "epsilon": 0.2, "rate": 0.01, "proposer_rate": 0.01},
    "dqn": {"discount": 0.6, "epsilon_steps": 300.0},
    **{name: {"discount": 0.6, "epsilon_steps": 300.0} for name in ("dqn_no_replay", *INGREDIENTS)},
}
ROBOTS, TRAINED, MARGIN = 48, 250, 0.4


def test_learners_drive_in_the_direction_that_is_rewarded(name):
    """Half are paid for driving on, half for driving back: 1 is perfect; chance is within 0.1."""
    direction = np.resize([1.0, -1.0], ROBOTS).astype(np.float32)
    agent, motors = made(name, robots=ROBOTS, **FAST[name]), np.zeros((ROBOTS, 2))
    for step in range(TRAINED):
        paid = (motors.sum(axis=1) * direction).astype(np.float32)
        # Signals vary a little, so that their running moments are defined.
        near = np.tile([0.8, -0.4], (ROBOTS, 1)) * (1 + 0.1 * np.sin(step))
        motors = agent.act(near.astype(np.float32), True)
        agent.learn(paid)
    tested = agent.act(np.tile(np.float32([0.8, -0.4]), (ROBOTS, 1)), False)
    assert np.mean(tested.sum(axis=1) * direction) > MARGIN
