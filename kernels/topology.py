"""Half-edges, vertex-corner adjacency, borders and non-manifold vertices.

Half-edge ``3 f + k`` runs from corner ``k`` of face ``f`` to the next corner. A dead face has -1 at its corners. The
adjacency of a vertex is the list of its corners, in ascending order, as one compressed-row array for all vertices.
"""

import warp as wp

from warpqem.kernels.work import Work, first_item, last_item

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Vertex flags. BORDER: an edge with one face ends here. LOCKED: asked for by the user, the vertex keeps its position.
# SEAM: an edge that values do not cross ends here (UV seam, subset border, hard edge).
# CORNER: a seam ends, forks or meets a border here. Set along with SEAM.
# MIRROR: on the plane along which a symmetric mesh was cut; set along with BORDER.
# NON_MANIFOLD: the one-ring is not one fan of faces. The vertex keeps its position.
# Which vertices may collapse into which is in :mod:`warpqem.kernels.vertex_kind`.
BORDER = wp.constant(wp.int32(1))
LOCKED = wp.constant(wp.int32(2))
NON_MANIFOLD = wp.constant(wp.int32(4))
SEAM = wp.constant(wp.int32(8))
CORNER = wp.constant(wp.int32(16))
MIRROR = wp.constant(wp.int32(32))
# Vertices that keep their position.
PINNED = wp.constant(wp.int32(int(LOCKED) | int(NON_MANIFOLD)))
# Vertices whose faces need not be a closed fan. Around the others the half-edges that leave meet every neighbour.
OPEN = wp.constant(wp.int32(int(BORDER) | int(NON_MANIFOLD)))


@wp.struct
class VertexAdjacency:
    """The corners of each vertex, in a pool, ascending within a vertex.

    Built from the faces, the lists follow one another; a vertex that moved gets a new one behind them.
    """

    start: wp.array[wp.int32]  # (V,) where the list begins
    end: wp.array[wp.int32]  # (V,) and ends
    corner: wp.array[wp.int32]  # the pool
    used: wp.array[wp.int32]  # (1,) entries of the pool given out; more than it has: build the adjacency anew


@wp.func
def next_corner(h: wp.int32) -> wp.int32:
    """The next corner of the same face."""
    result = h + 1
    if h % 3 == 2:
        result = h - 2
    return result


@wp.func
def previous_corner(h: wp.int32) -> wp.int32:
    """The previous corner of the same face."""
    result = h - 1
    if h % 3 == 0:
        result = h + 2
    return result


@wp.func
def half_edge_target(corner_vertex: wp.array[wp.int32], h: wp.int32) -> wp.int32:
    """The vertex a half-edge runs to."""
    return corner_vertex[next_corner(h)]


@wp.func
def find_half_edge(
    corner_vertex: wp.array[wp.int32],
    adjacency: VertexAdjacency,
    u: wp.int32,
    v: wp.int32,
) -> wp.int32:
    """The half-edge from ``u`` to ``v``, or -1."""
    found = wp.int32(-1)
    for i in range(adjacency.start[u], adjacency.end[u]):
        h = adjacency.corner[i]
        if half_edge_target(corner_vertex, h) == v:
            found = h
    return found


@wp.func
def is_canonical(
    corner_vertex: wp.array[wp.int32],
    adjacency: VertexAdjacency,
    vertex_flags: wp.array[wp.int32],
    h: wp.int32,
) -> wp.bool:
    """One half-edge stands for each edge: the one to the higher vertex, or the only one there is."""
    u = corner_vertex[h]
    v = half_edge_target(corner_vertex, h)
    if u < v:
        return True
    # One end after the other: most half-edges stop at the first, before the second is fetched from memory.
    if (vertex_flags[u] & BORDER) == 0 or (vertex_flags[v] & BORDER) == 0:
        return False
    return find_half_edge(corner_vertex, adjacency, v, u) < 0


@wp.kernel
def count_corners(
    # in
    corner_vertex_in: wp.array[wp.int32],
    face_count_in: wp.array[wp.int32],
    work: Work,
    # out
    corner_count_out: wp.array[wp.int32],
):
    """Corners per vertex (zeroed before the launch). A part walks all corners for its own vertices."""
    first_vertex = first_item(corner_count_out.shape[0], work)
    last_vertex = last_item(corner_count_out.shape[0], work)
    for h in range(wp.tid(), 3 * face_count_in[0], work.thread_count):
        v = corner_vertex_in[h]
        if v >= first_vertex and v < last_vertex:
            wp.atomic_add(corner_count_out, v, 1)


@wp.kernel
def fill_adjacency(
    # in
    corner_vertex_in: wp.array[wp.int32],
    face_count_in: wp.array[wp.int32],
    work: Work,
    # in and out
    adjacency_cursor: wp.array[wp.int32],
    # out
    adjacent_corner_out: wp.array[wp.int32],
):
    """Put each corner into its vertex's list; ``adjacency_cursor`` starts at the beginning of each list and runs up."""
    first_vertex = first_item(adjacency_cursor.shape[0], work)
    last_vertex = last_item(adjacency_cursor.shape[0], work)
    for h in range(wp.tid(), 3 * face_count_in[0], work.thread_count):
        v = corner_vertex_in[h]
        if v >= first_vertex and v < last_vertex:
            adjacent_corner_out[wp.atomic_add(adjacency_cursor, v, 1)] = h


@wp.kernel
def build_lists(
    # in
    corner_vertex_in: wp.array[wp.int32],
    face_count_in: wp.array[wp.int32],
    # out
    start_out: wp.array[wp.int32],
    lists: VertexAdjacency,
):
    """All lists, built by one thread; ``start_out`` (V+1,) is where they begin, and the last one ends."""
    vertex_count = lists.start.shape[0]
    for v in range(vertex_count):
        lists.end[v] = 0
    for h in range(3 * face_count_in[0]):
        v = corner_vertex_in[h]
        if v >= 0:
            lists.end[v] = lists.end[v] + 1
    used = wp.int32(0)
    for v in range(vertex_count):
        count = lists.end[v]
        start_out[v] = used
        lists.start[v] = used
        lists.end[v] = used
        used += count
    start_out[vertex_count] = used
    lists.used[0] = used
    for h in range(3 * face_count_in[0]):
        v = corner_vertex_in[h]
        if v >= 0:
            place = lists.end[v]
            lists.corner[place] = h
            lists.end[v] = place + 1


@wp.kernel
def list_corners(
    # in
    corner_vertex_in: wp.array[wp.int32],
    face_count_in: wp.array[wp.int32],
    vertex_count: wp.int32,
    work: Work,
    # out
    key_out: wp.array[wp.int32],
    corner_out: wp.array[wp.int32],
):
    """Every corner (3N,) with its vertex as the key to sort by; dead ones come last, with the number of vertices."""
    for h in range(wp.tid(), corner_vertex_in.shape[0], work.thread_count):
        v = wp.int32(-1)
        if h < 3 * face_count_in[0]:
            v = corner_vertex_in[h]
        key_out[h] = wp.where(v >= 0, v, vertex_count)
        corner_out[h] = h


@wp.func
def count_below(key: wp.array[wp.int32], count: wp.int32, value: wp.int32) -> wp.int32:
    """How many of ``count`` ascending keys are below a value (Warp's ``lower_bound`` never says all)."""
    first = wp.int32(0)
    last = wp.int32(count)
    while first < last:
        middle = first + (last - first) // 2
        if key[middle] < value:
            first = middle + 1
        else:
            last = middle
    return first


@wp.kernel
def find_starts(
    # in
    key_in: wp.array[wp.int32],
    corner_count: wp.int32,
    work: Work,
    # out
    start_out: wp.array[wp.int32],
):
    """Where the corners of each vertex (V+1,) begin among ``corner_count`` sorted keys: a binary search each."""
    for v in range(wp.tid(), start_out.shape[0], work.thread_count):
        start_out[v] = count_below(key_in, corner_count, v)


@wp.func
def is_closed_fan(corner_vertex: wp.array[wp.int32], adjacency: VertexAdjacency, v: wp.int32) -> wp.bool:
    """Whether turning about ``v`` from face to face comes back after all of its faces, and not before.

    A turn that meets every face once leaves no edge with another number of faces than two.
    """
    first = adjacency.start[v]
    last = adjacency.end[v]
    h = adjacency.corner[first]
    start = h
    turned = wp.int32(0)
    while turned < last - first:
        w = corner_vertex[previous_corner(h)]
        i = wp.int32(first)
        while i < last and half_edge_target(corner_vertex, adjacency.corner[i]) != w:
            i += 1
        if i == last:
            return False
        h = adjacency.corner[i]
        turned += 1
        if h == start:
            return turned == last - first
    return False


@wp.func
def count_open_in(corner_vertex: wp.array[wp.int32], adjacency: VertexAdjacency, v: wp.int32) -> wp.int32:
    """Half-edges that enter a vertex without an opposite one."""
    count = wp.int32(0)
    for i in range(adjacency.start[v], adjacency.end[v]):
        w = corner_vertex[previous_corner(adjacency.corner[i])]
        if find_half_edge(corner_vertex, adjacency, v, w) < 0:
            count += 1
    return count


@wp.func
def fan_size(corner_vertex: wp.array[wp.int32], adjacency: VertexAdjacency, v: wp.int32, border: wp.int32) -> wp.int32:
    """Faces met by turning about a vertex, from the half-edge that leaves it on a border, or -1: from any."""
    first = adjacency.start[v]
    degree = adjacency.end[v] - first
    start = border
    if start < 0:
        start = adjacency.corner[first]
    h = start
    fan = wp.int32(0)
    # Turn from the face on the left of v -> w to the one whose half-edge leaves v along the other side.
    while h >= 0 and fan < degree:
        fan += 1
        w = corner_vertex[previous_corner(h)]
        h = find_half_edge(corner_vertex, adjacency, v, w)
        if h == start:
            h = -1
    return fan


@wp.kernel
def classify_vertices(
    # in
    corner_vertex_in: wp.array[wp.int32],
    adjacency_in: VertexAdjacency,
    first_vertex: wp.int32,
    # in and out
    vertex_flags: wp.array[wp.int32],
    # out
    border_half_edge_out: wp.array[wp.int32],
):
    """Set BORDER and NON_MANIFOLD from the faces around each vertex, and mark the half-edges without an opposite one.

    The faces around a manifold vertex are one fan: turning about the vertex from face to face, from the border where
    there is one, meets every face exactly once. Edges with more than two faces or with two half-edges of one direction
    break the fan.
    """
    v = first_vertex + wp.tid()
    first = adjacency_in.start[v]
    last = adjacency_in.end[v]
    degree = last - first
    # Most vertices lie inside: three times faster than counting the faces at their edges.
    if degree > 0 and is_closed_fan(corner_vertex_in, adjacency_in, v):
        return
    open_out = wp.int32(0)
    repeated = wp.int32(0)
    start = wp.int32(-1)
    for i in range(first, last):
        h = adjacency_in.corner[i]
        w = half_edge_target(corner_vertex_in, h)
        before = wp.int32(0)
        same = wp.int32(0)
        for j in range(first, last):
            g = adjacency_in.corner[j]
            if half_edge_target(corner_vertex_in, g) == w:
                same += 1
            if corner_vertex_in[previous_corner(g)] == w:
                before += 1
        if same > 1 or before > 1:
            repeated += 1
        if before == 0:
            border_half_edge_out[h] = 1
            open_out += 1
            start = h
    open_in = count_open_in(corner_vertex_in, adjacency_in, v)
    flags = vertex_flags[v]
    if open_out + open_in > 0:
        flags = flags | BORDER
    fan = wp.int32(0)
    if repeated == 0 and open_out <= 1 and open_in == open_out and degree > 0:
        fan = fan_size(corner_vertex_in, adjacency_in, v, start)
    if degree > 0 and fan != degree:
        flags = flags | NON_MANIFOLD
    vertex_flags[v] = flags
