"""The tutorial as a notebook: the text, code and printed results of docs/tutorial.md."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any


def notebook(docs: Path) -> str:
    """Returns the notebook, which stands in docs/notebooks, as JSON."""
    cells: list[dict[str, Any]] = []
    for part in re.split(r"(```.*?```)", (docs / "tutorial.md").read_text(), flags=re.DOTALL):
        _, _, text = part.strip("`").partition("\n")
        if part.startswith("```python"):
            cells.append({"cell_type": "code", **_source(text)})
            cells[-1] |= {"execution_count": None, "outputs": []}
        elif part.startswith("```text"):
            output = {"output_type": "stream", "name": "stdout", "text": text}
            cells[-1]["outputs"].append(output)
        elif part.strip():
            text = re.sub(r"\]\((?!http)", "](../", part)
            cells.append({"cell_type": "markdown", **_source(text.strip())})
    kernel = {"name": "python3", "display_name": "Python 3"}
    made = {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 4}
    return json.dumps(made, indent=1) + "\n"


def _source(text: str) -> dict[str, Any]:
    return {"metadata": {}, "source": text.rstrip("\n").splitlines(keepends=True)}
