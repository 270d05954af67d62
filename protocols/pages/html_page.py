"""Renders the report with `report.html.jinja`, as one HTML file that needs no other file."""

from __future__ import annotations

import base64
import dataclasses
import mimetypes
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import jinja2
from markupsafe import Markup, escape

from ... import __version__
from ..agents.names import short_name
from ..analysis.claims import ClaimResult
from ..analysis.paper_tables import column, paper_column, row_names
from ..lives.conditions import Condition
from ..lives.run import Run
from ..terminal import printable
from . import labels, tables
from .figures import looks_of

_TEMPLATE = Path(__file__).with_name("report.html.jinja")
_COLUMNS = 3  # conditions next to each other, on the screen of a telephone


@dataclasses.dataclass(frozen=True)
class Medium:
    """A figure or a film of the page.

    Attributes:
      path: File of the figure or film, a .png or an .mp4.
      title: Heading above the figure or film; empty for none.
      caption: Text below the figure or film that says what it shows.
      alt: Sentence that replaces the figure or film for readers who cannot see it.
    """

    path: Path
    title: str
    caption: str
    alt: str

    @property
    def uri(self) -> str:
        """The content of the file as a data URI."""
        kind, _ = mimetypes.guess_type(self.path.name)
        return f"data:{kind};base64,{base64.b64encode(self.path.read_bytes()).decode()}"


@dataclasses.dataclass(frozen=True)
class PageCell:
    """A cell of a table on the page: our value, its interval, and the paper's value."""

    ours: str
    interval: str
    paper: str


@dataclasses.dataclass(frozen=True)
class Table:
    """A table of the page.

    Attributes:
      columns: For each column, a pair of its name and its colour.
      rows: For each row, a pair of its name and its cells.
    """

    columns: Sequence[tuple[str, str]]
    rows: Sequence[tuple[str, Sequence[PageCell]]]

    @property
    def has_paper(self) -> bool:
        """Whether a cell has the paper's value."""
        return any(cell.paper for _, cells in self.rows for cell in cells)


def page(
    run: Run,
    results: Sequence[ClaimResult],
    figures: Sequence[Medium],
    films: Sequence[Medium],
    missing: str,
) -> str:
    """Returns the report page as HTML.

    Args:
      run: The run.
      results: Verdicts on the claims; if empty, the page has no section of claims.
      figures: Figures in the order on the page; the first, of the learning curves, and the films
        are above the tables.
      films: Films in the order on the page.
      missing: Sentence about missing films; empty for none.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATE.parent),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["emphasis"] = _emphasis
    experiment = run.experiment
    return environment.get_template(_TEMPLATE.name).render(
        name=printable(run.name),
        facts=_facts(run),
        made=f"musebot {__version__}",
        tables={labels.title(t, experiment): [*_tables(run, t)] for t in run.tasks()},
        tables_notes=tables.notes(run),
        claims=tables.judged_claims(results),
        not_judged=tables.not_judged(results),
        claims_note=tables.claims_note(experiment) if results else "",
        first_figures=figures[:1],
        figures=figures[1:],
        films=films,
        missing=missing,
    )


def _facts(run: Run) -> list[str]:
    simulators = {"mujoco": "in MuJoCo", "kinematic": "in the kinematic simulator"}
    robots = sum(len(run.robots(condition)) for condition in run.conditions())
    count = f"{robots} robot" if robots == 1 else f"{robots} robots"
    facts = [simulators[run.experiment.body], count, f"seed {run.experiment.seed}"]
    return [*facts, *labels.particulars(run.experiment)]


def _tables(run: Run, task: str) -> Iterator[Table]:
    """Yields the tables of a task: one, or several if the task has many conditions."""
    proposers, look = run.proposers(task), looks_of(run)
    for first in range(0, len(proposers), _COLUMNS):
        group = proposers[first : first + _COLUMNS]
        columns = [_column(run, Condition(task, proposer)) for proposer in group]
        names = [*row_names(task), tables.VARIATION]
        rows = [*zip(names, zip(*columns, strict=True), strict=True)]
        yield Table([(short_name(name), look[name].colour) for name in group], rows)


def _column(run: Run, condition: Condition) -> list[PageCell]:
    ours, paper = column(run, condition), paper_column(run.experiment, condition)
    own = [*tables.cells(ours), tables.variation_cell(ours, paper)]
    theirs = [value for value, _ in tables.cells(paper)] if paper else [""] * (len(own) - 1)
    return [PageCell(*cell, other) for cell, other in zip(own, [*theirs, ""], strict=True)]


def _emphasis(text: str) -> Markup:
    """Returns the text, escaped for HTML, with *words* emphasised and `words` as code."""
    marked = re.sub(r"\*(.+?)\*", r"<em>\1</em>", str(escape(text)))
    return Markup(re.sub(r"`(.+?)`", r"<code>\1</code>", marked))
