"""Read the blend shapes of a mesh."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from warpqem.errors import StageError

__all__ = ["ShapeData", "choose_targets", "count_shape_users", "read_shapes", "shape_attributes"]

# Targets that take part in simplification as frames. They are chosen far apart; more of them add cost, not shape.
MAX_TARGETS = 24

Offsets = npt.NDArray[np.float32]


@dataclass(frozen=True)
class ShapeData:
    """One blend shape with an entry for every authored point of its mesh.

    Attributes:
        path: The BlendShape prim.
        arrays: Offsets by the name of their attribute: offsets, normalOffsets, and those of inbetweens; float32,
            shape (P, 3).
    """

    path: Sdf.Path
    arrays: dict[str, Offsets]


def count_shape_users(stage: Usd.Stage) -> Counter[Sdf.Path]:
    """How many meshes use each BlendShape prim, those of instances one by one."""
    users: Counter[Sdf.Path] = Counter()
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdGeom.Mesh):
            users.update(UsdSkel.BindingAPI(prim).GetBlendShapeTargetsRel().GetForwardedTargets())
    return users


def read_shapes(prim: Usd.Prim, point_count: int) -> list[ShapeData] | None:
    """The blend shapes of a mesh; None if one of them does not exist or does not fit the points.

    Raises:
        StageError: an offset of points is no finite number.
    """
    shapes = []
    for path in UsdSkel.BindingAPI(prim).GetBlendShapeTargetsRel().GetForwardedTargets():
        shape = UsdSkel.BlendShape(prim.GetStage().GetPrimAtPath(path))
        data = _read_shape(shape, point_count) if shape else None
        if data is None:
            return None
        shapes.append(data)
    return shapes


def _read_shape(shape: UsdSkel.BlendShape, point_count: int) -> ShapeData | None:
    indices = np.asarray(shape.GetPointIndicesAttr().Get() or [], dtype=np.int64)
    if not len(indices):
        # Without indices a shape has an offset for every point.
        indices = np.arange(point_count)
    if indices.min(initial=0) < 0 or indices.max(initial=0) >= point_count:
        return None
    arrays = {}
    for attribute, moves_points in shape_attributes(shape):
        value = attribute.Get() if attribute else None
        if value is None or not len(value):
            continue
        if len(value) != len(indices):
            return None
        dense = np.zeros((point_count, 3), dtype=np.float32)
        offsets = np.asarray(value, dtype=np.float32)
        bad = np.flatnonzero(~np.isfinite(offsets).all(axis=1))
        if moves_points and len(bad):
            raise StageError(f"{attribute.GetPath()}: offset {bad[0]} is {offsets[bad[0]].tolist()}")
        dense[indices] = offsets
        arrays[attribute.GetName()] = dense
    return ShapeData(shape.GetPath(), arrays)


def shape_attributes(shape: UsdSkel.BlendShape) -> list[tuple[Usd.Attribute, bool]]:
    """The arrays of a blend shape and of its inbetweens, and which of them move points; the others turn normals."""
    attributes = [(shape.GetOffsetsAttr(), True), (shape.GetNormalOffsetsAttr(), False)]
    for inbetween in shape.GetInbetweens():
        attributes += [(inbetween.GetAttr(), True), (inbetween.GetNormalOffsetsAttr(), False)]
    return attributes


def choose_targets(shapes: list[ShapeData]) -> list[Offsets]:
    """The offsets of all shapes, or of those that lie farthest apart where there are too many."""
    offsets = [shape.arrays["offsets"] for shape in shapes if "offsets" in shape.arrays]
    if len(offsets) <= MAX_TARGETS:
        return offsets
    flat = np.stack([array.ravel() for array in offsets]).astype(np.float64)
    # Farthest-point sampling that begins at the neutral shape (Gonzalez 1985).
    distance = np.linalg.norm(flat, axis=1)
    chosen = []
    for _ in range(MAX_TARGETS):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(flat - flat[chosen[-1]], axis=1))
    return [offsets[index] for index in sorted(chosen)]
