"""The course of a removal of joints: which one goes next, and what has come of it so far."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.skinning.fit_problem import SURFACE_REGULARISATION
from warpqem.skinning.fit_skin import PreparedFit
from warpqem.skinning.joint_removal import JointRemoval, VertexSkin
from warpqem.skinning.linear_skin import LinearSkin, blend_influences, normalised_weights

__all__ = ["JointsGone", "choose_joints", "joint_removal", "reduced_skin"]

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
