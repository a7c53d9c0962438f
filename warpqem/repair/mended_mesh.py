"""Meshes with a mended topology, what of the input each part of them is, and results in terms of the input."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from warpqem.arguments.array_input import is_empty
from warpqem.arguments.array_record import ArrayRecord
from warpqem.costs.attributes import checked_fields
from warpqem.costs.weights import lock_mask, read_quadric_scale, read_weights
from warpqem.frames.device_source import DeviceFrames
from warpqem.frames.stream import FrameSource, held_bytes
from warpqem.mesh.edges import edge_key
from warpqem.mesh.mesh_input import MeshInput, is_proper
from warpqem.mesh.seams import read_seams, seam_ends
from warpqem.repair.mended_topology import TopologyFindings, repair_topology
from warpqem.runtime.device import resolve_device

if TYPE_CHECKING:
    from warpqem.decimation.decimate import DecimatedMesh
    from warpqem.options import MeshOptions

__all__ = ["MeshRepair", "face_repair", "faces_for", "repaired_mesh", "repaired_options"]


@dataclass(frozen=True, eq=False, repr=False)
class MeshRepair(ArrayRecord):
    """How the V' vertices and M faces of a mesh with a mended topology come from the caller's V and N.

    Attributes:
        vertex: (V',) int32, the caller's vertex that each vertex is: the V themselves, then copies of those where more
            than one sheet of the surface meets.
        sheets: (N, 3) int32, corners of the caller's faces such that faces which go on from each other share vertices,
            and no others do: numbers below V' for vertices, from V' on for those on the back of a sheet; -1 at faces
            that were left out.
        vertex_count: the caller's vertices V.
        face_index: (M,) int32, the caller's face that each face is.
        back: (M,) int32, the caller's face on the other side of each; -1 where there is none.
        turned: (M,) bool, faces whose corners are in the reverse order.
        given_faces: (K, 3) int32, the caller's faces, but those that use a vertex twice.
        findings: what was mended.
    """

    vertex: np.ndarray
    sheets: np.ndarray
    vertex_count: int
    face_index: np.ndarray
    back: np.ndarray
    turned: np.ndarray
    given_faces: np.ndarray
    findings: TopologyFindings

    @cached_property
    def is_double(self) -> np.ndarray:
        """(M,) bool, faces with a back."""
        return np.asarray(self.back >= 0)

    @cached_property
    def is_turned(self) -> np.ndarray:
        """(N,) bool, those of the caller's faces whose corners are in the reverse order in the mended mesh."""
        found = np.zeros(len(self.sheets), dtype=bool)
        found[self.face_index[self.turned]] = True
        return found

    @property
    def faces(self) -> np.ndarray:
        """(M, 3) int32, the corners of each face."""
        own = self.sheets[self.face_index]
        return np.where(self.turned[:, None], own[:, ::-1], own)

    def corner_clusters(self, copy_map: np.ndarray) -> np.ndarray:
        """(N, 3) int32, the output vertex of each of the caller's corners, -1 at faces that were left out.

        ``copy_map`` (V',) is that of each vertex.
        """
        return np.where(self.sheets >= 0, copy_map[self.sheets % len(self.vertex)], np.int32(-1))

    def vertex_clusters(self, copy_map: np.ndarray) -> np.ndarray:
        """(V,) int32, the output vertex of each of the caller's vertices: that of its first copy that has one."""
        clusters = np.full(self.vertex_count, -1, dtype=np.int32)
        present = np.flatnonzero(copy_map >= 0)[::-1]
        clusters[self.vertex[present]] = copy_map[present]
        return clusters

    def with_backs(self, faces: np.ndarray, face_map: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Output faces (N', 3) that go on from ``face_map`` (N',) of the M faces, and those on their backs after them.

        Returns:
            The faces, and the caller's face that each goes on from.
        """
        double = self.is_double[face_map]
        joined = np.concatenate([faces, faces[double][:, ::-1]])
        return np.ascontiguousarray(joined), np.concatenate([self.face_index[face_map], self.back[face_map[double]]])

    def count_with_backs(self, face_map: np.ndarray) -> int:
        """How many faces these are."""
        return len(face_map) + int(self.is_double[face_map].sum())

    def back_corners(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners of the caller's faces, 0 to 3N, at the same vertex on the front and on the back: two (K,) int."""
        front, back = self.face_index[self.is_double], self.back[self.is_double]
        match = self.sheets[front][:, :, None] == self.sheets[back][:, None, :] - len(self.vertex)
        corners = np.arange(3) + 3 * front[:, None].astype(np.int64)
        return corners.ravel(), (3 * back[:, None].astype(np.int64) + match.argmax(axis=2)).ravel()

    def edges(self, pairs: Any, faces: np.ndarray) -> np.ndarray:
        """The edges (E, 2) of mended faces (M, 3) between the copies of pairs (S, 2) of the caller's vertices."""
        ends = seam_ends(pairs, self.vertex_count)
        tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
        key = edge_key(self.vertex[tail], self.vertex[head], self.vertex_count)
        chosen = np.isin(key, edge_key(ends[:, 0], ends[:, 1], self.vertex_count))
        found = np.stack([np.minimum(tail, head), np.maximum(tail, head)], axis=1)[chosen]
        return np.unique(found, axis=0).reshape(-1, 2)


class SplitFrames:
    """The frames of a source with some vertices more than once.

    Args:
        source: the frames.
        vertex: (V',) which of its vertices each vertex is.
    """

    def __init__(self, source: FrameSource, vertex: np.ndarray) -> None:
        self._source, self._vertex = source, vertex
        self.frame_count, self.vertex_count, self.dtype = source.frame_count, len(vertex), source.dtype

    @property
    def held_bytes(self) -> int:
        """What the source keeps in memory."""
        return held_bytes(self._source)

    def read(self, frames: slice) -> np.ndarray:
        """Consecutive frames."""
        return self._source.read(frames)[:, self._vertex]


def _split(source: FrameSource, vertex: np.ndarray) -> FrameSource:
    return source.split(vertex) if isinstance(source, DeviceFrames) else SplitFrames(source, vertex)


def repaired_mesh(mesh: MeshInput, device: str) -> MeshInput:
    """The same mesh where its topology is fit for decimation, else one with the topology mended, and its ``repair``."""
    if mesh.repair is not None or mesh.is_clean:
        return mesh
    repair = _repair(mesh.faces, mesh.face_index, mesh.input_face_count, mesh.vertex_count, device)
    if repair is None:
        return mesh
    faces, used = np.ascontiguousarray(repair.faces), np.zeros(len(repair.vertex), dtype=bool)
    used[faces] = True
    is_split = len(repair.vertex) > mesh.vertex_count
    source = _split(mesh.source, repair.vertex) if is_split else mesh.source
    return MeshInput(source, faces, repair.face_index, mesh.input_face_count, used, repair=repair)


def face_repair(faces: np.ndarray, vertex_count: int, device: str = "cpu") -> MeshRepair | None:
    """What simplifying is going to mend of faces (N, 3) int32 that may name a vertex twice; None for nothing."""
    proper = np.flatnonzero(is_proper(faces)).astype(np.int32)
    if not len(proper):
        return None
    return _repair(np.ascontiguousarray(faces[proper]), proper, len(faces), vertex_count, resolve_device(device))


def _repair(
    faces: np.ndarray, face_index: np.ndarray, input_face_count: int, vertex_count: int, device: str
) -> MeshRepair | None:
    mended = repair_topology(faces, vertex_count, device)
    if mended is None:
        return None
    sheets = np.full((input_face_count, 3), -1, dtype=np.int32)
    own = np.where(mended.turned[:, None], mended.faces[:, ::-1], mended.faces)
    sheets[face_index[mended.kept]] = own
    double = np.flatnonzero(mended.back >= 0)
    back = mended.back[double]
    # The corner of the front at the same vertex of the input, for each corner of the back.
    match = mended.vertex[own[double]][:, None, :] == faces[back][:, :, None]
    sheets[face_index[back]] = len(mended.vertex) + np.take_along_axis(own[double], match.argmax(axis=2), axis=1)
    return MeshRepair(
        vertex=mended.vertex,
        sheets=sheets,
        vertex_count=vertex_count,
        face_index=face_index[mended.kept],
        back=np.where(mended.back >= 0, face_index[mended.back], np.int32(-1)),
        turned=mended.turned,
        given_faces=faces,
        findings=mended.findings,
    )


def repaired_options(options: MeshOptions, given: MeshInput, mended: MeshInput) -> MeshOptions:
    """Options that :func:`warpqem.simplify` got for ``given``, checked, for the mesh that was made of it.

    Raises:
        WarpqemError: an array does not fit the given mesh.
    """
    repair = mended.repair
    if repair is None or given.repair is not None:
        return options
    factors, locks = read_weights(options.vertex_weights, given)
    locks |= lock_mask(options.locked, given.vertex_count)
    seams = options.seams
    if seams is not None and not is_empty(seams):
        read_seams(seams, given.faces, given.vertex_count)
        seams = repair.edges(seams, mended.faces)
    goal = options.goal(len(given.faces))
    return replace(
        options,
        # The share is one of all faces.
        ratio=None,
        target_faces=goal.target_faces or None,
        vertex_weights=None if options.vertex_weights is None else factors[repair.vertex],
        locked=locks[repair.vertex],
        quadric_scale=None
        if options.quadric_scale is None
        else read_quadric_scale(options.quadric_scale, given)[repair.vertex],
        seams=seams,
        attributes=_repaired_fields(options, given, repair),
    )


def _repaired_fields(options: MeshOptions, given: MeshInput, repair: MeshRepair) -> tuple[Any, ...]:
    fields = []
    for field, values in zip(options.attributes, checked_fields(options.attributes, given)[0], strict=True):
        if values.ndim == 3:
            values = values.copy()
            rows = repair.face_index[repair.turned]
            values[rows] = values[rows][:, ::-1]
            fields.append(replace(field, values=values))
        else:
            fields.append(replace(field, values=values[repair.vertex]))
    return tuple(fields)


def faces_for(ordered: DecimatedMesh, mesh: MeshInput, target: int) -> int:
    """How many of the M faces to order down to, so that these and their backs are ``target`` at most.

    Args:
        ordered: the mesh ordered down further than that, or as far as it goes.
        mesh: what was ordered.
        target: faces asked for.
    """
    # Whoever has ordered a mesh has loaded it; those who only look at a topology need not.
    import warp as wp

    from warpqem.decimation.faces_left import numbers_left

    assert mesh.repair is not None
    log, drops = ordered.log, ordered.drops
    index = np.arange(len(log))
    corner_vertex = wp.array(mesh.faces.ravel(), dtype=wp.int32, device=ordered.position.device)
    event = np.argsort(np.concatenate([2 * index + 1, 2 * drops.collapse_count]), kind="stable")

    def left(count: int) -> np.ndarray:
        collapsed = int((event[:count] < len(log)).sum())
        collapses = log.head(collapsed)
        root, dropped = collapses.roots(len(ordered.root)), drops.head(count - collapsed)
        return numbers_left(corner_vertex, collapses, root, dropped)

    low, high = 0, len(event)
    while low < high:
        middle = (low + high) // 2
        if mesh.repair.count_with_backs(left(middle)) <= target:
            high = middle
        else:
            low = middle + 1
    return len(left(low))
