"""`musebot demo`: a first look at what the robots learn."""

from __future__ import annotations

import dataclasses

from ..lives.executor_choice import HERE, WorkersOption
from ..terminal import show_markdown
from .shared_options import Out


@dataclasses.dataclass
class DemoCommand:
    """Film a trained robot, let a few learn, and film the best and a typical one in each task.

    The first film is ready within a minute, the rest in about five minutes on two idle cores. Can
    be stopped and continued. OUT/paper and OUT/steady are ordinary runs: other commands, such as
    `musebot report`, accept them.
    """

    out: Out
    """folder for the films and the two runs; an unfinished demonstration continues"""
    robots: int = 6
    """number of robots with each of the two brains in each task"""
    time_scale: float = 0.5
    """factor on every duration of the paper, in (0, 1]"""
    seed: int = 1
    """seed from which all random streams derive"""
    workers: WorkersOption = HERE

    def __call__(self) -> None:
        """Films, simulates, films again, and prints what was seen."""
        from ..compare.demonstration import Demo
        from ..compare.study import conduct

        demo = Demo(self.robots, self.time_scale, self.seed)
        text = conduct(demo, self.out, self.workers.executor()).markdown
        show_markdown(text.replace("OUT/", f"{self.out}/"))
