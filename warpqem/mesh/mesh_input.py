"""Take points and faces from the caller, check them, and find the mesh's unit scale."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import warp as wp

from warpqem.arguments.array_input import (
    FLOAT32_MAX,
    INDEX_LIMIT,
    first_beyond,
    first_outside,
    index_array,
    read_warp_array,
    real_array,
)
from warpqem.errors import DegenerateMeshError, FaceIndexError, MeshShapeError, OptionError
from warpqem.frames.blocks import frame_blocks, pack_frames
from warpqem.frames.checked_frames import BrokenPoints, check_source
from warpqem.frames.device_frames import HeldFrames, device_blocks, to_device
from warpqem.frames.device_source import DeviceFrames
from warpqem.frames.stream import ArrayFrames, FrameSource, counted_frames
from warpqem.mesh.first_reading import FirstReading, about_origin
from warpqem.mesh.rounding import rounding_of
from warpqem.mesh.used_vertices import TopologyLook, used_vertices
from warpqem.runtime.device import array_device, device_traits

if TYPE_CHECKING:
    from warpqem.repair.mended_mesh import MeshRepair

__all__ = [
    "AnimatedMesh",
    "FrameObserver",
    "MeshInput",
    "as_vertex_values",
    "finite_points",
    "is_proper",
    "measure_mesh",
    "read_faces",
    "read_mesh",
    "read_points",
]


@dataclass(frozen=True)
class MeshInput:
    """A mesh in motion as the caller gave it: faces checked, frames not read yet.

    Attributes:
        source: the frames, in the caller's coordinates.
        faces: (N, 3) int32 without faces that use a vertex twice.
        face_index: (N,) int32, the caller's index of each face.
        input_face_count: faces the caller gave.
        used: (V,) bool, vertices with a face.
        repair: how it comes from what the caller gave, where the topology had to be mended; the vertices and faces are
            then the mended ones.
        is_clean: whether nothing is to be mended; None where nobody has looked.
    """

    source: FrameSource
    faces: np.ndarray
    face_index: np.ndarray
    input_face_count: int
    used: np.ndarray
    repair: MeshRepair | None = field(default=None, kw_only=True)
    is_clean: bool | None = field(default=None, kw_only=True)

    @property
    def frame_count(self) -> int:
        """Frames F."""
        return self.source.frame_count

    @property
    def vertex_count(self) -> int:
        """Input vertices V, unreferenced ones included."""
        return self.source.vertex_count

    @property
    def given_faces(self) -> np.ndarray:
        """The caller's faces (K, 3) int32, but those that use a vertex twice, before the topology was mended."""
        return self.faces if self.repair is None else self.repair.given_faces


@dataclass(frozen=True)
class AnimatedMesh(MeshInput):
    """A mesh in motion whose frames have all been seen once.

    Attributes:
        origin: (3,) float64, taken off before the points are rounded to float32.
        centre: (3,) float32, middle of the bounding box of all frames, about ``origin``.
        diagonal: largest bounding-box diagonal of a frame, in the caller's units.
        held: the frames on the device; None where they are brought there as they are needed.
        rounding: how far single precision moves a point in double precision at most, in % of the diagonal; else 0.
    """

    origin: np.ndarray
    centre: np.ndarray
    diagonal: float
    held: HeldFrames | None = field(default=None, kw_only=True, repr=False)
    rounding: float = field(default=0.0, kw_only=True)

    def points(self, frames: slice) -> np.ndarray:
        """Consecutive frames in the caller's coordinates minus ``origin``: (n, V, 3) float32, C-contiguous."""
        return about_origin(self.source.read(frames), self.origin)

    def chosen_points(self, frames: np.ndarray) -> np.ndarray:
        """The same of any frames, ascending."""
        chosen = np.empty((len(frames), self.vertex_count, 3), dtype=np.float32)
        for index, frame in enumerate(frames.tolist()):
            chosen[index] = self.points(slice(frame, frame + 1))[0]
        return chosen

    def unit_blocks(self, frames: np.ndarray, device: str) -> wp.array:
        """Any frames (K,), ascending, in diagonals about the centre: (V, B) blocks of points on the device."""
        rows = None
        if self.held is not None:
            points, rows = self.held.points, frames
        elif isinstance(self.source, DeviceFrames):
            points = self.source.chosen(frames, self.origin)
        elif device_traits(device).own_memory:
            # One after the other: the host has no use for an array of all.
            there = HeldFrames.empty(len(frames), self.vertex_count, device)
            for index, frame in enumerate(frames.tolist()):
                there.put(slice(index, index + 1), self.points(slice(frame, frame + 1)))
            points = there.points
        else:
            points = to_device(self.chosen_points(frames), device)
        return pack_frames(points, device, frames=rows, centre=self.centre, scale=1 / self.diagonal)

    def device_blocks(self, blocks: Sequence[slice], device: str) -> Iterator[tuple[slice, wp.array]]:
        """Every block of frames, about ``origin``, as points (n, V) on the device."""
        if self.held is None and isinstance(self.source, DeviceFrames):
            source = self.source
            return ((frames, source.block(frames, self.origin)) for frames in blocks)
        return device_blocks(self.held, self.points, blocks, device)

    def to_unit(self, points: np.ndarray) -> np.ndarray:
        """Points about ``origin`` on a mesh of unit diagonal about ``centre``, float32."""
        unit = points - self.centre
        unit *= np.float32(1.0 / self.diagonal)
        return unit

    def original_points(self, unit: np.ndarray) -> np.ndarray:
        """Unit positions (..., 3) float32 back in the caller's coordinates, float32."""
        return (unit * self.diagonal + (self.centre + self.origin)).astype(np.float32)


class FrameObserver(Protocol):
    """Learns something from the frames while they are read for the first time."""

    def observe(self, frames: slice, points: np.ndarray | wp.array) -> None:
        """See consecutive frames (n, V, 3) float32, about the mesh's origin; called in the order of the frames.

        Of a source on a device they are (n, V) points there.
        """
        ...


def _is_trimesh(value: Any) -> bool:
    """Whether it is a ``trimesh.Trimesh``, which nobody can hold without having imported trimesh.

    Importing it here would take longer than simplifying a small mesh.
    """
    trimesh = sys.modules.get("trimesh")
    return trimesh is not None and isinstance(value, trimesh.Trimesh)


def read_mesh(
    points: Any,
    faces: Any = None,
    admit: Callable[[int], None] | None = None,
    device: str | None = None,
    look: TopologyLook | None = None,
) -> MeshInput:
    """Check the shape of points (F, V, 3) or (V, 3), or a :class:`FrameSource`, and faces (N, 3).

    A ``trimesh.Trimesh`` as the only argument serves for both, and so does a source with ``faces``, such as a
    :class:`warpqem.MeshSequence`, and a mesh that has been read. ``admit`` is
    called with the number of faces before anything is made of them; it may raise. Faces are looked through on the
    ``device``, and points that are there stay there; None for the host. Where the device has memory of its own, a
    ``look`` at the topology comes to the host along with that.

    Raises:
        MeshShapeError: wrong shape or dtype.
        FrameSourceError: an incomplete source.
        FaceIndexError: index below 0 or not below V.
        DegenerateMeshError: no point, or no face with three different vertices.
    """
    if isinstance(points, MeshInput) and faces is None:
        return points
    if faces is None and hasattr(points, "faces") and hasattr(points, "read"):
        # A source with faces of its own, such as a sequence of mesh files.
        faces = points.faces
    if _is_trimesh(points):
        if faces is not None:
            raise OptionError("faces must not be given with a trimesh.Trimesh, which has its own")
        points, faces = points.vertices, points.faces
    elif faces is None:
        raise OptionError("faces (N, 3) are missing")
    source = _checked_source(points, device)
    given = index_array(faces, "faces", ("N", 3))
    if admit is not None:
        admit(len(given))
    found = None if device is None else used_vertices(given, source.vertex_count, device, look)
    if found is not None:
        # A copy: the caller's array may change.
        own, (used, is_clean) = given.copy(), found
        return MeshInput(source, own, np.arange(len(given), dtype=np.int32), len(given), used, is_clean=is_clean)
    kept, face_index = _proper_faces(read_faces(given, "faces", source.vertex_count))
    # Counting takes half the time of marking.
    used = np.bincount(kept.ravel(), minlength=source.vertex_count) > 0
    return MeshInput(source, kept, face_index, len(given), used)


def measure_mesh(
    mesh: MeshInput,
    device: str,
    observers: Sequence[FrameObserver] = (),
    *,
    block_frames: int | None = None,
    hold: bool = False,
    progress: Callable[[int], None] | None = None,
) -> AnimatedMesh:
    """Read all frames once: check them, find the mesh's size, and let observers see them.

    Args:
        mesh: the mesh.
        device: Warp device.
        observers: see every block after it was checked.
        block_frames: frames read at a time; None for as many as keep a device busy.
        hold: keep the frames on the device.
        progress: called with the number of frames seen.

    Raises:
        NonFinitePointError: NaN or infinite coordinate.
        DegenerateMeshError: no extent.
    """
    lows, highs = [], []
    broken: BrokenPoints | None = None
    # A vertex without a face has no say in the mesh's size.
    reading = FirstReading(mesh.source, mesh.used, device, hold)
    for seen in reading.blocks(frame_blocks(mesh.frame_count, mesh.vertex_count, block_frames)):
        if seen.broken is not None:
            broken = BrokenPoints.add(broken, seen.broken, seen.frames.start)
        if broken is not None:
            # All frames are looked through, for the message to say how many points there are.
            continue
        lows.append(seen.low)
        highs.append(seen.high)
        for observer in observers:
            observer.observe(seen.frames, seen.points)
        if progress:
            progress(seen.frames.stop)
    if broken is not None:
        raise broken.error()
    low, high = np.concatenate(lows), np.concatenate(highs)
    diagonal = _diagonal(low[counted_frames(mesh.source)], high[counted_frames(mesh.source)])
    centre = ((low.min(axis=0).astype(np.float64) + high.max(axis=0)) / 2).astype(np.float32)
    return AnimatedMesh(
        mesh.source,
        mesh.faces,
        mesh.face_index,
        mesh.input_face_count,
        mesh.used,
        reading.origin,
        centre,
        diagonal,
        repair=mesh.repair,
        held=reading.held,
        rounding=rounding_of(low, high, reading.origin, diagonal) if mesh.source.dtype == np.float64 else 0.0,
    )


def _diagonal(low: np.ndarray, high: np.ndarray) -> float:
    """The largest diagonal of the bounding boxes (F, 3) of some frames.

    Raises:
        DegenerateMeshError: it is no size to divide by.
    """
    diagonal = float(np.linalg.norm(high.astype(np.float64) - low, axis=1).max())
    if not 0.0 < diagonal < np.inf:
        raise DegenerateMeshError(f"the mesh has no extent: its bounding-box diagonal is {diagonal:g} in every frame")
    if not 1.0 / FLOAT32_MAX < diagonal < FLOAT32_MAX:
        raise DegenerateMeshError(f"the bounding-box diagonal, {diagonal:g}, cannot be scaled to 1 in single precision")
    return diagonal


def _checked_source(points: Any, device: str | None) -> FrameSource:
    """A source as it is, or the frames of an array; those on ``device`` stay there."""
    source = check_source(points, "points")
    if source is not None:
        return source
    if device is None or array_device(points) != device:
        return ArrayFrames(read_points(points, "points"))
    there = read_warp_array(points, "points")
    # A NumPy array without memory has the same shape and kind of value, so the same is refused in the same words.
    dtype = np.dtype(wp.dtype_to_numpy(there.dtype))
    shape = read_points(np.broadcast_to(np.zeros((), dtype=dtype), there.shape), "points").shape
    return DeviceFrames(there if there.ndim == 3 else there.reshape(shape))


def read_points(points: Any, name: str) -> np.ndarray:
    """Check points (F, V, 3) or (V, 3): (F, V, 3) real numbers, which may not be finite; not copied if possible.

    Raises:
        MeshShapeError: another shape or dtype.
        DegenerateMeshError: there is none.
    """
    found = real_array(points, name, ("F", "V", 3), ("V", 3))
    if 0 in found.shape:
        raise DegenerateMeshError(f"{name} are empty: shape {found.shape}")
    if found.shape[-2] > INDEX_LIMIT:
        raise MeshShapeError(f"{name} have {found.shape[-2]} vertices, more than the {INDEX_LIMIT} that can be")
    return found[None] if found.ndim == 2 else found


def finite_points(points: np.ndarray, prefix: str = "point of") -> np.ndarray:
    """The same points (F, V, 3), if all of them are finite, in single precision too.

    Raises:
        NonFinitePointError: one is not; the message names vertex and frame after ``prefix``.
    """
    if first_beyond(points, FLOAT32_MAX) is not None:
        broken = BrokenPoints.add(None, points.astype(np.float64), 0)
        assert broken is not None
        raise broken.error(prefix)
    return points


def read_faces(faces: Any, name: str, vertex_count: int | None) -> np.ndarray:
    """Check faces (N, 3) of a mesh with so many vertices: (N, 3) int32, C-contiguous; not copied if possible.

    Args:
        faces: the argument.
        name: what messages call it.
        vertex_count: vertices V; None where faces are all that is given.

    Raises:
        MeshShapeError: another shape or dtype, or more of them than can be.
        DegenerateMeshError: there is none.
        FaceIndexError: index below 0 or not below V.
    """
    found, prefix = index_array(faces, name, ("N", 3)), "" if name == "faces" else f"{name}: "
    if len(found) == 0:
        raise DegenerateMeshError(f"{prefix}there are no faces")
    outside = first_outside(found, INDEX_LIMIT if vertex_count is None else vertex_count)
    if outside is not None:
        vertex = int(found[outside])
        there = "" if vertex_count is None else f", but there are {vertex_count} vertices"
        limit = "; indices are not negative" if vertex < 0 else f"; indices are below {vertex_count or INDEX_LIMIT}"
        raise FaceIndexError(f"{prefix}face {outside[0]} corner {outside[1]} refers to vertex {vertex}{there}{limit}")
    return np.ascontiguousarray(found, dtype=np.int32)


def is_proper(faces: np.ndarray) -> np.ndarray:
    """(N,) bool, faces (N, 3) with three different vertices: others cover nothing."""
    proper: np.ndarray = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return proper


def _proper_faces(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Faces with three different vertices, and the index of each."""
    proper = is_proper(faces)
    if proper.all():
        return faces.copy(), np.arange(len(faces), dtype=np.int32)
    if not proper.any():
        raise DegenerateMeshError(f"none of the {len(faces)} faces has three different vertices")
    return np.ascontiguousarray(faces[proper]), np.flatnonzero(proper).astype(np.int32)


def as_vertex_values(values: Any, name: str, vertex_count: int) -> np.ndarray:
    """Check one finite number per vertex, (V,) in the caller's dtype.

    Raises:
        MeshShapeError: another shape or dtype, or a value that is not finite.
    """
    expected = f"{vertex_count} numbers, one per vertex"
    array = real_array(values, name, (vertex_count,), expected=expected, bools=True)
    finite = np.isfinite(array)
    if not finite.all():
        vertex = int(np.flatnonzero(~finite)[0])
        raise MeshShapeError(f"{name} of vertex {vertex} is {array[vertex]}")
    return array
