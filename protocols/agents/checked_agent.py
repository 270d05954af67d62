"""Checks what a user's agent returns, and turns each of its faults into one sentence."""

from __future__ import annotations

import contextlib
import sysconfig
import traceback
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from ..errors import InputError, RunError
from ..storage import DTYPES
from .base import Agent, sound

# A fault of a user's code lies neither here, nor in Python, nor in these libraries. Without a
# virtual environment Python's folder has that of the packages in it.
_LIBRARIES = Path(np.__file__).parents[1]
_NOT_THEIRS = (
    "<",
    str(Path(__file__).parents[1]),
    *(str(_LIBRARIES / name) for name in ("numpy", "torch")),
)
_PYTHON = sysconfig.get_paths()["stdlib"]


class CheckedAgent(Agent):
    """An agent whose code is not ours: each fault becomes one sentence that names the agent."""

    def __init__(self, name: str, make: Callable[[], object], robots: int) -> None:
        """Makes the agent.

        Args:
          name: Name of the factory.
          make: Function that returns the agent.
          robots: Number of robots, B.

        Raises:
          InputError: the factory fails, or returns no agent.
          RunError: the factory exits.
        """
        self._name, self._robots = name, robots
        with ending_in_a_sentence(f"the factory {name} failed", InputError):
            agent = make()
        if not isinstance(agent, Agent):
            raise InputError(f"{name} must return an Agent, got {type(agent).__name__}")
        self._agent = agent

    def reset(self) -> None:
        """See `Agent.reset`."""
        with ending_in_a_sentence(f"{self._name} failed in reset"):
            self._agent.reset()

    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        """See `Agent.act`; the agent receives a copy.

        Raises:
          InputError: the motor values have another shape, or are not real numbers.
          RunError: the agent fails or exits, or the motor values of a robot are not finite though
            its weights are.
        """
        with ending_in_a_sentence(f"{self._name} failed in act"):
            motors = np.asarray(self._agent.act(state.copy(), learning))
        if motors.shape != (self._robots, 2):
            raise InputError(
                f"{self._name} must return motor values of shape ({self._robots}, 2), "
                f"got {motors.shape}"
            )
        if motors.dtype.kind not in "fiu":
            raise InputError(
                f"{self._name} must return motor values that are real numbers, got {motors.dtype}"
            )
        if not np.isfinite(motors).all():
            self._check_finite(motors)
        return motors

    def learn(self, reward: np.ndarray) -> None:
        """See `Agent.learn`; the agent receives a copy.

        Raises:
          RunError: the agent fails or exits.
        """
        with ending_in_a_sentence(f"{self._name} failed in learn"):
            self._agent.learn(reward.copy())

    def state(self) -> dict[str, np.ndarray]:
        """See `Agent.state`.

        Raises:
          InputError: the state cannot be written into a checkpoint.
          RunError: the agent fails or exits.
        """
        with ending_in_a_sentence(f"{self._name} failed in state"):
            state = self._agent.state()
        return self._arrays("state", state)

    def load_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """See `Agent.load_state`."""
        what = f"{self._name} failed in load_state"
        with ending_in_a_sentence(what, passed=(ValueError, KeyError)):
            self._agent.load_state({name: array.copy() for name, array in arrays.items()})

    def weights(self) -> dict[str, np.ndarray]:
        """See `Agent.weights`.

        Raises:
          InputError: the weights cannot be written into results.safetensors.
          RunError: the agent fails or exits.
        """
        with ending_in_a_sentence(f"{self._name} failed in weights"):
            weights = self._agent.weights()
        arrays = self._arrays("weights", weights)
        for name, array in arrays.items():
            if array.shape[:1] != (self._robots,):
                raise InputError(
                    f"{self._name} must return weights with a row a robot, got {name} of shape "
                    f"{array.shape} for {self._robots} robots"
                )
        return arrays

    def load_weights(self, arrays: Mapping[str, np.ndarray]) -> None:
        """See `Agent.load_weights`."""
        what = f"{self._name} failed in load_weights"
        with ending_in_a_sentence(what, passed=(ValueError, KeyError, NotImplementedError)):
            self._agent.load_weights({name: array.copy() for name, array in arrays.items()})

    def _arrays(self, what: str, arrays: object) -> dict[str, np.ndarray]:
        if not isinstance(arrays, Mapping):
            raise InputError(
                f"{self._name} must return a dict of arrays as its {what}, "
                f"got {type(arrays).__name__}"
            )
        for name, array in arrays.items():
            if isinstance(array, np.generic):
                raise InputError(
                    f"{self._name} must return a dict of arrays as its {what}, got the number "
                    f"{name!r} ({type(array).__name__}), not an array"
                )
            if not isinstance(name, str) or not isinstance(array, np.ndarray):
                raise InputError(
                    f"{self._name} must return a dict of arrays as its {what}, "
                    f"got {name!r} of type {type(array).__name__}"
                )
            if array.dtype not in DTYPES:
                raise InputError(
                    f"{self._name} must return a {what} of real numbers, got {name} of dtype "
                    f"{array.dtype}"
                )
        return dict(arrays)

    def _check_finite(self, motors: np.ndarray) -> None:
        """Raises RunError unless the weights show why: such robots are stopped and counted."""
        wrong = ~np.isfinite(motors).all(axis=1) & sound(self.weights(), self._robots)
        if wrong.any():
            robot = int(np.flatnonzero(wrong)[0])
            raise RunError(
                f"{self._name} must return motor values that are finite, got "
                f"{motors[robot].tolist()} for robot {robot}"
            )


@contextlib.contextmanager
def ending_in_a_sentence(
    what: str,
    kind: type[Exception] = RunError,
    passed: tuple[type[Exception], ...] = (),
) -> Iterator[None]:
    """Turns whatever a user's code raises within into one sentence.

    Args:
      what: Beginning of the sentence.
      kind: Error for an exception; an exit is a RunError.
      passed: Types of exceptions that are raised unchanged.

    Raises:
      InputError, RunError: the code has raised an exception, or exits.
    """
    try:
        yield
    except (*passed, InputError, RunError, KeyboardInterrupt):
        raise
    except SystemExit as error:
        raise RunError(f"{what}: it called for an exit (status {error.code})") from error
    except BaseException as error:  # any fault in a user's code
        raise kind(f"{what} ({fault(error)})") from error


def _is_not_theirs(file: str) -> bool:
    if file.startswith(str(_LIBRARIES)):
        return file.startswith(_NOT_THEIRS)
    return file.startswith((*_NOT_THEIRS, _PYTHON))


def fault(error: BaseException) -> str:
    """Returns type, text and place of an error in one line: the last place in a user's code."""
    text = " ".join(f"{type(error).__name__}: {error}".split())
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if not _is_not_theirs(frame.filename)
    ]
    return f"{text}, {Path(frames[-1].filename).name} line {frames[-1].lineno}" if frames else text
