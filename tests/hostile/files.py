"""Kinds of files that are read: real ones, the changes that hostile cases make, and the readers."""

import dataclasses
import functools
import hashlib
import json
import os
import shutil
from pathlib import Path

import numpy as np
import safetensors
from helpers import forget_digests
from hostile import mutations as change
from hostile.mutations import one

from musebot.protocols import exit_status
from musebot.protocols.agents.names import recorded_name
from musebot.protocols.agents.ppo import Policies, policy_arrays
from musebot.protocols.compare.study import conduct
from musebot.protocols.errors import Interrupted
from musebot.protocols.lives import checkpoints
from musebot.protocols.lives.cohort import Cohort
from musebot.protocols.lives.conditions import CohortKey, Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.manifest import write_manifest
from musebot.protocols.lives.plan import Plan
from musebot.protocols.lives.run import Robot
from musebot.protocols.lives.run_files import read_run, write_results
from musebot.protocols.pages.stored_brains import StoredRobot
from musebot.protocols.storage import load_arrays, save_arrays
from musebot.protocols.studies.learning_progress.frozen_brains import evaluation
from musebot.protocols.studies.learning_progress.study import LearningProgress
from musebot.protocols.studies.timestep import Timestep

NAN = float("nan")
WALLS, SPOT = Condition("wall_avoidance", "fixed"), Condition("spot_finding", "creative")
KEY = CohortKey(SPOT, 0)
TASK = "wall_avoidance_unit"


def experiment(seed, time_scale=0.05):
    """Returns the experiment of a run; its tests last 60 s and 180 s."""
    return Experiment(seed=seed, cohort_size=2, time_scale=time_scale, body="kinematic")


def short(seed):
    """Returns an experiment that can be simulated in no time."""
    return experiment(seed, 0.002)


def _rows(seed):
    late = 1.0 + seed
    walls = [
        Robot("wall_avoidance", "fixed", seed, 0, 0, 12.5, 0.0, 1.0, "L = 1"),
        Robot("wall_avoidance", "fixed", seed, 0, 1, 0.0, 0.0, NAN, "genius"),
        Robot("wall_avoidance", "fixed", seed, 1, 2, 3 * late, late, 0.5, "0 < L < 1"),
        Robot("wall_avoidance", "fixed", seed, 1, 3, 60.0, 60.0, NAN, "invalid"),
    ]
    spot = [
        Robot("spot_finding", "creative", seed, 0, 0, late, 3 * late, 0.5, "0 < L < 1"),
        Robot("spot_finding", "creative", seed, 0, 1, 3.0, 3.0, 0.0, "L = 0"),
    ]
    return walls, spot


class Nobody:
    """An executor of studies whose jobs are all done; whoever still has jobs is interrupted."""

    def __call__(self, jobs, progress):
        raise Interrupted
        yield


def make(folder, seed, invented):
    """Writes files of every kind, as musebot does.

    Args:
      folder: Folder to write them into.
      seed: Seed of all random streams; two folders of different seeds are of different robots.
      invented: Function `conftest.invented_results`.
    """
    run = folder / "run"
    walls, spot = _rows(seed)
    write_manifest(run, Plan(experiment(seed), {WALLS: 4, SPOT: 2}))
    write_results(
        run,
        {
            WALLS: invented(experiment(seed), walls, seed),
            SPOT: invented(experiment(seed), spot, seed),
        },
    )
    _make_whole_runs(folder, seed, invented)
    cohort = Cohort(short(seed), KEY)
    cohort.advance(cohort.steps // 2)
    checkpoints.save_checkpoint(checkpoints.checkpoint_file(folder, KEY), cohort)
    cohort.advance(10**6)
    path = checkpoints.finished_file(folder, KEY)
    checkpoints.save_lives(path, cohort.lives(), short(seed), KEY)
    draw = np.random.default_rng(seed)
    shapes = {0: (64, 5), 1: (64, 64), 2: (2, 64)}
    arrays = {}
    for name in policy_arrays():
        _, layer, what = name.split(".")
        shape = shapes[int(layer)][: 1 if what == "biases" else 2]
        arrays[name] = draw.normal(0, 0.3, (2, *shape)).astype(np.float32)
    save_arrays(folder / "policies.safetensors", arrays, task=TASK, seed=seed)
    conduct(timestep(), folder / "timestep", Alike())
    (folder / "progress").mkdir()
    for jobs in progress(seed).stages(folder / "progress"):
        for job in jobs:
            assert job.run(lambda: False, lambda done, message: None)


def _make_whole_runs(folder, seed, invented):
    """Writes runs of full length: one with both bounds of a leaderboard, and a continual one."""
    bounds = [recorded_name(name) for name in ("newborn", "hand_coded")]
    for name, protocol, proposers in (
        ("board", "paper", ("creative", "random", *bounds)),
        ("moved", "continual", ("creative",)),
    ):
        whole, results = dataclasses.replace(experiment(seed, 1), protocol=protocol), {}
        for condition in (Condition("spot_finding", proposer) for proposer in proposers):
            times = ((2.0, 6.0, 0.5, "0 < L < 1"), (3.0, 3.0, 0.0, "L = 0"))
            rows = [Robot("spot_finding", condition.proposer, seed, 0, robot, *row)
                    for robot, row in enumerate(times)]  # fmt: skip
            results[condition] = invented(whole, rows, seed)
        write_manifest(folder / name, Plan(whole, dict.fromkeys(results, 2)))
        write_results(folder / name, results)


def timestep():
    """Returns a study without runs."""
    return Timestep(robots=1, minutes=0.05)


class Alike:
    """An executor of the study `timestep` that measures one timestep only, a fast one."""

    def __call__(self, jobs, progress):
        assert jobs[-1].run(lambda: False, lambda done, message: None)
        arrays, _ = load_arrays(jobs[-1].path)
        arrays["microseconds"] = np.array(10.0)  # the only number that two machines do not share
        for job in jobs:
            save_arrays(job.path, arrays, **job.identity)
            yield job


def progress(seed):
    """Returns a study that reads brains of its own."""
    return LearningProgress(
        brains=("paper",), robots=2, seed=seed, body="kinematic", time_scale=0.002
    )


# ---- Readers: each returns a value that is equal if and only if the results are ----


def _digest(*arrays):
    content = hashlib.blake2b(digest_size=16)
    for array in arrays:
        content.update(
            f"{array.dtype} {array.shape}".encode() + np.ascontiguousarray(array).tobytes()
        )
    return content.hexdigest()


def run_of(folder):
    """Reads a run; returns its experiment, and all else as one value."""
    run = read_run(folder / "run")
    held = []
    for condition, part in run.results.items():
        names = [name for when in ("before", "after") for name in part.networks[when]]
        arrays = [array for when in ("before", "after") for array in part.networks[when].values()]
        assert np.isfinite(part.curves).all(), "curves that are not finite were accepted"
        held.append((str(condition), repr(part.robots), names, _digest(part.curves, *arrays)))
    return run.experiment, held


def film_of(folder):
    """Reads a run and simulates the first moments of a film."""
    run = read_run(folder / "run", replay=True)
    moments = StoredRobot(run, SPOT, 0, "post").episode().moments()
    found = [next(moments) for _ in range(3)]
    motors = np.array([moment.motors for moment in found])
    assert np.isfinite(motors).all(), "motor values that are not finite"
    return run.experiment, _digest(motors, np.array([moment.pose for moment in found]))


def _state_of(cohort):
    arrays, notes = cohort.checkpoint()
    return cohort.step, _digest(*(arrays[k] for k in sorted(arrays))), json.dumps(notes["random"])


def checkpoint_of(folder):
    """Restores a cohort; returns None for one that starts anew, which leads to the same results."""
    path = checkpoints.checkpoint_file(folder, KEY)
    cohort, message = checkpoints.restored_cohort(path, short(1), KEY)
    if cohort.step == 0 and _state_of(cohort) == _newborn():
        return None, bool(message)
    return None, _state_of(cohort)


@functools.cache
def _newborn():
    return _state_of(Cohort(short(1), KEY))


def finished_of(folder):
    """Reads what a finished cohort left."""
    path = checkpoints.finished_file(folder, KEY)
    lives = checkpoints.read_lives(path, short(1), KEY)
    arrays = [*lives.before.values(), *lives.after.values()]
    return None, _digest(lives.events, lives.minutes, lives.valid, *arrays)


def policies_of(folder):
    """Reads policies and lets one act."""
    policy = Policies.load(folder / "policies.safetensors", TASK).one(0)
    state = np.array([[0.3, 0.2, 0.1, 0.5, 0.0]], dtype=np.float32)
    motors = [policy.act(state, trained) for trained in (False, True)]
    assert np.isfinite(motors).all(), "motor values that are not finite"
    return None, _digest(*motors, *(policy.arrays[name] for name in sorted(policy.arrays)))


def study_of(folder):
    """Conducts a finished study again."""
    return None, conduct(timestep(), folder / "timestep", Nobody()).markdown


def timestep_of(folder):
    """Makes the page of a finished study."""
    study = timestep()
    study.check(folder / "timestep")
    text = study.page(folder / "timestep").markdown
    assert "nan" not in text and "inf" not in text, "a page of numbers that are not finite"
    return None, text


def progress_of(folder):
    """Reads brains of a study, and their tests."""
    study = progress(1)
    study.check(folder / "progress")
    (life,) = study.lives(folder / "progress")
    found = evaluation(life)
    networks = found.progress.networks
    assert all(np.isfinite(array).all() for array in networks.values()), "weights not finite"
    return None, _digest(*networks.values(), found.tests)


# ---- Changes ----


def _in_place(mutators):
    """Returns a change of a file's bytes."""

    def changed(draw, path, other):
        del other
        mutator = one(draw, mutators)
        path.write_bytes(mutator(draw, path.read_bytes()))
        return mutator.__name__

    return changed


def _placed(draw, path, other):
    place = one(draw, change.PLACES)
    place(draw, path, other)
    return place.__name__


def _swapped(draw, path, other):
    change.swapped(draw, path, other)
    return "swapped"


def _mixed_up(draw, path, other):
    """Puts another file of the same run there."""
    others = [p for p in sorted(path.parent.iterdir()) if p != path and p.is_file()]
    others += [p for p in sorted(other.parent.parent.rglob("*")) if p.is_file()]
    path.write_bytes(one(draw, others).read_bytes())
    return "mixed_up"


def _forged(draw, path, other):
    """Changes arrays or notes of a file, and writes a digest that fits."""
    arrays, notes = load_arrays(path)
    foreign, foreign_notes = load_arrays(other)
    names = sorted(arrays)
    name = one(draw, names)
    what = draw.integers(10)
    if what == 0:
        own = one(draw, names)
        arrays[name], arrays[own] = arrays[own], arrays[name]
    elif what == 1:
        del arrays[name]
    elif what == 2:
        arrays["../x"] = arrays[name]
    elif what == 3:
        arrays[name] = foreign.get(name, arrays[name])
    elif what == 4:
        notes = foreign_notes
    elif what == 5 and notes:
        text = change.json_mutated(draw, json.dumps(notes).encode())
        try:
            notes = json.loads(text)
            notes = notes if isinstance(notes, dict) else {"x": 1}
            json.dumps(notes)
        except (ValueError, RecursionError):
            notes = {}
    else:
        arrays[name] = change.array_mutated(draw, arrays[name])
    try:
        save_arrays(path, arrays, **{str(k): v for k, v in notes.items()})
    except (safetensors.SafetensorError, KeyError, ValueError, TypeError):  # of no such dtype
        path.write_bytes(path.read_bytes()[:-1])
    return "forged"


def _other_numbers(draw, path, other):
    """Changes rows or arrays of a run so that the file is whole."""
    del other
    mutator = change.rows_mutated if path.suffix == ".csv" else change.npz_mutated
    path.write_bytes(mutator(draw, path.read_bytes()))
    return mutator.__name__


BYTES, JSON = _in_place(change.BYTES), _in_place((change.json_mutated,))
TENSORS = _in_place((change.tensors_mutated,))


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of file.

    Attributes:
      name: Name of the kind.
      file: File within the folder that `make` writes.
      read: Function that reads what the folder holds and returns a pair: settings, and results.
      changes: Functions that change the file, each with its weight.
      writes: Whether the reader writes: it sets aside a damaged checkpoint, or makes a page again.
      digests: Whether the run has digests of its files, which those of earlier versions lack.
    """

    name: str
    file: str
    read: object
    changes: tuple
    writes: bool = False
    digests: bool = True

    def changed(self, draw, folder, other, number):
        """Changes the file in a folder; returns the name of the change.

        The first cases have each of the changes once; all others draw one.
        """
        functions, weights = zip(*self.changes, strict=True)
        weights = np.array(weights) / sum(weights)
        drawn = draw.choice(len(functions), p=weights)
        function = functions[number if number < len(functions) else drawn]
        return function(draw, folder / self.file, other / self.file)


_ARRAYS = ((BYTES, 4), (TENSORS, 3), (_placed, 1), (_swapped, 0.4), (_mixed_up, 0.4), (_forged, 4))
_TEXT = ((BYTES, 3), (JSON, 6), (_placed, 1), (_swapped, 0.3), (_mixed_up, 0.3))
_ROWS = ((BYTES, 3), (_other_numbers, 6), (_placed, 1), (_swapped, 0.3), (_mixed_up, 0.3))

KINDS = (
    Kind("experiment.json", "run/experiment.json", run_of, _TEXT),
    Kind("robots.csv", "run/robots.csv", run_of, _ROWS),
    Kind("curves.npz", "run/curves.npz", run_of, _ROWS),
    Kind("brains.safetensors", "run/brains.safetensors", run_of, _ARRAYS),
    Kind("film of a run", "run/brains.safetensors", film_of, _ARRAYS),
    Kind("checkpoint", f"checkpoints/{KEY}.safetensors", checkpoint_of, _ARRAYS, True),
    Kind("finished cohort", f"checkpoints/{KEY}.finished.safetensors", finished_of, _ARRAYS),
    Kind("policies", "policies.safetensors", policies_of, _ARRAYS),
    Kind("study.json", "timestep/study.json", study_of, _TEXT, True),
    Kind("file of a study", "timestep/substeps-010.safetensors", timestep_of, _ARRAYS),
    Kind("brains of a study", "progress/brains-paper.safetensors", progress_of, _ARRAYS),
    Kind("test of a study", "progress/test-paper-0.safetensors", progress_of, _ARRAYS),
    Kind("old robots.csv", "run/robots.csv", run_of, _ROWS, digests=False),
    Kind("old curves.npz", "run/curves.npz", run_of, _ROWS, digests=False),
)


def copied(kind, base, folder):
    """Copies the files that a reader reads."""
    part = Path(kind.file).parts[0]
    folder.mkdir(parents=True)
    copy = shutil.copytree if (base / part).is_dir() else shutil.copy
    copy(base / part, folder / part)
    if not kind.digests:
        forget_digests(folder / part)


def working(kind, folder):
    """Returns the work of reading a folder, as a command that ends in an exit status."""

    def work():
        found = []
        status = exit_status.exit_status(lambda: found.append(kind.read(folder)), check=False)
        return status, found[0] if found else None

    return work


def mark(folder: Path) -> Path:
    """Returns the folder that code of a data file would make."""
    path = folder / "unpickled"
    os.environ["HOSTILE_MARK"] = str(path)
    return path
