"""Quadrics of the present faces, for an order without a memory of the input's planes (Lindstrom & Turk 1998).

Planes of the input that the surface has left for good hold vertices where nothing is any more; those of the present
faces alone fit compact shapes better. They would let thin parts go, which the distances of
:mod:`warpqem.kernels.member_distance` keep.
"""

import warp as wp

from warpqem.kernels.lanes import lane_cross, lane_inverse_length, lane_kernel, lane_scale
from warpqem.kernels.mesh_state import KEY_FRAMES, AnyKeyFrames, MeshState
from warpqem.kernels.plane_quadrics import add_border_plane
from warpqem.kernels.quadric import zero_quadric
from warpqem.kernels.topology import (
    BORDER,
    SEAM,
    find_half_edge,
    half_edge_target,
    previous_corner,
)
from warpqem.kernels.work import Work, first_item, last_item


@wp.struct
class LineWeights:
    """What the planes on border and seam edges weigh."""

    border: wp.float32
    seam: wp.float32


@wp.func
def line_weight(state: MeshState, weights: LineWeights, h: wp.int32) -> wp.float32:
    """What the plane on half-edge ``h`` weighs: 0 where it is neither on a border nor a seam."""
    if state.seam[h] == 1:
        return weights.seam
    u = state.corner_vertex[h]
    v = half_edge_target(state.corner_vertex, h)
    weight = wp.float32(0.0)
    # Most edges have an inner end, and need no search.
    if (state.vertex_flags[u] & state.vertex_flags[v] & BORDER) != 0:
        opposite = find_half_edge(state.corner_vertex, state.adjacency, v, u)
        weight = wp.where(opposite < 0, weights.border, weight)
    return weight


@wp.func
def memoryless_quadric(state: MeshState, frames: AnyKeyFrames, weights: LineWeights, u: wp.int32, t: wp.int32):
    """Planes of the faces at ``u`` as they are now, and of its border and seam edges, about ``u``."""
    x = frames.position[u, t]
    q = zero_quadric(x)
    has_lines = (state.vertex_flags[u] & (BORDER | SEAM)) != 0
    for i in range(state.adjacency.start[u], state.adjacency.end[u]):
        h = state.adjacency.corner[i]
        a = frames.position[half_edge_target(state.corner_vertex, h), t]
        b = frames.position[state.corner_vertex[previous_corner(h)], t]
        cross = lane_cross(a - x, b - x)
        # The vertex lies on the plane, so that of its quadric only the matrix is not zero.
        n = lane_scale(lane_inverse_length(cross) * 0.5, cross)
        q[0] += wp.cw_mul(n[0], cross[0])
        q[1] += wp.cw_mul(n[0], cross[1])
        q[2] += wp.cw_mul(n[0], cross[2])
        q[3] += wp.cw_mul(n[1], cross[1])
        q[4] += wp.cw_mul(n[1], cross[2])
        q[5] += wp.cw_mul(n[2], cross[2])
        if has_lines:
            leaving = line_weight(state, weights, h)
            if leaving > 0.0:
                q = add_border_plane(q, x, a, b, x, leaving)
            entering = line_weight(state, weights, previous_corner(h))
            if entering > 0.0:
                q = add_border_plane(q, b, x, a, x, entering)
    return q


@lane_kernel(frames=KEY_FRAMES)
def renew_quadrics(
    # in
    state: MeshState,
    # in and out
    frames: AnyKeyFrames,
    # in
    weights: LineWeights,
    mask_in: wp.array[wp.int32],
    pass_number_in: wp.array[wp.int32],
    work: Work,
):
    """Make the quadrics of the vertices that this pass masked anew: of the planes around them, and the sums kept."""
    vertex_count = state.vertex_flags.shape[0]
    for u in range(first_item(vertex_count, work) + wp.tid(), last_item(vertex_count, work), work.thread_count):
        if mask_in[u] == pass_number_in[0] and state.adjacency.end[u] > state.adjacency.start[u]:
            for t in range(frames.position.shape[1]):
                frames.quadric[u, t] = state.quadric_scale[u] * memoryless_quadric(state, frames, weights, u, t)
            if state.sum_row.shape[0] > 0:
                row = state.sum_row[u]
                if row >= 0:
                    for t in range(frames.position.shape[1]):
                        frames.quadric[u, t] = frames.quadric[u, t] + frames.kept_sum[row, t]
