"""Fewer joints for a simplified mesh, chosen by the error over its poses.

The error of a skin is that of Landreneau & Schaefer 2009, see :mod:`warpqem.skinning.fit_skin`. Joints go one by one,
each time the one whose vertices miss their poses least without it, after rest positions and weights are solved for
again: a greedy backward elimination with exact costs. Where joints that go from the leaves of the skeleton, the deepest
or the cheapest first, leave less distance, as it is measured on the surface, these go instead. See
:mod:`warpqem.skinning.joint_removal`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal, TypedDict

import numpy as np

from warpqem.arguments.array_input import first_outside, index_array
from warpqem.arguments.array_record import ArrayRecord
from warpqem.arguments.array_types import ArrayInput, Points
from warpqem.arguments.number_input import real_number, whole_number
from warpqem.errors import MeshShapeError, OptionError
from warpqem.frames.stream import ArrayFrames
from warpqem.measure.measured import measure_frames
from warpqem.pipeline.result import SimplifiedMesh
from warpqem.runtime.device import on_device
from warpqem.skinning.fit_skin import PreparedFit, prepare_fit
from warpqem.skinning.joint_course import JointsGone, choose_joints, joint_removal, reduced_skin
from warpqem.skinning.joint_removal import JointRemoval
from warpqem.skinning.leaf_order import next_leaf
from warpqem.skinning.linear_skin import LinearSkin, pose_skin

__all__ = ["JointGoals", "ReducedJoints", "RemovalPlan", "Way", "joint_steps", "reduce_in_steps", "reduce_joints"]

#: Which joint goes next: the one that costs least of all, of the deepest leaves of the skeleton, or of all its leaves.
Way = Literal["any", "deepest leaf", "leaf"]
# Skins along a removal that are kept, by their numbers of joints.
MAX_STEPS = 16
# Poses, and samples on each mesh in each of them, that decide between the ways.
MEASURED_POSES, MEASURED_SAMPLES = 16, 2000


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


class JointGoals(TypedDict, total=False):
    """How far joints are reduced: arguments of :func:`reduce_joints`."""

    joints: int | None
    max_error: float | None
    parents: ArrayInput | None
    keep: ArrayInput | None


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
    to_planes: bool | None = None,
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
    goals: JointGoals = {"joints": joints, "max_error": max_error, "parents": parents, "keep": keep}
    given = (points, faces, result, skin, transforms, start, influences, offsets, start_offsets, seams, to_planes)
    return reduce_in_steps(given, goals, device=device)[0][0]


@dataclass(frozen=True)
class RemovalPlan:
    """Which joints go.

    Attributes:
        order: what :func:`choose_joints` gives.
        way: which one goes next; ``order`` is for those that are chosen of all. None where every way is to be tried.
    """

    order: list[int]
    way: Way | None = None


@on_device
def reduce_in_steps(
    given: tuple[Any, ...], goals: JointGoals, *, device: str | None, plan: RemovalPlan | None = None
) -> tuple[list[ReducedJoints], RemovalPlan]:
    """The skins along a removal, of the fewest joints first, and the plan that it went by.

    Args:
        given: the arguments of :func:`warpqem.skinning.fit_skin.prepare_fit` but for the device.
        goals: arguments of :func:`reduce_joints`.
        device: Warp device.
        plan: the plan for a mesh like this one; None to make one.

    Raises:
        The errors of :func:`reduce_joints`.
    """
    joints, max_error, keep = goals.get("joints"), goals.get("max_error"), goals.get("keep")
    if joints is None and max_error is None:
        raise OptionError("one of joints and max_error is needed")
    if joints is not None:
        joints = whole_number(joints, "joints")
    if max_error is not None:
        max_error = real_number(max_error, "max_error", "a percentage of at least 0", lambda x: x >= 0)
    prepared = prepare_fit(*(*given, device))
    joint_count = prepared.transforms.shape[1]
    above = _read_parents(goals.get("parents"), joint_count)
    may_go = np.ones(joint_count, dtype=bool)
    if keep is not None:
        kept = index_array(keep, "keep", ("N",))
        outside = first_outside(kept, joint_count)
        if outside is not None:
            raise MeshShapeError(f"keep at {outside[0]} is {kept[outside]}, but there are {joint_count} joints")
        may_go[kept] = False
    least, limit = joints or 1, np.inf if max_error is None else max_error
    if plan is None:
        plan = RemovalPlan(choose_joints(prepared, above, may_go, least, limit))
    return joint_steps(prepared, above, may_go, least, limit, plan)


def joint_steps(
    prepared: PreparedFit, parents: np.ndarray, may_go: np.ndarray, least: int, limit: float, plan: RemovalPlan
) -> tuple[list[ReducedJoints], RemovalPlan]:
    """The skins along a removal of joints, of the fewest joints first, and the plan that they came from.

    Joints go by what they cost, or from the leaves of the skeleton where that is nearer to the input: the error that
    decides is one by planes, which have no end.

    Args:
        prepared: the mesh.
        parents: (J,) the joint above each, -1 for none.
        may_go: (J,) bool.
        least: joints to come down to.
        limit: see ``max_error`` of :func:`reduce_joints`.
        plan: which joints go.
    """

    def steps(way: Way) -> list[ReducedJoints]:
        chosen = iter(plan.order)

        def choose(removal: JointRemoval) -> int | None:
            if way == "any":
                return _next_joint(removal, chosen, may_go)
            return next_leaf(removal, parents, may_go, deepest=way == "deepest leaf")

        return _course(prepared, may_go, least, limit, joint_removal(prepared, parents), choose, way == "any")

    if plan.way is not None:
        return steps(plan.way), plan
    found: dict[Way, list[ReducedJoints]] = {"any": steps("any")}
    if (parents >= 0).any() and len(found["any"][0].removed):
        found |= {"deepest leaf": steps("deepest leaf"), "leaf": steps("leaf")}
    fewest = min(len(skins[0].used) for skins in found.values())
    ways = [way for way, skins in found.items() if len(skins[0].used) == fewest]
    best = ways[0]
    if len(ways) > 1:
        best = min(ways, key=lambda way: _measured(prepared, found[way][0].skin))
    return found[best], replace(plan, way=best)


def _next_joint(removal: JointRemoval, chosen: Iterator[int], may_go: np.ndarray) -> int | None:
    """The next of the joints that were chosen, or the one that costs least; None where none may go.

    They may have been chosen for a mesh of fewer vertices, which fewer joints moved.
    """
    used = removal.used()
    used = used[may_go[used]]
    joint = next((joint for joint in chosen if joint in used), None)
    return removal.cheapest(used) if joint is None and len(used) else joint


def _course(
    prepared: PreparedFit,
    may_go: np.ndarray,
    least: int,
    limit: float,
    start: tuple[JointRemoval, float],
    choose: Callable[[JointRemoval], int | None],
    exchanges: bool,
) -> list[ReducedJoints]:
    """The skins along one removal, of the fewest joints first; ``choose`` says which joint goes next."""
    removal, size = start
    gone = JointsGone(removal)
    # What the limit adds to the sum of squares.
    most = gone.misses[0] + (limit / 100.0) ** 2 * size
    kept = set(np.linspace(least, len(gone.used), MAX_STEPS).round().astype(int).tolist())
    steps = [_reduced(prepared, removal, gone, size)]
    while len(gone.used) > least:
        joint = choose(removal)
        if joint is None or gone.misses[-1] + removal.cost(joint) > most:
            break
        gone.remove(joint, may_go, exchanges=exchanges)
        if len(gone.used) in kept:
            steps.append(_reduced(prepared, removal, gone, size))
    gone.finish()
    last = _reduced(prepared, removal, gone, size)
    if len(steps[-1].used) == len(last.used):
        steps.pop()
    return [last, *steps[::-1]]


def _reduced(prepared: PreparedFit, removal: JointRemoval, gone: JointsGone, size: float) -> ReducedJoints:
    return ReducedJoints(
        reduced_skin(prepared, removal),
        gone.used.astype(np.int32),
        np.array(gone.removed, dtype=np.int32),
        np.array(gone.heirs, dtype=np.int32),
        np.array(gone.counts, dtype=np.int32),
        100.0 * np.sqrt(np.array(gone.misses) / max(size, np.finfo(float).tiny)),
    )


def _measured(prepared: PreparedFit, skin: LinearSkin) -> float:
    """RMS distance of a skin from the input over the poses, in % of the diagonal, the rest shape left aside."""
    count = len(prepared.poses)
    poses = np.unique(np.linspace(min(1, count - 1), count - 1, MEASURED_POSES).round().astype(int))
    offsets = None if prepared.start_offsets is None else prepared.start_offsets[poses]
    posed = pose_skin(skin, prepared.transforms[poses], offsets) / prepared.diagonal
    frames = [ArrayFrames(points.astype(np.float32)) for points in (prepared.poses[poses], posed)]
    faces, chosen, device = (prepared.faces, prepared.result_faces), range(len(poses)), prepared.fit.device
    done = measure_frames(frames[0], faces[0], frames[1], faces[1], chosen, samples=MEASURED_SAMPLES, device=device)
    return float(done.per_frame().rms.mean())


def _read_parents(parents: Any, joint_count: int) -> np.ndarray:
    if parents is None:
        return np.full(joint_count, -1, dtype=np.int64)
    above = index_array(parents, "parents", (joint_count,)).astype(np.int64)
    wrong = np.flatnonzero((above < -1) | (above >= joint_count))
    if len(wrong):
        raise MeshShapeError(f"parents at {wrong[0]} is {above[wrong[0]]}, but there are {joint_count} joints")
    higher = np.arange(joint_count)
    for _ in range(joint_count):
        higher = np.where(higher >= 0, above[higher], -1)
    if (higher >= 0).any():
        raise MeshShapeError(f"parents at {int((higher >= 0).argmax())} lead to no root, but in a loop")
    return np.asarray(above)
