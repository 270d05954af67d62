"""The verbs of the command `musebot`, a module each."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

# The module and class of each verb. A verb's module is imported when the verb is asked for.
VERBS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "demo": ("demo", "DemoCommand"),
        "run": ("run", "RunCommand"),
        "tables": ("tables", "TablesCommand"),
        "film": ("film", "FilmCommand"),
        "report": ("report", "ReportCommand"),
        "figure": ("figure", "FigureCommand"),
        "study": ("study", "ListStudies"),
        "explore": ("explore", "ExploreCommand"),
        "check-agent": ("check_agent", "CheckAgentCommand"),
        "list": ("listing", "ListCommand"),
        "bench": ("bench", "BenchCommand"),
        "doctor": ("doctor", "DoctorCommand"),
    }
)


def verb_class(name: str) -> type[Any]:
    """Imports and returns the class of a verb.

    Raises:
      KeyError: there is no verb of that name.
    """
    module, cls = VERBS[name]
    return getattr(importlib.import_module(f".{module}", __package__), cls)


def study_command(name: str) -> type[Any]:
    """Imports a study, and returns the class of the command that conducts it.

    Raises:
      KeyError: there is no study of that name.
    """
    return importlib.import_module(".study", __package__).study_command(name)
