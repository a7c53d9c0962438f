"""The attribute error of a collapse: what the order sees of UVs and other values on the surface.

Each face carries a linear function of the position, ``a_f(x) = g_f.x + d_f`` per channel, in one reference frame. A
merged vertex at ``x`` with the free value ``s`` deviates from its faces by ``sum_f area_f (a_f(x) - s)^2``, area
weighted and with the gradients as they are, not normalised (Hoppe 1999, "New quadric metric for simplifying meshes with
appearance attributes"). With the best ``s``, the mean of the ``a_f(x)``, this is a variance, and so a quadric in ``x``
alone. Per wedge (corners of a vertex with one value) it needs the area ``W`` and the mean function ``m(x)`` only: when
wedges ``i`` and ``j`` merge, their variances add up to

    ``E_ij(x) = E_i(x) + E_j(x) + W_i W_j / (W_i + W_j) (m_i(x) - m_j(x))^2``
    ``m_ij(x) = (W_i m_i(x) + W_j m_j(x)) / (W_i + W_j)``

(the parallel-axis theorem). So the ``E`` of all wedges of a vertex are kept as one :class:`Quadric` about it, a merge
adds one plane per channel, and functions of different charts are never compared: a collapse merges the wedges that the
faces at its edge join, and those only. A wedge's function keeps an origin of its own and is moved when it merges.
"""

from typing import Any

import warp as wp

from warpqem.kernels.lanes import QUADRIC_ARRAY, lane_kernel
from warpqem.kernels.mesh_state import MeshState, Point, Quadric, Wedges
from warpqem.kernels.quadric import add_plane, apply_matrix, linear_part, shift_origin
from warpqem.kernels.topology import find_half_edge, next_corner

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.func
def first_frame(block: Any) -> Point:
    """The points of a block's first frame."""
    p = Point()
    p[0, 0] = block[0, 0]
    p[1, 0] = block[1, 0]
    p[2, 0] = block[2, 0]
    return p


@wp.func
def dot(a: Point, b: Point) -> wp.float32:
    """Dot product."""
    return a[0, 0] * b[0, 0] + a[1, 0] * b[1, 0] + a[2, 0] * b[2, 0]


@wp.func
def value_at(wedges: Wedges, w: wp.int32, k: wp.int32, x: Point) -> wp.float32:
    """``m(x)`` of channel ``k`` of wedge ``w``."""
    return wedges.value[w, k] + dot(wedges.gradient[w, k], x - wedges.origin[w])


@wp.func
def add_square(q: Quadric, gradient: Point, value: wp.float32, weight: wp.float32) -> Quadric:
    """``Q + weight (gradient.x + value)^2``."""
    return add_plane(q, gradient, type(gradient[0])(value), type(gradient[0])(weight))


@wp.func
def first_share(area: wp.float32, other_area: wp.float32) -> wp.float32:
    """``W_i / (W_i + W_j)``; one half without any area."""
    total = area + other_area
    return wp.where(total > 0.0, area / total, wp.float32(0.5))


@wp.func
def joined_corners(state: MeshState, u: wp.int32, v: wp.int32, side: wp.int32) -> wp.vec2i:
    """The corners at ``u`` and at ``v`` of the face left (side 0) or right (1) of the edge; -1 where there is none."""
    a = wp.where(side == 0, u, v)
    b = wp.where(side == 0, v, u)
    h = find_half_edge(state.corner_vertex, state.adjacency, a, b)
    if h < 0:
        return wp.vec2i(-1, -1)
    if side == 0:
        return wp.vec2i(h, next_corner(h))
    return wp.vec2i(next_corner(h), h)


@wp.func
def joined_wedges(state: MeshState, u: wp.int32, v: wp.int32, side: wp.int32) -> wp.vec2i:
    """The wedges that the face on one side of the edge joins; -1 where there is no face."""
    corners = joined_corners(state, u, v, side)
    if corners[0] < 0:
        return corners
    return wp.vec2i(state.wedges.corner_wedge[corners[0]], state.wedges.corner_wedge[corners[1]])


@wp.func
def merged_attribute_quadric(state: MeshState, u: wp.int32, v: wp.int32, x: Point) -> Quadric:
    """``E`` of the merged vertex, all its wedges and channels, about the point ``x`` of the reference frame."""
    wedges = state.wedges
    q = shift_origin(wedges.quadric[u], x - wedges.position[u])
    q += shift_origin(wedges.quadric[v], x - wedges.position[v])
    left = joined_wedges(state, u, v, 0)
    right = joined_wedges(state, u, v, 1)
    if left[0] < 0:
        left = right
    # Both faces join the same two wedges, unless the edge is a seam. Where a seam ends they have one wedge in common:
    # then the third joins the first two.
    is_second = right[0] >= 0 and (right[0] != left[0] or right[1] != left[1])
    is_third = is_second and (right[0] == left[0] or right[1] == left[1])
    area_a = wedges.area[left[0]]
    area_b = wedges.area[left[1]]
    share = first_share(area_a, area_b)
    for k in range(wedges.channel_count):
        a = value_at(wedges, left[0], k, x)
        b = value_at(wedges, left[1], k, x)
        ga = wedges.gradient[left[0], k]
        gb = wedges.gradient[left[1], k]
        q = add_square(q, ga - gb, a - b, share * area_b)
        if is_second:
            c = value_at(wedges, right[0], k, x)
            gc = wedges.gradient[right[0], k]
            area_c = wedges.area[right[0]]
            d = value_at(wedges, right[1], k, x)
            gd = wedges.gradient[right[1], k]
            area_d = wedges.area[right[1]]
            if is_third:
                if right[0] == left[0]:
                    c = d
                    gc = gd
                    area_c = area_d
                d = b + share * (a - b)
                gd = gb + share * (ga - gb)
                area_d = area_a + area_b
            q = add_square(q, gc - gd, c - d, first_share(area_c, area_d) * area_d)
    return q


@wp.func
def attribute_parabola(state: MeshState, u: wp.int32, v: wp.int32) -> wp.vec2:
    """``(b.d, d^T A d)`` of the merged ``E`` about ``u`` along the edge ``d``: its course over the material anchor."""
    p = state.wedges.position[u]
    d = state.wedges.position[v] - p
    q = merged_attribute_quadric(state, u, v, p)
    return wp.vec2(dot(d, linear_part(q)), dot(d, apply_matrix(q, d)))


@wp.func
def attribute_error(state: MeshState, u: wp.int32, v: wp.int32, x: Point) -> wp.float32:
    """``E(x)`` of the merged vertex at ``x`` in the reference frame."""
    q = merged_attribute_quadric(state, u, v, x)
    return wp.max(q[9, 0], 0.0)


@wp.func
def relabel_ring(state: MeshState, v: wp.int32, w: wp.int32, new: wp.int32):
    """Corners of wedge ``w`` around ``v`` become corners of wedge ``new``."""
    for i in range(state.adjacency.start[v], state.adjacency.end[v]):
        if state.wedges.corner_wedge[state.adjacency.corner[i]] == w:
            state.wedges.corner_wedge[state.adjacency.corner[i]] = new


@wp.func
def merge_wedges(state: MeshState, u: wp.int32, v: wp.int32, x: Point):
    """Merge the wedges of ``v`` into those of ``u``, which goes to ``x``; called while the faces are still there.

    All that is written belongs to the one-rings of ``u`` and ``v``, which no other selected collapse touches.
    """
    wedges = state.wedges
    wedges.quadric[u] = merged_attribute_quadric(state, u, v, x)
    wedges.position[u] = x
    for side in range(2):
        # The second side sees the wedges as the first has left them.
        pair = joined_wedges(state, u, v, side)
        a = pair[0]
        b = pair[1]
        if a != b:
            share = first_share(wedges.area[a], wedges.area[b])
            for k in range(wedges.channel_count):
                value = value_at(wedges, b, k, x)
                wedges.value[a, k] = value + share * (value_at(wedges, a, k, x) - value)
                gradient = wedges.gradient[b, k]
                wedges.gradient[a, k] = gradient + share * (wedges.gradient[a, k] - gradient)
            wedges.origin[a] = x
            wedges.area[a] = wedges.area[a] + wedges.area[b]
            relabel_ring(state, u, b, a)
            relabel_ring(state, v, b, a)


@wp.kernel
def move_corner_wedges(
    # in
    corner_vertex_in: wp.array[wp.int32],
    corner_wedge_in: wp.array[wp.int32],
    live_rank_in: wp.array[wp.int32],
    # out
    corner_wedge_out: wp.array[wp.int32],
):
    """Close the gaps between live faces as ``move_live_faces`` does; launched before it overwrites the faces."""
    f = wp.tid()
    if corner_vertex_in[3 * f] >= 0:
        g = live_rank_in[f] - 1
        for k in range(3):
            corner_wedge_out[3 * g + k] = corner_wedge_in[3 * f + k]


@lane_kernel(quadric=QUADRIC_ARRAY)
def add_attribute_quadrics(
    # in
    attribute_quadric_in: wp.array[Quadric],
    # in and out
    quadric: Any,
):
    """Add ``E`` to each vertex's quadric in the reference frame, so that placement's anchors see it."""
    v = wp.tid()
    block = quadric[v, 0]
    for i in range(10):
        block[i, 0] = block[i, 0] + attribute_quadric_in[v][i, 0]
    quadric[v, 0] = block
