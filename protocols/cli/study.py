"""`musebot study`: runs a study, or lists all."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any

import tyro

from ..compare import STUDIES, study_class
from ..lives.executor_choice import HERE, WorkersOption
from ..terminal import show_markdown
from .listing import ListCommand


@dataclasses.dataclass
class ListStudies:
    """List the studies; `musebot study NAME OUT` runs or continues one."""

    def __call__(self) -> None:
        """Prints a line for each study."""
        ListCommand("studies")()


ListStudies.__doc__ = f"{ListStudies.__doc__} NAME is one of {', '.join(STUDIES)}."


def study_command(name: str) -> type:
    """Returns the command that conducts a study, with the study's fields as options."""
    from ..compare.study import conduct

    cls = study_class(name)
    folder = tyro.conf.arg(metavar="OUT", help="folder of the study; an unfinished one continues")

    def call(self: Any) -> None:
        page = conduct(self.study, self.out, self.workers.executor())
        show_markdown(page.markdown)

    command = dataclasses.make_dataclass(
        "StudyCommand",
        [
            ("out", Annotated[Path, tyro.conf.Positional, folder]),
            ("study", Annotated[cls, tyro.conf.arg(name="")]),
            ("workers", WorkersOption, HERE),
        ],
        namespace={"__call__": call},
    )
    command.__doc__ = cls.__doc__
    return command
