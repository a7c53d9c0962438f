"""Poses of skinned and blend-shaped meshes, through UsdSkel.

The points equal what `UsdSkel.BakeSkinning` would write: blend shapes first, then linear or dual-quaternion skinning
with the geomBindTransform, then from the skeleton's space to the mesh's (UsdSkel documentation, "Schemas In-Depth").
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from warpqem.errors import StageError
from warpqem.usd.read.descendants import like
from warpqem.usd.read.hidden_users import shapes_in_proxies, shapes_in_variants

__all__ = ["MeshPoser", "StagePoses", "WeightChange"]

# What weights (S,) of all blend shapes of a mesh become.
WeightChange = Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]]


class StagePoses:
    """The skin bindings of a whole stage."""

    def __init__(self, stage: Usd.Stage) -> None:
        """Resolve the bindings below every SkelRoot of `stage`."""
        self._stage = stage
        self._cache = UsdSkel.Cache()
        self._bindings: dict[Sdf.Path, tuple[UsdSkel.SkeletonQuery, UsdSkel.SkinningQuery]] = {}
        # Those below a class count as well: the meshes there are edited in place of the instances of it.
        for prim in Usd.PrimRange.Stage(stage, Usd.PrimIsActive & Usd.PrimIsLoaded):
            if prim.IsA(UsdSkel.Root):
                self._collect(UsdSkel.Root(prim))

    def _collect(self, root: UsdSkel.Root) -> None:
        predicate = like(root.GetPrim())
        if not self._cache.Populate(root, predicate):
            return
        for binding in self._cache.ComputeSkelBindings(root, predicate):
            skeleton_query = self._cache.GetSkelQuery(binding.GetSkeleton())
            if not skeleton_query:
                continue
            for skinning_query in binding.GetSkinningTargets():
                self._bindings[skinning_query.GetPrim().GetPath()] = (skeleton_query, skinning_query)

    def shapes_of_others(self, prim: Usd.Prim) -> set[str]:
        """Names of the blend shapes that other meshes take from the animation of a mesh.

        Meshes of instances count, and so do those of unselected variants, whatever animation they take them from.
        """
        own = self._bindings.get(prim.GetPath())
        query = None if own is None else own[0].GetAnimQuery()
        names: set[str] = set()
        for path, (skeleton_query, skinning_query) in self._bindings.items():
            other = skeleton_query.GetAnimQuery()
            if path != prim.GetPath() and query and other and other.GetPrim() == query.GetPrim():
                names |= set(skinning_query.GetBlendShapeOrder() or [])
        if query:
            names |= self._proxy_shapes.get(query.GetPrim().GetPath(), set()) | self._variant_shapes
        return names

    @cached_property
    def _proxy_shapes(self) -> dict[Sdf.Path, set[str]]:
        return shapes_in_proxies(self._stage)

    @cached_property
    def _variant_shapes(self) -> set[str]:
        return shapes_in_variants(self._stage)

    def poser(self, prim: Usd.Prim) -> MeshPoser | None:
        """What deforms `prim`, or None if no skeleton or blend shape is bound to it."""
        binding = self._bindings.get(prim.GetPath())
        if binding is None:
            return None
        skeleton_query, skinning_query = binding
        if not skinning_query.HasJointInfluences() and not skinning_query.HasBlendShapes():
            return None
        return MeshPoser.create(prim, skeleton_query, skinning_query)


@dataclass(frozen=True)
class MeshPoser:
    """Deforms the rest points of one mesh.

    Attributes:
        prim: The mesh.
        skeleton_query: The skeleton bound to it.
        skinning_query: Its joint influences and blend shapes.
        blend_shape_query: Its blend shapes, None if it has none or no animation drives them.
        point_indices: For each blend shape the points it moves, empty for all of them.
        point_offsets: For each sub-shape (shape or inbetween) the offsets.
    """

    prim: Usd.Prim
    skeleton_query: UsdSkel.SkeletonQuery
    skinning_query: UsdSkel.SkinningQuery
    blend_shape_query: UsdSkel.BlendShapeQuery | None
    point_indices: list[Vt.IntArray]
    point_offsets: list[Vt.Vec3fArray]

    @classmethod
    def create(
        cls, prim: Usd.Prim, skeleton_query: UsdSkel.SkeletonQuery, skinning_query: UsdSkel.SkinningQuery
    ) -> MeshPoser:
        """Fetch the blend shapes once, for all times."""
        animation_query = skeleton_query.GetAnimQuery()
        if not skinning_query.HasBlendShapes() or not animation_query:
            return cls(prim, skeleton_query, skinning_query, None, [], [])
        query = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(prim))
        return cls(
            prim,
            skeleton_query,
            skinning_query,
            query,
            query.ComputeBlendShapePointIndices(),
            query.ComputeSubShapePointOffsets(),
        )

    @property
    def joint_count(self) -> int:
        """Number of joints in the order that the influences of this mesh use."""
        if not self.skinning_query.HasJointInfluences():
            return 0
        order = self.skinning_query.GetJointOrder()
        return len(order if order is not None else self.skeleton_query.GetJointOrder())

    @property
    def blend_shape_count(self) -> int:
        """Number of blend shapes bound to this mesh."""
        order = self.skinning_query.GetBlendShapeOrder() if self.skinning_query.HasBlendShapes() else None
        return 0 if order is None else len(order)

    def times(self) -> set[float]:
        """Every time code at which something that moves the points is authored."""
        times: set[float] = set()
        animation_query = self.skeleton_query.GetAnimQuery()
        query = self.skinning_query
        if query.HasJointInfluences():
            if animation_query:
                times.update(animation_query.GetJointTransformTimeSamples())
            for attribute in (query.GetGeomBindTransformAttr(), query.GetJointWeightsPrimvar()):
                if attribute:
                    times.update(attribute.GetTimeSamples())
            times.update(_relative_transform_times(self.prim, self.skeleton_query.GetPrim()))
        if self.blend_shape_query is not None:
            times.update(animation_query.GetBlendShapeWeightTimeSamples())
        return times

    def pose(self, rest_points: Vt.Vec3fArray, time: float | Usd.TimeCode) -> npt.NDArray[np.float32]:
        """Deform the points.

        Args:
            rest_points: The authored points at `time`.
            time: Time code of the pose.

        Returns:
            float32, shape (point count, 3), in the local space of the mesh.

        Raises:
            StageError: the influences or blend shapes do not fit the mesh.
        """
        points = Vt.Vec3fArray(rest_points)
        if self.blend_shape_query is not None:
            self._apply_blend_shapes(points, time)
        if not self.skinning_query.HasJointInfluences():
            return np.array(points, dtype=np.float32).reshape(-1, 3)
        transforms = self.skeleton_query.ComputeSkinningTransforms(time)
        if transforms is not None and self.skinning_query.IsRigidlyDeformed():
            # One transform for all points, as UsdSkel bakes it. Blending several joints point by point rounds otherwise
            # and comes out up to a few millionths of the distance from the origin apart.
            return self._to_local_space(_transform(np.asarray(points), self._rigid(transforms, time)), time)
        if transforms is None or not self._skin(transforms, points, time):
            raise StageError(
                f"{self.prim.GetPath()}: UsdSkel cannot skin the {len(points)} points at time {time} "
                f"with skeleton {self.skeleton_query.GetPrim().GetPath()} (primvars:skel:jointIndices, jointWeights)"
            )
        return self._to_local_space(np.asarray(points), time)

    def ordered(self, transforms: Vt.Matrix4dArray) -> Vt.Matrix4dArray:
        """Transforms of the skeleton's joints in the order of the mesh's influences.

        A joint of the mesh that the skeleton lacks stays where it is, and so do all but the last of one name, as
        `UsdSkel.BakeSkinning` has it.
        """
        mapper = self.skinning_query.GetJointMapper()
        return transforms if mapper is None else mapper.RemapTransforms(transforms, Vt.Matrix4dArray())

    @cached_property
    def _lacks_joints(self) -> bool:
        """Whether the skeleton lacks joints of the mesh, for which `UsdSkel.SkinningQuery` takes those of others."""
        mapper = self.skinning_query.GetJointMapper()
        return mapper is not None and bool(mapper.IsSparse())

    def whole(self, time: float | Usd.TimeCode) -> npt.NDArray[np.float64]:
        """The one transform (4, 4) from rest points to local space of a mesh whose joints move it as a whole, if any.

        Raises:
            StageError: the skeleton has no transforms at this time.
        """
        if not self.skinning_query.HasJointInfluences():
            return np.eye(4)
        transforms = self.skeleton_query.ComputeSkinningTransforms(time)
        if transforms is None:
            raise StageError(f"{self.skeleton_query.GetPrim().GetPath()}: no joint transforms at time {time}")
        moved: npt.NDArray[np.float64] = self._rigid(transforms, time) @ self._to_local(time)
        return moved

    def _rigid(self, transforms: Vt.Matrix4dArray, time: float | Usd.TimeCode) -> npt.NDArray[np.float64]:
        """The one transform of a mesh that is moved as a whole."""
        query = self.skinning_query
        if not self._lacks_joints:
            return np.array(query.ComputeSkinnedTransform(transforms, time))
        influences = self.influences(time)
        return np.array(
            UsdSkel.SkinTransform(
                query.GetSkinningMethod(), query.GetGeomBindTransform(time), self.ordered(transforms), *influences
            )
        )

    def influences(self, time: float | Usd.TimeCode) -> tuple[Any, Any]:
        """Joint indices and weights as authored."""
        query = self.skinning_query
        joints, weights = query.GetJointIndicesPrimvar(), query.GetJointWeightsPrimvar()
        return joints.ComputeFlattened(time), weights.ComputeFlattened(time)

    def _skin(self, transforms: Vt.Matrix4dArray, points: Vt.Vec3fArray, time: float | Usd.TimeCode) -> bool:
        """Move points by joints, in place; false where their influences do not fit."""
        query = self.skinning_query
        influences = self.influences(time)
        known = isinstance(influences[0], Vt.IntArray) and isinstance(influences[1], Vt.FloatArray)
        if known and not self._lacks_joints:
            return bool(query.ComputeSkinnedPoints(transforms, points, time))
        # UsdSkel reads no numbers of other types, such as weights in double precision, but calculates with them.
        joints, weights = (np.asarray(values) for values in influences)
        if joints.dtype.kind not in "iu" or weights.dtype.kind not in "fiu":
            return False
        return bool(
            UsdSkel.SkinPoints(
                query.GetSkinningMethod(),
                query.GetGeomBindTransform(time),
                self.ordered(transforms),
                Vt.IntArray.FromNumpy(joints.astype(np.int32)),
                Vt.FloatArray.FromNumpy(weights.astype(np.float32)),
                query.GetNumInfluencesPerComponent(),
                points,
            )
        )

    def shaped(
        self, rest_points: Vt.Vec3fArray, time: float | Usd.TimeCode, changed: WeightChange | None = None
    ) -> npt.NDArray[np.float32]:
        """The rest points as blend shapes leave them to the joints, float32, shape (point count, 3).

        Args:
            rest_points: The authored points.
            time: Time code of the pose.
            changed: What the weights become before they move anything; None where they stay.
        """
        points = Vt.Vec3fArray(rest_points)
        if self.blend_shape_query is not None:
            self._apply_blend_shapes(points, time, changed)
        return np.array(points, dtype=np.float32).reshape(-1, 3)

    def _apply_blend_shapes(
        self, points: Vt.Vec3fArray, time: float | Usd.TimeCode, changed: WeightChange | None = None
    ) -> None:
        assert self.blend_shape_query is not None
        weights = self.skeleton_query.GetAnimQuery().ComputeBlendShapeWeights(time)
        if weights is None:
            raise StageError(
                f"{self.skeleton_query.GetAnimQuery().GetPrim().GetPath()}.blendShapeWeights: no value at time {time}"
            )
        mapper = self.skinning_query.GetBlendShapeMapper()
        mapped = weights if mapper is None else mapper.Remap(weights)
        if changed is not None:
            mapped = Vt.FloatArray.FromNumpy(changed(np.array(mapped, dtype=np.float64)).astype(np.float32))
        sub_weights, shape_indices, sub_indices = self.blend_shape_query.ComputeSubShapeWeights(mapped)
        if not self.blend_shape_query.ComputeDeformedPoints(
            sub_weights, shape_indices, sub_indices, self.point_indices, self.point_offsets, points
        ):
            raise StageError(
                f"{self.prim.GetPath()}: a blend shape refers to points outside the {len(points)} points "
                f"of the mesh (skel:blendShapeTargets) at time {time}"
            )

    def _to_local_space(self, points: npt.NDArray[np.floating], time: float | Usd.TimeCode) -> npt.NDArray[np.float32]:
        """From the skeleton's space to the mesh's."""
        return _transform(points, self._to_local(time)).astype(np.float32)

    def _to_local(self, time: float | Usd.TimeCode) -> npt.NDArray[np.float64]:
        """What takes the skeleton's space to the mesh's; USD matrices act on row vectors."""
        cache = UsdGeom.XformCache(time)
        to_world = np.array(cache.GetLocalToWorldTransform(self.skeleton_query.GetPrim()))
        from_world = np.array(cache.GetLocalToWorldTransform(self.prim).GetInverse())
        moved: npt.NDArray[np.float64] = to_world @ from_world
        return moved


def _transform(points: npt.NDArray[np.floating], matrix: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    moved: npt.NDArray[np.float64] = points.astype(np.float64) @ matrix[:3, :3] + matrix[3, :3]
    return moved


def _relative_transform_times(first: Usd.Prim, second: Usd.Prim) -> set[float]:
    """Samples of the transforms between two prims; those of common ancestors cancel out."""
    times: set[float] = set()
    chains = [_transform_chain(first), _transform_chain(second)]
    for path in chains[0].keys() ^ chains[1].keys():
        times.update((chains[0].get(path) or chains[1][path]).GetTimeSamples())
    return times


def _transform_chain(prim: Usd.Prim) -> dict[Sdf.Path, UsdGeom.Xformable]:
    """The transformable prims from `prim` up to the root or to the first that resets the transform stack."""
    chain: dict[Sdf.Path, UsdGeom.Xformable] = {}
    while prim and not prim.IsPseudoRoot():
        xformable = UsdGeom.Xformable(prim)
        if xformable:
            chain[prim.GetPath()] = xformable
            if xformable.GetResetXformStack():
                break
        prim = prim.GetParent()
    return chain
