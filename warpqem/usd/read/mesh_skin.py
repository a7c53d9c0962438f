"""What deforms a mesh, as arrays: rest shape, joint influences, blend shapes."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from warpqem.usd.read.blend_shapes import ShapeData, read_shapes
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.value_arrays import sample_codes

__all__ = ["Influences", "Skin", "read_skin"]


@dataclass(frozen=True)
class Influences:
    """Joints of every authored point at one time.

    Attributes:
        joints: int32, shape (P, K).
        weights: float32, shape (P, K).
    """

    joints: npt.NDArray[np.int32]
    weights: npt.NDArray[np.float32]


@dataclass(frozen=True)
class Skin:
    """What deforms one mesh.

    Attributes:
        rest_points: float32, shape (P, 3).
        influences: At each sample, point by point; empty where one set of joints moves the whole mesh, or none.
        shapes: Its blend shapes.
        influence_limit: Joints that move a new point at most; None for as many as move an old one.
        fitted: Influences of the new points; None to blend them from the old ones'.
        joint_order: Names of the joints that `fitted` counts through; None for those of the input.
        shape_order: Names of `shapes`, where some of the input's went; None where all stay.
        removed_shapes: The BlendShape prims of those that went.
    """

    rest_points: npt.NDArray[np.float32]
    influences: dict[Usd.TimeCode, Influences]
    shapes: list[ShapeData]
    influence_limit: int | None = None
    fitted: Influences | None = None
    joint_order: tuple[str, ...] | None = None
    shape_order: tuple[str, ...] | None = None
    removed_shapes: tuple[Sdf.Path, ...] = ()

    @property
    def diagonal(self) -> float:
        """Bounding-box diagonal of the rest shape."""
        return float(np.linalg.norm(np.ptp(self.rest_points.astype(np.float64), axis=0)))

    @property
    def influence_count(self) -> int:
        """Joints that move an old point at most; 0 where none move single points."""
        return max(
            (int(np.count_nonzero(i.weights, axis=1).max(initial=0)) for i in self.influences.values()), default=0
        )


def read_skin(
    source: MeshSource, shape_users: Counter[Sdf.Path], influence_limit: int | None = None
) -> tuple[Skin | None, str | None]:
    """The skin of a mesh, if new points can take it over.

    Args:
        source: The mesh.
        shape_users: How many meshes use each BlendShape prim of the stage.
        influence_limit: Joints that move a new point at most; None for as many as move an old one.

    Returns:
        The skin, or None for a mesh without one or with one that cannot be taken over, and in that case why not.
    """
    prim = source.prim
    joints, weights = _influence_primvars(source)
    targets = UsdSkel.BindingAPI(prim).GetBlendShapeTargetsRel().GetForwardedTargets()
    if joints is None and not targets:
        return None, None
    points = source.mesh.GetPointsAttr()
    if len(points.GetTimeSamples()) > 1:
        return None, "its rest points are animated"
    for path in targets:
        if shape_users[path] > 1:
            return None, f"blend shape {path} belongs to {shape_users[path]} meshes"
        shape = prim.GetStage().GetPrimAtPath(path)
        if shape and shape.IsInstanceProxy():
            return None, f"blend shape {path} is an instance proxy"
    shapes = read_shapes(prim, source.point_count)
    if shapes is None:
        return None, "a blend shape does not fit its points"
    if joints is not None and weights is not None and _is_constant(joints) != _is_constant(weights):
        return None, "its joint indices are constant and its joint weights are not, or the other way round"
    influences = _read_influences(joints, weights, source.point_count)
    if influences is None:
        return None, "its joint influences do not fit its points"
    rest = np.array(points.Get(Usd.TimeCode.EarliestTime()), dtype=np.float32).reshape(-1, 3)
    return Skin(rest, influences, shapes, influence_limit), None


def _influence_primvars(source: MeshSource) -> tuple[UsdGeom.Primvar | None, UsdGeom.Primvar | None]:
    """Joint indices and weights; where a skeleton is bound, also those that UsdSkel inherits from an ancestor."""
    if source.poser is not None:
        query = source.poser.skinning_query
        primvars = (query.GetJointIndicesPrimvar(), query.GetJointWeightsPrimvar())
    else:
        binding = UsdSkel.BindingAPI(source.prim)
        primvars = (binding.GetJointIndicesPrimvar(), binding.GetJointWeightsPrimvar())
    joints, weights = (primvar if primvar and primvar.HasAuthoredValue() else None for primvar in primvars)
    return joints, weights


def _is_constant(primvar: UsdGeom.Primvar) -> bool:
    return bool(primvar.GetInterpolation() == UsdGeom.Tokens.constant)


def _read_influences(
    joints: UsdGeom.Primvar | None, weights: UsdGeom.Primvar | None, point_count: int
) -> dict[Usd.TimeCode, Influences] | None:
    if joints is None or weights is None:
        return {}
    if _is_constant(joints):
        return {}
    size = joints.GetElementSize()
    influences = {}
    for code in sample_codes(joints.GetAttr(), weights.GetAttr()):
        arrays = [np.asarray(primvar.ComputeFlattened(code)) for primvar in (joints, weights)]
        if any(len(array) != point_count * size for array in arrays):
            return None
        influences[code] = Influences(
            arrays[0].astype(np.int32).reshape(point_count, size), arrays[1].astype(np.float32).reshape(-1, size)
        )
    return influences
