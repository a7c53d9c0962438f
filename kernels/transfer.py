"""Where on the input surface an output wedge lies: the closest point among the faces it stands for."""

import warp as wp

from warpqem.kernels.closest_point import closest_barycentric, double_point, offset_squared

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.kernel
def find_wedge_sources(
    # in
    wedge_start_in: wp.array[wp.int32],
    face_in: wp.array[wp.int32],
    wedge_point_in: wp.array[wp.vec3],
    corner_vertex_in: wp.array[wp.int32],
    points_in: wp.array[wp.vec3],
    # out
    face_out: wp.array[wp.int32],
    weight_out: wp.array[wp.vec3],
):
    """The nearest of each wedge's faces, the first of equal ones, and the barycentric weights of the point on it."""
    wedge = wp.tid()
    p = double_point(wedge_point_in[wedge])
    best = wp.float64(wp.inf)
    for i in range(wedge_start_in[wedge], wedge_start_in[wedge + 1]):
        f = face_in[i]
        a = double_point(points_in[corner_vertex_in[3 * f]])
        b = double_point(points_in[corner_vertex_in[3 * f + 1]])
        c = double_point(points_in[corner_vertex_in[3 * f + 2]])
        barycentric = closest_barycentric(p, a, b, c)
        distance = offset_squared(p, a, b, c, barycentric)
        if distance < best:
            best = distance
            face_out[wedge] = f
            weight_out[wedge] = wp.vec3(
                wp.float32(barycentric[0]), wp.float32(barycentric[1]), wp.float32(barycentric[2])
            )
