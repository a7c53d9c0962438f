"""Place every output vertex in every frame: exact quadric of its cluster, solved against its material anchor."""

from typing import Any

import warp as wp

from warpqem.kernels.lanes import (
    POINTS_ARRAY,
    lane_cross,
    lane_dot,
    lane_inverse_length,
    lane_kernel,
    lane_max,
    lane_sum,
)
from warpqem.kernels.plane_quadrics import add_border_plane
from warpqem.kernels.quadric import (
    add_plane,
    apply_matrix,
    linear_part,
    tangential_minimiser,
    trace,
    zero_quadric,
)
from warpqem.kernels.topology import half_edge_target, next_corner, previous_corner

# Stiffnesses that are tried at a cluster.
STEPS = wp.constant(wp.int32(9))
Steps = wp.types.vector(length=int(STEPS), dtype=wp.float32)
StepOffsets = wp.types.matrix(shape=(int(STEPS), 4), dtype=wp.float32)


@wp.struct
class Clusters:
    """What each of the C output vertices is made of, as compressed rows."""

    member_start: wp.array[wp.int32]  # (C+1,)
    member: wp.array[wp.int32]  # input vertices of the anchor
    member_weight: wp.array[wp.float32]  # sum 1 per cluster
    face_start: wp.array[wp.int32]  # (C+1,)
    face: wp.array[wp.vec3i]  # corners of the input faces with a corner in the cluster
    face_weight: wp.array[wp.float32]  # corners in the cluster, each times its vertex's quadric scale
    other_start: wp.array[wp.int32]  # (C+1,)
    other: wp.array[wp.vec3i]  # corners of the input faces at vertices whose quadrics count in the cluster too
    other_weight: wp.array[wp.float32]
    border_start: wp.array[wp.int32]  # (C+1,)
    border: wp.array[wp.int32]  # border and seam half-edges with an end in the cluster
    border_weight: wp.array[wp.float32]
    solved: wp.array[wp.int32]  # (C,) 0: the vertex is the anchor itself
    stiffness: wp.array[wp.float32]  # (C,) regularisation towards the anchor, relative to the quadric


@wp.func
def anchor_position(points: Any, clusters: Clusters, c: wp.int32, t: wp.int32):
    """The material anchor of a cluster in a block of frames."""
    anchor = points.dtype()
    for j in range(clusters.member_start[c], clusters.member_start[c + 1]):
        anchor += clusters.member_weight[j] * points[clusters.member[j], t]
    return anchor


@wp.func
def add_faces(
    q: Any,
    points: Any,
    face: wp.array[wp.vec3i],
    weight: wp.array[wp.float32],
    first: wp.int32,
    last: wp.int32,
    t: wp.int32,
    anchor: Any,
):
    """The quadric with the planes of some faces, and the sum of their normals, each twice its area long."""
    normal = points.dtype()
    for j in range(first, last):
        f = face[j]
        p = points[f[0], t]
        cross = lane_cross(points[f[1], t] - p, points[f[2], t] - p)
        normal += cross
        # Twice the area is the cross product's length: area n n^T = cross cross^T / (2 length).
        q = add_plane(q, cross, lane_dot(cross, anchor - p), lane_inverse_length(cross) * (0.5 * weight[j]))
    return q, normal


@wp.func
def add_own_planes(points: Any, clusters: Clusters, c: wp.int32, t: wp.int32, anchor: Any):
    """The quadric of the faces of a cluster about its anchor, and the sum of their normals."""
    first = clusters.face_start[c]
    last = clusters.face_start[c + 1]
    return add_faces(zero_quadric(anchor), points, clusters.face, clusters.face_weight, first, last, t, anchor)


@wp.func
def add_other_planes(
    q: Any, points: Any, corner_vertex: wp.array[wp.int32], clusters: Clusters, c: wp.int32, t: wp.int32, anchor: Any
):
    """The quadric with the planes of other vertices, and of borders and seams: they are no part of the surface here."""
    first = clusters.other_start[c]
    last = clusters.other_start[c + 1]
    q, _normal = add_faces(q, points, clusters.other, clusters.other_weight, first, last, t, anchor)
    for j in range(clusters.border_start[c], clusters.border_start[c + 1]):
        h = clusters.border[j]
        a = points[corner_vertex[h], t]
        b = points[half_edge_target(corner_vertex, h), t]
        opposite = points[corner_vertex[previous_corner(h)], t]
        q = add_border_plane(q, a, b, opposite, anchor, clusters.border_weight[j])
    return q


@lane_kernel(points_in=POINTS_ARRAY, points_out=POINTS_ARRAY, normal_out=POINTS_ARRAY)
def place_vertices(
    # in
    points_in: Any,
    corner_vertex_in: wp.array[wp.int32],
    clusters: Clusters,
    first_cluster: wp.int32,
    # out
    points_out: Any,
    normal_out: Any,
):
    """Positions (C, B) of blocks of frames (V, B), in diagonals, and the area-weighted normal of each cluster."""
    i, t = wp.tid()
    c = first_cluster + i
    anchor = anchor_position(points_in, clusters, c, t)
    q, normal = add_own_planes(points_in, clusters, c, t, anchor)
    normal_out[c, t] = normal
    x = anchor
    if clusters.solved[c] == 1:
        q = add_other_planes(q, points_in, corner_vertex_in, clusters, c, t, anchor)
        x = anchor + tangential_minimiser(q, clusters.stiffness[c])
    points_out[c, t] = x


@lane_kernel(points_in=POINTS_ARRAY)
def measure_stiffness(
    # in
    points_in: Any,
    corner_vertex_in: wp.array[wp.int32],
    clusters: Clusters,
    stiffness_in: wp.array2d[wp.float32],
    first_cluster: wp.int32,
    # out
    error_out: wp.array3d[wp.float32],
    offset_out: wp.array3d[wp.vec4],
    area_out: wp.array2d[wp.float32],
):
    """What clusters would have of area times squared distance from their planes in blocks of frames, by stiffness.

    ``stiffness_in`` (C, S), ``error_out`` and ``offset_out`` (C, B, S) are of S = ``STEPS`` choices; offsets are sums
    of how far a vertex is from its anchor, (x, y, z), and of the squares of these distances; ``area_out`` (C, B) is
    what the planes weigh. All is zero at clusters that are not solved for.
    """
    i, t = wp.tid()
    c = first_cluster + i
    error = Steps()
    offset = StepOffsets()
    area = wp.float32(0.0)
    if clusters.solved[c] == 1:
        anchor = anchor_position(points_in, clusters, c, t)
        q, _normal = add_own_planes(points_in, clusters, c, t, anchor)
        q = add_other_planes(q, points_in, corner_vertex_in, clusters, c, t, anchor)
        area = lane_sum(trace(q))
        for step in range(STEPS):
            x = tangential_minimiser(q, stiffness_in[c, step])
            value = q[9] + lane_dot(x, 2.0 * linear_part(q) + apply_matrix(q, x))
            error[step] = lane_sum(lane_max(value, 0.0))
            offset[step] = wp.vec4(lane_sum(x[0]), lane_sum(x[1]), lane_sum(x[2]), lane_sum(lane_dot(x, x)))
    for step in range(STEPS):
        error_out[i, t, step] = error[step]
        offset_out[i, t, step] = offset[step]
    area_out[i, t] = area


@wp.kernel
def sum_stiffness(
    # in
    error_in: wp.array3d[wp.float32],
    offset_in: wp.array3d[wp.vec4],
    area_in: wp.array2d[wp.float32],
    frame_count: wp.int32,
    # out
    sum_out: wp.array2d[wp.float32],
):
    """Sums over all frames, (C, 2 S + 1), of what :func:`measure_stiffness` finds in blocks of them.

    Errors come first, then squared distances of vertices from where they are in the mean, beside anchors, then areas.
    """
    c = wp.tid()
    steps = error_in.shape[2]
    for step in range(steps):
        error = wp.float32(0.0)
        offset = wp.vec4d()
        for t in range(error_in.shape[1]):
            error += error_in[c, t, step]
            offset += wp.vec4d(offset_in[c, t, step])
        mean = wp.vec3d(offset[0], offset[1], offset[2]) / wp.float64(frame_count)
        sum_out[c, step] = error
        sum_out[c, steps + step] = wp.float32(
            wp.max(offset[3] - wp.float64(frame_count) * wp.length_sq(mean), wp.float64(0.0))
        )
    area = wp.float32(0.0)
    for t in range(area_in.shape[1]):
        area += area_in[c, t]
    sum_out[c, 2 * steps] = area


@lane_kernel(blocks_in=POINTS_ARRAY)
def restore_points(
    # in
    blocks_in: Any,
    scale: wp.float32,
    offset: wp.vec3d,
    # out
    points_out: wp.array2d[wp.vec3],
):
    """Points (F, C) in the caller's coordinates, of blocks (C, B) in diagonals: ``p scale + offset``, rounded once."""
    c, b = wp.tid()
    block = blocks_in[c, b]
    width = len(block[0])
    for k in range(width):
        t = b * width + k
        if t < points_out.shape[0]:
            p = wp.vec3()
            for axis in range(3):
                p[axis] = wp.float32(wp.float64(block[axis, k] * scale) + offset[axis])
            points_out[t, c] = p


@wp.kernel
def copy_vertices(
    # in
    points_in: wp.array2d[wp.vec3],
    vertex_in: wp.array[wp.int32],
    offset: wp.vec3d,
    column_in: wp.array[wp.int32],
    # out
    points_out: wp.array2d[wp.vec3],
):
    """Single vertices (M,) of points (F, V), plus ``offset`` and rounded once, into columns (M,) of other points."""
    t, i = wp.tid()
    p = points_in[t, vertex_in[i]]
    q = wp.vec3()
    for axis in range(3):
        q[axis] = wp.float32(wp.float64(p[axis]) + offset[axis])
    points_out[t, column_in[i]] = q


@lane_kernel(points_in=POINTS_ARRAY, normal_in=POINTS_ARRAY)
def count_flips(
    # in
    points_in: Any,
    normal_in: Any,
    corner_vertex_in: wp.array[wp.int32],
    # out
    flip_count: wp.array[wp.int32],
):
    """Output faces per frame that face away from the input faces gathered in their three vertices."""
    f, t = wp.tid()
    a = corner_vertex_in[3 * f]
    b = corner_vertex_in[next_corner(3 * f)]
    c = corner_vertex_in[previous_corner(3 * f)]
    p = points_in[a, t]
    n = lane_cross(points_in[b, t] - p, points_in[c, t] - p)
    agreement = lane_dot(n, normal_in[a, t] + normal_in[b, t] + normal_in[c, t])
    if wp.min(agreement) < 0.0:
        width = len(agreement)
        for k in range(width):
            if agreement[k] < 0.0:
                wp.atomic_add(flip_count, t * width + k, 1)
