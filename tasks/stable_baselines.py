"""The batch of robots with the interface of Stable-Baselines3 (extra `baselines`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..extras import extra_needed

with extra_needed("baselines"):
    import gymnasium
    from gymnasium.vector import AutoresetMode
    from stable_baselines3.common.vec_env.base_vec_env import VecEnv

from ..gymnasium_registration import GYMNASIUM_TASKS, LIFE_ID, USUAL_STEPS
from .gymnasium_env import INFO, ArenaVectorEnv
from .gymnasium_env.common import FPS, LIFE_INFO, task_name
from .suite import LIFE_DOMAIN


class ArenaVecEnv(VecEnv):
    """`ArenaVectorEnv` with the interface of Stable-Baselines3.

    A robot whose episode ends starts the next one in the same step. Stable-Baselines3 logs the mean
    return, `rollout/ep_rew_mean`, of a batch wrapped in `VecMonitor`:

        robots = VecMonitor(ArenaVecEnv("musebot/WallAvoidanceObstacles-v0", 64, threads=2))
        model = PPO("MlpPolicy", robots, verbose=1)
    """

    def __init__(self, task: str, num_envs: int, **kwargs: Any) -> None:
        """Initialises the batch.

        Args:
          task: Name of a task, see `musebot.ALL_TASKS`, or its Gymnasium id; or "life", with the
            keyword `life`. MODULE:NAME first imports the module, which registers the task.
          num_envs: Number of robots, B.
          **kwargs: Keywords of `ArenaVectorEnv` except `autoreset_mode`; `max_episode_steps` is by
            default that of the task, 1,000 in the suite.
        """
        name = LIFE_DOMAIN if task in (LIFE_DOMAIN, LIFE_ID) else task_name(task)
        ids = {task: f"musebot/{name}" for name, task in GYMNASIUM_TASKS.items()}
        spec = gymnasium.registry.get({**ids, LIFE_DOMAIN: LIFE_ID}.get(name, ""))
        steps = spec.max_episode_steps if spec else USUAL_STEPS
        kwargs = {"max_episode_steps": steps, **kwargs}
        mode = AutoresetMode.SAME_STEP
        self._robots = ArenaVectorEnv(name, num_envs, autoreset_mode=mode, **kwargs)
        self._actions = np.zeros((num_envs, 2), dtype=np.float32)
        robots = self._robots
        robots.spec = spec
        super().__init__(num_envs, robots.single_observation_space, robots.single_action_space)
        metadata: dict[str, Any] = self.metadata
        metadata["render_fps"] = FPS  # `VecVideoRecorder` reads it

    def reset(self) -> np.ndarray:
        """Starts an episode of every robot; returns the observations, shape (B, S).

        The seeds are those set by `seed`; options set by `set_options` hold for these episodes.
        Raises what `ArenaVectorEnv.reset` raises, and ValueError where the robots' options differ.
        """
        options = _shared(self._options)
        observations, info = self._robots.reset(seed=self._seeds, options=options)
        self.reset_infos = [_of(info, robot) for robot in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Simulates 0.1 s; returns observations (B, S), rewards (B,), dones (B,) and infos.

        The infos hold the entries of `INFO` at the end of an episode only, to save time.
        """
        observations, rewards, _, truncations, info = self._robots.step(self._actions)
        infos: list[dict[str, Any]] = [
            {"TimeLimit.truncated": bool(truncated)} for truncated in truncations
        ]
        for robot in np.flatnonzero(truncations):
            infos[robot]["terminal_observation"] = info["final_obs"][robot]
            infos[robot] |= _of(info["final_info"], robot)
        return observations, rewards.astype(np.float32), truncations, infos

    def close(self) -> None:
        self._robots.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        values = self._robots.get_attr(attr_name)
        return [values[robot] for robot in self._get_indices(indices)]

    def get_images(self) -> list[np.ndarray | None]:
        return list(self._robots.render() or [None] * self.num_envs)

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Raises AttributeError: robots of a batch have no attributes to set."""
        raise AttributeError(f"robots of a batch have no attributes to set, got {attr_name!r}")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> Any:
        """Raises AttributeError: robots of a batch have no methods of their own."""
        raise AttributeError(f"robots of a batch have no methods, got {method_name!r}")

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper], indices: Any = None
    ) -> list[bool]:
        return [False] * sum(1 for _ in self._get_indices(indices))


def _shared(options: Sequence[Mapping[str, Any] | None]) -> dict[str, Any]:
    """Returns the options that all robots share; ValueError where theirs differ."""
    first, *others = (one or {} for one in options)
    for other in others:
        equal = (np.array_equal(value, other[name]) for name, value in first.items())
        if first.keys() != other.keys() or not all(equal):
            raise ValueError("options must be the same for all robots of a batch")
    return dict(first)


def _of(info: Mapping[str, Any], robot: Any) -> dict[str, Any]:
    """Returns one robot's entries of `INFO` and, in a life, of `LIFE_INFO`."""
    names = [name for name in (*INFO, *LIFE_INFO) if name in info]
    return {name: info[name][robot] for name in names}
