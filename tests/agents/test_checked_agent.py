"""An agent of a user's that fails, exits or breaks the interface ends in one sentence."""

import itertools
import re
import sys

import numpy as np
import pytest
import torch

from musebot.protocols.agents.checked_agent import CheckedAgent
from musebot.protocols.agents.hand_coded import HandCoded
from musebot.protocols.agents.signals import senses_of
from musebot.protocols.cli import parser as cli
from musebot.protocols.errors import InputError, RunError

STATE, REWARD = np.ones((2, 1), np.float32), np.ones(2, np.float32)


def checked(**methods):
    """Returns a guarded agent of two robots with some methods of its own."""
    kind = type("Mine", (HandCoded,), {name: staticmethod(f) for name, f in methods.items()})
    return CheckedAgent("mine:make", lambda: kind(senses_of("spot_finding")), 2)


def leave(*_):
    sys.exit(0)


WRONG_MOTORS = [
    *((np.zeros(shape), rf"of shape \(2, 2\), got {re.escape(str(shape))}")
      for shape in ((1, 2), (2, 2, 1), ())),
    *((np.zeros((2, 2), kind), f"that are real numbers, got {np.dtype(kind)}")
      for kind in (complex, object, bool)),
    *((np.array([[0, 0], [0.5, x]]), rf"that are finite, got \[0.5, {x}\] for robot 1")
      for x in (np.nan, np.inf, -np.inf)),
    (torch.zeros(2, 2, requires_grad=True), r"as an array \(RuntimeError: Can't call numpy"),
    ([[0.5, 0.5], [0.5]], r"as an array \(ValueError: "),
]  # fmt: skip


def test_motor_values_that_are_no_array_of_finite_numbers_of_their_shape_are_refused():
    for motors, words in WRONG_MOTORS:
        agent = checked(act=lambda *_, motors=motors: motors)
        with pytest.raises((InputError, RunError), match=f"mine:make must .*values {words}"):
            agent.act(STATE, False)


def test_a_robot_with_weights_that_are_not_finite_is_stopped_by_the_simulation_instead():
    motors = np.array([[0, 0], [0.5, np.nan]])
    weights = {"w": np.array([[1.0], [np.nan]])}
    agent = checked(act=lambda state, learning: motors, weights=lambda: weights)
    assert agent.act(STATE, False) is motors


@pytest.mark.parametrize(
    "method", ["reset", "act", "learn", "state", "weights", "load_state", "load_weights"]
)
def test_a_fault_is_one_sentence_with_its_place_and_an_exit_is_an_error(method):
    given = {"act": (STATE, False), "learn": (REWARD,), "load_state": ({},), "load_weights": ({},)}
    arguments = given.get(method, ())
    # A state that does not fit is the caller's matter: its ValueError and KeyError pass.
    kind = LookupError if method.startswith("load") else KeyError

    def fail(*_):
        raise kind("two\nlines")

    with pytest.raises(RunError) as caught:
        getattr(checked(**{method: fail}), method)(*arguments)
    said = str(caught.value)
    shown = "KeyError: 'two\\nlines'" if kind is KeyError else "LookupError: two lines"
    assert said.startswith(f"mine:make failed in {method} ({shown}, test_checked_agent.py")
    with pytest.raises(RunError, match=rf"failed in {method}: it called for an exit \(status 0\)"):
        getattr(checked(**{method: leave}), method)(*arguments)


def test_arrays_that_no_file_can_hold_or_without_a_row_a_robot_are_refused():
    wrong = [{"w": np.zeros(2, kind)} for kind in (object, complex, ">f8")]
    wrong += [{"w": [1.0, 2.0]}, {"w": np.float32(1)}, {1: np.zeros(2)}, None]
    wrong += [{name: np.zeros(2)} for name in ("", "\ud800", "a\nb")]
    for returned, method in itertools.product(wrong, ("state", "weights")):
        agent = checked(**{method: lambda returned=returned: returned})
        with pytest.raises(InputError, match=f"a dict of real arrays as its {method}, .*got "):
            getattr(agent, method)()
    with pytest.raises(InputError, match=r"got w of shape \(3,\) for 2 robots"):
        checked(weights=lambda: {"w": np.zeros(3)}).weights()


def test_weights_keep_their_names_types_and_shapes_all_their_life():
    born = {"w": np.zeros((2, 3))}
    for later, words in (
        ({"w": np.zeros((2, 4))}, r"w: float64 \(2, 3\), then float64 \(2, 4\)"),
        ({"w": np.zeros((2, 3), np.float32)}, "w: float64 .*, then float32"),
        ({}, "w: float64 .*, then absent"),
        ({**born, "v": np.zeros(2)}, "v: absent, then float64"),
    ):
        returned = iter([born, born, later])
        agent = checked(weights=lambda returned=returned: next(returned))
        agent.weights()
        agent.weights()
        with pytest.raises(InputError, match=f"one kind all its life, got {words}"):
            agent.weights()
    returned_later = iter([{}, born])
    agent = checked(weights=lambda: next(returned_later))
    agent.weights()
    with pytest.raises(InputError, match="w: absent, then float64"):
        agent.weights()


def test_a_fault_whose_text_fails_is_named_by_its_type():
    class Fault(Exception):
        def __str__(self):
            raise ValueError

    def fail(*_):
        raise Fault

    with pytest.raises(RunError, match=r"failed in act \(Fault, test_checked_agent.py line"):
        checked(act=fail).act(STATE, False)


def test_an_agent_that_changes_what_it_is_given_changes_a_copy():
    def act(state, learning):
        state[:] = 7
        return np.zeros((2, 2))

    def learn(reward):
        reward[:] = 7

    agent = checked(act=act, learn=learn, load_state=lambda arrays: arrays["w"].fill(7))
    state, reward, saved = STATE.copy(), REWARD.copy(), {"w": np.ones(2)}
    agent.act(state, True)
    agent.learn(reward)
    agent.load_state(saved)
    assert all((array == 1).all() for array in (state, reward, saved["w"]))


# In a run

AGENT = """
import os, sys
import numpy as np
from musebot.protocols.agents.hand_coded import HandCoded

class Mine(HandCoded):
    steps = 0
    def act(self, state, learning):
        self.steps += 1
        if self.steps == 30:
            {late}
        return np.zeros((len(state), 2))

def make(robots, senses, seed):
    {factory}
    return Mine(senses)
{module}
"""


@pytest.fixture
def run(tmp_path, monkeypatch, capsys, commands_in_process):
    """Simulates an agent with faults; returns the exit status, stdout and the last line."""

    def run(**faults):
        code = AGENT.format(**{"late": "pass", "factory": "pass", "module": ""} | faults)
        (tmp_path / "mine.py").write_text(code)
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "path", [*sys.path])
        sys.modules.pop("mine", None)
        words = "run out --agent mine:make --robots 2 --time-scale 0.002 --body kinematic"
        status = cli.main([*words.split(), "--life", "wall_avoidance"])
        out, err = capsys.readouterr()
        sys.modules.pop("mine", None)
        assert "Traceback" not in err
        return status, out, err.strip().splitlines()[-1]

    return run


@pytest.mark.parametrize(
    ("faults", "status", "words"),
    [
        ({"module": "sys.exit(0)"}, 1, "mine cannot be imported: it called for an exit"),
        ({"factory": "1 / 0"}, 2, "the factory mine:make failed (ZeroDivisionError: division by"),
        (
            {"late": "return np.full((len(state), 2), np.nan)"},
            1,
            "motor values that are finite, got [nan, nan] for robot 0, in "
            "out/wall_avoidance-mine.make-0000 at step 29",
        ),
    ],
)
def test_a_run_ends_in_one_sentence_and_never_in_status_0(run, tmp_path, faults, status, words):
    found, out, last = run(**faults)
    assert (found, out) == (status, "")
    assert last.startswith("musebot: ") and words in last
    assert "late" in faults or not (tmp_path / "out").exists()


def test_an_agent_that_changes_the_working_directory_does_not_move_the_run(run, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    chdir = f"os.chdir({str(tmp_path / 'elsewhere')!r})"
    assert run(module=chdir, late=chdir)[0] == 0
    assert not any((tmp_path / "elsewhere").iterdir())
    assert (tmp_path / "out" / "robots.csv").exists()
    assert (tmp_path / "out" / "tables.md").exists()
