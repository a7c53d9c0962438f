"""Transfer values from the input surface to the output: every output corner knows its point on the input.

The point is the nearest one in a reference pose, among the input faces that the output vertex stands for, on the
corner's side of the seams: values never leak from one UV island, or one side of a cut, to another.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpqem.arguments.array_input import is_empty, real_array
from warpqem.arguments.number_input import shown, whole_number
from warpqem.errors import MeshShapeError, OptionError
from warpqem.kernels import transfer as kernels
from warpqem.mesh.blending import blend
from warpqem.mesh.components import lowest_members
from warpqem.mesh.edges import edge_key
from warpqem.mesh.grouping import order_by, ranks
from warpqem.mesh.mesh_input import finite_points, is_proper, read_faces, read_points
from warpqem.mesh.seams import seam_ends
from warpqem.place.cluster_rows import group_rows, list_faces_at
from warpqem.runtime import new_arrays
from warpqem.runtime.device import on_device, resolve_device
from warpqem.runtime.launches import launch

if TYPE_CHECKING:
    from warpqem.pipeline.result import SimplifiedMesh

__all__ = [
    "SurfaceTransfer",
    "check_fit",
    "check_result",
    "joined_edges",
    "joined_faces",
    "matching_corners",
    "surface_transfer",
]


@dataclass(frozen=True)
class SurfaceTransfer:
    """Points on the input surface for W wedges: an output vertex has one wedge on each side of the seams through it.

    Attributes:
        corner_wedge: (N', 3) int32, the wedge of each output corner.
        vertex_wedge: (V',) int32, one wedge of each output vertex.
        wedge_face: (W,) int32, input face.
        wedge_weight: (W, 3) float32, barycentric, not negative, sum 1.
        wedge_vertex: (W, 3) int32, the input vertices of ``wedge_face``.
        face_map: (N',) int32, the input face that each output face goes on from.
    """

    corner_wedge: np.ndarray
    vertex_wedge: np.ndarray
    wedge_face: np.ndarray
    wedge_weight: np.ndarray
    wedge_vertex: np.ndarray
    face_map: np.ndarray

    def from_vertices(self, values: np.ndarray) -> np.ndarray:
        """Values at output vertices, (V', ...) float64, from values at input vertices (V, ...)."""
        return self.wedges_from_vertices(values)[self.vertex_wedge]

    def wedges_from_vertices(self, values: np.ndarray) -> np.ndarray:
        """Values at wedges, (W, ...) float64, from values at input vertices (V, ...)."""
        return blend(values[self.wedge_vertex], self.wedge_weight)

    def wedges_from_corners(self, values: np.ndarray) -> np.ndarray:
        """Values at wedges, (W, ...) float64, from values at input corners (N, 3, ...)."""
        return blend(values[self.wedge_face], self.wedge_weight)


@on_device
def surface_transfer(
    points: Any,
    faces: Any,
    result: SimplifiedMesh,
    *,
    reference_frame: int = 0,
    seams: Any = None,
    device: str | None = None,
) -> SurfaceTransfer:
    """Find the point on the input surface of every output corner.

    Args:
        points: (V, 3), the input's pose in the reference frame.
        faces: (N, 3), the input's faces, as given to :func:`warpqem.simplify`.
        result: what that returned.
        reference_frame: the frame of ``result.points`` that ``points`` is the pose of.
        seams: (S, 2) int, ends of the edges that values do not cross, as given to :func:`warpqem.simplify`.
        device: Warp device; None takes cuda:0 if present, else cpu.

    Raises:
        OptionError: ``result`` is none, has no such frame, or a seam names a vertex that does not exist.
        MeshShapeError, NonFinitePointError, FaceIndexError, DegenerateMeshError: see :mod:`warpqem.errors`; the first
            one also where the result is that of another mesh.
    """
    device = resolve_device(device)
    result = check_result(result)
    given = read_points(real_array(points, "points", ("V", 3)), "points")
    pose = finite_points(given)[0].astype(np.float64)
    faces = read_faces(faces, "faces", len(pose))
    check_fit(result, faces, len(pose))
    reference_frame = _checked_frame(reference_frame, len(result.points))
    ends = None if seams is None or is_empty(seams) else seam_ends(seams, len(pose))
    cluster = result.corner_clusters(faces)
    usable = (cluster >= 0).all(axis=1) & is_proper(faces)
    sheets = faces if result.repair is None else result.repair.sheets
    two_sided = result.repair is not None and bool(result.repair.is_double.any())
    vertex_count = result.points.shape[1]
    corner_cluster = np.where(usable[:, None], cluster, -1).ravel()
    start, face = list_faces_at(corner_cluster, vertex_count, device)
    owner = np.repeat(np.arange(vertex_count), np.diff(start))
    # Entry: one input face at one output vertex; (owner, face) ascends over the entries.
    entry_key = owner * len(faces) + face
    side = owner
    if two_sided or (ends is not None and len(ends)):
        first, second = joined_edges(faces, np.zeros((0, 2), dtype=np.int64) if ends is None else ends, sheets)
        side = _sides(first, second, sheets, cluster, owner, face)
    wedge = ranks(side, int(side.max()) + 1)
    order, wedge_start = group_rows(wedge, int(wedge.max()) + 1)
    wedge_owner = owner[order[wedge_start[:-1]]]
    placed = result.points[reference_frame][wedge_owner]
    wedge_face, wedge_weight = _wedge_sources(pose, faces, placed, wedge_start, face[order], device)
    corner_key = result.faces.astype(np.int64) * len(faces) + result.face_map[:, None]
    vertex_wedge = np.empty(vertex_count, dtype=np.int32)
    vertex_wedge[wedge_owner[::-1]] = np.arange(len(wedge_owner) - 1, -1, -1)
    return SurfaceTransfer(
        corner_wedge=wedge[np.searchsorted(entry_key, corner_key)],
        vertex_wedge=vertex_wedge,
        wedge_face=wedge_face,
        wedge_weight=wedge_weight,
        wedge_vertex=faces[wedge_face],
        face_map=result.face_map,
    )


def _checked_frame(frame: Any, frame_count: int) -> int:
    expected = f"a frame of the result, 0 to {frame_count - 1}"
    frame = whole_number(frame, "reference_frame", least=0, expected=expected)
    if frame >= frame_count:
        raise OptionError(f"reference_frame must be {expected}, got {frame}")
    return frame


def _wedge_sources(
    pose: np.ndarray, faces: np.ndarray, placed: np.ndarray, start: np.ndarray, face: np.ndarray, device: str
) -> tuple[np.ndarray, np.ndarray]:
    """The input face that is nearest to each wedge, (W,) int32, and where on it, (W, 3) float32 barycentric.

    Args:
        pose: (V, 3) float64, the input.
        faces: (N, 3) int32, its faces.
        placed: (W, 3), the output vertex of each wedge.
        start: (W + 1,) int32, where its faces begin.
        face: (E,) the faces of each wedge.
        device: Warp device.
    """
    # Nearness is that about the pose's middle, where float32 is finest.
    middle = (pose.min(axis=0) + pose.max(axis=0)) / 2
    source = new_arrays.empty(len(placed), dtype=wp.int32, device=device)
    weight = new_arrays.empty(len(placed), dtype=wp.vec3, device=device)
    launch(
        kernels.find_wedge_sources,
        dim=len(placed),
        inputs=[
            new_arrays.uploaded(start, dtype=wp.int32, device=device),
            new_arrays.uploaded(face, dtype=wp.int32, device=device),
            new_arrays.uploaded((placed - middle).astype(np.float32), dtype=wp.vec3, device=device),
            new_arrays.uploaded(faces.ravel(), dtype=wp.int32, device=device),
            new_arrays.uploaded((pose - middle).astype(np.float32), dtype=wp.vec3, device=device),
        ],
        outputs=[source, weight],
        device=device,
    )
    return source.numpy(), weight.numpy()


def check_result(result: Any) -> SimplifiedMesh:
    """The result with all arrays on the host; an OptionError for what is no result of simplifying."""
    # What simplifies is loaded where there is a result: comparing meshes needs none of it.
    from warpqem.pipeline.result import SimplifiedMesh

    if not isinstance(result, SimplifiedMesh):
        raise OptionError(f"result must be a SimplifiedMesh, as warpqem.simplify returns, got {shown(result)}")
    return result.numpy()


def check_fit(result: SimplifiedMesh, faces: np.ndarray, vertex_count: int) -> None:
    """Raise a MeshShapeError where a result is that of another mesh than this one with faces (N, 3)."""
    repaired = len(faces) if result.repair is None else len(result.repair.sheets)
    if (
        len(result.vertex_map) != vertex_count
        or result.face_map.max(initial=-1) >= len(faces)
        or repaired != len(faces)
    ):
        raise MeshShapeError(
            f"the result is that of a mesh with {len(result.vertex_map)} vertices and at least "
            f"{result.face_map.max(initial=-1) + 1} faces, this one has {vertex_count} and {len(faces)}"
        )
    # Every face that is left is one of the input with its vertices merged; a mirrored one starts at another corner.
    was = np.sort(result.corner_clusters(faces)[result.face_map], axis=1)
    other = np.flatnonzero((was != np.sort(result.faces, axis=1)).any(axis=1))
    if len(other):
        raise MeshShapeError(
            f"the result is that of a mesh with other faces: its face {other[0]} does not go on from face "
            f"{result.face_map[other[0]]} of this one ({len(other)} do not)"
        )


def _sides(
    first: np.ndarray, second: np.ndarray, sheets: np.ndarray, cluster: np.ndarray, owner: np.ndarray, face: np.ndarray
) -> np.ndarray:
    """Per entry, the lowest entry that it is joined to through pairs of faces that go on from each other."""
    # The entry of each corner of the input's faces, -1 for none.
    entry = np.full(cluster.shape, -1, dtype=np.int64)
    for k, at in enumerate(cluster.T):
        here = np.flatnonzero(at[face] == owner)
        entry[face[here], k] = here
    # Corners at the ends of the edge stand for the same vertices; a face has one entry for several at one of them. So
    # only those across from it may be at one besides.
    one, other = (entry.ravel()[corner] for corner in matching_corners(first, second, sheets))
    joined = np.flatnonzero((one >= 0) & (other >= 0) & (owner[one] == owner[other]))
    return lowest_members(len(owner), np.stack([one[joined], other[joined]], axis=1))


def matching_corners(first: np.ndarray, second: np.ndarray, sheets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners (3P,) of pairs of faces that share the edges from corners (P,) on: at its ends, and those across."""
    topology = sheets.ravel()
    (after, last), (other_after, other_last) = ((_turned(edge, 1), _turned(edge, 2)) for edge in (first, second))
    along = topology[first] == topology[second]
    at_first, at_after = np.where(along, second, other_after), np.where(along, other_after, second)
    return np.concatenate([first, after, last]), np.concatenate([at_first, at_after, other_last])


def _turned(corner: np.ndarray, by: int) -> np.ndarray:
    """The corner so many after each one in its face."""
    place = corner % 3
    return corner - place + (place + by) % 3


def joined_faces(
    faces: np.ndarray, seams: np.ndarray, sheets: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of faces that share an edge which is no seam.

    ``sheets`` (N, 3) are corners that only faces share which go on from each other, see
    :class:`warpqem.repair.mended_mesh.MeshRepair`, where the topology was mended.
    """
    first, second = joined_edges(faces, seams, sheets)
    return first // 3, second // 3


def joined_edges(
    faces: np.ndarray, seams: np.ndarray, sheets: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The same as pairs of corners, from 0 to 3N: the edges from these to the next of their faces are one."""
    sheets = faces if sheets is None else sheets
    half_edge = np.flatnonzero(np.repeat(is_proper(sheets), 3))
    # From 1 on, as no corner of some sheets is -1.
    tail, head = (corner.ravel()[half_edge] + 1 for corner in (sheets, sheets.take((1, 2, 0), axis=1)))
    count = int(sheets.max(initial=0)) + 2
    key = edge_key(tail, head, count)
    order = order_by(key, count * count)
    key, half_edge = key[order], half_edge[order]
    pair = np.flatnonzero(key[1:] == key[:-1])
    if len(seams):
        later = half_edge[pair + 1]
        pair = pair[~_on_seams(faces.ravel()[later], faces.take((1, 2, 0), axis=1).ravel()[later], seams)]
    return half_edge[pair], half_edge[pair + 1]


def _on_seams(tail: np.ndarray, head: np.ndarray, seams: np.ndarray) -> np.ndarray:
    """Which of some edges (E,) are among seams (S, 2): (E,) bool."""
    vertex_count = int(max(tail.max(initial=0), head.max(initial=0), seams.max())) + 1
    is_end = np.zeros(vertex_count, dtype=bool)
    is_end[seams] = True
    found = is_end[tail] & is_end[head]
    near = np.flatnonzero(found)
    key = edge_key(tail[near], head[near], vertex_count)
    wanted = np.sort(edge_key(seams[:, 0], seams[:, 1], vertex_count))
    found[near] = wanted[np.searchsorted(wanted[:-1], key)] == key
    return found
