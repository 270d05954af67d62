"""`musebot bench`: measures the speed of simulation."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .options import option

_TEXTS = {
    "machine": "Rates are in robot-steps per second. A ratio is the median of the ratios of paired "
    "repetitions, with its range. MuJoCo's timers are off.",
    "lives": "Creative robots in training (sensors, brain, counts, physics), and the physics "
    "alone: `mujoco.rollout` with the same motor values from the same states, or the kinematic "
    "simulator with random ones.",
    "backends": "Creative spot finding in training in the kinematic simulator, by Numba and by "
    "PyTorch.",
    "interfaces": "Wall avoidance with random actions, and `tasks.Batch` alone with the same ones.",
    "populations": "Creative spot finding in training, and the physics alone with random motor "
    "values. Empty where the memory is too small.",
}


@dataclasses.dataclass
class Bench:
    """Measure the speed compared with the physics alone, in processor time (about 5 minutes)."""

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
        import importlib.util
        import json

        from ..machine import cores
        from ..runs.local import prepare_process
        from ..runs.manifest import made_with
        from ..storage import checked_file, write_atomically
        from ..terminal import notice
        from . import speed

        file = self.json and checked_file(self.json)
        effort = speed.QUICK if self.quick else speed.FULL
        if self.device is not None:
            speed.check_populations(self.device)
            todo = {"populations": speed.populations(effort, self.device)}
        else:
            todo = {"lives": speed.lives(effort), "interfaces": speed.interfaces(effort)}
            if importlib.util.find_spec("numba"):
                todo["backends"] = speed.backends(effort)
        prepare_process()
        about = made_with() | {"cores_used": cores(), "quick": self.quick}
        quick = " **Measured with --quick: too short to be quoted.**" if self.quick else ""
        cells = [(_words(name), str(value)) for name, value in about.items()]
        _show("machine", [("", "value"), *cells], quick)
        found: dict[str, Any] = {"machine": about}
        for name, rows in todo.items():
            notice(f"measuring {name}")
            found[name] = own = list(rows)
            head = [*max(own, key=len)]  # the longest row has all columns
            cells = [[_cell(row.get(one, "")) for one in head] for row in own]
            _show(name, [[*map(_words, head)], *cells])
        if file is not None:
            write_atomically(file, (json.dumps(found, indent=2) + "\n").encode())


def _show(name: str, rows: Sequence[Sequence[str]], more: str = "") -> None:
    from ..pages.markdown import table
    from ..terminal import show_markdown

    lines = [f"### {name.capitalize()}", "", f"{_TEXTS[name]}{more}", "", *table(rows), ""]
    show_markdown("\n".join(lines))


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return _words(value)
    return f"{value:.3f}" if isinstance(value, float) and value < 100 else f"{value:,.0f}"


def _words(name: str) -> str:
    return name.replace("_", " ")
