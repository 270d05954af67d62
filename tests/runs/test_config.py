"""Experiments in words: named brains, words NAME=VALUE, and a file instead of options."""

import dataclasses
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from musebot.controller import BRAINS, Parameters
from musebot.models import Kinematics
from musebot.protocols.errors import InputError
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.config import named_brain, read_config, read_life, values_of
from musebot.protocols.runs.experiment import Experiment, changed, overrides_of

EXAMPLE = """
experiment.seed = 7
experiment.body = "kinematic"
experiment.kinematics.wall = "slides"
experiment.brain = {name = "steady", epsilon = 1e-1, fixed_motors = [0.0, 0.5]}
plan = [
    {task = "wall_avoidance", proposer = "fixed", robots = 2},
    {task = "spot_finding", proposer = "creative", robots = 4},
]
"""


# Brains and overrides


def with_overrides(numbers, words):
    names = [field.name for field in dataclasses.fields(numbers)]
    return dataclasses.replace(numbers, **values_of(words, names))


def test_a_named_brain_is_found_by_its_name_and_named_by_it():
    for name, brain in BRAINS.items():
        assert named_brain(name) == brain and Experiment(brain=brain).brain_name == name
        words = overrides_of(brain, Parameters())
        assert with_overrides(Parameters(), words) == brain and overrides_of(brain, brain) == []
    brain = dataclasses.replace(BRAINS["steady"], discount=0.8, keep_main_idea=True)
    assert Experiment(brain=brain).brain_name == "steady discount=0.8 keep_main_idea=true"


def test_overrides_replace_the_named_parameters_only():
    for numbers, words, values in (
        (Parameters(), ["fixed_motors=[0.0,0.5]"], dict(fixed_motors=(0.0, 0.5))),
        (BRAINS["steady"], ["initial_epsilon=null"], dict(initial_epsilon=None)),
        (Kinematics(), ["wall=slides", "any_contact=true"], dict(wall="slides", any_contact=True)),
    ):
        found = with_overrides(numbers, words)
        assert found == dataclasses.replace(numbers, **values)
        assert with_overrides(numbers, overrides_of(found, numbers)) == found


def test_invalid_names_and_overrides_are_refused_in_a_sentence():
    for words, sentence in (
        (["soul=1"], "there is no parameter 'soul'; there are radius, wheel_base, wall, felt, "),
        (["lga=1"], "there is no parameter 'lga'; did you mean lag?"),
        (["lag"], "a value is set as NAME=VALUE, got 'lag'"),
        (["lag=0", "lag=1"], "lag is given twice"),
    ):
        with pytest.raises(InputError) as caught:
            with_overrides(Kinematics(), words)
        assert sentence in str(caught.value)
    with pytest.raises(InputError, match=r"lag must be a number in \[0, 1000\] s, got 'long'"):
        changed(Experiment(), values_of(["kinematics.lag=long"], ["kinematics.lag"]))
    with pytest.raises(InputError, match=r"there is no brain 'stedy'; did you mean steady\?"):
        named_brain("stedy")
    with pytest.raises(InputError, match="there is no brain 'divine'; there are paper, "):
        named_brain("divine")


# Files


@pytest.fixture
def written(tmp_path):
    def written(text):
        path = tmp_path / ("run.json" if text.startswith("{") else "run.toml")
        path.write_text(text)
        return path

    return written


def test_a_file_gives_the_fields_and_the_robots_of_an_experiment(written):
    config = read_config(written(EXAMPLE))
    assert {*config.values} == {"seed", "body", "kinematics", "brain"}
    brain = config.values["brain"]
    assert (brain.epsilon, brain.fixed_motors) == (0.1, (0.0, 0.5))
    assert brain.learn_rate == BRAINS["steady"].learn_rate
    assert config.values["kinematics"] == Kinematics(wall="slides")
    walls, spot = Condition("wall_avoidance", "fixed"), Condition("spot_finding", "creative")
    assert config.robots == {walls: 2, spot: 4}
    named = read_config(written('experiment.brain = "steady"'))
    assert named.values == {"brain": BRAINS["steady"]}
    changed = read_config(written('{"experiment": {"brain": {"noise": 0.5}}}'))
    assert changed.values == {"brain": Parameters(noise=0.5)}


ROW = '{task = "a", proposer = "dqn", robots = 1}'
WRONG = {
    "seed = 1": "the file has no 'seed'; there are experiment, plan, ",
    "experiment.sed = 1": "experiment has no 'sed'; did you mean seed?",
    "experiment.brain.epsilon = 2": "epsilon must be a number in [0, 1], got 2",
    "experiment.brain = 3": "brain must have names with values, got 3",
    "experiment.brain.name = [1]": "there is no brain '(1,)'; there are paper, steady, ",
    "experiment.seed = 1\nexperiment.seed = 2": "cannot be read",
    "plan = {a = 1}": "plan must be a list of rows",
    'plan = [{task = "spot_finding"}]': "needs task, proposer, robots, got no proposer",
    'plan = [{task = [1], proposer = "fixed", robots = 1}]': "must be texts, got ((1,), 'fixed')",
    f"plan = [{ROW}, {ROW}]": "a/musebot:dqn is planned twice",
    f"plan = [{ROW}, {ROW.replace('dqn', 'musebot:dqn')}]": "a/musebot:dqn is planned twice",
    f"plan = [{ROW.replace('1', '60.5')}]": "robots must be a whole number from 1 to ",
    f"plan = [{ROW.replace('= 1', '= true')}]": "robots must be a whole number from 1 to ",
    '{"experiment": {"seed": 1, "seed": 2}}': "'seed' is given twice",
}


def test_a_wrong_file_is_one_sentence_that_names_the_file(written):
    for text, words in WRONG.items():
        path = written(text)
        with pytest.raises(InputError) as caught:
            read_config(path)
        sentence = str(caught.value)
        assert words in sentence and sentence.startswith(str(path)) and "\n" not in sentence


@pytest.mark.parametrize("read", [read_config, read_life])
def test_a_file_that_the_system_does_not_open_is_refused_in_a_sentence(read, written):
    file = written("")
    for path in (file / "inside.toml", file.parent, file.parent / "none.toml"):
        with pytest.raises(InputError, match=str(path)):
            read(path)


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=8,
)
NAMES = st.sampled_from(["seed", "brain", "kinematics", "body", "time_scale", "device", "settings"])


@given(st.dictionaries(NAMES, PLAIN), PLAIN)
def test_any_data_is_read_or_refused_in_one_sentence(tmp_path_factory, experiment, plan):
    path = tmp_path_factory.mktemp("config") / "run.json"
    path.write_text(json.dumps({"experiment": experiment, "plan": plan}))
    try:
        config = read_config(path)
        changed(Experiment(), config.values)
        assert all(type(robots) is int for robots in config.robots.values())
    except InputError as error:
        assert "\n" not in str(error)
