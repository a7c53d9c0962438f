"""Connected components of a mesh: the lowest vertex of each, and which of them collapses take no further.

A forest in which every vertex points to one of its component that is no higher: each face joins the trees of its
corners, the higher root below the lower one, by a compare-and-swap that fails where another thread was there before.
Whatever the order of the threads, the root of a tree is its lowest vertex in the end. (Jaiganesh and Burtscher, "A
High-Performance Connected Components Implementation for GPUs", HPDC 2018.)
"""

import warp as wp

from warpqem.kernels.mesh_state import INFINITE_BITS, MeshState
from warpqem.kernels.topology import VertexAdjacency
from warpqem.kernels.work import Work

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# A component of so many faces has hardly an edge left to collapse: a tetrahedron, or a triangle or two.
MAX_REMNANT_FACES = wp.constant(wp.int32(4))
# Larger ones are looked at up to so many faces, if no collapse of theirs is cheap, and beyond that if none is legal. A
# ring, which has a hole, cannot get below 14 to 24 faces, a plate with 25 holes not below 360.
MAX_STUCK_FACES = wp.constant(wp.int32(1024))


@wp.func
def find_root(parent: wp.array[wp.int32], v: wp.int32) -> wp.int32:
    """The root of a vertex's tree. Vertices on the way come to point past their parents; others may do that, too."""
    before = wp.int32(v)
    at = parent[v]
    above = parent[at]
    while above < at:
        parent[before] = above
        before = at
        at = above
        above = parent[at]
    return at


@wp.func
def join_trees(parent: wp.array[wp.int32], a: wp.int32, b: wp.int32):
    """Make the trees of two vertices one."""
    low = find_root(parent, a)
    high = find_root(parent, b)
    while low != high:
        if high < low:
            swapped = wp.int32(high)
            high = low
            low = swapped
        found = wp.atomic_cas(parent, high, high, low)
        # Joined, or no root any more: then what it points to has to be joined.
        high = wp.where(found == high, low, found)


@wp.kernel
def begin_trees(
    # out
    parent_out: wp.array[wp.int32],
):
    """Every vertex is a tree of its own."""
    v = wp.tid()
    parent_out[v] = v


@wp.kernel
def join_faces(
    # in
    corner_vertex_in: wp.array[wp.int32],
    # in and out
    parent: wp.array[wp.int32],
):
    """Join the trees of each face's corners."""
    h = 3 * wp.tid()
    join_trees(parent, corner_vertex_in[h], corner_vertex_in[h + 1])
    join_trees(parent, corner_vertex_in[h + 1], corner_vertex_in[h + 2])


@wp.kernel
def close_trees(
    # in
    adjacency_in: VertexAdjacency,
    # in and out
    parent: wp.array[wp.int32],
    component_count: wp.array[wp.int32],
    # out
    is_root_out: wp.array[wp.int32],
):
    """Let every vertex point to its root, and count the roots that have a face (from zero)."""
    v = wp.tid()
    # No vertex but this one may come to point elsewhere: its own thread may have been there.
    root = parent[v]
    while parent[root] < root:
        root = parent[root]
    parent[v] = root
    is_root_out[v] = wp.where(root == v, 1, 0)
    if root == v and adjacency_in.start[v] < adjacency_in.end[v]:
        wp.atomic_add(component_count, 0, 1)


@wp.kernel
def number_components(
    # in
    root_in: wp.array[wp.int32],
    roots_before_in: wp.array[wp.int32],
    # out
    component_out: wp.array[wp.int32],
):
    """The component of each vertex: how many roots there are before its own."""
    v = wp.tid()
    component_out[v] = roots_before_in[root_in[v]]


@wp.kernel
def list_component_faces(
    # in
    corner_vertex_in: wp.array[wp.int32],
    face_count_in: wp.array[wp.int32],
    component_in: wp.array[wp.int32],
    is_chosen_in: wp.array[wp.int32],
    work: Work,
    # in and out
    listed: wp.array[wp.int32],
    # out
    face_out: wp.array[wp.vec3i],
):
    """List the live faces of the components (C,) that are chosen, in no order; ``listed`` counts them from zero."""
    for f in range(wp.tid(), face_count_in[0], work.thread_count):
        v = corner_vertex_in[3 * f]
        if v >= 0 and is_chosen_in[component_in[v]] != 0:
            i = wp.atomic_add(listed, 0, 1)
            face_out[i] = wp.vec3i(v, corner_vertex_in[3 * f + 1], corner_vertex_in[3 * f + 2])


@wp.kernel
def measure_components(
    # in
    state: MeshState,
    component_in: wp.array[wp.int32],
    work: Work,
    # out
    face_count: wp.array[wp.int32],
    cheapness: wp.array[wp.int32],
):
    """Live faces of each component, and how little its cheapest edge costs that is not known to be illegal.

    Both are 0 before the launch; ``component_in`` (V,) is the component of each vertex. Cheapness is the bits of
    infinity less those of the cost.
    """
    for f in range(wp.tid(), state.face_count[0], work.thread_count):
        v = state.corner_vertex[3 * f]
        if v >= 0:
            wp.atomic_add(face_count, component_in[v], 1)
            for k in range(3):
                # A suspended edge has a negative cost, and that has negative bits.
                bits = wp.cast(state.edge_cost[3 * f + k], wp.int32)
                if bits >= 0:
                    wp.atomic_max(cheapness, component_in[v], INFINITE_BITS - bits)


@wp.func
def cost_of_loss(loss: wp.float32, face_count: wp.int32) -> wp.float32:
    """What a loss costs beside a collapse: more faces that go with it make it worth more."""
    return loss * wp.min(1.0, wp.float32(MAX_REMNANT_FACES) / wp.float32(wp.max(face_count, 1)))


@wp.kernel
def mark_remnants(
    # in
    face_count_in: wp.array[wp.int32],
    cheapness_in: wp.array[wp.int32],
    least_loss_in: wp.array[wp.float32],
    threshold_in: wp.array[wp.float32],
    work: Work,
    # out
    is_remnant_out: wp.array[wp.int32],
    remnant_count: wp.array[wp.int32],
):
    """Which components may have nothing better to do than to go as a whole, and how many (0 before the launch).

    Those that are as small as any can become, and larger ones all of whose collapses cost at least ``threshold_in``
    (1,), the most that those of a pass cost; but none whose loss costs more (``least_loss_in`` (C,): the least that it
    can, see :func:`cost_of_loss`).
    """
    for c in range(wp.tid(), face_count_in.shape[0], work.thread_count):
        faces = face_count_in[c]
        cheapest = wp.cast(INFINITE_BITS - cheapness_in[c], wp.float32)
        is_large = faces > MAX_STUCK_FACES and cheapest < wp.inf
        is_stuck = faces <= MAX_REMNANT_FACES or (not is_large and cheapest >= threshold_in[0])
        cost = cost_of_loss(least_loss_in[c], faces)
        is_remnant = faces > 0 and is_stuck and cost <= threshold_in[0] and cost < wp.inf
        is_remnant_out[c] = wp.where(is_remnant, 1, 0)
        if is_remnant:
            wp.atomic_add(remnant_count, 0, 1)
