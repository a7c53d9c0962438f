"""Find the mirror plane of a mesh, and the vertices and faces that are mirror images of each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from warpqem.arguments.array_input import finite_array
from warpqem.arguments.array_record import ArrayRecord
from warpqem.arguments.array_types import ArrayInput
from warpqem.arguments.number_input import real_number, shown
from warpqem.errors import MeshShapeError, OptionError
from warpqem.mesh.mesh_input import finite_points, is_proper, read_faces, read_points
from warpqem.repair.mended_topology import repair_topology

__all__ = ["AXES", "Mirror", "MirrorPlane", "find_mirror"]

# A vertex may be so far from the mirror image of its partner, in parts of the bounding-box diagonal.
TOLERANCE = 1e-4
# A normal may be so far from length one: as far as single precision rounds it.
NORMAL_TOLERANCE = 1e-5
# A direction that no regular mesh has many vertices across.
GENERIC = np.array([0.5345224838248488, 0.2672612419124244, 0.8017837257372732])
AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False, repr=False)
class MirrorPlane(ArrayRecord):
    """The plane ``normal.p = offset``.

    Attributes:
        normal: (3,) float64, of length one.
        offset: in the caller's units.
    """

    normal: np.ndarray
    offset: float

    def reflect(self, points: np.ndarray) -> np.ndarray:
        """The mirror images of points (..., 3), float64."""
        away = points.astype(np.float64) @ self.normal - self.offset
        reflected: np.ndarray = points - 2.0 * away[..., None] * self.normal
        return reflected


@dataclass(frozen=True, eq=False, repr=False)
class Mirror(ArrayRecord):
    """How a mesh maps to itself.

    Attributes:
        plane: the mirror plane.
        vertex: (V,) int64, the mirror image of each vertex, itself on the plane; -1 without a face.
        face: (N,) int64, the mirror image of each face.
        half: indices of the faces on one side.
    """

    plane: MirrorPlane
    vertex: np.ndarray
    face: np.ndarray
    half: np.ndarray


def find_mirror(points: ArrayInput, faces: ArrayInput, plane: str | MirrorPlane = "auto") -> Mirror:
    """Find how a mesh maps to itself under reflection.

    Where the topology has to be mended (:mod:`warpqem.repair`), the mirror is that of the mended mesh.

    Args:
        points: (V, 3), a symmetric pose.
        faces: (N, 3) vertex indices.
        plane: "x", "y" or "z" for a plane across that axis through the middle of the bounding box; "auto" for the first
            of them that the mesh is symmetric about; or the plane itself.

    Raises:
        OptionError: the mesh is not symmetric about the plane, a face lies across it, or it is no plane.
        MeshShapeError, NonFinitePointError, FaceIndexError, DegenerateMeshError: see :mod:`warpqem.errors`.

    Examples:
        Two triangles, each the image of the other:

        >>> import warpqem
        >>> mirror = warpqem.find_mirror([(-1, 0, 0), (0, -1, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 3), (1, 2, 3)], "x")
        >>> mirror.vertex.tolist(), mirror.face.tolist()
        ([2, 1, 0, 3], [1, 0])
    """
    pose = finite_points(read_points(points, "points"))
    if len(pose) != 1:
        raise MeshShapeError(f"points must be one pose (V, 3), got {len(pose)} frames")
    pose = pose[0].astype(np.float64)
    corner = read_faces(faces, "faces", len(pose)).astype(np.int64)
    pose, corner = _repaired(pose, corner)
    if isinstance(plane, str) and plane == "auto":
        reasons = []
        for axis in AXES:
            try:
                return _mirror(pose, corner, _axis_plane(pose, corner, axis))
            except OptionError as error:
                reasons.append(f"across {axis} {error}")
        raise OptionError(f"symmetry: the mesh has no mirror plane: {'; '.join(reasons)}")
    if isinstance(plane, str):
        if plane not in AXES:
            raise OptionError(f"symmetry {plane!r}: expected auto, x, y, z or a plane")
        plane = _axis_plane(pose, corner, plane)
    plane = _checked_plane(plane)
    try:
        return _mirror(pose, corner, plane)
    except OptionError as error:
        raise OptionError(f"symmetry: {error}") from None


def _repaired(pose: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The vertices and faces that simplifying would work on: repeats and mixed windings have no mirror image."""
    if not is_proper(faces).all():
        return pose, faces
    mended = repair_topology(faces.astype(np.int32), len(pose), "cpu")
    return (pose, faces) if mended is None else (pose[mended.vertex], mended.faces.astype(np.int64))


def _checked_plane(plane: Any) -> MirrorPlane:
    if not isinstance(plane, MirrorPlane):
        raise OptionError(f"symmetry must be auto, x, y, z or a MirrorPlane, got {shown(plane)}")
    normal = finite_array(plane.normal, "symmetry: normal of the plane", (3,)).astype(np.float64)
    if not abs(np.linalg.norm(normal) - 1.0) < NORMAL_TOLERANCE:
        raise OptionError(f"symmetry: normal of the plane {normal.tolist()} must have length 1")
    offset = real_number(plane.offset, "symmetry: offset of the plane", "a finite number", np.isfinite)
    return MirrorPlane(normal, offset)


def _axis_plane(pose: np.ndarray, faces: np.ndarray, axis: str) -> MirrorPlane:
    used = pose[np.unique(faces)][:, AXES.index(axis)]
    return MirrorPlane(np.eye(3)[AXES.index(axis)], float(used.min() + used.max()) / 2)


def _mirror(pose: np.ndarray, faces: np.ndarray, plane: MirrorPlane) -> Mirror:
    used = np.unique(faces)
    tolerance = TOLERANCE * float(np.linalg.norm(np.ptp(pose[used], axis=0)))
    vertex = np.full(len(pose), -1, dtype=np.int64)
    away = np.abs(pose[used] @ plane.normal - plane.offset)
    vertex[used] = used[_nearest(pose[used], plane.reflect(pose[used]), tolerance)]
    # Near the plane a vertex is its own image, whichever neighbour is as near.
    vertex[used[away <= tolerance / 2]] = used[away <= tolerance / 2]
    alone = used[vertex[vertex[used]] != used]
    if len(alone):
        raise OptionError(f"vertex {alone[0]} has no mirror image ({len(alone)} have none)")
    face = _mirrored_faces(faces, vertex)
    alone = np.flatnonzero(face < 0)
    if len(alone):
        raise OptionError(f"face {alone[0]} has no mirror image ({len(alone)} have none)")
    side = pose @ plane.normal - plane.offset
    side[vertex == np.arange(len(pose))] = 0.0
    lowest, highest = side[faces].min(axis=1), side[faces].max(axis=1)
    across = np.flatnonzero(((lowest < 0) & (highest > 0)) | ((lowest == 0) & (highest == 0)))
    if len(across):
        raise OptionError(f"face {across[0]} lies across the plane ({len(across)} do)")
    return Mirror(plane, vertex, face, np.flatnonzero(highest > 0))


def _nearest(points: np.ndarray, wanted: np.ndarray, tolerance: float) -> np.ndarray:
    """Index of the nearest of ``points`` (M, 3) to each of ``wanted`` within the tolerance, the first of equal ones.

    Where there is none, the last point; the caller sees that it is not a mutual match.
    """
    along = points @ GENERIC
    order = np.argsort(along, kind="stable")
    target = wanted @ GENERIC
    first = np.searchsorted(along[order], target - tolerance)
    last = np.searchsorted(along[order], target + tolerance, side="right")
    best, distance = np.full(len(wanted), len(points) - 1), np.full(len(wanted), tolerance)
    for step in range(int((last - first).max(initial=0))):
        row = np.flatnonzero(first + step < last)
        candidate = order[first[row] + step]
        length = np.linalg.norm(points[candidate] - wanted[row], axis=1)
        nearer = (length < distance[row]) | ((length == distance[row]) & (candidate < best[row]))
        best[row[nearer]], distance[row[nearer]] = candidate[nearer], length[nearer]
    return best


def _mirrored_faces(faces: np.ndarray, vertex: np.ndarray) -> np.ndarray:
    """The face over the mirror images of each face's vertices, turned over, (N,) int64; -1 for none."""

    def canonical(corners: np.ndarray) -> np.ndarray:
        turn = corners.argmin(axis=1)
        return np.stack(
            [np.take_along_axis(corners, ((turn + k) % 3)[:, None], axis=1)[:, 0] for k in range(3)], axis=1
        )

    own, image = canonical(faces), canonical(vertex[faces][:, ::-1])
    count = len(vertex)
    own_key = (own[:, 0] * count + own[:, 1]) * count + own[:, 2]
    image_key = (image[:, 0] * count + image[:, 1]) * count + image[:, 2]
    order = np.argsort(own_key, kind="stable")
    place = np.minimum(np.searchsorted(own_key[order], image_key), len(order) - 1)
    found = own_key[order][place] == image_key
    return np.where(found, order[place], -1)
