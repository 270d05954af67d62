"""Tables in Markdown, and what the pages read from docstrings."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Sequence
from typing import Any

from musebot.protocols.pages import markdown


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Returns a table in Markdown.

    Args:
      head: Title of each column; a title that ends with ":" aligns its column to the right.
      rows: Cells of each row.
    """
    align = "".join("r" if title.endswith(":") else "l" for title in head)
    lines = [[title.rstrip(":") for title in head], *rows]
    cells = [[str(cell).replace("|", "\\|").replace("\n", " ") for cell in line] for line in lines]
    return "\n".join([*markdown.table(cells, align), ""])


def attributes(cls: type) -> dict[str, str]:
    """Returns the sentences of a docstring's section "Attributes", by name."""
    text = inspect.cleandoc(cls.__doc__ or "")
    _, _, section = text.partition("Attributes:\n")
    section = section.partition("\n\n")[0]
    found = re.findall(r"^  (\w+): (.*?)(?=^  \w|\Z)", section, re.DOTALL | re.MULTILINE)
    return {name: " ".join(words.split()) for name, words in found}


def first_line(described: Any) -> str:
    """Returns the first line of a docstring."""
    return inspect.cleandoc(described.__doc__ or "").partition("\n")[0]
