"""Hybrid quadrics: planes of the present faces blended into those gathered from the input.

A quadric that gathers all planes of the input keeps thin parts, but it also keeps planes that the surface has left for
good; a quadric of the present faces alone ("memoryless", Lindstrom & Turk 1998) fits compact shapes better and eats
thin parts. A hybrid quadric is ``gathered`` times the planes of the input and ``1 - gathered`` times those of the
present faces; after each pass it is made anew at every vertex around a collapse.
"""

import warp as wp

from warpqem.kernels.lanes import lane_cross, lane_dot, lane_inverse_length, lane_kernel
from warpqem.kernels.mesh_state import KEY_FRAMES, AnyKeyFrames, MeshState
from warpqem.kernels.plane_quadrics import add_border_plane
from warpqem.kernels.quadric import add_plane, zero_quadric
from warpqem.kernels.topology import (
    BORDER,
    find_half_edge,
    half_edge_target,
    previous_corner,
)
from warpqem.kernels.work import Work, first_item, last_item


@wp.struct
class HybridWeights:
    """What the planes of the input count against the present ones, and what those on border and seam edges weigh."""

    gathered: wp.float32
    border: wp.float32
    seam: wp.float32


@wp.func
def line_weight(state: MeshState, weights: HybridWeights, h: wp.int32) -> wp.float32:
    """What the plane on half-edge ``h`` weighs: 0 where it is neither on a border nor a seam."""
    if state.seam[h] == 1:
        return weights.seam
    u = state.corner_vertex[h]
    v = half_edge_target(state.corner_vertex, h)
    weight = wp.float32(0.0)
    # Most edges have an inner end, and need no search.
    if (state.vertex_flags[u] & state.vertex_flags[v] & BORDER) != 0:
        opposite = find_half_edge(state.corner_vertex, state.stars, v, u)
        weight = wp.where(opposite < 0, weights.border, weight)
    return weight


@wp.func
def present_quadric(state: MeshState, frames: AnyKeyFrames, weights: HybridWeights, u: wp.int32, t: wp.int32):
    """Planes of the faces at ``u`` as they are now, and of its border and seam edges, about ``u``."""
    x = frames.position[u, t]
    q = zero_quadric(x)
    on_plane = lane_dot(x - x, x)
    for i in range(state.stars.start[u], state.stars.end[u]):
        h = state.stars.corner[i]
        a = frames.position[half_edge_target(state.corner_vertex, h), t]
        b = frames.position[state.corner_vertex[previous_corner(h)], t]
        cross = lane_cross(a - x, b - x)
        q = add_plane(q, cross, on_plane, lane_inverse_length(cross) * 0.5)
        leaving = line_weight(state, weights, h)
        if leaving > 0.0:
            q = add_border_plane(q, x, a, b, x, leaving)
        entering = line_weight(state, weights, previous_corner(h))
        if entering > 0.0:
            q = add_border_plane(q, b, x, a, x, entering)
    return q


@lane_kernel(frames=KEY_FRAMES)
def blend_present_planes(
    state: MeshState,
    frames: AnyKeyFrames,
    weights: HybridWeights,
    mask_in: wp.array[wp.int32],
    pass_number_in: wp.array[wp.int32],
    work: Work,
):
    """Blend gathered and present planes at the vertices that this pass masked."""
    vertex_count = state.vertex_flags.shape[0]
    for u in range(first_item(vertex_count, work) + wp.tid(), last_item(vertex_count, work), work.lanes):
        if mask_in[u] == pass_number_in[0] and state.stars.end[u] > state.stars.start[u]:
            for t in range(frames.position.shape[1]):
                q = present_quadric(state, frames, weights, u, t)
                share = (1.0 - weights.gathered) * state.quadric_scale[u]
                frames.quadric[u, t] = weights.gathered * frames.gathered[u, t] + share * q
