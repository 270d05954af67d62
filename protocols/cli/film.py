"""`musebot film`: films a stored brain or a policy."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from ..terminal import notice, say
from .options import argument, option

if TYPE_CHECKING:
    from ..pages.replay import Episode, Relived


@dataclasses.dataclass
class Film:
    """Film a robot in a test with its stored brain or agent, or a PPO policy in an episode."""

    task: str = option(
        dataclasses.MISSING,
        "life of the run, such as spot_finding; or the task of the policy",
        "TASK",
    )
    output: Path = option(dataclasses.MISSING, "film to write, an .mp4 or a small .gif", "FILE")
    out: Path | None = argument(
        "folder of a run, or a .safetensors file of a policy; without it the policy that musebot "
        "brings",
        "OUT",
        None,
    )
    proposer: str | None = option(
        None, "proposer of the robot: fixed, random, creative; only for a run (creative)", "NAME"
    )
    agent: str | None = option(
        None, "agent of the robot, as `musebot run --agent` takes it; only for a run", "AGENT"
    )
    robot: int | None = option(
        None, "number of the robot within its condition; only for a run (0)", "N"
    )
    phase: str | None = option(
        None,
        "the robot before (pre) or after (post) training, or both side by side (post)",
        choices=("pre", "post", "both"),
    )
    minute: float | None = option(
        None, "instead: the robot in its life, which is simulated again up to this minute", "X"
    )
    seconds: float = option(30.0, "length of the film in seconds (30)", "X")
    speed: float = option(4.0, "simulated seconds per second of the film (4)", "X")
    seed: int | None = option(
        None, "seed of the brain's noise, or of the start of a policy's episode (0)", "N"
    )

    def __call__(self) -> None:
        """Renders and writes the film, without a display, through EGL."""
        from ..pages import film

        film.film(self._episodes(), self.output, seconds=self.seconds, speed=self.speed)
        say(str(self.output))

    def _episodes(self) -> Iterator[Episode | Relived]:
        from ..agents.policy import Policy, policy_file
        from ..pages.replay import Episode, Relived, StoredRobot, robots_named
        from ..runs.manifest import same_physics
        from ..runs.run_files import read_run

        if self.minute is not None and (self.phase, self.seed) != (None, None):
            raise InputError("--minute films a life as it was: it excludes --phase and --seed")
        phases = ("pre", "post") if self.phase == "both" else (self.phase or "post",)
        seed, robot = self.seed or 0, self.robot or 0
        source = self.out or policy_file(self.task)
        if source.is_file() and source.suffix != ".safetensors":
            raise InputError(f"{source} is neither a run's folder nor a .safetensors file")
        if source.suffix != ".safetensors" or source.is_dir():
            brains = self.minute is None  # a life is simulated anew, from its beginning
            run = read_run(source, replay=brains, networks=brains)
            condition = robots_named(self.task, self.proposer, self.agent)
            if self.minute is None:
                for phase in phases:
                    yield StoredRobot(run, condition, robot, phase, seed).episode()
                return
            if not run.experiment.on_tensors and not same_physics(source):
                notice(f"{source} was simulated in another physics, in which lives differ")
            yield Relived.at(run, condition, robot, self.minute)
            return
        for name in ("proposer", "agent", "robot", "minute"):
            if getattr(self, name) is not None:
                raise InputError(f"{source} holds a policy: --{name} needs a run")
        policy = Policy.load(source, self.task)
        for phase in phases:
            yield Episode.of_policy(policy, phase, seed)
