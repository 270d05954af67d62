"""Lives beside the bare physics that they contain, and the processes that live them.

What `protocols/bench.py` measures, without what it prints; a process that is measured imports
no more than a process of `musebot run`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import multiprocessing
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import median
from typing import Literal, ParamSpec, TypeVar

import mujoco
import numpy as np
import torch
from mujoco import rollout

from ...controller import BRAINS
from ...tasks import Batch
from ..errors import RunError
from ..experiment.experiment import CohortKey, Experiment
from ..simulation.cohort import Cohort, legs
from ..simulation.local import prepare_process
from ..storage import save_arrays

Act = Literal["live", "replay"]
P = ParamSpec("P")
T = TypeVar("T")

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value


@dataclasses.dataclass(frozen=True)
class Setting:
    """Which life is measured, and in blocks of what length.

    Attributes:
      task: "wall_avoidance" or "spot_finding".
      proposer: "fixed", "random" or "creative".
      robots: of the cohort.
      steps: control steps in a block.
      brain: name of the robots' brain.
    """

    task: str
    proposer: str
    robots: int
    steps: int
    brain: str = "paper"

    @property
    def robot_steps(self) -> int:
        """Robot-control-steps in a block."""
        return self.robots * self.steps


class Life:
    """A cohort from the first step of its training on, and a bare replay of what it did last.

    Training, where robots also learn, is the dearest part of a life; the tests before it are
    left out.

    Attributes:
      setting: what is lived.
      brain_seconds: spent in the brains' acting and learning, in the last block.
      physics_seconds: spent in MuJoCo, likewise.
    """

    def __init__(self, setting: Setting) -> None:
        """Gives birth to the robots."""
        self.setting = setting
        self.brain_seconds = self.physics_seconds = 0.0
        self._cohort = _newborn(setting)
        _begin_training(self._cohort, setting)
        self._watch()
        self._motors: list[np.ndarray] = []
        self._start = self._state().copy()
        batch = self._cohort.batch
        assert isinstance(batch, Batch)  # of MuJoCo's own body
        self._bare = Bare(batch.model, setting.robots, batch.substeps)

    def live(self) -> float:
        """Lives a block; returns its seconds."""
        self._motors.clear()
        self._start[:] = self._state()
        self.brain_seconds = self.physics_seconds = 0.0
        began = time.perf_counter()
        self._cohort.advance(self.setting.steps)
        return time.perf_counter() - began

    def replay(self) -> float:
        """Drives bare robots through the last block; returns its seconds.

        Raises:
          RunError: they did not arrive in the same states to the bit: the work was not equal.
        """
        seconds = self._bare.drive(self._start, np.array(self._motors, dtype=float))
        if not np.array_equal(self._bare.state, self._state()):
            raise RunError(
                f"the bare replay of {self.setting} did not end in the states of the life; "
                "was a robot unstable, or placed anew?"
            )
        return seconds

    def _state(self) -> np.ndarray:
        return self._cohort.batch.arrays()["state"]

    def _watch(self) -> None:
        # A few microseconds a control step, of all robots together, counted against the life.
        agent, batch = self._cohort.agent, self._cohort.batch
        assert isinstance(batch, Batch)  # of MuJoCo's own body
        agent.act = self._timed("brain_seconds", agent.act)
        agent.learn = self._timed("brain_seconds", agent.learn)
        batch.simulate = self._timed("physics_seconds", batch.simulate)
        step = batch.step

        def record(motors: np.ndarray) -> None:
            self._motors.append(motors.copy())
            step(motors)

        batch.step = record

    def _timed(self, clock: str, call: Callable[P, T]) -> Callable[P, T]:
        def timed(*args: P.args, **kwargs: P.kwargs) -> T:
            began = time.perf_counter()
            result = call(*args, **kwargs)
            setattr(self, clock, getattr(self, clock) + time.perf_counter() - began)
            return result

        return timed


def _newborn(setting: Setting) -> Cohort:
    key = CohortKey(setting.task, setting.proposer, 0)
    return Cohort(Experiment(brain=BRAINS[setting.brain], cohort_size=setting.robots), key)


def _begin_training(cohort: Cohort, setting: Setting) -> None:
    schedule = Experiment().schedule(setting.task)
    cohort.step = next(leg.start for leg in legs(schedule) if leg.phase.learning)
    cohort.advance(1)  # which places the robots


class Bare:
    """`mujoco.rollout` and nothing else: one call a control step, all its sensors.

    The least that any program must do that decides every motor anew: no argument is checked,
    no output allocated, no array prepared while the clock runs.
    """

    def __init__(self, model: mujoco.MjModel, robots: int, substeps: int, threads: int = 0) -> None:
        """Makes robots, stepped by so many threads; 0 for the calling one."""
        self._substeps = substeps
        self._models = [model] * robots
        self._scratch = [mujoco.MjData(model) for _ in range(max(threads, 1))]
        self._engine = rollout.Rollout(nthread=threads)
        self.state = np.zeros((robots, mujoco.mj_stateSize(model, _STATE)))
        self._states = np.zeros((robots, substeps, self.state.shape[1]))
        self._sensors = np.zeros((robots, substeps, model.nsensordata))

    def drive(self, start: np.ndarray, motors: np.ndarray) -> float:
        """Drives robots from states (B, n) with motors (T, B, 2); returns the loop's seconds."""
        controls = np.repeat(motors[:, :, None], self._substeps, axis=2)
        self.state[:] = start
        began = time.perf_counter()
        for control in controls:
            self._engine.rollout(
                self._models,
                self._scratch,
                self.state,
                control,
                nstep=self._substeps,
                state=self._states,
                sensordata=self._sensors,
                skip_checks=True,
            )
            self.state[:] = self._states[:, -1]
        return time.perf_counter() - began


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Blocks of a life and of its bare physics, in turns, in one process.

    Attributes:
      setting: what was lived.
      life: seconds of each block lived.
      brain: seconds of each block spent in the brains.
      physics: seconds of each block spent in MuJoCo, which evaluates the sensors in the last
        substep of a control step alone; the bare replay does so in all of them.
      bare: seconds of each block replayed.
    """

    setting: Setting
    life: tuple[float, ...]
    brain: tuple[float, ...]
    physics: tuple[float, ...]
    bare: tuple[float, ...]

    @property
    def ratios(self) -> list[float]:
        """Throughput of the life over that of the bare physics, of each block."""
        return [bare / life for life, bare in zip(self.life, self.bare, strict=True)]

    @property
    def ratio(self) -> float:
        """The blocks' median."""
        return median(self.ratios)

    @property
    def microseconds(self) -> dict[str, float]:
        """Of a robot-step, medians of the blocks: total, physics, brain, rest; and bare."""
        per_step = 1e6 / self.setting.robot_steps
        rest = [a - b - c for a, b, c in zip(self.life, self.brain, self.physics, strict=True)]
        return {
            "total": median(self.life) * per_step,
            "physics": median(self.physics) * per_step,
            "brain": median(self.brain) * per_step,
            "rest": median(rest) * per_step,
            "bare": median(self.bare) * per_step,
        }


def compare(setting: Setting, blocks: int) -> Comparison:
    """Lives and replays blocks in turns; a first one, to warm up, is thrown away."""
    life = Life(setting)
    life.live()
    life.replay()
    rows = [
        (life.live(), life.brain_seconds, life.physics_seconds, life.replay())
        for _ in range(blocks)
    ]
    lived, brain, physics, bare = zip(*rows, strict=True)
    return Comparison(setting, lived, brain, physics, bare)


@dataclasses.dataclass(frozen=True)
class BrainCost:
    """What brains take of the blocks of a life.

    Attributes:
      setting: what was lived.
      life: seconds of each block.
      brain: seconds of each block spent in acting and learning.
    """

    setting: Setting
    life: tuple[float, ...]
    brain: tuple[float, ...]

    @property
    def microseconds(self) -> float:
        """Of a robot-step, in the brain, the blocks' median."""
        return 1e6 * median(self.brain) / self.setting.robot_steps

    @property
    def share(self) -> float:
        """The brains' share of the time, the blocks' median."""
        return median(brain / life for brain, life in zip(self.brain, self.life, strict=True))

    def ratio(self, other: BrainCost) -> float:
        """These brains' seconds over those of others that lived in turns, the blocks' median."""
        return median(a / b for a, b in zip(self.brain, other.brain, strict=True))


def brain_costs(setting: Setting, names: Sequence[str], blocks: int) -> dict[str, BrainCost]:
    """Lives blocks with each of several brains, in turns; a first one, to warm up, is thrown away.

    Returns:
      By the brain's name.
    """
    crew = [Life(dataclasses.replace(setting, brain=name)) for name in names]
    for life in crew:
        life.live()
    rows = [[(life.live(), life.brain_seconds) for life in crew] for _ in range(blocks)]
    return {
        life.setting.brain: BrainCost(life.setting, *zip(*own, strict=True))
        for life, own in zip(crew, zip(*rows, strict=True), strict=True)
    }


class Worker:
    """A process that lives, or replays, a block whenever it is told to."""

    def __init__(self, setting: Setting, *, timers: bool = False) -> None:
        """Starts it; the first answer says that it is ready.

        Args:
          setting: its life.
          timers: whether MuJoCo's timers run there, as they do unless they are stopped.
        """
        context = multiprocessing.get_context("spawn")
        self._pipe, far = context.Pipe()
        self._process = context.Process(target=_serve, args=(far, setting, timers), daemon=True)
        self._process.start()
        far.close()  # or a death there would never be noticed here

    def tell(self, act: Act) -> None:
        """Has a block lived, or the last one replayed."""
        with contextlib.suppress(OSError):  # `answer` says that it died
            self._pipe.send(act)

    def answer(self) -> float:
        """Waits for the block's seconds.

        Raises:
          RunError: the process died.
        """
        try:
            return self._pipe.recv()
        except (EOFError, OSError) as error:
            raise RunError("a process died, perhaps for want of memory") from error

    def close(self) -> None:
        """Ends the process."""
        self._pipe.close()
        self._process.join()


def _serve(pipe: Connection, setting: Setting, timers: bool) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends us
    torch.set_num_threads(1) if timers else prepare_process()
    life = Life(setting)
    life.live()
    life.replay()
    with contextlib.suppress(EOFError, OSError):  # nobody asks any more
        pipe.send(0.0)
        while True:
            pipe.send(life.live() if pipe.recv() == "live" else life.replay())


@contextlib.contextmanager
def workers(settings: Sequence[Setting], timers: Sequence[bool] = ()) -> Iterator[list[Worker]]:
    """Processes for settings, ready; they end with the context."""
    switches = timers or [False] * len(settings)
    crew: list[Worker] = []
    try:
        for setting, switch in zip(settings, switches, strict=True):
            crew.append(Worker(setting, timers=switch))
        for worker in crew:
            worker.answer()
        yield crew
    finally:
        for worker in crew:
            worker.close()


def together(crew: Sequence[Worker], act: Act) -> float:
    """Seconds until all of them, at the same time, have finished a block."""
    for worker in crew:
        worker.tell(act)
    return max([worker.answer() for worker in crew])


@dataclasses.dataclass(frozen=True)
class Scaling:
    """One process against several, the same block of work in each, in turns.

    Attributes:
      setting: what each lived.
      processes: how many at most.
      one: seconds of a block, alone, for each turn the mean of the two processes.
      two: seconds until two processes had finished a block each, for each turn.
      all: the same of all processes.
    """

    setting: Setting
    processes: int
    one: tuple[float, ...]
    two: tuple[float, ...]
    all: tuple[float, ...]

    @property
    def ratio(self) -> float:
        """How many times one process's throughput two reach: the turns' median."""
        return median(2 * one / two for one, two in zip(self.one, self.two, strict=True))

    @property
    def robot_steps_per_second(self) -> float:
        """Of all processes together, the turns' median."""
        return self.processes * self.setting.robot_steps / median(self.all)


def scaling(setting: Setting, processes: int, turns: int) -> dict[Act, Scaling]:
    """One process, two, and all, living and replaying in turns."""
    seconds: dict[Act, list[tuple[float, float, float]]] = {"live": [], "replay": []}
    with workers([setting] * max(2, processes)) as crew:
        for _ in range(turns):
            for act, rows in seconds.items():
                # Each of the two has a turn alone, for cores may differ.
                one = sum(together([worker], act) for worker in crew[:2]) / 2
                two = together(crew[:2], act)
                everyone = crew[:processes]
                rows.append((one, two, two if everyone == crew[:2] else together(everyone, act)))
    return {
        act: Scaling(setting, processes, *zip(*rows, strict=True)) for act, rows in seconds.items()
    }


def with_and_without_timers(setting: Setting, turns: int) -> tuple[float, float]:
    """Seconds of a bare block with MuJoCo's timers on and off, medians of blocks in turns."""
    seconds = []
    with workers([setting] * 2, timers=[True, False]) as crew:
        for _ in range(turns):
            seconds.append([together([worker], "replay") for worker in crew])
    timed, plain = zip(*seconds, strict=True)
    return median(timed), median(plain)


def peak_memory(setting: Setting) -> float:
    """Peak of a fresh process that lives a block and saves a checkpoint, in MB of 10^6 bytes.

    Raises:
      RunError: the process died.
    """
    context = multiprocessing.get_context("spawn")
    near, far = context.Pipe(duplex=False)
    process = context.Process(target=_live_and_weigh, args=(far, setting), daemon=True)
    process.start()
    far.close()
    try:
        return near.recv()
    except EOFError as error:
        raise RunError("a process died, perhaps for want of memory") from error
    finally:
        process.join()


def _live_and_weigh(pipe: Connection, setting: Setting) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    prepare_process()
    cohort = _newborn(setting)
    cohort.advance(1)  # of a test
    _begin_training(cohort, setting)
    cohort.advance(setting.steps)
    arrays, notes = cohort.checkpoint()
    with tempfile.TemporaryDirectory() as folder:
        save_arrays(Path(folder) / "checkpoint.safetensors", arrays, **notes)
    pipe.send(peak_bytes() / 1e6)


def peak_bytes() -> int:
    """The most memory that this process has ever held."""
    # Linux hands ru_maxrss down from the process that started this one; VmHWM is our own.
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
