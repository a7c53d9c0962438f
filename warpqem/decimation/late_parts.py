"""Ordering again without parts that go too late.

Collapses cannot make a part small that has holes through it, such as a perforated plate. Where it has to go at last,
the others have been collapsed too far for it by then, and the mesh ends with far fewer faces than asked for.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from warpqem.decimation.decimate import DecimatedMesh
from warpqem.kernels.components import MAX_REMNANT_FACES

__all__ = ["without_late_parts"]

# How often a mesh is ordered again at most: without one component, which mostly is enough, without two more, and so on
# to sixteen more.
MAX_REPEATS = 5


def without_late_parts(
    ordered: DecimatedMesh, face_count: int, again: Callable[[np.ndarray], DecimatedMesh]
) -> DecimatedMesh:
    """The mesh with as many faces as asked for, if leaving out its latest large parts from the beginning leads there.

    Args:
        ordered: what ordering left.
        face_count: faces asked for.
        again: orders the mesh once more, with the components of vertices (V,) bool pruned first.
    """
    most = int(MAX_REMNANT_FACES)
    gone = np.zeros(len(ordered.root), dtype=bool)
    for repeat in range(MAX_REPEATS):
        if len(ordered.faces) + most > face_count:
            break
        drops = ordered.drops
        # What collapses leave with more faces than asked for is in no mesh with so few, however many there are of it.
        late = drops.vertices_of_largest(2**repeat, most) | drops.vertices_of_largest(len(drops), face_count)
        if not late.any():
            break
        gone |= late
        repeated = again(gone)
        if repeated.stopped != "target":
            break
        ordered = repeated
    return ordered
