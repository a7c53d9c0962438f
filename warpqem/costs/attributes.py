"""Attributes that the collapse order looks at: UVs, colours, any values on the surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from warpqem.arguments.array_input import FLOAT32_MAX, first_beyond, real_array
from warpqem.arguments.array_record import ArrayRecord
from warpqem.arguments.array_types import ArrayInput
from warpqem.arguments.limits import WEIGHTS
from warpqem.arguments.number_input import real_number
from warpqem.errors import MeshShapeError, OptionError
from warpqem.mesh.mesh_input import MeshInput

__all__ = [
    "AttributeField",
    "channel_count",
    "check_span",
    "checked_fields",
    "field_weight",
    "weighted_corner_values",
]

# Squares of differences of weighted values are float32, summed over faces and key frames: from 1e18 on costs and
# positions come out as no numbers.
MAX_SPAN = 1e15


@dataclass(frozen=True, eq=False, repr=False)
class AttributeField(ArrayRecord):
    """Values on the surface whose error the collapse order is to keep low.

    Attributes:
        values: (V,) or (V, C) at the vertices, or (N, 3, C) at the corners of the faces, real numbers in any unit.
            Corners of a vertex with other values lie on other sides of a seam, and are not compared. The values of a
            channel, times the weight, span 1e15 at most.
        weight: 0 (not looked at) to 1e6. At 1, an error of one in a value counts as much as an error of one
            bounding-box diagonal in position, in every key frame.
    """

    values: ArrayInput
    weight: float = 1.0


def weighted_corner_values(fields: Sequence[AttributeField], mesh: MeshInput) -> np.ndarray | None:
    """All channels at the corners of ``mesh.faces``, times their weights: (N, 3, C) float64; None for none.

    Fields of weight 0 are checked and left out.

    Raises:
        MeshShapeError: values of another shape or dtype, or a value that is not finite.
        OptionError: a weight outside its range, or values too far apart.
    """
    channels = []
    for index, (values, weight) in enumerate(zip(*checked_fields(fields, mesh), strict=True)):
        if weight > 0.0:
            at_corners = values[mesh.face_index] if values.ndim == 3 else values[mesh.faces]
            try:
                check_span(values, weight)
            except OptionError as error:
                raise OptionError(f"attributes[{index}]: {error}") from error
            channels.append(at_corners.astype(np.float64) * weight)
    return np.concatenate(channels, axis=2) if channels else None


def check_span(values: np.ndarray, weight: float) -> None:
    """Check that values (..., C) of a field are near enough to each other.

    Raises:
        OptionError: they are not; the message begins with the channel.
    """
    # All channels at once, which takes a tenth of the time, say for nearly every mesh that none spans too much.
    if not values.size or weight * (float(values.max()) - float(values.min())) <= MAX_SPAN:
        return
    span = weight * np.ptp(values.astype(np.float64).reshape(-1, values.shape[-1]), axis=0)
    channel = int(span.argmax())
    if span[channel] > MAX_SPAN:
        raise OptionError(
            f"channel {channel} spans {span[channel]:g}, times its weight, expected at most {MAX_SPAN:g}, as costs are "
            "in single precision"
        )


def checked_fields(fields: Sequence[AttributeField], mesh: MeshInput) -> tuple[list[np.ndarray], list[float]]:
    """Values of each field, (V, C) or (N, 3, C), and its weight.

    Raises:
        MeshShapeError: values of another shape or dtype, or a value that is not finite.
        OptionError: a weight outside its range.
    """
    values, weights = [], []
    for index, field in enumerate(fields):
        weights.append(field_weight(field, index))
        values.append(_checked(field.values, f"attributes[{index}].values", mesh.vertex_count, mesh.input_face_count))
    return values, weights


def field_weight(field: AttributeField, index: int) -> float:
    """The weight of a field, the index-th of all.

    Raises:
        OptionError: it is outside its range.
    """
    return real_number(field.weight, f"attributes[{index}].weight", str(WEIGHTS), WEIGHTS.__contains__)


def channel_count(fields: Sequence[AttributeField], mesh: MeshInput) -> int:
    """Channels of :func:`weighted_corner_values`, 0 for none, after the same checks."""
    values, weights = checked_fields(fields, mesh)
    return sum(array.shape[-1] for array, weight in zip(values, weights, strict=True) if weight > 0.0)


def _checked(values: Any, name: str, vertex_count: int, face_count: int) -> np.ndarray:
    """Finite ``values`` as (V, C) or (N, 3, C)."""
    array = real_array(
        values,
        name,
        (vertex_count,),
        (vertex_count, "C"),
        (face_count, 3, "C"),
        expected=f"numbers of shape ({vertex_count}, C) at vertices or ({face_count}, 3, C) at corners",
        bools=True,
    )
    if array.shape[-1] == 0:
        raise MeshShapeError(f"{name} must be numbers of at least one channel, got shape {array.shape}")
    array = array[:, None] if array.ndim == 1 else array
    where = first_beyond(array, FLOAT32_MAX)
    if where is not None:
        raise MeshShapeError(f"{name} at {where} is {array[where]}")
    return array
