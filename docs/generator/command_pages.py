"""The command reference: every option of every verb, from the fields that declare them."""

from __future__ import annotations

import dataclasses
import inspect

from tables import table

from musebot.protocols.cli.options import usage_of
from musebot.protocols.cli.verbs import BENCHMARK, VERBS, verb_class


def pages() -> dict[str, str]:
    """Returns the page of the command."""
    names = [name for name in VERBS if name != "benchmark"]
    sections = "\n".join(_section(name) for name in [*names, *BENCHMARK])
    return {
        "command.md": f"""# Command reference

All verbs of `musebot`; `musebot VERB --help` prints the same. A guide to the command is in
[command.md](../command.md).

{sections}"""
    }


def _section(verb: str) -> str:
    command = verb_class(verb)
    fields = dataclasses.fields(command)
    rows = []
    for one in fields:
        notes = one.metadata
        option = f"--{one.name.replace('_', '-')}"
        name = option if notes["option"] else notes["values"]
        several = " .." if str(one.type).startswith("tuple") else ""
        values = f"{notes['values']}{several}" if notes["option"] and one.type != "bool" else ""
        rows.append((f"`{name}`", f"`{values}`" if values else "", notes["says"]))
    return f"""## musebot {verb}

{inspect.cleandoc(command.__doc__ or "")}

```text
{usage_of(f"musebot {verb}", command)}
```

{table(("option", "value", "meaning"), rows)}"""
