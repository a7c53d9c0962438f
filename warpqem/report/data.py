"""What the page is handed: meshes as text, and the measures of each level."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from warpqem.arguments.json_types import Json
from warpqem.costs.motion_features import motion_features
from warpqem.errors import WarpqemError
from warpqem.measure import Comparison, compare, vertex_distances
from warpqem.measure.closest_points import ClosestPointSearch
from warpqem.measure.heatmap import COLOR_MAP
from warpqem.picture.look import Texture
from warpqem.report.content import Curve, Level, Report, Skeleton
from warpqem.report.encoding import Grid, encode
from warpqem.report.mesh_data import mesh_data, packed_textures
from warpqem.runtime.device import device_turn

__all__ = ["LARGEST_POSITIONS", "chosen_frames", "report_data", "scale_end"]

# Positions of a page take no more bytes than this before they are packed; the bundle and the rest add about 1 MB.
LARGEST_POSITIONS = 6 * 2**20
# A coordinate has 16 bits.
BYTES_PER_POINT = 6
# The meshes as a whole, with their faces.
LARGEST_MESHES = 2 * LARGEST_POSITIONS
BYTES_PER_FACE = 12
# Vertex, smoothing group, place on the texture and colour of what is drawn for a vertex.
BYTES_OF_LOOK = 15
# Five seconds show what moves, and each frame that is shown is measured too.
MAX_FRAMES = 120
# Distances in % of the diagonal that are rounding: double precision leaves some 1e-13.
NO_DISTANCE = 1e-9
# The scale of the colours ends here, as a share of the distances of all vertices in all frames: the few farthest would
# leave all others dark.
SCALE_QUANTILE = 0.99
# Times a power of ten. Each is three to five times a number of one digit, for its ticks.
SCALE_ENDS = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)

Progress = Callable[[float, str], None]


def chosen_frames(frame_count: int, point_count: int) -> range:
    """The frames of an animation that a page has room for, evenly spread: all, every second, every third, ...

    Args:
        frame_count: Frames that there are.
        point_count: Points of all meshes together.
    """
    room = max(2, min(MAX_FRAMES, LARGEST_POSITIONS // (BYTES_PER_POINT * max(point_count, 1))))
    return range(0, frame_count, -(-frame_count // room))


def report_data(report: Report, device: str | None = None, progress: Progress | None = None) -> dict[str, Json]:
    """Measure the levels and pack everything: plain dictionaries, lists, numbers, text and None, ready for JSON.

    Positions are rounded to 16 bits per component of the box around all of them.

    Args:
        report: what to show.
        device: Warp device; None for the default.
        progress: called with the fraction done and what is being done.

    Raises:
        MeshShapeError, NonFinitePointError, FaceIndexError, DegenerateMeshError: a mesh is none, or the numbers of
            frames differ.
        DeviceError: there is no such device.
    """
    progress = progress or (lambda fraction, text: None)
    original = np.asarray(report.points)
    original = original[None] if original.ndim == 2 else original
    levels = [
        replace(level, points=np.asarray(level.points).reshape(-1, *level.points.shape[-2:])) for level in report.levels
    ]
    grid = Grid.around(original, *(level.points for level in levels))
    notes = list(report.notes)
    shown = _with_room(
        [("The original", original, report.faces), *((v.name, v.points, v.faces) for v in levels)], notes
    )
    marked = np.array(list(report.markers.values()), dtype=np.int64)
    packed: list[dict[str, Any]] = []
    textures: list[Texture] = []
    labels = _features(original, report.faces, device)
    for index, level in enumerate(levels):
        start, share = index / len(levels), 1 / len(levels)

        def part(done: int, total: int, start: float = start, share: float = share, name: str = level.name) -> None:
            progress(start + share * done / total, f"measuring {name}")

        # Few points, so that every vertex can be asked.
        places = original[0, marked].astype(np.float64)
        nearest = [int(((level.points[0] - place) ** 2).sum(axis=1).argmin()) for place in places]
        found = _level_data(level, original, report, grid, labels, shown[index + 1], textures, device, part)
        packed.append({"markers": nearest, "joints": _used_joints(report.skeletons, level.used_joints)} | found)
    return {
        "title": report.title,
        "up": report.up,
        "framesPerSecond": report.frames_per_second,
        "times": list(report.times) if report.times is not None else list(range(1, len(original) + 1)),
        "grid": {"low": grid.low.tolist(), "step": grid.step},
        "colorMap": COLOR_MAP.tolist(),
        "markers": list(report.markers),
        "original": {
            **_counts(original, report.faces),
            "mesh": mesh_data(original, report.faces, grid, labels, look=report.look, textures=textures)
            if shown[0]
            else None,
            "markers": marked.tolist(),
        },
        "levels": packed,
        "heatEnd": scale_end([level.pop("heatEnd") for level in packed]),
        "textures": packed_textures(textures),
        "samples": packed[0]["measures"]["samples"] if packed else 0,
        "skeletons": [_skeleton_data(skeleton) for skeleton in report.skeletons],
        "curves": [_curve_data(curve) for curve in report.curves],
        "tables": [asdict(table) for table in report.tables],
        "notes": notes,
    }


def _skeleton_data(skeleton: Skeleton) -> dict[str, Any]:
    """A skeleton as the page decodes it, on a grid of its own: joints may be far from the mesh."""
    grid = Grid.around(skeleton.points)
    return {
        "name": skeleton.name,
        "joints": list(skeleton.joints),
        "parents": np.asarray(skeleton.parents).tolist(),
        "used": [joint in skeleton.used for joint in skeleton.joints],
        "grid": {"low": grid.low.tolist(), "step": grid.step},
        "points": encode(grid.round(skeleton.points), over_time=True),
    }


def _used_joints(skeletons: Sequence[Skeleton], used: Mapping[str, set[str]] | None) -> list[list[bool]]:
    """Of each skeleton, which of its joints move a level."""
    return [
        [joint in (skeleton.used if used is None else used.get(skeleton.name, set())) for joint in skeleton.joints]
        for skeleton in skeletons
    ]


def _curve_data(curve: Curve) -> dict[str, Any]:
    series = [{"name": name, "x": list(x), "y": list(y)} for name, x, y in curve.series]
    return {"title": curve.title, "unit": curve.unit, "xName": curve.x_name, "series": series}


def scale_end(ends: Sequence[float]) -> float:
    """Where one scale of distances for all levels ends: the next round number above the largest of theirs."""
    largest = max(ends, default=0.0)
    if largest <= NO_DISTANCE:
        return 0.0
    power = 10.0 ** np.floor(np.log10(largest))
    end = next(step * power for step in SCALE_ENDS if step * power >= largest * (1 - 1e-9))
    return float(f"{end:.3g}")


def _with_room(meshes: Sequence[tuple[str, np.ndarray, np.ndarray]], notes: list[str]) -> list[bool]:
    """Which meshes (name, points, faces) the page has room for; a note names each of the others.

    The last are the coarsest and come first: of what was simplified, most is seen.
    """
    room = LARGEST_MESHES
    shown = []
    for name, points, faces in reversed(meshes):
        per_vertex = points.shape[0] * BYTES_PER_POINT + BYTES_OF_LOOK
        size = points.shape[1] * per_vertex + len(faces) * BYTES_PER_FACE
        shown.append(size <= room)
        if shown[-1]:
            room -= size
        else:
            notes.append(f"{name} has {len(faces)} faces, more than this page has room for: measured, but not drawn.")
    return shown[::-1]


def _counts(points: np.ndarray, faces: np.ndarray) -> dict[str, int]:
    return {"frames": len(points), "vertices": points.shape[1], "faces": len(faces)}


def _features(points: np.ndarray, faces: np.ndarray, device: str | None) -> np.ndarray | None:
    """Motion feature of each vertex; None where nothing moves or the mesh is none that bends."""
    if len(points) < 2:
        return None
    try:
        label: np.ndarray = motion_features(points, faces, device=device).label
    except WarpqemError:
        return None
    return label if label.max(initial=-1) >= 0 else None


def _transferred(
    labels: np.ndarray, points: np.ndarray, faces: np.ndarray, new_points: np.ndarray, device: str | None
) -> np.ndarray:
    """Label of the vertex near each new point."""
    faces = np.asarray(faces, dtype=np.int64)
    middle, size = points.mean(axis=0, dtype=np.float64), float(np.ptp(points, axis=0).max()) or 1.0
    with device_turn(device) as used:
        search = ClosestPointSearch(faces, used, "reference")
        nearest = search.closest((points - middle) / size, (new_points - middle) / size, 0)
    return labels[faces[nearest.face, nearest.barycentric.argmax(axis=1)]]


def _level_data(
    level: Level,
    original: np.ndarray,
    report: Report,
    grid: Grid,
    labels: np.ndarray | None,
    shown: bool,
    textures: list[Texture],
    device: str | None,
    progress: Callable[[int, int], None],
) -> dict[str, Any]:
    meshes = (original, report.faces, level.points, level.faces)
    distance = vertex_distances(*meshes, device=device)
    own_labels = None if labels is None else _transferred(labels, original[0], report.faces, level.points[0], device)
    measures = _measures(compare(*meshes, device=device, progress=progress), report.thinned, level.measured or {})
    # Rounding alone is no distance.
    scale = None if distance.max(initial=0.0) > NO_DISTANCE else 0.0
    return {
        "name": level.name,
        **_counts(level.points, level.faces),
        "mesh": mesh_data(level.points, level.faces, grid, own_labels, distance, scale, level.look, textures)
        if shown
        else None,
        "heatEnd": float(np.quantile(distance, SCALE_QUANTILE)),
        "meshes": {name: dict(found) for name, found in level.meshes.items()},
        "measures": measures,
    }


def _measures(found: Comparison, thinned: bool, known: Mapping[str, Any]) -> dict[str, Any]:
    """The figures of a level; those that are known of all its frames take the place of those of the frames shown."""
    frames, figures = found.per_frame, {**found.to_dict(), **known}
    return {
        "rms": figures["rms"],
        "hausdorff": figures["hausdorff"],
        "mean": figures["mean"],
        "normals": figures["normal_deviation"],
        "flips": figures["flips"],
        "verdict": figures["verdict"],
        "reason": figures["reason"],
        "samples": figures["sample_count"],
        # Between frames that do not follow each other these say nothing.
        "jitter": None if thinned else found.jitter,
        "slide": None if thinned else found.slide,
        "slideP95": None if thinned else found.slide_p95,
        "edgeLength": found.edge_length_error,
        "perFrame": {
            name: _for_all_frames(getattr(frames, name), found)
            for name in ("rms", "hausdorff", "mean", "normal_deviation", "flips", "degenerate_faces")
        },
        "topology": asdict(found.test_topology),
        "originalTopology": asdict(found.reference_topology),
    }


def _for_all_frames(values: np.ndarray, found: Comparison) -> list[float | None]:
    """Errors of each frame as a page shows them; None where a mesh is collapsed, which has none."""
    shown: list[float | None] = [None] * (found.frame_count + len(found.collapsed_frames))
    for frame, value in zip(found.per_frame.frame.tolist(), values, strict=True):
        shown[frame] = float(f"{value:.4g}")
    return shown
