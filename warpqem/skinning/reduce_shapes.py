"""Fewer blend shapes for a simplified mesh: those that it shows least go, and others take their weight where they can.

What weights ``w`` do is ``sum_s w_s D_s``. A shape that goes is replaced by a sum of few others,
``D_s = sum_r M_sr D_r`` with ``M >= 0``, and the weights of those that stay become ``w_r + sum_s w_s M_sr``, within
[0, 1] or what the used weights reach. Where a limit on the error asks for it, as it does of equal shapes that are used
together, a shape that takes others over is scaled by the largest sum that it may get, and its weights by the inverse of
that, so that none is cut off. The mean square of what is left over weights that are used and over random ones,
``tr(W (1 - M) Q (1 - M)^T)`` with ``W = mean w w^T`` and the Gram matrix ``Q`` of the shapes, is quadratic in ``M``.
Shapes go one by one, each time the one that leaves least (greedy backward elimination); rows of ``M`` are found by
orthogonal matching pursuit without negative terms. ``Q`` measures across the surface of the simplified mesh, and a
little along it.

An inbetween is what it adds to the straight way to its shape, with the hat function of its weight; it is a row of its
own that nothing can replace.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from warpqem.arguments.array_input import finite_array, first_outside, index_array, is_empty
from warpqem.arguments.array_record import ArrayRecord
from warpqem.arguments.array_types import ArrayInput
from warpqem.arguments.number_input import real_number, whole_number
from warpqem.errors import MeshShapeError, OptionError
from warpqem.mesh.mesh_input import read_faces

__all__ = ["ReducedShapes", "reduce_shapes", "weight_range"]

# Shapes that may take over a part of the weight of one that goes.
MAX_HEIRS = 3
# Motion along the surface counts so much of that across it: it moves textures, not the outline.
ALONG_SURFACE = 0.1
# Random weights, each uniform in [0, 1], that errors are taken over.
RANDOM_SAMPLES = 512
# A part below this is no use: it would hardly be seen.
MIN_PART = 1e-3
# An inbetween matters where going without it adds so much to the mean square of the rest.
INBETWEEN_SHARE = 0.01
# Costs that differ by less than this part of what the largest shape moves are the same but for rounding.
SAME_COST = 1e-12
# Turns over all rows of M until each fits the others.
TURNS = 2


@dataclass(frozen=True, eq=False, repr=False)
class ReducedShapes(ArrayRecord):
    """What :func:`reduce_shapes` returns.

    Attributes:
        kept: (N,) int32, shapes that stay, ascending.
        removed: (R,) int32, those that went, in that order.
        parts: (S, N) float64, how much of the weight of each shape goes to each that stays: 1 for a shape itself.
        scales: (N,) float64, what the offsets of each shape that stays are to be multiplied by, and its weights are
            divided by: 1, but where it takes over so much that its weights would be cut off beyond ``max_error``.
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
        return _clipped(weights @ self.parts, own, low * self.scales, high * self.scales) / self.scales


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
    if shapes is None and max_error is None:
        raise OptionError("one of shapes and max_error is needed")
    least = 0 if shapes is None else whole_number(shapes, "shapes")
    limit = np.inf
    if max_error is not None:
        limit = real_number(max_error, "max_error", "a percentage of at least 0", lambda x: x >= 0) / 100.0
    problem = _ShapeProblem(rest, faces, offsets, weights, inbetweens, heirs, scalable)
    may_go = np.ones(problem.count, dtype=bool)
    if keep is not None:
        may_go[_read_indices(keep, "keep", problem.count)] = False
    errors = [(0.0, 0.0)]
    costs: dict[int, float] = dict.fromkeys(np.flatnonzero(may_go).tolist(), -1.0)
    removed: list[int] = []
    while costs and problem.count - len(removed) > least:
        shape = problem.cheapest(costs)
        parts = problem.without(shape)
        found = problem.errors(parts, [*removed, shape])
        if max(found) > limit:
            found = problem.scaled_errors(parts, [*removed, shape])
        if max(found) > limit:
            break
        problem.parts = parts
        removed.append(shape)
        problem.gone.append(shape)
        errors.append(found)
        # What a shape costs only grows as others go; these are lower bounds now.
        del costs[shape]
    return problem.result(removed, np.array(errors))


def _read_indices(value: Any, name: str, count: int) -> np.ndarray:
    # An empty list has no integers.
    found = index_array(np.zeros(0, dtype=np.int64) if is_empty(value) else value, name, ("N",))
    outside = first_outside(found, count)
    if outside is not None:
        raise MeshShapeError(f"{name} at {outside[0]} is {found[outside]}, but there are {count} shapes")
    return found


class _ShapeProblem:
    """Shapes and inbetweens as rows, their Gram matrix, and weights.

    Attributes:
        count: shapes S.
        parts: (S + I, S + I) float64, row s says what takes the place of row s: 1 at itself where it stays.
        scaled: (S,) bool, shapes that are scaled so that their weights are not cut off.
        gone: shapes that went.
    """

    def __init__(
        self, rest: Any, faces: Any, offsets: Any, weights: Any, inbetweens: Any, heirs: Any, scalable: Any
    ) -> None:
        points = finite_array(rest, "rest", ("C", 3)).astype(np.float64)
        corner = read_faces(faces, "faces", len(points))
        given = finite_array(offsets, "offsets", ("S", len(points), 3)).astype(np.float64)
        self.count = len(given)
        self._owner, self._place, extra = _read_inbetweens(inbetweens, given)
        rows = np.concatenate([given, extra])
        stiffness, area = _stiffness(points, corner)
        diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
        unit = 1.0 / max(area * diagonal**2, np.finfo(float).tiny)
        pushed = np.einsum("vij,svj->svi", stiffness, rows)
        self._gram = unit * (rows.reshape(len(rows), -1) @ pushed.reshape(len(rows), -1).T)
        self._used = None
        if weights is not None:
            self._used = finite_array(weights, "weights", ("F", self.count)).astype(np.float64)
        random = np.random.default_rng(0).uniform(size=(RANDOM_SAMPLES, self.count))
        self._samples = [self._with_hats(each) for each in (self._used, random) if each is not None and len(each)]
        self._moment = np.mean([each.T @ each / len(each) for each in self._samples], axis=0)
        self._lower, self._upper = weight_range(self._used, self.count)
        self._takes = np.zeros(len(rows), dtype=bool)
        self._takes[: self.count] = True
        if heirs is not None:
            self._takes[:] = False
            self._takes[_read_indices(heirs, "heirs", self.count)] = True
        self._scalable = np.full(self.count, scalable is None)
        if scalable is not None:
            self._scalable[_read_indices(scalable, "scalable", self.count)] = True
        self._scalable[self._owner] = False
        self.scaled = np.zeros(self.count, dtype=bool)
        self.parts = np.eye(len(rows))
        self.gone: list[int] = []

    def _with_hats(self, weights: np.ndarray) -> np.ndarray:
        """Weights of all rows: those of inbetweens by their hat functions."""
        hats = np.zeros((len(weights), len(self._owner)))
        for index, (owner, place) in enumerate(zip(self._owner, self._place, strict=True)):
            others = [0.0, 1.0, *[p for o, p in zip(self._owner, self._place, strict=True) if o == owner]]
            low = max(other for other in others if other < place)
            high = min(other for other in others if other > place)
            hats[:, index] = np.interp(weights[:, owner], [low, place, high], [0.0, 1.0, 0.0])
        return np.concatenate([weights, hats], axis=1)

    def cheapest(self, costs: dict[int, float]) -> int:
        """The shape that leaves least when it goes, of several the smallest; costs known before are lower bounds."""
        size, fresh = np.diag(self._gram), set[int]()
        while True:
            least = min(costs.values()) + SAME_COST * float(size.max())
            same = [shape for shape, cost in costs.items() if cost <= least]
            stale = [shape for shape in same if shape not in fresh]
            if not stale:
                # A large one can be made of small ones, but no small one of a large one that is gone.
                return min(same, key=lambda each: (size[each], each))
            shape = min(stale, key=lambda each: (costs[each], each))
            costs[shape] = self._left(self.without(shape, turns=1), [*self.gone, shape])
            fresh.add(shape)

    def without(self, shape: int, turns: int = TURNS) -> np.ndarray:
        """The parts when a shape goes, with its inbetweens; in one turn only those that lost an heir are found anew."""
        asked = [shape, *[row for row in self.gone if self.parts[row, shape] > 0]]
        # The first of several may make up for the next, or each stands for itself.
        ways = [False, True] if len(asked) > 1 else [True]
        found = [self._without(shape, asked, turns, each_alone=way) for way in ways]
        return min(found, key=lambda parts: self._left(parts, [*self.gone, shape]))

    def _without(self, shape: int, asked: list[int], turns: int, *, each_alone: bool) -> np.ndarray:
        parts = self.parts.copy()
        parts[self.count + np.flatnonzero(self._owner == shape)] = 0.0
        parts[asked] = 0.0
        heirs = self._takes.copy()
        heirs[[*self.gone, shape]] = False
        rows = self._rows_gone([*self.gone, shape])
        for place, row in enumerate(asked):
            known = rows[~np.isin(rows, asked[place + 1 :])] if each_alone else rows
            parts[row] = self._row(parts, row, known, heirs)
        for _ in range(turns - 1):
            # All that went: what one leaves, another may take off.
            for row in [*self.gone, shape]:
                parts[row] = self._row(parts, row, rows, heirs)
        return parts

    def _rows_gone(self, shapes: list[int]) -> np.ndarray:
        return np.concatenate([shapes, self.count + np.flatnonzero(np.isin(self._owner, shapes))]).astype(np.int64)

    def _row(self, parts: np.ndarray, row: int, rows: np.ndarray, heirs: np.ndarray) -> np.ndarray:
        """The best few parts of one row without negative ones, all others given (matching pursuit)."""
        left = np.eye(len(parts))[rows] - parts[rows]
        moment = self._moment[row, rows]
        own = self._moment[row, row]
        found = np.zeros(len(parts))
        if own <= 0:
            return found
        # What is left of the row and, by how their weights go together, of the others.
        target = (moment[:, None] * left).sum(axis=0) / own + parts[row]
        slope, size = target @ self._gram, np.diag(self._gram)
        support: list[int] = []
        for _ in range(MAX_HEIRS):
            rest = slope - found @ self._gram
            # What each takes off with the best part of it that it may have.
            part = np.divide(rest, size, out=np.zeros_like(rest), where=heirs & (size > 0)).clip(0.0, 1.0)
            gain = part * (2.0 * rest - part * size)
            gain[support] = 0.0
            best = int(gain.argmax())
            if gain[best] <= 0:
                break
            support.append(best)
            found = self._least_squares(slope, support)
        found[found < MIN_PART] = 0.0
        return found

    def _least_squares(self, slope: np.ndarray, support: list[int]) -> np.ndarray:
        """Parts within [0, 1] on a support of few, by coordinate descent."""
        gram, goal = self._gram[np.ix_(support, support)].tolist(), slope[support].tolist()
        part = [0.0] * len(support)
        for _ in range(20):
            for k, row in enumerate(gram):
                rest = goal[k] - sum(entry * other for entry, other in zip(row, part, strict=True)) + part[k] * row[k]
                part[k] = min(max(rest / row[k], 0.0), 1.0)
        found = np.zeros(len(slope))
        found[support] = part
        return found

    def _left(self, parts: np.ndarray, shapes: list[int]) -> float:
        """The mean square that is left, where no weight is cut off."""
        rows = self._rows_gone(shapes)
        left = np.eye(len(parts))[rows] - parts[rows]
        return float((self._moment[np.ix_(rows, rows)] * (left @ self._gram @ left.T)).sum())

    def scaled_errors(self, parts: np.ndarray, shapes: list[int]) -> tuple[float, float]:
        """The errors once shapes that take over weight of some that go are scaled, where they may be."""
        self.scaled |= self._scalable & (parts[shapes, : self.count] > 0).any(axis=0)
        return self.errors(parts, shapes)

    def scales(self, parts: np.ndarray, shapes: list[int]) -> np.ndarray:
        """What each shape is scaled by, (S,), when some go: as far as the sum of weights that it gets may go."""
        taken = parts[shapes, : self.count]
        high, low = (limit + limit[shapes] @ taken for limit in (self._upper, self._lower))
        down = np.divide(low, self._lower, out=np.ones(self.count), where=self._lower < 0)
        return np.where(self.scaled, np.maximum(np.maximum(high / self._upper, down), 1.0), 1.0)

    def errors(self, parts: np.ndarray, shapes: list[int]) -> tuple[float, float]:
        """RMS distances over used and random weights, in parts of the diagonal, with weights cut off at their ends."""
        scales = self.scales(parts, shapes)
        found = [self._rms(samples, parts, self._rows_gone(shapes), scales) for samples in self._samples]
        return (found[0], found[1]) if len(found) == 2 else (0.0, found[0])

    def _rms(self, samples: np.ndarray, parts: np.ndarray, rows: np.ndarray, scales: np.ndarray) -> float:
        new = samples @ parts
        own = samples[:, : self.count]
        new[:, : self.count] = _clipped(new[:, : self.count], own, self._lower * scales, self._upper * scales)
        new[:, rows] = 0.0
        away = samples - new
        return float(np.sqrt(max(np.einsum("fs,st,ft->", away, self._gram, away) / len(samples), 0.0)))

    def result(self, removed: list[int], errors: np.ndarray) -> ReducedShapes:
        """What came of it; inbetweens that do not matter go, too."""
        kept = np.setdiff1d(np.arange(self.count), removed)
        parts = self.parts[: self.count][:, kept]
        left = self._left(self.parts, removed) if removed else 0.0
        share = np.diag(self._moment) * np.diag(self._gram)
        stays = share[self.count :] > INBETWEEN_SHARE * left
        inbetweens = [
            tuple(float(place) for place in self._place[(self._owner == shape) & stays & np.isin(shape, kept)])
            for shape in range(self.count)
        ]
        weights, scales = None, self.scales(self.parts, removed)[kept]
        if self._used is not None:
            limits = (self._lower[kept] * scales, self._upper[kept] * scales)
            weights = _clipped(self._used @ parts, self._used[:, kept], *limits) / scales
        return ReducedShapes(
            kept.astype(np.int32),
            np.array(removed, dtype=np.int32),
            parts,
            scales,
            weights,
            inbetweens,
            np.arange(self.count, self.count - len(removed) - 1, -1, dtype=np.int32),
            100.0 * errors[:, 0],
            100.0 * errors[:, 1],
        )


def weight_range(used: np.ndarray | None, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest weight (S,) of each of so many shapes: 0 and 1, or what used weights (F, S) reach."""
    if used is None:
        return np.zeros(count), np.ones(count)
    return np.minimum(0.0, used.min(axis=0, initial=0.0)), np.maximum(1.0, used.max(axis=0, initial=0.0))


def _clipped(new: np.ndarray, own: np.ndarray, lower: np.ndarray | float, upper: np.ndarray | float) -> np.ndarray:
    """New weights within a range, which goes as far as the shape's own weight."""
    return np.asarray(np.clip(new, np.minimum(lower, own), np.maximum(upper, own)))


def _read_inbetweens(inbetweens: Any, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Owner and weight of each inbetween, and what it adds to the straight way to its shape, (I, C, 3)."""
    if inbetweens is not None and len(inbetweens) != len(offsets):
        raise MeshShapeError(f"inbetweens are of {len(inbetweens)} shapes, but there are {len(offsets)}")
    owner: list[int] = []
    place: list[float] = []
    extra = [np.zeros((0, *offsets.shape[1:]))]
    for shape, each in enumerate(inbetweens or ()):
        for weight, values in sorted(each.items()):
            if not 0 < weight < 1:
                raise OptionError(f"an inbetween of shape {shape} has the weight {weight:g}, expected one in (0, 1)")
            read = finite_array(values, f"inbetween {weight:g} of shape {shape}", offsets.shape[1:])
            owner.append(shape)
            place.append(float(weight))
            extra.append((read - weight * offsets[shape])[None])
    return np.array(owner, dtype=np.int64), np.array(place), np.concatenate(extra)


def _stiffness(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, float]:
    """What a move of each vertex counts, (C, 3, 3), by a third of the area of its faces; and the whole area."""
    corner = points[faces]
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = 0.5 * np.linalg.norm(cross, axis=1)
    normal = cross / np.maximum(2.0 * area, np.finfo(float).tiny)[:, None]
    across = (1.0 - ALONG_SURFACE) * np.einsum("fi,fj->fij", normal, normal) + ALONG_SURFACE * np.eye(3)
    stiffness = np.zeros((len(points), 3, 3))
    np.add.at(stiffness, faces.ravel(), np.repeat(across * (area / 3.0)[:, None, None], 3, axis=0))
    return stiffness, float(area.sum())
