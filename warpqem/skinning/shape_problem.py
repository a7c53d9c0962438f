"""Blend shapes that replace each other: their Gram matrix, the rows of the map of weights, and what is left.

See :mod:`warpqem.skinning.reduce_shapes` for the method.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from warpqem.arguments.array_input import finite_array, first_outside, index_array, is_empty
from warpqem.errors import MeshShapeError, OptionError
from warpqem.mesh.mesh_input import read_faces

__all__ = ["ShapeProblem", "clipped_weights", "read_indices", "weight_range"]

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


def read_indices(value: Any, name: str, count: int) -> np.ndarray:
    """Indices of some of so many shapes, int64 or int32.

    Raises:
        MeshShapeError: they are no integers, or there is no such shape.
    """
    # An empty list has no integers.
    found = index_array(np.zeros(0, dtype=np.int64) if is_empty(value) else value, name, ("N",))
    outside = first_outside(found, count)
    if outside is not None:
        raise MeshShapeError(f"{name} at {outside[0]} is {found[outside]}, but there are {count} shapes")
    return found


class ShapeProblem:
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
            self._takes[read_indices(heirs, "heirs", self.count)] = True
        self._scalable = np.full(self.count, scalable is None)
        if scalable is not None:
            self._scalable[read_indices(scalable, "scalable", self.count)] = True
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

    def takes_over(self, parts: np.ndarray, shapes: list[int]) -> np.ndarray:
        """Shapes that get weight of some that go and may be scaled, (S,) bool."""
        return np.asarray(self._scalable & (parts[shapes, : self.count] > 0).any(axis=0))

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
        new[:, : self.count] = clipped_weights(new[:, : self.count], own, self._lower * scales, self._upper * scales)
        new[:, rows] = 0.0
        away = samples - new
        return float(np.sqrt(max(np.einsum("fs,st,ft->", away, self._gram, away) / len(samples), 0.0)))

    def inbetweens_left(self, removed: list[int]) -> list[tuple[float, ...]]:
        """For each shape the weights of its inbetweens that matter when some shapes are gone."""
        left = self._left(self.parts, removed) if removed else 0.0
        share = np.diag(self._moment) * np.diag(self._gram)
        stays = (share[self.count :] > INBETWEEN_SHARE * left) & ~np.isin(self._owner, removed)
        return [
            tuple(float(place) for place in self._place[(self._owner == shape) & stays]) for shape in range(self.count)
        ]

    def corrected_weights(self, kept: np.ndarray, scales: np.ndarray) -> np.ndarray | None:
        """The used weights (F, N) of the N shapes that stay, which are scaled by this; None without any."""
        if self._used is None:
            return None
        limits = (self._lower[kept] * scales, self._upper[kept] * scales)
        new = self._used @ self.parts[: self.count][:, kept]
        return np.asarray(clipped_weights(new, self._used[:, kept], *limits) / scales)


def weight_range(used: np.ndarray | None, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest weight (S,) of each of so many shapes: 0 and 1, or what used weights (F, S) reach."""
    if used is None:
        return np.zeros(count), np.ones(count)
    return np.minimum(0.0, used.min(axis=0, initial=0.0)), np.maximum(1.0, used.max(axis=0, initial=0.0))


def clipped_weights(
    new: np.ndarray, own: np.ndarray, lower: np.ndarray | float, upper: np.ndarray | float
) -> np.ndarray:
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
