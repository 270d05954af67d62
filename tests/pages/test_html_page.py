"""The page of the report: its data, without a simulation."""

from __future__ import annotations

import dataclasses
import html
import re

import numpy as np
import pytest

from musebot import __version__
from musebot.protocols.agents.names import RECORDED_NAMES
from musebot.protocols.analysis.paper_claims import judge_all
from musebot.protocols.lives.conditions import Condition
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.run import ConditionResults, Robot, Run
from musebot.protocols.pages import tables
from musebot.protocols.pages.html_page import Medium, page


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
    assert all(f">{agent}</th>" in text for agent in agents)


def test_agents_have_their_short_names_and_colours_of_their_own():
    text = page(run_of(*(RECORDED_NAMES[name] for name in ("dqn", "hand_coded"))), [], [], [], "")
    heads = re.findall(r'<th scope="col" style="border-color:(#\w+)">(.*?)</th>', text)
    assert [name for _, name in heads] == ["dqn", "hand_coded"]
    assert len({shade for shade, _ in heads}) == 2


@pytest.mark.parametrize("exact", [False, True])
def test_the_page_says_under_its_tables_what_the_markdown_says(run, exact):
    run = dataclasses.replace(run, exact_classes=exact)
    text = html.unescape(re.sub("</?em>", "*", re.sub("</?code>", "`", page(run, [], [], [], ""))))
    found = tables.notes(run)
    assert len(found) == 2 and "Joint test" in found[0]
    for note in found:
        assert f'<p class="note">{note}</p>' in text and note in tables.markdown(run)
    assert ("rounded to two decimals" in text) == (not exact)


def test_the_page_is_named_after_its_run_and_says_which_version_made_it(run):
    text = page(dataclasses.replace(run, name="a & b"), [], [], [], "")
    for tag in ("title", "h1"):
        assert f"<{tag}>a &amp; b - Musebot report</{tag}>" in text
    assert f"musebot {__version__}<" in text
    assert "12 robots, seed 1" in text


def test_one_robot_is_no_robots():
    run = run_of("fixed")
    del next(iter(run.results.values())).robots[1:]
    assert "1 robot, seed 1" in page(run, [], [], [], "")


def test_figures_and_films_are_part_of_the_file(run, tmp_path):
    figure, film = tmp_path / "a.png", tmp_path / "b.mp4"
    figure.write_bytes(b"figure")
    film.write_bytes(b"film")
    media = (
        [Medium(figure, "A & B", "What it shows.", "A picture of A & B.")],
        [Medium(film, "", "a robot", "Film: a robot")],
    )
    text = page(run, [], *media, "")
    assert 'src="data:image/png;base64,ZmlndXJl" alt="A picture of A &amp; B."' in text
    assert 'src="data:video/mp4;base64,ZmlsbQ=="' in text
    assert '<video aria-label="Film: a robot" ' in text


def test_a_table_has_a_caption_and_heads_of_its_columns_and_rows(run):
    text = page(run, [], [], [], "")
    assert "<caption>Wall avoidance (table 1): ours, its interval, and <span" in text
    without = page(run_of("agents:mine"), [], [], [], "")
    assert "<caption>Wall avoidance (table 1): ours, its interval.</caption>" in without
    assert text.count('<th scope="col"') == 2
    assert text.count('<th scope="row">') == text.count("<tr>") - 1
    assert text.count("<th") == text.count("<th scope")


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
    figures = [Medium(tmp_path / f"{name}.png", f"Figure {name}", "", "") for name in "abc"]
    text = page(run, judge_all(run), figures, [], "No film.")
    marks = ("No film.", "Figure a", "<table>", "The claims", "Figure b", "Figure c")
    places = [text.index(mark) for mark in marks]
    assert places == sorted(places)
