"""Settings of agents are read, checked and handed to the factory."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from musebot.protocols.agents.settings import (
    Setting,
    checked_settings,
    settings_from,
    settings_of,
    tunable,
)
from musebot.protocols.cli import parser as cli
from musebot.protocols.errors import InputError
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.run_files import planned


@tunable(rate=Setting(0.1, 0.01, 1.0, log=True, each=True), tiles=Setting(4, 2, 8))
def made(robots, senses, seed, *, rate, tiles):
    """Makes nothing."""
    return robots, senses, seed, rate, tiles


def test_a_factory_receives_defaults_and_what_is_chosen():
    assert made(1, 2, 3) == (1, 2, 3, 0.1, 4)
    assert made(1, 2, 3, tiles=5) == (1, 2, 3, 0.1, 5)
    assert [*settings_of(made)] == ["rate", "tiles"] and made.__doc__ == "Makes nothing."
    assert settings_of(len) == {}


@given(st.floats(0, 1))
def test_a_share_of_a_range_lies_at_that_share_of_it(share):
    rate, tiles = settings_of(made).values()
    assert rate.at(share) == pytest.approx(0.01 * 100**share, rel=0.01)
    assert Setting(0.2, 0.0, 1.0).at(share) == pytest.approx(share, abs=1e-2)
    assert tiles.at(share) == min(2 + int(7 * share), 8) or 7 * share % 1 in (0.0, 1.0)


def test_a_range_that_does_not_suit_its_kind_is_an_error_of_the_agents_author():
    for wrong, words in (
        ((True, 0, 1), "take 0 and 1 for no and yes"),
        ((1, 0.5, 9, "", True), "a whole number's range must be, too"),
        ((1, 0, 9, "", True), "a logarithmic range must be above 0, got 0"),
        ((0.5, 0.0, 1.0, "", True), "a logarithmic range must be above 0, got 0.0"),
        ((1.0, 0, float("inf")), r"a range must be ordered and finite, got \[0, inf\]"),
        ((1, 0, 1e300), "a range must be ordered and finite"),
        ((2, 0, 1), r"2 does not lie in \[0, 1\]"),
    ):
        with pytest.raises(ValueError, match=words):
            Setting(*wrong)


def test_several_values_belong_to_equal_shares_of_the_robots():
    words = settings_from(["rate=0.5,0.1", "tiles=3"], several=True)
    checked = checked_settings("mine", made, words, 4)
    assert checked["rate"].tolist() == [0.5, 0.5, 0.1, 0.1]
    assert checked["tiles"] == 3 and type(checked["tiles"]) is int
    for values, robots in ((words, 5), ({"tiles": [3, 4]}, 4)):
        with pytest.raises(InputError, match=f"{robots} robots cannot have 2 values of"):
            checked_settings("mine", made, values, robots)
    with pytest.raises(InputError, match=r"must lie in \[0.01, 1\], got 2"):
        checked_settings("mine", made, {"rate": [0.5, 2]}, 4)


def test_other_settings_are_refused_in_a_sentence():
    wrong = dict.fromkeys(
        ("rate", "rate=nan", "rate=1e999", "rate=0.1,0.2", "=1"), "must be NAME=VALUE with a number"
    )
    wrong["rate=0.1 rate=0.2"] = "the setting rate is given twice"
    wrong["rats=0.1"] = r"mine has no setting rats: did you mean rate\?"
    wrong["tiles=2.5"] = r"must be a whole number in \[2, 8\], got 2.5"
    for words, sentence in wrong.items():
        with pytest.raises(InputError, match=sentence):
            checked_settings("mine", made, settings_from(words.split()), 4)


REHEARSAL = "--robots 2 --time-scale 0.002 --body kinematic --life spot_finding".split()


def test_a_run_keeps_its_settings_and_signals(tmp_path, commands_in_process, capsys):
    command = ["run", str(tmp_path), "--agent", "q_learner", *REHEARSAL]
    assert cli.main([*command, "--set", "agent.rate=0.01", "signals=raw"]) == 0
    experiment = planned(tmp_path).experiment
    assert experiment.settings == ("rate=0.01",) and experiment.signals == "raw"
    assert cli.main(["run", str(tmp_path), "--robots", "4"]) == 0
    assert planned(tmp_path).robots == {
        Condition("spot_finding", "musebot.protocols.baselines:q_learner"): 4
    }
    capsys.readouterr()
    assert cli.main([*command, "--set", "agent.rate=0.02"]) == 2
    assert "settings" in capsys.readouterr().err
