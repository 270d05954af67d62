"""A series: runs that differ in one thing each, in a folder each of one, and the page on them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ..analysis.comparison import Side
from ..errors import InputError
from ..experiment.experiment import Plan, check_same, same_physics
from ..options import Workers
from ..simulation import engine
from ..storage import is_draft, write_atomically


def conduct(
    out: Path,
    wanted: Mapping[str, Plan],
    workers: Workers,
    page: str,
    report: Callable[[Path], str],
) -> None:
    """Lives what OUT does not hold yet, all runs together; writes and prints the page.

    Args:
      out: folder of the series; an unfinished one goes on.
      wanted: which lives, by the name of their folder in OUT.
      workers: who lives them.
      page: name of the file for the page.
      report: makes it from the finished folder.

    Raises:
      InputError: a number makes no sense, OUT cannot hold these runs or holds something else, or
        there are no such workers.
      Interrupted, RunError, OSError: see `engine.run`.
    """
    _check_folder(out, wanted, page)
    plans = {out / name: plan for name, plan in wanted.items()}
    engine.run_all(plans, workers.workforce())
    text = report(out)
    write_atomically(out / page, text.encode())
    print(text)


def _check_folder(out: Path, wanted: Mapping[str, Plan], page: str) -> None:
    if out.is_dir():
        known = {*wanted, page}
        if (out / page).is_dir() or not all(
            path.name in known or is_draft(path) for path in out.iterdir()
        ):
            raise InputError(f"{out} is not empty and holds no study of musebot's")
    for name, plan in wanted.items():
        run = out / name
        if (held := engine.open_directory(run)) is None:
            continue
        check_same(f"{run} holds an experiment", held.experiment, plan.experiment)
        for condition, robots in held.robots.items():
            if robots > (asked := plan.robots.get(condition, 0)):
                lives = " ".join(condition)
                raise InputError(f"{run} holds {robots} robots of {lives}, more than {asked}")
        if not same_physics(run / engine.PLAN):
            raise InputError(f"{run} was lived in another physics than this version's")


def read(out: Path, names: Sequence[str]) -> dict[str, Side]:
    """The finished runs of a series, by name.

    Raises:
      InputError: one is missing or damaged.
    """
    sides = {}
    for name in names:
        if not (out / name / engine.PLAN).is_file():
            raise InputError(f"{out} lacks the run {name}")
        sides[name] = Side(name, *engine.read_run(out / name))
    return sides
