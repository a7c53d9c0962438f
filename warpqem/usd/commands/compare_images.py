"""Compare what two files look like: pictures of both from the same views, by the project's own ray caster."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import Usd

from warpqem.errors import DeviceError, OptionError, StageError, WarpqemError
from warpqem.files.outputs import OutputFile, named_outputs
from warpqem.picture.images import IMAGE_FRAMES, IMAGE_SIZE, ImagePair, ImageScore, compare_images
from warpqem.picture.sheet import caption, tile, write_png
from warpqem.usd.checks.input_files import check_stage_outputs
from warpqem.usd.commands.compare import CompareOptions
from warpqem.usd.commands.level_stages import level_stages, original_of_levels
from warpqem.usd.read.materials import Materials
from warpqem.usd.read.normal_textures import NormalTextures
from warpqem.usd.read.open_stage import open_stage
from warpqem.usd.read.variants import select_variants
from warpqem.usd.read.world import WorldMeshes, chosen_times, limit_places

__all__ = ["ImageReport", "check_sheet_path", "compare_stage_images"]

Progress = Callable[[float, str], None]


@dataclass
class ImageReport:
    """How alike pictures of two files are.

    Attributes:
        times: Time codes that were drawn; None for files that do not move.
        score: The measures; None where they failed.
        message: Why they failed.
        level: Name of the level of detail, with `CompareOptions.all_lods`; else None.
    """

    times: list[float] | None = None
    score: ImageScore | None = None
    message: str | None = None
    level: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain dictionaries, lists, numbers and None, ready for JSON."""
        score = None if self.score is None else self.score.to_dict()
        return {"level": self.level, "times": self.times, "message": self.message, "score": score}


def check_sheet_path(path: str | os.PathLike[str]) -> None:
    """Raise an OptionError for a sheet that is no .png file."""
    if not os.fspath(path).lower().endswith(".png"):
        raise OptionError(f"image sheet {path}: the suffix must be .png")


def compare_stage_images(
    reference_path: str | os.PathLike[str],
    test_path: str | os.PathLike[str],
    options: CompareOptions,
    progress: Progress | None = None,
    *,
    sheet: str | os.PathLike[str] | None = None,
    size: int = IMAGE_SIZE,
    other_outputs: Sequence[OutputFile] = (),
) -> list[ImageReport]:
    """Draw all meshes that two files show, in world space, and compare the pictures.

    In the first, the middle and the last of the frames, each from the four views of
    `warpqem.picture.compare_images`. Meshes are shaded by their normals as `warpqem.usd.read.shading_normals` has them,
    and show where they are visible, at every place of an instance. One that only one of the files has is a difference.

    Args:
        reference_path: USD file.
        test_path: USD file.
        options: What to draw: `frames`, `prims`, `variants`, `all_lods` and `device` of it.
        progress: Called with the fraction done and what is being done.
        sheet: .png file to write the pictures to: of each view both files and their difference, eight times as strong.
        size: Pixels along either side of a picture.
        other_outputs: What else the caller is going to write; see `warpqem.usd.simplify_stage`.

    Returns:
        One report, with `all_lods` one for each level.

    Raises:
        StageError: a file cannot be opened, or the sheet cannot be written.
        OptionError: an option or an output path is wrong.
        DeviceError: there is no such device.
    """
    if sheet is not None:
        check_sheet_path(sheet)
    stages = [open_stage(path) for path in (reference_path, test_path)]
    check_stage_outputs([*named_outputs({"image sheet": sheet}), *other_outputs], stages)
    if options.all_lods:
        tests: list[tuple[str | None, Usd.Stage]] = [*level_stages(test_path)]
    else:
        alone = None if original_of_levels(reference_path, stages[0]) else original_of_levels(test_path, stages[1])
        tests = [(None, alone or stages[1])]
    select_variants([stages[0], *(stage for _, stage in tests)], options.variants)
    rows: list[np.ndarray] = []
    reports = []
    for number, (level, stage) in enumerate(tests):
        report = ImageReport(level=level)
        reports.append(report)

        def part(fraction: float, number: int = number) -> None:
            if progress is not None:
                progress((number + fraction) / len(tests), "pictures")

        pair = (reference_path, stages[0]), (test_path, stage)
        try:
            _compare(report, pair, options, size, part, rows if sheet is not None else None)
        except WarpqemError as error:
            if isinstance(error, (OptionError, DeviceError)):
                raise
            report.message = f"pictures: {error}"
    if sheet is not None and rows:
        try:
            write_png(tile(rows, 1), sheet)
        except OSError as error:
            raise StageError(f"{sheet}: cannot be written ({error.strerror or error})") from error
    return reports


def _compare(
    report: ImageReport,
    files: Sequence[tuple[str | os.PathLike[str], Usd.Stage]],
    options: CompareOptions,
    size: int,
    progress: Callable[[float], None],
    rows: list[np.ndarray] | None,
) -> None:
    meshes = [WorldMeshes(path, options.prims, varying=True, stage=stage) for path, stage in files]
    limit_places(meshes)
    times = chosen_times(meshes, options.frames)
    if times:
        chosen = np.unique(np.linspace(0, len(times) - 1, IMAGE_FRAMES).round().astype(int))
        report.times = [times[index] for index in chosen]
    codes: list[float | None] = [None] if report.times is None else [*report.times]
    materials, textures = Materials(), NormalTextures()
    sides = [[item.shown(code, materials, textures) for code in codes] for item in meshes]
    name = "" if report.level is None else f"{report.level}, "
    done = 0

    def drawn(pair: ImagePair) -> None:
        nonlocal done
        done += 1
        progress(done / (len(codes) * 4))
        if rows is not None:
            code = codes[pair.frame]
            time = "" if code is None else f"time {code:g}, "
            rows.append(_row(pair, f"{name}{time}from {pair.view.azimuth:g} degrees"))

    report.score = compare_images(*sides, up=meshes[0].up, size=size, device=options.device, drawn=drawn)


# How much stronger differences are drawn than they are: one of 32 steps of 255 is white.
STRENGTH = 8


def _row(pair: ImagePair, text: str) -> np.ndarray:
    """Both pictures of a view and their difference, of one colour, then with colours and textures."""
    pictures = []
    for kind in ("gray", "textured"):
        first, second = getattr(pair.reference, kind), getattr(pair.test, kind)
        apart = np.abs(first.astype(np.int64) - second.astype(np.int64)).max(axis=2, keepdims=True)
        strong = np.broadcast_to(np.minimum(STRENGTH * apart, 255), first.shape).astype(np.uint8)
        titles = (f"reference, {text}", "test", f"difference x {STRENGTH}")
        both = zip((first, second, strong), titles, strict=True)
        pictures += [caption(picture, title) for picture, title in both]
    return tile(pictures, len(pictures))
