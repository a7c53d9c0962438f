"""What a launch needs, and how its arguments are counted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import warp as wp

from warpqem.kernels.lanes import width_of

__all__ = [
    "Arguments",
    "Demand",
    "frames_of",
    "half_edges_of",
    "keys_of",
    "length_of",
    "moved_of",
    "size_of",
    "vertices_of",
]

INT, POINT, QUADRIC = 4, 12, 40
# Edges, faces and neighbours at a vertex of a closed triangle mesh, on average; half-edges that leave or enter it.
VALENCE = 6
# Position and quadric of a vertex in one frame.
ROW = POINT + QUADRIC
# Operations per edge and frame: the anchor 67; the merged quadric 70, its minimiser 56, value and sums 27.
COST_FLOPS = 220
# A face plane in a vertex quadric: cross product 15, length 7, plane and products 30, ten sums.
PLANE_FLOPS = 62
# The minimum of a quadric held to its anchor.
SOLVE_FLOPS = 60

Arguments = Mapping[str, Any]


@dataclass(frozen=True)
class Demand:
    """Bytes moved to and from memory, and floating-point operations."""

    bytes: float
    flops: float = 0.0

    def __add__(self, other: Demand) -> Demand:
        return Demand(self.bytes + other.bytes, self.flops + other.flops)


def length_of(edges: Any) -> int:
    """Length of a list that the device counts, all parts of it."""
    return int(edges.count.numpy().sum())


def size_of(array: Any) -> int:
    """Bytes of an array."""
    return int(array.size) * int(wp.types.type_size_in_bytes(array.dtype))


def frames_of(blocks: Any) -> int:
    """Frames in an array (V, B) of blocks of points (3, width), those that fill up the last block included."""
    return int(blocks.shape[1]) * width_of(blocks)


def keys_of(a: Arguments) -> int:
    """Key frames."""
    return frames_of(a["frames"].position)


def half_edges_of(a: Arguments) -> int:
    """Half-edges of the mesh as it is now."""
    return 3 * int(a["state"].face_count.numpy()[0])


def moved_of(a: Arguments) -> int:
    """Vertices that the last pass moved."""
    return max(0, length_of(a["log"]) - int(a["pass_begin"].numpy()[0]))


def vertices_of(a: Arguments) -> int:
    """Vertices of the mesh, all parts of it, in a launch over them."""
    if "members" in a:
        return int(a["members"].area.size)
    return int(a["vertex_flags" if "vertex_flags" in a else "vertex_flags_in"].size)
