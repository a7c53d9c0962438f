"""Frames in double precision, about an origin in single precision."""

import warp as wp

from warpqem.kernels.frame_bounds import LARGEST

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.kernel
def subtract_origin(
    # in
    points_in: wp.array2d[wp.vec3d],
    origin: wp.vec3d,
    # out
    points_out: wp.array2d[wp.vec3],
):
    """Points (F, V) minus ``origin``, rounded; NaN where one is not finite, in single precision too."""
    t, v = wp.tid()
    p = points_in[t, v]
    q = wp.vec3()
    for k in range(3):
        q[k] = wp.float32(p[k] - origin[k])
        if not (wp.abs(p[k]) <= wp.float64(LARGEST)):
            q[k] = wp.float32(wp.nan)
    points_out[t, v] = q
