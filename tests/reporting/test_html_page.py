"""The page of the report: its data, without a simulation."""

from __future__ import annotations

import numpy as np
import pytest

from musebot.protocols.analysis.paper_claims import judge_all
from musebot.protocols.experiment.conditions import Condition
from musebot.protocols.experiment.experiment import Experiment
from musebot.protocols.reporting import tables
from musebot.protocols.reporting.html_page import Medium, page
from musebot.protocols.results.results import ConditionResults, Robot
from musebot.protocols.results.run import Run


def run_of(*proposers):
    results = {}
    for proposer in proposers:
        condition = Condition("wall_avoidance", proposer)
        rows = [
            Robot(condition.task, proposer, 1, 0, i, 6.0, 2.0, 0.5, "0 < L < 1") for i in range(6)
        ]
        results[condition] = ConditionResults(rows, np.zeros((6, 1)), {"before": {}, "after": {}})
    return Run("run", Experiment(), results)


@pytest.fixture(scope="module")
def run():
    return run_of("fixed", "creative")


def test_text_is_escaped_and_emphasised(run):
    text = page(run, judge_all(run), [], [], "No <film>.")
    assert "0 &lt; L &lt; 1" in text and "0 < L < 1" not in text
    assert "No &lt;film&gt;." in text
    assert "<em>By chance</em>" in text and "<em>The paper&#39;s own numbers</em>" in text


def test_a_cell_has_our_value_its_interval_and_the_papers(run):
    text = page(run, [], [], [], "")
    assert '<td>6<small class="paper">500</small></td>' in text
    assert '<td>6 (100%)<small>[61%, 100%]</small><small class="paper">12 (2%)</small></td>' in text


def test_without_results_there_is_no_section_of_claims(run):
    assert "The claims of section 4" not in page(run, [], [], [], "")
    assert "The claims of section 4" in page(run, judge_all(run), [], [], "")


def test_many_conditions_are_several_tables():
    agents = [f"agents:number_{i}" for i in range(4)]
    text = page(run_of("fixed", *agents), [], [], [], "")
    assert text.count("<table>") == 2
    assert all(agent in text for agent in agents)


def test_figures_and_films_are_part_of_the_file(run, tmp_path):
    figure, film = tmp_path / "a.png", tmp_path / "b.mp4"
    figure.write_bytes(b"figure")
    film.write_bytes(b"film")
    media = [Medium(figure, "A & B", "What it shows.")], [Medium(film, "", "a robot")]
    text = page(run, [], *media, "")
    assert 'src="data:image/png;base64,ZmlndXJl" alt="A &amp; B"' in text
    assert 'src="data:video/mp4;base64,ZmlsbQ=="' in text


def test_claims_that_a_run_cannot_judge_are_one_line():
    run = run_of("fixed", "random", "creative")
    results = judge_all(run)
    judged = [one for one in results if one.verdict != "not judged"]
    assert 0 < len(judged) < len(results)
    for text in (page(run, results, [], [], ""), tables.markdown(run)):
        assert text.count("are not judged") == text.count("not judged") == 1
        assert f"{len(results) - len(judged)} of {len(results)} claims are not judged" in text
        assert text.count("no robots of spot_finding, fixed") == 1
        assert "Spot finding (table 2)" not in text  # none of its claims is judged


def test_films_and_learning_curves_come_before_the_tables(run, tmp_path):
    for name in "abc":
        (tmp_path / f"{name}.png").write_bytes(name.encode())
    figures = [Medium(tmp_path / f"{name}.png", f"Figure {name}", "") for name in "abc"]
    text = page(run, judge_all(run), figures, [], "No film.")
    marks = ("No film.", "Figure a", "<table>", "The claims", "Figure b", "Figure c")
    places = [text.index(mark) for mark in marks]
    assert places == sorted(places)
