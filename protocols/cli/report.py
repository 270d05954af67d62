"""`musebot report`: writes the page of a run, or one figure."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from ..errors import InputError
from ..terminal import say
from .options import argument, option


@dataclasses.dataclass
class Report:
    """Write one page about OUT with tables, claims, figures and films: takes a few minutes.

    With --figure only one figure is drawn: the paper's architecture of networks or its robot, which
    need no OUT, or the paths of typical robots of OUT: a spinner, one that follows the spot's
    contour, and a slow approacher.
    """

    out: Path | None = argument(
        "folder of a run; figures are written into its figures/, films into its films/",
        "OUT",
        None,
    )
    output: Path | None = option(None, "page (report.html in OUT), or figure, to write", "FILE")
    figure: str | None = option(
        None, "draw only this figure", choices=("architecture", "robot", "typical")
    )
    task: str | None = option(None, "task of the architecture (wall_avoidance)", "TASK")

    def __call__(self) -> None:
        """Puts a sample of the brains back into robots to measure what they do.

        Raises:
          InputError: an option is invalid, or the run has no such robots; nothing was written.
        """
        from ..lives.local import prepare_process
        from ..lives.run_files import read_run
        from ..pages import report

        if self.figure is None and self.out is None:
            raise InputError("a page needs OUT, the folder of a run")
        if self.figure is not None and self.output is None:
            raise InputError("--figure needs --output, the figure to write")
        run = None if self.out is None else read_run(self.out, replay=True)
        prepare_process()
        if self.figure is not None and self.output is not None:
            report.draw(self.figure, self.output, run, self.task)
            say(str(self.output))
        elif run is not None and self.out is not None:
            say(str(report.report(run, self.out, self.output)))
