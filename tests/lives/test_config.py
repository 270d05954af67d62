"""A file instead of options: what it may hold, and what is refused."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import quick

from musebot.controller import BRAINS, Parameters
from musebot.models import Kinematics
from musebot.protocols.errors import InputError
from musebot.protocols.lives.config import read_config

EXAMPLE = """
[experiment]
seed = 7
time_scale = 0.001
body = "kinematic"
kinematics = {wall = "slides"}
brain = {name = "steady", epsilon = 1e-1, fixed_motors = [0.0, 0.5]}

[[plan]]
task = "wall_avoidance"
proposer = "fixed"
robots = 2

[[plan]]
task = "spot_finding"
proposer = "creative"
robots = 4
"""


@pytest.fixture
def written(tmp_path):
    def written(text, name="run.toml"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return written


def test_a_file_gives_the_fields_and_the_robots_of_an_experiment(written):
    config = read_config(written(EXAMPLE))
    assert {*config.values} == {"seed", "time_scale", "body", "kinematics", "brain"}
    brain = config.values["brain"]
    assert (brain.epsilon, brain.fixed_motors) == (0.1, (0.0, 0.5))
    assert brain.learn_rate == BRAINS["steady"].learn_rate
    assert config.values["kinematics"] == Kinematics(wall="slides")
    assert config.robots == {
        ("wall_avoidance", "fixed"): 2, ("spot_finding", "creative"): 4,
    }  # fmt: skip


def test_a_brain_is_a_name_or_the_paper_s_with_changes(written):
    named = read_config(written('experiment.brain = "steady"'))
    assert named.values == {"brain": BRAINS["steady"]}
    changed = read_config(written("experiment.brain.noise = 0.5"))
    assert changed.values == {"brain": Parameters(noise=0.5)}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("seed = 1", "the file has no 'seed'; there are format, experiment"),
        ("experiment = [1]", "experiment must have names with values, got [1]"),
        ("experiment.soul = 1", "experiment has no 'soul'"),
        ("experiment.sed = 1", "experiment has no 'sed'; did you mean seed?"),
        ("experiment.brain.soul = 1", "brain has no 'soul'"),
        ('experiment.brain = "divine"', "brain must be one of paper, steady, "),
        ("experiment.brain.epsilon = 2", "epsilon must be a number in [0, 1], got 2"),
        ("experiment.brain = 3", "brain must have names with values, got 3"),
        ('experiment.kinematics.tyre = "flat"', "kinematics has no 'tyre'"),
        ('experiment.seed = "one"', "seed must be a whole number"),
        ("experiment.seed = 010", "cannot be read"),
        ("experiment.seed = 1:30", "cannot be read"),
        ("experiment.seed = 1\nexperiment.seed = 2", "cannot be read"),
        ("experiment = {seed = 1", "cannot be read"),
        ("plan = {a = 1}", "plan must be a list of rows"),
        ('plan = [{task = "spot_finding"}]', "needs task, proposer, robots, got no proposer"),
        ('plan = [{task = [1], proposer = "fixed", robots = 1}]', "must be texts, got [1]"),
        (
            'plan = [{task = "a", proposer = "b", robots = 1}, {task = "a", proposer = "b",'
            " robots = 2}]",
            "a/b is planned twice",
        ),
    ],
)
def test_a_wrong_file_is_one_sentence_that_names_the_file(text, words, written):
    path = written(text)
    with pytest.raises(InputError) as caught:
        read_config(path)
    sentence = str(caught.value)
    assert words in sentence and sentence.startswith(str(path)) and "\n" not in sentence


def test_json_with_a_name_given_twice_is_refused(written):
    path = written('{"experiment": {"seed": 1, "seed": 2}}', "run.json")
    with pytest.raises(InputError, match="'seed' is given twice"):
        read_config(path)
    assert read_config(written('{"experiment": {"seed": 3}}', "a.json")).values == {"seed": 3}


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=8,
)
NAMES = st.sampled_from(["seed", "brain", "kinematics", "body", "time_scale", "device", "settings"])


@quick
@given(st.dictionaries(NAMES, PLAIN), PLAIN)
def test_any_data_is_read_or_refused_in_one_sentence(tmp_path_factory, experiment, plan):
    path = tmp_path_factory.mktemp("config") / "run.json"
    path.write_text(json.dumps({"experiment": experiment, "plan": plan}))
    try:
        read_config(path)
    except InputError as error:
        assert "\n" not in str(error)
