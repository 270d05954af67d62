"""A section of the output of `musebot bench`."""

from __future__ import annotations

import dataclasses

from ..reporting.markdown import table


@dataclasses.dataclass(frozen=True)
class Section:
    """A heading, a paragraph and a table.

    Attributes:
      title: Heading of the section.
      text: Paragraph that says what is measured.
      head: Names of the table's columns.
      rows: Rows of the table, a text for each cell.
    """

    title: str
    text: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def markdown(self) -> str:
        """Returns heading, paragraph and table as Markdown."""
        lines = "\n".join(table([self.head, *self.rows]))
        return f"### {self.title}\n\n{self.text}\n\n{lines}\n"
