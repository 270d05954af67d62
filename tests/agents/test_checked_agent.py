"""An agent of a user's that fails, exits or breaks the interface ends in one sentence."""

import os
import subprocess
import sys

import numpy as np
import pytest

from musebot.protocols.agents.bounds import HandCoded
from musebot.protocols.agents.checked_agent import CheckedAgent
from musebot.protocols.agents.senses import senses_of
from musebot.protocols.errors import InputError, RunError

STATE, REWARD = np.ones((2, 1), np.float32), np.ones(2, np.float32)


def checked(**methods):
    """Returns a guarded agent of two robots with some methods of its own."""
    kind = type("Mine", (HandCoded,), {name: staticmethod(f) for name, f in methods.items()})
    return CheckedAgent("mine:make", lambda: kind(senses_of("spot_finding")), 2)


def leave(*_):
    sys.exit(0)


@pytest.mark.parametrize(
    ("motors", "words"),
    [
        (np.zeros((1, 2)), r"must return motor values of shape \(2, 2\), got \(1, 2\)"),
        (np.zeros((2, 2, 1)), r"must return motor values of shape \(2, 2\), got \(2, 2, 1\)"),
        (None, r"must return motor values of shape \(2, 2\), got \(\)"),
        (np.zeros((2, 2), complex), "motor values that are real numbers, got complex128"),
        (np.full((2, 2), None), "motor values that are real numbers, got object"),
        (np.zeros((2, 2), bool), "motor values that are real numbers, got bool"),
    ],
)
def test_motors_of_another_shape_or_type_are_refused(motors, words):
    with pytest.raises(
        InputError, match=f"mine:make must return {words.removeprefix('must return ')}"
    ):
        checked(act=lambda state, learning: motors).act(STATE, False)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_motors_that_are_not_finite_are_refused_with_the_robot(value):
    agent = checked(act=lambda state, learning: np.array([[0, 0], [0.5, value]]))
    with pytest.raises(RunError) as caught:
        agent.act(STATE, False)
    assert str(caught.value) == (
        f"mine:make must return motor values that are finite, got [0.5, {value}] for robot 1"
    )


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


@pytest.mark.parametrize("method", ["state", "weights"])
@pytest.mark.parametrize(
    ("returned", "words"),
    [
        ({"w": np.array([None, None])}, "real numbers as its .*, got w of dtype .O"),
        ({"w": np.zeros(2, complex)}, "real numbers as its .*, got w of dtype <c16"),
        ({"w": np.zeros(2, ">f8")}, "real numbers as its .*, got w of dtype >f8"),
        ({"w": [1.0, 2.0]}, "a dict of arrays as its .*, got 'w' of type list"),
        ({"w": np.float32(1)}, "a dict of arrays as its .*, got 'w' of type float32"),
        ({1: np.zeros(2)}, "a dict of arrays as its .*, got 1 of type ndarray"),
        (None, "a dict of arrays as its .*, got NoneType"),
    ],
)
def test_arrays_that_no_file_can_hold_are_refused(method, returned, words):
    with pytest.raises(InputError, match=words):
        getattr(checked(**{method: lambda: returned}), method)()


def test_weights_have_a_row_a_robot():
    with pytest.raises(InputError, match=r"got w of shape \(3,\) for 2 robots"):
        checked(weights=lambda: {"w": np.zeros(3)}).weights()


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
from musebot.protocols.agents.bounds import HandCoded

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


def run(tmp_path, **faults):
    code = AGENT.format(**{"late": "pass", "factory": "pass", "module": ""} | faults)
    (tmp_path / "mine.py").write_text(code)
    words = "run out --agent mine:make --robots 2 --time-scale 0.002 --body kinematic"
    return subprocess.run(
        [sys.executable, "-m", "musebot", *words.split(), "--task", "wall_avoidance"],
        cwd=tmp_path, capture_output=True, text=True, env=os.environ | {"MUJOCO_GL": "off"},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("faults", "status", "words"),
    [
        ({"module": "sys.exit(0)"}, 1, "mine cannot be imported: it called for an exit"),
        ({"factory": "1 / 0"}, 2, "the factory mine:make failed (ZeroDivisionError: division by"),
        ({"late": "sys.exit(0)"}, 1, "failed in act: it called for an exit (status 0), in"),
        ({"late": "1 / 0"}, 1, "mine.py line 11), in out/wall_avoidance-mine.make-0000 at step 29"),
        (
            {"late": "return np.full((len(state), 2), np.nan)"},
            1,
            "motor values that are finite, got [nan, nan] for robot 0, in "
            "out/wall_avoidance-mine.make-0000 at step 29",
        ),
        ({"late": "os._exit(0)"}, 1, "a process died"),
    ],
)
def test_a_run_ends_in_one_sentence_and_never_in_status_0(tmp_path, faults, status, words):
    done = run(tmp_path, **faults)
    assert (done.returncode, done.stdout) == (status, ""), done.stderr
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("musebot: ") and words in last
    assert "Traceback" not in done.stderr
    assert "late" in faults or not (tmp_path / "out").exists()


def test_an_agent_that_changes_the_working_directory_does_not_move_the_run(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    chdir = f"os.chdir({str(tmp_path / 'elsewhere')!r})"
    done = run(tmp_path, module=chdir, late=chdir)
    assert done.returncode == 0, done.stderr
    assert not any((tmp_path / "elsewhere").iterdir())
    assert (tmp_path / "out" / "robots.csv").exists()
    assert (tmp_path / "out" / "tables.md").exists()
