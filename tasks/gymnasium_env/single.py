"""One robot with Gymnasium's interface."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import gymnasium
import mujoco
import numpy as np

from ...models.arena import heading
from ...models.physics import Physics
from ...models.rendering import has_display, no_window
from ..episode import NOT_RUNNING, check_counts, check_stage, check_state
from .common import FPS, PICTURE, check_render_mode, checked_task, life_info, picture_of, spaces


class ArenaEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """The dm_control environment of one robot with Gymnasium's interface.

    Actions beyond the limits are clipped; an action that is not finite raises ValueError.
    """

    metadata = {
        "render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"],
        "render_fps": FPS,
    }

    def __init__(
        self,
        task: str,
        *,
        render_mode: str | None = None,
        camera: str = PICTURE["camera"],
        width: int = PICTURE["width"],
        height: int = PICTURE["height"],
        **kwargs: Any,
    ) -> None:
        """Initialises the environment.

        Args:
          task: Name of a task, such as "wall_avoidance", see `musebot.ALL_TASKS`; or "life", which
            needs the keyword `life`.
          render_mode: "rgb_array", "depth_array", "rgbd_tuple" (see `render`), "human" for a
            window, or None.
          camera: Name of the camera: "overhead", "corner", "follow" or "eye".
          width: Width of the picture in pixels.
          height: Height of the picture in pixels.
          **kwargs: Keywords of the task: `robot`, `spot`, `nose` (see `arena.Settings`), or
            `life`, for the task "life": the name of a life, its TOML file or a `Life`.

        Raises TypeError for an unknown keyword, ValueError for an unknown task or a value out of
        range, RuntimeError for the mode "human" where no window can be opened.
        """
        definition = checked_task(task, kwargs)
        check_render_mode(render_mode, self.metadata["render_modes"])
        if render_mode == "human" and (reason := no_window()):
            raise RuntimeError(f"{reason}; render_mode='rgb_array' needs no display")
        if not has_display():  # Gymnasium's `check_env` tries all modes
            modes = [mode for mode in self.metadata["render_modes"] if mode != "human"]
            self.metadata = {**self.metadata, "render_modes": modes}
        # Gymnasium's wrapper TimeLimit counts the steps of an episode.
        self._environment = definition.environment(**kwargs, time_limit=math.inf)
        rules = self._environment.task.rules
        self.observation_space, self.action_space = spaces(rules, definition.limit)
        self.render_mode = render_mode
        self._picture = picture_of(self.model, camera, width, height)
        self.mujoco_renderer: Any = None
        self._layout = rules.layout
        self._radius = self.physics.dimensions.spot_radius
        self._counts = [0, 0]  # control steps of this episode in contact, and in the spot

    @property
    def physics(self) -> Physics:
        return self._environment.physics

    @property
    def model(self) -> mujoco.MjModel:
        """MuJoCo's model of robot and arena.

        It was not loaded from a file, so `mujoco.mj_saveLastXML` cannot write it:
        `musebot.tasks.suite.TASKS[task].spec().to_xml()` returns its MJCF.
        """
        return self.physics.model.ptr

    @property
    def data(self) -> mujoco.MjData:
        """MuJoCo's data."""
        return self.physics.data.ptr

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts an episode, even after `close`, as Stable-Baselines3's checker requires.

        Args:
          seed: Seed of the random stream; None continues the stream.
          options: Dictionary with the places of `robot` and `spot` at the start of this episode.
            A missing key keeps the environment's own start.

        Returns the observation, shape (S,), and the entries of `INFO`. Raises TypeError for an
        unknown option, ValueError for a place outside the arena or inside an obstacle.
        """
        environment = self._environment
        environment.task.episode.start_with(options)  # refuses before anything changes
        super().reset(seed=seed)
        if environment.stage == "closed":
            environment.stage = "new"
        environment.task.reseed(self.np_random)
        timestep = environment.reset(options=options)
        self._counts = [0, 0]
        self._show()
        return _state(timestep.observation), self._info(*self._ended())

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Simulates 0.1 s for a left and right action within `action_space`, shape (2,).

        Returns observation (S,), reward, termination (False), truncation (at the end of a life) and
        the entries of `INFO`, and of `LIFE_INFO` in a life. Raises what `arena.Environment.step`
        does, and RuntimeError before a reset and after the end of a life.
        """
        environment = self._environment
        check_stage(environment.stage, *NOT_RUNNING)
        if environment.task.steps >= environment.task.episode.steps:
            raise RuntimeError("reset must be called after the end of a life")
        timestep = environment.step(action)
        contact, in_spot = self._ended()
        self._counts[0] += contact
        self._counts[1] += in_spot
        self._show()
        over = environment.task.steps >= environment.task.episode.steps  # of a life
        info = self._info(contact, in_spot)
        return _state(timestep.observation), timestep.reward, False, over, info

    def render(self) -> Any:
        """Draws the window, or returns a picture.

        "rgb_array": uint8, shape (height, width, 3). "depth_array": OpenGL's depth in [0, 1],
        shape (height, width). "rgbd_tuple": both. "human": None. Raises RuntimeError where OpenGL
        cannot be opened, or the environment is closed.
        """
        check_stage(self._environment.stage, "closed")
        if self.render_mode is None:
            return None
        if self.mujoco_renderer is None:
            from ...models.gymnasium_renderer import ArenaRenderer

            self.mujoco_renderer = ArenaRenderer(self.model, self.data, **self._picture)
        return self.mujoco_renderer.render(self.render_mode)

    def close(self) -> None:
        """Closes the window, and frees the renderer; only `reset` opens the environment again."""
        if self.mujoco_renderer is not None:
            self.mujoco_renderer.close()
            self.mujoco_renderer = None
        self._environment.stage = "closed"

    def get_state(self) -> dict[str, Any]:
        """Returns everything that the next steps depend on, see `arena.Environment.get_state`.

        It lacks the step count of Gymnasium's wrapper TimeLimit.
        """
        check_stage(self._environment.stage, *NOT_RUNNING)
        own = {"counts": list(self._counts), "seed": self.np_random_seed}
        return self._environment.get_state() | own

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Continues from a state, bit-exactly, see `arena.Environment.set_state`."""
        environment = self._environment
        rest = dict(state) if isinstance(state, Mapping) else {}
        own = {name: rest.pop(name) for name in ("counts", "seed") if name in rest}
        environment.check_state(rest, self.np_random)
        check_state(own, {"counts": [0, 0], "seed": 0})
        check_counts("counts", own["counts"], [rest["steps"]] * 2)
        environment.task.reseed(self.np_random)
        environment.set_state(rest)
        self._counts, self._np_random_seed = list(own["counts"]), own["seed"]

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "mujoco_renderer": None}

    def _ended(self) -> tuple[bool, bool]:
        """Returns `_events` at the end of the step, before the robot was perhaps placed."""
        return self._events(self._environment.task.ended[1])

    def _info(self, contact: bool, in_spot: bool) -> dict[str, Any]:
        """Returns the entries of `INFO` for the robot whose step has `_ended` so."""
        physics, task = self._environment.physics, self._environment.task
        # Scalars of Python: a few small arrays would cost as much as a tenth of the step.
        x, y, _, w, i, j, k = physics.qpos.tolist()[:7]
        of_life = {}
        if task.episode.life:
            rules, ended = task.ended
            of_life = life_info(task.episode, task.steps, bool(rules.event(ended)[0]))
            contact, in_spot = self._events(physics.readings)  # perhaps placed since
        return {
            "position": np.array([x, y]),
            "heading": float(heading(w, i, j, k)),
            "spot": physics.spot_position(),
            "contact": contact,
            "in_spot": in_spot,
            "contact_steps": self._counts[0],
            "in_spot_steps": self._counts[1],
            **of_life,
        }

    def _events(self, readings: np.ndarray) -> tuple[bool, bool]:
        """Returns whether the robot is in contact, and whether it is in the spot."""
        sensed, layout = readings[0].tolist(), self._layout
        ahead, left = sensed[layout.smell.start], sensed[layout.smell.start + 1]
        inside = math.sqrt(ahead * ahead + left * left) < self._radius
        return sensed[layout.touch.start] > 0, inside

    def _show(self) -> None:
        if self.render_mode == "human":
            self.render()


def _state(observation: dict[str, np.ndarray]) -> np.ndarray:
    return np.concatenate(list(observation.values()), dtype=np.float32)
