"""The command reference: every option of every verb and study, from their help."""

from __future__ import annotations

import contextlib
import io
import os
import re
from collections.abc import Iterator

from tables import table

from musebot.protocols.cli.parser import parsed
from musebot.protocols.cli.verbs import VERBS, study_command, verb_class
from musebot.protocols.compare import STUDIES


def pages() -> dict[str, str]:
    """Returns the page of the command."""
    verbs = [_section(f"musebot {verb}", verb_class(verb)) for verb in VERBS]
    studies = [_section(f"musebot study {study}", study_command(study)) for study in STUDIES]
    return {
        "command.md": f"""# Command reference

All verbs of `musebot`, with what `musebot VERB --help` says. A guide to the
command is in [command.md](../command.md).

{"".join(verbs)}## The studies

{"".join(f"#{section}" for section in studies)}"""
    }


def _section(prog: str, command: type) -> str:
    usage, _, rest = _help(prog, command).partition("\n\n")
    says, _, options = rest.partition("\n\n ")
    says = " ".join(line.strip() for line in says.splitlines())
    rows = [
        (f"`{name}`", f"`{values}`" if values else "", text)
        for name, values, text in _options(f" {options}")
        if name != "-h,"
    ]
    listed = f"\n{table(('option', 'value', 'meaning'), rows)}" if rows else ""
    return f"## {prog}\n\n{says}\n\n```text\n{usage}\n```\n{listed}\n"


def _help(prog: str, command: type) -> str:
    """Returns what a command prints for `--help`, on a terminal on which no line is broken."""
    printed, columns = io.StringIO(), os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "2000"
    try:
        with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
            parsed(command, prog, ["--help"])
    finally:
        del os.environ["COLUMNS"]
        if columns is not None:
            os.environ["COLUMNS"] = columns
    return printed.getvalue()


def _options(text: str) -> Iterator[tuple[str, str, str]]:
    """Yields the name, the values and the meaning of each option.

    A line of an option begins at the frame; its meaning may go on in indented lines.
    """
    found: list[tuple[str, str]] = []
    for line in text.splitlines():
        inner = re.sub(r"^│|[│ ]+$", "", line)
        words = inner.strip()
        if words in ("", "options", "positional arguments") or re.match("[╭╰]|[-─]{3}", words):
            continue
        if len(inner) - len(inner.lstrip()) > 2:
            name, meaning = found.pop()
            found.append((name, f"{meaning} {words}".strip()))
        else:
            name, _, meaning = re.sub(" {2,}", "\n", words, count=1).partition("\n")
            found.append((name, meaning))
    for name, meaning in found:
        assert meaning, f"{name} has no meaning"
        option, _, values = name.partition(" ")
        yield option, values, meaning
