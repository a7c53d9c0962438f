"""Overviews of batches, with pictures of what was read and written."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain, count
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from warpqem.errors import StageError, WarpqemError
from warpqem.files.outputs import InputFile, OutputFile, check_outputs
from warpqem.measure.verdict import rank
from warpqem.picture import fit_view, render
from warpqem.report import write_report
from warpqem.report.overview import Asset, overview_page
from warpqem.report.page import check_page_path, save_page
from warpqem.usd.commands.report_page import coarsest_level, stage_report
from warpqem.usd.read.materials import Materials
from warpqem.usd.read.world import WorldMeshes, chosen_times, limit_places

__all__ = ["write_overview"]

Progress = Callable[[float, str], None]

# States of assets, see `warpqem.BatchResult`.
FAILED, PARTIAL = "failed", "partial"
# Width and height of a picture.
SIZE = (320, 240)
# Reading two files takes long beside drawing them, and the page is to stay below some MB.
MAX_PICTURES = 400
# Each asset has a report of its own, which takes some seconds and some MB: that many of the worst.
MAX_PAGES = 40
# Of the folder beside the overview.
PAGES = "_pages"


def write_overview(
    path: str | os.PathLike[str],
    results: Sequence[dict[str, Any]],
    prims: Sequence[str] = (),
    device: str | None = None,
    progress: Progress | None = None,
) -> None:
    """Write an overview of a batch as one HTML file, and beside it a folder with a report on each asset.

    Args:
        path: .html file; replaced if it exists. The folder is called as this, with `PAGES` instead of the suffix.
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
    pages = _Pages(Path(path), prims, device)
    for index, result in enumerate(ordered):
        if progress:
            progress(index / len(ordered), f"drawing {result['input']}")
        pictures: list[np.ndarray] = []
        message = result["message"] or ""
        name = os.path.relpath(os.path.abspath(result["input"]), folder)
        page = ""
        if result["status"] != FAILED and drawn < MAX_PICTURES:
            drawn += 1
            try:
                pictures = _pictures(result["input"], _outputs(result)[-1], prims, device)
            except WarpqemError as error:
                message = " ".join(part for part in (message, f"not drawn: {error}") if part)
        if pictures and drawn <= MAX_PAGES:
            try:
                page = pages.write(name, result)
            except WarpqemError as error:
                message = " ".join(part for part in (message, f"no report of its own: {error}") if part)
        assets.append(replace(_asset(name, result, message, pictures, Path(path)), page=page))
    done = sum(result["status"] in ("done", "skipped") for result in ordered)
    notes = [f"Inputs are in {folder}."]
    notes += [
        "Pictures show the middle of each animation, before and after. Errors are the largest of a mesh, in % of its "
        "diagonal; flips are faces a frame of all meshes together. The worst come first."
    ]
    if drawn == MAX_PICTURES < len(ordered):
        notes.append(f"The first {MAX_PICTURES} are drawn.")
    if drawn > MAX_PAGES:
        notes.append(f"The first {MAX_PAGES} have a report of their own.")
    save_page(path, overview_page(f"{done} of {len(ordered)} assets are done", assets, notes))


class _Pages:
    """Reports on single assets, in a folder beside the overview."""

    def __init__(self, overview: Path, prims: Sequence[str], device: str | None) -> None:
        self._folder = overview.with_name(overview.stem + PAGES)
        self._prims, self._device = prims, device
        self._taken: set[str] = set()

    def write(self, name: str, result: dict[str, Any]) -> str:
        """Write the report on one asset; its address from the overview.

        Raises:
            WarpqemError: one of the files cannot be read or written.
        """
        outputs = _outputs(result)
        report = stage_report(result["input"], outputs[-1], self._prims)
        errors = [prim for prim in (result["report"] or {}).get("prims", []) if prim.get("measured")]
        report = replace(report, levels=[replace(one, meshes=_of_level(errors, one.name)) for one in report.levels])
        stem = name.replace(os.sep, "_")
        numbered = (f"{stem}_{number}" for number in count(2))
        unique = next(text for text in chain([stem], numbered) if text not in self._taken)
        self._taken.add(unique)
        try:
            self._folder.mkdir(exist_ok=True)
        except OSError as error:
            raise StageError(f"{self._folder}: cannot be made ({error.strerror or error})") from error
        target = self._folder / f"{unique}.html"
        check_outputs([OutputFile("report", target)], _files_of(result))
        write_report(target, report, self._device)
        return _address(f"{self._folder.name}{os.sep}{unique}.html")


def _of_level(prims: Sequence[dict[str, Any]], level: str) -> dict[str, dict[str, Any]]:
    """Verdict and errors of the meshes of a level, by path."""
    names = ("verdict", "reason", "rms", "hausdorff")
    return {
        prim["path"]: {name: prim["measured"][name] for name in names}
        for prim in prims
        if prim.get("level") in (None, level)
    }


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
    time = [times[len(times) // 2]] if times else None
    shapes = [item.read(time) for item in meshes]
    view = fit_view(shapes[0][0], up=meshes[0].up, aspect=SIZE[0] / SIZE[1])
    materials = Materials()
    return [
        render(points[0], faces, view, size=SIZE, smooth=True, look=item.look(time, materials), device=device)
        for item, (points, faces) in zip(meshes, shapes, strict=True)
    ]
