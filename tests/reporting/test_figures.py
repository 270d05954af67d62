"""Figures: files of both kinds, whatever conditions there are, legible on light and on dark."""

from __future__ import annotations

import dataclasses
import math
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from musebot.protocols.experiment.experiment import CohortKey, Experiment
from musebot.protocols.playback.observation import Behaviour, Stay
from musebot.protocols.reporting import figures
from musebot.protocols.reporting import robot_figures as portraits
from musebot.protocols.results.results import Results, Robot, collect
from musebot.protocols.simulation.cohort import Cohort
from musebot.tasks import make_batch

WA, SF = "wall_avoidance", "spot_finding"
EXPERIMENT = Experiment(time_scale=0.002, cohort_size=4)
NAN = float("nan")


def live(*conditions) -> Results:
    lives = []
    for condition in conditions:
        key = CohortKey(*condition, 0)
        cohort = Cohort(EXPERIMENT, key)
        cohort.advance(cohort.steps)
        lives.append((key, cohort.lives()))
    return collect(EXPERIMENT, lives)


@pytest.fixture(scope="module")
def lived() -> Results:
    """Real lives, whose rows are then made an example of every kind."""
    results = live((WA, "creative"), (SF, "creative"))
    kinds = {
        WA: [("genius", 0, 0, NAN), ("L = 1", 9, 0, 1.0), ("L < 0", 1, 3, -0.5)],
        SF: [("ignorant", 0, 0, NAN), ("0 < L < 1", 1, 3, 0.5), ("L < 0", 3, 1, -0.5)],
    }
    rows = []
    for task in (WA, SF):
        own = results.of(task, "creative")
        for row, (name, pre, post, ability) in zip(own, kinds[task], strict=False):
            rows.append(dataclasses.replace(
                row, category=name, t_pre_s=pre, t_post_s=post, learn_ability=ability
            ))  # fmt: skip
        rows.append(dataclasses.replace(own[3], category="invalid", learn_ability=NAN))
    return dataclasses.replace(results, robots=rows)


def some(*conditions, robots=6, minutes=160):
    random = np.random.default_rng(0)
    rows = [
        Robot(t, p, 1, 0, i, 1.0, 2.0, *(((i - 3) / 3, "L < 0") if i < 3 else (1.0, "L = 1")))
        for t, p in conditions
        for i in range(robots)
    ]
    curves = {f"{t}/{p}": random.random((robots, minutes)) for t, p in conditions}
    return Results(rows, curves, {})


ALL = [(t, p) for t in (WA, SF) for p in ("fixed", "random", "creative")]


@pytest.mark.parametrize(
    ("conditions", "robots", "minutes"),
    [(ALL, 6, 160), ([(WA, "creative")], 1, 1), ([(WA, "fixed"), (SF, "random")], 6, 2)],
)
def test_populations_are_drawn_whatever_conditions_there_are(
    conditions, robots, minutes, tmp_path, recwarn
):
    results = some(*conditions, robots=robots, minutes=minutes)
    with figures.styled():
        drawn = {
            "curves": figures.learning_curves(Experiment(), results),
            "categories": figures.categories(Experiment(), results),
            "abilities": figures.abilities(results),
        }
        for name, figure in drawn.items():
            check_files(figures.save(figure, tmp_path / "figures", name))
    assert not recwarn.list


def check_files(paths):
    assert [path.suffix for path in paths] == [".svg", ".png"]
    assert ElementTree.parse(paths[0]).getroot().tag.endswith("svg")
    picture = np.asarray(Image.open(paths[1]).convert("RGBA"))
    assert (picture[..., 3] == 0).mean() > 0.05  # light or dark shines through
    assert (picture[..., 3] > 200).mean() > 0.005  # and something is there


def test_a_curve_is_drawn_where_its_means_are():
    results = some((WA, "fixed"), minutes=160)
    results.curves[f"{WA}/fixed"][:] = np.repeat([0.8, 0.1, 0.3], [20, 120, 20])
    with figures.styled():
        axis = figures.learning_curves(Experiment(), results).axes[0]
    hours, means = axis.lines[0].get_data()
    assert set(np.round(means, 6)) == {0.8, 0.1, 0.3}
    assert (hours[means > 0.5] < 20 / 60).all()
    borders = [line.get_xdata()[0] for line in axis.lines[1:]]
    assert borders == pytest.approx([20 / 60, 140 / 60])


def test_an_invalid_robot_is_in_no_curve():
    results = some((WA, "fixed"), robots=2)
    results.robots[1] = dataclasses.replace(results.robots[1], category="invalid")
    results.curves[f"{WA}/fixed"][:] = [[0.25], [1.0]]
    with figures.styled():
        axis = figures.learning_curves(Experiment(), results).axes[0]
    assert axis.lines[0].get_ydata() == pytest.approx(0.25)


def test_stacked_categories_are_the_counts_of_the_robots():
    with figures.styled():
        axis = figures.categories(Experiment(), some((WA, "fixed"))).axes[0]
    ours, papers = axis.patches[:5], axis.patches[5:]
    assert [bar.get_width() for bar in ours] == pytest.approx([0.5, 0, 0, 0.5, 0])
    assert papers[0].get_width() == pytest.approx(260 / 500)
    assert papers[-1].get_x() + papers[-1].get_width() == pytest.approx(1)


def test_spinning_and_stays_are_drawn(tmp_path):
    stay = Stay(np.ones(3, bool), np.ones((3, 2)), np.zeros((3, 2)), np.array([[0, 0.5, NAN]]))
    behaviour = Behaviour({(WA, "fixed"): np.array([[0.1, 0.9], [0.3, 0.7]])}, {"random": stay})
    with figures.styled():
        figure = figures.spinning(behaviour)
        means = [line.get_ydata()[0] for line in figure.axes[0].lines if len(line.get_xdata()) == 2]
        check_files(figures.save(figure, tmp_path, "spinning"))
        check_files(figures.save(figures.stays(behaviour.stays), tmp_path, "stays"))
    assert {0.2, 0.8} <= {round(float(mean), 6) for mean in means}


# ---- Portraits ----


def test_sitters_are_an_example_of_every_kind(lived):
    kinds = {s.kind: s.robot for s in portraits.sitters(lived, WA)}
    assert kinds == {"genius": 0, "learner": 1, "spoiled": 2}
    kinds = {s.kind: s.robot for s in portraits.sitters(lived, SF)}
    assert kinds == {"ignorant": 0, "learner": 1, "spoiled": 2}


@pytest.mark.parametrize("task", [WA, SF])
def test_single_robots_are_drawn_before_and_after(task, lived, tmp_path):
    with figures.styled():
        for name in ("trajectories", "values"):
            figure = getattr(portraits, name)(EXPERIMENT, lived, task)
            assert isinstance(figure, Figure)
            assert len(figure.axes) == 6
            check_files(figures.save(figure, tmp_path, name))


def test_nobody_to_portray_is_no_figure(lived):
    rows = [dataclasses.replace(row, category="invalid") for row in lived.robots]
    nobody = dataclasses.replace(lived, robots=rows)
    assert portraits.sitters(nobody, WA) == []
    assert portraits.trajectories(EXPERIMENT, nobody, WA) is None
    assert portraits.values(EXPERIMENT, nobody, SF) is None
    assert portraits.ticks(EXPERIMENT, nobody) == 0


def test_trajectories_tick_as_often_as_announced(lived):
    ticks = []
    for task in (WA, SF):
        portraits.trajectories(EXPERIMENT, lived, task, lambda: ticks.append(1))
    assert len(ticks) == portraits.ticks(EXPERIMENT, lived) > 0


def test_situations_are_what_they_are_called():
    walls = portraits.situations(make_batch(WA, 1), WA)
    front, contact = {k: v[0] for k, v in walls.items()}, {k: v[4] for k, v in walls.items()}
    assert front["a wall 3 cm ahead"] == pytest.approx(1 / 1.03**10, rel=0.02)
    assert front["in the open"] < 0.05
    assert contact == {"in the open": 0, "a wall 3 cm ahead": 0, "pressed against it": -1}
    smells = {k: v[0] for k, v in portraits.situations(make_batch(SF, 1), SF).items()}
    assert smells["no smell"] == 0
    assert smells["spot 20 cm ahead"] == pytest.approx(3 / 4, rel=0.01)  # s' = 10 * 0.06 / 0.2
    assert smells["inside the spot"] == pytest.approx(10 / 11)


# ---- Legible ----


def luminance(shade):
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(shade)]
    return sum(w * c for w, c in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


@pytest.mark.parametrize("background", ["#ffffff", "#14171c"])
@pytest.mark.parametrize(
    "shade", [figures.INK, *map(figures.colour, ("fixed", "random", "creative"))]
)
def test_ink_and_colours_stand_out_from_light_and_dark(shade, background):
    first, second = sorted([luminance(shade), luminance(background)])
    assert (second + 0.05) / (first + 0.05) >= 3  # WCAG's bound for graphics and large text


def seen_without_red_or_green(shade, kind):
    """How a dichromat sees a colour: Viénot, Brettel and Mollon (1999), in linear RGB."""
    matrices = {
        "protanopia": [[0.11238, 0.88762, 0], [0.11238, 0.88762, 0], [0.00401, -0.00401, 1]],
        "deuteranopia": [[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]],
    }
    linear = np.array([((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(shade)])
    mixed = np.clip(np.array(matrices[kind]) @ linear, 0, 1)
    return 1.055 * mixed ** (1 / 2.4) - 0.055


@pytest.mark.parametrize("kind", ["protanopia", "deuteranopia"])
def test_proposers_look_different_to_the_colour_blind(kind):
    seen = [
        seen_without_red_or_green(figures.colour(p), kind) for p in ("fixed", "random", "creative")
    ]
    for first, second in ((0, 1), (0, 2), (1, 2)):
        assert math.dist(seen[first], seen[second]) > 0.2


def test_an_agent_unknown_to_the_paper_has_a_colour_of_its_own():
    known = {figures.colour(p) for p in ("fixed", "random", "creative")}
    assert figures.colour("ppo") not in known
    assert figures.colour("ppo") == figures.colour("ppo")
