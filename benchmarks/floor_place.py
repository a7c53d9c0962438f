"""The least that kernels before and after decimation must do: frames measured, clusters gathered, points restored."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.demand import INT, PLANE_FLOPS, POINT, ROW, SOLVE_FLOPS, Arguments, Demand, frames_of, size_of

__all__ = ["PLACE_MODELS"]


def _measure_bounds(a: Arguments) -> Demand:
    return Demand(size_of(a["points_in"]) + size_of(a["used_in"]), 6 * a["points_in"].size)


def _compare_frames(a: Arguments) -> Demand:
    return Demand(size_of(a["bounds_in"]) + size_of(a["scale_out"]))


def _subtract_origin(a: Arguments) -> Demand:
    return Demand(size_of(a["points_in"]) + size_of(a["points_out"]), 3 * a["points_in"].size)


def _mark_used_vertices(a: Arguments) -> Demand:
    return Demand(size_of(a["corner_vertex_in"]) + size_of(a["used"]))


def _key_collapses(a: Arguments) -> Demand:
    return Demand(len(a["slot_out"]) / 2 * (3 * INT + 8))


def _key_rounds(a: Arguments) -> Demand:
    return Demand(len(a["key_out"]) / 2 * 3 * INT)


def _gather_log(a: Arguments) -> Demand:
    return Demand(2 * size_of(a["values_out"]) + size_of(a["slot_in"]), len(a["slot_in"]))


def _restore_points(a: Arguments) -> Demand:
    return Demand(size_of(a["blocks_in"]) + size_of(a["points_out"]), 6 * a["points_out"].size)


def _copy_vertices(a: Arguments) -> Demand:
    copies = a["vertex_in"].size
    return Demand(copies * (2 * INT + 2 * POINT * len(a["points_in"])), 3 * copies * len(a["points_in"]))


def _choose_highest(a: Arguments) -> Demand:
    return Demand(3 * size_of(a["cluster_in"]) + size_of(a["highest_rank_in"]))


def _fill_gram_matrices(a: Arguments) -> Demand:
    keys, size = frames_of(a["key_position_in"]), _member_counts(a)
    members, entries = size.sum(), (size * (size + 1) / 2).sum()
    moved = members * (keys * POINT + 2 * INT) + len(size) * (keys * ROW + 3 * INT) + entries * INT
    return Demand(moved, keys * (members * 26 + entries * 7))


def _solve_for_weights(a: Arguments) -> Demand:
    keys, size = frames_of(a["key_position_in"]), _member_counts(a)
    members, entries = size.sum(), (size * (size + 1) / 2).sum()
    moved = members * (keys * POINT + 2 * INT) + len(size) * (keys * POINT + 4 * INT) + 2 * entries * INT
    return Demand(moved, keys * members * 9 + (size**3 / 3 + 2 * size**2).sum())


def _put_in_the_middle(a: Arguments) -> Demand:
    keys, members = frames_of(a["key_position_in"]), _member_counts(a).sum()
    moved = members * (keys * POINT + INT) + size_of(a["row_in"]) * (2 + keys * POINT / INT)
    return Demand(moved, keys * members * 3)


def _measure_reach(a: Arguments) -> Demand:
    keys, size = frames_of(a["key_position_in"]), _member_counts(a)
    return Demand(size.sum() * (keys * POINT + 2 * INT) + size_of(a["reach_out"]), keys * size.sum() * 28)


def _keep_within_reach(a: Arguments) -> Demand:
    return Demand(_member_counts(a).sum() * 2 * INT + size_of(a["reach_in"]) + size_of(a["moved_in"]))


def _member_counts(a: Arguments) -> np.ndarray:
    return np.diff(a["member_start_in"].numpy()).astype(np.float64)


def _measure_stiffness(a: Arguments) -> Demand:
    frames, clusters, outputs = frames_of(a["points_in"]), a["clusters"], len(a["area_out"])
    # Lists of faces may have room for more.
    faces, members = int(clusters.face_start.numpy()[-1]), clusters.member.size
    once = faces * 4 * INT + members * 2 * INT + clusters.border.size * 2 * INT + outputs * 10 * INT
    # Nine stiffnesses are tried at each place.
    flops = faces * PLANE_FLOPS + members * 6 + outputs * 9 * (SOLVE_FLOPS + 39)
    results = sum(size_of(a[name]) for name in ("error_out", "offset_out", "area_out"))
    return Demand(once + size_of(a["points_in"]) + results, frames * flops)


def _sum_stiffness(a: Arguments) -> Demand:
    moved = sum(size_of(a[name]) for name in ("error_in", "offset_in", "area_in", "sum_out"))
    return Demand(moved, 5 * a["error_in"].size + a["area_in"].size)


def _choose_alone(a: Arguments) -> Demand:
    return Demand(size_of(a["sum_in"]) / 2 + 2 * size_of(a["chosen_out"]), a["sum_in"].size / 2)


def _sum_choices(a: Arguments) -> Demand:
    return Demand(size_of(a["sum_in"]) + size_of(a["chosen_in"]) + size_of(a["total_out"]), a["sum_in"].size)


def _choose_together(a: Arguments) -> Demand:
    return Demand(size_of(a["total_in"]), a["total_in"].size)


def _take_choices(a: Arguments) -> Demand:
    return Demand(3 * size_of(a["chosen_in"]))


def _finish_anchors(a: Arguments) -> Demand:
    members = int(a["start_in"].numpy()[-1] - a["start_in"].numpy()[0])
    return Demand(members * INT + 4 * size_of(a["heaviest_out"]))


def _label_corners(a: Arguments) -> Demand:
    return Demand(3 * size_of(a["corner_vertex_in"]) + 2 * size_of(a["cluster_in"]))


def _gather_corners(a: Arguments) -> Demand:
    # Of room for more.
    return Demand(7 * INT * int(a["total_in"].numpy()[0]))


PLACE_MODELS: dict[str, Callable[[Arguments], Demand]] = {
    model.__name__.removeprefix("_"): model
    for model in (
        _measure_bounds,
        _compare_frames,
        _subtract_origin,
        _mark_used_vertices,
        _key_collapses,
        _key_rounds,
        _gather_log,
        _restore_points,
        _copy_vertices,
        _choose_highest,
        _fill_gram_matrices,
        _solve_for_weights,
        _put_in_the_middle,
        _measure_reach,
        _keep_within_reach,
        _measure_stiffness,
        _sum_stiffness,
        _choose_alone,
        _sum_choices,
        _choose_together,
        _take_choices,
        _finish_anchors,
        _label_corners,
        _gather_corners,
    )
}
