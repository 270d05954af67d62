"""The scores in docs/leaderboard.md, copied from the page of all kept runs."""

from __future__ import annotations

from pathlib import Path

from musebot.protocols.compare.leaderboard_page import BOARDS_HEADING

NAME = "leaderboard.md"
BEGIN = "<!-- Scores, copied by `python docs/generator`: edit above or below. -->"
END = "<!-- End of the scores. -->"


def updated(docs: Path) -> str:
    """Returns the text of the page with the present scores."""
    before, _ = _parted(docs / NAME, BEGIN)
    _, after = _parted(docs / NAME, END)
    page = docs / "results" / "leaderboard" / "leaderboard.md"
    scores, _ = _parted(page, f"{BOARDS_HEADING}\n")
    return f"{before}{BEGIN}\n\n{scores.strip()}\n\n{END}{after}"


def _parted(page: Path, mark: str) -> list[str]:
    parts = page.read_text().split(mark)
    if len(parts) != 2:
        raise SystemExit(f"{page} must contain this once: {mark}")
    return parts
