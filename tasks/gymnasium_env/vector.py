"""A batch of robots with Gymnasium's interface."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from dm_control.mujoco.wrapper import MjModel
from dm_control.rl.control import PhysicsError
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from ...models.physics import Physics
from ..batch import Batch, CapacityError
from ..episode import (
    NOT_RUNNING,
    Stage,
    check_counts,
    check_stage,
    check_state,
    check_stream_state,
    checked_length,
    set_stream_state,
    stream_state,
    whole_number,
)
from ..lives import Leg, place
from ..sensors import Nose
from ..starts import Start, random_spots
from .common import (
    FPS,
    PICTURE,
    check_render_mode,
    checked_task,
    final_info,
    life_info,
    picture_of,
    spaces,
)

_Timestep = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]


class ArenaVectorEnv(gymnasium.vector.VectorEnv):
    """A batch of B robots, each with its own seed, bit-exactly equal to B instances of `ArenaEnv`.

    With `backend="warp"`, they are equal up to rounding in single precision.

    Actions beyond the limits are clipped; an action that is not finite raises ValueError.
    """

    metadata = {
        "autoreset_mode": AutoresetMode.NEXT_STEP,
        "render_modes": ["rgb_array"],
        "render_fps": FPS,
    }

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int = 0,
        render_mode: str | None = None,
        **kwargs: Any,
    ) -> None:
        """Initialises the batch.

        Args:
          task: Name of a task, such as "wall_avoidance", see `musebot.ALL_TASKS`; or "life", which
            needs the keyword `life`.
          num_envs: Number of robots, B.
          max_episode_steps: Length of an episode in control steps; None or -1 for endless ones.
          autoreset_mode: Start of the next episode. NEXT_STEP: the next call of `step` starts
            it, ignores the action, and returns the first observation with a reward of 0.
            SAME_STEP: the call that ends an episode starts the next, and returns the last
            observation as `info["final_obs"]`. DISABLED: the caller resets the robots whose
            episodes have ended, with `reset(options={"reset_mask": mask})`.
          threads: Number of threads that step the physics; 0 for the calling thread. Results do
            not depend on it.
          render_mode: "rgb_array" for pictures by `render`; None for no pictures.
          **kwargs: Keywords of the task (`robot`, `spot`, `nose`, `life`, see `ArenaEnv`), of its
            pictures (`camera`, `width`, `height`, see `ArenaEnv`), and `backend`: "mujoco", or
            "warp" for MuJoCo Warp on the default device of PyTorch, in single precision.

        Raises:
          ModuleNotFoundError: MuJoCo Warp is not installed.
          TypeError: A keyword is unknown.
          ValueError: There is no such task, or a value is out of range.
        """
        picture = {name: kwargs.pop(name, usual) for name, usual in PICTURE.items()}
        backend = kwargs.pop("backend", "mujoco")
        definition = checked_task(task, kwargs)
        if backend not in ("mujoco", "warp"):
            raise ValueError(f"backend must be 'mujoco' or 'warp', got {backend!r:.60}")
        if backend == "warp" and threads:
            raise ValueError(f"threads are of the backend 'mujoco' only, got {threads!r:.60}")
        check_render_mode(render_mode, self.metadata["render_modes"])
        steps = checked_length(max_episode_steps)
        self.num_envs = whole_number("num_envs", num_envs, 1)
        self._mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self._mode}
        nose = kwargs.pop("nose", "inverse")
        if backend == "warp" and definition.life:
            raise ValueError("a life needs the backend 'mujoco', got 'warp'")
        model = definition.spec().compile()
        rules = definition.rules.of(model, nose)
        if backend == "warp":
            from ..tensors.warp import WarpBatch

            self._batch: Batch = WarpBatch(model, rules, num_envs)
        else:
            self._batch = Batch(model, rules, num_envs, threads=threads)
        start, size = Start(**kwargs), self._batch.dimensions
        self._episode = definition.episode(start, size, steps, rules, nose)
        self.single_observation_space, self.single_action_space = spaces(rules, definition.limit)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.render_mode = render_mode
        self._picture = picture_of(self._batch.model, **picture)
        self._painter: Physics | None = None
        self._stage: Stage = "new"
        self._first_spots = self._batch.spot  # of the model
        self._nose = Nose(spot_radius=self._batch.dimensions.spot_radius)
        streams = [seeding.np_random() for _ in range(num_envs)]
        self._randoms, self._seeds = map(list, zip(*streams, strict=True))
        self._steps = np.zeros(num_envs, dtype=np.int64)  # so far in each robot's episode
        self._counts = np.zeros((2, num_envs), dtype=np.int64)  # of them in contact, in the spot
        self._reached = np.zeros(num_envs, dtype=bool)  # whether the last step did, in a life
        self._over = np.zeros(num_envs, dtype=bool)

    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Random stream of every robot."""
        return tuple(self._randoms)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Seed of every robot's random stream."""
        return tuple(self._seeds)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Returns an attribute of every robot, such as an entry of `INFO` or a space.

        Raises AttributeError where robots of a batch have no such attribute.
        """
        found = {own: entry for own, entry in self._info().items() if own[0] != "_"}
        found |= {"np_random": self._randoms, "np_random_seed": self._seeds}
        shared = {
            "action_space": self.single_action_space,
            "observation_space": self.single_observation_space,
            "model": self._batch.model,
            **{own: getattr(self, own) for own in ("metadata", "render_mode", "spec")},
        }
        found |= {own: (value,) * self.num_envs for own, value in shared.items()}
        if name not in found:
            raise AttributeError(f"robots of a batch have {sorted(found)}, got {name!r}")
        return tuple(found[name])

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts an episode of every robot, or of some.

        Args:
          seed: A list of one seed per robot; or one number s, which gives robot k (from 0) the
            seed s + k. A robot whose seed is None continues its random stream.
          options: Dictionary with the places of `robot` and `spot` at the start, and
            `reset_mask`, an array of B Booleans, True for each robot that starts an episode. All
            robots (default) must start at the first reset, after a PhysicsError and in a life.

        Returns the observations of all robots, shape (B, S), and the entries of `INFO`. Raises
        TypeError for an unknown option, ValueError for a wrong number of seeds, a wrong mask or an
        impossible place, gymnasium.error.Error for a negative seed, RuntimeError after `close`.
        """
        check_stage(self._stage, "closed")
        places = dict(options or {})
        mask = self._mask(places.pop("reset_mask", None))
        start = self._episode.start_with(places)
        if isinstance(seed, int | np.integer):
            seed = [int(seed) + k for k in range(self.num_envs)]
        seeds = [None] * self.num_envs if seed is None else list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"there must be {self.num_envs} seeds, got {len(seeds)}")
        # All streams are made before the first is kept: a seed may be refused.
        made = {
            robot: seeding.np_random(own)
            for robot, own in enumerate(seeds)
            if mask[robot] and own is not None
        }
        for robot, pair in made.items():
            self._randoms[robot], self._seeds[robot] = pair
        self._begin(np.flatnonzero(mask), start)
        self._over[mask] = False
        self._stage = "running"
        return self._observations(), self._info(mask)

    def step(self, actions: np.ndarray) -> _Timestep:
        """Simulates 0.1 s for the robots' left and right actions, shape (B, 2).

        Returns:
          Observations (B, S), rewards (B,), terminations (B,), truncations (B,) and a dictionary:
          the entries of `INFO`, each an array with a row for every robot; with SAME_STEP, also the
          last observations and entries of episodes that ended.

        Raises:
          ValueError: The actions have another shape, or are not finite.
          PhysicsError: A robot's simulation became unstable; then all must be reset.
          RuntimeError: There was no reset; the batch is closed; or, with AutoresetMode.DISABLED, a
            robot was not reset after its episode had ended.
        """
        check_stage(self._stage, *NOT_RUNNING)
        starting = np.flatnonzero(self._over)  # never with SAME_STEP
        motors = self._episode.batch_motors(actions, self.num_envs, starting)
        if len(starting) and self._mode is AutoresetMode.DISABLED:
            raise RuntimeError(
                f"reset must be called with a reset_mask of the robots {starting.tolist()}, "
                "whose episodes have ended"
            )
        rewards = self._simulate(motors)
        if len(starting):  # for these robots, the call is no step of an episode
            self._begin(starting, self._episode.start)
            rewards[starting] = 0.0
        elif leg := self._episode.leg_from(int(self._steps[0])):  # all begin a life together
            self._enter(leg, np.arange(self.num_envs))
        self._over = self._steps >= self._episode.steps
        truncations, observations, info = self._over.copy(), self._observations(), {}
        if self._mode is AutoresetMode.SAME_STEP and self._over.any():
            info = final_info(observations, self._over.copy(), self._info(self._over))
            self._begin(np.flatnonzero(self._over), self._episode.start)
            self._over[:] = False
            observations = self._observations()
        info |= self._info()
        return observations, rewards, np.zeros(self.num_envs, dtype=bool), truncations, info

    def _simulate(self, motors: np.ndarray) -> np.ndarray:
        """Simulates a control step, counts it and its events, and returns rewards, shape (B,)."""
        batch = self._batch
        for robot in np.flatnonzero(self._episode.jumps(self._steps) & ~self._over).tolist():
            spot = random_spots(self._randoms[robot], batch.dimensions, 1)
            batch.place_spot(np.array([robot]), spot)
        try:
            batch.step(motors)
        except CapacityError as error:
            self._stage = "failed"
            raise PhysicsError(str(error)) from error
        self._check_sound(batch.valid)
        self._steps += 1
        self._counts += self._events()
        self._reached = self._reaches()
        return batch.rules.checked_reward(batch.sensordata).astype(float)

    def _check_sound(self, sound: Any) -> None:
        """Raises PhysicsError unless `sound`, Booleans of shape (B,), is True for all robots."""
        if not sound.all():
            self._stage = "failed"
            broken = np.flatnonzero(~sound).tolist()
            raise PhysicsError(f"the simulation of the robots {broken} became unstable")

    def render(self, robots: Sequence[int] | None = None) -> tuple[np.ndarray, ...] | None:  # type: ignore[override]
        """Returns pictures of robots, for `render_mode="rgb_array"`: (height, width, 3) each.

        `robots` are their numbers; None for all. Raises IndexError where there is no such robot,
        RuntimeError where the batch is closed.
        """
        check_stage(self._stage, "closed")
        if self.render_mode != "rgb_array":
            return None
        batch = self._batch
        if self._painter is None:
            self._painter = Physics.from_model(MjModel(copy.copy(batch.model)))
        physics, pictures = self._painter, []
        for robot in range(self.num_envs) if robots is None else robots:
            batch.show(robot, physics.data.ptr)
            pictures.append(physics.render(**self._picture))
        return tuple(pictures)

    def close_extras(self, **kwargs: Any) -> None:
        """Frees the renderer; the batch cannot be used any more."""
        self._stage = "closed"
        if self._painter is not None:
            self._painter.free()
            self._painter = None

    def get_state(self) -> dict[str, Any]:
        """Returns everything that the next steps depend on; RuntimeError unless running."""
        check_stage(self._stage, *NOT_RUNNING)
        return self._state()

    def _state(self) -> dict[str, Any]:
        return {
            "task": self._episode.task,
            "batch": self._batch.get_state(),
            "randoms": [stream_state(random) for random in self.np_random],
            "seeds": list(self._seeds),
            "steps": self._steps.copy(),
            "counts": self._counts.copy(),
            "reached": self._reached.copy(),
            "over": self._over.copy(),
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restores what `get_state` returned, here or for equally many robots in the same task.

        Raises ValueError for a state of another task or number of robots, or of robots that do not
        stand in the arena; nothing has changed then. Raises RuntimeError where the batch is closed.
        """
        check_stage(self._stage, "closed")
        self._check_state(state)
        for random, one in zip(self.np_random, state["randoms"], strict=True):
            set_stream_state(random, one)
        self._batch.set_state(state["batch"])
        self._seeds = list(state["seeds"])
        self._steps, self._counts, self._reached, self._over = (
            state[name].copy() for name in ("steps", "counts", "reached", "over")
        )
        if self._episode.life:
            self._batch.enter(self._episode.leg_of(int(self._steps[0])).phase.world)
        self._stage = "running"

    def _check_state(self, state: Mapping[str, Any]) -> None:
        check_state(state, self._state())
        batch = state["batch"]
        check_state(batch, self._batch.arrays())
        self._batch.dimensions.check_standing(batch["state"], *batch.values())
        if not batch["valid"].all():
            raise ValueError(f"state['batch']['valid'] must be all True, got {batch['valid']}")
        check_counts("steps", state["steps"], [self._episode.most_steps] * self.num_envs)
        for counts in state["counts"]:
            check_counts("counts", counts, state["steps"])
        if self._episode.life and (state["steps"] != state["steps"][0]).any():
            raise ValueError(f"state['steps'] of a life must be equal, got {state['steps']}")
        check_counts("seeds", state["seeds"], [math.inf] * self.num_envs)
        for random, one in zip(self.np_random, state["randoms"], strict=True):
            check_stream_state(random, one)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_painter": None}

    def _mask(self, mask: Any) -> np.ndarray:
        """Returns the robots that a reset starts, shape (B,)."""
        if mask is None:
            return np.ones(self.num_envs, dtype=bool)
        kind = isinstance(mask, np.ndarray) and mask.dtype == bool
        if not kind or mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(
                f"reset_mask must be an array of {self.num_envs} Booleans, one of them True, "
                f"got {mask!r:.200}"
            )
        if self._stage != "running" and not mask.all():
            raise ValueError(
                f"reset_mask must be True for all robots before an episode is under way, got {mask}"
            )
        if self._episode.life and not mask.all():
            raise ValueError(
                f"robots of a life begin together: all must be in reset_mask, got {mask}"
            )
        return mask.copy()

    def _begin(self, robots: np.ndarray, start: Start) -> None:
        """Starts an episode of some robots, with starts drawn from their own streams."""
        self._batch.valid[robots] = True  # a robot that was stopped starts again
        if leg := self._episode.leg_from(0):
            self._batch.place_spot(robots, self._first_spots[robots])
            self._enter(leg, robots)
            if leg.phase.robot is None:
                self._batch.place(robots, np.zeros((len(robots), 3)))
        else:
            starts = [start.draw(self._randoms[robot], self._batch.dimensions) for robot in robots]
            poses, spots = map(np.stack, zip(*starts, strict=True))
            self._batch.place_spot(robots, spots)
            self._batch.place(robots, poses)
        self._check_sound(np.isfinite(self._batch.sensordata).all(axis=1))
        self._steps[robots] = 0
        self._counts[:, robots] = 0
        self._reached[robots] = self._reaches()[robots]

    def _enter(self, leg: Leg, robots: np.ndarray) -> None:
        """Begins a stretch of a life, with places drawn from the robots' own streams."""
        for robot in robots.tolist():
            place(self._batch, leg.phase, self._randoms[robot], np.array([robot]))

    def _observations(self) -> np.ndarray:
        return self._batch.rules.state(self._batch.sensordata).astype(np.float32)

    def _events(self) -> np.ndarray:
        """Returns which robots are in contact, and which in the spot, shape (2, B)."""
        readings, layout = self._batch.sensordata, self._batch.rules.layout
        touched = readings[:, layout.touch][:, 0] > 0
        return np.stack([touched, self._nose.inside(readings[:, layout.smell])])

    def _reaches(self) -> np.ndarray:
        """Returns whether each robot reaches what its world rewards, shape (B,)."""
        if not self._episode.life:
            return self._reached
        return self._batch.rules.event(self._batch.sensordata).astype(bool)

    def _info(self, robots: np.ndarray | None = None) -> dict[str, Any]:
        """Returns the entries of `INFO`, each with a mask, as Gymnasium's own batches do.

        With `robots`, a mask of shape (B,), the entries of the others are 0.
        """
        pose, (contact, in_spot) = self._batch.pose, self._events()
        entries = {
            "position": pose[:, :2],
            "heading": pose[:, 2],
            "spot": self._batch.spot,
            "contact": contact,
            "in_spot": in_spot,
            "contact_steps": self._counts[0].copy(),
            "in_spot_steps": self._counts[1].copy(),
        }
        if self._episode.life:
            own = life_info(self._episode, int(self._steps[0]), self._reached.copy())
            entries |= {name: np.full(self.num_envs, value) for name, value in own.items()}
        mask = np.ones(self.num_envs, dtype=bool) if robots is None else robots.copy()
        if robots is not None:
            entries = {name: (entry.T * robots).T for name, entry in entries.items()}
        return entries | {f"_{name}": mask for name in entries}
