"""`musebot figure`: draws the paper's two figures, and typical robots of a run."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ..errors import InputError
from ..terminal import say
from .shared_options import TASK_CHOICES, option


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
        from ..lives.run_files import read_run
        from ..lives.worker import prepare_process
        from ..pages import report, style

        style.check_output(self.output)
        run = None
        if (self.name == "typical") != (self.out is not None):
            raise InputError("typical needs the folder of a run, and only typical takes one")
        if self.out is not None:
            run = read_run(self.out, replay=True)
            prepare_process()
        report.draw(self.name, self.output, run, self.task)
        say(str(self.output))
