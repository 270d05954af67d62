"""Hostile cases of files that are read: real ones of each kind, their changes, and the readers."""

import dataclasses
import functools
import hashlib
import json
import os
import shutil
from pathlib import Path

import numpy as np
from helpers import random_policy
from hostile import mutations as change
from hostile import oracle
from hostile.mutations import one

from musebot.protocols import exit_status
from musebot.protocols.agents.names import recorded_name
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
    whole = dataclasses.replace(short, time_scale=1)
    bounds = [Condition("spot_finding", recorded_name(name)) for name in ("newborn", "hand_coded")]
    _make_run(folder / "board", whole, dict.fromkeys([SPOT, *bounds], 2), invented)
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
        names = (condition.task, condition.proposer, experiment.seed)
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


# ---- Changes ----


def _in_place(**mutators):
    """Returns a change of a file's bytes."""

    def changed(draw, path, other):
        name = one(draw, [*mutators])
        path.write_bytes(mutators[name](draw, path.read_bytes()))
        return name

    return changed


def _placed(draw, path, other):
    name = one(draw, [*change.PLACES])
    path.unlink()
    change.PLACES[name](path, other)
    return name


def _swapped(draw, path, other):
    path.write_bytes(other.read_bytes())
    return "swapped"


def _mixed_up(draw, path, other):
    """Puts another file of the same run or of another one there."""
    others = [p for p in sorted(path.parent.iterdir()) if p != path and p.is_file()]
    others += [p for p in sorted(other.parent.parent.rglob("*")) if p.is_file()]
    path.write_bytes(one(draw, others).read_bytes())
    return "mixed_up"


_ANY = ((_in_place(**change.BYTES), 4), (_placed, 1), (_swapped, 0.4), (_mixed_up, 0.4))


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of file within the folder that `make` writes."""

    name: str
    file: str
    read: object  # function that reads what the folder holds
    changes: tuple = _ANY  # functions that change the file, each with its weight

    def changed(self, draw, folder, other, number):
        """Changes the file in a folder; returns the name of the change, of which all come first."""
        functions, weights = zip(*self.changes, strict=True)
        drawn = draw.choice(len(functions), p=np.array(weights) / sum(weights))
        function = functions[number if number < len(functions) else drawn]
        return function(draw, folder / self.file, other / self.file)


KINDS = (
    Kind("experiment.json", "run/experiment.json", run_of,
         (*_ANY, (_in_place(json=change.json_mutated), 6))),
    Kind("results", "run/results.safetensors.gz", run_of),
    Kind("checkpoint", f"checkpoints/{KEY}.safetensors", checkpoint_of),
    Kind("finished cohort", f"checkpoints/{KEY}.finished.safetensors", finished_of),
    Kind("policy", "policy.safetensors", policy_of),
)  # fmt: skip


def working(kind, folder):
    """Returns the work of reading a folder, as a command that ends in an exit status."""

    def work():
        found = []
        status = exit_status.exit_status(lambda: found.append(kind.read(folder)))
        return status, found[0] if found else None

    return work


# ---- Cases ----

SEED = 20040
# Accepted changes of a result: nothing could tell of sound weights of another policy.
UNTOLD = {"policy": ["swapped", "mixed_up", "link_to_other"]}


_TRUE = {}


def case(base, folder, kind, number):
    """Carries out a numbered case of a kind of file, in a folder that is then removed.

    Returns:
      The class of what happened, which must not begin with "wrong", and a sentence.
    """
    draw = np.random.default_rng([SEED, KINDS.index(kind), number])
    own, victim = folder / "own", folder / "victim"
    part = Path(kind.file).parts[0]
    own.mkdir(parents=True)
    copy = shutil.copytree if (base / "a" / part).is_dir() else shutil.copy
    copy(base / "a" / part, own / part)
    victim.mkdir()
    (victim / "notes.txt").write_text("mine")
    os.environ["HOSTILE_MARK"] = str(folder / "unpickled")
    what = kind.changed(draw, own, base / "b", number)
    before, outside = oracle.snapshot(own), oracle.snapshot(victim, base, contents=False)
    outcome = oracle.carried_out(working(kind, own))
    said = f"{kind.name} {number}, {what}: {outcome.status} {outcome.printed.strip()[-1200:]}"
    try:
        return _judged(kind, what, outcome, before != oracle.snapshot(own)), said
    finally:
        left = oracle.snapshot(victim, base, contents=False)
        assert left == outside, f"{said}: something outside was changed"
        assert not (folder / "unpickled").exists(), f"{said}: code of the file was run"
        shutil.rmtree(folder)


def _judged(kind, what, outcome, changed):
    if outcome.status == 0:
        if outcome.value == _TRUE[kind.name]:
            return "accepted, the same results"
        if kind.name == "checkpoint" and outcome.value is (what != "no_file"):
            return "set aside, starts anew"
        if what in UNTOLD.get(kind.name, ()):
            return f"is unknown: {what}"
        return f"wrong: accepted with other results after {what}"
    if wrong := oracle.complaint(outcome):
        return f"wrong: {wrong}"
    if changed:
        return "wrong: refused, but the folder was changed"
    return "refused in one sentence"


def learn_truth(base):
    """Reads the unchanged files: what every accepted case must give."""
    for kind in KINDS:
        outcome = oracle.carried_out(working(kind, base / "a"))
        assert outcome.status == 0, f"{kind.name}: {outcome.printed}"
        _TRUE[kind.name] = outcome.value
