"""What brains know by the hour: diaries, frozen tests, ideas, and the figures of them."""

import dataclasses
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import torch

from musebot.controller import BRAINS
from musebot.protocols import hours
from musebot.protocols.cohort import Cohort
from musebot.protocols.experiment import CohortKey, Experiment
from musebot.protocols.hours import TIMES, Diary, Findings

STEADY = BRAINS["steady"]
SHORT = Experiment(cohort_size=3, time_scale=0.005, body="kinematic", brain=STEADY)
KEY = CohortKey("spot_finding", "creative", 0)


@pytest.fixture(scope="module")
def diary():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    ticks = []
    yield hours.keep(SHORT, "steady", ticks.append)
    torch.set_num_threads(threads)
    assert sum(ticks) == 3 * (180 + 720)


@pytest.fixture(scope="module")
def found(diary):
    ticks = []
    shares = hours.examined(diary, ticks.append)
    assert len(ticks) > 0
    return Findings(diary, shares, *hours.asked(diary))


def test_a_diary_begins_with_the_newborn_and_ends_with_the_trained_brains(diary):
    cohort = Cohort(SHORT, KEY)
    cohort.advance(10**9)
    lives = cohort.lives()
    assert len(diary.hours) == TIMES + 1
    assert (diary.hours[0], diary.hours[-1]) == (0, pytest.approx(4 * 0.005))
    for name, networks in diary.networks.items():
        np.testing.assert_array_equal(networks[0], lives.before[name])
        np.testing.assert_array_equal(networks[-1], lives.after[name])
        assert not np.array_equal(networks[TIMES // 2], networks[-1])


def test_the_smells_are_none_weaker_stronger_and_full():
    none, weak, strong, full = hours.smells(SHORT)[:, 0]
    assert none == 0 < weak < strong < full
    assert full == pytest.approx(10 / 11)


def of(shares, networks=None):
    experiment = dataclasses.replace(SHORT, cohort_size=np.shape(shares)[1])
    blank = np.zeros((len(shares), 4, np.shape(shares)[1]))
    times = np.arange(len(shares), dtype=float)
    return Findings(Diary(experiment, "one", times, networks or {}), np.array(shares), blank, blank)


def test_what_is_forgotten_is_what_a_robot_once_did_better():
    one = of([[0.0, 0.5], [0.8, 0.2], [0.1, 0.9]])
    assert one.best.tolist() == [[0.0, 0.5], [0.8, 0.5], [0.8, 0.9]]
    row = hours.markdown([one]).splitlines()[2]
    assert row.startswith("| one | 2 | 0.850 ")
    assert "| 0.500 " in row
    assert "| 0.350 " in row


def test_a_brain_with_all_actions_for_ideas_lacks_nothing_and_one_with_one_lacks_more(diary):
    def missing(ideas):
        brain = dataclasses.replace(STEADY, ideas=ideas)
        other = dataclasses.replace(diary, experiment=dataclasses.replace(SHORT, brain=brain))
        return hours.asked(other)

    (few_spread, few), (_, many) = missing(1), missing(2000)
    assert (few_spread == 0).all()
    assert (few >= 0).all()
    assert (few <= 1).all()
    assert many.mean() < 0.03 < few.mean()


def test_frozen_brains_stand_in_their_own_time_and_robot(diary):
    which = np.array([[0, TIMES, 2], [2, 0, 1]])
    networks = diary.brains(which).controller.networks()
    for name, tensor in networks.items():
        for row, (time, robot) in enumerate(which.T):
            np.testing.assert_array_equal(tensor[row].numpy(), diary.networks[name][time, robot])


def test_the_figures_show_every_brain_and_smell(found, tmp_path):
    with hours.figures.styled():
        figure = hours.draw([found, found])
        paths = hours.figures.save(figure, tmp_path, "hours")
        paths += hours.figures.save(hours.draw_hours(found), tmp_path, "values")
    texts = [ET.parse(path).getroot() for path in paths if path.suffix == ".svg"]
    assert len(texts) == 2
    assert all(path.stat().st_size > 1000 for path in paths)
    assert [axis.get_title(loc="left") for axis in figure.axes[:2]] == ["steady", "steady"]
    for axis in figure.axes:
        low, high = axis.get_ylim()
        lines = [line.get_ydata() for line in axis.lines]
        assert all((np.array(line) >= low).all() & (np.array(line) <= high).all() for line in lines)


def test_it_is_a_command_and_refuses_what_makes_no_sense(tmp_path, capsys):
    small = {"robots": 2, "body": "kinematic", "time_scale": 0.002}
    hours.main(tmp_path / "out", ("paper", "steady"), **small)
    assert capsys.readouterr().out.startswith("| brain | robots | in the spot, at best |")
    names = [f"{name}.{end}" for name in ("hours", "values-paper", "values-steady")
             for end in ("png", "svg")]  # fmt: skip
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == names
    (tmp_path / "file").touch()
    for out, brains, changes, sentence in (
        ("new", ("paper", "paper"), {}, "different brains"),
        ("new", (), {}, "different brains"),
        ("new", ("clever",), {}, "the brain must be one of"),
        ("new", ("paper",), {"robots": 0}, "at least 1"),
        ("new", ("paper",), {"kinematics": ("wall=eats",)}, "wall must be one of"),
        ("file", ("paper",), {}, "is no folder"),
    ):
        with pytest.raises(hours.InputError, match=sentence):
            hours.main(tmp_path / out, brains, **small | changes)
    assert not (tmp_path / "new").exists()
