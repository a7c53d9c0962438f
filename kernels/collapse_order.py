"""The collapse log put in order after the passes: by round, cost and removed vertex."""

import warp as wp

wp.set_module_options({"enable_backward": False})  # no gradients are taken


# Keys of slots without a collapse.
LAST = wp.constant(wp.int64(2**63 - 1))
LAST_ROUND = wp.constant(wp.int32(2**31 - 1))
# The faces that go with a collapse, in the lower bits of one number with its round.
FACE_BITS = wp.constant(wp.int32(8))
# Numbers of four bytes that come to the host of each collapse.
ROWS = wp.constant(wp.int32(7))


@wp.kernel
def key_collapses(
    # in
    cost_in: wp.array[wp.float32],
    removed_in: wp.array[wp.int32],
    count_in: wp.array[wp.int32],
    # out
    key_out: wp.array[wp.int64],
    slot_out: wp.array[wp.int32],
):
    """Every collapse with a key to sort by: the bits of its cost, which ascend with it, then the removed vertex.

    Slots from ``count_in`` (1,) on are no collapses and come last.
    """
    i = wp.tid()
    slot_out[i] = i
    if i >= count_in[0]:
        key_out[i] = LAST
        return
    key_out[i] = (wp.int64(wp.cast(cost_in[i], wp.int32)) << wp.int64(32)) | wp.int64(removed_in[i])


@wp.kernel
def key_rounds(
    # in
    slot_in: wp.array[wp.int32],
    round_in: wp.array[wp.int32],
    count_in: wp.array[wp.int32],
    # out
    key_out: wp.array[wp.int32],
):
    """The round of each collapse, for a second sort that leaves those of a round in order, and what is none last."""
    i = wp.tid()
    slot = slot_in[i]
    round_index = wp.int32(LAST_ROUND)
    if slot < count_in[0]:
        round_index = round_in[slot]
    key_out[i] = round_index


@wp.func
def _input_vertex(vertex: wp.array[wp.int32], v: wp.int32) -> wp.int32:
    """The vertex of the input that ``v`` is, -1 for none."""
    if v < 0 or vertex.shape[0] == 0:
        return v
    return vertex[v]


@wp.kernel
def gather_log(
    # in
    rows_in: wp.array2d[wp.int32],
    slot_in: wp.array[wp.int32],
    count_in: wp.array[wp.int32],
    vertex_in: wp.array[wp.int32],
    # out
    values_out: wp.array[wp.int32],
):
    """Rows (8, C) of a log in the order of ``slot_in``, one after the other; see `warpqem.decimation.collapse_log`.

    ``vertex_in`` (V,) says which vertex of the input each one is; it may be empty: the same. The opposite vertices of a
    collapse come to lie side by side, in the place of both their rows; the faces that go with it and its round become
    one number, and the last row, squared errors, their roots. What is beyond ``count_in`` (1,) stays.
    """
    i = wp.tid()
    if i >= count_in[0]:
        return
    slot = slot_in[i]
    count = values_out.shape[0] / ROWS
    values_out[i] = _input_vertex(vertex_in, rows_in[0, slot])
    values_out[count + i] = _input_vertex(vertex_in, rows_in[1, slot])
    values_out[2 * count + 2 * i] = _input_vertex(vertex_in, rows_in[2, slot])
    values_out[2 * count + 2 * i + 1] = _input_vertex(vertex_in, rows_in[3, slot])
    values_out[4 * count + i] = (rows_in[5, slot] << FACE_BITS) | rows_in[4, slot]
    values_out[5 * count + i] = rows_in[6, slot]
    error = wp.sqrt(wp.cast(rows_in[7, slot], wp.float32))
    values_out[6 * count + i] = wp.cast(error, wp.int32)


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
    count_in: wp.array[wp.int32],
    # out
    parent_out: wp.array[wp.int32],
):
    """The vertex that each removed one collapsed into, of a log as :func:`gather_log` leaves it."""
    i = wp.tid()
    if i >= count_in[0]:
        return
    count = values_in.shape[0] / ROWS
    parent_out[values_in[count + i]] = values_in[i]


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
