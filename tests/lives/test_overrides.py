"""Named brains, and words such as "epsilon=0.1" that override single parameters."""

import dataclasses

import pytest

from musebot.controller import BRAINS, Parameters
from musebot.models import Kinematics
from musebot.protocols.errors import InputError
from musebot.protocols.lives.overrides import (
    brain_name,
    named_brain,
    overrides_of,
    with_overrides,
)


@pytest.mark.parametrize("name", BRAINS)
def test_a_named_brain_is_found_by_its_name_and_named_by_it(name):
    assert named_brain(name) == BRAINS[name]
    assert brain_name(named_brain(name)) == name


def test_an_unknown_brain_is_refused_with_all_names():
    with pytest.raises(InputError) as caught:
        named_brain("divine")
    assert str(caught.value) == f"the brain must be one of {', '.join(BRAINS)}, got 'divine'"


def test_a_misspelt_brain_or_parameter_gets_a_suggestion():
    with pytest.raises(InputError, match=r"there is no brain 'stedy': did you mean steady\?"):
        named_brain("stedy")
    with pytest.raises(
        InputError, match=r"there is no parameter 'nois'; did you mean noise or noisy_share"
    ):
        with_overrides(BRAINS["paper"], ["nois=0.1"])


@pytest.mark.parametrize("name", ["paper", "steady"])
def test_a_changed_brain_is_named_by_the_nearest_one_and_its_overrides(name):
    brain = dataclasses.replace(BRAINS[name], discount=0.8, keep_main_idea=True)
    assert brain_name(brain) == f"{name} discount=0.8 keep_main_idea=true"


@pytest.mark.parametrize(
    ("numbers", "words", "changed"),
    [
        (Parameters(), [], {}),
        (Parameters(), ["epsilon=0.1", "ideas=5"], {"epsilon": 0.1, "ideas": 5}),
        (Parameters(), ["fixed_motors=[0.0,0.5]"], {"fixed_motors": (0.0, 0.5)}),
        (Parameters(), ["noise_on_biases=true"], {"noise_on_biases": True}),
        (BRAINS["steady"], ["initial_epsilon=null"], {"initial_epsilon": None}),
        (Kinematics(), ["wall=slides", "lag=.08"], {"wall": "slides", "lag": 0.08}),
    ],
)
def test_overrides_replace_the_named_parameters_only(numbers, words, changed):
    assert with_overrides(numbers, words) == dataclasses.replace(numbers, **changed)


@pytest.mark.parametrize("name", BRAINS)
def test_overrides_of_a_brain_turn_the_reference_into_it(name):
    words = overrides_of(BRAINS[name], Parameters())
    assert with_overrides(Parameters(), words) == BRAINS[name]
    assert overrides_of(BRAINS[name], BRAINS[name]) == []


def test_overrides_of_kinematics_turn_the_reference_into_them():
    driven = Kinematics(wall="slides", felt="pushed", lag=0.08, any_contact=True)
    words = overrides_of(driven, Kinematics())
    assert words == ["wall=slides", "felt=pushed", "any_contact=true", "lag=0.08"]
    assert with_overrides(Kinematics(), words) == driven


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (
            ["soul=1"],
            "there is no parameter 'soul'; there are radius, wheel_base, wall, felt, ",
        ),
        (["lag"], "a value is set as NAME=VALUE, got 'lag'"),
        (["lag=0", "lag=1"], "lag is given twice"),
        (["lag=long", "wall=slides"], "lag must be a number in [0, 1000] s, got 'long'"),
        (["wall=soft"], "wall must be"),
    ],
)
def test_invalid_overrides_are_refused_in_a_sentence(words, sentence):
    with pytest.raises(InputError) as caught:
        with_overrides(Kinematics(), words)
    assert sentence in str(caught.value)
