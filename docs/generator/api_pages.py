"""The pages of the API: which modules they show. mkdocstrings fills them from the docstrings."""

from __future__ import annotations

import importlib
from pathlib import Path

import musebot
from tables import first_line

# Page, title, package and its modules; None for all modules of the package.
GROUPS = (
    ("musebot", "musebot", "musebot", ()),
    ("tasks", "Tasks", "musebot.tasks", None),
    ("gymnasium", "Gymnasium", "musebot.tasks.gymnasium_env", None),
    ("models", "Models", "musebot.models", None),
    ("controller", "The paper's brain", "musebot.controller", None),
    ("extensions", "Beyond the paper's brain", "musebot.controller.extensions", None),
    ("experiment", "Experiments", "musebot.protocols.experiment", None),
    ("agents", "Agents", "musebot.protocols.agents", None),
    ("results", "Results of a run", "musebot.protocols.results", None),
    ("analysis", "Statistics", "musebot.protocols.analysis", None),
    ("playback", "Films and replay", "musebot.protocols.playback", None),
)


def pages() -> dict[str, str]:
    """Returns the pages by their path below `docs/reference`."""
    return {f"api/{name}.md": _page(*group) for name, *group in GROUPS}


def _page(title: str, package: str, chosen: tuple[str, ...] | None) -> str:
    folder = Path(musebot.__file__).parent.joinpath(*package.split(".")[1:])
    found = sorted(path.stem for path in folder.glob("*.py") if path.stem != "__init__")
    names = found if chosen is None else chosen
    says = first_line(importlib.import_module(package))
    shown = [package] if chosen is not None else [f"{package}.{name}" for name in names]
    listed = "".join(f"::: {name}\n\n" for name in shown)
    return f"# {title}\n\n`{package}`: {says}\n\n{listed}"
