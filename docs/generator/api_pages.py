"""The pages of the API: which modules they show. mkdocstrings fills them from the docstrings."""

from __future__ import annotations

import importlib
from pathlib import Path

from tables import first_line

import musebot

# Page, title and package; a page shows all modules of its package, musebot's the package itself.
GROUPS = (
    ("musebot", "musebot", "musebot"),
    ("tasks", "Tasks", "musebot.tasks"),
    ("gymnasium", "Gymnasium", "musebot.tasks.gymnasium_env"),
    ("models", "Models", "musebot.models"),
    ("controller", "The paper's brain", "musebot.controller"),
    ("agents", "Agents", "musebot.protocols.agents"),
    ("runs", "Runs", "musebot.protocols.runs"),
    ("analysis", "Statistics", "musebot.protocols.analysis"),
    ("pages", "Tables, films and replay", "musebot.protocols.pages"),
)


def pages() -> dict[str, str]:
    """Returns the pages by their path below `docs/reference`."""
    return {f"api/{name}.md": _page(title, package) for name, title, package in GROUPS}


def _page(title: str, package: str) -> str:
    shown, says = [package], first_line(importlib.import_module(package))
    if package != "musebot":
        folder = Path(musebot.__file__).parent.joinpath(*package.split(".")[1:])
        stems = sorted(path.stem for path in folder.glob("*.py") if path.stem != "__init__")
        shown = [f"{package}.{stem}" for stem in stems]
    listed = "".join(f"::: {name}\n\n" for name in shown)
    return f"# {title}\n\n`{package}`: {says}\n\n{listed}"
