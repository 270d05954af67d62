"""Experiments: the parameters that decide every robot's life."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from typing import Any, Literal, get_args

from ...controller.parameters import Parameters
from ...controller.presets import BRAINS
from ...fields import check, choice, flag, number, shown, text, whole
from ...models import Kinematics, centre_nose, scale_torque
from ...models.arena import FASTEST, SLOWEST
from ...tasks.batch import Robots
from ...tasks.episode import CONTROL_TIMESTEP
from ...tasks.kinematic import make_kinematic_batch
from ...tasks.lives import LIVES, Life, life_from, life_named
from ...tasks.sensors import NoseForm
from ...tasks.suite import TASKS, Edit, make_batch
from ..errors import InputError, nearest

Body = Literal["mujoco", "kinematic"]
NosePlace = Literal["front", "centre"]
MotorTorque = Literal["constant", "scaled"]
Signals = Literal["paper", "raw"]
Physics = Literal["c", "warp"]
Backend = Literal["torch", "numba"]
BODIES: tuple[Body, ...] = get_args(Body)


@dataclasses.dataclass(frozen=True)
class Experiment:
    """Parameters of a simulation; on one machine, equal ones give bit-exactly equal lives.

    Not among them are the conditions, the number of processes, and the number of robots: more
    robots are more cohorts.

    Attributes:
      seed: Seed from which all random streams derive.
      cohort_size: Number of robots simulated in lockstep on one random stream. If it is not set,
        `musebot run` chooses it: at most 250 (`plan.default_cohort_size`).
      time_scale: Factor on every duration of a life, in (0, 1]; below 1 for short rehearsals.
      nose: Form of Eq. 3: "inverse", in which the smell falls with the distance, or "printed", in
        which it grows (see `tasks.sensors.Nose`).
      nose_place: Place of the nose: "front" of the rim, or "centre" of the robot.
      learn_across_placement: Whether robots with a brain learn from the step that spans a new
        placement (not stated in the paper).
      motor_speed: Speed of a wheel at motor value 0.5, in [m/s]; None for that of `robot.xml`.
      motor_torque: Stall torque of the motors if `motor_speed` is set: "constant", so that faster
        wheels lag behind for longer, or "scaled" with the speed, so that the lag stays equal.
      body: Simulated body: "mujoco", or "kinematic" for the simulator `models.kinematic`.
      kinematics: Settings of the kinematic simulator, for the body "kinematic" only.
      brain: Parameters of the neurocontroller, for conditions with a proposer.
      physics: Engine of the body "mujoco": "c" for MuJoCo, "warp" for MuJoCo Warp, which
        computes in single precision (docs/physics.md).
      device: Device on which brains and simulator compute: "cpu", or a GPU, such as "cuda" or
        "cuda:1". A GPU needs the kinematic simulator or MuJoCo Warp. Lives differ between devices,
        because random numbers and rounding do.
      backend: Library that computes: "torch", or "numba", which compiles the paper's brain and the
        kinematic simulator (docs/performance.md). Their lives differ by rounding.
      signals: Observation set of agents: "paper", or "raw" with smell and reward before they
        saturate (see `agents.signals`). For brains, the parameters `raw_signals` and `raw_reward`
        set this.
      settings: Settings of agents that differ from their defaults, as NAME=VALUE.
      life: Life that the user defines; None if all lives are those of `tasks.lives.LIVES`.
    """

    seed: int = whole(1, 0, 2**128 - 1)
    cohort_size: int = whole(50, 1, 1_000_000)
    time_scale: float = number(1.0, 0, 1, "(]")
    nose: NoseForm = choice("inverse", NoseForm)
    nose_place: NosePlace = choice("front", NosePlace)
    learn_across_placement: bool = flag(False)
    motor_speed: float | None = number(None, SLOWEST, FASTEST, unit="m/s")
    motor_torque: MotorTorque = choice("constant", MotorTorque)
    body: Body = choice("mujoco", Body)
    kinematics: Kinematics = Kinematics()
    brain: Parameters = Parameters()
    physics: Physics = choice("c", Physics)
    device: str = text("cpu", "cpu|cuda(:[0-9]{1,2})?", "cpu, cuda or cuda:N")
    backend: Backend = choice("torch", Backend)
    signals: Signals = choice("paper", Signals)
    settings: tuple[str, ...] = ()
    life: Life | None = None

    def __post_init__(self) -> None:
        """Raises InputError if a value is out of its range, or excluded by another value."""
        try:
            check(self)
        except ValueError as error:
            raise InputError(str(error)) from error
        if not isinstance(self.settings, tuple) or not all(
            isinstance(word, str) for word in self.settings
        ):
            raise InputError(f"settings must be words NAME=VALUE, got {shown(self.settings)}")
        printed = self.nose == "printed"
        warp, kinematic = self.physics == "warp", self.body == "kinematic"
        numba = self.backend == "numba"
        excluded = {
            "a brain that uses the maximal smell needs the nose 'inverse'": (
                printed and (self.brain.raw_signals or self.brain.raw_reward)
            ),
            "raw signals need the nose 'inverse'": printed and self.signals == "raw",
            "only the body 'kinematic' or the physics 'warp' can be simulated on a GPU": (
                self.device != "cpu" and not kinematic and not warp
            ),
            "the physics 'warp' needs the body 'mujoco'": warp and kinematic,
            "the backend 'numba' does not compute on a GPU or in Warp": numba and self.on_tensors,
            "the backend 'numba' compiles the paper's brain only, unlike this one, in MuJoCo": (
                numba and not kinematic and not self.brain.compilable
            ),
            "kinematics need the body 'kinematic'": (
                not kinematic and self.kinematics != Kinematics()
            ),
            "the motor torque needs the body 'mujoco' and a motor speed": (
                self.motor_torque != "constant" and (kinematic or self.motor_speed is None)
            ),
        }
        for sentence, wrong in excluded.items():
            if wrong:
                raise InputError(sentence)

    @property
    def on_tensors(self) -> bool:
        """Whether robots and brains share tensors of a device, see `tasks.tensors`."""
        return self.device != "cpu" or self.physics == "warp"

    @property
    def brain_name(self) -> str:
        """Name of the most similar named brain, followed by the parameters that differ from it."""
        overrides = {name: overrides_of(self.brain, named) for name, named in BRAINS.items()}
        closest = min(overrides, key=lambda name: len(overrides[name]))
        return " ".join([closest, *overrides[closest]])

    @property
    def rehearsal(self) -> str:
        """Text about the scale of all durations; empty for a scale of 1."""
        return "" if self.time_scale == 1 else f"all durations times {self.time_scale:g}"

    def life_of(self, name: str) -> Life:
        """Returns a life with scaled durations; raises InputError if there is no such life."""
        lives = {**LIVES, **({self.life.name: self.life} if self.life else {})}
        try:
            return life_named(name, lives).scaled(self.time_scale)
        except KeyError:
            life, at, _ = name.partition("@")
            if at and life in lives:
                phases = f"the phases 1 to {len(lives[life].phases)}"
                raise InputError(f"the life {life} has {phases}, got {shown(name)}") from None
            raise InputError(f"there is no life {shown(name)}; {nearest(name, lives)}") from None

    def robot_seconds(self, steps: int) -> float:
        """Returns the simulated seconds of `steps` control steps, summed over a cohort's robots."""
        return steps * self.cohort_size * CONTROL_TIMESTEP

    def batch(self, life: str, robots: int, edits: Sequence[Edit] = ()) -> Robots:
        """Returns robots in lockstep on the host, with the body of the experiment.

        MuJoCo in C simulates the body "mujoco". `runs.device` moves a cohort's robots to a GPU or
        to Warp afterwards; films and figures use these robots as they are.

        Args:
          life: Name of a life, or of a task of the domain "arena".
          robots: Number B of robots.
          edits: Functions that change the arena's MjSpec in place, called after the task's own.
        """
        task = life if life in TASKS else self.life_of(life).task
        if self.nose_place == "centre":
            edits = (*edits, centre_nose)
        if self.motor_torque == "scaled":
            edits = (*edits, scale_torque)
        shared: Any = {"nose": self.nose, "motor_speed": self.motor_speed, "edits": edits}
        if self.body == "kinematic":
            return make_kinematic_batch(task, robots, self.kinematics, **shared)
        return make_batch(task, robots, **shared)


def changed(experiment: Experiment, values: Mapping[str, Any]) -> Experiment:
    """Returns an experiment with other values of some fields, such as "seed" or "brain.epsilon".

    Raises:
      InputError: a value is invalid.
    """
    fields = {name: value for name, value in values.items() if "." not in name}
    inner: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        part, dotted, own = name.partition(".")
        if dotted:
            inner.setdefault(part, {})[own] = value
    try:
        for part, own in inner.items():
            fields[part] = dataclasses.replace(fields.get(part, getattr(experiment, part)), **own)
        return dataclasses.replace(experiment, **fields)
    except ValueError as error:
        raise InputError(str(error)) from error


def overrides_of(numbers: Parameters | Kinematics, reference: Parameters | Kinematics) -> list[str]:
    """Returns the words NAME=VALUE that turn `reference` into `numbers`."""
    theirs = dataclasses.asdict(reference)
    return [
        f"{name}={value if isinstance(value, str) else json.dumps(value, separators=(',', ':'))}"
        for name, value in dataclasses.asdict(numbers).items()
        if value != theirs[name]
    ]


def differing(ours: Experiment, other: Experiment) -> dict[str, tuple[Any, Any]]:
    """Returns both values of each field in which two experiments differ, by dotted name.

    A life is given by its name.
    """
    first, second = (flat(dataclasses.asdict(one) | {"life": one.life}) for one in (ours, other))
    found = {name: (first[name], second[name]) for name in first if first[name] != second[name]}
    if "life" in found:
        found["life"] = (ours.life and ours.life.name, other.life and other.life.name)
    return found


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Returns nested values by dotted name, such as "brain.noise" or "life.phases.1.minutes"."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        inner = value
        if isinstance(value, list) and value and isinstance(value[0], dict):
            inner = {str(number): one for number, one in enumerate(value, 1)}
        if isinstance(inner, dict):
            found |= flat(inner, f"{prefix}{name}.")
        else:
            found[f"{prefix}{name}"] = value
    return found


def experiment_from(fields: Mapping[str, Any]) -> Experiment:
    """Returns the experiment whose fields were stored as JSON.

    Raises:
      KeyError, TypeError: the fields are not those of an experiment.
      InputError: a value is invalid.
    """
    brain, life = dict(fields["brain"]), fields.get("life")
    brain["fixed_motors"] = tuple(brain["fixed_motors"])
    kinematics, settings = Kinematics(**fields["kinematics"]), tuple(fields["settings"])
    parts: Any = {"brain": Parameters(**brain), "kinematics": kinematics, "settings": settings}
    parts["life"] = None if life is None else life_from(life)
    return Experiment(**{**fields, **parts})
