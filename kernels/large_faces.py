"""Faces of one surface that are larger than those of another one, as a list on the device, and their distances."""

import warp as wp

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Lengths are added up by so many threads, each over every so many of them, and then in order.
SLICES = wp.constant(wp.int32(256))


@wp.kernel
def sum_lengths(
    # in
    squared_in: wp.array[wp.float32],
    # out
    total_out: wp.array[wp.float64],
):
    """Parts of the sum of lengths (N,), given squared."""
    first = wp.tid()
    total = wp.float64(0.0)
    for i in range(first, squared_in.shape[0], total_out.shape[0]):
        total += wp.float64(wp.sqrt(squared_in[i]))
    total_out[first] = total


@wp.kernel
def scale_sum(
    # in
    total_in: wp.array[wp.float64],
    factor: wp.float64,
    # out
    length_out: wp.array[wp.float32],
):
    """One thread: the sum of all parts, times a factor."""
    total = wp.float64(0.0)
    for i in range(total_in.shape[0]):
        total += total_in[i]
    length_out[0] = wp.float32(factor * total)


@wp.kernel
def mark_longer(
    # in
    squared_in: wp.array[wp.float32],
    length_in: wp.array[wp.float32],
    # out
    is_longer_out: wp.array[wp.int32],
):
    """1 at lengths (N,), given squared, beyond one (1,)."""
    i = wp.tid()
    is_longer_out[i] = wp.where(wp.sqrt(squared_in[i]) > length_in[0], 1, 0)


@wp.kernel
def list_longer(
    # in
    corner_vertex_in: wp.array[wp.int32],
    cluster_in: wp.array[wp.int32],
    before_in: wp.array[wp.int32],
    # out
    face_out: wp.array[wp.int32],
    corner_out: wp.array2d[wp.int32],
    cluster_out: wp.array2d[wp.int32],
):
    """How many faces are marked, then each of them, ascending, as far as there is room: (1 + R,).

    Their corners and the clusters (V,) of these are (R, 3). ``before_in`` counts those up to each face, itself too.
    """
    f = wp.tid()
    before = wp.int32(0)
    if f > 0:
        before = before_in[f - 1]
    place = before_in[f]
    if place > before and place < face_out.shape[0]:
        face_out[place] = f
        for k in range(3):
            corner = corner_vertex_in[3 * f + k]
            corner_out[place - 1, k] = corner
            cluster_out[place - 1, k] = cluster_in[corner]
    if f == before_in.shape[0] - 1:
        face_out[0] = place


@wp.kernel
def leave_out_others(
    # in
    count_in: wp.array[wp.int32],
    points_of_each: wp.int32,
    # in and out
    within: wp.array[wp.float32],
):
    """A negative limit for points (n,) of rows beyond a number, the first of ``count_in``."""
    i = wp.tid()
    if i / points_of_each >= count_in[0]:
        within[i] = -1.0


@wp.kernel
def rows_of_corners(
    # in
    corner_in: wp.array2d[wp.int32],
    row_in: wp.array[wp.int32],
    corner_of_point_in: wp.array[wp.int32],
    # out
    row_out: wp.array2d[wp.int32],
):
    """The row (V,) of the corner that each of S points of faces (R, 3) is nearest to: (R, S)."""
    i, sample = wp.tid()
    row_out[i, sample] = row_in[corner_in[i, corner_of_point_in[sample]]]


@wp.kernel
def largest_of_points(
    # in
    squared_in: wp.array[wp.float32],
    points_of_each: wp.int32,
    # out
    squared_out: wp.array[wp.float32],
):
    """The largest of the squared distances of each face's points (n S,), one face after another: (n,)."""
    i = wp.tid()
    largest = wp.float32(0.0)
    for k in range(points_of_each * i, points_of_each * (i + 1)):
        largest = wp.max(largest, squared_in[k])
    squared_out[i] = largest
