"""What skeleton and blend shapes of a mesh do in its poses, as arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom, UsdSkel, Vt

from warpqem.errors import StageError
from warpqem.usd.read.skeleton_poses import MeshPoser

__all__ = ["is_linear", "joint_names", "joint_parents", "joint_transforms", "shape_offsets"]


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
    index = _joint_index(poser)
    for time in times:
        transforms = poser.skeleton_query.ComputeSkinningTransforms(time)
        if transforms is None:
            raise StageError(f"{poser.skeleton_query.GetPrim().GetPath()}: no joint transforms at time {time}")
        cache = UsdGeom.XformCache(time)
        to_world = np.array(cache.GetLocalToWorldTransform(poser.skeleton_query.GetPrim()))
        from_world = np.array(cache.GetLocalToWorldTransform(poser.prim).GetInverse())
        # USD matrices act on row vectors, so that the first to act stands first.
        bind = np.array(query.GetGeomBindTransform(time))
        # A joint of the mesh that the skeleton lacks stays where it is, as UsdSkel leaves it.
        own = np.concatenate([np.array(transforms).reshape(-1, 4, 4), np.eye(4)[None]])[index]
        matrices.append(bind @ own @ (to_world @ from_world))
    stacked = np.stack(matrices)
    columns: npt.NDArray[np.float64] = np.swapaxes(stacked, -1, -2)[..., :3, :]
    return columns


def _joint_index(poser: MeshPoser) -> npt.NDArray[np.int64]:
    """Where the joints that the mesh's influences name stand in the skeleton's order; -1 for those it lacks."""
    names = list(poser.skeleton_query.GetJointOrder())
    order = poser.skinning_query.GetJointOrder()
    if order is None:
        return np.arange(len(names))
    position = {name: index for index, name in enumerate(names)}
    return np.array([position.get(name, -1) for name in order], dtype=np.int64)


def joint_names(poser: MeshPoser) -> list[str]:
    """The joints of a mesh in the order that its influences use."""
    order = poser.skinning_query.GetJointOrder()
    return list(poser.skeleton_query.GetJointOrder() if order is None else order)


def joint_parents(poser: MeshPoser) -> npt.NDArray[np.int64]:
    """The nearest joint above each joint of a mesh, in the order that its influences use, -1 for none; (J,).

    Joints between the two that the mesh does not name are passed over; so are joints that the skeleton lacks.
    """
    names = list(poser.skeleton_query.GetJointOrder())
    topology = poser.skeleton_query.GetTopology()
    own = {name: index for index, name in enumerate(joint_names(poser))}
    place = {name: index for index, name in enumerate(names)}
    parents = np.full(len(own), -1, dtype=np.int64)
    for name, index in own.items():
        above = topology.GetParent(place[name]) if name in place else -1
        while above >= 0 and names[above] not in own:
            above = topology.GetParent(above)
        parents[index] = own[names[above]] if above >= 0 else -1
    return parents


def shape_offsets(
    poser: MeshPoser, rest_points: npt.NDArray[np.float32], times: Sequence[Usd.TimeCode]
) -> npt.NDArray[np.float32] | None:
    """What blend shapes add to the authored rest points at each time, (F, P, 3); None without any."""
    if poser.blend_shape_query is None:
        return None
    offsets = np.empty((len(times), *rest_points.shape), dtype=np.float32)
    for index, time in enumerate(times):
        offsets[index] = poser.shaped(Vt.Vec3fArray.FromNumpy(rest_points), time) - rest_points
    return offsets
