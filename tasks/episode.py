"""What an episode is, for every interface: its start, actions, length, random stream and states.

The dm_control environment, which Gymnasium's drives, and the batch of Gymnasium build an `Episode`
and have a `Stage`, so that they refuse the same values with the same messages.
"""

from __future__ import annotations

import bisect
import copy
import dataclasses
import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    from ..models.arena import Dimensions
    from .lives import Leg, Life
    from .starts import Random, Start

CONTROL_TIMESTEP = 0.1  # [s]; the cycle time of section 3

# An environment is "new" until the first reset, then "running"; a PhysicsError makes it "failed"
# until the next reset. Only Gymnasium's environment can be reset after "closed".
Stage = Literal["new", "running", "failed", "closed"]
NOT_RUNNING: tuple[Stage, ...] = ("new", "failed", "closed")
_REFUSALS: Mapping[Stage, str] = {
    "new": "reset must be called before the first step",
    "failed": "reset must be called after a PhysicsError, before the next step",
    "closed": "the environment is closed",
}
_MOST_STEPS = 2**53  # limit for an episode without end


@dataclasses.dataclass(frozen=True)
class Episode:
    """An episode of a task.

    Attributes:
      task: Name of the task and, if it is not the usual one, of the form of the smell; for a life,
        also a checksum of its phases. States of another task are refused.
      start: Places of robot and spot at the start, fixed or random.
      dimensions: Dimensions of robot, arena and spot, which decide the possible places.
      limit: Bound of an action's two numbers: `limit` gives motor value 0.5, `-limit` gives -0.5.
      spot_steps: Number of control steps between two jumps of the spot to a random place; 0 for a
        spot that stays.
      steps: Number of control steps; infinity for an episode without end.
      life: Life through which the robot passes in the episode; None for one without phases.
    """

    task: str
    start: Start
    dimensions: Dimensions
    limit: float
    spot_steps: int = 0
    steps: float = math.inf
    life: Life | None = None

    def __post_init__(self) -> None:
        """Raises ValueError for a place outside the arena or inside an obstacle."""
        self.start.check(self.dimensions)

    @property
    def most_steps(self) -> float:
        """Largest number of control steps that a saved state may hold."""
        return min(self.steps, _MOST_STEPS)

    def start_with(self, options: Mapping[str, Any] | None) -> Start:
        """Returns the task's start, with `robot` and `spot` of the options in place of its own.

        Raises TypeError for an unknown option, ValueError for an impossible place.
        """
        if not options:
            return self.start
        check_keywords("reset", options, [] if self.life else ["robot", "spot"], "options")
        start = dataclasses.replace(self.start, **options)
        start.check(self.dimensions)
        return start

    @functools.cached_property
    def _legs(self) -> Sequence[Leg]:
        return self.life.legs() if self.life else ()

    def leg_from(self, step: int) -> Leg | None:
        """Returns the stretch of the life that begins at control step `step`, None if none does."""
        leg = self.leg_of(step) if self.life else None
        return leg if leg and leg.start == step else None

    def leg_of(self, step: int) -> Leg:
        """Returns the stretch of the life that contains control step `step`; at the end, the last.

        Only for an episode that is a life.
        """
        return self._legs[bisect.bisect_right(self._legs, step, key=lambda leg: leg.start) - 1]

    def jumps(self, step: Any) -> Any:
        """Returns whether the spot jumps at the start of control step number `step`, from 0."""
        if not self.spot_steps:
            return step < 0  # never, in the shape of `step`
        return (step > 0) & (step % self.spot_steps == 0)

    def motors(self, action: Any) -> tuple[float, float]:
        """Returns an action's motor values, clipped; ValueError unless it is two finite numbers."""
        left, right = real_numbers("action", action, (2,), finite=True).tolist()
        limit = self.limit
        scale = 0.5 / limit
        return min(max(left, -limit), limit) * scale, min(max(right, -limit), limit) * scale

    def batch_motors(
        self, actions: Any, robots: int, ignored: Sequence[int] | np.ndarray = ()
    ) -> np.ndarray:
        """Returns the motor values of B robots' actions, shape (B, 2); see `motors`.

        The actions of robots that are `ignored` are not read; their motor values are 0.
        """
        values = real_numbers("actions", actions, (robots, 2)).astype(float)
        if len(ignored):
            values[ignored] = 0
        real_numbers("actions", values, (robots, 2), finite=True)
        return np.clip(values, -self.limit, self.limit) * (0.5 / self.limit)


def check_stage(stage: Stage, *refused: Stage) -> None:
    """Raises RuntimeError, which says what must be done, if an environment's stage is refused."""
    if stage in refused:
        raise RuntimeError(_REFUSALS[stage])


def check_keywords(
    whose: str, given: Mapping[str, Any], allowed: Sequence[str], kind: str = "keywords"
) -> None:
    """Raises TypeError if a given keyword is not allowed."""
    unknown = sorted(map(str, set(given) - set(allowed)))
    if unknown:
        raise TypeError(f"{whose} takes the {kind} {sorted(allowed)}, got {unknown}")


def real_numbers(
    name: str, values: Any, shape: tuple[int, ...], finite: bool = False
) -> np.ndarray:
    """Returns values as an array; ValueError unless they are real numbers of this shape."""
    try:
        array = np.asarray(values)
    except ValueError:  # raised for parts of different lengths
        array = np.empty(0)
    sound = array.shape == shape and array.dtype.kind in "fiu"
    if sound and finite:  # Python's function takes a tenth of the time for two numbers
        sound = (
            np.isfinite(array).all() if array.ndim > 1 else all(map(math.isfinite, array.tolist()))
        )
    if not sound:
        kind = "finite real" if finite else "real"
        raise ValueError(f"{name} must be {kind} numbers of shape {shape}, got {values!r:.200}")
    return array


def whole_number(name: str, value: Any, least: int) -> int:
    """Returns a value as an int; ValueError unless it is a whole number from `least` up."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r:.60}")
    return int(value)


def checked_length(max_episode_steps: Any) -> float:
    """Returns the number of steps of an episode, at least 1; infinity for None and -1."""
    if max_episode_steps is None or (type(max_episode_steps) is int and max_episode_steps == -1):
        return math.inf
    return whole_number("max_episode_steps, if not -1,", max_episode_steps, 1)


def seconds(time_limit: Any) -> float:
    """Returns a time limit in [s] as a float, perhaps infinite; ValueError unless positive."""
    number = isinstance(time_limit, int | float | np.integer | np.floating)
    if isinstance(time_limit, bool) or not number or not time_limit > 0:
        raise ValueError(f"time_limit must be a positive number of seconds, got {time_limit!r:.60}")
    return float(time_limit)


def stream_state(random: Random) -> dict[str, Any]:
    """Returns the state of a random stream, for `set_stream_state`."""
    if isinstance(random, np.random.RandomState):
        state: Any = random.get_state(legacy=False)
    else:
        state = random.bit_generator.state
    return copy.deepcopy(state)


def check_stream_state(random: Random, state: Any) -> None:
    """Raises ValueError unless `state` fits this kind of random stream."""
    set_stream_state(copy.deepcopy(random), state)


def set_stream_state(random: Random, state: Any) -> None:
    """Sets the state of a random stream; ValueError unless it fits this kind of stream."""
    try:
        if isinstance(random, np.random.RandomState):
            random.set_state(state)
        else:
            random.bit_generator.state = state
    except Exception as error:  # NumPy documents no exceptions
        raise ValueError(f"state must hold the state of such a random stream ({error})") from error


def check_state(state: Any, like: Mapping[str, Any]) -> None:
    """Raises ValueError unless a state has the keys, types and shapes of the state `like`.

    Strings must be equal; lists must be equally long.
    """
    if not isinstance(state, Mapping) or set(state) != set(like):
        got = sorted(map(str, state)) if isinstance(state, Mapping) else type(state).__name__
        raise ValueError(f"state must have the keys {sorted(like)}, got {got}")
    for name, own in like.items():
        given = state[name]
        array = isinstance(own, np.ndarray)
        if not (isinstance(given, np.ndarray) if array else type(given) is type(own)):
            kinds = type(own).__name__, type(given).__name__
            raise ValueError(f"state[{name!r}] must be of type {kinds[0]}, got {kinds[1]}")
        if isinstance(own, str) and given != own:
            raise ValueError(f"state[{name!r}] must be {own!r}, got {given!r:.60}")
        if isinstance(own, list) and len(given) != len(own):
            raise ValueError(f"state[{name!r}] must have {len(own)} parts, got {len(given)}")
        if array and (given.shape, given.dtype) != (own.shape, own.dtype):
            wanted, got = (f"{one.dtype} of shape {one.shape}" for one in (own, given))
            raise ValueError(f"state[{name!r}] must be {wanted}, got {got}")


def check_counts(name: str, counts: Iterable[Any], most: Iterable[float]) -> None:
    """Raises ValueError unless each count in a state is a whole number from 0 to its `most`."""
    for count, limit in zip(counts, most, strict=True):
        whole = isinstance(count, int | np.integer) and not isinstance(count, bool)
        if not whole or not 0 <= count <= limit:
            raise ValueError(
                f"state[{name!r}] must be whole numbers from 0 to {limit:.0f}, got {count!r:.60}"
            )
