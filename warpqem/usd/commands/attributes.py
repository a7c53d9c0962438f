"""The primvars whose error the collapse order is to keep low."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

from warpqem.arguments.array_input import FLOAT32_MAX, first_beyond
from warpqem.costs.attributes import AttributeField, check_span
from warpqem.errors import OptionError, StageError
from warpqem.usd.commands.option_checks import AttributeWeights, bare_name
from warpqem.usd.read.mesh_seams import DISPLAY_COLORS, corner_values
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.texture_coordinates import is_uv

__all__ = ["check_names", "weighted_fields"]

# Default weight of display colours. On a rolling sheet of 8192 faces with a soft disc, the colours at
# a tenth of the faces come 3 times as near to the input's by it as without, and the RMS distance stays; at 3 % of the
# faces twice as near, for 13 %.
COLOR_WEIGHT = 0.005

# The same where one colour ends and another begins over an edge: a border that shows, as that between colours of whole
# faces. At 3 % of its faces the disc of such a sheet overlaps with the input's by 97 %; at the weight above by 96 %,
# without one by 90 %.
BORDER_WEIGHT = 0.01

# Colours have borders where so many of the triangles of several colours lie between triangles of one. All do, but for
# corners of the border; on a gradient next to none.
BORDER_SHARE = 0.5


def check_names(prims: Iterable[Usd.Prim], weights: AttributeWeights) -> None:
    """Check that every name is that of a primvar of one of the meshes at least.

    Raises:
        OptionError: one is not.
    """
    prims = list(prims)
    for name, _ in weights:
        if not any(UsdGeom.PrimvarsAPI(prim).GetPrimvar(bare_name(name)).HasAuthoredValue() for prim in prims):
            raise OptionError(f"attribute_weights: none of the {len(prims)} meshes has a primvar {bare_name(name)}")


def weighted_fields(source: MeshSource, uv_weight: float, weights: AttributeWeights) -> list[AttributeField]:
    """The primvars of a mesh that have a weight, at the corners of its triangles, by their first sample.

    Constant primvars have no error and are left out. Display colours and opacities that `weights` does not name have
    a default one where they vary within triangles; borders between colours of whole faces are seams instead.

    Args:
        source: The mesh.
        uv_weight: Weight of texture coordinates that `weights` does not name.
        weights: Weights of single primvars.

    Raises:
        StageError: a primvar that `weights` names has no real numbers at points or corners, or a primvar has a value
            that is not finite, or values too far apart for its weight.
    """
    named = {bare_name(name): weight for name, weight in weights}
    api = UsdGeom.PrimvarsAPI(source.prim)
    wanted = {}
    for primvar in api.GetPrimvarsWithAuthoredValues():
        name = str(primvar.GetPrimvarName())
        weight = named.get(name, uv_weight if is_uv(primvar) else 0.0)
        if weight > 0.0 and primvar.GetInterpolation() != UsdGeom.Tokens.constant:
            wanted[primvar.GetAttr().GetName()] = weight
    colors = [name for name in DISPLAY_COLORS if bare_name(name) not in named and _varies(api, name)]
    if not wanted and not colors:
        return []
    found = corner_values(source, points_too=True)
    values = {name: next(iter(samples.values())) for name, samples, _ in found if samples}
    fields = []
    for name, weight in wanted.items():
        if name in values and values[name].dtype.kind == "f":
            fields.append(_weighted_field(source, name, values[name], weight))
        elif bare_name(name) in named:
            raise StageError(f"{source.path}.{name}: has no real numbers at points or corners that could be weighed")
    fields += [_color_field(values[name], source.topology.triangles) for name in colors if name in values]
    return [field for field in fields if field.weight > 0.0]


def _weighted_field(source: MeshSource, name: str, values: npt.NDArray[Any], weight: float) -> AttributeField:
    """Values of a primvar at the corners of the triangles, with their weight.

    Raises:
        StageError: one is no finite number in single precision, or they are too far apart for that weight.
    """
    topology = source.topology
    corners = values.reshape(len(topology.triangles), 3, -1)
    bad = first_beyond(corners, FLOAT32_MAX)
    if bad is not None:
        point, face = topology.triangles[bad[:2]], topology.triangle_polygons[bad[0]]
        value = corners[bad[:2]].squeeze().tolist()
        raise StageError(f"{source.path}.{name}: value {value} at point {point} of face {face} has no error to weigh")
    try:
        check_span(corners, weight)
    except OptionError as error:
        raise StageError(f"{source.path}.{name}: {error}") from error
    return AttributeField(corners, weight)


def _varies(api: UsdGeom.PrimvarsAPI, name: str) -> bool:
    """True of a primvar with values at points or corners."""
    primvar = api.GetPrimvar(bare_name(name))
    at_faces = (UsdGeom.Tokens.constant, UsdGeom.Tokens.uniform)
    return bool(primvar and primvar.HasAuthoredValue()) and primvar.GetInterpolation() not in at_faces


def _color_field(values: npt.NDArray[Any], triangles: npt.NDArray[np.int32]) -> AttributeField:
    """A display colour or opacity with its default weight; 0 where it does not vary within triangles, or is broken."""
    corners = values.reshape(len(triangles), 3, -1)
    if corners.dtype.kind != "f" or not np.isfinite(corners).all():
        return AttributeField(corners, 0.0)
    varied = (corners != corners[:, :1]).any(axis=(1, 2))
    if not varied.any():
        return AttributeField(corners, 0.0)
    of_one_color = np.zeros(int(triangles.max()) + 1, dtype=bool)
    of_one_color[triangles[~varied]] = True
    has_borders = of_one_color[triangles[varied]].all(axis=1).mean() > BORDER_SHARE
    weight = BORDER_WEIGHT if has_borders else COLOR_WEIGHT
    # Display colours lie between 0 and 1; what ranges further, as colours of high dynamic range, counts as if it did.
    return AttributeField(corners, weight / max(1.0, float(np.ptp(corners.astype(np.float64)))))
