"""`musebot report`: writes the page of a run."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from ..terminal import say
from .options import argument, option


@dataclasses.dataclass
class Report:
    """Write a page about OUT with tables, claims, figures and films; this takes a few minutes."""

    out: Path = argument(
        "folder of a run; figures are written into its figures/, films into its films/", "OUT"
    )
    output: Path | None = option(None, "page to write (report.html in OUT)", "FILE")

    def __call__(self) -> None:
        """Simulates a sample of robots with their stored brains, and writes the page."""
        from ..pages import report
        from ..runs.local import prepare_process
        from ..runs.run_files import read_run

        run = read_run(self.out, replay=True)
        prepare_process()
        say(str(report.report(run, self.out, self.output)))
