"""Attributes that the collapse order looks at: UVs, colours, any values on the surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from warpqem.errors import MeshShapeError, OptionError
from warpqem.mesh_input import MeshInput, as_numpy

__all__ = ["AttributeField", "channel_count", "weighted_corner_values"]

# Squares of weighted values go into float32 costs, which end at 1e38.
MOST_WEIGHT = 1e6


@dataclass(frozen=True)
class AttributeField:
    """Values on the surface whose error the collapse order is to keep low.

    Attributes:
        values: (V,) or (V, C) at the vertices, or (N, 3, C) at the corners of the faces, real numbers in any unit.
            Corners of a vertex with other values lie on other sides of a seam, and are not compared.
        weight: 0 (not looked at) to 1e6. At 1, an error of one in a value counts as much as an error of one
            bounding-box diagonal in position, in every key frame.
    """

    values: Any
    weight: float = 1.0


def weighted_corner_values(fields: Sequence[AttributeField], mesh: MeshInput) -> np.ndarray | None:
    """All channels at the corners of ``mesh.faces``, times their weights: (N, 3, C) float64; None for none.

    Fields of weight 0 are checked and left out.

    Raises:
        MeshShapeError: values of another shape or dtype, or a value that is not finite.
        OptionError: a weight outside its range.
    """
    channels = []
    for index, field in enumerate(fields):
        if not 0.0 <= field.weight <= MOST_WEIGHT:
            raise OptionError(f"attributes[{index}].weight must be in [0, {MOST_WEIGHT:g}], got {field.weight}")
        values = _checked(
            as_numpy(field.values), f"attributes[{index}].values", mesh.vertex_count, mesh.input_face_count
        )
        if field.weight > 0.0:
            at_corners = values[mesh.face_index] if values.ndim == 3 else values[mesh.faces]
            channels.append(at_corners.astype(np.float64) * field.weight)
    return np.concatenate(channels, axis=2) if channels else None


def channel_count(fields: Sequence[AttributeField]) -> int:
    """Channels of :func:`weighted_corner_values`, 0 for none."""
    arrays = [as_numpy(field.values) for field in fields if field.weight > 0.0]
    return sum(1 if array.ndim == 1 else array.shape[-1] for array in arrays)


def _checked(values: np.ndarray, name: str, vertex_count: int, face_count: int) -> np.ndarray:
    """``values`` as (V, C) or (N, 3, C)."""
    if values.ndim == 1:
        values = values[:, None]
    at_vertices = values.ndim == 2 and len(values) == vertex_count
    at_corners = values.ndim == 3 and values.shape[:2] == (face_count, 3)
    if not (at_vertices or at_corners) or values.dtype.kind not in "fiub" or values.shape[-1] == 0:
        raise MeshShapeError(
            f"{name} must be numbers of shape ({vertex_count}, C) at vertices or ({face_count}, 3, C) at corners, "
            f"got shape {values.shape} dtype {values.dtype}"
        )
    if not np.isfinite(values).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(values))[0])
        raise MeshShapeError(f"{name} at {where} is {values[where]}")
    return values
