"""The notebook as a page: its text, its code, and what its cells show."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

__all__ = ["notebook_page"]


def notebook_page(path: Path) -> tuple[str, dict[str, bytes]]:
    """The page, and its pictures by their names on the site."""
    pictures: dict[str, bytes] = {}
    parts: list[str] = []
    for cell in json.loads(path.read_text("utf-8"))["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        parts += [_shown(output, pictures) for output in cell["outputs"]]
    # Below the title, which is the first line.
    title, _, rest = "\n\n".join(parts).partition("\n")
    return f"{title}\n\n[Download it as a notebook]({path.name}).\n{rest}\n", pictures


def _shown(output: dict[str, Any], pictures: dict[str, bytes]) -> str:
    """An output of a cell as Markdown; a picture joins the others."""
    data = output.get("data", {})
    text = "".join(output.get("text") or data.get("text/plain", ""))
    shown = f"```text\n{text.rstrip()}\n```"
    if "image/png" not in data:
        return shown
    name = f"notebook_{len(pictures) + 1}.png"
    pictures[name] = base64.b64decode(data["image/png"])
    return f"{shown}\n\n![What the cell above shows]({name})"
