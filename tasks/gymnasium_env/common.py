"""What one robot and a batch of robots have in common: spaces, `info`, pictures."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import mujoco
import numpy as np

from ...gymnasium_registration import GYMNASIUM_TASKS
from ..arena import TaskDefinition
from ..episode import CONTROL_TIMESTEP, Episode, check_keywords, whole_number
from ..lives import LIVES
from ..rules import Rules
from ..suite import LIFE_DOMAIN, TASKS, life_definition, task_definition

FPS = round(1 / CONTROL_TIMESTEP)

INFO: Mapping[str, str] = {
    "position": "x, y of the robot's centre in [m], shape (2,)",
    "heading": "direction of the robot's front in [rad], 0 along x, counterclockwise",
    "spot": "x, y of the spot's centre in [m], shape (2,)",
    "contact": "whether the rim is in contact with a wall or an obstacle",
    "in_spot": "whether the front of the rim is inside the spot",
    "contact_steps": "number of control steps of this episode that ended in contact",
    "in_spot_steps": "number of control steps of this episode that ended in the spot",
}
PICTURE: Mapping[str, Any] = {"camera": "overhead", "width": 480, "height": 320}


def spaces(rules: Rules, limit: float) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    """Returns the spaces of a robot's observations, shape (S,), and actions, shape (2,)."""
    low, high = (end.astype(np.float32) for end in rules.bounds())
    return gymnasium.spaces.Box(low, high), gymnasium.spaces.Box(-limit, limit, (2,))


def task_name(task: Any) -> str:
    """Returns the name of a task, given as its name, its Gymnasium id or MODULE:NAME.

    The module is imported if this process does not know the task. Raises ImportError where there is
    no such module, ValueError where there is no such task.
    """
    module, _, name = task.rpartition(":") if isinstance(task, str) else ("", "", task)
    if module or name != task:
        if not all(part.isidentifier() for part in module.split(".")):
            raise ValueError(f"task must be NAME or MODULE:NAME, got {task!r:.200}")
        if _plain(name) not in TASKS:  # in a process that does not know it yet
            importlib.import_module(module)
        if _plain(name) not in TASKS:
            raise ValueError(f"the module {module} registers no task {name!r:.100}")
    return task_definition(_plain(name)).name


def _plain(name: Any) -> Any:
    return GYMNASIUM_TASKS.get(name.removeprefix("musebot/"), name) if type(name) is str else name


# Further entries of `info` in a life.
LIFE_INFO: Mapping[str, str] = {
    "phase": "number of the phase in which the next step is, from 0",
    "learning": "whether the robot learns in this phase; False in a test",
    "placed": "whether the robot was placed after this step",
    "changed": "whether the world changed after this step",
    "reached": "whether the measured event held: in the spot, driving or, among walls, in contact",
}


def checked_task(task: Any, kwargs: dict[str, Any]) -> TaskDefinition:
    """Returns the definition of a task, see `task_name`; "life" needs the keyword `life`.

    Raises TypeError for an unknown keyword.
    """
    is_life = task == LIFE_DOMAIN
    if is_life and "life" not in kwargs:
        raise TypeError(f"life must be given: one of {sorted(LIVES)}, FILE.toml, or a Life")
    definition = (
        life_definition(kwargs.pop("life")) if is_life else task_definition(task_name(task))
    )
    check_keywords(f"task {definition.name!r}", kwargs, [*definition.keywords, *PICTURE])
    return definition


def life_info(episode: Episode, step: int, reached: Any) -> dict[str, Any]:
    """Returns the entries of `LIFE_INFO` after `step` control steps of a life."""
    leg = episode.leg_of(step)
    begins = leg.start == step
    return {
        "phase": leg.number,
        "learning": leg.phase.learning,
        "placed": begins and leg.phase.robot is not None,
        "changed": begins and leg.changes_world,
        "reached": reached,
    }


def check_render_mode(render_mode: Any, modes: Sequence[str]) -> None:
    """Raises ValueError unless `render_mode` is None or one of `modes`."""
    if render_mode not in (None, *modes):
        raise ValueError(f"render_mode must be one of {list(modes)} or None, got {render_mode!r}")


def picture_of(model: mujoco.MjModel, camera: Any, width: Any, height: Any) -> dict[str, Any]:
    """Returns the keywords of dm_control's `render`: size in pixels, and camera.

    Raises ValueError where there is no such camera, or a size is not whole and at least 1.
    """
    cameras = [model.camera(number).name for number in range(model.ncam)]
    if camera not in cameras:
        raise ValueError(f"camera must be one of {cameras}, got {camera!r}")
    size = {"height": whole_number("height", height, 1), "width": whole_number("width", width, 1)}
    return {**size, "camera_id": camera}


def final_info(observations: np.ndarray, mask: np.ndarray, info: dict[str, Any]) -> dict[str, Any]:
    """Returns Gymnasium's dictionary of the last observations of the episodes that ended."""
    final = np.full(len(observations), None, dtype=object)
    for robot in np.flatnonzero(mask):
        final[robot] = observations[robot]
    return {"final_obs": final, "_final_obs": mask, "final_info": info, "_final_info": mask.copy()}
