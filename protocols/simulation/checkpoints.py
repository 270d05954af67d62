"""The files in `OUT/checkpoints`: checkpoints of unfinished cohorts, results of finished ones."""

from __future__ import annotations

from pathlib import Path

from ..errors import DamagedFileError
from ..experiment.conditions import CohortKey
from ..experiment.experiment import Experiment
from ..results.results import Lives
from ..storage import load_arrays, save_arrays
from .cohort import Cohort

CHECKPOINTS = "checkpoints"


def checkpoint_file(directory: Path, key: CohortKey) -> Path:
    """Returns the file of an unfinished cohort's last checkpoint, in a run's folder."""
    return directory / CHECKPOINTS / f"{key}.safetensors"


def finished_file(directory: Path, key: CohortKey) -> Path:
    """Returns the file that keeps a finished cohort's results until the whole run is finished."""
    return directory / CHECKPOINTS / f"{key}.finished.safetensors"


def save_checkpoint(directory: Path, key: CohortKey, cohort: Cohort) -> None:
    """Writes a cohort's checkpoint.

    Raises:
      OSError: the file cannot be written.
    """
    arrays, notes = cohort.checkpoint()
    save_arrays(checkpoint_file(directory, key), arrays, cohort=str(key), **notes)


def restored_cohort(directory: Path, experiment: Experiment, key: CohortKey) -> tuple[Cohort, str]:
    """Returns a cohort from its checkpoint, or a new one, and a message about a damaged file."""
    path = checkpoint_file(directory, key)
    cohort = Cohort(experiment, key)
    try:
        cohort.restore(*load_arrays(path))
    except FileNotFoundError:
        return cohort, ""
    except (DamagedFileError, ValueError, KeyError) as error:
        return Cohort(experiment, key), set_aside(path, key, error)
    return cohort, ""


def save_lives(path: Path, lives: Lives) -> None:
    """Writes the results of a finished cohort.

    Raises:
      OSError: the file cannot be written.
    """
    arrays = {"events": lives.events, "minutes": lives.minutes, "valid": lives.valid}
    for when, networks in (("before", lives.before), ("after", lives.after)):
        arrays |= {f"{when}/{name}": array for name, array in networks.items()}
    save_arrays(path, arrays)


def read_lives(path: Path) -> Lives:
    """Reads the results of a finished cohort.

    Raises:
      FileNotFoundError: there is no such file.
      DamagedFileError: the file is damaged.
    """
    arrays, _ = load_arrays(path)
    return Lives(
        arrays["events"],
        arrays["minutes"],
        arrays["valid"],
        *(
            {k.partition("/")[2]: v for k, v in arrays.items() if k.startswith(f"{when}/")}
            for when in ("before", "after")
        ),
    )


def set_aside(path: Path, key: CohortKey, error: Exception) -> str:
    """Renames a damaged file, and returns the message that says so."""
    path.replace(path.with_suffix(".damaged"))
    return f"{error}; set aside, cohort {key} starts anew"
