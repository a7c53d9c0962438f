"""Which value of a skin, a blend shape or an animation a pose without finite points comes from."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from warpqem.usd.read.blend_shapes import shape_attributes
from warpqem.usd.read.skeleton_poses import MeshPoser

__all__ = ["first_broken_value"]


def first_broken_value(poser: MeshPoser, code: Usd.TimeCode) -> str | None:
    """The first value that is no finite number, with its attribute; None where all that move the mesh are finite.

    Args:
        poser: what moves the mesh.
        code: time of the pose.
    """
    for attribute in _attributes(poser):
        value = attribute.Get(code)
        array = None if value is None else np.asarray(value)
        if array is None or array.dtype.kind != "f":
            continue
        # One transform, or several elements.
        rows = array.reshape(1 if attribute.GetTypeName().isArray is False else len(array), -1)
        bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
        if len(bad):
            return f"{attribute.GetPath()}: value {bad[0]} is {rows[bad[0]].squeeze().tolist()}"
    for prim in (poser.skeleton_query.GetPrim(), poser.prim):
        if not np.isfinite(np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(prim))).all():
            return f"{prim.GetPath()}: its transform to the world is not finite"
    return None


def _attributes(poser: MeshPoser) -> Iterator[Usd.Attribute]:
    """What moves a mesh, that which is its own first."""
    query = poser.skinning_query
    if query.HasJointInfluences():
        yield query.GetJointWeightsPrimvar().GetAttr()
        if query.GetGeomBindTransformAttr():
            yield query.GetGeomBindTransformAttr()
    for path in UsdSkel.BindingAPI(poser.prim).GetBlendShapeTargetsRel().GetForwardedTargets():
        shape = UsdSkel.BlendShape(poser.prim.GetStage().GetPrimAtPath(path))
        if shape:
            yield from (attribute for attribute, moves_points in shape_attributes(shape) if moves_points)
    skeleton = poser.skeleton_query.GetSkeleton()
    yield from (skeleton.GetBindTransformsAttr(), skeleton.GetRestTransformsAttr())
    animation = poser.skeleton_query.GetAnimQuery()
    moves = UsdSkel.Animation(animation.GetPrim()) if animation else None
    if moves:
        yield from (
            moves.GetTranslationsAttr(),
            moves.GetRotationsAttr(),
            moves.GetScalesAttr(),
            moves.GetBlendShapeWeightsAttr(),
        )
