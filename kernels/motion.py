"""Dihedral angles of edges over frames, and how fast they change."""

import warp as wp

wp.set_module_options({"enable_backward": False})  # no gradients are taken

PI = wp.constant(wp.float32(3.14159265358979))


@wp.func
def dihedral_angle(p: wp.vec3, q: wp.vec3, left: wp.vec3, right: wp.vec3) -> wp.float32:
    """Signed angle in radians between the faces ``p q left`` and ``q p right``; 0 when flat, positive at a ridge."""
    edge = q - p
    n = wp.cross(edge, left - p)
    m = wp.cross(right - p, edge)
    return wp.atan2(wp.dot(wp.cross(n, m), wp.normalize(edge)), wp.dot(n, m))


@wp.func
def wrapped(angle: wp.float32) -> wp.float32:
    """An angle's representative in (-pi, pi]."""
    if angle > PI:
        return angle - 2.0 * PI
    if angle <= -PI:
        return angle + 2.0 * PI
    return angle


@wp.kernel
def measure_dihedral_changes(
    # in
    edge_in: wp.array2d[wp.int32],
    points_in: wp.array2d[wp.vec3],
    chunk_steps: wp.int32,
    # in and out
    change: wp.array[wp.float32],
):
    """Largest ``|theta^{t+1} - theta^t|`` in radians, taken on over a block of frames (B, V).

    ``edge_in`` (E, 4) holds the two ends and the two opposite vertices. The block's first frame is its predecessor's
    last. A thread takes ``chunk_steps`` steps of one edge; the largest of all is the same in whichever order the
    threads come.
    """
    chunk, e = wp.tid()
    p = edge_in[e, 0]
    q = edge_in[e, 1]
    left = edge_in[e, 2]
    right = edge_in[e, 3]
    first = chunk * chunk_steps
    largest = wp.float32(0.0)
    before = wp.float32(0.0)
    for t in range(first, wp.min(first + chunk_steps + 1, points_in.shape[0])):
        angle = dihedral_angle(points_in[t, p], points_in[t, q], points_in[t, left], points_in[t, right])
        if t > first:
            largest = wp.max(largest, wp.abs(wrapped(angle - before)))
        before = angle
    # What is no larger needs no atomic operation: most chunks of later blocks.
    if largest > change[e]:
        wp.atomic_max(change, e, largest)
