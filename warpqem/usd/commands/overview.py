"""Overviews of batches, with pictures of what was read and written."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from warpqem.errors import WarpqemError
from warpqem.files.outputs import InputFile, OutputFile, check_outputs
from warpqem.measure.verdict import rank
from warpqem.picture import fit_view, render
from warpqem.report.overview import Asset, overview_page
from warpqem.report.page import check_page_path, save_page
from warpqem.usd.commands.report_page import coarsest_level
from warpqem.usd.read.world import WorldMeshes, chosen_times, limit_places

__all__ = ["write_overview"]

Progress = Callable[[float, str], None]

# States of assets, see `warpqem.BatchResult`.
FAILED, PARTIAL = "failed", "partial"
# Width and height of a picture.
SIZE = (200, 150)
# Reading two files takes long beside drawing them, and the page is to stay below some MB.
MAX_PICTURES = 400


def write_overview(
    path: str | os.PathLike[str],
    results: Sequence[dict[str, Any]],
    prims: Sequence[str] = (),
    device: str | None = None,
    progress: Progress | None = None,
) -> None:
    """Write an overview of a batch as one HTML file.

    Args:
        path: .html file; replaced if it exists.
        results: What came of each asset, see `warpqem.BatchResult.to_dict`.
        prims: Prim paths; meshes at and below them are drawn. Empty for all.
        device: Warp device; None for the default.
        progress: Called with the fraction done and what is being done.

    Raises:
        OptionError: the suffix of `path` is another one, or it is a file that an asset needs or was written to.
        StageError: the page cannot be written.
    """
    check_page_path(path)
    check_outputs([OutputFile("report", path)], (file for result in results for file in _files_of(result)))
    ordered = sorted(results, key=lambda result: (_badness(result), str(result["input"])))
    folder = os.path.commonpath([os.path.dirname(os.path.abspath(result["input"])) for result in ordered] or [os.sep])
    assets = []
    drawn = 0
    for index, result in enumerate(ordered):
        if progress:
            progress(index / len(ordered), f"drawing {result['input']}")
        pictures: list[np.ndarray] = []
        message = result["message"] or ""
        if result["status"] != FAILED and drawn < MAX_PICTURES:
            drawn += 1
            try:
                pictures = _pictures(result["input"], _outputs(result)[-1], prims, device)
            except WarpqemError as error:
                message = " ".join(part for part in (message, f"not drawn: {error}") if part)
        name = os.path.relpath(os.path.abspath(result["input"]), folder)
        assets.append(_asset(name, result, message, pictures, Path(path)))
    done = sum(result["status"] in ("done", "skipped") for result in ordered)
    notes = [f"Inputs are in {folder}."]
    notes += [
        "Pictures show the middle of each animation, before and after. Errors are the largest of a mesh, in % of its "
        "diagonal; flips are faces a frame of all meshes together. The worst come first."
    ]
    if drawn == MAX_PICTURES < len(ordered):
        notes.append(f"The first {MAX_PICTURES} are drawn.")
    save_page(path, overview_page(f"{done} of {len(ordered)} assets are done", assets, notes))


def _badness(result: dict[str, Any]) -> tuple[int, tuple[int, float]]:
    """What assets are sorted by, the worst first: what failed, then by the worst mesh."""
    measured = [prim["measured"] for prim in (result["report"] or {}).get("prims", []) if prim.get("measured")]
    if result["status"] in (FAILED, PARTIAL):
        return (0 if result["status"] == FAILED else 1), (0, 0.0)
    ranks = [rank(found["verdict"], found["hausdorff"]) for found in measured]
    return (2, min(ranks)) if ranks else (3, (0, 0.0))


def _files_of(result: dict[str, Any]) -> list[InputFile]:
    """The output of an asset, its input, and the files that this is known to need."""
    needed = (result.get("fingerprint") or {}).get("files", {})
    outputs = [InputFile(path, f"the output for {result['input']}") for path in _outputs(result)]
    return outputs + [InputFile(file, f"a file that {result['input']} needs") for file in (result["input"], *needed)]


def _outputs(result: dict[str, Any]) -> list[str]:
    """The files of an asset, the coarsest level last."""
    return (result["report"] or {}).get("outputs") or [result["output"]]


def _asset(name: str, result: dict[str, Any], message: str, pictures: Sequence[np.ndarray], page: Path) -> Asset:
    measured = [prim["measured"] for prim in (result["report"] or {}).get("prims", []) if prim.get("measured")]
    worst = min(measured, key=lambda found: rank(found["verdict"], found["hausdorff"]), default=None)
    written = result["status"] != "failed"
    return Asset(
        name=name,
        status=result["status"],
        faces=result["faces"],
        faces_after=result["faces_after"],
        verdict="" if worst is None else worst["verdict"],
        reason="" if worst is None else worst["reason"],
        rms=max((found["rms"] for found in measured), default=None),
        hausdorff=max((found["hausdorff"] for found in measured), default=None),
        flips=sum(found["flips"] for found in measured) if measured else None,
        seconds=round(result["seconds"], 2),
        message=message,
        pictures=pictures,
        link=_address(os.path.relpath(_outputs(result)[0], page.resolve().parent)) if written else "",
    )


def _address(path: str) -> str:
    """A relative path as an address; a name need be no text."""
    return quote(os.fsencode(path.replace(os.sep, "/")))


def _pictures(before: str, after: str, prims: Sequence[str], device: str | None) -> list[np.ndarray]:
    meshes = [WorldMeshes(before, prims), coarsest_level(after, prims)]
    limit_places(meshes)
    times = chosen_times(meshes)
    shapes = [item.read([times[len(times) // 2]] if times else None) for item in meshes]
    view = fit_view(shapes[0][0], up=meshes[0].up, aspect=SIZE[0] / SIZE[1])
    return [render(points[0], faces, view, size=SIZE, device=device) for points, faces in shapes]
