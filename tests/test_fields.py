"""Declared fields: every field of a brain accepts exactly the values that its words describe."""

import dataclasses
import math
import re
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from musebot.controller import Parameters
from musebot.fields import (
    Checked,
    check,
    choice,
    flag,
    number,
    numbers,
    shown,
    text,
    whole,
)
from musebot.models import Kinematics
from musebot.tasks.sensors import Nose

FIELDS = {field.name: field for field in dataclasses.fields(Parameters)}


@dataclasses.dataclass(frozen=True)
class Inner(Checked):
    share: float = number(0.5, 0, 1)


@dataclasses.dataclass(frozen=True)
class Sample(Checked):
    """A field of each kind."""

    speed: float | None = number(None, 0, 10, "(]", unit="m/s")
    steps: int | None = whole(None, 1, 9)
    colour: str = choice("red", Literal["red", "blue"])
    device: str = text("cpu", "cpu|cuda:[0-9]", "cpu or cuda:N")
    on: bool = flag(False)
    shares: tuple[float, ...] = numbers((0.0,), 0, 1, 3)
    inner: Inner = Inner()
    undeclared: object = None


def number_in(value, words):
    """Whether a value is in a range such as "a number in (0, 10]", by its words alone."""
    opening, low, high, closing = re.search(r"([\[(])(\S+), (\S+?)([\])])", words).groups()
    if type(value) not in (int, float) or value != value:
        return False
    above = value > float(low) or opening == "[" and value == float(low)
    below = value < float(high) or closing == "]" and value == float(high)
    return above and below


def allows(words, value):
    """Whether a value is allowed, by the words that describe the allowed values."""
    if words.endswith(" or none"):
        return value is None or allows(words.removesuffix(" or none"), value)
    if several := re.match(r"1 to (\d+) values, each (.*)", words):
        most, each = int(several[1]), several[2]
        return type(value) is tuple and 1 <= len(value) <= most and all(
            number_in(one, each) for one in value
        )  # fmt: skip
    if limits := re.match(r"a whole number from (\d+) to (\d+)", words):
        return type(value) is int and int(limits[1]) <= value <= int(limits[2])
    if words.startswith("a number in"):
        return number_in(value, words)
    if words == "true or false":
        return value is True or value is False
    if words == "cpu or cuda:N":
        return value in ("cpu", "cuda:1")
    return isinstance(value, str) and repr(value) in words.split(" or ")


def near(words):
    """Values at the ends of a range, and beside them."""
    ends = [float(x) for x in re.findall(r"-?\d+(?:\.\d+)?", words)]
    beside = [math.nextafter(x, toward) for x in ends for toward in (-math.inf, math.inf)]
    wholes = [int(x) + step for x in ends for step in (-1, 0, 1)]
    return [*ends, *beside, *wholes]


STRANGE = [
    *(None, True, False, math.nan, math.inf, -math.inf, 10**400, 10**5000, "", "no", b"sgd"),
    *((), [], {}, [0.0], (0.1, "a"), (math.nan,), (0.0,) * 100, (0,) * 101, {"a"}, 1j, object()),
    *"red cpu cuda:1 xcpu logistic tanh signal difference on_policy max anew fixed adam".split(),
    *("best", "Tanh", "cuda:1\n"),
]


@pytest.mark.parametrize("cls", [Parameters, Sample, Nose, Kinematics])
def test_a_field_accepts_exactly_the_values_that_its_words_describe(cls):
    for field in dataclasses.fields(cls):
        if "words" not in field.metadata:
            continue
        name, words = field.name, field.metadata["words"]
        values = [field.default, *STRANGE, *near(words), *[(x,) for x in near(words)]]
        accepted = 0
        for value in values:
            if allows(words, value):
                accepted += 1
                assert getattr(cls(**{name: value}), name) == value
            else:
                with pytest.raises(ValueError) as error:
                    cls(**{name: value})
                assert str(error.value) == f"{name} must be {words}, got {shown(value)}"
                assert len(str(error.value)) < 200
        assert 0 < accepted < len(values), name


def test_the_defaults_are_the_papers_parameters():
    papers = [*FIELDS][: [*FIELDS].index("activation")]  # those beyond the paper follow
    assert {name: getattr(Parameters(), name) for name in papers} == {
        "evaluation_hidden": 7,  # "seven hidden neurons in the evaluation net"
        "learn_rate": 0.01,  # eta
        "discount": 0.9,  # gamma
        "epsilon": 0.01,
        "test_epsilon": 0.0,
        "fixed_motors": (-0.5, -0.25, 0.0, 0.25, 0.5),
        "ideas": 25,  # "the same number of 25 potential actions"
        "memory_hidden": 5,  # "five in the memory net"
        "noise": 0.76,  # sigma
        "noisy_share": 0.25,  # "noise in a quarter of all connections"
        "noisy_connections": "anew",
        "noise_steps": 1,
        "noise_on_biases": False,
        "keep_main_idea": False,
        "initial_range": 1.0,  # "from the interval [-1.0, 1.0]"
    }
    assert Parameters().activation == "logistic"  # "neurons with logistic activation function"
    assert Parameters().reward_form == "signal"  # "reward is identical to specific sensor signals"
    assert Parameters().bootstrap == "on_policy"  # SARSA
    assert Parameters().memory_target == "selected"  # "trained with the state-action pair selected"


def test_a_field_has_its_unit_in_its_words_and_an_undeclared_one_has_none():
    speed, *_, undeclared = dataclasses.fields(Sample)
    assert speed.metadata["words"] == "a number in (0, 10] m/s or none"
    assert not undeclared.metadata
    check(Sample(undeclared=object()))


def test_numbers_of_numpy_become_pythons():
    own = Sample(speed=np.float64(0.5), steps=np.int64(3), on=np.bool_(True), colour=np.str_("red"))
    assert own == Sample(speed=0.5, steps=3, on=True)
    assert [type(x) for x in (own.speed, own.steps, own.on, own.colour)] == [float, int, bool, str]
    assert type(Parameters(fixed_motors=(*np.array([0.0, 0.5]),)).fixed_motors[1]) is float
    for value in (np.array(0.5), np.array([0.5, 0.5]), np.nan):
        with pytest.raises(ValueError, match="^speed must"):
            Sample(speed=value)


class Endless:
    """An object whose `repr` must not be computed."""

    def __repr__(self):
        raise AssertionError


class LongText(str):
    def __repr__(self):
        raise AssertionError


def nested(depth):
    value = ["x"]
    for _ in range(depth):
        value = [value, value]  # 2^depth leaves
    return value


@settings(max_examples=40)
@given(st.one_of(st.integers(), st.floats(), st.text(), st.lists(st.text(), max_size=5)))
def test_a_value_is_shown_in_one_short_line(value):
    assert len(shown(value)) <= 60
    assert "\n" not in shown(value)
    if isinstance(value, int | float) and abs(value) < 1e9:
        assert shown(value) == repr(value)


def test_a_huge_value_is_never_computed_whole():
    huge = [nested(200), [Endless()] * 10**6, {"a": Endless()}, Endless(), 10**5000]
    for value in (*huge, LongText("x" * 10**6), "x" * 10**8, b"x" * 10**8):
        assert len(shown(value)) <= 60
