"""The study of the paper's open choices: one thing changed at a time, and every run kept."""

import sys

import numpy as np
import pytest
import tyro

from musebot.protocols.errors import exit_status
from musebot.protocols.experiment.experiment import (
    TASKS,
    CohortKey,
    Experiment,
    differing,
    save_plan,
)
from musebot.protocols.options import Workers
from musebot.protocols.simulation import engine
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.studies import sensitivity
from musebot.protocols.studies.sensitivity import BASELINE, CHOICES, NOISE, Choice

EVERYWHERE = sensitivity.plans(1, 1.0)[BASELINE].conditions
NAMES = [choice.name for choice in CHOICES]


def run(out, **options):
    return exit_status(
        lambda: sensitivity.main(
            out, **({"robots": 2, "time_scale": 0.001, "workers": Workers(1)} | options)
        )
    )


def listing(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def life(experiment, condition):
    cohort = Cohort(experiment, CohortKey(*condition, 0))
    cohort.advance(10**9)
    return cohort.lives()


def same(first, second):
    pairs = zip(first.after.values(), second.after.values(), strict=True)
    return np.array_equal(first.minutes, second.minutes) and all(np.array_equal(*p) for p in pairs)


def test_every_choice_differs_from_the_baseline_in_one_field():
    wanted = sensitivity.plans(100, 1.0)
    baseline = wanted.pop(BASELINE).experiment
    assert baseline == Experiment(body="kinematic", cohort_size=100)
    assert list(wanted) == NAMES
    differ = [tuple(differing(plan.experiment, baseline)) for plan in wanted.values()]
    assert all(len(fields) == 1 for fields in differ), differ
    assert {fields[0] for fields in differ} == {
        *("seed", "motor_speed", "turned_start", "nose", "learn_across_placement"),
        *(
            f"kinematics.{name}"
            for name in ("radius", "wheel_base", "felt", "any_contact", "wall", "lag")
        ),
        *("brain.test_epsilon", "brain.noise_on_biases"),
    }


@pytest.fixture(scope="module")
def baseline():
    experiment = Experiment(body="kinematic", cohort_size=5, time_scale=0.003)
    return experiment, {condition: life(experiment, condition) for condition in EVERYWHERE}


@pytest.mark.parametrize("choice", CHOICES, ids=NAMES)
def test_where_a_choice_is_left_out_it_changes_no_bit_of_a_life_and_elsewhere_it_does(
    choice, baseline
):
    experiment, lives = baseline
    changed = choice.experiment(experiment)
    for condition in EVERYWHERE:
        if condition not in choice.conditions:
            assert same(life(changed, condition), lives[condition]), condition
    somewhere = (c for c in choice.conditions if not same(life(changed, c), lives[c]))
    assert next(somewhere, None)


@pytest.fixture
def fewer(monkeypatch):
    """Two choices and another seed: what is tested is the study, not each of them."""
    monkeypatch.setattr(
        sensitivity,
        "CHOICES",
        tuple(
            choice for choice in CHOICES if choice.name in (NOISE, "speed-250mm", "nose-printed")
        ),
    )


def test_a_study_keeps_every_run_and_its_page_and_goes_on_where_it_was(
    tmp_path, lived_here, fewer, capsys
):
    out = tmp_path / "study"
    assert run(out) == 0
    text, progress = capsys.readouterr()
    assert "21 cohorts" in progress  # of all four runs together
    names = {BASELINE, NOISE, "speed-250mm", "nose-printed"}
    assert {path.name for path in out.iterdir()} == {*names, "sensitivity.md"}
    assert (out / "sensitivity.md").read_text() == sensitivity.report(out)
    assert text.strip() == sensitivity.report(out).strip()
    assert "2 robots a condition. After Holm's correction 0 of 135 cells differ" in text
    assert "motor 0.5 is 0.25 m/s (in 6 conditions); Eq. 3 as printed (in 3 conditions)." in text
    assert "| choice |" not in text
    assert "a rehearsal: every duration times 0.001" in text

    before = listing(out)
    for name in ("speed-250mm/robots.csv", "sensitivity.md"):
        (out / name).unlink()
    assert run(out) == 0
    assert listing(out) == before
    assert engine.load_plan(out / NOISE / "experiment.json").experiment.seed == 2


def test_a_choice_that_matters_is_seen_beside_the_noise(tmp_path, lived_here, monkeypatch):
    walls = TASKS[:1]
    seed = Choice(NOISE, "another seed", {"seed": 2}, walls)
    crawl = Choice("crawl", "too slow for a wall", {"motor_speed": 1e-4}, walls)
    monkeypatch.setattr(sensitivity, "TASKS", walls)
    monkeypatch.setattr(sensitivity, "CHOICES", (seed, crawl))
    assert run(tmp_path / "study", robots=40, time_scale=0.01) == 0
    text = (tmp_path / "study" / "sensitivity.md").read_text()
    rows = [line for line in text.splitlines() if line.startswith("| too slow for a wall |")]
    genius = [row.strip("| ").split(" | ")[2:] for row in rows if "| (genius) |" in row]
    lines = [line for line in text.splitlines() if line.endswith("| 1.0000 |")]
    noise = [line.strip("| ").split(" | ") for line in lines]
    both_seeds = {(row[0], row[1]): (row[3], row[4]) for row in noise}
    assert len(genius) == 3
    for proposer, name, chosen, baseline, difference, holm, two_seeds in genius:
        assert chosen == "100.0%"
        assert difference.startswith(f"+{100 - float(baseline[:-1]):.1f}%")
        assert holm == "< 0.0001"
        assert (baseline, two_seeds) == both_seeds[proposer, name]
    assert f"{len(rows)} of 54 cells differ" in text
    assert "No cell does with: another seed (in 3 conditions)." in text


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"robots": 0}, "number of robots must be at least 1, got 0"),
        ({"time_scale": 2.0}, "time scale must lie in (0, 1], got 2"),
        ({"workers": Workers(0)}, "number of processes must be at least 1, got 0"),
    ],
)
def test_bad_input_is_one_sentence_and_nothing_is_made(options, words, tmp_path, capsys):
    assert run(tmp_path / "study", **options) == 2
    message = capsys.readouterr().err
    assert words in message and message.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_foreign_folder_is_refused_and_left_alone(tmp_path, capsys):
    (tmp_path / "thesis.tex").write_text("precious")
    assert run(tmp_path) == 2
    assert "is not empty and holds no study of musebot's" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_another_study_than_a_folders_own_is_refused_and_nothing_changes(tmp_path, capsys):
    held = sensitivity.plans(2, 0.001)["any-contact"]
    save_plan(tmp_path / "any-contact" / engine.PLAN, held)
    before = listing(tmp_path)
    assert run(tmp_path, time_scale=0.002) == 2
    words = "any-contact holds an experiment with time_scale 0.001, not 0.002"
    assert words in capsys.readouterr().err
    assert listing(tmp_path) == before


def test_a_study_that_lacks_a_run_is_named(tmp_path):
    with pytest.raises(sensitivity.InputError, match="lacks the run baseline"):
        sensitivity.report(tmp_path)


def test_it_explains_itself(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["sensitivity", "--help"])
    with pytest.raises(SystemExit) as stop:
        tyro.cli(sensitivity.main)
    assert stop.value.code == 0
    assert "--robots" in capsys.readouterr().out
