"""Write the skin of a simplified mesh: joint influences and blend shapes of its new points."""

from __future__ import annotations

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from warpqem.skinning.linear_skin import blend_influences as blend_arrays
from warpqem.skinning.linear_skin import normalised_weights
from warpqem.usd.read.mesh_skin import Influences, Skin
from warpqem.usd.write.attribute_transfer import AttributeTransfer, Rows
from warpqem.usd.write.blend_shape_output import write_shape

__all__ = ["blend_influences", "write_skin"]


def write_skin(stage: Usd.Stage, prim: Usd.Prim, skin: Skin, transfer: AttributeTransfer) -> None:
    """Give the new points of a mesh their joint influences and blend shapes.

    Skeleton, animation, geomBindTransform and targets are those of the input, and so are joints that move the whole
    mesh as one. The joint order is the input's, or the mesh gets one of its own with the joints that it still uses.

    Args:
        stage: Stage whose edit target takes the edits.
        prim: The mesh.
        skin: Its skin on the old points.
        transfer: Where the new points get their values from.
    """
    rows = transfer.vertices()
    if skin.fitted is not None:
        _write_influences(prim, dict.fromkeys(skin.influences, skin.fitted))
        if skin.joint_order is not None:
            UsdSkel.BindingAPI(prim).CreateJointsAttr(Vt.TokenArray(skin.joint_order))
    elif skin.influences:
        blended = {code: blend_influences(item, rows, skin.influence_limit) for code, item in skin.influences.items()}
        _write_influences(prim, blended)
    if skin.shape_order is not None:
        binding = UsdSkel.BindingAPI(prim)
        binding.CreateBlendShapesAttr(Vt.TokenArray(skin.shape_order))
        binding.CreateBlendShapeTargetsRel().SetTargets([shape.path for shape in skin.shapes])
        for path in skin.removed_shapes:
            stage.OverridePrim(path).SetActive(False)
    for shape in skin.shapes:
        write_shape(stage, shape, rows, skin.diagonal, transfer)


def _write_influences(prim: Usd.Prim, influences: dict[Usd.TimeCode, Influences]) -> None:
    if not prim.HasAPI(UsdSkel.BindingAPI):
        # Inherited influences are replaced by the mesh's own, which UsdSkel reads only where the API is applied.
        UsdSkel.BindingAPI.Apply(prim)
    primvars = UsdGeom.PrimvarsAPI(prim)
    for name, kind, arrays in (
        ("jointIndices", Sdf.ValueTypeNames.IntArray, {code: item.joints for code, item in influences.items()}),
        ("jointWeights", Sdf.ValueTypeNames.FloatArray, {code: item.weights for code, item in influences.items()}),
    ):
        size = next(iter(arrays.values())).shape[1]
        primvar = primvars.CreatePrimvar(f"skel:{name}", kind, UsdGeom.Tokens.vertex, size)
        if primvar.IsIndexed():
            primvar.BlockIndices()
        array_type = Vt.IntArray if kind == Sdf.ValueTypeNames.IntArray else Vt.FloatArray
        for code, array in arrays.items():
            primvar.Set(array_type.FromNumpy(np.ascontiguousarray(array.ravel())), code)


def blend_influences(influences: Influences, rows: Rows, most: int | None = None) -> Influences:
    """Joint influences of new points: the weighted mean of the old points', its largest weights, scaled to sum one.

    Args:
        influences: Of the old points.
        rows: The new points as blends of the old ones.
        most: Influences that a new point keeps; None for as many as an old one has.

    Returns:
        Influences in order of falling weight. A point without any weight keeps joint 0 with weight 0.
    """
    joints, weights = blend_arrays(influences.joints, influences.weights, rows.index, rows.weight, most)
    return Influences(joints, normalised_weights(weights))
