"""The study of ways to propose actions: cells, runs, seats, contrasts and decisions."""

import dataclasses
import shutil
from typing import Any

import numpy as np
import pytest
from matplotlib.text import Annotation
from scipy import stats

from musebot.protocols import cli
from musebot.protocols.analysis.hypothesis_tests import linear_contrast
from musebot.protocols.errors import DamagedFileError
from musebot.protocols.experiment.experiment import differing
from musebot.protocols.studies.proposers import study as module
from musebot.protocols.studies.proposers.answers import (
    baseline,
    compared,
    contrasts,
    decisions,
    rule,
)
from musebot.protocols.studies.proposers.cells import IDEAS, PARTS, WAYS, Cell
from musebot.protocols.studies.proposers.page import Outcome, draw, page
from musebot.protocols.studies.proposers.seats import FOLDER, seats
from musebot.protocols.studies.proposers.study import Proposers
from musebot.protocols.studies.study import conduct

TINY = Proposers(robots=3, time_scale=0.004)
FEW = [Cell("connections", 25), Cell("uniform", 25), Cell("copies", 25), Cell("copies", 3, True)]


# ---- Cells ----


def test_the_first_part_has_the_46_cells_of_the_plan():
    cells = PARTS["first"].cells
    assert len({*cells}) == len(cells) == 46
    assert sum(cell.outside for cell in cells) == 18
    assert [cell.name for cell in cells if cell.way == "copies"] == [
        "copies-25-own", "copies-25-outside", "copies-3-outside", "copies-9-outside",
    ]  # fmt: skip


def test_every_cell_of_a_contrast_is_simulated():
    simulated = {cell: np.zeros(9) for cell in PARTS["first"].cells}
    assert {answer.value for answer in contrasts(simulated).values()} == {0.0}


def test_cells_differ_from_todays_way_in_what_they_say():
    plans = TINY.plans()
    today = plans["connections-25-own"].experiment
    assert today.brain.random_share == 0
    assert set(differing(today, plans["action-25-own"].experiment)) == {"brain.novelty"}
    assert set(differing(today, plans["untrained-3-outside"].experiment)) == {
        "brain.ideas", "brain.random_share", "brain.memory_learns",
    }  # fmt: skip
    assert [c.proposer for c in plans["uniform-9-own"].conditions] == ["random"]


def test_brains_are_tested_only_with_a_memory_that_they_have():
    pairs = {(a.way, b.way) for a, b in seats(PARTS["first"].cells)}
    ways = {way for way, _ in pairs}
    assert len(ways) == 10 and {(way, way) for way in ways} <= pairs
    assert ("untrained", "connections") in pairs  # its memory is the one at birth
    assert ("uniform", "connections") not in pairs and ("uniform", "untrained") in pairs
    assert ("connections", "learned") not in pairs and ("learned", "sobol") in pairs


# ---- Runs and seats ----


@pytest.fixture(scope="module")
def few():
    """The first part with four cells."""
    with pytest.MonkeyPatch.context() as patch:
        part = dataclasses.replace(PARTS["first"], cells=FEW)
        patch.setattr(module, "PARTS", {**PARTS, "first": part})
        yield


@pytest.fixture(scope="module")
def finished(few, tmp_path_factory, in_process):
    out = tmp_path_factory.mktemp("proposers") / "out"
    return out, conduct(TINY, out, in_process())


def test_the_page_has_each_cell_and_each_seat(finished):
    out, page = finished
    assert "4 of 4 cells are finished" in page.markdown
    assert len(list((out / FOLDER).iterdir())) == len(seats(FEW)) == 7
    assert "| uniform | - | - | 0." in page.markdown


def test_robots_csv_alone_makes_the_page(finished, tmp_path, listing, in_process):
    out, page = finished
    kept = tmp_path / "kept"
    for path in out.rglob("*"):
        if path.name not in ("brains.safetensors", "curves.npz") and path.is_file():
            (kept / path.relative_to(out)).parent.mkdir(parents=True, exist_ok=True)
            (kept / path.relative_to(out)).write_bytes(path.read_bytes())
    assert conduct(TINY, kept, in_process()).markdown == page.markdown
    assert not list(kept.rglob("brains.safetensors"))


def test_a_changed_row_is_noticed_without_the_other_files(finished, tmp_path):
    out, _ = finished
    path = out / "copies-25-own" / "robots.csv"
    content = path.read_bytes()
    try:
        path.write_bytes(content + b"\n")
        with pytest.raises(DamagedFileError, match="copies-25-own/robots.csv is not the file"):
            TINY.page(out)
    finally:
        path.write_bytes(content)


def test_an_unfinished_study_continues_to_the_same_page(finished, tmp_path, here):
    _, page = finished
    out = tmp_path / "out"

    def killed(jobs, progress):
        for number, job in enumerate(here(jobs, progress)):
            if number == 2:
                raise KeyboardInterrupt
            yield job

    with pytest.raises(KeyboardInterrupt):
        conduct(TINY, out, killed)
    assert "2 of 4 cells are finished" in TINY.page(out).markdown
    before = len(here.jobs)
    assert conduct(TINY, out, here).markdown == page.markdown
    assert len(here.jobs) - before < 10  # of four cohorts and seven seats


def test_brains_seated_under_their_own_way_repeat_their_networks(finished):
    """Under `uniform` the evaluation network alone decides: it must be the trained one."""
    out, _ = finished
    job = next(job for job in TINY._seats(out) if str(job) == "brains of uniform under uniform")
    first = job.path.read_bytes()
    job.path.unlink()
    assert job.run(lambda: False, lambda *_: None)
    assert job.path.read_bytes() == first


def test_a_seat_that_is_stopped_writes_nothing(finished, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(finished[0], out)
    job = TINY._seats(out)[0]
    job.path.unlink()
    assert not job.run(lambda: True, lambda *_: None)
    assert not job.path.exists()


def test_a_seat_of_other_brains_is_refused(finished):
    out, _ = finished
    first, second = TINY._seats(out)[:2]
    content = first.path.read_bytes()
    try:
        first.path.write_bytes(second.path.read_bytes())
        with pytest.raises(DamagedFileError, match="is another's: its test is"):
            TINY.check(out)
    finally:
        first.path.write_bytes(content)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--robots", "-1"], "robots must be at least 1, got -1"),
        (["--time-scale", "2"], "the time scale must lie in"),
    ],
)
def test_bad_input_is_one_sentence_and_writes_nothing(words, sentence, tmp_path, capsys):
    assert cli.main(["study", "proposers", str(tmp_path / "out"), *words]) == 2
    assert sentence in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


# ---- Answers ----


def shares(means, robots=200):
    """Robots whose shares scatter by 0.05 around the mean of each simulated cell."""
    random = np.random.default_rng(1)
    return {
        cell: np.clip(means(cell) + random.normal(0, 0.05, robots), 0, 1)
        for cell in PARTS["first"].cells
    }


def test_a_linear_contrast_of_two_groups_is_the_paired_t_test():
    random = np.random.default_rng(3)
    robots = random.normal(0, 1, 30)
    first, second = robots + random.normal(0.1, 0.3, 30), robots + random.normal(0, 0.3, 30)
    value, interval, p = linear_contrast([first, second], [1, -1])
    oracle: Any = stats.ttest_rel(first, second)
    assert value == pytest.approx(first.mean() - second.mean())
    assert p == pytest.approx(oracle.pvalue)
    assert interval == pytest.approx(tuple(oracle.confidence_interval(0.95)))
    second[3] = np.nan  # a robot without a value is left out
    kept = np.arange(30) != 3
    assert linear_contrast([first, second], [1, -1]) == linear_contrast(
        [first[kept], second[kept]], [1, -1]
    )


def test_a_contrast_of_groups_without_scatter_is_not_tested():
    value, interval, p = linear_contrast([np.ones(9), np.zeros(9)], [1, -1])
    assert value == 1 and np.isnan(p) and np.isnan(interval).all()
    nothing = np.full(9, np.nan)
    assert np.isnan(linear_contrast([nothing, nothing], [1, -1])[0])


def test_robots_that_were_born_alike_are_compared_in_pairs():
    """A small difference of robots that differ much: only pairs find it."""
    robots = np.random.default_rng(9).uniform(0.1, 0.8, 100)
    today = Cell("connections", 3)
    for way, found in (("sobol", True), ("uniform", False)):
        groups = {today: robots, Cell(way, 3): np.append(robots + 0.02, 0.5)}
        groups[Cell(way, 3)][:2] = np.nan, 0.1
        answer = compared(groups)[Cell(way, 3)]
        assert (answer.p < 0.001) is found
        assert (answer.value == pytest.approx(0.02, abs=0.01)) or not found


@pytest.mark.parametrize("effect", [0.0, 0.1])
def test_the_contrast_noise_is_the_effect_of_noise_and_of_nothing_else(effect):
    def mean(cell):
        noisy = cell.way not in ("copies", "untrained-copies", "main-idea-uniform", "uniform")
        return 0.5 + effect * noisy + 0.07 * cell.outside + 0.05 * (cell.ideas == 25)

    answers = contrasts(shares(mean))
    assert answers["noise"].value == pytest.approx(effect, abs=0.01)
    assert answers["memory"].value == pytest.approx(0, abs=0.01)
    assert answers["memory x noise"].value == pytest.approx(0, abs=0.02)
    assert answers["noise x ideas"].value == pytest.approx(0, abs=0.02)
    assert answers["noise"].sign == (effect > 0)


def test_every_contrast_is_the_plans_sum_of_means():
    """The table of docs/plans/proposers.md, with other means in every cell."""
    random = np.random.default_rng(8)
    means = {cell: random.uniform(0.2, 0.8) for cell in PARTS["first"].cells}
    groups = {cell: np.array([mean - 0.1, mean + 0.1]) for cell, mean in means.items()}

    def over_ideas(way, outside=False):
        return np.mean([means[Cell(way, ideas, outside).simulated] for ideas in IDEAS])

    noisy, copies, untrained, both = (
        over_ideas(way, True) for way in ("connections", "copies", "untrained", "untrained-copies")
    )
    today, main = over_ideas("connections"), over_ideas("with-main-idea")
    few, many = (
        means[Cell("connections", ideas, True)] - means[Cell("copies", ideas, True)]
        for ideas in (3, 25)
    )
    expected = {
        "memory": (noisy + copies - untrained - both) / 2,
        "noise": (noisy + untrained - copies - both) / 2,
        "memory x noise": (noisy - untrained) - (copies - both),
        "noise x outside ideas": (noisy - copies) - (today - over_ideas("copies")),
        "noise x ideas": few - many,
        "main idea included": main - today,
        "source of novelty": main - over_ideas("main-idea-uniform"),
        "place of the noise": today - over_ideas("action"),
        "memory against Sobol": today - over_ideas("sobol"),
        "memory against cross-entropy": today - over_ideas("cross-entropy"),
        "memory against the learned": today - over_ideas("learned"),
    }
    found = {name: answer.value for name, answer in contrasts(groups).items()}
    assert found == pytest.approx(expected)


def test_decisions_follow_the_plans_rule():
    assert decisions({}) == []
    unfinished = shares(lambda cell: 0.5)
    del unfinished[Cell("uniform", 9)]
    assert decisions(unfinished) == []
    noise = decisions(shares(lambda cell: 0.5 + 0.2 * ("copies" not in cell.way)))
    assert noise == [
        "Noise pays: yes.",
        "The memory pays: no.",
        *(f"At {n} ideas only distinct candidates pay: yes." for n in IDEAS),
    ]
    bad = ("untrained", "untrained-copies", "uniform")
    memory = decisions(shares(lambda cell: 0.5 - 0.2 * (cell.way in bad)))
    assert memory[:2] == ["Noise pays: no.", "The memory pays: yes."]


def test_cells_are_compared_with_todays_way_of_equal_ideas_and_outside_share():
    known = [Cell("connections", count, True) for count in (25, 3)]
    assert baseline(Cell("uniform", 3), known) == Cell("connections", 3, True)
    assert baseline(Cell("copies", 25, True), known) == Cell("connections", 25, True)
    assert baseline(Cell("action", 25), known) is None
    assert baseline(Cell("connections", 25, True), PARTS["first"].cells) is None
    answers = compared(shares(lambda cell: 0.7 if cell.way == "sobol" else 0.5))
    better = {cell.way for cell, answer in answers.items() if answer.sign > 0}
    assert better == {"sobol"} and len(answers) == 40


@pytest.mark.parametrize(("loss", "holds"), [(0.0, True), (0.1, False)])
def test_the_rule_must_not_be_worse_by_the_margin(loss, holds):
    random = np.random.default_rng(2)
    groups = {
        cell: random.normal(0.8 - loss * (cell.way == "success-rule"), 0.1, 300)
        for cell in PARTS["rule"].cells
    }
    assert all(test.p_for < 0.05 for test in rule(groups)) is holds
    assert len(rule(groups)) == 6
    assert rule({}) == []


def test_a_context_that_finds_what_is_not_smelt_is_noticed():
    random = np.random.default_rng(4)
    cells = PARTS["context"].cells
    assert [cell.way for cell in cells] == ["connections", "recurrent"]
    shares = [random.uniform(0.5, 0.9, 100) for _ in cells]
    shares[0][:20] = 0
    found = [Outcome(cell, "spot_finding", own) for cell, own in zip(cells, shares, strict=True)]
    text = page("context", PARTS["context"], "", found, {}).markdown
    row = next(line for line in text.splitlines() if line.startswith("| never in the spot"))
    assert "20 of 100 | 0 of 100" in row and row.split("|")[-2].strip() == "< 0.0001"
    alone = page("context", PARTS["context"], ", all durations times 0.5", found[:1], {}).markdown
    assert "### Recurrent context" not in alone and ", all durations times 0.5; 1 of 2" in alone


def test_the_figure_names_every_way_once_in_each_panel():
    axes = draw(shares(lambda cell: 0.5)).axes
    words = [[text.get_text() for text in axis.texts] for axis in axes]
    assert sorted(words[0]) == sorted(set(WAYS) - {"success-rule", "untrained-copies", "recurrent"})
    assert len(words[1]) == len({*words[1]}) == 6
    heights = sorted(t.xy[1] for t in axes[0].texts if isinstance(t, Annotation))
    assert np.diff(heights).min() > 0.04


def test_each_mean_is_drawn_at_its_number_of_ideas():
    found = shares(lambda cell: 0.2 + 0.006 * cell.ideas)
    for axis, outside in zip(draw(found).axes, (False, True), strict=True):
        lines = [line for line in axis.lines if line.get_marker() == "o"]
        ways = [way for way in WAYS if Cell(way, max(IDEAS), outside).simulated in found]
        ways = [way for way in ways if WAYS[way].mixes or not outside]
        assert len(lines) == len(ways) > 1
        for line, way in zip(lines, ways, strict=True):
            numbers = [Cell(way, int(x), outside).simulated.ideas for x in line.get_xdata()]
            assert line.get_ydata() == pytest.approx(0.2 + 0.006 * np.array(numbers), abs=0.02)
