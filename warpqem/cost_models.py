"""The cost models by name: which frames decide, which weights apply, which deformation term is added.

| name   | order decided by                                   | source                                      |
|--------|----------------------------------------------------|---------------------------------------------|
| `qem`  | the first frame's quadrics                         | Garland & Heckbert 1997                     |
| `dsd`  | the sum of the frames' quadrics                    | Mohr & Gleicher 2003                        |
| `dod`  | that sum plus the edges' change of length          | deformation oriented decimation             |
| `aqem` | that sum times the size of the motion feature      | Yang, Zhou, Lin, Lin & Lin 2019, equation 6 |
"""

from __future__ import annotations

from dataclasses import dataclass

from warpqem.errors import OptionError

__all__ = ["COST_MODELS", "CostModelSpec", "cost_model"]


@dataclass(frozen=True)
class CostModelSpec:
    """What a cost model asks of the ordering.

    Attributes:
        name: as in ``simplify(metric=...)``.
        single_frame: only the first frame decides.
        deformation_weight: factor of the edge-length deformation term; 0 for none.
        uses_motion_features: costs are multiplied by the weights of the motion features.
    """

    name: str
    single_frame: bool = False
    deformation_weight: float = 0.0
    uses_motion_features: bool = False


COST_MODELS = {
    spec.name: spec
    for spec in (
        CostModelSpec("qem", single_frame=True),
        CostModelSpec("dsd"),
        CostModelSpec("dod", deformation_weight=1.0),
        CostModelSpec("aqem", uses_motion_features=True),
    )
}


def cost_model(name: str) -> CostModelSpec:
    """The cost model of that name.

    Raises:
        OptionError: there is none.
    """
    if name not in COST_MODELS:
        raise OptionError(f"unknown metric {name!r}; there are {', '.join(COST_MODELS)}")
    return COST_MODELS[name]
