"""Fit rest positions and skin weights of a simplified mesh to its poses (Landreneau & Schaefer 2009).

A skin whose weights are only blended from the input's leaves the simplified surface where the poses of a rest mesh take
it. Here every output vertex gets the rest position and the weights that together take it nearest to where placement
put it in the poses, as its cluster's quadrics measure it; see :mod:`warpqem.kernels.skin_fit`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warpqem.arguments.array_input import is_empty
from warpqem.arguments.array_record import ArrayRecord
from warpqem.arguments.array_types import ArrayInput, Points
from warpqem.arguments.number_input import flag, shown, whole_number
from warpqem.errors import MeshShapeError, OptionError
from warpqem.mesh.mesh_input import read_faces
from warpqem.pipeline.result import SimplifiedMesh
from warpqem.pipeline.surface_transfer import check_fit, check_result, surface_transfer
from warpqem.runtime.device import on_device, resolve_device
from warpqem.skinning.fit_problem import CandidateRows, ClusterPlanes, SkinFit
from warpqem.skinning.linear_skin import (
    LinearSkin,
    blend_influences,
    blend_skin,
    largest_influences,
    normalised_weights,
    pose_skin,
    read_offsets,
    read_poses,
    read_transforms,
)

__all__ = ["FittedSkin", "fit_skin"]

# Joints that a vertex may choose from: those with the largest sum of weights over its cluster. The dense solves grow
# with the cube of this, and a joint beyond it has next to no weight there.
MAX_CANDIDATES = 16
# A pose may differ so much from what skin and transforms give, in parts of the diagonal: weights of eight bits sum to
# one as badly.
POSE_TOLERANCE = 1e-2


@dataclass(frozen=True, eq=False, repr=False)
class FittedSkin(ArrayRecord):
    """What :func:`fit_skin` returns.

    Attributes:
        skin: the skin of the output vertices: rest (C, 3) float32, joints (C, K) int32, weights (C, K) float32 in
            order of falling weight, sum one.
        before: RMS distance over poses of the vertices from their planes with the weights blended from the input's, in
            % of the rest shape's diagonal, beyond that of the free placement.
        after: the same of the fitted skin.
    """

    skin: LinearSkin
    before: float
    after: float


@on_device
def fit_skin(
    points: Points,
    faces: ArrayInput,
    result: SimplifiedMesh,
    skin: LinearSkin,
    transforms: ArrayInput,
    *,
    start: LinearSkin | None = None,
    influences: int | None = None,
    offsets: ArrayInput | None = None,
    start_offsets: ArrayInput | None = None,
    seams: ArrayInput | None = None,
    to_planes: bool | None = None,
    device: str | None = None,
) -> FittedSkin:
    """Fit the skin of a simplified mesh over P poses, the first of them the rest shape.

    The more the poses have in common with those that the skin will see, the better; 16 to 32 that are far apart do.

    Args:
        points: (P, V, 3), the input in its poses, as given to :func:`warpqem.simplify`.
        faces: (N, 3), the input's faces.
        result: what that returned.
        skin: the input's skin.
        transforms: (P, J, 3, 4), see :func:`pose_skin`; identities in the first pose.
        start: the skin of the output vertices to start from; None blends the input's at the nearest points of the rest
            shape.
        influences: joints that move an output vertex at most; None for as many as in the input's skin.
        offsets: (P, V, 3), offsets of blend shapes in each pose, added to the rest points; None for none.
        start_offsets: (P, C, 3), the same for the output vertices; needed with ``offsets`` and ``start``.
        seams: (S, 2) vertex pairs, as given to :func:`warpqem.simplify`.
        to_planes: aim at the least of each vertex's quadrics, as the skin keeps it on the material by itself. False: at
            where ``result`` has it, which is better after a refit. None: the one that is better for ``result``.
        device: Warp device; None takes cuda:0 if present, else cpu.

    Raises:
        MeshShapeError: shapes do not go together, or the poses are not what skin and transforms give.
        OptionError: ``influences`` is below 1.
    """
    prepared = prepare_fit(
        points, faces, result, skin, transforms, start, influences, offsets, start_offsets, seams, to_planes, device
    )
    fitted, before, after = prepared.solve()
    return prepared.rounded(fitted, before, after)


@dataclass(frozen=True)
class PreparedFit:
    """A simplified mesh whose skin is ready to be fitted, on a mesh of unit diagonal.

    Attributes:
        skin: the input's skin, of the vertices that were simplified.
        start: the skin of the output vertices to start from.
        fixed: (C,) bool, output vertices that keep the skin of an input vertex.
        member: (C,) int64, which one; -1 for the others.
        rows: candidate joints of the others.
        transforms: (P, J, 3, 4) float64, with translations in the caller's units.
        start_offsets: (P, C, 3) offsets of blend shapes in the caller's units, or None.
        fit: the solves.
        planes: those of the clusters.
        poses: (P, V, 3) float32, the input in its poses.
        placed: (P, C, 3), where placement put the vertices.
        faces: (N, 3) int32, the faces that were simplified.
        result_faces: (N', 3) int32, those of the simplified mesh.
        influences: joints that move an output vertex at most.
        diagonal: that of the rest shape's bounding box, in the caller's units.
        to_planes: aim at the least of the quadrics.
    """

    skin: LinearSkin
    start: LinearSkin
    fixed: np.ndarray
    member: np.ndarray
    rows: CandidateRows
    transforms: np.ndarray
    start_offsets: np.ndarray | None
    fit: SkinFit
    planes: ClusterPlanes
    poses: np.ndarray
    placed: np.ndarray
    faces: np.ndarray
    result_faces: np.ndarray
    influences: int
    diagonal: float
    to_planes: bool

    def solve(self) -> tuple[LinearSkin, float, float]:
        """The fitted skin in double precision, and ``before`` and ``after`` of :class:`FittedSkin`."""
        rest, weight, before, after, size = self.fit.solve(self.planes, self.poses, self.influences, self.to_planes)
        fixed, start, skin, most = self.fixed, self.start, self.skin, self.influences
        row = np.repeat(np.arange(len(fixed)), np.diff(self.rows.start))
        joints, weights = largest_influences(row, self.rows.joint, weight, len(fixed), most)
        rest *= self.diagonal
        # What E measures may only go down: a vertex whose limit on influences cost more than the fit gave stays.
        kept = (after > before) & ~fixed
        for rows_kept, source, index in ((kept, start, np.flatnonzero(kept)), (fixed, skin, self.member[fixed])):
            rest[rows_kept] = source.rest[index]
            joints[rows_kept], weights[rows_kept] = _cut(source, index, most)
        after = np.where(kept, before, after)
        part = [100.0 * float(np.sqrt(misses.sum() / max(size, 1e-300))) for misses in (before, after)]
        return LinearSkin(rest, joints, weights), part[0], part[1]

    def rounded(self, skin: LinearSkin, before: float, after: float) -> FittedSkin:
        """A skin in single precision with its figures."""
        weights = normalised_weights(skin.weights)
        return FittedSkin(LinearSkin(skin.rest.astype(np.float32), skin.joints, weights), before, after)


def prepare_fit(
    points: Any,
    faces: Any,
    result: Any,
    skin: Any,
    transforms: Any,
    start: Any,
    influences: Any,
    offsets: Any,
    start_offsets: Any,
    seams: Any,
    to_planes: Any,
    device: str | None,
) -> PreparedFit:
    """Check the arguments of :func:`fit_skin`, which see, and prepare the solves."""
    device, result = resolve_device(device), check_result(result)
    given = _checked(points, faces, result, skin, transforms, start, influences, offsets, start_offsets)
    to_planes = not result.refitted if to_planes is None else flag(to_planes, "to_planes")
    start, start_offsets = given.start, given.start_offsets
    if start is None:
        start, start_offsets = _blended_start(given, result, seams, device)
    if len(start.rest) != result.points.shape[1]:
        raise MeshShapeError(f"start has {len(start.rest)} points, the result {result.points.shape[1]}")
    start = replace(start.checked(given.transforms.shape[1]), rest=result.points[0].astype(np.float64))
    corner, poses, skin, most = given.faces, given.poses, given.skin, given.most
    if result.repair is not None and result.copy_map is not None:
        # On the vertices and faces that were simplified.
        repair = result.repair
        corner = repair.faces
        seams = None if seams is None or is_empty(seams) else repair.edges(seams, corner)
        poses, skin = poses[:, repair.vertex], skin.rows(repair.vertex)
        result = replace(result, vertex_map=result.copy_map)
    fixed, member = _fixed(poses, result, (skin.weights > 0).sum(axis=1) <= most)
    rows = _candidates(skin, start, result.vertex_map, fixed)
    # On a mesh of unit diagonal, which the thresholds are made for.
    unit = 1.0 / given.diagonal
    placed = result.points * unit
    return PreparedFit(
        skin=skin,
        start=start,
        fixed=fixed,
        member=member,
        rows=rows,
        transforms=given.transforms,
        start_offsets=start_offsets,
        fit=SkinFit(given.transforms, rows, start.rest * unit, placed, start_offsets, unit, device),
        planes=ClusterPlanes(corner, result.vertex_map, len(fixed), seams, device),
        poses=poses * np.float32(unit),
        placed=placed,
        faces=corner,
        result_faces=result.faces,
        influences=most,
        diagonal=given.diagonal,
        to_planes=to_planes,
    )


@dataclass(frozen=True)
class _Given:
    """What :func:`fit_skin` got, checked.

    Attributes:
        poses: (P, V, 3) float32 or float64.
        faces: (N, 3) int32.
        skin: the input's skin.
        transforms: (P, J, 3, 4) float64.
        start: the skin to start from, if any.
        offsets: (P, V, 3), if any.
        start_offsets: (P, C, 3), if any.
        most: joints that move an output vertex at most.
        diagonal: that of the rest shape's bounding box.
    """

    poses: np.ndarray
    faces: np.ndarray
    skin: LinearSkin
    transforms: np.ndarray
    start: LinearSkin | None
    offsets: np.ndarray | None
    start_offsets: np.ndarray | None
    most: int
    diagonal: float


def _checked(
    points: Any,
    faces: Any,
    result: SimplifiedMesh,
    skin: Any,
    transforms: Any,
    start: Any,
    influences: Any,
    offsets: Any,
    start_offsets: Any,
) -> _Given:
    poses = read_poses(points)
    corner = read_faces(faces, "faces", poses.shape[1])
    matrices = read_transforms(transforms, len(poses))
    check_fit(result, corner, poses.shape[1])
    if result.points.shape[0] != len(poses):
        raise MeshShapeError(f"the result has {result.points.shape[0]} frames, there are {len(poses)} poses")
    if influences is not None:
        influences = whole_number(influences, "influences", expected="at least 1")
    offsets = read_offsets(offsets, "offsets", len(poses), poses.shape[1])
    start_offsets = read_offsets(start_offsets, "start_offsets", len(poses), result.points.shape[1])
    if start is not None and offsets is not None and start_offsets is None:
        raise OptionError("start_offsets are needed with offsets and start")
    for given, what in ((skin, "skin"), (start, "start")):
        if not (isinstance(given, LinearSkin) or (given is None and what == "start")):
            raise OptionError(f"{what} must be a LinearSkin, got {shown(given)}")
    skin = skin.checked(matrices.shape[1])
    diagonal = float(np.linalg.norm(np.ptp(poses[0].astype(np.float64), axis=0)))
    _check_poses(poses, result.vertex_map >= 0, skin, matrices, offsets, diagonal)
    most = skin.joints.shape[1] if influences is None else influences
    return _Given(poses, corner, skin, matrices, start, offsets, start_offsets, most, diagonal)


def _blended_start(
    given: _Given, result: SimplifiedMesh, seams: Any, device: str
) -> tuple[LinearSkin, np.ndarray | None]:
    """The input's skin, blended at the nearest points of the rest shape, and the offsets (P, C, 3) there."""
    transfer = surface_transfer(given.poses[0], given.faces, result, seams=seams, device=device)
    index = transfer.wedge_vertex[transfer.vertex_wedge]
    share = transfer.wedge_weight[transfer.vertex_wedge]
    start = blend_skin(given.skin, index, share, given.most)
    if given.offsets is None:
        return start, given.start_offsets
    return start, np.stack([transfer.from_vertices(offset) for offset in given.offsets])


def _cut(skin: LinearSkin, index: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """The largest influences of some vertices of a skin."""
    return blend_influences(skin.joints, skin.weights, index[:, None], np.ones((len(index), 1)), most)


def _check_poses(
    poses: np.ndarray,
    used: np.ndarray,
    skin: LinearSkin,
    transforms: np.ndarray,
    offsets: np.ndarray | None,
    diagonal: float,
) -> None:
    """Check that the poses are those of the skin."""
    if len(skin.rest) != poses.shape[1]:
        raise MeshShapeError(f"the skin has {len(skin.rest)} points, the mesh {poses.shape[1]}")
    for index, pose in enumerate(poses):
        offset = None if offsets is None else offsets[index : index + 1]
        away = np.linalg.norm(pose_skin(skin, transforms[index : index + 1], offset)[0] - pose, axis=1) * used
        if not away.max(initial=0.0) <= POSE_TOLERANCE * diagonal:
            vertex = int(np.nanargmax(away))
            raise MeshShapeError(
                f"pose {index} is not what skin and transforms give: vertex {vertex} is {away[vertex]:g} away"
            )


def _fixed(poses: np.ndarray, result: SimplifiedMesh, keeps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Output vertices that are an input vertex in all poses, (C,) bool, and which one, (C,) int, -1 for the others.

    These are alone in their cluster, locked, or placed at an endpoint: they keep the skin of that vertex, if it has no
    more influences than may be: ``keeps`` (V,) bool.
    """
    member = np.full(result.points.shape[1], -1, dtype=np.int64)
    used = np.flatnonzero((result.vertex_map >= 0) & keeps)
    for pose, placed in zip(poses, result.points, strict=True):
        used = used[(pose[used] == placed[result.vertex_map[used]]).all(axis=1)]
    member[result.vertex_map[used[::-1]]] = used[::-1]
    return member >= 0, member


def _candidates(skin: LinearSkin, start: LinearSkin, vertex_map: np.ndarray, fixed: np.ndarray) -> CandidateRows:
    """Joints of each cluster's input vertices and of where it starts, those with the most weight; none where fixed."""
    used = np.flatnonzero(vertex_map >= 0)
    vertex_count, width = start.joints.shape
    row = np.concatenate([np.repeat(vertex_map[used], skin.joints.shape[1]), np.repeat(np.arange(vertex_count), width)])
    joint = np.concatenate([skin.joints[used].ravel(), start.joints.ravel()])
    cluster_weight, start_weight = skin.weights[used].ravel(), start.weights.ravel()
    none = np.zeros(len(cluster_weight))
    # A joint that a vertex starts with comes before any other.
    largest = 1.0 + cluster_weight.sum()
    rank = np.concatenate([cluster_weight, np.where(start_weight > 0, largest + start_weight, 0.0)])
    own = np.concatenate([none, start_weight])
    keep = (rank > 0) & ~fixed[row]
    key, entry = np.unique(row[keep] * (int(joint.max(initial=0)) + 1) + joint[keep], return_inverse=True)
    total, weight = (np.bincount(entry.ravel(), weights=array[keep], minlength=len(key)) for array in (rank, own))
    row, joint = np.divmod(key, int(joint.max(initial=0)) + 1)
    order = np.lexsort((joint, -total, row))
    row = row[order]
    first = np.arange(len(row)) - np.searchsorted(row, row) < MAX_CANDIDATES
    row, order = row[first], order[first]
    count = np.zeros(vertex_count + 1, dtype=np.int32)
    np.cumsum(np.bincount(row, minlength=vertex_count), out=count[1:])
    return CandidateRows(count, joint[order].astype(np.int32), weight[order])
