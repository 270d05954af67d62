"""`musebot film`: films a stored brain or a policy."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from ..errors import InputError
from ..terminal import say
from .shared_options import PROPOSER_CHOICES, option

if TYPE_CHECKING:
    from ..pages.replay import Episode


@dataclasses.dataclass
class FilmCommand:
    """Film a robot in a test, driven by its stored brain or agent, or a policy in an episode."""

    task: Annotated[str, tyro.conf.arg(metavar="TASK")]
    """task of the run, wall_avoidance or spot_finding; or that of the policies (docs/tasks.md)"""
    output: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """film to write, an .mp4 or a small .gif"""
    out: Annotated[
        Path | None, tyro.conf.Positional, option("[OUT]", "the policy that musebot brings")
    ] = None
    """folder of a run, or a .safetensors file of policies (`musebot study ppo`)"""
    proposer: Annotated[str | None, option(PROPOSER_CHOICES, "creative")] = None
    """proposer of the robot; only for a run"""
    agent: Annotated[str | None, option("AGENT", "none")] = None
    """agent of the robot, as `musebot run --agent` takes it; only for a run"""
    robot: int = 0
    """number of the robot within its condition, or of the policy"""
    phase: Literal["pre", "post"] = "post"
    """show the robot before (pre) or after (post) training"""
    seconds: float = 30.0
    """length of the film in seconds"""
    speed: float = 4.0
    """simulated seconds per second of the film"""
    seed: int = 0
    """seed of the brain's noise, or of the start of a policy's episode"""

    def __call__(self) -> None:
        """Renders without a display, through EGL."""
        from ..pages import film

        film.film(self._episode(), self.output, seconds=self.seconds, speed=self.speed)
        say(str(self.output))

    def _episode(self) -> Episode:
        from ..agents.ppo import Policies, policy_file
        from ..lives.run_files import read_run
        from ..pages.replay import Episode, StoredRobot, robots_named

        source = self.out or policy_file(self.task)
        if source.is_file() and source.suffix != ".safetensors":
            raise InputError(f"{source} is neither a run's folder nor a .safetensors file")
        if source.suffix != ".safetensors" or source.is_dir():
            run = read_run(source, replay=True)
            condition = robots_named(self.task, self.proposer, self.agent)
            return StoredRobot(run, condition, self.robot, self.phase, self.seed).episode()
        if self.proposer or self.agent:
            raise InputError(f"{source} holds policies, which have no proposer and no agent")
        policies = Policies.load(source, self.task)
        return Episode.of_policy(policies, self.robot, self.phase, self.seed)
