"""Figures of populations: files of both kinds, whatever conditions there are."""

import dataclasses

import numpy as np
import pytest
from helpers import run_of_rows

from musebot.protocols.analysis import intervals
from musebot.protocols.analysis.behaviour import Behaviour, Stay
from musebot.protocols.pages import figures, style
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.run import Robot
from musebot.tasks.lives import LIVES

WA, SF = "wall_avoidance", "spot_finding"
WALLS_FIXED = Condition(WA, "fixed")
NAN = float("nan")
ALL = [Condition(t, p) for t in (WA, SF) for p in ("fixed", "random", "creative")]


def run_of(*conditions, robots=6, **fields):
    """A run in which some robots got worse, others are perfect, and events are at random."""
    rows = [
        Robot(
            c.life, c.proposer, 1, 0, i, 1.0, 2.0, *(((i - 3) / 3, "L < 0"), (1.0, "L = 1"))[i > 2]
        )
        for c in conditions
        for i in range(robots)
    ]
    run = run_of_rows(rows, Experiment(**fields))
    for condition, part in run.results.items():
        minutes = len(run.experiment.life_of(condition.life).steps_of_minutes())
        curves = np.random.default_rng(0).random((robots, minutes))
        run.results[condition] = dataclasses.replace(part, curves=curves)
    return run


def test_populations_are_drawn_for_any_conditions(check_figure, recwarn):
    for conditions, robots, scale in (
        (ALL, 6, 1),
        ([Condition(WA, "creative"), Condition(SF, "agents:mine")], 1, 1 / 400),
    ):
        run = run_of(*conditions, robots=robots, time_scale=scale)
        with style.styled():
            for draw in (figures.learning_curves, figures.categories, figures.abilities):
                check_figure(draw(run))
    assert not recwarn.list


def test_the_band_of_a_curve_is_the_interval_of_the_mean_of_valid_robots():
    run, shares = run_of(WALLS_FIXED, robots=7), np.array([0.1, 0.2, 0.2, 0.3, 0.4, 0.6])
    run.results[WALLS_FIXED].curves[:6] = shares[:, None]
    rows = run.results[WALLS_FIXED].robots
    rows[6] = dataclasses.replace(rows[6], category="invalid")  # is not in the mean
    with style.styled():
        (band,) = figures.learning_curves(run).axes[0].collections
    low, high = intervals.mean(shares, intervals.SHARE)
    assert low < 0.25 and high > 0.35
    heights = band.get_paths()[0].vertices[:, 1]
    assert {*np.round(heights, 6)} == {round(low, 6), round(high, 6)}


@pytest.mark.parametrize(
    ("task", "fields"),
    [
        (WA, {}),
        (WA, {"time_scale": 0.5}),
        ("spot_finding_walls", {}),
        (WA, {"time_scale": 0.07}),  # the first test and training share a minute
    ],
)
def test_no_point_of_a_curve_mixes_a_test_and_training(task, fields):
    schedule = Experiment(**fields).life_of(task)
    borders = [schedule.minutes_of("pre").stop, schedule.minutes_of("training").stop]
    minutes = schedule.minutes_of("post").stop
    run = run_of(condition := Condition(task, "fixed"), **fields)
    run.results[condition].curves[:] = np.repeat([0.8, 0.1, 0.3], np.diff([0, *borders, minutes]))
    with style.styled():
        axis = figures.learning_curves(run).axes[0]
    hours, means = axis.lines[0].get_data()
    assert {*np.round(means, 6)} == {0.8, 0.1, 0.3} and len(means) >= min(minutes, 20)
    # The marks are where the parts begin and end, and the curve's values lie between them.
    ends = np.cumsum([schedule.steps_of(part) for part in ("pre", "training", "post")]) / 36000
    assert [line.get_xdata()[0] for line in axis.lines[1:]] == pytest.approx(ends[:2])
    assert (hours[means > 0.5] < ends[0] + 1 / 60).all() and (hours[means < 0.5] > ends[0]).all()
    assert axis.child_axes[0].get_xticks() == pytest.approx((np.array([0, *ends[:2]]) + ends) / 2)


def test_the_points_of_a_curve_add_up_to_the_time_with_the_event():
    for scale in (0.97, 1 / 128, 1 / 400):
        steps = Experiment(time_scale=scale).life_of(WA).steps_of_minutes()
        assert len({*steps}) > 1 or len(steps) == 1  # the last minute is shorter than others
        run = run_of(WALLS_FIXED, time_scale=scale)
        with style.styled():
            line = figures.learning_curves(run).axes[0].lines[0]
        hours, means = line.get_data()
        edges = [0.0]
        for hour in hours:  # the middle of each point's stretch
            edges.append(2 * hour - edges[-1])
        total = run.results[WALLS_FIXED].curves.mean(axis=0) @ steps / 36000
        assert edges[-1] == pytest.approx(steps.sum() / 36000)
        assert means @ np.diff(edges) == pytest.approx(total)
        assert (line.get_marker() == "o") == (len(hours) == 1)  # a single point has no line


@pytest.mark.parametrize("name", LIVES)
def test_a_curve_marks_where_the_world_changes_in_lives_with_few_changes(name):
    run = run_of(Condition(name, "creative"), robots=2)
    worlds = [phase.world for phase in LIVES[name].phases for _ in range(int(phase.minutes))]
    changes = [minute for minute in range(1, len(worlds)) if worlds[minute] != worlds[minute - 1]]
    with style.styled():
        lines = figures.learning_curves(run).axes[0].lines
    marks = [line.get_xdata()[0] * 60 for line in lines if line.get_linewidth() == 0.5]
    assert marks == pytest.approx(changes if len(changes) <= 24 else [])


def test_a_histogram_has_a_scale_and_no_shares_where_nothing_was_measured():
    run, random = run_of(WALLS_FIXED, Condition(SF, "fixed"), *ALL[4:5]), ALL[4]
    for condition, ability, kind in ((WALLS_FIXED, NAN, "genius"), (random, 0.0, "L = 0")):
        rows = run.results[condition].robots
        rows[:] = [dataclasses.replace(one, learn_ability=ability, category=kind) for one in rows]
    with style.styled():
        empty, full, _, zeros = figures.abilities(run).axes
    assert not empty.texts and [text.get_text() for text in full.texts] == ["17%", "50%"]
    assert empty.get_title(loc="left") == "Wall avoidance\nfixed, 0 measured"
    assert full.get_title(loc="left") == "Spot finding\nfixed, 6 measured, mean 0.17"
    ((left, width),) = [(b.get_x(), b.get_width()) for b in zeros.patches if b.get_height() == 1]
    assert left + width / 2 == pytest.approx(0)


def test_stacked_categories_are_the_counts_of_the_robots():
    with style.styled():
        axis = figures.categories(run_of(WALLS_FIXED, robots=20)).axes[0]
    ours, paper = zip(*(bars.patches for bars in axis.containers), strict=True)
    assert [bar.get_width() for bar in ours] == pytest.approx([0.85, 0, 0, 0.15, 0])
    assert [500 * bar.get_width() for bar in paper] == pytest.approx([260, 12, 13, 19, 196])
    labels = [text.get_text() for text in axis.texts if text.get_text()]
    assert labels == ["85", "52", "15", "39"]  # category by category; small bars have none
    names = [text.get_text() for text in axis.get_yticklabels()]
    assert names == ["fixed, here", "fixed, paper"]


def test_spinning_is_drawn_on_the_left_before_and_on_the_right_after_training(check_figure):
    own = Condition("mine", "fixed")
    run = run_of(own, life=dataclasses.replace(LIVES[WA], name="mine", title="My walls"))
    shares = np.array([[0.1, 0.9], [0.3, 0.7], [0.2, 0.5]])
    with style.styled():
        figure = figures.spinning(run, Behaviour({own: shares}, {}))
        check_figure(figure)
    before, first, after, second = figure.axes[0].lines
    for marks, mean, column in ((before, first, 0), (after, second, 1)):
        assert marks.get_ydata() == pytest.approx(shares[:, column])
        assert mean.get_ydata() == pytest.approx([shares[:, column].mean()] * 2)
        for line in (marks, mean):
            assert (np.sign(line.get_xdata()) == 2 * column - 1).all()
    assert figure.axes[0].get_title(loc="left") == "My walls"
    for empty, full in ((before, after), figure.legends[0].get_lines()):
        assert empty.get_markerfacecolor() == "none" != full.get_markerfacecolor()


def test_following_the_contour_is_dashed_and_spinning_inside_is_solid(check_figure):
    minutes = np.array([[0.5, 0.1], [0.4, 0.2]])
    stay = Stay(np.array([True, True, False]), np.ones((3, 2)), np.zeros((3, 2)), minutes)
    with style.styled():
        figure = figures.stays({"random": stay})
        check_figure(figure)
    drawn = {line.get_linestyle(): [*line.get_ydata()] for line in figure.axes[0].lines}
    assert drawn == {"--": [0.5, 0.4], "-": [0.1, 0.2]}
    named = {line.get_label(): line.get_linestyle() for line in figure.legends[0].get_lines()}
    assert named == {"along the contour": "--", "spinning inside": "-"}
    assert figure.axes[0].get_title(loc="left") == "random, 2 robots"
