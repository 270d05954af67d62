"""A page for each task."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

from tables import first_line, table

import musebot
from musebot.models.arena_variants import OBSTACLES, add_obstacles
from musebot.protocols.cli.listing import NAMES
from musebot.tasks.arena import SUITE, TaskDefinition
from musebot.tasks.episode import CONTROL_TIMESTEP
from musebot.tasks.suite import BENCHMARKING, PAPER, TASKS

SMELL = (
    "Eq. 3, s / (1 + s) with s = 10 (r / d) (1 - 2 beta / alpha) if beta < alpha / 2, else 0; "
    "s = 10 if d < r. d and beta are the distance and the direction of the spot's centre, seen "
    "from {}; r = 6 cm, alpha = 90 degrees"
)
# The values of each signal in order, its unit and its meaning; names and ranges are in the code.
SIGNALS = {
    "distances": (
        "front, back, left, right",
        "1",
        "Eq. 2, 1 / (1 + d)^10 for a wall or pillar at d metres from the rim",
    ),
    "contact": ("", "1", "-1 in contact with a wall or a pillar, else 0"),
    "speed": ("", "0.2 m/s", "speed of the robot's centre ahead, clipped"),
    "nose": ("", "1", SMELL.format("the nose at the front of the rim")),
    "noses": (
        "left, right",
        "1",
        SMELL.format("one of two noses on the rim, 30 degrees to the left and right of the front"),
    ),
}


def pages(docs: Path) -> dict[str, str]:
    """Returns the pages by their path below `docs/reference`."""
    earned = _earned((docs / "tasks.md").read_text())
    return {f"tasks/{name}.md": _page(TASKS[name], earned) for name in TASKS if name in SUITE}


def _earned(written: str) -> dict[str, list[str]]:
    """Returns the mean rewards per step of random actions and of PPO, from docs/tasks.md."""
    row = r"^\|.+\(reference/tasks/(\w+)\.md\).+\| (.+) \| (.+) \|$"
    return {name: earned for name, *earned in re.findall(row, written, re.MULTILINE)}


def _gymnasium_id(name: str) -> str:
    ids = {task: f"musebot/{identifier}" for identifier, task in musebot.GYMNASIUM_TASKS.items()}
    return ids[name]


def _page(definition: TaskDefinition, earned: dict[str, list[str]]) -> str:
    name, rules = definition.name, definition.rules
    signals, places, start = [], [], 0
    for signal, (length, low, high) in rules.shapes.items():
        values, unit, meaning = SIGNALS[signal]
        titled = f"`{signal}`: {values}" if values else f"`{signal}`"
        signals.append((titled, f"({length},)", f"{low:g}", f"{high:g}", unit, meaning))
        places.append(f"`{signal}` {_numbers(start, length)}")
        start += length
    limit = definition.limit
    unit = "motor value" if limit == 0.5 else f"{0.5 / limit:g} motor values"
    action = ("`motors`: left, right", "(2,)", f"{-limit:g}", f"{limit:g}", unit)
    action = (*action, f"speed of the wheel: {0.2 / limit:g} m/s times the action")
    columns = ("shape", "min:", "max:", "unit", "meaning")
    low, high = rules.rewards
    random, ppo = earned[name]
    return f"""# {name}

{NAMES["tasks"][name]}

![The arena of {name}](../../images/{name.removesuffix("_unit")}.png)

{table(("property", "value"), _facts(definition))}
## Observations

{table(("signal", *columns), signals)}
Gymnasium concatenates the signals in this order, as 32-bit floats of shape ({start},):
{"; ".join(places)}.

## Actions

{table(("action", *columns), [action])}
Values beyond the limits are clipped.

## Reward

In [{low:g}, {high:g}]: {_returned(rules.reward)}

The measured event, whose share of the time is a robot's score: {_returned(rules.event)}

## Start and end

{_start(definition)}

## Film

![A trained policy in {name}](../../images/{name}.gif)

An untrained policy, and the one that musebot brings, in the episode of seed 1, at four times the
real speed.

Reproduce: `musebot film --task {name} --phase both --seed 1 --seconds 8 --output {name}.gif`

## Baselines

Mean reward per step, with its 95 % interval over robots:

{table(("random actions:", "PPO:"), [(random, ppo)])}
How they were measured, and the code: [what learners earn](../../tasks.md#what-learners-earn). The
policy was trained with

```sh
musebot benchmark ppo runs/{name} --task {name}
```

## Open it

```python
import gymnasium
import musebot

env = musebot.load("arena", "{name}", task_kwargs={{"random": 1}})  # dm_control
env = gymnasium.make("{_gymnasium_id(name)}")
robots = gymnasium.make_vec("{_gymnasium_id(name)}", num_envs=50)
```

Interfaces, keywords and `info`: [the tasks](../../tasks.md).
"""


def _numbers(start: int, length: int) -> str:
    return f"{start}" if length == 1 else f"{start} to {start + length - 1}"


def _facts(definition: TaskDefinition) -> list[tuple[str, str]]:
    name, steps = definition.name, definition.time_limit / CONTROL_TIMESTEP
    identifier = _gymnasium_id(name)
    tag = "paper" if ("arena", name) in PAPER else "benchmarking"
    assert tag == "paper" or ("arena", name) in BENCHMARKING
    endless = "endless; Gymnasium truncates after 1,000 steps"
    return [
        ("dm_control", f'`musebot.load("arena", "{name}")`'),
        ("Gymnasium", f"`{identifier}`"),
        ("version", identifier.rpartition("-")[2]),
        ("tag", f"`{tag}`"),
        ("control step", f"{CONTROL_TIMESTEP:g} s"),
        ("episode", endless if math.isinf(steps) else f"{steps:,.0f} steps"),
    ]


def _returned(function: Any) -> str:
    return first_line(function).removeprefix("Returns ").removeprefix("whether ")


def _start(definition: TaskDefinition) -> str:
    drawn = ["The robot's place and heading are drawn for every episode, 1 cm clear of walls."]
    if definition.rules.has_nose:
        drawn.append("The spot's place is drawn, too, with the whole spot inside the arena.")
    if steps := definition.spot_steps:
        seconds = definition.spot_seconds
        drawn.append(f"The spot jumps to a new place every {seconds:g} s ({steps} steps).")
    keywords = ", ".join(f"`{word}`" for word in definition.keywords)
    if add_obstacles in definition.edits:
        pillars = "; ".join(str(pillar) for pillar in OBSTACLES)
        drawn.append(f"Pillars (x, y, radius in metres): {pillars}.")
    drawn.append("No episode ends before its last step.")
    return f"{' '.join(drawn)} Keywords of the task: {keywords}."
