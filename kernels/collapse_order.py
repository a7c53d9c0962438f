"""The collapse log put in order after the passes: by round, cost and removed vertex."""

import warp as wp

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.kernel
def key_collapses(
    # in
    cost_in: wp.array[wp.float32],
    removed_in: wp.array[wp.int32],
    # out
    key_out: wp.array[wp.int64],
    slot_out: wp.array[wp.int32],
):
    """Every collapse with a key to sort by: the bits of its cost, which ascend with it, then the removed vertex."""
    i = wp.tid()
    key_out[i] = (wp.int64(wp.cast(cost_in[i], wp.int32)) << wp.int64(32)) | wp.int64(removed_in[i])
    slot_out[i] = i


@wp.kernel
def key_rounds(
    # in
    slot_in: wp.array[wp.int32],
    round_in: wp.array[wp.int32],
    # out
    key_out: wp.array[wp.int32],
):
    """The round of each collapse, for a second sort that leaves those of a round in order."""
    i = wp.tid()
    key_out[i] = round_in[slot_in[i]]


@wp.kernel
def gather_log(
    # in
    rows_in: wp.array2d[wp.int32],
    slot_in: wp.array[wp.int32],
    # out
    values_out: wp.array[wp.int32],
):
    """Rows (R, C) of a log in the order of ``slot_in``, one after the other; see `warpqem.decimation.collapse_log`.

    The opposite vertices of a collapse come to lie side by side, in the place of both their rows; the last row, squared
    errors, becomes their roots.
    """
    i = wp.tid()
    slot = slot_in[i]
    last = rows_in.shape[0] - 1
    count = slot_in.shape[0]
    for row in range(last):
        place = row * count + i
        if row == 2 or row == 3:
            place = 2 * count + 2 * i + row - 2
        values_out[place] = rows_in[row, slot]
    error = wp.sqrt(wp.cast(rows_in[last, slot], wp.float32))
    values_out[last * count + i] = wp.cast(error, wp.int32)


@wp.kernel
def begin_roots(
    # out
    parent_out: wp.array[wp.int32],
):
    """Every vertex (V,) goes on as itself."""
    v = wp.tid()
    parent_out[v] = v


@wp.kernel
def link_collapses(
    # in
    values_in: wp.array[wp.int32],
    vertex_in: wp.array[wp.int32],
    # out
    parent_out: wp.array[wp.int32],
):
    """The vertex that each removed one collapsed into, of a log as :func:`gather_log` leaves it.

    ``vertex_in`` (V,) says which vertex of the input the log's are; it may be empty: the same.
    """
    i = wp.tid()
    count = values_in.shape[0] / 8
    kept = values_in[i]
    removed = values_in[count + i]
    if vertex_in.shape[0] > 0:
        kept = vertex_in[kept]
        removed = vertex_in[removed]
    parent_out[removed] = kept


@wp.kernel
def follow_collapses(
    # in
    parent_in: wp.array[wp.int32],
    # out
    root_out: wp.array[wp.int32],
):
    """The vertex that each vertex (V,) ended in."""
    v = wp.tid()
    root = v
    while parent_in[root] != root:
        root = parent_in[root]
    root_out[v] = root
