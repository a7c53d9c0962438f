"""Bounds of frames: the lowest and highest corner of each, and whether all of its points are finite."""

import warp as wp

wp.set_module_options({"enable_backward": False})  # no gradients are taken

LARGEST = wp.constant(wp.float32(3.4028234663852886e38))  # finite number of float32


@wp.kernel
def measure_bounds(
    # in
    points_in: wp.array2d[wp.vec3],
    used_in: wp.array[wp.bool],
    lanes: wp.int32,
    # in and out
    bounds: wp.array2d[wp.float32],
):
    """Widen the bounds (F, 7) of points (F, V): lowest corner, highest corner, and 1 where a point is not finite.

    Each of ``lanes`` threads takes every so manieth vertex of a frame. Only those that ``used_in`` marks count for the
    corners; all do where it is empty. Minima and maxima are the same in any order.
    """
    t, lane = wp.tid()
    everywhere = used_in.shape[0] == 0
    low = wp.vec3(LARGEST, LARGEST, LARGEST)
    high = -low
    finite = wp.bool(True)
    for v in range(lane, points_in.shape[1], lanes):
        p = points_in[t, v]
        finite = finite and wp.isfinite(p)
        if everywhere or used_in[v]:
            low = wp.min(low, p)
            high = wp.max(high, p)
    for k in range(3):
        # Most threads find nothing further out than others did: those need not wait for each other.
        if low[k] < bounds[t, k]:
            wp.atomic_min(bounds, t, k, low[k])
        if high[k] > bounds[t, 3 + k]:
            wp.atomic_max(bounds, t, 3 + k, high[k])
    if not finite:
        bounds[t, 6] = 1.0


@wp.kernel
def compare_frames(
    # in
    bounds_in: wp.array2d[wp.float32],
    smallest: wp.float32,
    # out
    scale_out: wp.array[wp.float32],
):
    """One thread: by how much frames (F,) are smaller than the largest one, by their diagonals.

    None counts as smaller than a part of it.
    """
    largest = wp.float32(0.0)
    for t in range(bounds_in.shape[0]):
        extent = wp.vec3()
        for k in range(3):
            extent[k] = bounds_in[t, 3 + k] - bounds_in[t, k]
        scale_out[t] = wp.length(extent)
        largest = wp.max(largest, scale_out[t])
    for t in range(bounds_in.shape[0]):
        if largest > 0.0:
            scale_out[t] = largest / wp.max(scale_out[t], smallest * largest)
        else:
            scale_out[t] = 1.0
