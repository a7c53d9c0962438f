"""Fewer blend shapes for a simplified mesh: those that it shows least go, and others take their weight where they can.

What weights ``w`` do is ``sum_s w_s D_s``. A shape that goes is replaced by a sum of few others,
``D_s = sum_r M_sr D_r`` with ``M >= 0``, and the weights of those that stay become ``w_r + sum_s w_s M_sr``, within
[0, 1] or what the used weights reach. Where that cuts too much off, as of equal shapes that are used together, a shape
that takes others over is scaled by the largest sum that it may get, and its weights by the inverse of that. The mean
square of what is left over weights that are used and over random ones, ``tr(W (1 - M) Q (1 - M)^T)`` with
``W = mean w w^T`` and the Gram matrix ``Q`` of the shapes, is quadratic in ``M``.
Shapes go one by one, each time the one that leaves least (greedy backward elimination); rows of ``M`` are found by
orthogonal matching pursuit without negative terms. ``Q`` measures across the surface of the simplified mesh, and a
little along it.

An inbetween is what it adds to the straight way to its shape, with the hat function of its weight; it is a row of its
own that nothing can replace.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any, TypedDict

import numpy as np

from warpqem.arguments.array_record import ArrayRecord
from warpqem.arguments.array_types import ArrayInput
from warpqem.arguments.number_input import real_number, whole_number
from warpqem.errors import OptionError
from warpqem.skinning.shape_problem import ShapeProblem, clipped_weights, read_indices

__all__ = ["MAX_STEPS", "ReducedShapes", "ShapeGoals", "reduce_shapes", "shape_steps"]

# Steps along a removal at most.
MAX_STEPS = 16
# Without a limit on the error, shapes are scaled where used weights that are cut off leave more than this part of the
# diagonal, which would be seen, and where that takes a tenth of it off at least.
MAX_CUT, MAX_SCALED = 1e-4, 0.9


@dataclass(frozen=True, eq=False, repr=False)
class ReducedShapes(ArrayRecord):
    """What :func:`reduce_shapes` returns.

    Attributes:
        kept: (N,) int32, shapes that stay, ascending.
        removed: (R,) int32, those that went, in that order.
        parts: (S, N) float64, how much of the weight of each shape goes to each that stays: 1 for a shape itself.
        scales: (N,) float64, what the offsets of each shape that stays are to be multiplied by, and its weights are
            divided by: 1, but where it takes over so much that its weights would be cut off beyond ``max_error`` or,
            without that, used ones by what would be seen.
        weights: (F, N) float64, the used weights corrected, within [0, 1] or what the used ones reach; None for none.
        inbetweens: for each shape the weights of its inbetweens that stay.
        counts: (R + 1,) int32, shapes at each step.
        used_errors: (R + 1,) float64, RMS distance over the used weights at each of these counts, in % of the rest
            shape's diagonal; 0 without any.
        random_errors: (R + 1,) float64, the same over random weights.
    """

    kept: np.ndarray
    removed: np.ndarray
    parts: np.ndarray
    scales: np.ndarray
    weights: np.ndarray | None
    inbetweens: list[tuple[float, ...]]
    counts: np.ndarray
    used_errors: np.ndarray
    random_errors: np.ndarray

    def corrected(
        self, weights: np.ndarray, upper: np.ndarray | None = None, lower: np.ndarray | None = None
    ) -> np.ndarray:
        """Weights of the shapes that stay; one that takes nothing over keeps its weight.

        Args:
            weights: (..., S), weights of all shapes.
            upper: (N,), what others add to a shape goes up to this; None for 1.
            lower: (N,), or down to this; None for 0.

        Returns:
            (..., N).
        """
        own = weights[..., self.kept]
        low, high = (default if limit is None else limit for limit, default in ((lower, 0.0), (upper, 1.0)))
        return clipped_weights(weights @ self.parts, own, low * self.scales, high * self.scales) / self.scales


def reduce_shapes(
    rest: ArrayInput,
    faces: ArrayInput,
    offsets: ArrayInput,
    weights: ArrayInput | None = None,
    *,
    shapes: int | None = None,
    max_error: float | None = None,
    inbetweens: Sequence[Mapping[float, ArrayInput]] | None = None,
    keep: ArrayInput | None = None,
    heirs: ArrayInput | None = None,
    scalable: ArrayInput | None = None,
) -> ReducedShapes:
    """Choose the blend shapes that a mesh can do without, and how the others take their place.

    Args:
        rest: (C, 3), the rest shape of the simplified mesh.
        faces: (N, 3), its faces.
        offsets: (S, C, 3), what each shape adds at weight 1, in the units of ``rest``.
        weights: (F, S), weights that an animation uses; None for none. Random ones count as much.
        shapes: shapes that stay at most; None for no such goal. One of the two goals is needed.
        max_error: shapes go as long as the RMS distance that this makes is at most so many % of the rest shape's
            diagonal, over the used weights and over random ones; None for no such limit. With both, the limit holds.
        inbetweens: for each shape its inbetweens, offsets (C, 3) by their weight between 0 and 1; None for none.
        keep: shapes that stay; None for none.
        heirs: shapes that may take over weight of others; None for all.
        scalable: of these, shapes whose offsets may be scaled, see :attr:`ReducedShapes.scales`; None for all. One with
            inbetweens is never.

    Raises:
        MeshShapeError: shapes of arrays do not go together.
        OptionError: there is no goal, or a number is out of range.
    """
    given = (rest, faces, offsets, weights, inbetweens, heirs, scalable)
    return shape_steps(given, {"shapes": shapes, "max_error": max_error, "keep": keep}, most=1)[0]


class ShapeGoals(TypedDict, total=False):
    """How far shapes are reduced: arguments of :func:`reduce_shapes`."""

    shapes: int | None
    max_error: float | None
    keep: ArrayInput | None


def shape_steps(given: tuple[Any, ...], goals: ShapeGoals, *, most: int = MAX_STEPS) -> list[ReducedShapes]:
    """What comes of shapes along their removal, of the fewest shapes first and of all last.

    Args:
        given: arguments of :func:`reduce_shapes`: rest, faces, offsets, weights, inbetweens, heirs, scalable.
        goals: others of its arguments.
        most: steps at most, evenly spread; of one alone that of the fewest shapes.

    Raises:
        The errors of :func:`reduce_shapes`.
    """
    shapes, max_error, keep = goals.get("shapes"), goals.get("max_error"), goals.get("keep")
    if shapes is None and max_error is None:
        raise OptionError("one of shapes and max_error is needed")
    least = 0 if shapes is None else whole_number(shapes, "shapes")
    limit = np.inf
    if max_error is not None:
        limit = real_number(max_error, "max_error", "a percentage of at least 0", lambda x: x >= 0) / 100.0
    problem = ShapeProblem(*given)
    may_go = np.ones(problem.count, dtype=bool)
    if keep is not None:
        may_go[read_indices(keep, "keep", problem.count)] = False
    errors = [(0.0, 0.0)]
    costs: dict[int, float] = dict.fromkeys(np.flatnonzero(may_go).tolist(), -1.0)
    removed: list[int] = []
    noted = set(np.linspace(least, problem.count, most).round().astype(int).tolist() if most > 1 else [])
    steps = [_reduced(problem, removed, errors)]
    while costs and problem.count - len(removed) > least:
        shape = problem.cheapest(costs)
        parts = problem.without(shape)
        found = _scaled_if_needed(problem, parts, [*removed, shape], None if max_error is None else limit)
        if max(found) > limit:
            break
        problem.parts = parts
        removed.append(shape)
        problem.gone.append(shape)
        errors.append(found)
        # What a shape costs only grows as others go; these are lower bounds now.
        del costs[shape]
        if problem.count - len(removed) in noted:
            steps.append(_reduced(problem, removed, errors))
    last = _reduced(problem, removed, errors)
    if len(steps[-1].removed) == len(removed):
        steps.pop()
    return [last, *steps[::-1]][:most]


def _scaled_if_needed(
    problem: ShapeProblem, parts: np.ndarray, shapes: list[int], limit: float | None
) -> tuple[float, float]:
    """The errors when some shapes are gone; shapes are scaled where a limit, or else the used weights, ask for it."""
    # Animators know shapes by what weight 1 does: without a limit, random weights ask for nothing.
    decides = itemgetter(0) if limit is None else max
    found = problem.errors(parts, shapes)
    if decides(found) <= (MAX_CUT if limit is None else limit):
        return found
    before = problem.scaled
    problem.scaled = before | problem.takes_over(parts, shapes)
    scaled = problem.errors(parts, shapes)
    if limit is None and decides(scaled) > MAX_SCALED * decides(found):
        problem.scaled = before
        return found
    return scaled


def _reduced(problem: ShapeProblem, removed: list[int], errors: list[tuple[float, float]]) -> ReducedShapes:
    """What has come of the shapes so far; inbetweens that do not matter go, too."""
    kept = np.setdiff1d(np.arange(problem.count), removed)
    scales = problem.scales(problem.parts, removed)[kept]
    used, random = 100.0 * np.array(errors).T
    return ReducedShapes(
        kept.astype(np.int32),
        np.array(removed, dtype=np.int32),
        problem.parts[: problem.count][:, kept],
        scales,
        problem.corrected_weights(kept, scales),
        problem.inbetweens_left(removed),
        np.arange(problem.count, problem.count - len(removed) - 1, -1, dtype=np.int32),
        used,
        random,
    )
