"""Pages of the notebooks in docs/notebooks, with the results that are stored in them."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

_IMAGES = {"image/png": "png", "image/gif": "gif"}


def files(docs: Path) -> dict[Path, bytes]:
    """Returns the pages and their pictures by path; docs/reference/notebooks is not committed."""
    folder, made = docs / "reference" / "notebooks", {}
    for path in sorted((docs / "notebooks").glob("*.ipynb")):
        parts = [f"<!-- Made from docs/notebooks/{path.name} by `python docs/generator`. -->\n"]
        for number, cell in enumerate(json.loads(path.read_text())["cells"]):
            text = "".join(cell["source"])
            if cell["cell_type"] == "markdown":
                parts.append(re.sub(r"\]\(\.\./(?=[^)]*\))", "](../../", text))
                continue
            parts.append(f"```python\n{text}\n```")
            for place, output in enumerate(cell["outputs"]):
                name = f"{path.stem}-{number}-{place}"
                shown, pictures = _output(output, name)
                parts.append(shown)
                made |= {folder / file: content for file, content in pictures.items()}
        parts.append(f"[This notebook, to open in Jupyter](../../notebooks/{path.name})")
        made[folder / f"{path.stem}.md"] = ("\n\n".join(parts) + "\n").encode()
    return made


def _output(output: dict[str, Any], name: str) -> tuple[str, dict[str, bytes]]:
    """Returns an output in Markdown, and its pictures by file name."""
    if output["output_type"] == "stream":
        return f"```text\n{''.join(output['text']).rstrip()}\n```", {}
    data = output.get("data", {})
    html = "".join(data.get("text/html", ""))
    if found := re.search(r"data:(image/\w+);base64,([\w+/=]+)", html):
        data = {found[1]: found[2]}
    for kind, ending in _IMAGES.items():
        if kind in data:
            file = f"{name}.{ending}"
            return f"![Output of the cell above]({file})", {file: base64.b64decode(data[kind])}
    return f"```text\n{''.join(data['text/plain'])}\n```", {}
