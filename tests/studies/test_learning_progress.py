"""The study of what brains have learned at nine times of their training: page and figures."""

import dataclasses
import sys
import types

import numpy as np
import pytest

from musebot.protocols.errors import InputError
from musebot.protocols.experiment.experiment import Experiment
from musebot.protocols.storage import is_draft
from musebot.protocols.studies.learning_progress import study as module
from musebot.protocols.studies.learning_progress.frozen_brains import BrainsInTime, Evaluation
from musebot.protocols.studies.learning_progress.study import (
    LearningProgress,
    draw,
    draw_brain,
    markdown,
)
from musebot.protocols.studies.study import conduct

SHORT = Experiment(cohort_size=3, time_scale=0.005, body="kinematic")
SMALL = {"robots": 2, "body": "kinematic", "time_scale": 0.002}


def of(first, second, invalid=0):
    """An evaluation with the given two tests, each of shape (T, R)."""
    experiment = dataclasses.replace(SHORT, cohort_size=np.shape(first)[1] + invalid)
    blank = np.zeros((len(first), 4, np.shape(first)[1]))
    tests = np.array([first, second], dtype=float)
    progress = BrainsInTime(experiment, "one", np.arange(len(first)), {}, invalid)
    return Evaluation(progress, tests, blank, blank)


def test_the_second_test_gives_the_shares_at_the_times_that_the_first_chose():
    one = of([[0.0, 0.5], [0.8, 0.2], [0.1, 0.9]], [[0.1, 0.4], [0.7, 0.1], [0.2, 1.0]])
    assert one.best.tolist() == [[0.1, 0.4], [0.7, 0.4], [0.7, 1.0]]
    row = markdown([one]).splitlines()[2]
    assert row.startswith("| one, all durations times 0.005 | 2 | 0.850 |")
    assert "| 0.600 |" in row
    assert "| 0.250 |" in row


def test_each_line_of_the_figure_is_what_its_label_says():
    one = of([[0.0, 0.5], [0.8, 0.2], [0.1, 0.9]], [[0.1, 0.4], [0.7, 0.1], [0.2, 1.0]])
    smell = np.arange(4)[None, :, None] + np.array([0.1, 0.2, 0.3])[:, None, None]
    one = dataclasses.replace(one, spread=smell + np.zeros(2), regret=10 + smell + np.zeros(2))
    above, middle, below = draw([one]).axes
    drawn = {line.get_label(): line.get_ydata() for line in above.lines}
    assert drawn["at its best time so far"] == pytest.approx([0.25, 0.55, 0.85])
    assert drawn["now"] == pytest.approx([0.25, 0.4, 0.6])
    for axis, first in ((middle, 0), (below, 10)):
        for number, (line, name) in enumerate(zip(axis.lines, module.SMELLS, strict=True)):
            assert line.get_label() == name
            assert line.get_ydata() == pytest.approx(first + number + np.array([0.1, 0.2, 0.3]))
    assert middle.get_ylabel() == "spread of ideas" and below.get_ylabel() == "regret of ideas"


def test_the_values_are_those_of_the_median_robot(monkeypatch):
    asked = []

    def brains(places):
        asked.append(places.tolist())
        return types.SimpleNamespace(controller=None)

    tests = np.full((2, 9, 3), 0.5)
    tests[1, -1] = 0.9, 0.45, 0.1
    one = of(*tests)
    progress = types.SimpleNamespace(experiment=SHORT, hours=np.arange(9.0), brains=brains)
    monkeypatch.setattr(module, "draw_values", lambda axis, brain, state: None)
    figure = draw_brain(dataclasses.replace(one, progress=progress))
    assert asked == [[[time], [1]] for time in module.SHOWN]
    rows = figure.axes[:: len(module.SMELLS)]
    assert [axis.get_ylabel().split()[0] for axis in rows] == [str(time) for time in module.SHOWN]


def test_a_reading_sets_body_kinematics_and_nose():
    study = LearningProgress(brains=("paper",), reading="plain")
    experiment = study.experiments()["paper"]
    assert (experiment.body, experiment.nose, experiment.nose_place) == (
        "kinematic", "printed", "centre"
    )  # fmt: skip
    assert experiment.kinematics.wall == "refuses"
    with pytest.raises(InputError, match="give either it or them"):
        dataclasses.replace(study, kinematics=("lag=0.08",)).experiments()
    with pytest.raises(InputError, match="the reading must be one of body, plain"):
        dataclasses.replace(study, reading="plane").experiments()


def test_luck_in_one_of_many_tests_is_not_counted_as_forgotten():
    random = np.random.default_rng(0)
    one = of(*(random.random((2, 9, 4000)) < 0.5))
    forgotten = (one.best[-1] - one.shares[-1]).mean()
    assert forgotten == pytest.approx(0, abs=0.03)


def test_robots_that_became_unstable_are_left_out_and_counted():
    tests = np.full((2, 9, 4), 0.5)
    tests[1, -1, 2] = np.nan
    assert "| 3 (and 1 invalid) |" in markdown([of(*tests)])
    assert "| 3 (and 3 invalid) |" in markdown([of(*tests, invalid=2)])


def test_a_study_has_a_page_and_figures_and_does_again_only_what_is_lost(tmp_path, here, listing):
    study = LearningProgress(**SMALL)
    page = conduct(study, tmp_path, here)
    assert page.markdown.startswith("| brain | robots | in the spot, at its best time |")
    tests = [f"test {seed} of {brain}" for brain in study.brains for seed in (0, 1)]
    assert [str(job) for job in here.jobs] == ["life of paper", "life of steady", *tests]
    whole = listing(tmp_path)
    kept = [f"brains-{name}.safetensors" for name in study.brains]
    kept += [f"test-{name}-{seed}.safetensors" for name in study.brains for seed in (0, 1)]
    figures = ("learning-progress", "values-paper", "values-steady")
    drawn = [f"{name}.{suffix}" for name in figures for suffix in ("png", "svg")]
    assert sorted(map(str, whole)) == sorted([*kept, *drawn, "learning-progress.md", "study.json"])
    for lost in ("brains-paper.safetensors", "test-steady-1.safetensors"):
        (tmp_path / lost).unlink()
    here.jobs.clear()
    assert conduct(study, tmp_path, here).markdown == page.markdown
    assert [str(job) for job in here.jobs] == ["life of paper", "test 1 of steady"]
    assert listing(tmp_path) == whole

    overview = page.figures["learning-progress"]
    assert [axis.get_title(loc="left") for axis in overview.axes[:2]] == ["paper", "steady"]
    for axis in overview.axes:
        low, high = axis.get_ylim()
        lines = [np.array(line.get_ydata()) for line in axis.lines]
        assert lines and all(((line >= low) & (line <= high)).all() for line in lines)
    assert len(page.figures["values-paper"].axes) == 4 * 4

    (tmp_path / "brains-paper.safetensors").write_bytes(b"not ours")
    here.jobs.clear()
    with pytest.raises(InputError, match="brains-paper.safetensors is damaged"):
        conduct(study, tmp_path, here)
    assert here.jobs == []


def test_a_stopped_study_continues_to_the_same_bytes(tmp_path, here, listing, stopped):
    line = [sys.executable, "-m", "musebot", "study", "learning-progress"]
    line += [str(tmp_path / "stopped"), "--brains", "steady", "--robots", "2", "--seed", "2"]
    line += ["--body", "kinematic", "--time-scale", "0.01", "--processes", "1"]
    status, said = stopped(line, tmp_path, "stopped/brains-*")
    assert status == 130, said
    assert "the same command continues from here" in said
    kept = [path.name for path in tmp_path.glob("stopped/*") if not is_draft(path)]
    assert sorted(kept) == ["brains-steady.safetensors", "study.json"]
    for out in ("stopped", "whole"):
        options = SMALL | {"time_scale": 0.01, "seed": 2}
        conduct(LearningProgress(("steady",), **options), tmp_path / out, here)
    assert listing(tmp_path / "stopped") == listing(tmp_path / "whole")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"brains": ("paper", "paper")}, "brains must be 1 to 4 different ones, got paper paper"),
        ({"brains": ()}, "brains must be 1 to 4 different ones"),
        ({"brains": ("clever",)}, "the brain must be one of"),
        ({"robots": 0}, "robots must be at least 1"),
        ({"kinematics": ("wall=eats",)}, "wall must be one of"),
    ],
)
def test_an_invalid_option_is_refused(options, words):
    with pytest.raises(InputError, match=words):
        LearningProgress(**(SMALL | options)).experiments()
