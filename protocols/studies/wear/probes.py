"""Probes: what frozen copies of brains do in ten minutes with a spot at a random place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ....tasks.arena import Edit
from ...agents.base import sound
from ...agents.factory import make_agent
from ...experiment.conditions import Condition
from ...experiment.experiment import Experiment
from ...experiment.random_streams import named_streams
from ...experiment.schedules import SPOT_FINDING, Phase, control_steps
from ...playback.rollout import Tick, count_events
from ...simulation.placement import place

CONDITION = Condition("spot_finding", "creative")
PROBE = Phase("post", 10, False, robot="random", spot="random")
TRAINING = SPOT_FINDING.phases[1]  # once more, after the change
PERIODS = round(TRAINING.minutes / PROBE.minutes)  # of training, with a probe after each
PERIODS_PER_SPOT = round((TRAINING.every_minutes or TRAINING.minutes) / PROBE.minutes)
REFERENCES = 6  # probes before the change


def period(experiment: Experiment) -> int:
    """Returns the control steps of a probe, and of the training between two probes."""
    return control_steps(PROBE.minutes * experiment.time_scale)


def probe(
    experiment: Experiment,
    networks: Mapping[str, np.ndarray],
    stream: tuple[str, int, int],
    edits: Sequence[Edit] = (),
    tick: Tick = lambda: None,
) -> np.ndarray:
    """Evaluates frozen copies of brains in one probe.

    The copies have a random stream of their own, which depends on the seed and on `stream` alone:
    equal streams have equal places of robot and spot, whatever the brains and the body.

    Args:
      experiment: Experiment that decides the brains and the body.
      networks: Networks of B brains, see `Agent.weights`.
      stream: Kind of probe, number of the cohort, and number of the probe.
      edits: Edits of the arena's model.
      tick: Function called after every simulated minute.

    Returns:
      Share of time in the spot, shape (B,); NaN where the simulation became unstable or a weight
      is not finite.
    """
    kind, *numbers = stream
    seed, random = named_streams(experiment.seed, f"wear/{kind}", *numbers)
    robots = len(next(iter(networks.values())))
    agent = make_agent(experiment, CONDITION, robots, seed)
    agent.load_weights(networks)
    batch = experiment.batch(CONDITION.task, robots, edits)
    place(batch, PROBE, random)
    steps = period(experiment)
    counts = count_events(batch, agent, steps, tick=tick)
    return np.where(batch.valid & sound(networks, robots), counts / steps, np.nan)
