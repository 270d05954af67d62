"""Settings of agents are read, checked and handed to the factory."""

import re

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
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.run_files import planned


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
def test_a_share_of_a_range_lies_in_it(share):
    for setting in settings_of(made).values():
        assert setting.low <= setting.at(share) <= setting.high
    assert settings_of(made)["tiles"].at(share) in range(2, 9)


def test_a_range_that_does_not_suit_its_kind_is_refused():
    with pytest.raises(ValueError, match="take 0 and 1 for no and yes"):
        Setting(True, 0, 1)
    with pytest.raises(ValueError, match="whole numbers begins at 1"):
        Setting(1, 0.5, 9, log=True)
    with pytest.raises(ValueError, match="a logarithmic range must be above 0, got 0.0"):
        Setting(0.5, 0.0, 1.0, log=True)


def test_whole_numbers_are_drawn_evenly():
    drawn = [settings_of(made)["tiles"].at((n + 0.5) / 700) for n in range(700)]
    assert [drawn.count(value) for value in range(2, 9)] == [100] * 7


def test_half_of_a_logarithmic_range_is_its_geometric_mean():
    assert settings_of(made)["rate"].at(0.5) == pytest.approx(0.1)
    assert Setting(0.2, 0.0, 1.0).at(0.5) == 0.5


def test_settings_are_read_as_numbers():
    assert settings_from(["rate=0.5", "tiles=3"]) == {"rate": [0.5], "tiles": [3]}
    checked = checked_settings("mine", made, {"rate": [1], "tiles": [3.0]}, 5)
    assert checked == {"rate": 1.0, "tiles": 3} and type(checked["tiles"]) is int


def test_several_values_belong_to_equal_shares_of_the_robots():
    words = settings_from(["rate=0.5,0.1", "tiles=3"], several=True)
    checked = checked_settings("mine", made, words, 4)
    assert checked["rate"].tolist() == [0.5, 0.5, 0.1, 0.1] and checked["tiles"] == 3
    with pytest.raises(InputError, match="5 robots cannot have 2 values of rate"):
        checked_settings("mine", made, words, 5)
    with pytest.raises(InputError, match="4 robots cannot have 2 values of tiles"):
        checked_settings("mine", made, {"tiles": [3, 4]}, 4)
    with pytest.raises(InputError, match=r"must lie in \[0.01, 1\], got 2"):
        checked_settings("mine", made, {"rate": [0.5, 2]}, 4)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["rate"], "a setting must be NAME=VALUE with a number, got 'rate'"),
        (["rate=nan"], "with a number"),
        (["rate=1e999"], "with a number"),
        (["rate=0.1,0.2"], "with a number"),
        (["=1"], "must be NAME=VALUE"),
        (["rate=0.1", "rate=0.2"], "the setting rate is given twice"),
        (["rats=0.1"], r"mine has no setting rats: did you mean rate\?"),
        (["unnamed=2"], r"mine has no setting unnamed: there are rate, tiles"),
        (["rate=2"], r"the setting rate of mine must lie in \[0.01, 1\], got 2"),
        (["tiles=2.5"], r"must be a whole number in \[2, 8\], got 2.5"),
    ],
)
def test_other_settings_are_refused_in_a_sentence(words, sentence):
    with pytest.raises(InputError, match=sentence):
        checked_settings("mine", made, settings_from(words), 4)


def test_a_default_outside_of_its_range_is_an_error_of_the_agents_author():
    with pytest.raises(ValueError, match=r"2 does not lie in \[0, 1\]"):
        Setting(2, 0, 1)


REHEARSAL = "--robots 2 --time-scale 0.002 --body kinematic --task spot_finding".split()


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


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--agent", "sarsa"], "did you mean sarsa_lambda"),
        (["--agent", "dqn", "--set", "agent.rat=1"], "dqn has no setting rat: did you mean rate?"),
        (["--proposer", "fixed", "--set", "signals=raw"], "raw signals change agents only"),
        (["--set", "agent.rate=0.1"], "raw signals change agents only"),
        (["--agent", "dqn", "--set", "signals=salty"], "signals must be .*'paper' or 'raw'"),
    ],
)
def test_a_run_with_an_unknown_agent_or_setting_is_refused_before_anything_is_made(
    words, sentence, tmp_path, commands_in_process, capsys
):
    out = tmp_path / "out"
    assert cli.main(["run", str(out), *words, *REHEARSAL]) == 2
    assert re.search(sentence.replace("?", r"\?"), capsys.readouterr().err)
    assert not out.exists()
