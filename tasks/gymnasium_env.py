"""The tasks as Gymnasium environments: one robot, or a batch of robots.

`musebot.register_gymnasium` registers both. Observations are the task's signals concatenated in
the order of docs/tasks.md; observations and actions are 32-bit floats. Episodes never terminate;
they are truncated after 1,000 steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from dm_control.rl.control import PhysicsError
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from ..models.rendering import no_window
from .arena import CONTROL_TIMESTEP, TaskDefinition, check_keywords, checked_actions
from .rules import Rules
from .starts import Start, random_spots
from .suite import load, make_batch, task_definition

_FPS = round(1 / CONTROL_TIMESTEP)


def _spaces(rules: type[Rules], limit: float) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    """Returns the spaces of a robot's observations, shape (S,), and actions, shape (2,)."""
    low, high = (
        np.concatenate(
            [np.full(shape[0], shape[end], np.float32) for shape in rules.shapes.values()]
        )
        for end in (1, 2)
    )
    return gymnasium.spaces.Box(low, high), gymnasium.spaces.Box(-limit, limit, (2,))


def _checked(task: str, kwargs: dict[str, Any]) -> TaskDefinition:
    definition = task_definition(task)
    check_keywords(f"task {task!r}", kwargs, definition.keywords)
    return definition


class ArenaEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """The dm_control environment of one robot with Gymnasium's interface.

    Actions beyond the limits are clipped; an action that is not finite raises ValueError.
    """

    metadata = {
        "render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"],
        "render_fps": _FPS,
    }

    def __init__(
        self,
        task: str,
        *,
        render_mode: str | None = None,
        camera: str = "overhead",
        width: int = 480,
        height: int = 320,
        **kwargs: Any,
    ) -> None:
        """Initialises the environment.

        Args:
          task: Name of a task, see `musebot.ALL_TASKS`.
          render_mode: "rgb_array", "depth_array", "rgbd_tuple", "human" for a window, or None.
          camera: Name of the camera: "overhead", "corner", "follow" or "eye".
          width: Width of the picture in pixels.
          height: Height of the picture in pixels.
          **kwargs: Keywords of the task: `robot`, `spot`, `nose` (see `arena.Settings`).

        Raises:
          TypeError: A keyword is unknown.
          ValueError: There is no such task, or a value is out of range.
          RuntimeError: The mode is "human", and no window can be opened.
        """
        definition = _checked(task, kwargs)
        if render_mode not in (None, *self.metadata["render_modes"]):
            modes = self.metadata["render_modes"]
            raise ValueError(f"render_mode must be one of {modes} or None, got {render_mode!r}")
        if render_mode == "human" and (reason := no_window()):
            raise RuntimeError(f"{reason}; render_mode='rgb_array' needs no display")
        # Gymnasium's wrapper TimeLimit counts the steps of an episode.
        self._environment = load("arena", task, {**kwargs, "time_limit": float("inf")})
        self.observation_space, self.action_space = _spaces(definition.rules, definition.limit)
        self.render_mode = render_mode
        model = self._environment.physics.model.ptr
        cameras = [model.camera(k).name for k in range(model.ncam)]
        if camera not in cameras:
            raise ValueError(f"camera must be one of {cameras}, got {camera!r}")
        self._picture = camera, width, height
        self.mujoco_renderer: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts an episode; returns the observation, shape (S,), and an empty dictionary."""
        super().reset(seed=seed)
        self._environment.task.reseed(self.np_random)
        timestep = self._environment.reset()
        self._show()
        return _state(timestep.observation), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Simulates 0.1 s.

        Args:
          action: Left and right action within `action_space`, shape (2,).

        Returns:
          Observation (S,), reward, termination (False), truncation (False) and an empty
          dictionary.
        """
        timestep = self._environment.step(action)
        self._show()
        return _state(timestep.observation), timestep.reward, False, False, {}

    def render(self) -> Any:
        """Draws the window, or returns a picture.

        Returns:
          "rgb_array": uint8, shape (height, width, 3). "depth_array": OpenGL's depth in [0, 1],
          shape (height, width). "rgbd_tuple": both. "human": None.

        Raises:
          RuntimeError: OpenGL cannot be opened here.
        """
        if self.render_mode is None:
            return None
        if self.mujoco_renderer is None:
            from ..models.gymnasium_renderer import ArenaRenderer

            physics = self._environment.physics
            self.mujoco_renderer = ArenaRenderer(
                physics.model.ptr, physics.data.ptr, *self._picture
            )
        return self.mujoco_renderer.render(self.render_mode)

    def close(self) -> None:
        """Closes the window, and frees the renderer."""
        if self.mujoco_renderer is not None:
            self.mujoco_renderer.close()
            self.mujoco_renderer = None
        self._environment.physics.free()

    def _show(self) -> None:
        if self.render_mode == "human":
            self.render()


class ArenaVectorEnv(gymnasium.vector.VectorEnv):
    """A batch of B robots, each with its own seed, bit-exactly equal to B instances of `ArenaEnv`.

    Actions beyond the limits are clipped; an action that is not finite raises ValueError.
    """

    metadata = {
        "autoreset_mode": AutoresetMode.NEXT_STEP,
        "render_modes": [],
        "render_fps": _FPS,
    }

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int = 0,
        **kwargs: Any,
    ) -> None:
        """Initialises the batch.

        Args:
          task: Name of a task, see `musebot.ALL_TASKS`.
          num_envs: Number of robots, B.
          max_episode_steps: Length of an episode in control steps; None or -1 for endless ones.
          autoreset_mode: Start of the next episode. NEXT_STEP: the next call of `step` starts
            it, ignores the action, and returns the first observation with a reward of 0.
            SAME_STEP: the call that ends an episode starts the next, and returns the last
            observation as `info["final_obs"]`.
          threads: Number of threads that step the physics; 0 for the calling thread. Results do
            not depend on it.
          **kwargs: Keywords of the task: `robot`, `spot`, `nose` (see `arena.Settings`); and
            `render_mode`, which must be None.

        Raises:
          TypeError: A keyword is unknown.
          ValueError: There is no such task, or a value is out of range.
        """
        render_mode = kwargs.pop("render_mode", None)
        definition = _checked(task, kwargs)
        if render_mode is not None:
            raise ValueError(f"render_mode must be None for a batch, got {render_mode!r}")
        mode = AutoresetMode(autoreset_mode)
        if mode is AutoresetMode.DISABLED:
            raise ValueError(f"autoreset_mode must be 'NextStep' or 'SameStep', got {mode.value!r}")
        self.metadata = {**self.metadata, "autoreset_mode": mode}
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = _spaces(
            definition.rules, definition.limit
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        nose = kwargs.pop("nose", "inverse")
        self._batch = make_batch(task, num_envs, nose=nose, threads=threads)
        self._start = Start(**kwargs)
        self._same_step = mode is AutoresetMode.SAME_STEP
        self._limit, self._spot_steps = definition.limit, definition.spot_steps
        endless = max_episode_steps in (None, -1)
        self._max_steps = np.inf if endless else float(max_episode_steps or 0)
        self._randoms: list[np.random.Generator] | None = None
        self._seeds: list[int] = []
        self._steps = np.zeros(num_envs, dtype=np.int64)  # so far in each robot's episode
        self._over = np.zeros(num_envs, dtype=bool)

    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Random stream of every robot."""
        return tuple(self._streams([None] * self.num_envs))

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Seed of every robot's random stream."""
        self._streams([None] * self.num_envs)
        return tuple(self._seeds)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts an episode of every robot.

        Args:
          seed: Seeds of the robots; or one seed s, which gives robot k the seed s + k. None
            continues a robot's random stream.
          options: Unused.

        Returns:
          Observations, shape (B, S), and an empty dictionary.

        Raises:
          ValueError: The number of seeds is not the number of robots.
        """
        if isinstance(seed, int | np.integer):
            seed = [int(seed) + k for k in range(self.num_envs)]
        seeds = [None] * self.num_envs if seed is None else list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"there must be {self.num_envs} seeds, got {len(seeds)}")
        self._streams(seeds)
        self._begin(np.arange(self.num_envs))
        self._over[:] = False
        return self._states(), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Simulates 0.1 s.

        Args:
          actions: Left and right action of every robot, within `action_space`, shape (B, 2).

        Returns:
          Observations (B, S), rewards (B,), terminations (B,), truncations (B,) and a dictionary
          with the last observations of episodes that SAME_STEP ended.

        Raises:
          ValueError: The actions have another shape, or are not finite.
          PhysicsError: A robot's simulation became unstable.
        """
        batch = self._batch
        motors = checked_actions(actions, (self.num_envs, 2), self._limit)
        starting = np.flatnonzero(self._over)  # never with SAME_STEP
        if self._spot_steps:
            due = (self._steps > 0) & (self._steps % self._spot_steps == 0) & ~self._over
            self._jump(np.flatnonzero(due))
        batch.step(motors)
        if not batch.valid.all():
            broken = np.flatnonzero(~batch.valid).tolist()
            raise PhysicsError(f"the simulation of the robots {broken} became unstable")
        self._steps += 1
        rewards = batch.rules.reward(batch.sensordata)
        if len(starting):
            self._begin(starting)
            rewards[starting] = 0.0
        self._over = self._steps >= self._max_steps
        truncations, observations, info = self._over.copy(), self._states(), {}
        if self._same_step and self._over.any():
            ended = np.flatnonzero(self._over)
            info = _final(observations, ended)
            self._begin(ended)
            self._over[:] = False
            observations = self._states()
        return observations, rewards, np.zeros(self.num_envs, dtype=bool), truncations, info

    def _streams(self, seeds: Sequence[int | None]) -> list[np.random.Generator]:
        """Returns the random streams, with a new one for every seed given."""
        if self._randoms is None:
            pairs = [seeding.np_random(seed) for seed in seeds]
            self._randoms = [random for random, _ in pairs]
            self._seeds = [made_from for _, made_from in pairs]
        else:
            for robot, seed in enumerate(seeds):
                if seed is not None:
                    self._randoms[robot], self._seeds[robot] = seeding.np_random(seed)
        return self._randoms

    def _begin(self, robots: np.ndarray) -> None:
        """Starts an episode of some robots, with starts drawn from their own streams."""
        randoms = self._streams([None] * self.num_envs)
        starts = [self._start.draw(randoms[robot], self._batch.dimensions) for robot in robots]
        poses, spots = map(np.stack, zip(*starts, strict=True))
        self._batch.valid[robots] = True  # a robot that was stopped starts again
        self._batch.place_spot(robots, spots)
        self._batch.place(robots, poses)
        self._steps[robots] = 0

    def _jump(self, robots: np.ndarray) -> None:
        """Moves the spots of some robots to places drawn from their own streams."""
        randoms = self._streams([None] * self.num_envs)
        for robot in robots:
            spot = random_spots(randoms[robot], self._batch.dimensions, 1)
            self._batch.place_spot(robot[None], spot)

    def _states(self) -> np.ndarray:
        return self._batch.rules.state(self._batch.sensordata).astype(np.float32)


def _state(observation: dict[str, np.ndarray]) -> np.ndarray:
    return np.concatenate(list(observation.values())).astype(np.float32)


def _final(observations: np.ndarray, ended: np.ndarray) -> dict[str, Any]:
    """Returns Gymnasium's dictionary of the last observations of the episodes that ended."""
    mask = np.zeros(len(observations), dtype=bool)
    mask[ended] = True
    final = np.full(len(observations), None, dtype=object)
    for robot in ended:
        final[robot] = observations[robot]
    return {"final_obs": final, "_final_obs": mask, "final_info": {}, "_final_info": mask.copy()}
