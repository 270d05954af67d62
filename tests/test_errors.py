"""Suggestions for names that are misspelt."""

import re

import pytest

from musebot.protocols.errors import InputError, check_name, nearest, similar


def test_only_the_most_similar_names_are_suggested_and_dashes_do_not_count():
    for name, known, found in (
        ("stedy", "steady paper", "did you mean steady?"),
        ("--robts", "--robots --proposer --out", "did you mean --robots?"),
        ("--but", "--robots --out --set", "did you mean --out?"),
        ("rate", "rates rater gate", "did you mean rates or rater?"),
        ("sarsa", "sarsa_lambda dqn", "did you mean sarsa_lambda?"),
        ("steady-ra", "steady steady-adam steady-random", "did you mean steady-random?"),
        ("", "sarsa_lambda dqn", ""),
        ("x", "--robots --set", ""),
        ("--xx", "--robots --set", ""),
        ("any", "", ""),
    ):
        assert similar(name, known.split()) == found


def test_without_a_similar_name_all_names_are_listed():
    assert nearest("xx", ["robots", "set"]) == "there are robots, set"
    assert nearest("xx", []) == "there are none"
    assert nearest("xx", map(str, range(30))).endswith(", 18, 19 and 10 more")
    assert nearest("sett", ["robots", "set"]) == "did you mean set?"


def test_a_name_that_is_not_known_is_refused_with_those_that_are():
    for name, end in (("stedy", "did you mean steady?"), ("x", "there are steady"), (1, "steady")):
        with pytest.raises(InputError, match=f"^there is no brain {name!r}; .*{re.escape(end)}$"):
            check_name("brain", name, ["steady"])
    assert check_name("brain", "steady", ["steady"]) is None
