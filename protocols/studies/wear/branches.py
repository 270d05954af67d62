"""Four more hours of training in the changed body, an arm of a cohort each, with probes."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ....models import CHANGES
from ....tasks import Robots
from ...agents.base import sound
from ...agents.factory import make_agent
from ...errors import DamagedFileError, InputError
from ...experiment.experiment import Experiment
from ...experiment.manifest import UNREADABLE
from ...experiment.random_streams import random_streams
from ...playback.rollout import Mode, Tick, count_events
from ...simulation.jobs import Report, Stop
from ...simulation.placement import place
from ...storage import load_arrays, save_arrays
from ..jobs import SAVE_EVERY, MinuteTick, StoppedError, check_notes, check_shares
from .arms import ARMS, FROZEN, NEWBORN, Arm
from .lives import LifeJob, OldBrains
from .probes import CONDITION, PERIODS, PERIODS_PER_SPOT, TRAINING, period, probe


class Branch:
    """Robots of an arm after the change of the body.

    Attributes:
      experiment: Experiment with the arm's brain.
      agent: Brains of the robots.
      batch: Robots in the changed body.
      shares: Share of time in the spot in each probe so far, arrays of shape (B,).
    """

    def __init__(self, life: LifeJob, old: OldBrains, change: str, arm: Arm) -> None:
        """Changes the body of a finished life's robots.

        Args:
          life: Finished job of the robots' life.
          old: What that job left.
          change: Name of the change, a key of `CHANGES`.
          arm: Arm that says what is kept of the brains.
        """
        self._life, self._arm, self._edits = life, arm, [CHANGES[change]]
        self.experiment = dataclasses.replace(
            life.experiment, brain=arm.brain(life.experiment.brain)
        )
        robots = self.experiment.cohort_size
        # The seed of a birth: newborns are the same brains as the old ones were.
        seed, _ = random_streams(self.experiment.seed, life.key)
        self.agent = make_agent(self.experiment, CONDITION, robots, seed)
        if arm.name != NEWBORN:
            self.agent.load_state(arm.state(old.part("brain"), old.part("before")))
        self.batch = _rebuilt(life.experiment, old, self._edits)
        self.agent.reset()
        self._random = old.random
        self.shares: list[np.ndarray] = []

    def advance(self, tick: Tick) -> None:
        """Trains for ten minutes, unless nothing was probed yet or the arm is frozen; probes."""
        if self.shares and self._arm.name != FROZEN:
            if (len(self.shares) - 1) % PERIODS_PER_SPOT == 0:
                place(self.batch, TRAINING, self._random)
            steps = period(self.experiment)
            count_events(self.batch, self.agent, steps, tick=tick, mode=Mode(True, True))
            self.batch.stop(~sound(self.agent.weights(), self.batch.robots))
        stream = "changed", self._life.index, len(self.shares)
        shares = probe(self.experiment, self.agent.weights(), stream, self._edits, tick)
        self.shares.append(np.where(self.batch.valid, shares, np.nan))

    def checkpoint(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Returns copies of arrays, and notes, from which `restore` continues bit-exactly."""
        arrays = {f"brain.{name}": array.copy() for name, array in self.agent.state().items()}
        arrays |= {f"batch.{name}": array.copy() for name, array in self.batch.arrays().items()}
        arrays["shares"] = np.array(self.shares).reshape(-1, self.batch.robots)
        return arrays, {"random": self._random.bit_generator.state}

    def restore(self, arrays: Mapping[str, np.ndarray], notes: Mapping[str, Any]) -> None:
        """Continues from a checkpoint of the same arm.

        Raises:
          KeyError, ValueError, TypeError: something is missing, or its shape differs.
        """
        parts: dict[str, dict[str, np.ndarray]] = {"brain": {}, "batch": {}}
        for name, array in arrays.items():
            part, _, rest = name.partition(".")
            if rest:
                parts[part][rest] = array
        self.agent.load_state(parts["brain"])
        self.batch.load_arrays(parts["batch"])
        self._random.bit_generator.state = notes["random"]
        self.shares = [*arrays["shares"]]


def _rebuilt(experiment: Experiment, old: OldBrains, edits: list[Any]) -> Robots:
    """Returns the robots of a checkpoint in a changed body, at rest where they were."""
    before = experiment.batch(CONDITION.task, experiment.cohort_size)
    before.load_arrays(old.part("batch"))
    everyone = np.arange(before.robots)
    after = experiment.batch(CONDITION.task, before.robots, edits)
    after.place_spot(everyone, before.spot)
    after.place(everyone, before.pose)
    after.stop(~before.valid)
    return after


@dataclasses.dataclass(frozen=True)
class BranchJob:
    """Simulates an arm of a cohort after the change, and stores what its probes gave.

    Attributes:
      folder: Folder of the change's files, an absolute path.
      life: Job of the cohort's life.
      change: Name of the change, a key of `CHANGES`.
      arm: Name of the arm, a key of `ARMS`.
      digest: Digest of the life's brains, see `OldBrains.digest`: a file of other brains is not
        done. Empty where the life's file was deleted.
    """

    folder: Path
    life: LifeJob
    change: str
    arm: str
    digest: str = ""

    def __str__(self) -> str:
        return f"{self.change}, {self.arm}, cohort {self.life.index}"

    @property
    def path(self) -> Path:
        """See `Job.path`; the file is also the checkpoint."""
        return self.folder / f"{self.arm}-{self.life.index:04d}.safetensors"

    @property
    def cost(self) -> float:
        """See `Job.cost`."""
        trained = 0 if self.arm == FROZEN else PERIODS
        steps = (trained + PERIODS + 1) * period(self.life.experiment)
        return self.life.experiment.robot_seconds(steps)

    def done(self) -> bool:
        """See `Job.done`."""
        if not self.path.exists():
            return False
        arrays, notes = self._read()
        own = not self.digest or notes["life"] == self.digest
        return own and len(arrays["shares"]) > PERIODS

    def run(self, stop: Stop, report: Report) -> bool:
        """See `Job.run`; continues bit-exactly from the last probe that was stored.

        Raises:
          InputError: the life is not finished.
        """
        old = self.life.brains()
        if old is None:
            raise InputError(f"{self.life.folder} lacks the whole of {self.life.path.name}")
        branch, life = Branch(self.life, old, self.change, ARMS[self.arm]), old.digest
        if self.path.exists():
            arrays, notes = self._read()
            if notes["life"] == life:
                self._restore(branch, arrays, notes)
        begun = len(branch.shares) / (PERIODS + 1) * self.cost
        tick = MinuteTick(self, self.life.experiment.cohort_size, stop, report, begun)
        saved, kept = time.monotonic(), branch.checkpoint()
        try:
            while len(branch.shares) <= PERIODS:
                branch.advance(tick)
                kept = branch.checkpoint()
                if time.monotonic() - saved > SAVE_EVERY:
                    self._save(*kept, life)
                    saved = time.monotonic()
        except StoppedError:
            self._save(*kept, life)
            return False
        self._save({"shares": np.array(branch.shares), "reference": old.reference}, {}, life)
        report(self.cost, "")
        return True

    def shares(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Reads the share of time in the spot in each probe; None if the job is not finished.

        Returns:
          Shares in the probes before the change, shape (R, B), and at 0, 10, ... 240 minutes after
          it, shape (P, B); NaN for a robot that was stopped.

        Raises:
          DamagedFileError: the file is damaged, or another job's.
        """
        if not self.path.exists():
            return None
        arrays, _ = self._read()
        return (arrays["reference"], arrays["shares"]) if "reference" in arrays else None

    def _save(self, arrays: Mapping[str, np.ndarray], notes: Mapping[str, Any], life: str) -> None:
        save_arrays(self.path, arrays, **notes, **self._identity, life=life)

    @property
    def _identity(self) -> dict[str, Any]:
        return {
            "change": dataclasses.asdict(CHANGES[self.change]),
            "arm": self.arm,
            "experiment": self.life.experiment.seed,
        }

    def _read(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        arrays, notes = load_arrays(self.path)
        robots = self.life.experiment.cohort_size
        check_notes(self.path, notes, self._identity)
        shares = arrays.get("shares")
        if "life" not in notes or shares is None or shares.dtype != np.float64:
            raise DamagedFileError(f"{self.path} is damaged (it has no shares)")
        if shares.shape[1:] != (robots,) or len(shares) > PERIODS + 1:
            raise DamagedFileError(f"{self.path} is damaged (its shares are of {shares.shape})")
        reference = arrays.get("reference", shares[:0])
        if (len(shares) > PERIODS) != ("reference" in arrays) or reference.shape[1:] != (robots,):
            raise DamagedFileError(f"{self.path} is damaged (its reference is missing or foreign)")
        for values in (shares, reference):
            check_shares(self.path, values)
        return arrays, notes

    def _restore(
        self, branch: Branch, arrays: Mapping[str, np.ndarray], notes: Mapping[str, Any]
    ) -> None:
        if len(arrays["shares"]) > PERIODS:  # finished, of this life
            branch.shares = [*arrays["shares"]]
            return
        try:
            branch.restore(arrays, notes)
        except UNREADABLE as error:
            raise DamagedFileError(f"{self.path} is damaged ({error!r:.200})") from error
