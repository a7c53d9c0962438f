"""Edge-length deformation over frames: the extra cost of deformation oriented decimation.

"Progressive deforming meshes based on deformation oriented decimation" (Huang, Chen & Chuang), equation 2:
``xi = w A (mean dl)^2`` with ``dl^t = |l^{t+1} - l^t|`` over the F - 1 steps, ``A`` the sum over frames of the area of
the edge's two faces and ``w = (max dl - mean dl) / std dl`` (0/0 counts as 1).

A face's area and an edge's steps are summed once where they changed, over chunks of frames: a GPU gives each chunk a
thread, a CPU has one chunk. The cost of an edge puts the chunks together in their order.
"""

import warp as wp

from warpqem.kernels.mesh_state import CollapseLog, MeshState
from warpqem.kernels.topology import find_half_edge, half_edge_target, is_canonical, previous_corner
from warpqem.kernels.work import Work, first_item, last_item

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Steps of an edge length below this, in diagonals, are rounding of float32 positions, not deformation.
LENGTH_NOISE = wp.constant(wp.float32(1.0e-7))


@wp.func
def chunk_area(state: MeshState, f: wp.int32, first: wp.int32, last: wp.int32) -> wp.float32:
    """Sum of the area of a face over frames ``first`` to ``last - 1``."""
    a = state.corner_vertex[3 * f]
    b = state.corner_vertex[3 * f + 1]
    c = state.corner_vertex[3 * f + 2]
    area = wp.float32(0.0)
    for t in range(first, last):
        p = state.trajectory[a, t]
        area += wp.length(wp.cross(state.trajectory[b, t] - p, state.trajectory[c, t] - p))
    return 0.5 * area


@wp.func
def edge_vector(state: MeshState, u: wp.int32, v: wp.int32, t: wp.int32) -> wp.vec3d:
    """From ``u`` to ``v`` in frame ``t``, without rounding."""
    return wp.vec3d(state.trajectory[v, t]) - wp.vec3d(state.trajectory[u, t])


@wp.func
def chunk_steps(state: MeshState, h: wp.int32, first: wp.int32, last: wp.int32) -> wp.vec3:
    """Mean, squared deviations, and what the largest is above the mean, of the steps of an edge's length.

    The steps are those into frames ``first`` to ``last - 1``; none leads into frame 0. In float64: an edge that turns
    changes its length by far less than its ends move, and the deviation of nearly even steps by less again.
    """
    u = state.corner_vertex[h]
    v = half_edge_target(state.corner_vertex, h)
    begin = wp.max(first, 1)
    total = wp.float64(0.0)
    squares = wp.float64(0.0)
    largest = wp.float64(0.0)
    length_before = wp.length(edge_vector(state, u, v, begin - 1))
    for t in range(begin, last):
        length = wp.length(edge_vector(state, u, v, t))
        step = wp.abs(length - length_before)
        total += step
        squares += step * step
        largest = wp.max(largest, step)
        length_before = length
    count = wp.float64(wp.max(last - begin, 1))
    mean = total / count
    squares = wp.max(squares - total * mean, wp.float64(0.0))
    return wp.vec3(wp.float32(mean), wp.float32(squares), wp.float32(largest - mean))


@wp.func
def measure_half_edge(state: MeshState, h: wp.int32, chunk: wp.int32):
    """Steps of the edge that a half-edge stands for, in one chunk of frames."""
    if is_canonical(state.corner_vertex, state.adjacency, state.vertex_flags, h):
        first = chunk * state.deformation.chunk_frames
        last = wp.min(first + state.deformation.chunk_frames, state.trajectory.shape[1])
        state.deformation.steps[h, chunk] = chunk_steps(state, h, first, last)


@wp.func
def measure_face(state: MeshState, f: wp.int32, chunk: wp.int32):
    """Area of a face in one chunk of frames."""
    first = chunk * state.deformation.chunk_frames
    last = wp.min(first + state.deformation.chunk_frames, state.trajectory.shape[1])
    state.deformation.face_area[f, chunk] = chunk_area(state, f, first, last)


@wp.func
def length_deformation(state: MeshState, h: wp.int32) -> wp.float32:
    """``xi`` of the edge that half-edge ``h`` stands for, from what was measured of it and its faces."""
    frame_count = state.trajectory.shape[1]
    if frame_count < 2:
        return 0.0
    face = h // 3
    opposite_face = wp.int32(-1)
    opposite = find_half_edge(
        state.corner_vertex, state.adjacency, half_edge_target(state.corner_vertex, h), state.corner_vertex[h]
    )
    if opposite >= 0:
        opposite_face = opposite // 3
    area = wp.float32(0.0)
    count = wp.float32(0.0)
    mean = wp.float32(0.0)
    squares = wp.float32(0.0)
    excess = wp.float32(0.0)
    for chunk in range(state.deformation.steps.shape[1]):
        area += state.deformation.face_area[face, chunk]
        if opposite_face >= 0:
            area += state.deformation.face_area[opposite_face, chunk]
        first = chunk * state.deformation.chunk_frames
        last = wp.min(first + state.deformation.chunk_frames, frame_count)
        more = wp.float32(last - wp.max(first, 1))
        if more > 0.0:
            # Mean and squared deviations of two samples together (Chan, Golub & LeVeque 1983).
            steps = state.deformation.steps[h, chunk]
            apart = steps[0] - mean
            both = count + more
            excess = wp.max(excess - apart * more / both, steps[2] + apart * count / both)
            squares += steps[1] + apart * apart * count * more / both
            mean += apart * more / both
            count = both
    deviation = wp.sqrt(squares / count)
    weight = wp.float32(1.0)
    if deviation > LENGTH_NOISE:
        weight = excess / deviation
    return weight * area * mean * mean


@wp.kernel
def measure_all_deformation(
    # in and out
    state: MeshState,
    # in
    work: Work,
):
    """Areas of all faces and steps of all edges, the threads dealt out to the chunks of frames."""
    chunk_count = state.deformation.steps.shape[1]
    half_edge_count = 3 * state.face_count[0]
    threads = wp.max(work.thread_count // wp.max(chunk_count, 1), 1)  # for each chunk
    begin = first_item(half_edge_count, work) + wp.tid() % threads
    end = last_item(half_edge_count, work)
    for chunk in range(wp.tid() // threads, chunk_count, work.thread_count // threads):
        for h in range(begin, end, threads):
            if state.corner_vertex[h] >= 0:
                measure_half_edge(state, h, chunk)
                if h % 3 == 0:
                    measure_face(state, h // 3, chunk)


@wp.kernel
def move_trajectories(
    # in and out
    state: MeshState,
    # in
    log: CollapseLog,
    pass_begin: wp.array[wp.int32],
    work: Work,
):
    """Every frame of each vertex that the last pass moved becomes the material point ``(1 - anchor) p_u + anchor p_v``.

    No vertex takes part in two collapses of a pass. An anchor counts once: a second launch changes nothing.
    """
    chunk_count = state.deformation.anchor.shape[1]
    item_count = (log.count[0] - pass_begin[0]) * chunk_count
    for i in range(first_item(item_count, work) + wp.tid(), last_item(item_count, work), work.thread_count):
        u = log.kept[pass_begin[0] + i // chunk_count]
        v = log.removed[pass_begin[0] + i // chunk_count]
        chunk = i % chunk_count
        anchor = state.deformation.anchor[u, chunk]
        state.deformation.anchor[u, chunk] = 0.0
        first = chunk * state.deformation.chunk_frames
        for t in range(first, wp.min(first + state.deformation.chunk_frames, state.trajectory.shape[1])):
            p = state.trajectory[u, t]
            state.trajectory[u, t] = p + anchor * (state.trajectory[v, t] - p)


@wp.kernel
def measure_moved_deformation(
    # in and out
    state: MeshState,
    # in
    log: CollapseLog,
    pass_begin: wp.array[wp.int32],
    work: Work,
):
    """Areas of the faces and steps of the edges at each vertex that the last pass moved.

    Vertices that one pass moves are never neighbours, so no other thread writes them.
    """
    chunk_count = state.deformation.steps.shape[1]
    item_count = (log.count[0] - pass_begin[0]) * chunk_count
    for i in range(first_item(item_count, work) + wp.tid(), last_item(item_count, work), work.thread_count):
        u = log.kept[pass_begin[0] + i // chunk_count]
        for j in range(state.adjacency.start[u], state.adjacency.end[u]):
            h = state.adjacency.corner[j]
            measure_face(state, h // 3, i % chunk_count)
            measure_half_edge(state, h, i % chunk_count)
            measure_half_edge(state, previous_corner(h), i % chunk_count)


@wp.kernel
def move_deformation(
    # in
    corner_vertex_in: wp.array[wp.int32],
    face_area_in: wp.array2d[wp.float32],
    steps_in: wp.array2d[wp.vec3],
    live_rank_in: wp.array[wp.int32],
    # out
    face_area_out: wp.array2d[wp.float32],
    steps_out: wp.array2d[wp.vec3],
):
    """What was measured of each live face and its half-edges moves along when gaps are closed."""
    f, chunk = wp.tid()
    if corner_vertex_in[3 * f] >= 0:
        g = live_rank_in[f] - 1
        face_area_out[g, chunk] = face_area_in[f, chunk]
        for k in range(3):
            steps_out[3 * g + k, chunk] = steps_in[3 * f + k, chunk]
