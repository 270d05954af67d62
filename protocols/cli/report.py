"""`musebot report`: writes the page of a run, or one figure."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from ..progress import StepProgress
from ..terminal import say
from .options import argument, option

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
    task: str = option("wall_avoidance", "task of the architecture (wall_avoidance)", "TASK")

    def __call__(self) -> None:
        """Puts a sample of the brains back into robots to measure what they do.

        Raises:
          InputError: an option is invalid, or the run has no such robots; nothing was written.
        """
        from ..lives.run_files import read_run
        from ..lives.worker import prepare_process
        from ..pages import report, style

        if (self.out is None) != (self.figure in ("architecture", "robot")):
            raise InputError("a page and typical robots need OUT, the folder of a run; others none")
        if self.figure is None:
            assert self.out is not None
            run = read_run(self.out, replay=True)
            prepare_process()
            say(str(report.report(run, self.out, self.output)))
            return
        if self.output is None:
            raise InputError("--figure needs --output, the figure to write")
        style.check_output(self.output)
        with style.styled():
            style.write(self._figure(), self.output)
        say(str(self.output))

    def _figure(self) -> Figure:
        from ..lives.conditions import Condition
        from ..lives.run_files import read_run
        from ..lives.worker import prepare_process
        from ..pages import paper_figures, typical_robots
        from ..pages.measured_behaviour import with_brains

        if self.figure == "architecture":
            Condition(self.task, "creative")  # refuses another task
            return paper_figures.architecture(self.task)
        if self.figure == "robot":
            return paper_figures.robot()
        assert self.out is not None
        run = read_run(self.out, replay=True)
        prepare_process()
        if not with_brains(run):
            raise InputError(f"{self.out} has no typical robots: it holds no brains")
        with StepProgress("observing robots", typical_robots.ticks(run)) as progress:
            figure = typical_robots.draw(run, progress.advance)
        if figure is None:
            raise InputError(f"{self.out} has no typical robots: no stored brain spins or arrives")
        return figure
