"""`musebot explore`: opens a window on a task."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from .options import argument, option

if TYPE_CHECKING:
    from ..pages.viewer import Driver


@dataclasses.dataclass
class Explore:
    """Open a window on a robot in a task; a policy, a brain, arrow keys or chance drive it."""

    task: str = argument(
        "task that `musebot list tasks` prints; with --out wall_avoidance or spot_finding "
        "(wall_avoidance)",
        "TASK",
        "wall_avoidance",
    )
    out: Path | None = option(None, "folder of a run to take a brain from", "OUT")
    policy: Path | None = option(
        None, "file of PPO's policy for this task (the policy that musebot brings)", "FILE"
    )
    keys: bool = option(False, "drive with the arrow keys")
    random: bool = option(False, "drive at random")
    proposer: str | None = option(
        None, "proposer of the robot: fixed, random, creative; only for a run (creative)", "NAME"
    )
    agent: str | None = option(None, "agent of the robot; only for a run", "AGENT")
    robot: int | None = option(
        None, "number of the robot within its condition; only for a run (0)", "N"
    )
    phase: str | None = option(
        None, "the robot before (pre) or after (post) training (post)", choices=("pre", "post")
    )

    def __call__(self) -> None:
        """Opens the window, which needs a display."""
        from ..pages import viewer

        if sum((self.out is not None, self.policy is not None, self.keys, self.random)) > 1:
            raise InputError("only one of --out, --policy, --keys and --random can drive")
        for name in ("proposer", "agent", "robot"):
            if getattr(self, name) is not None and not self.out:
                raise InputError(f"--{name} needs --out, the run to take a brain from")
        if self.phase is not None and (self.keys or self.random):
            raise InputError("--phase chooses a brain or a policy, got --keys or --random")
        viewer.explore(self.task, self._driver())

    def _driver(self) -> Driver | None:
        """Returns the driver; None for random motor values."""
        from ..agents.policy import Policy, policy_file
        from ..pages.replay import StoredRobot, robots_named
        from ..pages.viewer import ArrowKeys, Driver
        from ..runs.run_files import read_run

        if self.random:
            return None
        if self.keys:
            return Driver("arrow keys", ArrowKeys())
        phase = self.phase or "post"
        if self.out:
            run = read_run(self.out, replay=True)
            condition = robots_named(self.task, self.proposer, self.agent)
            return Driver.of_robot(StoredRobot(run, condition, self.robot or 0, phase))
        policy = Policy.load(self.policy or policy_file(self.task), self.task)
        return Driver.of_policy(policy, phase)
