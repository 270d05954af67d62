"""Hostile cases of the readers: one changed file, one reader, and the judgement."""

import os
import shutil

import numpy as np
from hostile import files, oracle

SEED = 20040

# Accepted changes of a result by kinds of files: nothing could tell of sound weights of other
# policies, nor of sound values with a digest written anew.
UNTOLD = {kind.name: ["forged"] for kind in files.KINDS if kind.file.endswith(".safetensors")}
UNTOLD["policies"] += ["swapped", "mixed_up", "link_to_other"]


def case(base, folder, kind, number):
    """Carries out a numbered case of a kind of file, in a folder that is then removed.

    Returns:
      The class of what happened, which must not begin with "wrong", and a sentence.
    """
    draw = np.random.default_rng([SEED, files.KINDS.index(kind), number])
    own, victim = folder / "own", folder / "victim"
    files.copied(kind, base / "a", own)
    victim.mkdir()
    (victim / "notes.txt").write_text("mine")
    os.environ["HOSTILE_MARK"] = str(folder / "unpickled")
    what = kind.changed(draw, own, base / "b", number)
    before, outside = oracle.snapshot(own), oracle.snapshot(victim, base, contents=False)
    outcome = oracle.carried_out(files.working(kind, own))
    said = f"{kind.name} {number}, {what}: {outcome.status} {outcome.printed.strip()[-1200:]}"
    try:
        return _judged(kind, what, outcome, (before, oracle.snapshot(own))), said
    finally:
        left = oracle.snapshot(victim, base, contents=False)
        assert left == outside, f"{said}: something outside was changed"
        assert not (folder / "unpickled").exists(), f"{said}: code of the file was run"
        shutil.rmtree(folder)


def _judged(kind, what, outcome, folders):
    if outcome.status == 0:
        if outcome.value == _TRUE[kind.name]:
            return "accepted, the same results"
        if kind.name == "checkpoint" and outcome.value is (what != "no_file"):
            return "set aside, starts anew"
        if what in UNTOLD.get(kind.name, ()):
            return f"is unknown: {what}"
        return f"wrong: accepted with other results after {what}"
    if kind.harmless:
        return f"wrong: refused, but nothing needs it: {outcome.printed}"
    if wrong := oracle.complaint(outcome):
        return f"wrong: {wrong}"
    if folders[0] != folders[1]:
        return "wrong: refused, but the folder was changed"
    return "refused in one sentence"


_TRUE = {}


def learn_truth(base):
    """Reads the unchanged files: what every accepted case must give."""
    for kind in files.KINDS:
        outcome = oracle.carried_out(files.working(kind, base / "a"))
        assert outcome.status == 0, f"{kind.name}: {outcome.printed}"
        _TRUE[kind.name] = outcome.value
