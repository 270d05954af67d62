"""Checkpoints of unfinished cohorts and results of finished ones, in a run's `checkpoints/`."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from ...tasks.lives import control_steps
from ..errors import DamagedFileError
from ..storage import load_arrays, save_arrays
from .cohort import Cohort
from .conditions import CohortKey
from .experiment import Experiment
from .manifest import UNREADABLE, check_identity
from .run import Lives

CHECKPOINTS = "checkpoints"


def checkpoint_file(directory: Path, key: CohortKey) -> Path:
    """Returns the path of an unfinished cohort's checkpoint; `directory` is the run's folder."""
    return directory / CHECKPOINTS / f"{key}.safetensors"


def finished_file(directory: Path, key: CohortKey) -> Path:
    """Returns the path of a finished cohort's results, kept until all cohorts are finished."""
    return directory / CHECKPOINTS / f"{key}.finished.safetensors"


def save_checkpoint(path: Path, cohort: Cohort) -> None:
    """Writes a cohort's checkpoint."""
    arrays, notes = cohort.checkpoint()
    save_arrays(path, arrays, **_identity(cohort.experiment, cohort.key), **notes)


def restored_cohort(path: Path, experiment: Experiment, key: CohortKey) -> tuple[Cohort, str]:
    """Returns a cohort, restored from its checkpoint or new, and a message.

    The message reports a damaged checkpoint; otherwise it is empty.
    """
    cohort = Cohort(experiment, key)
    try:
        arrays, notes = load_arrays(path)
        check_identity(path, notes, _identity(experiment, key))
        cohort.restore(arrays, notes)
        return cohort, ""
    except FileNotFoundError:
        return cohort, ""
    except DamagedFileError as error:
        damage = str(error)
    except UNREADABLE as error:
        damage = f"{path} is damaged ({error!r:.200})"
    return Cohort(experiment, key), set_aside(path, key, damage)


def read_minutes(directory: Path, experiment: Experiment, key: CohortKey) -> np.ndarray:
    """Reads from a cohort's checkpoint how often the measured event has happened so far.

    Returns:
      Number of control steps in contact, or in the spot, of each valid robot in each whole
      simulated minute, shape (n, m). Without a readable checkpoint m is 0.
    """
    try:
        arrays, notes = load_arrays(path := checkpoint_file(directory, key))
        check_identity(path, notes, _identity(experiment, key))
        whole = notes["step"] // control_steps(1)
        return arrays["minutes"][arrays["batch.valid"], :whole]
    except (OSError, DamagedFileError, KeyError):  # the cohort's job reports the damage
        return np.zeros((experiment.cohort_size, 0), np.int16)


def save_lives(path: Path, lives: Lives, experiment: Experiment, key: CohortKey) -> None:
    """Writes the results of a finished cohort."""
    save_arrays(path, lives.arrays(), **_identity(experiment, key))


def read_lives(path: Path, experiment: Experiment, key: CohortKey) -> Lives:
    """Reads the results of a finished cohort.

    Raises:
      FileNotFoundError: there is no such file.
      DamagedFileError: the file is damaged, or of another cohort or experiment.
    """
    arrays, notes = load_arrays(path)
    check_identity(path, notes, _identity(experiment, key))
    try:
        return Lives.of(arrays)
    except KeyError as error:  # a checkpoint of the cohort
        raise DamagedFileError(f"{path} holds no results ({error})") from error


def _identity(experiment: Experiment, key: CohortKey) -> dict[str, Any]:
    """Returns the JSON notes by which a file names its experiment and its cohort."""
    return {"cohort": str(key), **dataclasses.asdict(experiment)}


def set_aside(path: Path, key: CohortKey, damage: str) -> str:
    """Renames a cohort's damaged file, and returns a message about it."""
    path.replace(path.with_suffix(".damaged"))
    return f"{damage}; set aside, cohort {key} starts anew"
