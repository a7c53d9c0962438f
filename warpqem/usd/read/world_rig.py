"""What moves the meshes of a file: joints in world space, and the size of what is stored for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom, UsdSkel

from warpqem.report.content import Skeleton
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import MeshPoser
from warpqem.usd.read.skin_poses import joint_names

__all__ = ["influence_count", "moving_joints", "shape_count", "skeletons_of", "stored_bytes"]


def skeletons_of(sources: Sequence[MeshSource], times: Sequence[float] | None) -> list[Skeleton]:
    """The skeletons of some meshes at some times, each once, in world space.

    Args:
        sources: The meshes.
        times: Time codes; None for the default time.
    """
    found: dict[str, Skeleton] = {}
    poses: Sequence[float | None] = times or [None]
    for poser in _posers(sources):
        query = poser.skeleton_query
        path = str(query.GetPrim().GetPath())
        used = moving_joints(poser)
        if path in found:
            found[path].used.update(used)
            continue
        points = [_joint_places(query, time) for time in poses]
        parents = np.array(query.GetTopology().GetParentIndices(), dtype=np.int64)
        if all(len(pose) == len(parents) for pose in points):
            names = [str(name) for name in query.GetJointOrder()]
            found[path] = Skeleton(path, names, parents, np.stack(points), set(used))
    return list(found.values())


def _posers(sources: Sequence[MeshSource]) -> list[MeshPoser]:
    posers = [source.poser for source in sources if source.poser is not None]
    return [poser for poser in posers if poser.skinning_query.HasJointInfluences()]


def _joint_places(query: UsdSkel.SkeletonQuery, time: float | None) -> npt.NDArray[np.float64]:
    """Places of the joints (J, 3); none where the animation does not fit the skeleton."""
    code = Usd.TimeCode.EarliestTime() if time is None else Usd.TimeCode(time)
    transforms = query.ComputeJointSkelTransforms(code)
    if not transforms:
        return np.zeros((0, 3))
    world = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(query.GetPrim()))
    places: npt.NDArray[np.float64] = (np.array(transforms, dtype=np.float64).reshape(-1, 4, 4) @ world)[:, 3, :3]
    return places


def _influences(poser: MeshPoser) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]] | None:
    """Joints and weights of a mesh as they are stored; None where they do not belong together."""
    query, code = poser.skinning_query, Usd.TimeCode.EarliestTime()
    joints = np.array(query.GetJointIndicesPrimvar().Get(code) or (), dtype=np.int64)
    weights = np.array(query.GetJointWeightsPrimvar().Get(code) or (), dtype=np.float64)
    return (joints, weights) if len(joints) == len(weights) else None


def moving_joints(poser: MeshPoser) -> set[str]:
    """Names of the joints with a weight on some point of a mesh."""
    found = _influences(poser)
    if found is None:
        return set()
    names = joint_names(poser)
    return {str(names[joint]) for joint in np.unique(found[0][found[1] > 0]).tolist() if 0 <= joint < len(names)}


def influence_count(poser: MeshPoser) -> int:
    """The most joints that move one point of a mesh."""
    found = _influences(poser)
    width = poser.skinning_query.GetNumInfluencesPerComponent()
    if found is None or width < 1 or len(found[1]) % width:
        return 0
    return int((found[1].reshape(-1, width) > 0).sum(axis=1).max(initial=0))


def shape_count(source: MeshSource) -> int:
    """Blend shapes of a mesh."""
    return len(UsdSkel.BindingAPI(source.prim).GetBlendShapeTargetsRel().GetForwardedTargets())


def stored_bytes(source: MeshSource) -> int:
    """Bytes of all values of a mesh and its blend shapes at all their times, as they are in memory."""
    targets = UsdSkel.BindingAPI(source.prim).GetBlendShapeTargetsRel().GetForwardedTargets()
    stage = source.prim.GetStage()
    prims = [source.prim, *(stage.GetPrimAtPath(path) for path in targets)]
    return sum(_attribute_bytes(attribute) for prim in prims if prim for attribute in prim.GetAuthoredAttributes())


def _attribute_bytes(attribute: Usd.Attribute) -> int:
    """Of arrays alone; all samples are taken to be as long as the first."""
    if not attribute.GetTypeName().isArray:
        return 0
    value = attribute.Get(Usd.TimeCode.EarliestTime())
    try:
        size = np.asarray(value).nbytes if value else 0
    except (TypeError, ValueError):
        return 0
    return size * max(1, attribute.GetNumTimeSamples())
