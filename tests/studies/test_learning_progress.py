"""What brains know by the hour: diaries, frozen tests, ideas, and the figures of them."""

import dataclasses
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import torch

from musebot.controller import BRAINS
from musebot.protocols.experiment.experiment import CohortKey, Experiment
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.storage import is_draft
from musebot.protocols.studies import learning_progress as hours
from musebot.protocols.studies.learning_progress import TIMES, Diary, Findings, Job

STEADY = BRAINS["steady"]
SHORT = Experiment(cohort_size=3, time_scale=0.005, body="kinematic", brain=STEADY)
KEY = CohortKey("spot_finding", "creative", 0)


PAPER = dataclasses.replace(SHORT, brain=BRAINS["paper"])
SMALL = {"robots": 2, "body": "kinematic", "time_scale": 0.002, "processes": 1}


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    ticks = []
    job = Job(tmp_path_factory.mktemp("hours"), "steady", SHORT)
    hours.live(job, ticks.append)
    yield job
    torch.set_num_threads(threads)
    assert sum(ticks) == 3 * (180 + 720)


@pytest.fixture
def done(monkeypatch):
    """What is handed over to the pool, and then done in this process."""

    def work_off(what, work, jobs, processes, total, begun=0):
        ticks = []
        monkeypatch.setattr(hours.pool, "tick", ticks.append)
        for job, *rest in jobs:
            handed_over.append((what, job.name, *rest[1:]))
            work(job, *rest)
        assert sum(ticks) == total - begun

    handed_over = []
    monkeypatch.setattr(hours.pool, "work_off", work_off)
    return handed_over


@pytest.fixture(scope="module")
def diary(job):
    return job.diary()


@pytest.fixture(scope="module")
def found(diary):
    ticks = []
    tests = np.array([hours.examined(diary, seed, ticks.append) for seed in (0, 1)])
    assert sum(ticks) == 2 * 3 * (TIMES + 1)
    return Findings(diary, tests, *hours.asked(diary))


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


def test_a_life_killed_at_any_time_goes_on_to_the_same_bits(job, tmp_path):
    class KilledError(Exception):
        pass

    def killed_at(step):
        def tick(steps):
            lived.append(steps)
            if sum(lived) >= 3 * step:
                raise KilledError

        lived = [other.lived()]
        return tick

    other = Job(tmp_path, "steady", SHORT)
    for step in (100, 181, 400, 899, 900):
        with pytest.raises(KilledError):
            hours.live(other, killed_at(step))
        assert other.diary() is None
    ticks = []
    assert other.lived() == 3 * (180 + 7 * 90)
    hours.live(other, ticks.append)
    assert sum(ticks) == 3 * 90
    assert other.lived() == 3 * (180 + 720)
    assert other.brains.read_bytes() == job.brains.read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["brains-steady.safetensors"]


def test_the_smells_are_none_weaker_stronger_and_full():
    none, weak, strong, full = hours.smells(SHORT)[:, 0]
    assert none == 0 < weak < strong < full
    assert full == pytest.approx(10 / 11)


def of(first, second):
    """What two tests of diaries come to, each of shape (T, R)."""
    experiment = dataclasses.replace(SHORT, cohort_size=np.shape(first)[1])
    blank = np.zeros((len(first), 4, np.shape(first)[1]))
    tests = np.array([first, second], dtype=float)
    return Findings(Diary(experiment, "one", np.arange(len(first)), {}), tests, blank, blank)


def test_what_is_forgotten_is_judged_by_another_test_than_the_best_time_is_chosen_by():
    one = of([[0.0, 0.5], [0.8, 0.2], [0.1, 0.9]], [[0.1, 0.4], [0.7, 0.1], [0.2, 1.0]])
    assert one.best.tolist() == [[0.1, 0.4], [0.7, 0.4], [0.7, 1.0]]
    row = hours.markdown([one]).splitlines()[2]
    assert row.startswith("| one | 2 | 0.850 |")
    assert "| 0.600 |" in row
    assert "| 0.250 |" in row


def test_brains_that_forget_nothing_have_forgotten_nothing_however_lucky_they_once_were():
    random = np.random.default_rng(0)
    one = of(*(random.random((2, 9, 4000)) < 0.5))
    forgotten = (one.best[-1] - one.shares[-1]).mean()
    assert forgotten == pytest.approx(0, abs=0.03)


def test_an_unstable_simulation_is_left_out_and_counted(diary):
    broken = {name: networks.copy() for name, networks in diary.networks.items()}
    broken["memory.output_biases"][-1, 1] = np.nan
    spoilt = dataclasses.replace(diary, networks=broken)
    shares = hours.examined(spoilt, 0, lambda steps: None)
    assert np.isnan(shares).sum() == 1
    assert np.isnan(shares[-1, 1])
    found = Findings(spoilt, np.array([shares, shares]), *np.zeros((2, TIMES + 1, 4, 3)))
    assert "| 2 (and 1 invalid) |" in hours.markdown([found])


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
        for row, (when, robot) in enumerate(which.T):
            np.testing.assert_array_equal(tensor[row].numpy(), diary.networks[name][when, robot])


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


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_it_is_a_command_that_does_anew_what_is_lost_and_no_more(tmp_path, capsys, done):
    def command():
        done.clear()
        hours.main(tmp_path, ("paper", "steady"), **SMALL)
        return capsys.readouterr().out

    page = command()
    assert page.startswith("| brain | robots | in the spot, at its best time |")
    tests = [("tests", name, seed) for name in ("paper", "steady") for seed in (0, 1)]
    assert done == [("lives", "paper"), ("lives", "steady"), *tests]
    whole = content(tmp_path)
    kept = [f"brains-{name}.safetensors" for name in ("paper", "steady")]
    kept += [f"test-{name}-{seed}.safetensors" for _, name, seed in tests]
    drawn = [f"{name}.{end}" for name in ("hours", "values-paper", "values-steady")
             for end in ("png", "svg")]  # fmt: skip
    assert sorted(whole) == sorted(kept + drawn)
    for lost, anew in (
        ("hours.svg", []),
        ("brains-paper.safetensors", [("lives", "paper")]),
        ("test-steady-1.safetensors", [("tests", "steady", 1)]),
    ):
        (tmp_path / lost).unlink()
        (tmp_path / f".{lost}.1.draft").touch()  # of a writer that was killed
        assert command() == page
        assert done == anew
        assert content(tmp_path) == whole


def test_a_test_is_kept_as_it_was_sat_and_sat_again_by_other_brains(
    job, tmp_path, monkeypatch, done
):
    def examined(kept, seed, tick):
        tick(kept.robots * len(kept.hours))
        return kept.networks["memory.output_biases"][..., 0] + seed

    def tests():
        (found,) = hours.findings([own], 1)
        return found.tests

    monkeypatch.setattr(hours, "examined", examined)
    own = Job(tmp_path, "steady", SHORT)
    own.brains.write_bytes(job.brains.read_bytes())
    first = tests()
    assert (np.diff(first, axis=0) > 0.9).all()
    assert done == [("tests", "steady", 0), ("tests", "steady", 1)]
    np.testing.assert_array_equal(tests(), first)
    own.test(0).write_bytes(own.test(1).read_bytes())  # of another seed
    np.testing.assert_array_equal(tests(), first)
    assert done[2:] == [("tests", "steady", 0)]
    arrays, notes = hours.load_arrays(own.brains)
    arrays["known.memory.output_biases"] *= 2
    hours.save_arrays(own.brains, arrays, **notes)
    np.testing.assert_allclose(tests()[0], 2 * first[0])
    assert done[3:] == [("tests", "steady", 0), ("tests", "steady", 1)]


def test_that_no_life_was_valid_is_said_when_the_other_brains_have_lived(job, tmp_path, done):
    bad, good = Job(tmp_path, "steady", SHORT), Job(tmp_path, "paper", PAPER)
    arrays, notes = hours.load_arrays(job.brains)
    arrays["batch.valid"][:] = False
    hours.save_arrays(bad.brains, arrays, **notes)
    with pytest.raises(hours.RunError, match="steady: every simulation became unstable"):
        hours.findings([bad, good], 1)
    assert done == [("lives", "paper")]
    assert good.diary() is not None


def test_who_has_half_lived_lives_the_other_half(job, tmp_path, monkeypatch, done):
    half = Job(tmp_path, "steady", SHORT)
    real = hours.save_arrays

    def killed_after_half(path, arrays, **notes):
        real(path, arrays, **notes)
        if notes["step"] == 180 + 360:
            raise KeyboardInterrupt

    monkeypatch.setattr(hours, "save_arrays", killed_after_half)
    with pytest.raises(KeyboardInterrupt):
        hours.live(half, lambda steps: None)
    monkeypatch.setattr(hours, "save_arrays", real)
    assert half.lived() == 3 * 540
    hours.findings([half], 1)  # where what is done anew is held against what was left
    assert done == [("lives", "steady"), ("tests", "steady", 0), ("tests", "steady", 1)]
    assert half.brains.read_bytes() == job.brains.read_bytes()


def test_stopped_it_goes_on_to_the_same_bytes(tmp_path, stopped):
    line = [
        sys.executable,
        "-m",
        "musebot.protocols.studies.learning_progress",
        str(tmp_path / "stopped"),
    ]
    line += ["--brains", "steady", "--robots", "2", "--body", "kinematic", "--seed", "2"]
    line += ["--time-scale", "0.02", "--processes", "1"]
    status, said = stopped(line, tmp_path, "stopped/brains-*")
    assert status == 130, said
    assert "the same command goes on from here" in said
    kept = [path.name for path in tmp_path.glob("stopped/*") if not is_draft(path)]
    assert kept == ["brains-steady.safetensors"]
    for out in ("stopped", "whole"):
        small = SMALL | {"time_scale": 0.02, "seed": 2}
        hours.main(tmp_path / out, ("steady",), **small)
    assert content(tmp_path / "stopped") == content(tmp_path / "whole")


def test_it_refuses_what_makes_no_sense(tmp_path):
    (tmp_path / "file").touch()
    for out, brains, changes, sentence in (
        ("new", ("paper", "paper"), {}, "different brains"),
        ("new", (), {}, "different brains"),
        ("new", ("clever",), {}, "the brain must be one of"),
        ("new", ("paper",), {"robots": 0}, "robots must be at least 1"),
        ("new", ("paper",), {"processes": 0}, "processes must be at least 1"),
        ("new", ("paper",), {"kinematics": ("wall=eats",)}, "wall must be one of"),
        ("file", ("paper",), {}, "is not a folder"),
        ("file/below", ("paper",), {}, "is not a folder"),
    ):
        with pytest.raises(hours.InputError, match=sentence):
            hours.main(tmp_path / out, brains, **SMALL | changes)
    assert not (tmp_path / "new").exists()


def test_it_goes_on_with_nothing_but_its_own(job, tmp_path, monkeypatch):
    monkeypatch.setattr(hours.pool, "results", None)  # refused before anything is done
    brains, test = tmp_path / job.brains.name, tmp_path / job.test(0).name

    def refused(sentence, **changes):
        own = {"robots": 3, "body": "kinematic", "time_scale": 0.005, "seed": SHORT.seed}
        held = content(tmp_path)
        with pytest.raises(hours.InputError, match=sentence):
            hours.main(tmp_path, ("steady",), **own | changes)
        assert held == content(tmp_path)

    brains.write_bytes(job.brains.read_bytes())
    refused(r"brains-steady.safetensors is of robots with seed \d, not 7", seed=7)
    refused("is of robots with cohort_size 3, not 4", robots=4)
    arrays, notes = hours.load_arrays(brains)
    brains.write_bytes(b"not ours")
    with hours.engine.locked(tmp_path):
        refused("another musebot is running")
    refused("brains-steady.safetensors is damaged")
    for changed, sentence in (
        ({"physics": [1.0] * len(notes["physics"])}, "was lived in another physics"),
        ({"times": notes["times"][::2]}, "kept at other times"),
        ({"experiment": notes["experiment"] | {"mood": 1}}, "is another version's"),
        ({"experiment": notes["experiment"] | {"kinematics": {"lag": -1}}}, "another version's"),
        ({"experiment": []}, "is another version's"),
        ({"step": 333}, "is another version's.*9 networks are not those of step 333"),
        ({"random": []}, "is another version's"),
    ):
        hours.save_arrays(brains, arrays, **notes | changed)
        refused(f"brains-steady.safetensors .*{sentence}")
    for lost in ("known.memory.output_biases", "batch.valid"):
        fewer = {name: array for name, array in arrays.items() if name != lost}
        hours.save_arrays(brains, fewer, **notes)
        refused("brains-steady.safetensors is another version's")
    for name, networks in (
        ("memory.output_biases", arrays["known.memory.output_biases"][:-1]),
        ("memory.output_biases", arrays["known.memory.output_biases"][:, :-1]),
        ("memory.output_biases", np.float32(0)),
    ):
        hours.save_arrays(brains, arrays | {f"known.{name}": networks}, **notes)
        refused("brains-steady.safetensors is another version's")
    brains.unlink()
    hours.save_arrays(test, {"shares": np.zeros((TIMES + 1, 3))})
    refused("test-steady-0.safetensors is another version's")
    test.write_bytes(b"not ours")
    refused("test-steady-0.safetensors is damaged")
