"""Attributes of the robots of a batch, as Gymnasium and Stable-Baselines3 read and set them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np

from ..episode import Episode
from .common import shared_options

METHODS = ("get_wrapper_attr", "render", "set_wrapper_attr")  # methods of robots
SETTABLE = ("np_random", "options")  # attributes that can be set


class RobotAttributes(gymnasium.vector.VectorEnv):
    """A batch of B robots, each of which has the attributes of `ArenaEnv`."""

    _randoms: list[np.random.Generator]
    _seeds: list[int]
    _usual: Episode  # without `options`
    _episode: Episode  # with `options`
    _batch: Any
    _info: Any

    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Random stream of every robot."""
        return tuple(self._randoms)

    @np_random.setter
    def np_random(self, streams: Sequence[np.random.Generator]) -> None:
        """Replaces the robots' random streams; their seeds become -1, as in Gymnasium."""
        found = [*streams] if isinstance(streams, list | tuple) else []
        if [*map(type, found)] != [np.random.Generator] * self.num_envs:
            raise ValueError(f"np_random must be {self.num_envs} generators, one for each robot")
        self._randoms, self._seeds = found, [-1] * self.num_envs

    @property
    def options(self) -> Mapping[str, Any]:
        """Options of all further episodes; those given to `reset` replace them for that episode."""
        return self._options

    @options.setter
    def options(self, options: Mapping[str, Any]) -> None:
        self._episode = self._usual.with_options(options)
        self._options = dict(options or {})

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Seed of every robot's random stream."""
        return tuple(self._seeds)

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Returns what one of `METHODS` returns for every robot, or `get_attr(name)`."""
        if name == "render":
            return self.render(*args, **kwargs) or (None,) * self.num_envs
        if name == "get_wrapper_attr":
            return self.get_attr(*args, **kwargs)
        if name == "set_wrapper_attr":
            self.set_attr(*args, **kwargs)
            return (True,) * self.num_envs
        return self.get_attr(name)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Returns an attribute of every robot, such as an entry of `INFO`, `options` or a space.

        Raises AttributeError where robots of a batch have no such attribute.
        """
        shared = {
            "action_space": self.single_action_space,
            "observation_space": self.single_observation_space,
            "model": self._batch.model,
            **{own: getattr(self, own) for own in ("metadata", "options", "render_mode", "spec")},
        }
        found = {own: entry for own, entry in self._info().items() if own[0] != "_"}
        found |= {own: getattr(self, own) for own in ("np_random", "np_random_seed")}
        found |= {own: (value,) * self.num_envs for own, value in shared.items()}
        if name not in found:
            raise AttributeError(
                f"robots of a batch have the attributes {sorted(found)}, got {name!r}"
            )
        return tuple(found[name])

    def set_attr(self, name: str, values: Any) -> None:
        """Sets `options`, which are the same for all robots, or the robots' `np_random`.

        Raises AttributeError for any other attribute, ValueError or TypeError for wrong values.
        """
        if name not in SETTABLE:
            raise AttributeError(f"robots of a batch can be given {SETTABLE}, got {name!r}")
        if name == "options" and isinstance(values, list | tuple):  # one for each robot
            values = shared_options(values)
        setattr(self, name, values)
