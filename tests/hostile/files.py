"""Hostile cases of files that are read: what may stand in the place of each kind, and its reader.

tests/test_storage.py changes every byte of a file; tests/runs/test_config.py the values of JSON.
"""

import dataclasses
import functools
import hashlib
import json
import os
import shutil

import numpy as np
from helpers import random_policy
from hostile import oracle

from musebot.protocols import exit_status
from musebot.protocols.agents.policy import Policy
from musebot.protocols.runs import checkpoints
from musebot.protocols.runs.cohort import Cohort
from musebot.protocols.runs.conditions import CohortKey, Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.manifest import write_manifest
from musebot.protocols.runs.plan import Plan
from musebot.protocols.runs.run import Robot
from musebot.protocols.runs.run_files import read_run, write_results
from musebot.protocols.storage import save_arrays

WALLS, SPOT = Condition("wall_avoidance", "fixed"), Condition("spot_finding", "creative")
KEY = CohortKey(SPOT, 0)
TASK = "wall_avoidance_unit"
SHORT = Experiment(seed=1, cohort_size=2, time_scale=0.002, body="kinematic")


def make(folder, seed, invented):
    """Writes files of every kind into a folder, of other robots for another seed."""
    short = dataclasses.replace(SHORT, seed=seed)
    experiment = dataclasses.replace(short, time_scale=0.05)
    _make_run(folder / "run", experiment, {WALLS: 4, SPOT: 2}, invented)
    cohort = Cohort(short, KEY)
    cohort.advance(cohort.steps // 2)
    checkpoints.save_checkpoint(checkpoints.checkpoint_file(folder, KEY), cohort)
    cohort.advance(10**6)
    path = checkpoints.finished_file(folder, KEY)
    checkpoints.save_lives(path, cohort.lives(), short, KEY)
    policy = random_policy(TASK, seed=seed)
    save_arrays(folder / "policy.safetensors", policy.arrays, task=TASK, seed=seed)


def _make_run(folder, experiment, robots, invented):
    """Writes a run with invented robots, of which the second of each condition is invalid."""
    folder.mkdir(parents=True)
    measured = {}
    for condition, number in robots.items():
        names = (condition.life, condition.proposer, experiment.seed)
        kinds = ["invalid" if n == 1 else "L < 0" for n in range(number)]
        rows = [Robot(*names, 0, n, float(n), 2.0 * n, 0.0, kinds[n]) for n in range(number)]
        measured[condition] = invented(experiment, rows, experiment.seed)
    write_manifest(folder, Plan(experiment, robots))
    write_results(folder, experiment, measured)


# ---- Readers: each returns a value that is equal if and only if the results are ----
# A film has what the run of its robot has, and nothing reads robots.csv (test_run_files.py).


def _digest(*arrays):
    content = hashlib.blake2b(digest_size=16)
    for array in arrays:
        content.update(f"{array.dtype} {array.shape}".encode() + array.tobytes())
    return content.hexdigest()


def run_of(folder):
    """Reads a run; returns all that it has."""
    run = read_run(folder / "run")
    held = []
    for condition, part in run.results.items():
        assert np.isfinite(part.curves).all(), "curves that are not finite were accepted"
        both = [part.networks[when] for when in ("before", "after")]
        arrays = [array for networks in both for array in networks.values()]
        names = [[*networks] for networks in both]
        held.append((str(condition), repr(part.robots), names, _digest(part.curves, *arrays)))
    return run.experiment, held


def _state_of(cohort):
    arrays, notes = cohort.checkpoint()
    return cohort.step, _digest(*(arrays[k] for k in sorted(arrays))), json.dumps(notes["random"])


def checkpoint_of(folder):
    """Restores a cohort; returns whether it says so if it starts anew, with the same results."""
    path = checkpoints.checkpoint_file(folder, KEY)
    cohort, message = checkpoints.restored_cohort(path, SHORT, KEY)
    state = _state_of(cohort)
    return bool(message) if state == _newborn() else state


@functools.cache
def _newborn():
    return _state_of(Cohort(SHORT, KEY))


def finished_of(folder):
    """Reads what a finished cohort left."""
    lives = checkpoints.read_lives(checkpoints.finished_file(folder, KEY), SHORT, KEY)
    return _digest(*(array for _, array in sorted(lives.arrays().items())))


def policy_of(folder):
    """Reads a policy and lets it act."""
    policy = Policy.load(folder / "policy.safetensors", TASK)
    state = np.array([[0.3, 0.2, 0.1, 0.5, 0.0]], dtype=np.float32)
    motors = [policy.act(state, trained) for trained in (False, True)]
    assert np.isfinite(motors).all(), "motor values that are not finite"
    return _digest(*motors, *(policy.arrays[name] for name in sorted(policy.arrays)))


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of file within the folder that `make` writes."""

    name: str
    file: str
    read: object  # function that reads what the folder holds

    def work(self, folder):
        """Reads a folder as a command does; returns the exit status and what was read."""
        found = []
        status = exit_status.exit_status(lambda: found.append(self.read(folder)))
        return status, found[0] if found else None


KINDS = (
    Kind("experiment.json", "run/experiment.json", run_of),
    Kind("results", "run/results.safetensors.gz", run_of),
    Kind("checkpoint", f"checkpoints/{KEY}.safetensors", checkpoint_of),
    Kind("finished cohort", f"checkpoints/{KEY}.finished.safetensors", finished_of),
    Kind("policy", "policy.safetensors", policy_of),
)


# ---- What stands in the place of a file ----


def places(kind, others):
    """Returns what may stand in the place of a file: by name, functions that put it at a path.

    Args:
      kind: The file's kind.
      others: Folder with the files of other robots.
    """

    def huge(path):
        path.touch()
        os.truncate(path, 2**30)  # without blocks on the disk

    def put(file):
        return lambda path: path.write_bytes(file.read_bytes())

    return {
        "no file": lambda path: None,
        "a pipe": os.mkfifo,
        "a folder": os.mkdir,
        "a link to other robots": lambda path: path.symlink_to(others / kind.file),
        "a link to itself": lambda path: path.symlink_to(path.name),
        "a link to /dev/zero": lambda path: path.symlink_to("/dev/zero"),
        "a link to /dev/full": lambda path: path.symlink_to("/dev/full"),
        "a link to /dev/stdin": lambda path: path.symlink_to("/dev/stdin"),
        "a huge file": huge,
        **{f"the {other.name} of other robots": put(others / other.file) for other in KINDS},
    }


# Nothing could tell of sound weights that they are another policy's.
SOUND_POLICIES = ("a link to other robots", "the policy of other robots")


def case(base, folder, kind, place):
    """Reads a folder in which something else stands in the place of a file.

    Args:
      base: Folder with the files of two seeds, in `a` and `b`.
      folder: Folder that is made, and removed afterwards.
      kind: The file's kind.
      place: What stands there: a name of `places`.

    Returns:
      The class of what happened, which must not begin with "wrong", and a sentence.
    """
    own, victim = folder / "own", folder / "victim"
    shutil.copytree(base / "a", own)
    victim.mkdir()
    (victim / "notes.txt").write_text("mine")
    (own / kind.file).unlink()
    places(kind, base / "b")[place](own / kind.file)
    before, outside = oracle.snapshot(own), oracle.snapshot(victim, base, contents=False)
    outcome = oracle.carried_out(lambda: kind.work(own))
    said = f"{kind.name}, {place}: {outcome.status} {outcome.printed.strip()[-1200:]}"
    unchanged = before == oracle.snapshot(own)
    assert oracle.snapshot(victim, base, contents=False) == outside, f"{said}: changed outside"
    shutil.rmtree(folder)
    return _judged(kind, place, outcome, unchanged), said


def _judged(kind, place, outcome, unchanged):
    if outcome.status == 0:
        if kind.name == "checkpoint" and outcome.value is (place != "no file"):
            return "set aside, starts anew"
        if kind.name == "policy" and place in SOUND_POLICIES:
            return "another policy"
        return "wrong: accepted"
    if wrong := oracle.complaint(outcome):
        return f"wrong: {wrong}"
    return "refused in one sentence" if unchanged else "wrong: refused, but the folder was changed"
