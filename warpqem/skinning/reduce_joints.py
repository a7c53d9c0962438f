"""Fewer joints for a simplified mesh, chosen by the error over its poses.

The error of a skin is that of Landreneau & Schaefer 2009, see :mod:`warpqem.skinning.fit_skin`. Joints go one by one,
each time the one whose vertices miss their poses least without it, after rest positions and weights are solved for
again: a greedy backward elimination with exact costs. See :mod:`warpqem.skinning.joint_removal`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warpqem.arguments.array_input import first_outside, index_array
from warpqem.arguments.array_record import ArrayRecord
from warpqem.arguments.array_types import ArrayInput, Points
from warpqem.arguments.number_input import real_number, whole_number
from warpqem.errors import MeshShapeError, OptionError
from warpqem.pipeline.result import SimplifiedMesh
from warpqem.runtime.device import on_device
from warpqem.skinning.fit_problem import SURFACE_REGULARISATION
from warpqem.skinning.fit_skin import PreparedFit, prepare_fit
from warpqem.skinning.joint_removal import JointRemoval, VertexSkin
from warpqem.skinning.linear_skin import LinearSkin, blend_influences, normalised_weights

__all__ = ["JointsGone", "ReducedJoints", "choose_joints", "joint_removal", "reduce_joints", "reduced_skin"]

# Vertices that decide which joint goes, about so many, and of each joint at least so many of those that it moves most:
# all of a small mesh. The skin of all vertices is solved for in any case.
MAX_DECIDING, MIN_DECIDING = 512, 8
# Joints of a vertex that count in that choice: the others have little weight, and the solves grow with their cube.
DECIDING_INFLUENCES = 4
# Influences of a mesh whose vertices look for better solutions once more at the end, which takes up to 10 % off the
# error and half a millisecond for each.
MAX_IMPROVED = 40000
# Where no more joints are left, one by one is not good enough: each is tried for each that went. With more of them the
# choice was never worse than removal from the leaves.
MAX_EXCHANGED = 3
# An exchange takes off this part of the error at least.
MIN_EXCHANGE = 0.999


@dataclass(frozen=True, eq=False, repr=False)
class ReducedJoints(ArrayRecord):
    """What :func:`reduce_joints` returns.

    Attributes:
        skin: the skin of the output vertices, as in :class:`warpqem.skinning.FittedSkin`; its joints are those of the
            input.
        used: (N,) int32, joints that move a vertex, ascending.
        removed: (R,) int32, joints that went, in that order; those that moved no vertex are not among them.
        heirs: (R,) int32, the joint that got most of the weight of each; -1 where its vertices had found better ones.
        joint_counts: (S + 1,) int32, falling: joints in use before any went and after each step.
        errors: (S + 1,) float64, RMS distance over poses of the vertices from their planes at each of these counts, in
            % of the rest shape's diagonal, beyond that of the free placement.
    """

    skin: LinearSkin
    used: np.ndarray
    removed: np.ndarray
    heirs: np.ndarray
    joint_counts: np.ndarray
    errors: np.ndarray

    @property
    def added_error(self) -> float:
        """RMS distance that fewer joints add to that of all joints, in quadrature, in % of the diagonal."""
        return float(np.sqrt(max(self.errors[-1] ** 2 - self.errors[0] ** 2, 0.0)))

    def own_order(self) -> LinearSkin:
        """The same skin with joints that count through ``used``."""
        place = np.zeros(int(self.skin.joints.max(initial=0)) + 1, dtype=np.int32)
        place[self.used] = np.arange(len(self.used))
        joints = np.where(self.skin.weights > 0, place[self.skin.joints], 0).astype(np.int32)
        return LinearSkin(self.skin.rest, joints, self.skin.weights)


@on_device
def reduce_joints(
    points: Points,
    faces: ArrayInput,
    result: SimplifiedMesh,
    skin: LinearSkin,
    transforms: ArrayInput,
    *,
    joints: int | None = None,
    max_error: float | None = None,
    parents: ArrayInput | None = None,
    keep: ArrayInput | None = None,
    start: LinearSkin | None = None,
    influences: int | None = None,
    offsets: ArrayInput | None = None,
    start_offsets: ArrayInput | None = None,
    seams: ArrayInput | None = None,
    to_planes: bool = True,
    device: str | None = None,
) -> ReducedJoints:
    """Fit the skin of a simplified mesh over P poses with fewer joints, the first pose being the rest shape.

    Args:
        points: (P, V, 3), the input in its poses; this and what is not named here as in
            :func:`warpqem.skinning.fit_skin`.
        faces: (N, 3), the input's faces.
        result: the simplified mesh.
        skin: the input's skin.
        transforms: (P, J, 3, 4).
        joints: joints that move the mesh at most; None for no such goal. One of the two goals is needed.
        max_error: joints go as long as the RMS distance that this adds over the poses is at most so many % of the rest
            shape's diagonal, see :attr:`ReducedJoints.added_error`; None for no such limit. With both, the limit holds.
        parents: (J,) int, the joint above each, -1 for none: where a joint goes, its nearest one above may take its
            vertices, beside those that move most alike. None where this is not known.
        keep: joints that do not go; None for none.
        start: see there.
        influences: see there.
        offsets: see there.
        start_offsets: see there.
        seams: see there.
        to_planes: see there.
        device: see there.

    Raises:
        MeshShapeError: shapes do not go together, or the poses are not what skin and transforms give.
        OptionError: there is no goal, or a number is out of range.
    """
    if joints is None and max_error is None:
        raise OptionError("one of joints and max_error is needed")
    if joints is not None:
        joints = whole_number(joints, "joints")
    if max_error is not None:
        max_error = real_number(max_error, "max_error", "a percentage of at least 0", lambda x: x >= 0)
    prepared = prepare_fit(
        points, faces, result, skin, transforms, start, influences, offsets, start_offsets, seams, to_planes, device
    )
    joint_count = prepared.transforms.shape[1]
    above = _read_parents(parents, joint_count)
    may_go = np.ones(joint_count, dtype=bool)
    if keep is not None:
        kept = index_array(keep, "keep", ("N",))
        outside = first_outside(kept, joint_count)
        if outside is not None:
            raise MeshShapeError(f"keep at {outside[0]} is {kept[outside]}, but there are {joint_count} joints")
        may_go[kept] = False
    return _run(prepared, above, may_go, joints or 1, np.inf if max_error is None else max_error)


def _run(prepared: PreparedFit, parents: np.ndarray, may_go: np.ndarray, least: int, limit: float) -> ReducedJoints:
    order = choose_joints(prepared, parents, may_go, least, limit)
    removal, size = joint_removal(prepared, parents)
    gone = JointsGone(removal)
    # What the limit adds to the sum of squares.
    most = gone.misses[0] + (limit / 100.0) ** 2 * size
    for joint in order:
        if len(gone.used) <= least or gone.misses[-1] + removal.cost(joint) > most:
            break
        gone.remove(joint, may_go)
    gone.finish()
    return ReducedJoints(
        reduced_skin(prepared, removal),
        gone.used.astype(np.int32),
        np.array(gone.removed, dtype=np.int32),
        np.array(gone.heirs, dtype=np.int32),
        np.array(gone.counts, dtype=np.int32),
        100.0 * np.sqrt(np.array(gone.misses) / max(size, np.finfo(float).tiny)),
    )


def choose_joints(
    prepared: PreparedFit, parents: np.ndarray, may_go: np.ndarray, least: int, limit: float = np.inf
) -> list[int]:
    """The joints that go, in their order, by the exact cost of each over vertices that stand for all.

    Args:
        prepared: the mesh.
        parents: (J,) the joint above each, -1 for none.
        may_go: (J,) bool.
        least: joints to come down to.
        limit: see ``max_error`` of :func:`reduce_joints`.
    """
    removal, size = joint_removal(prepared, parents, sample=True)
    removal.improve()
    first = present = float(removal.skin.misses.sum())
    order: list[int] = []
    used = removal.used()
    while len(used) > least:
        candidates = used[may_go[used]]
        if not len(candidates):
            break
        joint = removal.cheapest(candidates)
        if present + removal.cost(joint) > first + (limit / 100.0) ** 2 * size:
            break
        order.append(joint)
        removal.remove(joint)
        removal.improve()
        used = removal.used()
        present = float(removal.skin.misses.sum())
    return order


class JointsGone:
    """The course of a removal.

    Attributes:
        used: joints in use.
        removed: joints that went.
        heirs: which got most of the weight of each; -1 where its vertices found better ones before it went.
        counts: joints in use before any went and after each.
        misses: what the poses miss at each of these counts.
    """

    def __init__(self, removal: JointRemoval) -> None:
        self._removal, self._all = removal, removal.used()
        self.removed: list[int] = []
        self.heirs: list[int] = []
        self.used = self._all
        self.counts: list[int] = []
        self.misses: list[float] = []
        self.record()

    def remove(self, joint: int, may_go: np.ndarray | None = None, exchanges: bool = True) -> None:
        """Take a joint away; where few are left and all may go, exchange others for joints that went before.

        Args:
            joint: the joint; the one that costs least where it went in an exchange.
            may_go: (J,) bool; None for all.
            exchanges: whether others may be exchanged.
        """
        movable = self.used if may_go is None else self.used[may_go[self.used]]
        if joint not in movable:
            joint = min(movable.tolist(), key=self._removal.cost)
        self.removed.append(joint)
        self.heirs.append(self._removal.remove(joint))
        if exchanges and len(self.used) - 1 <= MAX_EXCHANGED and (may_go is None or may_go[self._all].all()):
            self._exchange()
        self.record()

    def _exchange(self) -> None:
        """Exchange one joint for another as long as the poses miss less with it, but not less than with one more."""
        removal = self._removal
        removal.settle()
        while True:
            used = removal.used().tolist()
            trials = {}
            for out in used:
                for other in np.setdiff1d(self._all, used).tolist():
                    joints = [*(joint for joint in used if joint != out), other]
                    found, present = removal.misses_with(joints, MAX_DECIDING)
                    trials[out, other] = found / max(present, np.finfo(float).tiny)
            if not trials:
                return
            out, other = min(trials, key=lambda pair: (trials[pair], pair))
            joints = [*(joint for joint in used if joint != out), other]
            if trials[out, other] > MIN_EXCHANGE or not removal.move_with(joints, self.misses[-1]):
                return
            if other in self.removed:
                del self.heirs[self.removed.index(other)]
                self.removed.remove(other)
            self.removed.append(out)
            self.heirs.append(other)

    def finish(self) -> None:
        """Let the vertices of a mesh of moderate size take better solutions once more."""
        if MAX_DECIDING * DECIDING_INFLUENCES < self._removal.skin.joints.size <= MAX_IMPROVED:
            self._removal.improve()
            del self.counts[-1], self.misses[-1]
            self.record()

    def record(self) -> None:
        """Note what the removal has come to."""
        if self._removal.skin.joints.size <= MAX_DECIDING * DECIDING_INFLUENCES:
            self._removal.improve()
        else:
            self._removal.settle()
        self.used = self._removal.used()
        for joint in np.setdiff1d(self._all, [*self.used, *self.removed]).tolist():
            self.removed.append(joint)
            self.heirs.append(-1)
        self.counts.append(len(self.used))
        self.misses.append(float(self._removal.skin.misses.sum()))


def _read_parents(parents: Any, joint_count: int) -> np.ndarray:
    if parents is None:
        return np.full(joint_count, -1, dtype=np.int64)
    above = index_array(parents, "parents", (joint_count,)).astype(np.int64)
    wrong = np.flatnonzero((above < -1) | (above >= joint_count))
    if len(wrong):
        raise MeshShapeError(f"parents at {wrong[0]} is {above[wrong[0]]}, but there are {joint_count} joints")
    return np.asarray(above)


def joint_removal(prepared: PreparedFit, parents: np.ndarray, sample: bool = False) -> tuple[JointRemoval, float]:
    """The state before any joint goes, from the fitted skin; and the area of all planes over all poses.

    Args:
        prepared: the mesh.
        parents: (J,) the joint above each, -1 for none.
        sample: take vertices that stand for all where there are many.
    """
    fitted, _, _ = prepared.solve()
    fit, count, unit = prepared.fit, len(prepared.fixed), 1.0 / prepared.diagonal
    position = wp.array(np.ascontiguousarray(prepared.poses), dtype=wp.vec3, device=fit.device)
    gathered = prepared.planes.gather(slice(0, count), position, prepared.placed, prepared.to_planes)
    stiffness, goal = (array.numpy() for array in gathered)
    size = float(np.trace(stiffness, axis1=2, axis2=3).sum()) / (1.0 + 3.0 * SURFACE_REGULARISATION)
    transforms = prepared.transforms.copy()
    transforms[..., 3] *= unit
    offsets = None if prepared.start_offsets is None else prepared.start_offsets * unit
    vertex, factor = np.arange(count), np.ones(count)
    joints, weights = fitted.joints, fitted.weights.copy()
    if sample:
        vertex, factor = _representatives(fitted)
        most = min(DECIDING_INFLUENCES, joints.shape[1])
        joints, weights = blend_influences(joints, weights, vertex[:, None], np.ones((len(vertex), 1)), most)
    skin = VertexSkin(fitted.rest[vertex] * unit, joints, weights, np.zeros(len(vertex)))
    stiffness = stiffness[vertex] * factor[:, None, None, None]
    offsets = None if offsets is None else offsets[:, vertex]
    return JointRemoval(fit, stiffness, goal[:, vertex], transforms, offsets, skin, parents), size


def _representatives(skin: LinearSkin) -> tuple[np.ndarray, np.ndarray]:
    """Vertices that stand for all, and how many each stands for: evenly of those that the same joint moves most."""
    heaviest = skin.joints[np.arange(len(skin.joints)), skin.weights.argmax(axis=1)]
    groups = [np.flatnonzero(heaviest == joint) for joint in np.unique(heaviest)]
    # Small groups are kept, the others share the rest.
    share = min(1.0, MAX_DECIDING / len(heaviest))
    chosen, factor = [], []
    for group in groups:
        number = min(len(group), max(MIN_DECIDING, round(share * len(group))))
        picked = group[np.linspace(0, len(group) - 1, number).round().astype(int)]
        chosen.append(picked)
        factor.append(np.full(number, len(group) / number))
    vertex, weight = np.concatenate(chosen), np.concatenate(factor)
    order = np.argsort(vertex)
    return vertex[order], weight[order]


def reduced_skin(prepared: PreparedFit, removal: JointRemoval) -> LinearSkin:
    """The present skin in the caller's units and in single precision, weights in falling order."""
    skin = removal.skin
    order = np.argsort(-skin.weights, axis=1, kind="stable")
    joints, weights = (np.take_along_axis(array, order, axis=1) for array in (skin.joints, skin.weights))
    joints = np.where(weights > 0, joints, 0).astype(np.int32)
    return LinearSkin((skin.rest * prepared.diagonal).astype(np.float32), joints, normalised_weights(weights))
