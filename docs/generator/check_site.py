"""Checks a built site: `python docs/generator/check_site.py site`.

Every local link and picture must exist, and no page may load anything from elsewhere.
"""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

# Links that a page loads by itself; others only lead elsewhere when they are clicked.
_LOADED_LINKS = {"stylesheet", "preconnect", "preload", "icon", "manifest"}


class _Page(HTMLParser):
    """The links and anchors of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        for name in ("href", "src", "poster"):
            if not (target := given.get(name)):
                continue
            self.links.append(target)
            loaded = tag == "link" and _LOADED_LINKS & set(given.get("rel", "").split())
            if loaded or name != "href":
                self.loads.append(target)


def faults(site: Path) -> list[str]:
    """Returns a line for each broken link of a site, and for each file loaded from elsewhere.

    Args:
      site: Folder of the site.
    """
    pages = {path.resolve(): _read(path) for path in sorted(site.rglob("*.html"))}
    found = []
    for path, page in pages.items():
        if path.name == "404.html":  # its links are relative to the host
            continue
        place = path.relative_to(site.resolve())
        found += [f"{place}: loads {url}" for url in page.loads if urlsplit(url).netloc]
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = path
            if parts.path:
                target = (path.parent / unquote(parts.path)).resolve()
                target = target / "index.html" if target.is_dir() else target
            anchor = unquote(parts.fragment)
            lost = target in pages and anchor and anchor not in pages[target].anchors
            if lost or not target.exists():
                found.append(f"{place}: {link} does not exist")
    return found


def _read(path: Path) -> _Page:
    page = _Page()
    page.feed(path.read_text())
    return page


if __name__ == "__main__":
    lines = faults(Path(sys.argv[1]))
    print("\n".join(lines) or f"{sys.argv[1]}: every link and picture exists")
    sys.exit(1 if lines else 0)
