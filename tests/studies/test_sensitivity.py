"""The study of the paper's open choices: one thing changed at a time."""

from typing import ClassVar

import numpy as np
import pytest

from musebot.protocols.errors import InputError
from musebot.protocols.experiment.conditions import PAPER_TASKS, CohortKey, Condition
from musebot.protocols.experiment.experiment import Experiment, differing
from musebot.protocols.experiment.manifest import read_manifest
from musebot.protocols.experiment.plan import Variant
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.studies.sensitivity import BASELINE, CHOICES, NOISE, Sensitivity
from musebot.protocols.studies.study import conduct

PROPOSERS = ("fixed", "random", "creative")
EVERYWHERE = [Condition(task, proposer) for task in PAPER_TASKS for proposer in PROPOSERS]
NAMES = [choice.name for choice in CHOICES]


class Few(Sensitivity):
    """Two choices and another seed: what is tested is the study, not each of them."""

    choices: ClassVar = tuple(
        choice for choice in CHOICES if choice.name in (NOISE, "speed-250mm", "nose-printed")
    )


class Crawling(Sensitivity):
    """A choice with an obvious effect."""

    tasks: ClassVar = PAPER_TASKS[:1]
    choices: ClassVar = (
        Variant(NOISE, {"seed": 2}, tasks, says="another seed"),
        Variant("crawl", {"motor_speed": 1e-4}, tasks, says="too slow for a wall"),
    )


def life(experiment, condition):
    cohort = Cohort(experiment, CohortKey(condition, 0))
    cohort.advance(10**9)
    return cohort.lives()


def same(first, second):
    pairs = zip(first.after.values(), second.after.values(), strict=True)
    return np.array_equal(first.minutes, second.minutes) and all(np.array_equal(*p) for p in pairs)


def test_every_choice_differs_from_the_baseline_in_one_field():
    wanted = dict(Sensitivity().plans())
    baseline = wanted.pop(BASELINE)
    assert baseline.experiment == Experiment(body="kinematic", cohort_size=100)
    assert baseline.robots == dict.fromkeys(EVERYWHERE, 100)
    assert list(wanted) == NAMES
    differ = [tuple(differing(plan.experiment, baseline.experiment)) for plan in wanted.values()]
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
def test_a_choice_changes_lives_in_its_conditions_and_no_bit_of_them_elsewhere(choice, baseline):
    experiment, lives = baseline
    changed = choice.experiment(experiment)
    for condition in EVERYWHERE:
        if condition not in choice.conditions:
            assert same(life(changed, condition), lives[condition]), condition
    somewhere = (c for c in choice.conditions if not same(life(changed, c), lives[c]))
    assert next(somewhere, None)


def test_the_page_says_how_many_cells_differ_and_with_which_choices_none_does(tmp_path, here):
    text = conduct(Few(robots=2, time_scale=0.001), tmp_path, here).markdown
    assert len(here.jobs) == 21  # of all four runs together
    assert "2 robots in each condition. After Holm's correction 0 of 135 cells differ" in text
    assert "motor 0.5 is 0.25 m/s (in 6 conditions); Eq. 3 as printed (in 3 conditions)." in text
    assert "| choice |" not in text
    assert "all durations times 0.001" in text
    assert read_manifest(tmp_path / NOISE).experiment.seed == 2


def test_a_choice_with_an_effect_is_reported_next_to_the_noise(tmp_path, here):
    text = conduct(Crawling(robots=40, time_scale=0.01), tmp_path, here).markdown
    rows = [line for line in text.splitlines() if line.startswith("| too slow for a wall |")]
    genius = [row.strip("| ").split(" | ")[2:] for row in rows if "| (genius) |" in row]
    lines = [line for line in text.splitlines() if line.endswith("| 1.0000 |")]
    noise = [line.strip("| ").split(" | ") for line in lines]
    both_seeds = {(row[0], row[1]): (row[3], row[4]) for row in noise}
    assert len(genius) == 3
    for proposer, name, variant, baseline, difference, holm, two_seeds in genius:
        assert variant == "100.0%"
        assert difference.startswith(f"+{100 - float(baseline[:-1]):.1f}%")
        assert holm == "< 0.0001"
        assert (baseline, two_seeds) == both_seeds[proposer, name]
    assert f"{len(rows)} of 54 cells differ" in text
    assert "No cell differs with: another seed (in 3 conditions)." in text


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"robots": 0}, "robots must be at least 1, got 0"),
        ({"robots": 251}, "do not split into a few equal cohorts of at most 250"),
        ({"time_scale": 2.0}, r"time scale must lie in \(0, 1\], got 2"),
    ],
)
def test_an_invalid_option_is_refused(options, words):
    with pytest.raises(InputError, match=words):
        Sensitivity(**options).experiments()
