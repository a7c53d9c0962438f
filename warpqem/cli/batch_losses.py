"""What an asset of a batch lost, and what else is worth knowing: one line for all meshes that lost the same."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from warpqem.batching.job_result import BatchResult, report_of

__all__ = ["has_losses", "loss_lines"]

# Notes and problems of one asset that are shown; losses are shown all.
MAX_NOTES = 20


def has_losses(result: BatchResult) -> bool:
    """Whether something of an asset did not fit a new mesh."""
    return any(prim["dropped"] for prim in _prims(result))


def loss_lines(result: BatchResult) -> list[tuple[str, str]]:
    """What to show of one asset: "warning" or "note", and the text. Meshes that lost the same share a line."""
    report = report_of(result)
    lost = _grouped(((prim, name) for prim in _prims(result) for name in prim["dropped"]), ", ")
    lines = [("warning", f"{place}: dropped, does not fit the new mesh: {names}") for names, place in lost]
    notes = [("warning", text) for text in report.get("problems", [])]
    notes += [("warning", f"{place}: {text}") for text, place in _grouped(_texts(result, "problems"))]
    notes += [("warning", f"{place}: {text}") for text, place in _grouped(_shortfalls(result))]
    notes += [("note", text) for text in report.get("notes", [])]
    notes += [("note", f"{place}: {text}") for text, place in _grouped(_texts(result, "notes"))]
    if len(notes) > MAX_NOTES:
        notes[MAX_NOTES:] = [("note", f"and {len(notes) - MAX_NOTES} more notes, see --json")]
    return [(kind, f"{result.input}: {text}") for kind, text in lines + notes]


def _prims(result: BatchResult) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = report_of(result).get("prims", [])
    return found


def _texts(result: BatchResult, key: str) -> Iterable[tuple[dict[str, Any], str]]:
    """Texts about meshes without the path that they begin with."""
    for prim in _prims(result):
        for text in prim[key]:
            yield prim, text.removeprefix(f"{prim['path']}: ")


def _shortfalls(result: BatchResult) -> Iterable[tuple[dict[str, Any], str]]:
    """Goals that a mesh did not reach."""
    for prim in _prims(result):
        if prim["symmetry"] not in (None, "kept"):
            yield prim, f"not kept symmetric: {prim['symmetry']}"
        if prim["status"] == "simplified" and prim["stopped"] == "no legal collapse":
            yield prim, "stopped above its number of faces, no legal collapse is left"


def _grouped(entries: Iterable[tuple[dict[str, Any], str]], joint: str = "; ") -> list[tuple[str, str]]:
    """Texts, and the meshes that they are about: the first and how many more. Those about the same meshes are one."""
    paths: dict[str, dict[str, None]] = {}
    for prim, text in entries:
        level = f" ({prim['level']})" if prim.get("level") else ""
        paths.setdefault(text, {})[prim["path"] + level] = None
    texts: dict[tuple[str, ...], list[str]] = {}
    for text, found in paths.items():
        texts.setdefault(tuple(found), []).append(text)
    return [
        (joint.join(found), meshes[0] + (f" and {len(meshes) - 1} more" if len(meshes) > 1 else ""))
        for meshes, found in texts.items()
    ]
