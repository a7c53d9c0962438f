"""Greedy removal of joints from a fitted skin: which joint costs the poses least, once weights are solved again.

Of every vertex and every joint that moves it, the error ``E(v, a)`` of :mod:`warpqem.kernels.skin_fit` is known for the
vertex without that joint, solved for by the same kernel. What a joint costs is the sum of these over its vertices, less
their present errors. The joint with the least goes, its vertices take their solutions, and what depended on them is
solved for again: one launch per joint that goes. In place of the joint a vertex may take those that move most alike in
the poses, as its error measures them, and the nearest joint above that is left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.skinning.fit_problem import CandidateRows, SkinFit
from warpqem.skinning.linear_skin import largest_influences

__all__ = ["JointRemoval", "VertexSkin"]

# Joints beside its own that a vertex may choose from when one of its own goes. Two more changed no error by a percent.
SUBSTITUTES = 4
# A joint that a vertex may take beside all of its own is chosen by what it misses with this part of the weight there.
TRIAL_WEIGHT = 0.25
# Bytes for what all joints make of some vertices in all poses, which bounds the scratch memory.
SCRATCH_BYTES = 2**25
# A solution counts as better where it takes off so much of a vertex's error, and of the mean error, at least. A
# thousandth of this took four times as long and was better by one percent.
MIN_GAIN = 1e-2
# Times that vertices take better solutions between two joints that go; each time only what changed is solved for.
MAX_ADOPTIONS = 2
# Substitutes that differ by less than this part of a vertex's mean error count as the same, and so do joints to go that
# differ by less than this part of the whole error.
SAME_ERROR = 1e-3
# What rounding makes of a vertex without error, in units of area times squared length on a mesh of unit diagonal.
MIN_MISSES = 1e-20


@dataclass
class VertexSkin:
    """The skin of C vertices on a mesh of unit diagonal, and what they miss.

    Attributes:
        rest: (C, 3) float64.
        joints: (C, K) int32.
        weights: (C, K) float64; 0 for a joint that does not count.
        misses: (C,) float64, E of each.
    """

    rest: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    misses: np.ndarray


class JointRemoval:
    """The state of the removal.

    Args:
        fit: the solves; its own rows are not used.
        stiffness: (C, P, 3, 3) float64, ``H`` of each vertex in each pose.
        goal: (P, C, 3) float64, ``y``.
        transforms: (P, J, 3, 4) float64, on a mesh of unit diagonal.
        offsets: (P, C, 3) of blend shapes there, or None.
        skin: to start from; its misses are computed.
        parents: (J,) the joint above each, -1 for none.

    Attributes:
        skin: the present skin.
        left: (J,) bool, joints that may move vertices.
    """

    def __init__(
        self,
        fit: SkinFit,
        stiffness: np.ndarray,
        goal: np.ndarray,
        transforms: np.ndarray,
        offsets: np.ndarray | None,
        skin: VertexSkin,
        parents: np.ndarray,
    ) -> None:
        self._fit, self._stiffness, self._goal, self._offsets = fit, stiffness, goal, offsets
        self._rotation, self._translation = transforms[..., :3], transforms[..., 3]
        self._parents, self.skin = parents, skin
        self.left = np.zeros(transforms.shape[1], dtype=bool)
        self.left[self.used()] = True
        count, width = skin.joints.shape
        # Of each vertex without its k-th joint, and last with all of them: rest, joints, weights and E, where valid.
        self._rest = np.zeros((count, width + 1, 3))
        self._joints = np.zeros((count, width + 1, width), dtype=np.int32)
        self._weights = np.zeros((count, width + 1, width))
        self._misses = np.zeros((count, width + 1))
        self._valid = np.zeros((count, width + 1), dtype=bool)
        every = np.arange(count)
        skin.misses[:] = self._solve(every, skin.rest, skin.joints, skin.weights)[3]

    def used(self) -> np.ndarray:
        """Joints that move a vertex, ascending."""
        return np.unique(self.skin.joints[self.skin.weights > 0])

    def costs(self, joints: np.ndarray) -> np.ndarray:
        """What the poses would miss more without each of some joints, float64; infinity where no other is left."""
        self._refresh()
        moved = self.skin.weights > 0
        more = np.where(moved, self._misses[:, :-1] - self.skin.misses[:, None], 0.0)
        total = np.bincount(self.skin.joints[moved], weights=more[moved], minlength=len(self.left))
        return np.asarray(total[joints])

    def cheapest(self, joints: np.ndarray) -> int:
        """The joint of some that costs least; of several that cost the same the one with most joints above it."""
        costs = self.costs(joints)
        same = costs <= costs.min() + SAME_ERROR * self._mean() * len(self.skin.misses)
        depth = np.array([self._depth(int(joint)) for joint in joints])
        return int(joints[np.where(same, depth, -1).argmax()])

    def _depth(self, joint: int) -> int:
        depth = 0
        while self._parents[joint] >= 0 and depth < len(self._parents):
            joint, depth = int(self._parents[joint]), depth + 1
        return depth

    def improve(self) -> None:
        """Let vertices take better solutions with the joints that are left."""
        self._refresh()

    def settle(self) -> None:
        """Solve for vertices with all of their joints and what may take their place; those that gain take that."""
        self._leave_unused()
        slot = self._valid.shape[1] - 1
        vertex = np.flatnonzero(~self._valid[:, slot] & (self.skin.weights > 0).any(axis=1))
        self._solve_all(vertex, np.full(len(vertex), slot))
        vertex = vertex[self._misses[vertex, slot] < self.skin.misses[vertex]]
        self._adopt(vertex, np.full(len(vertex), slot))
        # Once is enough: they are solved for again when they lose a joint.
        self._valid[vertex, slot] = True

    def cost(self, joint: int) -> float:
        """What the poses would miss more without one joint, where nothing else is solved for."""
        vertex, slot = self._without(joint)
        return float((self._misses[vertex, slot] - self.skin.misses[vertex]).sum())

    def _without(self, joint: int) -> tuple[np.ndarray, np.ndarray]:
        """The vertices that a joint moves and its place in each, with valid solutions without it."""
        vertex, slot = np.nonzero((self.skin.joints == joint) & (self.skin.weights > 0))
        asked = ~self._valid[vertex, slot]
        self._solve_all(vertex[asked], slot[asked])
        return vertex, slot

    def remove(self, joint: int) -> int:
        """Take a joint away; returns the one that got most of its weight, or itself where it had none."""
        vertex, slot = self._without(joint)
        heir = joint
        if len(vertex):
            heir = self._largest_gain(vertex, slot, joint)
            self._adopt(vertex, slot)
        self._leave(joint)
        return heir

    def _leave(self, joint: int) -> None:
        """Take a joint without vertices away, and forget the solutions that took it as a substitute."""
        self.left[joint] = False
        taken = (self._joints == joint) & (self._weights > 0)
        self._valid &= ~taken.any(axis=2)

    def misses_with(self, joints: list[int], most: int) -> tuple[float, float]:
        """What evenly chosen vertices, at most so many, would miss if some joints alone moved them; and miss now."""
        moved = np.flatnonzero((self.skin.weights > 0).any(axis=1))
        vertex = moved[:: max(1, len(moved) // most)]
        return float(self._solve_with(joints, vertex)[4].sum()), float(self.skin.misses[vertex].sum())

    def move_with(self, joints: list[int], least: float) -> bool:
        """Let some joints alone move everything, unless the poses would miss less than ``least``; whether they do."""
        vertex = np.flatnonzero((self.skin.weights > 0).any(axis=1))
        solved = self._solve_with(joints, vertex)
        if not least <= solved[4].sum() < self.skin.misses[vertex].sum():
            return False
        skin = self.skin
        skin.rest[vertex], skin.joints[vertex], skin.weights[vertex], _, skin.misses[vertex] = solved
        self.left[:] = False
        self.left[joints] = True
        self._valid[:] = False
        return True

    def _solve_with(self, joints: list[int], vertex: np.ndarray) -> tuple[np.ndarray, ...]:
        """Solve for vertices with these joints and no others, from the weights that they have there."""
        own = np.tile(np.array(joints, dtype=np.int32), (len(vertex), 1))
        same = self.skin.joints[vertex][:, None, :] == own[:, :, None]
        weights = (same * self.skin.weights[vertex][:, None, :]).sum(axis=2)
        weights += (1.0 - weights.sum(axis=1, keepdims=True)) / len(joints)
        return self._solve(vertex, self.skin.rest[vertex], own, weights, np.ones(own.shape, dtype=bool))

    def _largest_gain(self, vertex: np.ndarray, slot: np.ndarray, joint: int) -> int:
        size = len(self.left)
        gain = np.bincount(
            self._joints[vertex, slot].ravel(), weights=self._weights[vertex, slot].ravel(), minlength=size
        ) - np.bincount(self.skin.joints[vertex].ravel(), weights=self.skin.weights[vertex].ravel(), minlength=size)
        gain[joint] = -np.inf
        return int(gain.argmax())

    def _adopt(self, vertex: np.ndarray, slot: np.ndarray) -> None:
        """Give vertices their solutions without one of their joints."""
        self.skin.rest[vertex] = self._rest[vertex, slot]
        self.skin.joints[vertex] = self._joints[vertex, slot]
        self.skin.weights[vertex] = self._weights[vertex, slot]
        self.skin.misses[vertex] = self._misses[vertex, slot]
        self._valid[vertex] = False

    def _refresh(self) -> None:
        """Solve for what is not valid. Where a vertex misses less in one of its solutions, it takes that."""
        for turn in range(MAX_ADOPTIONS + 1):
            self._leave_unused()
            moved = self.skin.weights > 0
            moved = np.concatenate([moved, moved.any(axis=1, keepdims=True)], axis=1)
            vertex, slot = np.nonzero(~self._valid & moved)
            self._solve_all(vertex, slot)
            misses = np.where(moved, self._misses, np.inf)
            best = misses.argmin(axis=1)
            gain = self.skin.misses - misses[np.arange(len(best)), best]
            better = gain > MIN_GAIN * np.maximum(self.skin.misses, self._mean())
            if turn == MAX_ADOPTIONS or not better.any():
                break
            self._adopt(np.flatnonzero(better), best[better])

    def _mean(self) -> float:
        """What a vertex misses in the mean; not zero."""
        return float(self.skin.misses.mean()) + MIN_MISSES

    def _leave_unused(self) -> None:
        """Take joints away that have lost their last vertex, so that they do not come back."""
        for joint in np.setdiff1d(np.flatnonzero(self.left), self.used()):
            self._leave(int(joint))

    def _solve_all(self, vertex: np.ndarray, slot: np.ndarray) -> None:
        """Solve for vertices without one joint each, in batches of little memory."""
        poses = len(self._rotation)
        size = max(1, SCRATCH_BYTES // (poses * max(int(self.left.sum()), 1) * 3 * 8))
        for first in range(0, len(vertex), size):
            self._solve_pairs(vertex[first : first + size], slot[first : first + size])

    def _solve_pairs(self, vertex: np.ndarray, slot: np.ndarray) -> None:
        """Solve for some vertices without one joint each, or with all and what may take their place."""
        skin, every, width = self.skin, np.arange(len(vertex)), self.skin.joints.shape[1]
        own_joints, own_weights = skin.joints[vertex].copy(), skin.weights[vertex].copy()
        goes = slot < width
        joint = np.where(goes, own_joints[every, np.minimum(slot, width - 1)], -1)
        share = np.where(goes, own_weights[every, np.minimum(slot, width - 1)], 0.0)
        bound = self._bounds(vertex, own_joints, own_weights, joint, np.where(goes, share, TRIAL_WEIGHT))
        own_weights[own_joints == joint[:, None]] = 0.0
        # The weight goes to the joint that misses least with it, and the kernel goes on from there.
        best = bound.argmin(axis=1)
        possible = np.isfinite(bound[every, best]) | ~goes
        # Of joints that move alike in these poses the one above does so in others, too.
        above = self._above(joint)
        nearly = bound[every, best] + SAME_ERROR * self._mean()
        best = np.where((above >= 0) & (bound[every, above] <= nearly), above, best)
        is_own = (own_joints == best[:, None]) & (own_weights > 0)
        own_weights += np.where(is_own, share[:, None], 0.0)
        own_vertex, own_slot = np.nonzero(own_weights > 0)
        bound[own_vertex, own_joints[own_vertex, own_slot]] = np.inf
        others = np.argsort(bound, axis=1, kind="stable")[:, : min(SUBSTITUTES, bound.shape[1])]
        others = np.concatenate([others, above[:, None]], axis=1)
        valid = np.isfinite(np.take_along_axis(bound, others, axis=1)) & (others >= 0)
        valid[:, -1] &= ~(others[:, :-1] == others[:, -1:]).any(axis=1)
        started = np.where((others == best[:, None]) & ~is_own.any(axis=1)[:, None] & valid, share[:, None], 0.0)
        joints = np.concatenate([own_joints, others.astype(np.int32)], axis=1)
        weights = np.concatenate([own_weights, started], axis=1)
        allowed = np.concatenate([own_weights > 0, valid], axis=1) & possible[:, None]
        if width == 1:
            solved = self._solve_singly(vertex, joints, allowed)
        else:
            solved = self._solve(vertex, skin.rest[vertex], joints, weights, allowed)
        self._rest[vertex, slot], self._joints[vertex, slot], self._weights[vertex, slot], _, after = solved
        self._misses[vertex, slot] = np.where(possible, after, np.inf)
        self._valid[vertex, slot] = True

    def _solve_singly(self, vertex: np.ndarray, joints: np.ndarray, allowed: np.ndarray) -> tuple[np.ndarray, ...]:
        """As :meth:`_solve` where one joint alone may move each vertex: each candidate is tried with all of the weight.

        Weights of several that are solved for together say little of which one is best alone.
        """
        skin, row = self.skin, np.nonzero(allowed)
        rest, own, weights = skin.rest[vertex], joints[:, :1].astype(np.int32), np.zeros((len(vertex), 1))
        before, after = np.zeros((2, len(vertex)))
        if len(row[0]):
            of = vertex[row[0]]
            solved = self._solve(of, skin.rest[of], joints[row][:, None], np.ones((len(of), 1)))
            # The best of each vertex, of equal ones the first.
            order = np.lexsort((row[1], solved[4], row[0]))
            found, first = np.unique(row[0][order], return_index=True)
            for to, values in zip((rest, own, weights, before, after), solved, strict=True):
                to[found] = values[order[first]]
        return rest, own, weights, before, after

    def _above(self, joint: np.ndarray) -> np.ndarray:
        """The nearest joint above each that is left; -1 for none."""
        above = np.where(joint >= 0, self._parents[joint], -1)
        for _ in range(len(self._parents)):
            gone = (above >= 0) & ~self.left[above]
            if not gone.any():
                break
            above = np.where(gone, self._parents[above], above)
        return np.asarray(above)

    def _bounds(
        self, vertex: np.ndarray, joints: np.ndarray, weights: np.ndarray, joint: np.ndarray, share: np.ndarray
    ) -> np.ndarray:
        """What vertices would miss if a part of their weight went to another joint, (N, J); infinity for none.

        With the rest position fixed, ``E(a + s (e_r - e_j))`` is known from ``G``; an upper bound on what solving
        gives. What is the same for all ``r`` is left out.

        Args:
            vertex: (N,) the vertices.
            joints: (N, K) their joints.
            weights: (N, K) their weights.
            joint: (N,) the joint that the part is of; -1 for a part of all.
            share: (N,) the part.
        """
        every, active = np.arange(len(vertex)), np.flatnonzero(self.left)
        poses, goes = len(self._rotation), joint >= 0
        rest = np.broadcast_to(self.skin.rest[vertex], (poses, len(vertex), 3))
        moved = rest if self._offsets is None else rest + self._offsets[:, vertex]
        # u of all joints, (N, P, A, 3)
        linear = self._rotation[:, active].reshape(poses, -1, 3) @ moved.transpose(0, 2, 1)
        away = linear.reshape(poses, len(active), 3, -1).transpose(3, 0, 1, 2) + self._translation[:, active]
        away -= self._goal[:, vertex].transpose(1, 0, 2)[:, :, None]
        place = np.zeros(len(self.left), dtype=np.int64)
        place[active] = np.arange(len(active))
        total = np.zeros((len(vertex), poses, 3))
        for k in range(joints.shape[1]):
            total += weights[:, k, None, None] * away[every, :, place[joints[:, k]]]
        part = np.where(goes[:, None, None], away[every, :, place[joint]], total)
        stiffness = self._stiffness[vertex]
        rest_of = 2.0 * share[:, None, None] * (total - share[:, None, None] * part)
        toward = np.einsum("npij,npj->npi", stiffness, rest_of)
        squares = share[:, None] ** 2 * np.einsum("npai,npai->na", away, np.matmul(away, stiffness))
        found = np.full((len(vertex), len(self.left)), np.inf)
        found[:, active] = np.einsum("npai,npi->na", away, toward) + squares
        found[every[goes], joint[goes]] = np.inf
        return found

    def _solve(
        self,
        vertex: np.ndarray,
        rest: np.ndarray,
        joints: np.ndarray,
        weights: np.ndarray,
        allowed: np.ndarray | None = None,
    ) -> tuple[np.ndarray, ...]:
        """Rest, joints, weights and E before and after of rows of candidates; what misses less of start and end."""
        width, count = self.skin.joints.shape[1], len(vertex)
        allowed = weights > 0 if allowed is None else allowed
        start = np.zeros(count + 1, dtype=np.int32)
        np.cumsum(allowed.sum(axis=1), out=start[1:])
        rows = CandidateRows(start, joints[allowed].astype(np.int32), weights[allowed])
        device = self._fit.device
        stiffness = wp.array(np.ascontiguousarray(self._stiffness[vertex]), dtype=wp.mat33d, device=device)
        goal = wp.array(np.ascontiguousarray(self._goal[:, vertex]), dtype=wp.vec3d, device=device)
        offsets = None if self._offsets is None else np.ascontiguousarray(self._offsets[:, vertex])
        solved, weight, before, after = self._fit.solve_rows(rows, rest, offsets, stiffness, goal, width)
        row = np.repeat(np.arange(count), np.diff(start))
        # Weights to start from that are of more joints than may count are no solution to go back to.
        started = np.bincount(row[rows.weight > 0], minlength=count)
        worse = (after > before) & (started <= width)
        weight = np.where(worse[row], rows.weight, weight)
        found = largest_influences(row, rows.joint, weight, count, width)
        return np.where(worse[:, None], rest, solved), *found, before, np.where(worse, before, after)
