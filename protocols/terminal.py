"""Prints texts, notices and Markdown, with control characters escaped."""

from __future__ import annotations

import contextlib
import re
import sys
from typing import TextIO

_MOST = 2000  # characters of a sentence
# Control and invisible characters, changes of text direction, and bytes that are no text.
_UNPRINTABLE = re.compile(
    "[\x00-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff]"
)


def printable(text: str, *, lines: bool = False) -> str:
    """Returns a text in which characters that could control a terminal are escaped.

    Args:
      text: Text to print; names of files or values in it may contain control characters.
      lines: Whether to keep line breaks and the whole length. Otherwise line breaks are escaped,
        and a long text is shortened in the middle.
    """

    def escaped(match: re.Match[str]) -> str:
        return match[0] if lines and match[0] == "\n" else ascii(match[0])[1:-1]

    if not lines and len(text) > _MOST:
        text = f"{text[: _MOST // 2]} ... {text[-_MOST // 2 :]}"
    return _UNPRINTABLE.sub(escaped, text)


def say(text: str, stream: TextIO | None = None, *, lines: bool = False) -> None:
    """Prints a text, by default on stdout, with control characters escaped."""
    if (stream := stream or sys.stdout) is not None:  # not closed
        print(printable(text, lines=lines), file=stream)


def notice(sentence: str) -> None:
    """Prints a sentence on stderr."""
    say_if_possible(f"musebot: {sentence}")


def say_if_possible(text: str) -> None:
    """Prints a text on stderr; ignores a full disk, or a reader that has left."""
    if sys.stderr is not None:
        with contextlib.suppress(OSError, ValueError):  # full, without a reader, or closed
            say(text, sys.stderr)


def safe_streams() -> None:
    """Makes stdout and stderr escape characters that they cannot encode, instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        if (reconfigure := getattr(stream, "reconfigure", None)) is not None:
            reconfigure(errors="backslashreplace")


def show_markdown(text: str) -> None:
    """Prints Markdown on stdout, formatted if stdout is a terminal."""
    from rich.console import Console  # the plain install has no rich, and prints no Markdown
    from rich.markdown import Markdown

    console = Console()
    if console.is_terminal:
        console.print(Markdown(printable(text, lines=True)))
    else:
        say(text, lines=True)
