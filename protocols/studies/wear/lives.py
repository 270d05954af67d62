"""The old brains: ordinary lives up to the change of the body, kept as full checkpoints."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import DamagedFileError, InputError
from ...experiment.conditions import CohortKey
from ...experiment.experiment import Experiment, check_same
from ...experiment.manifest import UNREADABLE, experiment_from
from ...simulation.cohort import Cohort, shapes_of
from ...simulation.jobs import Report, Stop
from ...storage import digest, load_arrays, save_arrays
from ..jobs import MinuteTick, StoppedError, advance, check_shares
from .probes import CONDITION, REFERENCES, period, probe


@dataclasses.dataclass(frozen=True)
class OldBrains:
    """A cohort of B robots at the moment of the change.

    Attributes:
      arrays: Arrays of the cohort's checkpoint.
      notes: Notes of the cohort's checkpoint.
      reference: Share of time in the spot in each probe before the change, shape (P, B).
    """

    arrays: dict[str, np.ndarray]
    notes: dict[str, Any]
    reference: np.ndarray

    def part(self, name: str) -> dict[str, np.ndarray]:
        """Returns a part of the checkpoint: "brain", "before" (the newborn networks) or "batch"."""
        start = f"{name}."
        return {k.removeprefix(start): v for k, v in self.arrays.items() if k.startswith(start)}

    @property
    def random(self) -> np.random.Generator:
        """The random stream of the placements, which continues from the checkpoint."""
        random = np.random.default_rng()
        random.bit_generator.state = self.notes["random"]
        return random

    @property
    def digest(self) -> str:
        """Digits that identify these brains."""
        return digest(self.arrays | {"reference": self.reference})


@dataclasses.dataclass(frozen=True)
class LifeJob:
    """Simulates a cohort to the end of its training, and probes its frozen brains.

    Attributes:
      folder: Folder of the file, an absolute path.
      experiment: Experiment of the robots.
      index: Number of the cohort.
    """

    folder: Path
    experiment: Experiment
    index: int

    def __str__(self) -> str:
        return f"life of cohort {self.index}"

    @property
    def key(self) -> CohortKey:
        """Condition and number of the cohort."""
        return CohortKey(CONDITION, self.index)

    @property
    def path(self) -> Path:
        """See `Job.path`; the file is also the checkpoint."""
        return self.folder / f"life-{self.index:04d}.safetensors"

    @property
    def steps(self) -> int:
        """Number of control steps up to the change."""
        schedule = self.experiment.schedule(CONDITION.task)
        return schedule.steps_of("pre") + schedule.steps_of("training")

    @property
    def cost(self) -> float:
        """See `Job.cost`."""
        return self.experiment.robot_seconds(self.steps + REFERENCES * period(self.experiment))

    def done(self) -> bool:
        """See `Job.done`."""
        return self.path.exists() and len(self._restored()[1]) == REFERENCES

    def run(self, stop: Stop, report: Report) -> bool:
        """See `Job.run`; continues bit-exactly from its last checkpoint."""
        cohort, reference = self._restored()
        begun = self.experiment.robot_seconds(cohort.step)
        tick = MinuteTick(self, self.experiment.cohort_size, stop, report, begun)
        try:
            advance(cohort, self.steps, tick, lambda: self._save(cohort, reference))
        except StoppedError:
            return False
        try:
            shares = [
                probe(
                    self.experiment,
                    cohort.agent.weights(),
                    ("reference", self.index, number),
                    tick=tick,
                )
                for number in range(REFERENCES)
            ]
        except StoppedError:
            self._save(cohort, reference)
            return False
        self._save(cohort, np.where(cohort.batch.valid, shares, np.nan))
        report(self.cost, "")
        return True

    def brains(self) -> OldBrains | None:
        """Reads the job's file; None if the job is not finished.

        Raises:
          DamagedFileError: the file is damaged, or another job's.
        """
        cohort, reference = self._restored()
        if len(reference) != REFERENCES:
            return None
        arrays, notes = cohort.checkpoint()
        return OldBrains(arrays, notes, reference)

    def check(self) -> None:
        """Raises DamagedFileError if the file is damaged or another's."""
        self._restored()

    def _restored(self) -> tuple[Cohort, np.ndarray]:
        """Returns the cohort as stored, or newborn, and its probes, shape (0 or P, B)."""
        cohort = Cohort(self.experiment, self.key)
        none = np.empty((0, self.experiment.cohort_size))
        if not self.path.exists():
            return cohort, none
        arrays, notes = load_arrays(self.path)
        try:
            held = experiment_from(notes["experiment"])
            check_same("an experiment", held, self.experiment)
            if notes["index"] != self.index:
                raise ValueError(f"it is cohort {notes['index']}")
            reference = arrays.pop("reference")
            if reference.shape not in (none.shape, (REFERENCES, none.shape[1])):
                raise ValueError(f"reference has the shape {reference.shape}")
            check_shares(self.path, reference)
            cohort.check_shapes(shapes_of(arrays))
            cohort.restore(arrays, notes)
            if cohort.step > self.steps or (len(reference) and cohort.step < self.steps):
                raise ValueError(f"step {cohort.step} is not before the change")
        except (InputError, *UNREADABLE) as error:
            raise DamagedFileError(f"{self.path} is of other robots ({error!r:.200})") from error
        return cohort, reference

    def _save(self, cohort: Cohort, reference: np.ndarray) -> None:
        arrays, notes = cohort.checkpoint()
        own = {"experiment": dataclasses.asdict(self.experiment), "index": self.index}
        save_arrays(self.path, arrays | {"reference": reference}, **notes, **own)
