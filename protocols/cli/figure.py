"""`musebot figure`: draws the paper's two figures, and typical robots of a run."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from ..errors import InputError
from ..terminal import StepProgress, say
from .shared_options import TASK_CHOICES, option

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass
class FigureCommand:
    """Draw a figure of the paper (architecture or robot), or typical robots of a run.

    Typical robots are a spinner, one that follows the spot's contour, and a slow approacher.
    """

    name: Annotated[
        Literal["architecture", "robot", "typical"],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="NAME"),
    ]
    """architecture: the networks; robot: body and sensors; typical: paths, from OUT's brains"""
    output: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """figure to write, an .svg or .png"""
    out: Annotated[Path | None, tyro.conf.Positional, option("[OUT]", "none")] = None
    """folder of a run; only for typical"""
    task: Annotated[str | None, option(TASK_CHOICES, "wall_avoidance")] = None
    """task of the brain that is drawn; only for architecture"""

    def __call__(self) -> None:
        """Draws without a display.

        Raises:
          InputError: an option is invalid, or the run has no such robots; nothing was written.
        """
        from ..lives.conditions import PAPER_TASKS
        from ..pages import style

        style.check_output(self.output)
        if (self.name == "typical") != (self.out is not None):
            raise InputError("typical needs the folder of a run, and only typical takes one")
        if self.task is not None and self.name != "architecture":
            raise InputError(f"--task chooses the architecture, not {self.name}")
        if self.task not in (None, *PAPER_TASKS):
            raise InputError(f"the task must be one of {', '.join(PAPER_TASKS)}, got {self.task!r}")
        with style.styled():
            style.write(self._figure(), self.output)
        say(str(self.output))

    def _figure(self) -> Figure:
        from ..lives.run_files import read_run
        from ..lives.worker import prepare_process
        from ..pages import paper_figures, typical_robots
        from ..pages.measured_behaviour import with_brains

        if self.name == "architecture":
            return paper_figures.architecture(self.task or "wall_avoidance")
        if self.name == "robot":
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
