"""The least that a launch must do: bytes read and written, and floating-point operations, counted from its arguments.

Every array element that the launch needs counts once, as if it stayed in the cache until all threads had used it, and
operations count without index arithmetic: no program can do less with this algorithm, so time over floor is how far a
kernel is from the machine. Lists whose length the device alone knows are read back before the launch, so a count is
what this launch finds, not what would fit the list. A kernel without an entry here is reported without a floor.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.cards import H200, Card
from benchmarks.demand import COST_FLOPS, INT, PLANE_FLOPS, POINT, ROW, SOLVE_FLOPS, VALENCE, Arguments, Demand
from benchmarks.demand import frames_of as _frames
from benchmarks.demand import half_edges_of as _half_edges
from benchmarks.demand import keys_of as _keys
from benchmarks.demand import length_of as _length
from benchmarks.demand import moved_of as _moved
from benchmarks.demand import size_of as _size
from benchmarks.demand import vertices_of as _vertices
from benchmarks.floor_options import OPTION_MODELS, frame_items
from benchmarks.floor_place import PLACE_MODELS
from benchmarks.floor_preparation import PREPARATION_MODELS

__all__ = ["COUNTED", "Demand", "count_demand", "floor_seconds"]

# The anchor, the merged quadric 70, its minimiser 56, the sums of the target 9.
ANCHOR_FLOPS = 67
TARGET_FLOPS = ANCHOR_FLOPS + 135
# Per face and frame: two edges and two normals 39, their dot product and test 8.
FLIP_FLOPS = 47
# Two shifts and a sum of quadrics, error and trace.
MERGE_FLOPS = 95


def floor_seconds(demand: Demand, card: Card = H200) -> float:
    """The longer of the two times that a card needs: for the bytes, and for the operations."""
    return max(demand.bytes / card.bytes_per_second, demand.flops / card.flops_per_second)


def _compute_all_costs(a: Arguments) -> Demand:
    vertices, keys, half_edges = len(a["state"].vertex_flags), _keys(a), _half_edges(a)
    # Corners, adjacency and costs of each half-edge; the row starts and flags of each vertex.
    topology = half_edges * 3 * INT + vertices * 3 * INT
    return Demand(vertices * keys * ROW + topology, half_edges / 2 * keys * COST_FLOPS)


def _update_moved_costs(a: Arguments) -> Demand:
    moved, keys = _moved(a), _keys(a)
    # The vertex and its ring; corners and adjacency to find them; a cost at either half-edge of each edge.
    return Demand(
        moved * ((1 + VALENCE) * (keys * ROW + 3 * INT) + VALENCE * (3 + 3 + 2) * INT),
        moved * VALENCE * keys * COST_FLOPS,
    )


def _resume_neighbourhoods(a: Arguments) -> Demand:
    # All costs; what the few suspended edges need besides is not counted.
    return Demand(_half_edges(a) * INT)


def _place_collapses(a: Arguments) -> Demand:
    selected, keys = _length(a["selected"]), _keys(a)
    return Demand(selected * (keys * (2 * ROW + POINT) + 6 * INT), selected * keys * TARGET_FLOPS)


def _check_collapses(a: Arguments) -> Demand:
    selected, keys = _length(a["selected"]), _keys(a)
    # Both one-rings: eight faces stay, over the two ends and a ring of eight, against one target.
    faces, vertices = 2 * (VALENCE - 2), 2 + 2 * (VALENCE - 2)
    return Demand(
        selected * (keys * (vertices + 1) * POINT + 2 * VALENCE * 4 * INT), selected * keys * faces * FLIP_FLOPS
    )


def _measure_anchors(a: Arguments) -> Demand:
    selected, keys = _length(a["selected"]), _keys(a)
    return Demand(selected * (keys * (2 * ROW + POINT) + 3 * INT), selected * keys * ANCHOR_FLOPS)


def _sum_anchor_terms(a: Arguments) -> Demand:
    selected, blocks = _length(a["selected"]), a["term_in"].shape[1]
    return Demand(selected * (blocks * POINT + 6 * INT), selected * blocks * 3)


def _place_blocks(a: Arguments) -> Demand:
    selected, keys = _length(a["selected"]), _keys(a)
    return Demand(selected * (keys * (2 * ROW + POINT) + 6 * INT), selected * keys * (TARGET_FLOPS - ANCHOR_FLOPS))


def _settle_collapses(a: Arguments) -> Demand:
    # Corners of both ends and what is noted there; a member or two.
    return Demand(_length(a["selected"]) * (2 * VALENCE * 4 + 8) * INT)


def _merge_blocks(a: Arguments) -> Demand:
    collapses, keys = _collapses(a), _keys(a)
    return Demand(collapses * (keys * (3 * ROW + 2 * POINT) + 4 * INT), collapses * keys * MERGE_FLOPS)


def _commit_merged(a: Arguments) -> Demand:
    collapses, blocks = _collapses(a), a["term_in"].shape[1]
    return Demand(collapses * (blocks * POINT + 8 * INT + 2 * VALENCE * 6 * INT), collapses * blocks * 2)


def _collapses(a: Arguments) -> int:
    return int(np.count_nonzero(a["faces_removed_in"].numpy()[: _length(a["selected"])]))


def _open_log(a: Arguments) -> Demand:
    return Demand(_size(a["legal_count"]) * 4 + _size(a["log_slot"]) * 2)


def _remove_dead_corners(a: Arguments) -> Demand:
    # Two opposite vertices: the adjacency of each read and written, its faces looked at.
    return Demand(_moved(a) * 2 * (VALENCE * 3 + 4) * INT)


def _commit_collapses(a: Arguments) -> Demand:
    collapses, keys = _collapses(a), _keys(a)
    # Two rows and the target read, one row written; the log; the mask and corners of both ends.
    return Demand(
        collapses * (keys * (3 * ROW + POINT) + 8 * INT + 2 * VALENCE * 6 * INT), collapses * keys * MERGE_FLOPS
    )


def _count_costs(a: Arguments) -> Demand:
    return Demand(_half_edges(a) / int(a["sample_step_in"].numpy()[0]) * INT)


def _find_cost_threshold(a: Arguments) -> Demand:
    return Demand(2 * _size(a["histogram"]))


def _sum_bins(a: Arguments) -> Demand:
    return Demand(_size(a["histogram_in"]) + _size(a["sum_out"]))


def _find_threshold_by_sums(a: Arguments) -> Demand:
    return Demand(2 * _size(a["histogram"]) + _size(a["sum_in"]))


def _bound_threshold(a: Arguments) -> Demand:
    return Demand(4 * INT)


def _trim_collapses(a: Arguments) -> Demand:
    # Faces read and written; only the last rounds look at keys.
    return Demand(2 * _length(a["selected"]) * INT)


def _trim_in_order(a: Arguments) -> Demand:
    return _trim_collapses(a)


def _list_log_keys(a: Arguments) -> Demand:
    # The half-edge, its cost, both ends and their flags; the key written.
    return Demand(len(a["key_out"]) * 6 * INT + _size(a["key_out"]))


def _collect_candidates(a: Arguments) -> Demand:
    return Demand(_half_edges(a) * INT)


def _reserve_vertices(a: Arguments) -> Demand:
    # The half-edge, its cost and corners; a reservation of eight bytes read and written at either end.
    return Demand(_length(a["candidates"]) * (4 * INT + 2 * 2 * 8))


def _select_collapses(a: Arguments) -> Demand:
    # The half-edge, its cost, corners and the reservations at both ends; most candidates need no more.
    return Demand(_length(a["candidates"]) * (4 * INT + 2 * 8))


def _clear_reservations(a: Arguments) -> Demand:
    return Demand(_length(a["candidates"]) * (3 * INT + 2 * 8))


def _shrink_candidates(a: Arguments) -> Demand:
    return Demand(_length(a["candidates_in"]) * (1 + 2 + 1 + 2 + 1) * INT)


def _count_corners(a: Arguments) -> Demand:
    return Demand(3 * int(a["face_count_in"].numpy()[0]) * INT + 2 * _size(a["corner_count_out"]))


def _build_lists(a: Arguments) -> Demand:
    # The corners twice, and their lists.
    return Demand(3 * 3 * int(a["face_count_in"].numpy()[0]) * INT + 3 * _size(a["start_out"]))


def _fill_adjacency(a: Arguments) -> Demand:
    return Demand(2 * 3 * int(a["face_count_in"].numpy()[0]) * INT + 2 * _size(a["adjacency_cursor"]))


def _list_corners(a: Arguments) -> Demand:
    return Demand(3 * _size(a["corner_vertex_in"]))


def _find_starts(a: Arguments) -> Demand:
    return Demand(a["corner_count"] * INT + _size(a["start_out"]))


def _classify_vertices(a: Arguments) -> Demand:
    return Demand(3 * _size(a["corner_vertex_in"]) + 3 * _size(a["vertex_flags"]))


def _mark_live_faces(a: Arguments) -> Demand:
    return Demand(2 * _size(a["live_out"]))


def _move_live_faces(a: Arguments) -> Demand:
    # Rank and corner of every face; three corners, costs and seams of the live ones, read and written.
    live = int(np.count_nonzero(a["corner_vertex_in"].numpy()[::3] >= 0))
    return Demand(2 * _size(a["live_rank_in"]) + 2 * 9 * live * INT)


def _pack_frames(a: Arguments) -> Demand:
    # Of the frames given, those that are packed.
    share = min(1.0, _frames(a["blocks_out"]) / len(a["points_in"]))
    return Demand(share * _size(a["points_in"]) + _size(a["blocks_out"]), 6 * share * a["points_in"].size)


def _unpack_frames(a: Arguments) -> Demand:
    return Demand(_size(a["blocks_in"]) + _size(a["points_out"]))


def _put_points(a: Arguments) -> Demand:
    # Read once; written in single and in double precision.
    points = a["points_in"]
    return Demand(4 * _size(points) + _size(a["vertex_in"]), 12 * points.size)


def _gather_rows(a: Arguments) -> Demand:
    return Demand(2 * _size(a["rows_out"]) + _size(a["vertex_in"]))


def _weigh_face_normals(a: Arguments) -> Demand:
    normals = a["weighted_normal_out"]
    faces = normals.shape[0]
    # A part of the faces needs the vertices of that part.
    positions = min(_size(a["position_in"]), faces / 2 * POINT * _frames(normals))
    return Demand(_size(normals) + faces * 3 * INT + positions, faces * _frames(normals) * 27)


def _gather_vertex_quadrics(a: Arguments) -> Demand:
    quadrics = a["quadric_out"]
    vertices, frames = quadrics.shape[0], _frames(a["weighted_normal_in"])
    normals = min(_size(a["weighted_normal_in"]), 2 * vertices * POINT * frames)
    return Demand(_size(quadrics) + normals + (VALENCE + 2) * vertices * INT, vertices * frames * (VALENCE * 12 + 6))


def _measure_cluster_distances(a: Arguments) -> Demand:
    positions = a["key_position_in"]
    vertices, frames = positions.shape[0], _frames(positions)
    kept = len(np.unique(a["root_in"].numpy()))
    return Demand(_size(positions) + kept * frames * POINT + 2 * vertices * INT, vertices * frames * 9)


def _choose_nearest(a: Arguments) -> Demand:
    # Every vertex and its distance; the chosen ones.
    members = int(a["start_in"].numpy()[-1] - a["start_in"].numpy()[0])
    chosen = int(a["chosen_start_in"].numpy()[-1] - a["chosen_start_in"].numpy()[0])
    return Demand((members * 2 + chosen) * INT + 2 * _size(a["start_in"]))


def _key_members(a: Arguments) -> Demand:
    # Cluster and distance read, a key of eight bytes and the vertex written.
    return Demand(a["distance_in"].size * (3 * INT + 8))


def _take_nearest(a: Arguments) -> Demand:
    return Demand(a["start_in"].size * 2 * INT + a["chosen_out"].size * (8 + 2 * INT))


def _count_faces(a: Arguments) -> Demand:
    corners = int(a["start_in"].numpy()[-1] - a["start_in"].numpy()[0])
    return Demand(corners * INT + 2 * _size(a["start_in"]))


def _list_faces(a: Arguments) -> Demand:
    corners = int(a["start_in"].numpy()[-1] - a["start_in"].numpy()[0])
    faces = int(a["face_start_in"].numpy()[-1] - a["face_start_in"].numpy()[0])
    return Demand((corners * 2 + faces * 2) * INT + 2 * _size(a["start_in"]))


def _place_vertices(a: Arguments) -> Demand:
    frames, clusters, outputs = _frames(a["points_in"]), a["clusters"], a["points_out"].shape[0]
    # Lists of faces may have room for more.
    faces, members = int(clusters.face_start.numpy()[-1]), clusters.member.size
    once = faces * 4 * INT + members * 2 * INT + clusters.border.size * 2 * INT + outputs * 4 * INT
    flops = faces * PLANE_FLOPS + members * 6 + outputs * SOLVE_FLOPS
    return Demand(once + _size(a["points_in"]) + _size(a["points_out"]) + _size(a["normal_out"]), frames * flops)


def _count_flips(a: Arguments) -> Demand:
    faces = a["corner_vertex_in"].size / 3
    moved = _size(a["points_in"]) + _size(a["normal_in"])
    return Demand(_size(a["corner_vertex_in"]) + moved, faces * _frames(a["points_in"]) * 26)


_MODELS: dict[str, Callable[[Arguments], Demand]] = {
    model.__name__.removeprefix("_"): model
    for model in (
        _compute_all_costs,
        _update_moved_costs,
        _resume_neighbourhoods,
        _place_collapses,
        _check_collapses,
        _measure_anchors,
        _sum_anchor_terms,
        _place_blocks,
        _settle_collapses,
        _merge_blocks,
        _commit_merged,
        _open_log,
        _remove_dead_corners,
        _commit_collapses,
        _count_costs,
        _find_cost_threshold,
        _sum_bins,
        _find_threshold_by_sums,
        _bound_threshold,
        _trim_collapses,
        _trim_in_order,
        _list_log_keys,
        _collect_candidates,
        _reserve_vertices,
        _select_collapses,
        _clear_reservations,
        _shrink_candidates,
        _build_lists,
        _count_corners,
        _fill_adjacency,
        _list_corners,
        _find_starts,
        _classify_vertices,
        _mark_live_faces,
        _move_live_faces,
        _pack_frames,
        _unpack_frames,
        _put_points,
        _gather_rows,
        _weigh_face_normals,
        _gather_vertex_quadrics,
        _measure_cluster_distances,
        _choose_nearest,
        _key_members,
        _take_nearest,
        _count_faces,
        _list_faces,
        _place_vertices,
        _count_flips,
    )
}

_MODELS |= OPTION_MODELS | PREPARATION_MODELS | PLACE_MODELS | {"check_slots": _check_collapses}
# One thread with some numbers of the loop of passes.
_BOOKKEEPING = (
    "begin_pass",
    "begin_round",
    "note_threshold",
    "end_pass",
    "note_new_adjacency",
    "resume_passes",
    "note_candidates",
    "find_upkeep",
    "begin_steps",
    "end_step",
)
_MODELS |= dict.fromkeys(_BOOKKEEPING, lambda _: Demand(8 * INT))

# Names of the kernels that have a floor.
COUNTED = frozenset(_MODELS)


def count_demand(kernel: str, arguments: Arguments, threads: int) -> Demand | None:
    """What a launch needs; None for a kernel without an entry.

    Args:
        kernel: its name.
        arguments: its arguments by name, as they are before the launch.
        threads: threads of the launch.
    """
    if kernel not in _MODELS:
        return None
    whole = _MODELS[kernel](arguments)
    share = _share(arguments, threads)
    return Demand(share * whole.bytes, share * whole.flops)


def _share(a: Arguments, threads: int) -> float:
    """The part of the whole that a launch does, where CPU threads have a launch each."""
    if "work" in a:
        return 1.0 / int(a["work"].part_count)
    if "first_cluster" in a:
        return threads / a["points_out" if "points_out" in a else "area_out"].size
    if "first_output" in a:
        return threads / a["squared_out"].size
    if "first_vertex" in a:
        return threads / _vertices(a)
    if "turns" in a:
        return min(1.0, threads / frame_items(a))
    return 1.0
