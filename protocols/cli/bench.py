"""`musebot bench`: measures the speed."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .options import option

_TEXTS = {
    "machine": "Rates are in robot-steps per second. A ratio is the median of the ratios of paired "
    "repetitions, with its range. MuJoCo's timers are off.",
    "lives": "Creative robots in training (sensors, brain, counts, physics), and the physics "
    "alone, which repeats their motor values from the same states: `mujoco.rollout`, one call for "
    "each control step, or the kinematic simulator.",
    "interfaces": "Wall avoidance with random actions, and the same physics steps by "
    "`mujoco.rollout` alone.",
    "processes": "Creative wall avoidance: each process while all work, and one alone. The "
    "scaling is the ratio times the number of processes.",
    "populations": "Creative spot finding in training, and the physics alone with random motor "
    "values. Empty where the memory is too small.",
}


@dataclasses.dataclass
class Bench:
    """Measure the speed compared with the raw physics, in processor time: about 5 minutes."""

    json: Path | None = option(None, "file to write all measured numbers to", "FILE")
    quick: bool = option(False, "measure next to nothing, to see that everything works")
    device: str | None = option(
        None,
        "measure populations instead, in the kinematic simulator and in MuJoCo Warp, on cpu, cuda "
        "or cuda:N",
        "NAME",
    )

    def __call__(self) -> None:
        """Prints Markdown, each section as soon as it is measured."""
        import json

        from ..lives.local import prepare_process
        from ..lives.manifest import machine
        from ..machine import cores
        from ..pages import markdown
        from ..storage import check_place, resolved_file, write_atomically
        from ..terminal import notice, show_markdown
        from . import speed

        file = self.json and resolved_file(self.json)
        if file is not None:
            check_place(file)
        effort = speed.QUICK if self.quick else speed.FULL
        if self.device is not None:
            speed.check_populations(self.device)
            todo = {"populations": speed.populations(effort, self.device)}
        else:
            todo = {
                "lives": speed.lives(effort),
                "interfaces": speed.interfaces(effort),
                "processes": speed.processes(effort, cores()),
            }
        prepare_process()
        about = machine() | {"cores_used": cores(), "quick": self.quick}
        quick = " **Measured with --quick: too short to be quoted.**" if self.quick else ""
        table = [("", "value"), *((_words(name), str(value)) for name, value in about.items())]
        show_markdown(markdown.section("Machine", _TEXTS["machine"] + quick, table[0], table[1:]))
        found: dict[str, Any] = {"machine": about}
        for name, rows in todo.items():
            notice(f"measuring {name}")
            found[name] = list(rows)
            head, *cells = table_of(found[name])
            show_markdown(markdown.section(name.capitalize(), _TEXTS[name], head, cells))
        if file is not None:
            write_atomically(file, (json.dumps(found, indent=2) + "\n").encode())


def table_of(rows: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Returns the cells of a table, its head first: the longest row has all columns."""
    names = [*max(rows, key=len)]
    return [[*map(_words, names)], *([_cell(row.get(name, "")) for name in names] for row in rows)]


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return _words(value)
    return f"{value:.3f}" if isinstance(value, float) and value < 100 else f"{value:,.0f}"


def _words(name: str) -> str:
    return name.replace("_", " ")
