"""A section of the output of `musebot bench`."""

from __future__ import annotations

import dataclasses


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
        rule = ("---", *("---:" for _ in self.head[1:]))
        table = "\n".join(f"| {' | '.join(row)} |" for row in (self.head, rule, *self.rows))
        return f"### {self.title}\n\n{self.text}\n\n{table}\n"
