"""The page itself: template, styles, three.js and the data in one file."""

from __future__ import annotations

import html
import json
import os
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from warpqem.arguments.json_types import Json
from warpqem.errors import OptionError, StageError
from warpqem.files.temporary import replacing
from warpqem.printable import printable
from warpqem.report.content import Report
from warpqem.report.data import Progress, report_data

__all__ = ["asset_text", "check_page_path", "page_json", "report_page", "save_page", "script_text", "write_report"]

SUFFIXES = (".html", ".htm")
# In the order of what they use of each other.
SCRIPTS = (
    "decode.js",
    "tables.js",
    "plots.js",
    "mesh_view.js",
    "skeleton.js",
    "scene.js",
    "meshes.js",
    "share.js",
    "page.js",
)


def write_report(
    path: str | os.PathLike[str], report: Report, device: str | None = None, progress: Progress | None = None
) -> None:
    """Write a report as one HTML file that needs nothing else; an existing one is replaced.

    Args:
        path: .html file.
        report: what to show.
        device: Warp device; None for the default.
        progress: called with the fraction done and what is being done.

    Raises:
        OptionError: the suffix is another one.
        StageError: the file cannot be written.
        WarpqemError: see `report_data`.
    """
    check_page_path(path)
    save_page(path, report_page(report_data(report, device, progress)))


def check_page_path(path: str | os.PathLike[str]) -> None:
    """Refuse what browsers would not open as a page.

    Raises:
        OptionError: the suffix is another one.
    """
    if not os.fspath(path).lower().endswith(SUFFIXES):
        raise OptionError(f"report {os.fspath(path)}: the suffix must be .html")


def report_page(data: Mapping[str, Json]) -> str:
    """The HTML text for the data of `report_data`."""
    text = asset_text("template.html")
    # Each mark is replaced once, and what it is replaced by is not looked at again.
    parts = {
        "TITLE": html.escape(printable(str(data["title"]))),
        "STYLE": asset_text("page.css"),
        "DATA": page_json(data),
        "THREE": script_text("three.min.js"),
        "PAGE": "".join(map(script_text, SCRIPTS)),
        "PLAIN": _plain_table(data),
    }
    pieces = text.split("%%")
    return "".join(parts[piece] if index % 2 else piece for index, piece in enumerate(pieces))


def _plain_table(data: Mapping[str, Any]) -> str:
    """The errors of the levels as HTML, for browsers that run no script."""
    rows = [("level", "faces", "verdict", "RMS %", "Hausdorff %"), ("original", data["original"]["faces"], "", "", "")]
    for level in data["levels"]:
        found = level.get("measures") or {"verdict": "", "rms": None, "hausdorff": None}
        errors = ("" if found[name] is None else f"{found[name]:.4g}" for name in ("rms", "hausdorff"))
        rows.append((level["name"], level["faces"], found["verdict"], *errors))
    cells = ("".join(f"<td>{html.escape(printable(str(value)))}</td>" for value in row) for row in rows)
    return "<table>" + "".join(f"<tr>{row}</tr>" for row in cells) + "</table>"


def page_json(value: Any) -> str:
    """JSON as the inside of a script element, with every text made safe to show."""
    return json.dumps(_printable(value), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _printable(value: Any) -> Any:
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, dict):
        return {_printable(name): _printable(entry) for name, entry in value.items()}
    return [_printable(entry) for entry in value] if isinstance(value, (list, tuple)) else value


def save_page(path: str | os.PathLike[str], text: str) -> None:
    """Write the text under a temporary name and rename it.

    Raises:
        StageError: the file cannot be written; nothing is left behind.
    """
    try:
        with replacing(Path(path)) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except OSError as error:
        raise StageError(f"{path}: cannot be written ({error.strerror or error})") from error


def asset_text(name: str) -> str:
    """One of the files that pages are made of."""
    return (files("warpqem.report") / "assets" / name).read_text(encoding="utf-8")


def script_text(name: str) -> str:
    """The same as the inside of a script element."""
    # Inside a page, only this would end a script early.
    return asset_text(name).replace("</script", "<\\/script")
