"""The cost models by name: which frames decide, which weights apply, which deformation term is added.

| name   | order decided by                                   | source                                      |
|--------|----------------------------------------------------|---------------------------------------------|
| `qem`  | the first frame's quadrics                         | Garland & Heckbert 1997                     |
| `dsd`  | the sum of the frames' quadrics                    | Mohr & Gleicher 2003                        |
| `dod`  | that sum plus the edges' change of length          | Huang, Chen & Chuang, a poster              |
| `aqem` | that sum times the size of the motion feature      | Yang, Zhou, Lin, Lin & Lin 2019, equation 6 |
| `face` | that sum, feature points with neighbours' planes | multiresolution facial animation, eq. 1     |

Other packages add theirs as entry points of the group `warpqem.cost_models`: the name of the entry point is that of the
model, its object a :class:`CostModelSpec`. A name from the table stays what it is here.
"""

from __future__ import annotations

import functools
import sys
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Protocol

from warpqem.errors import OptionError

if TYPE_CHECKING:
    import numpy as np

    from warpqem.arguments.array_types import ArrayInput

__all__ = ["COST_MODELS", "ENTRY_POINTS", "CostModelSpec", "Metric", "VertexWeight", "cost_model", "cost_model_names"]

# Entry points of this group are cost models.
ENTRY_POINTS = "warpqem.cost_models"
# Texture attributes have a part in the error of the face paper. On a face scan of 52000 faces at a tenth this weight
# takes the largest twentieth of UV errors to 0.74 times what they were, for 3 % of the shape's RMS; 0.03 to 0.82 times
# for 2 %, 0.3 to 0.62 times for 14 %.
FACE_UV_WEIGHT = 0.1


class VertexWeight(Protocol):
    """A function that weighs the vertices of a mesh, see ``CostModelSpec.vertex_weight``."""

    def __call__(self, points: np.ndarray, faces: np.ndarray, /) -> ArrayInput:
        """Factors (V,) on the cost at each vertex, from key frames (K, V, 3) and faces (N, 3)."""
        ...


@dataclass(frozen=True)
class CostModelSpec:
    """What a cost model asks of the ordering.

    Attributes:
        name: as in ``simplify(metric=...)``.
        single_frame: only the first frame decides.
        deformation_weight: factor of the edge-length deformation term; 0 for none.
        uses_motion_features: costs are multiplied by the weights of the motion features.
        vertex_weight: called once for each mesh with the key frames, points (K, V, 3) float32 in the input's unit about
            a common origin and faces (N, 3) int32; returns factors on the cost at each vertex, (V,) numbers, 0 or more
            and finite, which multiply those the caller gives. Equal arguments have to give equal bits. None for none.
        keeps_face: the quadrics of the feature points of a face hold those of their neighbours, and the points stay
            vertices.
        uv_weight: weight of the error of texture coordinates where the caller names none, see
            :class:`warpqem.costs.AttributeField`; for USD files, which say what texture coordinates are.
        source: the paper, for reports.
    """

    name: str
    single_frame: bool = False
    deformation_weight: float = 0.0
    uses_motion_features: bool = False
    vertex_weight: VertexWeight | None = None
    keeps_face: bool = False
    uv_weight: float = 0.0
    source: str = ""


# A cost model by its name, as a spec, or as the vertex weights of one.
Metric = str | CostModelSpec | VertexWeight

COST_MODELS = {
    spec.name: spec
    for spec in (
        CostModelSpec("qem", single_frame=True, source="Garland & Heckbert 1997"),
        CostModelSpec("dsd", source="Mohr & Gleicher 2003"),
        CostModelSpec("dod", deformation_weight=1.0, source="Huang, Chen & Chuang, deformation oriented decimation"),
        CostModelSpec("aqem", uses_motion_features=True, source="Yang et al. 2019"),
        CostModelSpec(
            "face",
            keeps_face=True,
            uv_weight=FACE_UV_WEIGHT,
            source="multiresolution facial animation, equation 1",
        ),
    )
}


def cost_model_names() -> tuple[str, ...]:
    """The names of all cost models: those of warpqem, then those of other packages by name. None is loaded.

    Examples:
        >>> import warpqem
        >>> "dsd" in warpqem.costs.cost_model_names()
        True
    """
    return (*COST_MODELS, *sorted(_plug_ins()))


def cost_model(metric: Metric) -> CostModelSpec:
    """The cost model of that name; a spec is one itself, and a function the ``vertex_weight`` of one with its name.

    Raises:
        OptionError: there is none, or that of another package cannot be loaded or is no :class:`CostModelSpec`.
    """
    if isinstance(metric, CostModelSpec):
        return metric
    if callable(metric):
        return CostModelSpec(str(getattr(metric, "__name__", type(metric).__name__)), vertex_weight=metric)
    name = metric
    if not isinstance(name, str):
        from warpqem.arguments.number_input import shown

        raise OptionError(f"metric must be the name of a cost model, a CostModelSpec or a function, got {shown(name)}")
    if name in COST_MODELS:
        return COST_MODELS[name]
    found = _plug_ins()
    if name not in found:
        raise OptionError(f"unknown metric {name!r}; there are {', '.join(cost_model_names())}")
    origin = f"metric {name!r} of {found[name].value}"
    try:
        spec = found[name].load()
    except Exception as error:
        raise OptionError(f"{origin} cannot be loaded: {type(error).__name__}: {error}") from error
    if not isinstance(spec, CostModelSpec):
        raise OptionError(f"{origin} is a {type(spec).__name__}, expected a CostModelSpec")
    return replace(spec, name=name)


def _plug_ins() -> dict[str, EntryPoint]:
    return _plug_ins_on(tuple(sys.path))


# Commands ask for the names several times while they start, and each look goes through all installed packages.
@functools.lru_cache(maxsize=1)
def _plug_ins_on(_path: tuple[str, ...]) -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=ENTRY_POINTS) if point.name not in COST_MODELS}
