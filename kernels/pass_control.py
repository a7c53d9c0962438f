"""Where a loop of passes stands, kept on the device, so that it goes from pass to pass without the host."""

import warp as wp

from warpqem.kernels.mesh_state import CollapseLog, MeshState
from warpqem.kernels.topology import half_edge_target
from warpqem.kernels.vertex_kind import removed_end
from warpqem.kernels.work import EdgeList, Work

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Part of the edges that one pass may touch. More is faster and further from the serial greedy order.
CANDIDATE_FRACTION = wp.constant(wp.float64(0.05))
# Where none of these is legal, the next pass looks at so many times as many.
FRACTION_GROWTH = wp.constant(wp.float64(4.0))
# A closed surface has so many edges for each face.
EDGES_PER_FACE = wp.constant(wp.float64(1.5))
# A pass looks at this many edges at least, or on small meshes each would do one collapse. With half as many, ordering
# props of 350 faces takes a tenth more time, and their largest distances are 3 to 5 % smaller.
MIN_CANDIDATES = wp.constant(wp.int32(32))
# The cost threshold is read off every so many half-edges; a step without the factor 3 sees all corners alike.
SAMPLE_STEP = wp.constant(wp.int32(7))
# The cost threshold is read off all half-edges where a sample has fewer than so many: it need not be exact, only the
# same on every run.
MIN_SAMPLE = wp.constant(wp.int32(2048))

# A host closes the gaps that dead faces leave when fewer than this part of the faces is alive.
LIVE_FRACTION = wp.constant(wp.float64(0.7))

# No collapse has it: costs are finite.
LAST_KEY = wp.constant(wp.int64(2**63 - 1))

# Why a loop of passes ended. FULL_POOL: the adjacency has to be built anew, for want of room. COMPONENTS: some are
# small enough to be pruned.
RUNNING = wp.constant(wp.int32(0))
TARGET = wp.constant(wp.int32(1))
STUCK = wp.constant(wp.int32(2))
FULL_POOL = wp.constant(wp.int32(3))
COMPONENTS = wp.constant(wp.int32(4))


@wp.struct
class PassControl:
    """Numbers of a loop of passes, in arrays of one each."""

    running: wp.array[wp.int32]  # 1: there is another pass
    status: wp.array[wp.int32]  # one of the above
    live_faces: wp.array[wp.int32]  # without those that the round at work removes
    collapse_count: wp.array[wp.int32]  # length of the log after the last pass
    target_faces: wp.array[wp.int32]
    removed_faces: wp.array[wp.int32]  # by the round at work
    candidate_count: wp.array[wp.int32]  # of the last pass
    pass_collapses: wp.array[wp.int32]  # of the last pass
    pass_threshold: wp.array[wp.float32]  # what its components may cost; infinite where no edge is left to collapse
    overfull: wp.array[wp.int32]  # 1: the adjacency pool may be too small for another pass
    remnant_count: wp.array[wp.int32]  # components that may be pruned as a whole
    fraction: wp.array[wp.float64]  # of the edges that the pass may touch
    pass_number: wp.array[wp.int32]
    pass_begin: wp.array[wp.int32]  # length of the log when the pass began
    wanted: wp.array[wp.int32]  # edges that the pass is to look at; 0: none
    sample_step: wp.array[wp.int32]  # the threshold is read off every so many half-edges


@wp.kernel
def begin_pass(
    # in
    log: CollapseLog,
    face_slots: wp.array[wp.int32],
    # in and out
    control: PassControl,
    # out
    candidates: EdgeList,
):
    """How many edges the pass looks at, with empty lists. After the end it looks at none, and changes nothing.

    Costs are sampled where ``face_slots`` (1,) have enough half-edges.
    """
    candidates.count[0] = 0
    control.pass_begin[0] = log.count[0]
    control.sample_step[0] = 1
    control.wanted[0] = 0
    if control.running[0] == 0:
        return
    control.pass_number[0] = control.pass_number[0] + 1
    fraction = control.fraction[0]
    live = control.live_faces[0]
    control.wanted[0] = wp.max(MIN_CANDIDATES, wp.int32(fraction * EDGES_PER_FACE * wp.float64(live)))
    # After a pass without a collapse every edge counts: the few not suspended may be missing from a sample.
    if fraction == CANDIDATE_FRACTION and 3 * face_slots[0] >= SAMPLE_STEP * MIN_SAMPLE:
        control.sample_step[0] = SAMPLE_STEP


@wp.func
def take_off_removed(control: PassControl):
    """Take what the round before removed off the live faces."""
    control.live_faces[0] = control.live_faces[0] - control.removed_faces[0]
    control.removed_faces[0] = 0


@wp.kernel
def begin_round(
    # in
    candidates: EdgeList,
    first: wp.int32,
    # in and out
    control: PassControl,
    log: CollapseLog,
    # out
    selected: EdgeList,
    candidates_left: EdgeList,
):
    """Empty lists for a round; ``first`` is 1 in the first one of a pass. After the end no round counts."""
    selected.count[0] = 0
    candidates_left.count[0] = 0
    if control.running[0] == 0:
        return
    if first == 1:
        control.candidate_count[0] = candidates.count[0]
    take_off_removed(control)
    log.round_count[0] = log.round_count[0] + 1


@wp.func
def log_key(state: MeshState, h: wp.int32) -> wp.int64:
    """The order of the log within a round: cost, then the vertex that the commit removes."""
    removed = removed_end(state.vertex_flags, state.corner_vertex[h], half_edge_target(state.corner_vertex, h))
    return (wp.int64(wp.cast(state.edge_cost[h], wp.int32)) << wp.int64(32)) | wp.int64(removed)


@wp.kernel
def list_log_keys(
    # in
    state: MeshState,
    half_edge_in: wp.array[wp.int32],
    # out
    key_out: wp.array[wp.int64],
):
    """What collapses are put in order by, for a host that decides which of them go ahead."""
    i = wp.tid()
    key_out[i] = log_key(state, half_edge_in[i])


@wp.kernel
def trim_collapses(
    # in
    state: MeshState,
    selected: EdgeList,
    faces_removed_in: wp.array[wp.int32],
    work: Work,
    # in and out
    control: PassControl,
    # out
    faces_removed_out: wp.array[wp.int32],
):
    """Leave out the costliest collapses beyond the target: those before which the others remove enough faces.

    Each selected collapse adds up the faces of those before it: pairs that no sort has to put in order, and only in the
    round that comes to the target.
    """
    remaining = control.live_faces[0] - control.target_faces[0]
    count = selected.count[0]
    for i in range(wp.tid(), count, work.thread_count):
        faces = faces_removed_in[i]
        # A collapse removes two faces at most.
        if faces > 0 and 2 * count > remaining:
            key = log_key(state, selected.half_edge[i])
            before = wp.int32(0)
            for j in range(count):
                if faces_removed_in[j] > 0 and log_key(state, selected.half_edge[j]) < key:
                    before += faces_removed_in[j]
            if before >= remaining:
                faces = 0
        faces_removed_out[i] = faces
        if faces > 0:
            wp.atomic_add(control.removed_faces, 0, faces)


@wp.kernel
def note_candidates(
    # in
    candidates: EdgeList,
    # in and out
    control: PassControl,
):
    """Note how many edges a pass looks at."""
    control.candidate_count[0] = candidates.count[0]


@wp.func
def cutoff_key(
    state: MeshState, selected: EdgeList, faces_removed_in: wp.array[wp.int32], remaining: wp.int32
) -> wp.int64:
    """The least key such that the collapses before it remove ``remaining`` faces, fewer than all remove.

    By halving: a sum for each bit of a key, where looking at pairs takes one for each collapse.
    """
    below = wp.int64(0)
    key = LAST_KEY
    if remaining <= 0:
        key = below
    while key - below > wp.int64(1):
        middle = below + (key - below) / wp.int64(2)
        before = wp.int32(0)
        for j in range(selected.count[0]):
            if faces_removed_in[j] > 0 and log_key(state, selected.half_edge[j]) < middle:
                before += faces_removed_in[j]
        if before >= remaining:
            key = middle
        else:
            below = middle
    return key


@wp.kernel
def trim_in_order(
    # in
    state: MeshState,
    selected: EdgeList,
    faces_removed_in: wp.array[wp.int32],
    # in and out
    control: PassControl,
    # out
    faces_removed_out: wp.array[wp.int32],
    legal_count: wp.array[wp.int32],
):
    """What ``trim_collapses`` does, in one thread, which counts the collapses that go ahead, too."""
    remaining = control.live_faces[0] - control.target_faces[0]
    total = wp.int32(0)
    for i in range(selected.count[0]):
        total += faces_removed_in[i]
    end = LAST_KEY
    if total > remaining:
        end = cutoff_key(state, selected, faces_removed_in, remaining)
    legal = wp.int32(0)
    removed = wp.int32(0)
    for i in range(selected.count[0]):
        faces = faces_removed_in[i]
        if faces > 0 and log_key(state, selected.half_edge[i]) >= end:
            faces = 0
        faces_removed_out[i] = faces
        removed += faces
        legal += wp.where(faces > 0, 1, 0)
    legal_count[0] = legal
    control.live_faces[0] = control.live_faces[0] - removed


@wp.struct
class Upkeep:
    """What is to be done after the rounds of a pass, 1 or 0 each."""

    any: wp.array[wp.int32]  # edges collapsed
    compacts: wp.array[wp.int32]  # close the gaps that dead faces leave
    builds: wp.array[wp.int32]  # build the adjacency anew
    updates: wp.array[wp.int32]  # bring it up to date


@wp.kernel
def find_upkeep(
    # in
    state: MeshState,
    log: CollapseLog,
    control: PassControl,
    # out
    upkeep: Upkeep,
):
    """What the collapses of a pass ask for."""
    any = wp.where(log.count[0] > control.pass_begin[0], 1, 0)
    upkeep.any[0] = any
    few = wp.float64(control.live_faces[0]) < LIVE_FRACTION * wp.float64(state.face_count[0])
    upkeep.compacts[0] = wp.where(few, any, 0)
    overfull = state.adjacency.used[0] > state.adjacency.corner.shape[0]
    upkeep.builds[0] = wp.where(few or overfull, any, 0)
    upkeep.updates[0] = any - upkeep.builds[0]


@wp.func
def has_full_pool(state: MeshState, live: wp.int32) -> wp.bool:
    """Whether the adjacency of another pass may find no room: that of its collapses shares no corner."""
    return 3 * live > state.adjacency.corner.shape[0] - state.adjacency.used[0]


@wp.func
def is_stuck(control: PassControl) -> wp.bool:
    """Whether a pass over all edges found none that may be legal."""
    return control.candidate_count[0] == 0 and control.fraction[0] >= wp.float64(1.0)


@wp.func
def close_pass(state: MeshState, control: PassControl, stops_when_full: wp.int32):
    """Whether another pass follows, and how far it looks."""
    fraction = control.fraction[0]
    status = wp.int32(RUNNING)
    if is_stuck(control):
        status = STUCK
    # No legal collapse under the threshold: look further, at all edges, until every one has been refused.
    if control.pass_collapses[0] > 0:
        control.fraction[0] = CANDIDATE_FRACTION
    else:
        control.fraction[0] = wp.min(wp.float64(1.0), FRACTION_GROWTH * fraction)
    if control.live_faces[0] <= control.target_faces[0]:
        status = TARGET
    go_on(state, control, status, stops_when_full)


@wp.func
def go_on(state: MeshState, control: PassControl, status: wp.int32, stops_when_full: wp.int32):
    """Set the status, and whether to build the adjacency anew: with ``stops_when_full`` 1 the loop ends for that."""
    overfull = has_full_pool(state, control.live_faces[0])
    control.overfull[0] = wp.where(overfull, 1, 0)
    control.status[0] = status
    if overfull and status == RUNNING and stops_when_full == 1:
        control.status[0] = FULL_POOL
    control.running[0] = wp.where(control.status[0] == RUNNING, 1, 0)


@wp.kernel
def note_threshold(
    # in
    threshold_in: wp.array[wp.float32],
    # in and out
    control: PassControl,
):
    """Note what components may cost: as much as the edges of the pass, anything where no edge is left."""
    if control.running[0] == 1:
        control.pass_threshold[0] = wp.where(is_stuck(control), wp.inf, threshold_in[0])


@wp.kernel
def end_pass(
    # in
    state: MeshState,
    log: CollapseLog,
    stops_when_full: wp.int32,
    # in and out
    control: PassControl,
):
    """Close a pass."""
    if control.running[0] == 0:
        return
    take_off_removed(control)
    control.collapse_count[0] = log.count[0]
    control.pass_collapses[0] = log.count[0] - control.pass_begin[0]
    if control.remnant_count[0] > 0 and control.live_faces[0] > control.target_faces[0]:
        # The pass is closed by ``resume_passes``.
        control.status[0] = COMPONENTS
        control.running[0] = 0
        return
    close_pass(state, control, stops_when_full)


@wp.kernel
def resume_passes(
    # in
    state: MeshState,
    dropped_faces: wp.int32,
    stops_when_full: wp.int32,
    # in and out
    control: PassControl,
):
    """Go on after the host has pruned components of ``dropped_faces`` faces together."""
    if dropped_faces == 0:
        close_pass(state, control, stops_when_full)
        return
    control.live_faces[0] = control.live_faces[0] - dropped_faces
    status = wp.int32(RUNNING)
    if control.live_faces[0] <= control.target_faces[0]:
        status = TARGET
    go_on(state, control, status, stops_when_full)


@wp.kernel
def note_new_adjacency(
    # in and out
    control: PassControl,
):
    """Go on after the adjacency has been built anew."""
    control.overfull[0] = 0
    if control.status[0] == FULL_POOL:
        control.status[0] = RUNNING
        control.running[0] = 1
