"""Trained drivers that come with musebot: a creative robot, and a policy for each task."""

from __future__ import annotations

from pathlib import Path

_HERE = Path(__file__).parent

# The only robot of `musebot run robot --brain steady --robots 1 --life spot_finding --proposer
# creative`, not chosen among several.
ROBOT = _HERE / "robot"


# Policies that PPO trained, TASK.safetensors for each task of the suite:
# `musebot benchmark ppo OUT --task TASK`.
POLICIES = _HERE / "policies"
