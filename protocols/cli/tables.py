"""`musebot tables`: prints the tables of a run."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Any

from ..terminal import show_markdown
from .shared_options import Out, option


@dataclasses.dataclass
class TablesCommand:
    """Print the paper's tables, or another run's, next to those of OUT's robots."""

    out: Out
    """folder of a run"""
    compare: Annotated[Path | None, option("OTHER", "the paper")] = None
    """folder of another run to compare with, cell by cell"""
    exact_classes: bool = False
    """class exact L; otherwise L is rounded to two decimals first, as the paper's counts suggest"""
    json: bool = False
    """print JSON instead of Markdown"""

    def __call__(self) -> None:
        """Reads and prints; changes nothing."""
        from ..lives.run_files import read_run, run_names

        if self.compare:
            from ..analysis.comparison import compare_runs
            from ..pages import comparison_tables as reporting

            names = run_names((self.out, self.compare))
            pairs = zip((self.out, self.compare), names, strict=True)
            runs = [read_run(*pair, networks=False) for pair in pairs]
            runs = [dataclasses.replace(run, exact_classes=self.exact_classes) for run in runs]
            shown: tuple[Any, ...] = (*runs, compare_runs(*runs))
        else:
            from ..pages import tables as reporting

            run = read_run(self.out, networks=False)  # it may be kept without its brains
            shown = (dataclasses.replace(run, exact_classes=self.exact_classes),)
        if self.json:
            print(json.dumps(reporting.as_json(*shown), indent=2))
        else:
            show_markdown(reporting.markdown(*shown))
