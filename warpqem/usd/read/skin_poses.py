"""What skeleton and blend shapes of a mesh do in its poses, as arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom, UsdSkel, Vt

from warpqem.errors import StageError
from warpqem.usd.read.skeleton_poses import MeshPoser, WeightChange

__all__ = [
    "first_repeated",
    "is_linear",
    "joint_names",
    "joint_parents",
    "joint_transforms",
    "repeated_joint",
    "shape_offsets",
    "whole_transforms",
]


def is_linear(poser: MeshPoser) -> bool:
    """True for linear blend skinning of every point by joints of its own."""
    query = poser.skinning_query
    return query.HasJointInfluences() and query.GetSkinningMethod() == UsdSkel.Tokens.classicLinear


def joint_transforms(poser: MeshPoser, times: Sequence[Usd.TimeCode]) -> npt.NDArray[np.float64]:
    """What each joint of a mesh does to its rest points, (F, J, 3, 4) as columns.

    From rest points through geomBindTransform and the joint to the mesh's local space, as `MeshPoser.pose` goes. Joints
    are in the order that the mesh's influences use.

    Raises:
        StageError: the skeleton has no transforms at a time.
    """
    matrices = []
    query = poser.skinning_query
    for time in times:
        transforms = poser.skeleton_query.ComputeSkinningTransforms(time)
        if transforms is None:
            raise StageError(f"{poser.skeleton_query.GetPrim().GetPath()}: no joint transforms at time {time}")
        cache = UsdGeom.XformCache(time)
        to_world = np.array(cache.GetLocalToWorldTransform(poser.skeleton_query.GetPrim()))
        from_world = np.array(cache.GetLocalToWorldTransform(poser.prim).GetInverse())
        # USD matrices act on row vectors, so that the first to act stands first.
        bind = np.array(query.GetGeomBindTransform(time))
        own = np.array(poser.ordered(transforms)).reshape(-1, 4, 4)
        matrices.append(bind @ own @ (to_world @ from_world))
    stacked = np.stack(matrices)
    columns: npt.NDArray[np.float64] = np.swapaxes(stacked, -1, -2)[..., :3, :]
    return columns


def joint_names(poser: MeshPoser) -> list[str]:
    """The joints of a mesh in the order that its influences use."""
    order = poser.skinning_query.GetJointOrder()
    return list(poser.skeleton_query.GetJointOrder() if order is None else order)


def joint_parents(poser: MeshPoser) -> npt.NDArray[np.int64]:
    """The nearest joint above each joint of a mesh, in the order that its influences use, -1 for none; (J,).

    Joints between the two that the mesh does not name are passed over; so are joints that the skeleton lacks.
    """
    topology = poser.skeleton_query.GetTopology()
    place = _places(poser)
    own = {joint: index for index, joint in enumerate(place.tolist()) if joint >= 0}
    parents = np.full(len(place), -1, dtype=np.int64)
    for joint, index in own.items():
        above = topology.GetParent(joint)
        while above >= 0 and above not in own:
            above = topology.GetParent(above)
        parents[index] = own.get(above, -1)
    return parents


def _places(poser: MeshPoser) -> npt.NDArray[np.int64]:
    """Where each joint of a mesh stands in the skeleton's order, -1 for one that nothing there moves; (J,)."""
    mapper = poser.skinning_query.GetJointMapper()
    every = Vt.IntArray(range(len(poser.skeleton_query.GetJointOrder())))
    if mapper is None:
        return np.array(every, dtype=np.int64)
    return np.array(mapper.Remap(every, Vt.IntArray([-1] * poser.joint_count)), dtype=np.int64)


def repeated_joint(poser: MeshPoser) -> str | None:
    """The first joint whose name does not say which one is meant, of the mesh's order or the skeleton's; or None."""
    return first_repeated(joint_names(poser)) or first_repeated(poser.skeleton_query.GetJointOrder())


def first_repeated(names: Iterable[str]) -> str | None:
    """The first name that comes a second time; None if all differ."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return None


def whole_transforms(poser: MeshPoser, times: Sequence[Usd.TimeCode]) -> npt.NDArray[np.float64]:
    """What takes the rest points of a mesh that moves as a whole to its local space, (F, 1, 3, 4) as columns.

    Raises:
        StageError: the skeleton has no transforms at a time.
    """
    stacked = np.stack([poser.whole(time) for time in times])[:, None]
    columns: npt.NDArray[np.float64] = np.swapaxes(stacked, -1, -2)[..., :3, :]
    return columns


def shape_offsets(
    poser: MeshPoser,
    rest_points: npt.NDArray[np.float32],
    times: Sequence[Usd.TimeCode],
    changed: WeightChange | None = None,
) -> npt.NDArray[np.float32] | None:
    """What blend shapes add to the authored rest points at each time, (F, P, 3); None without any.

    Args:
        poser: what moves the mesh.
        rest_points: the authored points.
        times: time codes.
        changed: what the weights become first; None where they stay.
    """
    if poser.blend_shape_query is None:
        return None
    offsets = np.empty((len(times), *rest_points.shape), dtype=np.float32)
    for index, time in enumerate(times):
        offsets[index] = poser.shaped(Vt.Vec3fArray.FromNumpy(rest_points), time, changed) - rest_points
    return offsets
