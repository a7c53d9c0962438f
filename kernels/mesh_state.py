"""The state of a mesh while its edges are collapsed: what the kernels of one pass read and write."""

from typing import Any

import warp as wp

from warpqem.kernels.lanes import POINTS, POINTS_ARRAY, QUADRIC, QUADRIC_ARRAY, WIDTHS
from warpqem.kernels.topology import VertexAdjacency

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Attributes live in one frame: blocks of one.
Point = POINTS[1]
Quadric = QUADRIC[1]

# The bits of infinity: floats that are not negative are in the order of their bits.
INFINITE_BITS = wp.constant(wp.int32(0x7F800000))


@wp.struct
class Wedges:
    """Attributes as linear functions ``value + gradient.(x - origin)`` in the first key frame (W wedges, C channels).

    A wedge is the corners of one vertex that share their values. See :mod:`warpqem.kernels.attribute`.
    """

    channel_count: wp.int32  # C; 0: the order does not look at attributes, and the arrays are empty
    corner_wedge: wp.array[wp.int32]  # (3N,)
    area: wp.array[wp.float32]  # (W,) in diagonals squared, of all faces gathered so far
    origin: wp.array[Point]  # (W,) in diagonals
    value: wp.array2d[wp.float32]  # (W, C) times the weight
    gradient: wp.array2d[Point]  # (W, C) times the weight, per diagonal
    position: wp.array[Point]  # (V,) the vertex in the first key frame
    quadric: wp.array[Quadric]  # (V,) variance of the attributes at a vertex, origin at ``position``


@wp.struct
class Members:
    """The input vertices that each vertex stands for, as linked lists that begin with itself (V vertices)."""

    area: wp.array2d[wp.float32]  # (2, V) a third of the faces around, in diagonals squared: first frame, mean of all
    reach_squared: wp.array2d[wp.float32]  # (2, V) how far its faces reach from it, squared, likewise
    first_point: wp.array[wp.vec3]  # (V,) each in the first key frame: what is walked over most lies close together
    following: wp.array[wp.int32]  # (V,) -1 for the last one
    last: wp.array[wp.int32]  # (V,)


@wp.struct
class Deformation:
    """What the deformation term sums over chunks of frames (C chunks), only where there is one.

    See :mod:`warpqem.kernels.deformation`.
    """

    chunk_frames: wp.int32  # frames in a chunk
    face_area: wp.array2d[wp.float32]  # (N, C) sum of the areas, in diagonals squared
    steps: wp.array2d[wp.vec3]  # (3N, C) at canonical half-edges: mean, squared deviations, largest above mean
    anchor: wp.array2d[wp.float32]  # (V, C) how far a kept vertex is yet to move towards the removed one; else 0


@wp.struct
class MeshState:
    """Faces, vertex-corner adjacency, flags and edge costs (V vertices, N faces, F frames)."""

    face_count: wp.array[wp.int32]  # (1,) faces in the arrays, dead ones included
    corner_vertex: wp.array[wp.int32]  # (3N,) vertex of each corner; -1 in a dead face
    adjacency: VertexAdjacency
    vertex_flags: wp.array[wp.int32]  # (V,) BORDER | LOCKED | NON_MANIFOLD | SEAM | CORNER
    cost_weight: wp.array[wp.float32]  # (V,) multiplies the cost; averaged when two vertices merge
    quadric_scale: wp.array[wp.float32]  # (V,) what planes at a vertex count; averaged when two vertices merge
    sum_row: wp.array[wp.int32]  # (V,) row of ``kept_sum``, -1 for none; empty where no sums are kept
    seam: wp.array[wp.int32]  # (3N,) 1 at both half-edges of a seam edge
    edge_cost: wp.array[wp.float32]  # (3N,) at canonical half-edges; inf: no collapse here; negative: suspended
    trajectory: wp.array2d[wp.vec3]  # (V, F) every frame's position, only where a deformation term needs it
    deformation: Deformation
    wedges: Wedges  # attributes, only where they have a weight
    members: Members


@wp.func
def degree(state: MeshState, v: wp.int32) -> wp.int32:
    """Faces at a vertex."""
    return state.adjacency.end[v] - state.adjacency.start[v]


def _key_frames(width: int) -> type:
    """The struct for blocks of ``width`` frames."""

    @wp.struct
    class KeyFrames:
        """Position and quadric of each vertex in each block of key frames (V vertices, B blocks)."""

        position: POINTS_ARRAY[width]  # (V, B) in units of the bounding-box diagonal
        input: POINTS_ARRAY[width]  # (V, B) the same before the first collapse: positions of members
        quadric: QUADRIC_ARRAY[width]  # (V, B) origin at the vertex's position in that frame
        kept_sum: QUADRIC_ARRAY[width]  # (R, B) what memoryless quadrics get besides the present faces' planes

    return KeyFrames


KEY_FRAMES = {width: _key_frames(width) for width in WIDTHS}
AnyKeyFrames = Any  # one of KEY_FRAMES


@wp.struct
class CostModel:
    """What the cost of an edge is made of, and where its collapse puts the vertex."""

    key_count: wp.float32  # key frames K
    epsilon: wp.float32  # regularisation towards the edge anchor, relative to the quadric's trace
    endpoint: wp.int32  # 1: the vertex goes to the better end; 0: to the optimum
    error_limit: wp.float32  # squared error, in diagonals squared, above which no edge collapses
    deformation_weight: wp.float32  # factor of the deformation term; 0: none


@wp.struct
class CollapseLog:
    """Collapses in the order of application; a pass owns the range from its first slot to the count."""

    count: wp.array[wp.int32]  # (1,)
    round_count: wp.array[wp.int32]  # (1,) rounds of reservations so far
    kept: wp.array[wp.int32]  # (V,)
    removed: wp.array[wp.int32]  # (V,)
    left_opposite: wp.array[wp.int32]  # (V,) the vertex opposite the edge in its canonical face
    right_opposite: wp.array[wp.int32]  # (V,) -1 at a border
    cost: wp.array[wp.float32]  # (V,)
    error: wp.array[wp.float32]  # (V,) squared, in diagonals squared
    faces_removed: wp.array[wp.int32]  # (V,)
    round_index: wp.array[wp.int32]  # (V,) from 1
