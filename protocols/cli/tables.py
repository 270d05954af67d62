"""`musebot tables`: prints the tables of a run."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

from ..terminal import show_markdown
from .options import argument, option


@dataclasses.dataclass
class Tables:
    """Print the paper's tables, or another run's, next to those of OUT's robots."""

    out: Path = argument("folder of a run", "OUT")
    compare: Path | None = option(
        None, "folder of another run to compare with, cell by cell", "OTHER"
    )
    exact_classes: bool = option(
        False,
        "class robots by their exact L; otherwise L is rounded to two decimals first, as the "
        "paper's counts suggest",
    )
    json: bool = option(False, "print JSON instead of Markdown")

    def __call__(self) -> None:
        """Reads and prints; changes nothing."""
        from ..lives.run_files import read_run, run_names

        if self.compare:
            from ..analysis.comparison import compare_runs
            from ..pages.tables import comparison_json as as_json
            from ..pages.tables import comparison_markdown as markdown

            names = run_names((self.out, self.compare))
            runs = [read_run(*pair) for pair in zip((self.out, self.compare), names, strict=True)]
            runs = [dataclasses.replace(run, exact_classes=self.exact_classes) for run in runs]
            shown: tuple[Any, ...] = (*runs, compare_runs(*runs))
        else:
            from ..pages.tables import as_json, markdown

            run = read_run(self.out, needs="curves")  # it may be kept without its brains
            shown = (dataclasses.replace(run, exact_classes=self.exact_classes),)
        if self.json:
            print(json.dumps(as_json(*shown), indent=2))
        else:
            show_markdown(markdown(*shown))
