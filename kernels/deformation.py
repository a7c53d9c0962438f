"""Edge-length deformation over frames: the extra cost of deformation oriented decimation (DOD).

``xi = w A (mean dl)^2`` with ``dl^t = |l^{t+1} - l^t|`` over the F - 1 steps, ``A`` the sum over frames of the area of
the edge's faces and ``w = (max dl - mean dl) / std dl`` (0/0 counts as 1).
"""

import warp as wp

from warpqem.kernels.topology import VertexStars, find_half_edge, half_edge_target, previous_corner

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Steps of an edge length below this, in diagonals, are rounding of float32 positions, not deformation.
LENGTH_NOISE = wp.constant(wp.float32(1.0e-7))


@wp.func
def triangle_area(p: wp.vec3, q: wp.vec3, r: wp.vec3) -> wp.float32:
    """Area of a triangle."""
    return 0.5 * wp.length(wp.cross(q - p, r - p))


@wp.func
def length_deformation(
    corner_vertex: wp.array[wp.int32],
    stars: VertexStars,
    trajectory: wp.array2d[wp.vec3],
    h: wp.int32,
) -> wp.float32:
    """``xi`` of the edge of half-edge ``h`` from the trajectories of its vertices (all frames)."""
    u = corner_vertex[h]
    v = half_edge_target(corner_vertex, h)
    left = corner_vertex[previous_corner(h)]
    right = wp.int32(-1)
    opposite = find_half_edge(corner_vertex, stars, v, u)
    if opposite >= 0:
        right = corner_vertex[previous_corner(opposite)]
    frame_count = trajectory.shape[1]
    # Sums are taken about the first step: the deviation of nearly even steps would drown in their squares otherwise.
    first_step = wp.float32(0.0)
    excess_sum = wp.float32(0.0)
    excess_square_sum = wp.float32(0.0)
    step_max = wp.float32(0.0)
    area = wp.float32(0.0)
    edge_before = wp.vec3()
    length_before = wp.float32(0.0)
    for t in range(frame_count):
        p = trajectory[u, t]
        q = trajectory[v, t]
        edge = q - p
        length = wp.length(edge)
        area += triangle_area(p, q, trajectory[left, t])
        if right >= 0:
            area += triangle_area(p, q, trajectory[right, t])
        if t > 0:
            # The difference of the lengths, from the edges' own difference: small steps keep their digits.
            step = wp.abs(wp.dot(edge - edge_before, edge + edge_before)) / wp.max(length + length_before, LENGTH_NOISE)
            if t == 1:
                first_step = step
            excess = step - first_step
            excess_sum += excess
            excess_square_sum += excess * excess
            step_max = wp.max(step_max, step)
        edge_before = edge
        length_before = length
    if frame_count < 2:
        return 0.0
    steps = wp.float32(frame_count - 1)
    mean_excess = excess_sum / steps
    mean = first_step + mean_excess
    deviation = wp.sqrt(wp.max(excess_square_sum / steps - mean_excess * mean_excess, 0.0))
    weight = wp.float32(1.0)
    if deviation > LENGTH_NOISE:
        weight = (step_max - mean) / deviation
    return weight * area * mean * mean


@wp.kernel
def measure_length_deformation(
    corner_vertex_in: wp.array[wp.int32],
    stars_in: VertexStars,
    trajectory_in: wp.array2d[wp.vec3],
    # outputs
    deformation_out: wp.array[wp.float32],
):
    """``xi`` of the edge at each half-edge."""
    h = wp.tid()
    if corner_vertex_in[h] >= 0:
        deformation_out[h] = length_deformation(corner_vertex_in, stars_in, trajectory_in, h)
