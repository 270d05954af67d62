"""Checks what a user's agent returns, and reports each of its faults in one sentence."""

from __future__ import annotations

import contextlib
import sysconfig
import traceback
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, RunError
from ..storage import DTYPES
from .base import Agent, sound

# Folders whose code is not the user's: ours, Python's and that of two libraries. Without a
# virtual environment, Python's folder contains the packages' folder.
_LIBRARIES = Path(np.__file__).parents[1]
_OURS = "<", str(Path(__file__).parents[2]), *(str(_LIBRARIES / n) for n in ("numpy", "torch"))
_PYTHON = sysconfig.get_paths()["stdlib"]


class CheckedAgent(Agent):
    """A user's agent whose faults become errors of one sentence, which names the agent.

    Every method raises InputError where the agent returns what the interface does not allow, and
    RunError where it fails, exits or returns motor values that are not finite. The agent receives
    copies of all arrays.
    """

    def __init__(self, name: str, make: Callable[[], object], robots: int) -> None:
        """Calls `make` to make the agent of B robots; errors name its factory, `name`.

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
        self._kinds: dict[str, str] | None = None  # dtype and shape of each weight at birth

    def reset(self) -> None:
        self._call("reset")

    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        """See `Agent.act`; only robots with a NaN or infinite weight may have such motor values."""
        motors = self._call("act", state.copy(), learning)
        with ending_in_a_sentence(f"{self._name} must return motor values as an array", InputError):
            motors = np.asarray(motors)
        if motors.shape != (self._robots, 2):
            raise self._wrong(f"motor values of shape ({self._robots}, 2), got {motors.shape}")
        if motors.dtype.kind not in "fiu":
            raise self._wrong(f"motor values that are real numbers, got {motors.dtype}")
        if not np.isfinite(motors).all():
            # The simulation itself stops robots with weights that are not finite.
            wrong = ~np.isfinite(motors).all(axis=1) & sound(self.weights(), self._robots)
            if wrong.any():
                robot = int(wrong.argmax())
                got = f"got {motors[robot].tolist()} for robot {robot}"
                raise RunError(f"{self._name} must return motor values that are finite, {got}")
        return motors

    def learn(self, reward: np.ndarray) -> None:
        self._call("learn", reward.copy())

    def state(self) -> dict[str, np.ndarray]:
        return self._arrays("state")

    def load_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        passed = ValueError, KeyError, MemoryError  # for want of memory no file is damaged
        self._call("load_state", copied(arrays), passed=passed)

    def weights(self) -> dict[str, np.ndarray]:
        arrays = self._arrays("weights")
        for name, array in arrays.items():
            if array.shape[:1] != (self._robots,):
                rows = f"got {name} of shape {array.shape} for {self._robots} robots"
                raise self._wrong(f"weights with a row a robot, {rows}")
        kinds = {name: f"{array.dtype} {array.shape}" for name, array in arrays.items()}
        self._kinds = kinds if self._kinds is None else self._kinds
        for name in {**self._kinds, **kinds}:
            born, now = (kind.get(name, "absent") for kind in (self._kinds, kinds))
            if born != now:  # results hold the weights before and after training
                both = f"got {name}: {born}, then {now}"
                raise self._wrong(f"weights of one kind all its life, {both}")
        return arrays

    def load_weights(self, arrays: Mapping[str, np.ndarray]) -> None:
        passed = (ValueError, KeyError, NotImplementedError)
        self._call("load_weights", copied(arrays), passed=passed)

    def _call(self, method: str, *arguments: Any, passed: tuple[type[Exception], ...] = ()) -> Any:
        with ending_in_a_sentence(f"{self._name} failed in {method}", passed=passed):
            return getattr(self._agent, method)(*arguments)

    def _arrays(self, what: str) -> dict[str, np.ndarray]:
        """Returns what `what` ("state", "weights") returns; raises unless a file can hold it."""
        arrays = self._call(what)
        if not isinstance(arrays, Mapping):
            raise self._wrong(f"a dict of real arrays as its {what}, got {type(arrays).__name__}")
        for name, array in arrays.items():
            fits = isinstance(array, np.ndarray) and array.dtype in DTYPES
            named = isinstance(name, str) and name.isprintable() and name  # a key of a file
            if not named or not fits:
                kind = f"{type(array).__name__} {getattr(array, 'dtype', '')}".rstrip()
                arrays_wanted = f"a dict of real arrays as its {what}, with printable names"
                raise self._wrong(f"{arrays_wanted}, got {name!r}: {kind}")
        return dict(arrays)

    def _wrong(self, words: str) -> InputError:
        return InputError(f"{self._name} must return {words}")


def copied(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Returns copies of arrays by name."""
    return {name: array.copy() for name, array in arrays.items()}


@contextlib.contextmanager
def ending_in_a_sentence(
    what: str, kind: type[Exception] = RunError, passed: tuple[type[Exception], ...] = ()
) -> Iterator[None]:
    """Turns what a user's code raises in this context into an error of one sentence.

    Args:
      what: Beginning of the sentence, such as "NAME failed in act"; the fault follows.
      kind: Type of the error that replaces an exception; SystemExit always becomes a RunError.
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


def fault(error: BaseException) -> str:
    """Returns one line: an error's type and text, and the last file and line of the user's code."""
    text = type(error).__name__
    with contextlib.suppress(Exception):  # its own text may fail, too
        text = " ".join(f"{text}: {error}".split())
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        python = frame.filename.startswith(_PYTHON)
        library = frame.filename.startswith(str(_LIBRARIES))
        if not frame.filename.startswith(_OURS) and (library or not python):
            return f"{text}, {Path(frame.filename).name} line {frame.lineno}"
    return text
