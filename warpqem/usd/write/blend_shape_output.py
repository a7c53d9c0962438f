"""Write the blend shapes of a mesh for its new points."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdSkel, Vt

from warpqem.usd.read.blend_shapes import ShapeData
from warpqem.usd.write.attribute_transfer import AttributeTransfer, Rows
from warpqem.usd.write.fitted_values import fit_normal_offsets

__all__ = ["write_shape"]

# Offsets shorter than this share of the mesh's diagonal are rounding errors of float32.
ZERO_SHARE = 1e-7


def write_shape(
    stage: Usd.Stage, shape: ShapeData, rows: Rows, diagonal: float, transfer: AttributeTransfer | None = None
) -> None:
    """Author a blend shape for new points, without the points that it does not move.

    Args:
        stage: Stage whose edit target takes the edits.
        shape: The shape on the old points.
        rows: The new points as blends of the old ones.
        diagonal: Bounding-box diagonal of the mesh's rest shape.
        transfer: Where the new mesh gets its values from: offsets of normals are fitted as normals
            are; None to blend them.
    """
    prim = stage.OverridePrim(shape.path)
    if not shape.arrays:
        # A shape without offsets moves nothing. Point indices without offsets would not fit it.
        attribute = UsdSkel.BlendShape(prim).GetPointIndicesAttr()
        if attribute.Get():
            attribute.Set(Vt.IntArray())
        return
    transferred: dict[str, npt.NDArray[np.float64]] = {
        name: rows.blend(values) for name, values in shape.arrays.items()
    }
    moves = np.zeros(len(rows.index), dtype=bool)
    if transfer is not None and transfer.normals == "fit":
        for name, offsets in shape.arrays.items():
            if _is_of_normals(name):
                transferred[name] = fit_normal_offsets(transfer, offsets, transferred[name])
    for name, values in transferred.items():
        # Normal offsets belong to vectors of length one, whatever the size of the mesh.
        size = 1.0 if _is_of_normals(name) else diagonal
        moves |= (np.abs(values) > ZERO_SHARE * size).any(axis=1)
    # A shape without any index would be read as one with an offset for every point.
    moves[0] |= not moves.any()
    indices = np.flatnonzero(moves).astype(np.int32)
    for name, values in transferred.items():
        prim.GetAttribute(name).Set(Vt.Vec3fArray.FromNumpy(values[indices].astype(np.float32)))
    UsdSkel.BlendShape(prim).CreatePointIndicesAttr(Vt.IntArray.FromNumpy(indices))


def _is_of_normals(name: str) -> bool:
    return name.split(":")[-1] == "normalOffsets"
