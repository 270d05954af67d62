"""Fields of a command: its options and positional arguments, and the executor they choose."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..machine import cores

if TYPE_CHECKING:
    from ..runs.jobs import Executor


def option(
    default: Any, says: str, values: str = "", *, choices: tuple[str, ...] = (), group: str = ""
) -> Any:
    """Returns the dataclass field of an option, such as `--robots`.

    Args:
      default: Value if the option is not given; `dataclasses.MISSING` if it must be given.
      says: Text in the help: meaning, unit and default.
      values: Name of the value in the help, such as "N"; "" lists the choices instead.
      choices: Words that the parser accepts; empty if it accepts all, and later code checks them.
      group: Heading in the help above the option; "" for the heading "options".
    """
    values = values or f"{{{','.join(choices)}}}"
    notes = {"says": says, "values": values, "choices": choices, "group": group, "option": True}
    return dataclasses.field(default=default, metadata=notes)


def argument(says: str, values: str, default: Any = dataclasses.MISSING) -> Any:
    """Returns the dataclass field of a positional argument, such as OUT."""
    notes = {"says": says, "values": values, "choices": (), "group": "", "option": False}
    return dataclasses.field(default=default, metadata=notes)


def usage_of(prog: str, command: type) -> str:
    """Returns a command's usage, such as "musebot film [OUT] [OPTION ..]"."""
    words = [prog]
    for field in dataclasses.fields(command):
        if not field.metadata["option"]:
            word = field.metadata["values"]
            words.append(word if field.default is dataclasses.MISSING else f"[{word}]")
    return " ".join([*words, "[OPTION ..]"])


def executor(processes: int | None = None, ray: str | None = None, device: str = "cpu") -> Executor:
    """Returns the executor of a command's jobs; connects to the cluster if `ray` is given.

    This machine runs `processes` jobs at a time, by default one per core; on a GPU it runs one,
    because jobs would share the GPU's memory. `ray` is the cluster's address, HOST:PORT.

    Raises:
      InputError: a value is invalid, there is no such cluster, or the device excludes Ray.
      ImportError: Ray is not installed.
    """
    if processes is not None and (type(processes) is not int or processes < 1):
        raise InputError(f"processes must be a whole number of at least 1, got {processes!r:.60}")
    if device != "cpu" and (ray is not None or processes not in (None, 1)):
        raise InputError(f"the device {device} of this machine runs one job: no --ray, --processes")
    if ray is None:
        from ..runs.local import Local

        return Local(processes or cores() if device == "cpu" else 1)
    if processes is not None:
        raise InputError("--processes and --ray exclude each other: Ray uses its cluster's cores")
    from ..runs.ray_cluster import RayCluster

    return RayCluster(ray)
