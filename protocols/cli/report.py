"""`musebot report`: writes the page of a run."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

from ..terminal import say
from .shared_options import Out, option


@dataclasses.dataclass
class ReportCommand:
    """Write one page about OUT with tables, claims, figures and films: takes a few minutes."""

    out: Out
    """folder of a run; figures are written into its figures/, films into its films/"""
    output: Annotated[Path | None, option("FILE", "report.html in OUT")] = None
    """page to write, an .html"""

    def __call__(self) -> None:
        """Puts a sample of the brains back into robots to measure what they do."""
        from ..lives.run_files import read_run
        from ..lives.worker import prepare_process
        from ..pages import report

        run = read_run(self.out, replay=True)
        prepare_process()
        say(str(report.report(run, self.out, self.output)))
