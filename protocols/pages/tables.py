"""Tables 1 and 2 of a run next to the paper's or another run's, and verdicts on the claims."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from ..agents.names import short_name
from ..analysis import comparison, intervals
from ..analysis.behaviour import Behaviour
from ..analysis.claims import ClaimResult
from ..analysis.hypothesis_tests import ALPHA, same_classes
from ..analysis.paper_claims import judge_all
from ..analysis.paper_tables import Column, column, paper_column, row_names
from ..runs.conditions import Condition
from ..runs.experiment import Experiment, differing
from ..runs.learn_ability import total_variation
from ..runs.run import FEWEST_COMPARED, Run
from . import markdown as md

VARIATION = "total variation"
_NUMBERS = ("mean", "deviation", "post_share")  # of a column, listed after its shares
_INTERVALS = f"In brackets: 95 % intervals (Wilson for shares; for means and deviations {md.MEANS}"
_OF_PAPER = (
    "; Student's t for the paper's means, from its table). *By chance*: the total variation that "
    "two groups of these sizes exceed with a probability of 5 % if their robots do not differ."
)
_TOO_FEW = (
    f"A condition has fewer than {FEWEST_COMPARED} robots: nothing is tested or compared with the "
    "paper, and numbers have at most two digits."
)
_JOINT = (
    "Joint test that all columns of a table have the paper's shares of classes (sum of "
    "chi-squares, simulated null distribution)"
)
_CLAIMS = (
    "A claim holds if all its inequalities are significant. It does not hold if the opposite "
    "of one is significant. Otherwise it is undecided. The level is 5 %. p is two-sided; "
    "p against a claim is multiplied by the number of its inequalities (Bonferroni). *The "
    "paper's own numbers*: the verdict by the paper's tables, where they suffice for one."
)
_ROUNDED = " L is rounded to two decimals before it is classed (`--exact-classes` does not round)."


# ---- A run and the paper ----


def markdown(run: Run, behaviour: Behaviour | None = None, *, narrow: bool = False) -> str:
    """Returns the tables of a run, and the verdicts on the claims that it can test.

    `behaviour` is None if the robots were not observed. With `narrow`, each proposer or agent has a
    table of its own, as narrow as a telephone's screen.
    """
    parts = [f"{_TOO_FEW}\n"] if run.few else []
    for task in run.tasks():
        parts.append(f"### {md.escape(md.title(task, run.experiment))}\n")
        life = run.experiment.life_of(task)
        if not life.tested:
            parts.append("\n".join([*md.table(_shares_of_life(run, task)), ""]))
            continue
        names = ["", *row_names(life), *([] if run.few else [VARIATION])]
        columns = [_columns(run, Condition(task, proposer)) for proposer in run.proposers(task)]
        for group in columns if narrow else [itertools.chain(*columns)]:
            parts.append("\n".join([*md.table([*zip(names, *group, strict=True)]), ""]))
    if not run.few and (agreement := _joint_tests(run)):
        values = ", ".join(f"{name} p = {p:.4f}" for name, p in agreement.items())
        parts.append(f"{_JOINT}: {values}.\n")
    tested = any(run.experiment.life_of(task).tested for task in run.tasks())
    rounded = _ROUNDED if tested and not run.exact_classes else ""
    with_paper = not run.few and any(map(paper_column, run.conditions()))
    parts.append(f"{_INTERVALS}{_OF_PAPER if with_paper else ').'}{rounded}\n")
    if not run.few and (results := judge_all(run, behaviour)):
        parts.append(_claims(run.experiment, results))
    return "\n".join(parts)


def _shares_of_life(run: Run, task: str) -> list[list[str]]:
    """Returns the rows of a life without tests: proposer, robots, share of the time."""
    rows = [["", "robots", f"share of time {run.experiment.life_of(task).event}"]]
    for proposer in run.proposers(task):
        shares = run.life_shares(Condition(task, proposer))
        mean = md.number(float(shares.mean()) if len(shares) else math.nan, _form(run, ".4f"))
        span = intervals.mean(shares, intervals.SHARE)
        share = md.with_interval(mean, span, _form(run, ".3f"))
        rows.append([short_name(proposer), str(len(shares)), share])
    return rows


def _form(run: Run, usual: str) -> str:
    """Returns the format of a number: `usual`, or two digits for a run with few robots."""
    return ".2g" if run.few else usual


def _columns(run: Run, condition: Condition) -> list[list[str]]:
    """Returns a condition's column (head, then cells), and the paper's column if there is one."""
    ours, paper = column(run, condition), paper_column(condition)
    name = short_name(condition.proposer)
    if run.few:
        return [[name, *_cells(ours, ".2g", ".2g")]]
    if paper is None:
        return [[name, *_cells(ours), "-"]]
    distance, chance = _variation(ours, paper)
    variation = "-" if math.isnan(distance) else f"{distance:.2f} (by chance {chance:.2f})"
    return [
        [f"{name}, ours", *_cells(ours), variation],
        [f"{name}, paper", *_cells(paper), ""],
    ]


def _cells(column: Column, form: str = ".4f", ends: str = ".3f") -> list[str]:
    """Returns cells in the order of `row_names`; formats: `form` of values, `ends` of intervals."""
    summary = column.summary
    invalid = f" (and {summary.invalid} invalid)" if summary.invalid else ""
    shares = zip(summary.counts, summary.shares, column.shares, strict=True)
    numbers = [(getattr(summary, name), getattr(column, name)) for name in _NUMBERS]
    return [
        f"{summary.robots}{invalid}",
        *(md.with_interval(f"{n} ({share:.0%})", span, ".0%") for n, share, span in shares),
        *(md.with_interval(md.number(value, form), span, ends) for value, span in numbers),
    ]


def _variation(first: Column, second: Column) -> tuple[float, float]:
    """Returns the total variation of two columns, and its 95th percentile by chance; or NaNs."""
    if not first.summary.robots:
        return math.nan, math.nan
    summaries = first.summary, second.summary
    return total_variation(*summaries), intervals.chance_variation(*summaries)


def _joint_tests(run: Run) -> dict[str, float]:
    """Returns p of a joint test by table, and for both; empty without columns of the paper."""
    found: dict[str, list[tuple[tuple[int, ...], tuple[int, ...]]]] = {}
    for condition in run.conditions():
        ours, paper = run.summary(condition), paper_column(condition)
        if paper and ours.robots:
            counts = ours.counts, paper.summary.counts
            title = run.experiment.life_of(condition.life).title.lower()
            found.setdefault(title, []).append(counts)
    if len(found) > 1:
        found["both tables"] = [pair for pairs in found.values() for pair in pairs]
    return {name: same_classes(pairs) for name, pairs in found.items()}


# ---- The claims ----


def _claims(experiment: Experiment, results: Sequence[ClaimResult]) -> str:
    lines = ["### The claims of section 4", "", _CLAIMS, ""]
    if experiment.time_scale != 1:
        lines[2] += " Durations were shortened: these verdicts do not apply to the paper."
    left = [one for one in results if one.verdict == "not judged"]
    for task, title in md.TITLES.items():
        judged = [one for one in results if one.claim.task == task and one not in left]
        if judged:
            lines += [f"**{title}**", ""]
            lines += [f"- *{one.claim.says}* **{one.verdict}**: {one.words}" for one in judged]
            lines.append("")
    if left:
        why = "; ".join(dict.fromkeys(one.why.rstrip(".") for one in left))
        lines += [f"{len(left)} of {len(results)} claims are not judged: {why}.", ""]
    return "\n".join(lines)


# ---- Two runs ----


def comparison_markdown(ours: Run, other: Run, cells: Sequence[comparison.Cell]) -> str:
    """Returns Markdown on how two runs differ; `cells` come from `comparison.compare_runs`."""
    names = md.escape(ours.name), md.escape(other.name)
    found = [cell for cell in cells if cell.differs]
    lines = [f"**{names[0]}** compared with **{names[1]}**. {_differ_in(ours, other)}", ""]
    end = ":" if found else "."
    lines += [f"After Holm's correction {len(found)} of {len(cells)} cells differ{end}", ""]
    for cell in found:
        first, second, difference = _numbers(cell)
        name = f"{cell.condition.life}, {short_name(cell.condition.proposer)}: {cell.name}"
        lines.append(f"- {name} {first} against {second}, {difference}")
    lines += [""] * bool(found)
    for task in ours.tasks():
        if own := [cell for cell in cells if cell.condition.life == task]:
            rows = [["", "", *names, "difference", "p", "Holm"]]
            for cell in own:
                holm = md.probability(cell.corrected)
                p = md.probability(cell.p), f"**{holm}**" if cell.differs else holm
                rows.append([short_name(cell.condition.proposer), cell.name, *_numbers(cell), *p])
            lines += [f"### {md.escape(md.title(task, ours.experiment, other.experiment))}", ""]
            lines += [*md.table(rows, "llrrrrr"), ""]
    return "\n".join([*lines, _comparison_note(cells)])


def _differ_in(ours: Run, other: Run) -> str:
    fields = differing(ours.experiment, other.experiment)
    if not fields:
        return (
            "Their experiments are the same: they can differ only in the versions and machines "
            "that simulated them."
        )
    named = "; ".join(
        f"{name} ({', '.join(md.escape(md.field_text(name, value)) for value in pair)})"
        for name, pair in fields.items()
    )
    if len(fields) == 1:
        return f"Their experiments differ in {named}."
    several = f"{len(fields)} fields, so that no difference below can be attributed to one of them"
    return f"Their experiments differ in {several}: {named}."


def _numbers(cell: comparison.Cell) -> tuple[str, str, str]:
    """Returns our value, the other's, and the difference with its interval; a dash for NaN."""
    form, signed = (".1%", "+.1%") if cell.share else (".4f", "+.3f")
    difference = md.with_interval(md.number(cell.difference, signed), cell.interval, signed)
    return md.number(cell.ours, form), md.number(cell.other, form), difference


def _comparison_note(cells: Sequence[comparison.Cell]) -> str:
    paired = [cell.paired for cell in cells]
    pairing = "The robots are independent groups: their newborn brains differ"
    if any(paired):
        pairing = "Robots of the same number have the same newborn brain and are compared in pairs"
        pairing += "" if all(paired) else f" in {sum(paired)} of {len(cells)} cells"
    tests = ["McNemar's" if any(paired) else "", "Fisher's" if not all(paired) else ""]
    return (
        f"{pairing}. In brackets: the 95 % interval of the difference (Newcombe for shares "
        f"of robots; for the rest {md.MEANS}). *p*: two-sided, "
        f"{' or '.join(filter(None, tests))} exact test for shares, a permutation test for the "
        f"rest. *Holm*: p corrected over {len(cells)} cells, bold below {ALPHA:g}. A dash: too few "
        f"measured robots.{_left_out(cells)}\n"
    )


def _left_out(cells: Sequence[comparison.Cell]) -> str:
    """Returns in words how many pairs lack a value of one robot, empty if none does."""
    found = ", ".join(
        f"{cell.incomplete} ({cell.condition.life}, {short_name(cell.condition.proposer)})"
        for cell in cells
        if cell.name == "mean L" and cell.incomplete
    )
    words = (
        " Mean and deviation of L are those of pairs in which both robots have an L. Pairs left "
        "out because only one has it: "
    )
    return f"{words}{found}." if found else ""
