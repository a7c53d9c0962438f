"""The least that kernels before the first pass must do: what each vertex stands for, and the like."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.demand import INT, POINT, VALENCE, Arguments, Demand, size_of

__all__ = ["PREPARATION_MODELS"]

# Two edges, their cross product and its length 20, lengths of three edges 15, largest ones and sums 6.
AREA_FLOPS = 41


def _begin_members(a: Arguments) -> Demand:
    # A point read and written, two links.
    return Demand(a["members"].area.size * (2 * POINT + 2 * INT))


def _measure_members(a: Arguments) -> Demand:
    vertices, corners = a["members"].area.size, a["corner_vertex_in"]
    # Corners and the lists of them; point, list, area and reach of each vertex.
    return Demand(2 * size_of(corners) + vertices * (POINT + 4 * INT), vertices * VALENCE * AREA_FLOPS)


def _begin_trees(a: Arguments) -> Demand:
    return Demand(size_of(a["parent_out"]))


def _join_faces(a: Arguments) -> Demand:
    return Demand(size_of(a["corner_vertex_in"]) + 2 * size_of(a["parent"]))


def _close_trees(a: Arguments) -> Demand:
    return Demand(2 * size_of(a["parent"]) + size_of(a["is_root_out"]))


def _number_components(a: Arguments) -> Demand:
    return Demand(size_of(a["root_in"]) + size_of(a["roots_before_in"]) + size_of(a["component_out"]))


PREPARATION_MODELS: dict[str, Callable[[Arguments], Demand]] = {
    model.__name__.removeprefix("_"): model
    for model in (_begin_members, _measure_members, _begin_trees, _join_faces, _close_trees, _number_components)
}
