"""What a page says of rigs: a table of joints, shapes and sizes, and curves of the error as they go."""

from __future__ import annotations

from collections.abc import Sequence

from warpqem.report import Curve, Table
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.world import WorldMeshes
from warpqem.usd.read.world_rig import influence_count, moving_joints, shape_count, stored_bytes
from warpqem.usd.write.stage_report import PrimReport

__all__ = ["rig_curves", "size_table"]

KILOBYTE = 1000.0
# A page has room for the curves of so many meshes.
MAX_CURVES = 8


def size_table(original: WorldMeshes, levels: Sequence[tuple[str, WorldMeshes]]) -> Table:
    """Joints, influences, blend shapes and bytes of all meshes of the original and of each level."""
    head = ("level", "joints", "influences", "blend shapes", "KB")
    return Table("Size and rig", head, [_row(name, found) for name, found in [("original", original), *levels]])


def _row(name: str, meshes: WorldMeshes) -> tuple[str | int | float | None, ...]:
    sources = meshes.sources
    posers = [source.poser for source in sources if source.poser is not None]
    skinned = [poser for poser in posers if poser.skinning_query.HasJointInfluences()]
    joints = {(str(p.skeleton_query.GetPrim().GetPath()), joint) for p in skinned for joint in moving_joints(p)}
    influences = max((influence_count(poser) for poser in skinned), default=0)
    counts = (len(joints), influences, sum(map(shape_count, sources)))
    size = sum(stored_bytes(source) for source in _once(sources))
    return (name, *(count or None for count in counts), round(size / KILOBYTE, 1))


def _once(sources: Sequence[MeshSource]) -> list[MeshSource]:
    return list({source.path: source for source in sources}.values())


def rig_curves(prims: Sequence[PrimReport]) -> list[Curve]:
    """Error against joints and against blend shapes, where those went; of the worst meshes if there are many."""
    joints, shapes = [], []
    for prim in prims:
        level = getattr(prim, "level", "")
        name = f"{prim.path.rsplit('/', 1)[-1]} {level}".rstrip()
        if prim.joints is not None:
            joints.append((name, prim.joints.counts, prim.joints.errors))
        if prim.shapes is not None:
            shapes.append((f"{name}, animation", prim.shapes.counts, prim.shapes.used_errors))
            shapes.append((f"{name}, random weights", prim.shapes.counts, prim.shapes.random_errors))
    found = [("Error over joints", "joints", joints), ("Error over blend shapes", "blend shapes", shapes)]
    return [
        Curve(title, "RMS over the poses, % of the diagonal", name, sorted(series[:MAX_CURVES], key=lambda one: one[0]))
        for title, name, series in found
        if any(len(counts) > 1 for _, counts, _ in series)
    ]
