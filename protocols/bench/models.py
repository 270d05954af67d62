"""Times a physics step of several models, and `env.step` of several environments."""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Callable
from pathlib import Path
from statistics import mean, median

import mujoco
import numpy as np
from dm_control.rl.control import Environment
from dm_control.suite import point_mass

from ... import tasks
from ...models import arena_spec
from ...tasks import CONTROL_TIMESTEP
from ..errors import RunError

# The structure and the degrees of freedom of MuJoCo's model/car/car.xml, with other numbers: a
# free chassis (a mesh) with a ball in front, two cylinder wheels on damped hinges, motors on
# the tendons "forward" and "turn", two joint torque sensors, two lights, four ornaments and an
# infinite floor. Timestep, integrator, solver and flags are MuJoCo's defaults.
CAR = """
<mujoco model="car-like">
  <compiler autolimits="true"/>
  <asset>
    <texture name="floor" type="2d" builtin="checker" rgb1=".8 .8 .75" rgb2=".7 .7 .65" width="256" height="256"/>
    <material name="floor" texture="floor" texrepeat="2 2" texuniform="true" reflectance=".1"/>
    <mesh name="wedge" vertex="-.11 .05 -.012  -.11 -.05 -.012  -.10 .06 .014  -.10 -.06 .014  -.04 0 .034
                               .10 .02 -.013  .10 -.02 -.013  .095 .012 .004  .095 -.012 .004"/>
  </asset>
  <default>
    <joint damping=".025" actuatorfrcrange="-.5 .5"/>
    <geom rgba=".85 .55 .15 1"/>
    <default class="wheel">
      <geom type="cylinder" size=".032 .009" rgba=".15 .15 .17 1"/>
      <site type="box" rgba=".9 .9 .85 1"/>
    </default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="4 4 .02" material="floor"/>
    <body name="chassis" pos="0 0 .032">
      <freejoint name="chassis"/>
      <light name="above" pos="0 0 1.5" mode="trackcom" diffuse=".5 .5 .5"/>
      <light name="headlight" pos=".11 0 .015" dir="3 0 -1" diffuse=".8 .8 .7"/>
      <geom name="wedge" type="mesh" mesh="wedge"/>
      <geom name="ball" type="sphere" size=".014" pos=".085 0 -.018" condim="1" priority="1"/>
      <body name="left" pos="-.065 .065 0" zaxis="0 1 0" childclass="wheel">
        <joint name="left"/>
        <geom name="left"/>
        <site name="left_spoke" size=".005 .026 .0105"/>
        <site name="left_cross" size=".026 .005 .0105"/>
      </body>
      <body name="right" pos="-.065 -.065 0" zaxis="0 1 0" childclass="wheel">
        <joint name="right"/>
        <geom name="right"/>
        <site name="right_spoke" size=".005 .026 .0105"/>
        <site name="right_cross" size=".026 .005 .0105"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="forward"><joint joint="left" coef=".5"/><joint joint="right" coef=".5"/></fixed>
    <fixed name="turn"><joint joint="left" coef="-.5"/><joint joint="right" coef=".5"/></fixed>
  </tendon>
  <actuator>
    <motor name="forward" tendon="forward" ctrlrange="-1 1"/>
    <motor name="turn" tendon="turn" ctrlrange="-1 1"/>
  </actuator>
  <sensor>
    <jointactuatorfrc name="left" joint="left"/>
    <jointactuatorfrc name="right" joint="right"/>
  </sensor>
</mujoco>
"""  # noqa: E501

_ENDLESS = 10**9  # time limit of an episode in [s]
OURS, SENSELESS, LIKE_CAR, CAR_XML = "ours", "ours, sensors off", "car-like", "MuJoCo's car.xml"


def car_xml() -> Path | None:
    """Returns the file of MuJoCo's own car, where MuJoCo is usually unpacked; None without one."""
    places = [Path(mujoco.__file__).parent, Path("/usr/share/mujoco"), Path("/usr/local/mujoco")]
    places += sorted(Path("/opt").glob("mujoco*")) + sorted(Path.home().glob(".mujoco/mujoco*"))
    for place in places:
        if (found := place / "model" / "car" / "car.xml").exists():
            return found
    return None


@dataclasses.dataclass(frozen=True)
class StepCost:
    """Time of a model's physics step, and the size of the model.

    Attributes:
      name: Name of the model.
      timestep: Integration timestep in [s].
      freedoms: Number of degrees of freedom.
      geoms: Number of geoms.
      sensors: Number of sensors that a physics step evaluates.
      contacts: Mean number of contacts in a physics step.
      rows: Mean number of constraint rows in a physics step.
      seconds: Mean duration of a physics step in [s], one value for each round.
    """

    name: str
    timestep: float
    freedoms: int
    geoms: int
    sensors: int
    contacts: float
    rows: float
    seconds: tuple[float, ...]

    def ratio(self, other: StepCost) -> float:
        """Returns the median, over rounds, of this model's time divided by the other model's."""
        return median(a / b for a, b in zip(self.seconds, other.seconds, strict=True))


class ModelTimer:
    """Times a model under random controls, drawn for every control step of 0.1 s."""

    def __init__(self, name: str, model: mujoco.MjModel, *, sensors: bool = True) -> None:
        """Sets the model to its initial state.

        Args:
          name: Name of the model.
          model: Compiled model.
          sensors: Whether sensors are evaluated.
        """
        self._name, self._model = name, model
        if not sensors:
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR.value
        self._sensors = model.nsensor if sensors else 0
        self._data = mujoco.MjData(model)
        self._random = np.random.default_rng(1)
        self._substeps = round(CONTROL_TIMESTEP / model.opt.timestep)
        self._seconds: list[float] = []
        self._contacts: list[tuple[int, int]] = []

    def run(self, steps: int) -> None:
        """Times a round of at least `steps` physics steps."""
        count = -(-steps // self._substeps)
        low, high = self._model.actuator_ctrlrange.T
        controls = self._random.uniform(low, high, (count, self._model.nu))
        total = 0.0
        for control in controls:
            self._data.ctrl[:] = control
            began = time.perf_counter()
            mujoco.mj_step(self._model, self._data, self._substeps)
            total += time.perf_counter() - began
            self._contacts.append((self._data.ncon, self._data.nefc))
        self._seconds.append(total / (count * self._substeps))

    def cost(self) -> StepCost:
        """Returns the time of a step in all rounds but the first, which warms up."""
        contacts, rows = map(mean, zip(*self._contacts, strict=True))
        model = self._model
        return StepCost(
            self._name,
            model.opt.timestep,
            model.nv,
            model.ngeom,
            self._sensors,
            contacts,
            rows,
            tuple(self._seconds[1:]),
        )


def step_costs(own_car: mujoco.MjModel | None, rounds: int, steps: int) -> dict[str, StepCost]:
    """Times our model with and without sensors, and a car-like model, in alternation.

    Args:
      own_car: MuJoCo's own car, which is timed as well; None for no such model.
      rounds: Number of timed rounds, after an additional round to warm up.
      steps: Minimum number of physics steps in a round.

    Returns:
      Times of a physics step by the name of the model.
    """
    timers = [
        ModelTimer(OURS, arena_spec().compile()),
        ModelTimer(SENSELESS, arena_spec().compile(), sensors=False),
        ModelTimer(LIKE_CAR, mujoco.MjModel.from_xml_string(CAR)),
    ]
    if own_car is not None:
        timers.append(ModelTimer(CAR_XML, own_car))
    for _ in range(rounds + 1):
        for timer in timers:
            timer.run(steps)
    costs = [timer.cost() for timer in timers]
    return {cost.name: cost for cost in costs}


@dataclasses.dataclass(frozen=True)
class EnvironmentCost:
    """Time of `env.step`, and of its physics steps alone.

    Attributes:
      name: Name of the environment.
      substeps: Number of physics steps in an `env.step`.
      step: Mean duration of `env.step` in [s]; one value for each round.
      bare: Time in [s] that MuJoCo alone needs for all physics steps of one `env.step`; mean of
        each round.
    """

    name: str
    substeps: int
    step: tuple[float, ...]
    bare: tuple[float, ...]

    @property
    def overhead_us(self) -> float:
        """Median time of `env.step` outside the physics in [us]."""
        return 1e6 * median(a - b for a, b in zip(self.step, self.bare, strict=True))


class EnvironmentTimer:
    """Times an environment under random actions, and its physics repeated by bare MuJoCo.

    Attributes:
      name: Name of the environment.
      substeps: Number of physics steps in an `env.step`.
    """

    def __init__(self, name: str, environment: Environment) -> None:
        """Starts an episode that does not end."""
        self.name = name
        self._environment = environment
        environment.reset()
        physics = environment.physics
        self._model, self._data = physics.model.ptr, physics.data.ptr
        self._bare_data = mujoco.MjData(self._model)
        self.substeps = round(environment.control_timestep() / self._model.opt.timestep)
        self._advance = _physics_steps(physics.legacy_step, self.substeps)
        self._random = np.random.default_rng(1)
        self._actions = np.empty((0, self._model.nu))

    def step(self, count: int) -> float:
        """Returns the mean duration of `count` calls of `env.step` in [s]."""
        spec = self._environment.action_spec()
        self._actions = self._random.uniform(spec.minimum, spec.maximum, (count, *spec.shape))
        mujoco.mj_copyData(self._bare_data, self._model, self._data)
        total = 0.0
        for action in self._actions:
            began = time.perf_counter()
            self._environment.step(action)
            total += time.perf_counter() - began
        return total / count

    def bare(self) -> float:
        """Returns the mean duration in [s] of the physics steps in `env.step`, simulated alone.

        Raises:
          RunError: MuJoCo alone ended in other positions than the environment.
        """
        model, data = self._model, self._bare_data
        total = 0.0
        for action in self._actions:
            data.ctrl[:] = action
            began = time.perf_counter()
            self._advance(model, data)
            total += time.perf_counter() - began
        if not np.array_equal(data.qpos, self._data.qpos):
            raise RunError(f"the bare physics did not end in the positions of {self.name}")
        return total / len(self._actions)


def _physics_steps(legacy: bool, substeps: int) -> Callable[[mujoco.MjModel, mujoco.MjData], None]:
    if not legacy:
        return lambda model, data: mujoco.mj_step(model, data, substeps)
    if substeps > 1:
        raise ValueError(f"a legacy step must have 1 substep, got {substeps}")

    def steps(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        mujoco.mj_step2(model, data)
        mujoco.mj_step1(model, data)

    return steps


def environment_costs(rounds: int, steps: int) -> list[EnvironmentCost]:
    """Times `env.step` of our tasks and of dm_control's point_mass, and their physics alone.

    Args:
      rounds: Number of timed rounds, after an additional round to warm up.
      steps: Number of calls of `env.step` in a round.
    """
    timers = [
        EnvironmentTimer(task, tasks.load("arena", task, task_kwargs={"random": 1}))
        for _, task in tasks.PAPER
    ]
    timers.append(EnvironmentTimer("point_mass", point_mass.easy(time_limit=_ENDLESS, random=1)))
    seconds: dict[str, list[tuple[float, float]]] = {timer.name: [] for timer in timers}
    for turn, timer in itertools.product(range(rounds + 1), timers):
        pair = timer.step(steps), timer.bare()
        if turn:  # the first round warms up
            seconds[timer.name].append(pair)
    return [
        EnvironmentCost(timer.name, timer.substeps, *zip(*seconds[timer.name], strict=True))
        for timer in timers
    ]
