"""The least that kernels of single options must do: the refit, quadrics of the present faces, terms of all frames."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import warp as wp

from benchmarks.demand import (
    COST_FLOPS,
    INT,
    PLANE_FLOPS,
    POINT,
    QUADRIC,
    ROW,
    VALENCE,
    Arguments,
    Demand,
    half_edges_of,
    keys_of,
    moved_of,
    size_of,
)
from warpqem.kernels.surface_limits import Samples

__all__ = ["OPTION_MODELS", "frame_items"]

# Bytes of a pair of points of the refit, and of a sum of steps of an edge length.
PAIR, STEPS = 44, 12
# A pair in its face's matrix: three products with frames and their sums 60, six outer products 130. The three edges of
# a face in one frame: two products with frames and six outer products each.
PAIR_FLOPS, EDGES_FLOPS = 190, 480
# An angle between two faces: three cross products, differences, dot products, a length and an arc tangent.
ANGLE_FLOPS = 80

# Kernels that read or write each of these arrays once: path of the argument, and how many times its size.
_STREAMED: dict[str, tuple[tuple[str, float], ...]] = {
    # The diagonal blocks are three of nine.
    "start_solve": (
        ("e.adjacency_start", 1),
        ("e.adjacent_corner", 1),
        ("e.block", 1 / 3),
        ("corner_right_in", 1),
        ("s.x", 1),
        ("s.residual", 1),
        ("s.direction", 1),
        ("s.inverse", 1),
    ),
    "multiply_direction": (
        ("e.adjacency_start", 1),
        ("e.adjacent_corner", 1),
        ("e.corner_vertex", 1),
        ("e.block", 1),
        ("s.direction", 1),
        ("s.image", 1),
    ),
    "sum_curvature": (("s.direction", 1), ("s.image", 1), ("s.slice_sum", 1)),
    "sum_residual": (("s.residual", 1), ("s.inverse", 1), ("s.slice_sum", 1)),
    "close_curvature": (("s.slice_sum", 1),),
    "close_residual": (("s.slice_sum", 1),),
    "step_forward": (("s.x", 2), ("s.residual", 2), ("s.direction", 1), ("s.image", 1)),
    "turn_direction": (("s.direction", 2), ("s.residual", 1), ("s.inverse", 1)),
    "link_half_edges": (
        ("s.corner_vertex", 1),
        ("s.adjacency_start", 1),
        ("s.adjacent_corner", 1),
        ("opposite_out", 1),
    ),
    "measure_material_frames": (
        ("points_in", 1),
        ("normal_in", 1),
        ("frame_out", 1),
        ("free_in", 1),
        ("rings.adjacent_corner", 1),
        ("rings.corner_vertex", 1),
        ("rings.reference", 1),
    ),
    "distances_of_points": (
        ("own", 1),
        ("point", 1),
        ("row", 1),
        ("cluster_start", 1),
        ("cluster", 1),
        # Lists are of all clusters, of which a launch may need few.
        ("squared", 1),
        ("nearest", 2),
        ("furthest", 1),
    ),
    "move_vertices": (("points_in", 1), ("before", 2), ("vertex_squared", 2)),
    "points_of_faces": (("position_in", 1), ("corner_vertex_in", 1), ("within_in", 1), ("point_out", 1)),
    "scale_frames": (("blocks", 2),),
    "largest_steps": (("before_in", 1), ("now_in", 1), ("component_in", 1)),
    "longest_edges": (("position_in", 1), ("corner_vertex_in", 1), ("squared_out", 1)),
    "key_faces_of_corners": (("corner_vertex_in", 1), ("key_out", 1), ("face_out", 1)),
    "mark_corners_in_clusters": (("corner_cluster_in", 1), ("is_inside_out", 1)),
    # Of many corners few are listed.
    "key_corners_in_clusters": (("corner_cluster_in", 1), ("before_in", 1)),
    "start_lists": (("key_in", 1), ("start_out", 1)),
    "sum_lengths": (("squared_in", 1),),
    "scale_sum": (("total_in", 1),),
    "mark_longer": (("squared_in", 1), ("is_longer_out", 1)),
    # Of many faces few are listed.
    "list_longer": (("before_in", 1), ("face_out", 1)),
    "leave_out_others": (("within", 1),),
    "largest_of_points": (("squared_in", 1), ("squared_out", 1)),
    "rows_of_corners": (("corner_in", 1), ("row_out", 1)),
    "find_partners": (
        ("source.points", 1),
        ("start_in", 1),
        ("near_in", 1),
        ("corner_vertex_in", 1),
        ("points_in", 1),
        ("face_out", 1),
        ("weight_out", 1),
    ),
    "sum_misfits": (
        ("partner_in", 1),
        ("partner_weight_in", 1),
        ("corner_start_in", 1),
        ("start_in", 1),
        ("misfit_out", 1),
    ),
    "solve_channel": (
        ("corner_in", 1),
        ("area_in", 1),
        ("free_in", 1),
        ("misfit_in", 1),
        ("change_out", 1),
    ),
    "turn_back": (
        ("chart.corner_row", 1),
        ("chart.sign", 1),
        ("values", 1),
    ),
    "start_solution": (
        ("unknowns.adjacency_start", 1),
        ("unknowns.adjacent_corner", 1),
        ("unknowns.area", 1),
        ("misfit_in", 1),
        ("residual_out", 1),
        ("change_out", 1),
        ("direction_out", 1),
    ),
    "improve_solution": (
        ("unknowns.adjacency_start", 1),
        ("unknowns.adjacent_corner", 1),
        ("unknowns.corner", 1),
        ("unknowns.area", 1),
        ("direction_in", 1),
        ("residual", 2),
        ("change", 2),
        ("direction_out", 1),
    ),
    # Normal maps: both surfaces once, and the texels.
    "bake_texels": (
        ("output.uv", 1),
        ("output.position", 1),
        ("output.normal", 1),
        ("output.tangent", 1),
        ("output.part", 1),
        ("source.position", 1),
        ("source.normal", 1),
        ("source.part", 1),
        ("normal_out", 1),
        ("filled_out", 1),
    ),
    "count_faces_at_texels": (("output.uv", 1), ("count_out", 1)),
    "dilate": (("normal_in", 1), ("filled_in", 1), ("normal_out", 1), ("filled_out", 1)),
    # A vertex that is not corrected needs no frame.
    "move_by_corrections": (("points_in", 1), ("points_out", 1), ("correction_in", 1)),
    # What is written are as many blocks as are read.
    "hold_elements": (("diagonal_in", 2), ("share_in", 1), ("hold_in", 1), ("corner_vertex_in", 1)),
    "mark_long_corrections": (("correction_in", 1), ("marked_out", 1)),
    "sum_face_sizes": (("points_in", 1), ("corner_vertex_in", 1), ("sum_out", 1)),
    "weigh_sizes": (("sum_in", 1), ("size_out", 1)),
    "raise_holds": (("marked_in", 1),),
    "note_look": (("far_in", 1),),
    "count_times_far": (("far_in", 1), ("rings_out", 1)),
    "widen_rings": (("corner_vertex_in", 1),),
    "take_held": (("held_in", 1), ("solution_in", 1), ("correction", 1)),
    "scale_corrections": (("factor_in", 1), ("correction", 2)),
    "mark_new_flips": (("points_in", 1), ("moved_in", 1), ("normal_in", 1), ("corner_vertex_in", 1)),
}


def _array(a: Arguments, path: str) -> wp.array:
    name, *members = path.split(".")
    value = a[name]
    for member in members:
        value = getattr(value, member)
    return value


def _streamed(kernel: str, a: Arguments) -> Demand:
    return Demand(sum(times * size_of(_array(a, path)) for path, times in _STREAMED[kernel]))


def frame_items(a: Arguments) -> float:
    """Threads of a launch that matches samples of one key frame, all parts of it."""
    turns = a["turns"]
    pairs = a["pairs"].face.size
    if "half_edge_in" in a:
        pairs = a["half_edge_in"].size * int(a["per_edge"]) * int(turns.count)
    return max(1.0, pairs / int(turns.key_count))


def _match(a: Arguments, *surfaces: str) -> Demand:
    """One key frame: its pairs, and the points of both surfaces."""
    return Demand(frame_items(a) * PAIR + sum(a[name].points.shape[1] * POINT for name in surfaces))


def _match_line_samples(a: Arguments) -> Demand:
    # The pairs of one frame; the points on borders or seams alone.
    return Demand(frame_items(a) * 2 * PAIR + 2 * a["half_edge_in"].size * (INT + POINT))


def _assemble_elements(a: Arguments) -> Demand:
    pairs = int(np.count_nonzero(a["output_pairs"].face.numpy() >= 0)) + int(a["input_start_in"].numpy()[-1])
    faces, frames = a["block_out"].shape[0], a["points_in"].shape[0]
    arrays = ("corner_vertex_in", "points_in", "frame_in", "block_out", "right_out", "correction_in", "share_out")
    flops = pairs * PAIR_FLOPS + faces * frames * EDGES_FLOPS
    return Demand(pairs * PAIR + sum(size_of(a[name]) for name in arrays), flops)


def _masked(a: Arguments) -> int:
    """Vertices that this pass masked."""
    return int(np.count_nonzero(a["mask_in"].numpy() == a["pass_number_in"].numpy()[0]))


def _renew_quadrics(a: Arguments) -> Demand:
    masked, keys = _masked(a), keys_of(a)
    needed = masked * (keys * (POINT + QUADRIC) + VALENCE * 3 * INT)
    return Demand(size_of(a["mask_in"]) + needed, masked * keys * VALENCE * PLANE_FLOPS)


def _update_neighbourhood_costs(a: Arguments) -> Demand:
    masked, keys = _masked(a), keys_of(a)
    # Every masked vertex has six edges, each shared with one other at most.
    edges = masked * VALENCE / 2
    needed = size_of(a["mask_in"]) + half_edges_of(a) * INT + masked * keys * ROW + edges * INT
    return Demand(needed, edges * keys * COST_FLOPS)


def _measure_dihedral_changes(a: Arguments) -> Demand:
    edges, frames = a["edge_in"].shape[0], a["points_in"].shape[0]
    arrays = size_of(a["edge_in"]) + size_of(a["points_in"]) + 2 * size_of(a["change"])
    return Demand(arrays, edges * frames * ANGLE_FLOPS)


def _measure_all_deformation(a: Arguments) -> Demand:
    # Sums of steps at one of the two half-edges of an edge.
    state = a["state"]
    measured = size_of(state.deformation.face_area) + size_of(state.deformation.steps) / 2
    return Demand(size_of(state.trajectory) + half_edges_of(a) * INT + measured)


def _measure_moved_deformation(a: Arguments) -> Demand:
    state = a["state"]
    frames, chunks = state.trajectory.shape[1], state.deformation.steps.shape[1]
    # The vertex and its ring; areas of its faces and sums of the edges that leave it.
    return Demand(moved_of(a) * ((1 + VALENCE) * frames * POINT + VALENCE * chunks * (INT + STEPS)))


def _move_trajectories(a: Arguments) -> Demand:
    frames, chunks = a["state"].trajectory.shape[1], a["state"].deformation.anchor.shape[1]
    return Demand(moved_of(a) * (frames * 3 * POINT + chunks * 2 * INT + 2 * INT), moved_of(a) * frames * 9)


def _move_deformation(a: Arguments) -> Demand:
    corners = a["corner_vertex_in"].numpy()[::3]
    share = int(np.count_nonzero(corners >= 0)) / max(1, len(corners))
    return Demand(2 * share * (size_of(a["face_area_in"]) + size_of(a["steps_in"])) + size_of(a["live_rank_in"]))


def _measure_vertex_distances(a: Arguments) -> Demand:
    # One frame of both surfaces, and a walk from each vertex to the faces around where it ends.
    vertices = a["squared_out"].shape[1]
    frame = a["source"].points.shape[1] + a["target"].points.shape[1]
    return Demand(frame * POINT + a["source"].corner_vertex.size * INT + vertices * 3 * INT, vertices * VALENCE * 60)


def _look_at_samples(a: Arguments) -> Demand:
    # Where each sample of a key frame is and how far; next to none needs a search.
    samples = a["samples"]
    return Demand(_samples_of_key(samples) * 2 * INT + samples.vertex_squared.shape[1] * 2 * INT)


def _samples_of_key(samples: Samples) -> int:
    return int(samples.input_turns.per_key + samples.output_turns.per_key)


def _update_distances(a: Arguments) -> Demand:
    # In every key frame the same, and how far the corners of a sample's face have moved; distances are written, too.
    samples, before = a["samples"], size_of(a["before_in"])
    count = _samples_of_key(samples) * samples.vertex_squared.shape[0]
    return Demand(count * 3 * INT + samples.vertex_squared.size * 3 * INT + 2 * before)


def _look_at_places(a: Arguments) -> Demand:
    # The first vertex of each place and the squared distance or limit of each of its points; and how far they are at
    # most, where that is kept.
    squared = a["squared_out"] if "squared_out" in a else a["squared_in"]
    kept = 2 * size_of(a["most"]) if "most" in a else 0
    return Demand(a["places"].vertex.shape[0] * INT + size_of(squared) + kept)


OPTION_MODELS: dict[str, Callable[[Arguments], Demand]] = {
    **{kernel: partial(_streamed, kernel) for kernel in _STREAMED},
    "match_input_samples": lambda a: _match(a, "source", "target"),
    "match_output_samples": lambda a: _match(a, "source", "target"),
    "match_line_samples": _match_line_samples,
    "measure_vertex_distances": _measure_vertex_distances,
    "raise_limits": _look_at_samples,
    "update_distances": _update_distances,
    "mark_far_samples": _look_at_samples,
    "begin_at_vertices": lambda a: Demand(3 * size_of(a["nearest_out"])),
    "gather_limits": _look_at_places,
    "raise_own_limits": _look_at_places,
    "mark_far_places": _look_at_places,
    "assemble_elements": _assemble_elements,
    "renew_quadrics": _renew_quadrics,
    "update_neighbourhood_costs": _update_neighbourhood_costs,
    "measure_dihedral_changes": _measure_dihedral_changes,
    "measure_all_deformation": _measure_all_deformation,
    "measure_moved_deformation": _measure_moved_deformation,
    "move_trajectories": _move_trajectories,
    "move_deformation": _move_deformation,
}
