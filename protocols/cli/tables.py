"""`musebot tables`: prints the tables of a run."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from ..terminal import show_markdown
from .options import argument, option


@dataclasses.dataclass
class Tables:
    """Print the tables of OUT's robots next to the paper's, or to another run's."""

    out: Path = argument("folder of a run", "OUT")
    compare: Path | None = option(
        None, "folder of another run to compare with, cell by cell", "OTHER"
    )
    exact_classes: bool = option(
        False,
        "class robots by their exact L; otherwise L is rounded to two decimals first, as the "
        "paper's counts suggest",
    )

    def __call__(self) -> None:
        """Reads the runs and prints the tables; writes no file."""
        from ..analysis.comparison import compare_runs
        from ..pages import tables
        from ..runs.run_files import read_run
        from ..storage import resolved

        if self.compare:
            folders = resolved(self.out), resolved(self.compare)
            same = folders[0].name == folders[1].name
            ours, other = (
                dataclasses.replace(
                    read_run(folder, networks=False),
                    name=str(folder) if same else folder.name,
                    exact_classes=self.exact_classes,
                )
                for folder in folders
            )
            text = tables.comparison_markdown(ours, other, compare_runs(ours, other))
        else:
            run = read_run(self.out, networks=False)  # it may be kept without its brains
            text = tables.markdown(dataclasses.replace(run, exact_classes=self.exact_classes))
        show_markdown(text)
