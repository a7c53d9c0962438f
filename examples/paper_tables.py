"""The tables of the source papers, on the shipped scenes.

python examples/paper_tables.py [levels] [morph] [face] [retarget] [articulated] [influences] [joints]

levels        any level from one run, and its error (progressive deforming meshes)
morph         ten levels of a face with and without weights (morph-target-based surface simplification)
face          feature points that survive (multiresolution facial animation)
retarget      expressions carried to levels (the same; expression cloning, Noh & Neumann 2001)
articulated   poses that the fit of a skin has not seen (simplification of articulated meshes)
influences    the same with fewer joints for each vertex
joints        vertices that joints keep (animated meshes with motion features, AQEM)
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parent.parent))  # the scenes are not part of the installed package

import warpqem
from scenes import head, quadruped
from scenes.scene import Scene
from warpqem.face import FaceMesh
from warpqem.face import retarget as carry_expressions
from warpqem.measure import compare, vertex_distances
from warpqem.usd import CompareOptions, FrameRange, SimplifyOptions, compare_stages, simplify_stage

SCENES = Path(__file__).parent.parent / "scenes"
# Shares of the faces that skins are fitted at.
SKIN_RATIOS = (0.25, 0.1, 0.05)


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
    mesh = warpqem.build_progressive(points, scene.faces)
    table = _table("A gallop at any level, from one run", "faces", "vertices", "error %", "RMS %")
    for ratio in (0.5, 0.25, 0.1, 0.05, 0.02, 0.01):
        level = mesh.level(mesh.splits_for(ratio=ratio))
        rms = compare(points, scene.faces, level.points, level.faces, samples=4000).rms
        _add(table, len(level.faces), level.points.shape[1], level.error, rms)
    return table


def morph() -> Table:
    """Ten levels of a head with blend shapes: RMS over all targets, with the weights of the paper and without."""
    scene = _head()
    rest = scene.points.astype(np.float64)
    targets = np.stack([_with_shape(rest, shape) for shape in scene.blend.shapes])
    frames = np.concatenate([rest[None], targets])
    weights = warpqem.morph_weights(rest, targets, method="thirds")
    ratios = tuple(np.geomspace(0.6, 0.03, 10))
    plain = warpqem.simplify_levels(frames, scene.faces, ratios=ratios, metric="qem")
    weighted = warpqem.simplify_levels(frames, scene.faces, ratios=ratios, quadric_scale=weights)
    moved = weights >= 1.0
    table = _table("A head and its morph targets: the most animated third, mean distance %", "faces", "QEM", "weighted")
    for first, second in zip(plain, weighted, strict=True):
        distances = [_mean_distance(frames, scene.faces, moved, level) for level in (first, second)]
        _add(table, len(second.faces), *distances)
    return table


# Faces of the levels of the face paper, of a head of 2000.
FACE_LEVELS = (1420, 1120, 820, 620)


@cache
def _head_of_2000() -> tuple[np.ndarray, np.ndarray, warpqem.FacialFeatures]:
    """Every fourth frame of the head at 2000 faces, as the paper begins with, and its feature points there."""
    scene = _head()
    points = scene.baked()
    whole = warpqem.facial_features(points, scene.faces)
    small = warpqem.simplify(points[::4], scene.faces, target_faces=2000, locked=whole.indices)
    return small.points, small.faces, whole.moved(small.vertex_map)


def _face_levels(count: int) -> dict[str, warpqem.SimplifiedMesh]:
    """A level of that head by equation 1 alone, by the default, and by plain quadrics."""
    points, faces, features = _head_of_2000()
    kinds = {
        "equation 1": {"metric": "face", "face": warpqem.FaceProtection(features, keep=False)},
        "default": {"metric": "face", "face": warpqem.FaceProtection(features)},
        "QEM": {"metric": "qem"},
    }
    return {name: warpqem.simplify(points, faces, target_faces=count, **kind) for name, kind in kinds.items()}


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
            moved = carry_expressions(source, FaceMesh(level.points[0], level.faces, own), points)
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
                simplify_stage(scene, output, SimplifyOptions(ratio=ratio, frames=FrameRange(1, 24), **options))
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
        result = warpqem.simplify(points, scene.faces, ratio=0.1, metric=metric)
        _add(table, metric, len(np.unique(result.vertex_map[inside])), result.points.shape[1])
    return table


TABLES: dict[str, Callable[[], Table]] = {
    "levels": levels,
    "morph": morph,
    "face": face,
    "retarget": retarget,
    "articulated": articulated,
    "influences": influences,
    "joints": joints,
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
