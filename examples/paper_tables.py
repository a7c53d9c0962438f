"""The tables of the source papers, on the shipped scenes.

python examples/paper_tables.py [TABLE...]

levels        any level from one run, and its error (progressive deforming meshes)
stretch       vertices where the surface stretches most (the same: deformation oriented decimation)
morph         ten levels of a face with and without weights (surface simplification guided by morph-targets)
rest          the same with weights for what rests but matters (its outlook)
face          feature points that survive (multiresolution facial animation)
retarget      expressions carried to levels (the same; expression cloning, Noh & Neumann 2001)
articulated   poses that the fit of a skin has not seen (simplification of articulated meshes)
influences    the same with fewer joints for each vertex
joints        vertices that joints keep (animated meshes with motion features, AQEM)
reductions    errors at the reductions of that paper, by the weights of joints
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

sys.path.insert(0, str(Path(__file__).parent.parent))  # the scenes are not part of the installed package

import warpqem
from scenes import cape, head, quadruped
from scenes.scene import Scene
from warpqem.face import FaceMesh
from warpqem.face import retarget as retarget_expressions
from warpqem.measure import compare, vertex_distances
from warpqem.usd import CompareOptions, FrameRange, SimplifyOptions, compare_stages, simplify_stage

# The head of surface simplification guided by morph-targets: 3128 triangles to 878.
PAPER_RATIO = 878 / 3128
SCENES = Path(__file__).parent.parent / "scenes"
# What the papers order by: quadrics of the input, and no last fit of the whole surface.
QUALITY: Literal["fast"] = "fast"
# Shares of the faces that skins are fitted at.
SKIN_RATIOS = (0.25, 0.1, 0.05)
# Reductions of the paper on motion features, in % of the faces.
REDUCTIONS = (39, 58, 68, 86)
# Shares of the faces of a head with targets, from the finest level to the coarsest.
MORPH_RATIOS = tuple(float(ratio) for ratio in np.geomspace(0.6, 0.03, 10))


@cache
def _gallop() -> Scene:
    return quadruped.build()


@cache
def _head() -> Scene:
    return head.build()


def levels() -> Table:
    """Levels of a gallop from one progressive mesh."""
    scene = _gallop()
    points = scene.baked()
    mesh = warpqem.build_progressive(points, scene.faces, quality=QUALITY)
    table = _table("A gallop at any level, from one run", "faces", "vertices", "error %", "RMS %")
    for ratio in (0.5, 0.25, 0.1, 0.05, 0.02, 0.01):
        level = mesh.level(mesh.splits_for(ratio=ratio))
        rms = compare(points, scene.faces, level.points, level.faces, samples=4000).rms
        _add(table, len(level.faces), level.points.shape[1], level.error, rms)
    return table


def stretch() -> Table:
    """Share of the vertices that lie in the fifth of the surface that stretches most."""
    scenes = {"gallop": _gallop(), "cape": cape.build(), "head": _head()}
    table = _table("Vertices in the fifth of the surface that stretches most, %", "clip", "faces", "DSD", "DOD")
    for name, scene in scenes.items():
        points = scene.baked()
        inside = stretching_fifth(points, scene.faces)
        for ratio in (0.25, 0.1, 0.05):
            results = [
                warpqem.simplify(points, scene.faces, ratio=ratio, metric=metric, quality=QUALITY)
                for metric in ("dsd", "dod")
            ]
            shares = [100.0 * _share_inside(result, inside) for result in results]
            _add(table, name, len(results[0].faces), *shares)
    return table


def stretching_fifth(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V,) bool, vertices with most of their area among the faces whose edges change most, a fifth of the area.

    A face changes by the mean step of its edges' lengths from frame to frame, relative to the mean length.
    """
    x = points.astype(np.float64)
    sides = x[:, np.roll(faces, -1, axis=1)] - x[:, faces]
    length = np.linalg.norm(sides, axis=3)
    change = (np.abs(np.diff(length, axis=0)).mean(axis=0) / length.mean(axis=0)).mean(axis=1)
    area = 0.5 * np.linalg.norm(np.cross(sides[:, :, 0], sides[:, :, 1]), axis=2).mean(axis=0)
    order = np.argsort(-change, kind="stable")
    inside = np.zeros(len(faces), dtype=bool)
    inside[order[np.cumsum(area[order]) <= 0.2 * area.sum()]] = True
    corner_area, corner_inside = np.repeat(area, 3), np.repeat(inside, 3)
    around = np.bincount(faces.ravel(), corner_area, minlength=points.shape[1])
    within = np.bincount(faces.ravel(), corner_area * corner_inside, minlength=points.shape[1])
    return within > 0.5 * around


def _share_inside(result: warpqem.SimplifiedMesh, inside: np.ndarray) -> float:
    """Mean over the vertices left of the part of the vertices they stand for that is inside."""
    count = result.points.shape[1]
    kept = result.vertex_map >= 0
    of_all = np.bincount(result.vertex_map[kept], minlength=count)
    return float((np.bincount(result.vertex_map[kept], inside[kept], minlength=count) / of_all).mean())


def morph() -> Table:
    """Ten levels of a head with blend shapes, by the first shape alone and by all, with the weights and without."""
    scene = _head()
    frames = shapes_of(scene)
    weights = warpqem.costs.morph_weights(frames[0], frames[1:], method="thirds")
    moved = weights >= 1.0
    table = _table("A head and its targets: the most animated third, mean distance %", "faces", *MORPH_WAYS)
    columns = []
    for options in MORPH_WAYS.values():
        scale = weights if options["weighted"] else None
        levels = warpqem.simplify_levels(
            frames, scene.faces, ratios=MORPH_RATIOS, metric=options["metric"], quadric_scale=scale, quality=QUALITY
        )
        columns.append([(len(level.faces), _mean_distance(frames, scene.faces, moved, level)) for level in levels])
    for cells in zip(*columns, strict=True):
        _add(table, cells[0][0], *(distance for _, distance in cells))
    return table


# Like beside like: what decides the order, and whether the quadrics of what moves are weighted up.
MORPH_WAYS = {
    "qem": {"metric": "qem", "weighted": False},
    "qem, thirds": {"metric": "qem", "weighted": True},
    "dsd": {"metric": "dsd", "weighted": False},
    "dsd, thirds": {"metric": "dsd", "weighted": True},
}


def shapes_of(scene: Scene) -> np.ndarray:
    """(1 + T, V, 3), the neutral shape of a scene and its targets."""
    rest = scene.points.astype(np.float64)
    return np.stack([rest, *(_with_shape(rest, shape) for shape in scene.blend.shapes)])


def _weights_around(faces: np.ndarray, vertices: np.ndarray, vertex_count: int) -> np.ndarray:
    """Ten at some vertices, falling to one beyond four edges: as far as wings of noses and rims of ears."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    graph = coo_array((np.ones(len(ends)), ends.T), shape=(vertex_count, vertex_count)).tocsr()
    away = dijkstra(graph, directed=False, indices=vertices, unweighted=True, min_only=True, limit=4)
    return 1.0 + 9.0 * (1.0 - np.minimum(away, 5.0) / 5.0)


def rest() -> Table:
    """Weights for what moves and for what rests but matters: errors where a head moves, at nose and ears, of all."""
    scene = _head()
    frames = shapes_of(scene)
    neutral, height = frames[0], np.ptp(frames[0][:, 1])
    thirds = warpqem.costs.morph_weights(neutral, frames[1:], method="thirds")
    found = warpqem.face.facial_features(frames[:1], scene.faces)
    features = _weights_around(scene.faces, found.indices, len(neutral))
    marks = neutral[[vertex for name, vertex in found.vertices.items() if name.startswith(("nose", "head_side"))]]
    moved = thirds >= 1.0
    # A twentieth of the head's height around them is what they look like.
    resting = (np.linalg.norm(neutral[:, None] - marks, axis=2).min(axis=1) < 0.05 * height) & ~moved
    table = _table("A head and its targets, mean distance %", "faces", "weights", "moves most", "nose and ears", "all")
    scales = {"none": None, "thirds": thirds, "features": features, "both": thirds * features}
    for ratio in (PAPER_RATIO, 0.1):
        for name, scale in scales.items():
            level = warpqem.simplify(frames, scene.faces, ratio=ratio, quadric_scale=scale, quality=QUALITY)
            parts = (moved, resting, np.ones(len(neutral), dtype=bool))
            distances = [_mean_distance(frames, scene.faces, part, level) for part in parts]
            _add(table, len(level.faces), name, *distances)
    return table


# Faces of the levels of the face paper, of a head of 2000.
FACE_LEVELS = (1420, 1120, 820, 620)


@cache
def _head_of_2000() -> tuple[np.ndarray, np.ndarray, warpqem.face.FacialFeatures]:
    """Every fourth frame of the head at 2000 faces, as the paper begins with, and its feature points there."""
    scene = _head()
    points = scene.baked()
    whole = warpqem.face.facial_features(points, scene.faces)
    small = warpqem.simplify(points[::4], scene.faces, target_faces=2000, locked=whole.indices, quality=QUALITY)
    return small.points, small.faces, whole.moved(small.vertex_map)


def _face_levels(count: int) -> dict[str, warpqem.SimplifiedMesh]:
    """A level of that head by equation 1 alone, by the default, and by plain quadrics."""
    points, faces, features = _head_of_2000()
    kinds = {
        "equation 1": {"metric": "face", "face": warpqem.face.FaceProtection(features, keep=False)},
        "default": {"metric": "face", "face": warpqem.face.FaceProtection(features)},
        "QEM": {"metric": "qem"},
    }
    return {
        name: warpqem.simplify(points, faces, target_faces=count, quality=QUALITY, **kind)
        for name, kind in kinds.items()
    }


def face() -> Table:
    """Feature points that are still vertices in all frames, and the RMS of the levels of the paper."""
    points, faces, features = _head_of_2000()
    names = ("equation 1", "default", "QEM")
    table = _table(
        f"Of {len(features.indices)} feature points of a face survive, and RMS %",
        "faces",
        *(f"{name}: {what}" for name in names for what in ("points", "RMS")),
    )
    near = 0.01 * float(features.face_height(points[0]) or 0.0)
    for count in FACE_LEVELS:
        row: list[object] = []
        for level in _face_levels(count).values():
            rms = compare(points, faces, level.points, level.faces, samples=4000).rms
            row += [_survivors(points[:, features.indices], level, near), rms]
        _add(table, count, *row)
    return table


def retarget() -> Table:
    """Expressions of the head carried to its levels (expression cloning): distance from the true motion, RMS %.

    The feature points of a plain level are its nearest vertices, as it has lost its own.
    """
    points, faces, features = _head_of_2000()
    source = FaceMesh(points[0], faces, features)
    table = _table("Expressions carried to the levels of a face: RMS from the true motion, %", "faces", "face", "QEM")
    for count in FACE_LEVELS:
        row: list[object] = []
        for name in ("default", "QEM"):
            level = _face_levels(count)[name]
            away = np.linalg.norm(level.points[0] - points[0, features.indices][:, None], axis=2)
            own = replace(features, vertices=dict(zip(features.names, away.argmin(axis=1).tolist(), strict=True)))
            moved = retarget_expressions(source, FaceMesh(level.points[0], level.faces, own), points)
            row.append(compare(points, faces, moved.points, level.faces, samples=4000).rms)
        _add(table, count, *row)
    return table


def articulated() -> Table:
    """Errors of a skinned quadruped on the half of its poses that was not fitted, in % of the diagonal."""
    kinds = {"fitted": {}, "interpolated": {"skin_fit": False}, "pulled back": {"pose_independent": True}}
    return _unseen_poses("A skinned gallop on poses that were not fitted: RMS %", kinds)


def influences() -> Table:
    """The same for skins of at most 11, 5 and 3 joints a vertex; the paper shows 11 and 5."""
    kinds = {f"{count} joints": {"influences": count} for count in (11, 5, 3)}
    return _unseen_poses("A skinned gallop with fewer joints a vertex, on poses that were not fitted: RMS %", kinds)


def _unseen_poses(title: str, kinds: dict[str, dict[str, object]]) -> Table:
    """RMS on the second half of the poses for some options, fitted to the first half."""
    scene = SCENES / "quadruped_gallop.usdc"
    table = _table(title, "share", *kinds)
    with tempfile.TemporaryDirectory() as folder:
        for ratio in SKIN_RATIOS:
            errors = []
            for options in kinds.values():
                output = Path(folder) / "out.usdc"
                simplify_stage(
                    scene, output, SimplifyOptions(ratio=ratio, quality=QUALITY, frames=FrameRange(1, 24), **options)
                )
                [pair] = compare_stages(scene, output, CompareOptions(samples=4000, frames=FrameRange(25, 48)))
                errors.append(pair.comparison.rms)
            _add(table, ratio, *errors)
    return table


def joints() -> Table:
    """Vertices in the joints of a quadruped that are left at a tenth of its faces."""
    scene = _gallop()
    points = scene.baked()
    features = warpqem.motion_features(points, scene.faces)
    inside = features.label >= 0
    table = _table("Vertices left inside motion features, at a tenth of the faces", "metric", "inside", "of all")
    for metric in ("qem", "dsd", "dod", "aqem"):
        result = warpqem.simplify(points, scene.faces, ratio=0.1, metric=metric, quality=QUALITY)
        _add(table, metric, len(np.unique(result.vertex_map[inside])), result.points.shape[1])
    return table


def reductions() -> Table:
    """Errors of a gallop, and vertices in its joints, with the weights of the paper and with milder ones."""
    scene = _gallop()
    points = scene.baked()
    inside = warpqem.motion_features(points, scene.faces).label >= 0
    ways = {"dsd": {}, "aqem": {"metric": "aqem"}}
    ways["log"] = {"metric": "aqem", "motion": warpqem.costs.MotionWeighting(weight="log")}
    columns = [f"{name} {figure}" for name in ways for figure in ("RMS %", "in joints")]
    table = _table("A gallop at the reductions of the paper", "reduction %", "faces", *columns)
    for reduction in REDUCTIONS:
        cells: list[object] = []
        for options in ways.values():
            result = warpqem.simplify(points, scene.faces, ratio=1 - reduction / 100, quality=QUALITY, **options)
            rms = compare(points, scene.faces, result.points, result.faces, samples=4000, frames=8).rms
            cells += [rms, len(np.unique(result.vertex_map[inside]))]
        _add(table, reduction, len(result.faces), *cells)
    return table


TABLES: dict[str, Callable[[], Table]] = {
    "levels": levels,
    "stretch": stretch,
    "morph": morph,
    "rest": rest,
    "face": face,
    "retarget": retarget,
    "articulated": articulated,
    "influences": influences,
    "joints": joints,
    "reductions": reductions,
}


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title)
    for name in columns:
        table.add_column(name, justify="right")
    return table


def _add(table: Table, *values: object) -> None:
    table.add_row(*(f"{value:.4f}" if isinstance(value, float) else str(value) for value in values))


def _with_shape(rest: np.ndarray, shape: object) -> np.ndarray:
    points = rest.copy()
    points[shape.vertices] += shape.offsets
    return points


def _mean_distance(frames: np.ndarray, faces: np.ndarray, moved: np.ndarray, level: warpqem.SimplifiedMesh) -> float:
    """Mean over all frames of the distance from the moved vertices to the level, in % of the diagonal."""
    return float(vertex_distances(level.points, level.faces, frames, faces)[:, moved].mean())


def _survivors(points: np.ndarray, level: warpqem.SimplifiedMesh, within: float) -> int:
    """How many of n points (F, n, 3) have one vertex of the level that is so near in all frames."""
    away = np.linalg.norm(level.points[:, None] - points[:, :, None], axis=3).max(axis=0).min(axis=1)
    return int((away <= within).sum())


def main(names: list[str]) -> None:
    """Print the tables."""
    for name in names or list(TABLES):
        Console().print(TABLES[name]())


if __name__ == "__main__":
    main(sys.argv[1:])
