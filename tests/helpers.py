"""Small functions that several tests need."""

import numpy as np


def files_below(folder, folders=False):
    """Returns the content of all files below a folder, by their paths within it.

    With `folders`, the folders below it are listed, too, with None as content.
    """
    return {
        path.relative_to(folder): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
        if folders or path.is_file()
    }


def change_physics(folder):
    """Makes the run in a folder one of another physics."""
    from musebot.protocols.runs.manifest import MANIFEST
    from musebot.protocols.storage import read_json, write_json

    content = read_json(folder / MANIFEST)
    write_json(folder / MANIFEST, content | {"physics": [0.5, *content["physics"][1:]]})


def snapshot(tensors):
    """Returns copies of tensors by name."""
    return {name: tensor.clone() for name, tensor in tensors.items()}


def recorded(owner, method):
    """Returns a list that will get a copy of each tensor that an object's method returns."""
    found, called = [], getattr(owner, method)

    def call(*arguments):
        found.append(called(*arguments).clone())
        return found[-1].clone()

    setattr(owner, method, call)
    return found


def unit_senses(signals):
    """Returns senses of signals, and of a reward, in [0, 1] that do not saturate."""
    from musebot.controller import Senses, Signal

    return Senses((Signal(0, 1),) * signals, Signal(0, 1))


def same(first, second):
    """Returns whether tensors by name are equal."""
    return first.keys() == second.keys() and all(first[k].equal(second[k]) for k in first)


def random_policy(task, seed=0):
    """Returns a policy of a task with random weights, which differ before and after training."""
    from musebot.protocols.agents.policy import Policy, policy_shapes
    from musebot.protocols.agents.signals import senses_of

    random = np.random.default_rng(seed)
    shapes = policy_shapes(len(senses_of(task).state))
    arrays = {
        name: (random.normal(size=shape) / np.sqrt(shape[-1])).astype("f4")
        for name, shape in shapes.items()
    }
    return Policy(task, arrays)


def run_of_rows(rows, experiment=None, *, minutes=1, name="run"):
    """Returns a run of robots' rows, without networks and without events in its curves."""
    from musebot.protocols.runs.conditions import Condition
    from musebot.protocols.runs.experiment import Experiment
    from musebot.protocols.runs.run import ConditionResults, Run

    results = {}
    for row in rows:
        results.setdefault(Condition(row.task, row.proposer), []).append(row)
    for condition, own in results.items():
        curves = np.zeros((len(own), minutes))
        results[condition] = ConditionResults(own, curves, {"before": {}, "after": {}})
    return Run(name, experiment or Experiment(), results)
