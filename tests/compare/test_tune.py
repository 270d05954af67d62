"""Settings of an agent are tuned with the same effort for each."""

import dataclasses
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from musebot.protocols.agents import factory
from musebot.protocols.agents.factory import factory_of
from musebot.protocols.agents.hand_coded import HandCoded
from musebot.protocols.agents.settings import Setting, settings_of, tunable
from musebot.protocols.compare.benchmark import LEARNERS
from musebot.protocols.compare.study import STUDY_FILE, conduct
from musebot.protocols.compare.tune import Tune, read_tunings, shares_of
from musebot.protocols.errors import InputError
from musebot.protocols.storage import read_json, write_json
from musebot.tasks.lives import LIVES

GOODNESS = 0.2, 0.0, 1.0, "share of the time in which it acts well"


@tunable(goodness=Setting(*GOODNESS))
def graded(robots, senses, seed, *, goodness):
    """Drives well for a share of the time, and else straight on."""
    return Graded(senses, goodness)


@tunable(goodness=Setting(*GOODNESS, each=True))
def each(robots, senses, seed, *, goodness):
    """The same, where robots may differ."""
    return Graded(senses, np.broadcast_to(goodness, robots))


class Graded(HandCoded):
    def __init__(self, senses, goodness):
        super().__init__(senses)
        self.goodness, self.step = goodness, 0

    def act(self, state, learning):
        self.step += 1
        good = np.broadcast_to((self.step * 0.618) % 1 < self.goodness, len(state))
        return np.where(good[:, None], super().act(state, learning), 0.5)


def plain(robots, senses, seed):
    return HandCoded(senses)


@tunable(goodness=Setting(*GOODNESS))
def failing(robots, senses, seed, *, goodness):
    raise ValueError


MINE = types.ModuleType("mine")
MINE.graded, MINE.each, MINE.plain, MINE.failing = graded, each, plain, failing


@pytest.fixture(autouse=True)
def module(monkeypatch):
    monkeypatch.setitem(sys.modules, "mine", MINE)
    monkeypatch.setattr(factory, "_TRUSTED", set())


KEPT = Path(__file__).parents[2] / "docs" / "results" / "tuned"
TINY = Tune(agent="mine:graded", trials=4, kept=2, robots=3, time_scale=0.002)


@pytest.fixture(scope="module")
def tuned(tmp_path_factory, in_process):
    """Finished studies of both agents by their name."""
    found = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "mine", MINE)
        for name in ("graded", "each"):
            out = tmp_path_factory.mktemp(name) / "out"
            study = dataclasses.replace(TINY, agent=f"mine:{name}")
            page = conduct(study, out, in_process())
            found[name] = study, out, page.markdown
    return found


def test_the_first_trial_has_the_defaults_and_all_lie_in_their_ranges():
    factory.trust(TINY.agent)
    trials = TINY.drawn()
    assert trials[0].settings == () and len({*trials}) == 4
    for trial in trials[1:]:
        (word,) = trial.settings
        assert 0 <= float(word.removeprefix("goodness=")) <= 1
    assert trials == dataclasses.replace(TINY).drawn()
    assert trials != dataclasses.replace(TINY, seed=5).drawn()


@pytest.mark.parametrize("name", ["wall_avoidance", "spot_finding", "senses"])
def test_shares_are_those_at_the_goal_in_each_part_and_0_for_an_unstable_robot(name):
    life = LIVES[name]
    steps = [life.steps_of(part) for part in ("pre", "training", "post")]
    events = np.array([[0, 0.2, 0.1], [1, 0.6, 0.5], [0, 0.6, 0.6]]) * steps
    arrays = {"events": events.astype(np.int32), "valid": np.array([True, True, False])}
    wanted = np.array([[0.1, 0.5], [0.2, 0.6]])
    wanted = wanted if life.wanted else 1 - wanted
    wanted = np.column_stack([wanted, [0, 0]])[0 if life.tested else 1 :]
    np.testing.assert_allclose(shares_of(arrays, life), wanted, atol=1e-3)


def test_each_trial_is_given_its_own_robots(tuned):
    """An agent that drives well for the share of time it is given: so are its values."""
    factory.trust("mine:graded", "mine:each")
    alone, together = (
        {one.trial: one.early.mean() for one in study.ranked(out)}
        for study, out, _ in tuned.values()
    )
    assert np.corrcoef([*alone.values()], [together[trial] for trial in alone])[0, 1] > 0.9
    assert [len([*(out / "trials").iterdir()]) for _, out, _ in tuned.values()] == [6, 2]


def test_the_best_trials_have_a_second_round_and_the_page_names_the_winner(tuned):
    study, out, page = tuned["graded"]
    factory.trust("mine:graded")
    first, second, *others = study.ranked(out)
    assert [one.late is not None for one in (first, second, *others)] == [True, True, False, False]
    assert min(first.early.mean(), second.early.mean()) >= max(one.early.mean() for one in others)
    assert first.late.mean() >= second.late.mean() and study.best(out) == first.trial
    assert f"Best: trial {first.trial.number}, `musebot run OUT --agent mine:graded" in page


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"agent": "creative"}, "is a proposer of the brain"),
        ({"life": "boddy"}, "there is no life 'boddy'; did you mean body"),
        ({"agent": "mine:plain"}, "mine:plain has no settings to tune"),
        ({"trials": 0}, "trials must be a whole number from 1 to 1024, got 0"),
        ({"trials": 3, "kept": 4}, "kept must be at most trials, 3, got 4"),
        ({"robots": 62_501}, "robots must be a whole number from 1 to 62500"),
        ({"seed": -1}, "seed must be a whole number from 0"),
        ({"agent": "mine:failing"}, "the factory mine:failing failed"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(changes, sentence):
    with pytest.raises(InputError, match=sentence):
        dataclasses.replace(TINY, **changes).identity()


def test_a_study_is_read_from_its_folder_without_its_agents_code(tuned, tmp_path):
    study, out, _ = tuned["each"]
    ((folder, read),) = read_tunings([out]).values()
    assert (read, folder) == (study, out)
    with pytest.raises(InputError, match="trust"):
        read.best(out)
    assert [*read_tunings([out])] == [("mine:each", "raw")]
    with pytest.raises(InputError, match="mine:each with raw signals was tuned twice"):
        read_tunings([out, out])


def test_what_is_no_study_that_tunes_is_refused_in_a_sentence(tuned, tmp_path):
    held = read_json(tuned["each"][1] / STUDY_FILE)
    for changes in (
        *({"agent": agent} for agent in (5, "**x** | y")),
        *({"kept": kept} for kept in ("3", 2.5)),
        *({"life": "chess"}, {"time_scale": "1"}),
    ):
        write_json(tmp_path / STUDY_FILE, held | {"identity": held["identity"] | changes})
        with pytest.raises(InputError, match="study.json is no study `tune` of musebot's"):
            read_tunings([tmp_path])
    write_json(tmp_path / STUDY_FILE, held | {"study": "ppo"})
    with pytest.raises(InputError, match="it holds another study"):
        read_tunings([tmp_path])


def test_every_learner_of_ours_can_be_tuned_but_for_its_size():
    for name in LEARNERS:
        settings = settings_of(factory_of(name))
        assert {*settings} - {*Tune(agent=name).settings} <= {"hidden", "cells"}
        assert len(Tune(agent=name).drawn()) == 16


def test_a_kept_tuning_has_the_best_trial_of_its_page():
    for folder in KEPT.iterdir():
        ((_, study),) = read_tunings([folder]).values()
        best = study.best(folder)
        kept = (folder / "tune.md").read_text().splitlines()
        assert any(line.startswith(f"Best: trial {best.number}, ") for line in kept)
        made = study.page(folder).markdown.splitlines()
        rows, wanted = ([line for line in text if line[:1] == "|"] for text in (made, kept))
        assert rows == wanted
