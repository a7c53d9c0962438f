"""Contact sheets of USD files: what a file shows at several times, beside what another one shows."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from pxr import Usd

from warpqem.errors import OptionError, StageError
from warpqem.files.outputs import OutputFile
from warpqem.measure import distance_colors
from warpqem.measure.heatmap import COLOR_MAP
from warpqem.picture import View, caption, fit_view, render, tile, write_png
from warpqem.picture.look import Look
from warpqem.usd.checks.input_files import check_stage_outputs
from warpqem.usd.commands.level_stages import original_of_levels
from warpqem.usd.read.materials import Materials
from warpqem.usd.read.missing_textures import missing_lines, missing_textures
from warpqem.usd.read.normal_textures import NormalTextures
from warpqem.usd.read.time_codes import FrameRange
from warpqem.usd.read.variants import open_stages, select_variants
from warpqem.usd.read.world import WorldMeshes, chosen_times, limit_places

__all__ = ["RenderOptions", "render_sheet"]

Progress = Callable[[float, str], None]


# Of all pictures in a row: at some 20 bytes each, what a usual machine has memory for.
MAX_PIXELS = 2**27


@dataclass(frozen=True)
class RenderOptions:
    """How to draw.

    Attributes:
        pictures: Pictures in a row, at times that are spread evenly over the animation.
        frames: Time codes to draw from; None for all authored ones.
        prims: Prim paths; meshes at and below them are drawn. Empty for all.
        size: Width and height of one picture, in pixels.
        azimuth: Degrees about the up axis, see `warpqem.picture.View`.
        elevation: Degrees above the horizon.
        lines: Draw the edges.
        smooth: Shade over the edges that are not hard, instead of face by face.
        plain: One colour for all, instead of textures and display colours.
        heatmap: With a reference: a row of colours for the distance from it.
        device: Warp device; None for the default.
        variants: Variants to draw, `SET=NAME` or `/Prim/Path{SET=NAME}`, of each file that has them.
    """

    pictures: int = 4
    frames: FrameRange | None = None
    prims: tuple[str, ...] = ()
    size: tuple[int, int] = (480, 360)
    azimuth: float = 30.0
    elevation: float = 12.0
    lines: bool = False
    smooth: bool = True
    plain: bool = False
    heatmap: bool = False
    device: str | None = None
    variants: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse sheets without a picture."""
        if self.pictures < 1:
            raise OptionError(f"pictures {self.pictures}: expected at least 1")
        if min(self.size) < 1:
            raise OptionError(f"size {self.size[0]} x {self.size[1]}: expected at least one pixel")
        if self.size[0] * self.size[1] * self.pictures > MAX_PIXELS:
            pixels = f"{self.pictures} pictures of {self.size[0]} x {self.size[1]} pixels"
            raise OptionError(f"size: {pixels} are more than {MAX_PIXELS // 2**20} million in a row")


def render_sheet(
    input_path: str | os.PathLike[str],
    output_path: str | os.PathLike[str],
    options: RenderOptions,
    reference_path: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    warn: Callable[[str], None] | None = None,
) -> float | None:
    """Draw a file at several times as a PNG: a row of pictures; with a reference a row of it above, from the same view.

    Args:
        input_path: USD file.
        output_path: .png file; replaced if it exists.
        options: How to draw.
        reference_path: USD file to draw above it.
        progress: Called with the fraction done and what is being done.
        warn: Called with a line for each texture that is not shown.

    Returns:
        Distance of the brightest colour of the heat map, in % of the bounding-box diagonal; None without one.

    Raises:
        StageError: a file cannot be read or written.
        OptionError: an option or the output path is wrong.
        DeviceError: there is no such device.
    """
    if not os.fspath(output_path).lower().endswith(".png"):
        raise OptionError(f"output {output_path}: the suffix must be .png")
    if options.heatmap and reference_path is None:
        raise OptionError("`heatmap` needs a `reference`")
    paths = [path for path in (reference_path, input_path) if path is not None]
    stages = open_stages(paths)
    check_stage_outputs([OutputFile("output", output_path)], stages)
    both = zip(paths, stages, strict=True)
    stages = [original_of_levels(path, stage) or stage for path, stage in both]
    select_variants(stages, options.variants)
    both = zip(paths, stages, strict=True)
    drawn = [WorldMeshes(path, options.prims, varying=True, stage=stage) for path, stage in both]
    limit_places(drawn)
    times = _spread(chosen_times(drawn, options.frames), options)
    # Each time for itself: the topology may be another one.
    meshes = [[item.read(None if times is None else [time]) for time in times or [0.0]] for item in drawn]
    materials, textures = Materials(), NormalTextures()
    looks = [
        [_look(item, None if times is None else [time], options, materials, textures) for time in times or [0.0]]
        for item in drawn
    ]
    if warn is not None and not options.plain:
        for line in _not_shown(stages, materials):
            warn(line)
    rows, scale = _rows(meshes, looks, [item.name for item in drawn], options)
    views = _views(meshes, drawn[0].up, options)
    pictures = _pictures(rows, times, views, options, progress)
    try:
        write_png(tile(pictures, len(times or [None])), output_path)
    except OSError as error:
        raise StageError(f"{output_path}: cannot be written ({error.strerror or error})") from error
    return scale


def _not_shown(stages: Sequence[Usd.Stage], materials: Materials) -> list[str]:
    """A line for each texture that cannot be found, or that cannot be drawn for another reason."""
    missing = [missing_textures(stage) for stage in stages]
    named = {texture.path for textures in missing for texture in textures}
    others = [
        line for line in materials.left_out if not any(f": texture {path} is not shown" in line for path in named)
    ]
    return list(dict.fromkeys([*(line for textures in missing for line in missing_lines(textures)), *others]))


def _look(
    item: WorldMeshes,
    times: list[float] | None,
    options: RenderOptions,
    materials: Materials,
    textures: NormalTextures,
) -> Look:
    """Colours, textures and hard edges at a time; plain ones keep the edges."""
    look = item.look(times, materials, textures)
    if not options.plain:
        return look
    return replace(look, parts=[replace(part, texture=None) for part in look.parts], colors=None, textures=())


def _views(meshes: Sequence[_Meshes], up: str, options: RenderOptions) -> list[View]:
    """A view for each time, in whose middle the meshes of all files are, all of one scale."""
    width, height = options.size
    found = [
        fit_view(
            np.concatenate([points.reshape(-1, 3) for points, _ in frame]),
            azimuth=options.azimuth,
            elevation=options.elevation,
            up=up,
            aspect=width / height,
        )
        if any(points.size for points, _ in frame)
        else None
        for frame in zip(*meshes, strict=True)
    ]
    shown = [view for view in found if view is not None]
    # At a time at which nothing shows, any will do.
    empty = View(options.azimuth, options.elevation, (0.0, 0.0, 0.0), 1.0, up)
    tallest = max((view.height for view in shown), default=1.0)
    return [replace(view or empty, height=tallest) for view in found]


def _pictures(
    rows: Sequence[_Row],
    times: list[float] | None,
    views: Sequence[View],
    options: RenderOptions,
    progress: Progress | None,
) -> list[np.ndarray]:
    """The pictures of all rows, one row after another, each below its title and time."""
    pictures: list[np.ndarray] = []
    for row in rows:
        for frame, view in enumerate(views):
            if progress:
                progress(len(pictures) / (len(views) * len(rows)), row.title)
            picture = render(
                row.meshes[frame][0][0],
                row.meshes[frame][1],
                view,
                colors=None if row.colors is None else row.colors[frame],
                size=options.size,
                smooth=options.smooth,
                lines=options.lines and row.colors is None,
                look=row.looks[frame],
                device=options.device,
            )
            time = "" if times is None else f", time {times[frame]:g}"
            pictures.append(caption(picture, f"{row.title}{time}", row.bar))
    return pictures


# Points (1, V, 3) and faces (N, 3) at each time.
_Meshes = Sequence[tuple[npt.NDArray[np.float32], npt.NDArray[np.int32]]]


@dataclass(frozen=True)
class _Row:
    """What one row of pictures shows."""

    title: str
    meshes: _Meshes
    looks: Sequence[Look]
    colors: Sequence[npt.NDArray[np.float32]] | None = None
    bar: tuple[npt.NDArray[np.float64], str] | None = None


def _rows(
    meshes: Sequence[_Meshes], looks: Sequence[Sequence[Look]], names: list[str], options: RenderOptions
) -> tuple[list[_Row], float | None]:
    rows = [
        _Row(f"{name}, {_face_counts(item)} faces", item, look)
        for name, item, look in zip(names, meshes, looks, strict=True)
    ]
    if not options.heatmap:
        return rows, None
    # A time at which one of them shows nothing has no distances.
    pairs = [(*first, *second) for first, second in zip(*meshes, strict=True)]
    shown = [pair for pair in pairs if len(pair[1]) and len(pair[3])]
    scale = max((distance_colors(*pair, device=options.device)[1] for pair in shown), default=0.0)
    colors = [
        distance_colors(*pair, scale=scale or None, device=options.device)[0][0]
        if len(pair[1]) and len(pair[3])
        else np.zeros(pair[2].shape[1:], dtype=np.float32)
        for pair in pairs
    ]
    return [*rows, _Row("distance", meshes[1], looks[1], colors, (COLOR_MAP, f"{scale:.3g} %"))], scale


def _face_counts(meshes: _Meshes) -> str:
    least, most = min(len(faces) for _, faces in meshes), max(len(faces) for _, faces in meshes)
    return f"{most}" if least == most else f"{least} to {most}"


def _spread(times: list[float], options: RenderOptions) -> list[float] | None:
    """The times to draw; None for meshes that do not move."""
    if not times:
        return None
    chosen = np.unique(np.linspace(0, len(times) - 1, min(options.pictures, len(times))).round().astype(int))
    return [times[index] for index in chosen]
