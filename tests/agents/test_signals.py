"""What agents sense: each task describes its signals, and raw ones are those `steady` reads."""

import numpy as np
import pytest
import torch

import musebot
from musebot.controller.presets import BRAINS
from musebot.controller.senses import Encoding, Senses, Signal
from musebot.protocols.agents.hand_coded import HandCoded
from musebot.protocols.agents.signals import RawSignals, raw_senses, senses_of
from musebot.tasks.suite import TASKS


def signal(name, spec):
    smells = 10 if name.startswith("nose") else None
    return Signal(float(np.min(spec.minimum)), float(np.max(spec.maximum)), maximal=smells)


def test_every_task_describes_its_signals_and_its_reward():
    for task in TASKS:
        environment = musebot.load("arena", task)
        specs = environment.observation_spec().items()
        signals = [signal(name, spec) for name, spec in specs for _ in range(*spec.shape)]
        # Where driving may be rewarded, too, the reward does not saturate.
        smells = "spot" in task and "driving" not in task
        reward = signal("nose" if smells else "", environment.reward_spec())
        assert senses_of(task) == Senses(tuple(signals), reward)
    with pytest.raises(ValueError, match="task"):
        senses_of("swimming")


class Spy(HandCoded):
    def act(self, state, learning):
        self.seen = state
        return super().act(state, learning)

    def learn(self, reward):
        self.paid = reward

    def weights(self):
        return {"seen": np.ones((3, 1))}


def guarded(task):
    spy = Spy(raw_senses(senses_of(task)))
    return RawSignals(senses_of(task), spy), spy


def test_the_smell_is_a_further_signal_as_steady_reads_it():
    agent, spy = guarded("spot_finding")
    signals = np.array([[0.0], [0.5], [10 / 11]], np.float32)
    agent.act(signals, True)
    assert BRAINS["steady"].raw_signals and BRAINS["steady"].raw_reward
    senses = senses_of("spot_finding")
    wanted = Encoding(senses.state, centred=False, raw_signals=True).state(torch.tensor(signals))
    assert np.array_equal(spy.seen, wanted)
    np.testing.assert_allclose(spy.seen[:, 1], [0, 0.1, 1], rtol=1e-5)
    agent.learn(signals[:, 0])
    np.testing.assert_allclose(spy.paid, [0, 0.1, 1], rtol=1e-5)
    assert len(raw_senses(senses).state) == 2 and raw_senses(senses).reward.high == 1


def test_wall_avoidance_has_no_raw_signals():
    agent, spy = guarded("wall_avoidance")
    signals = np.full((3, 5), 0.25, np.float32)
    agent.act(signals, True)
    agent.learn(signals[:, 0])
    assert np.array_equal(spy.seen, signals) and np.array_equal(spy.paid, signals[:, 0])
    assert raw_senses(senses_of("wall_avoidance")) == senses_of("wall_avoidance")
    assert agent.state() == {} and [*agent.weights()] == ["seen"]
