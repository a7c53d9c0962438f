"""Save and load progressive meshes: see :mod:`warpqem.progressive.container` for the file as a whole.

Numbers are coded by :mod:`warpqem.progressive.coding`, without loss. Parts of the base mesh: input vertices and lowest
ranks of its vertices, ranks and indices of its faces, the error, the trajectories. Parts of a chunk of splits: the row
that each ends, the input vertex and lowest rank that part from it, the number of faces it brings, their ranks and
indices, the error, the ratio of its vertices, and their trajectories.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import numpy as np

from warpqem.errors import OptionError, ProgressiveFileError
from warpqem.outputs import InputFile, OutputFile, check_outputs
from warpqem.progressive import coding
from warpqem.progressive.container import ChunkFile, FileInfo, write_chunks
from warpqem.progressive.mesh import ProgressiveMesh
from warpqem.progressive.splits import SplitTopology

__all__ = ["load", "read_info", "save", "stream"]

# The first chunk of splits is small, so that something finer comes soon; each one after is twice as long, up to a size
# that keeps the coder's overhead small.
FIRST_CHUNK, MOST_CHUNK = 1024, 32768


def save(mesh: ProgressiveMesh, path: str | os.PathLike[str], extra: dict[str, Any] | None = None) -> None:
    """Write a progressive mesh under a temporary name and rename it.

    Args:
        mesh: the mesh, with all its splits.
        path: the file, replaced if it exists.
        extra: anything that JSON holds, to be found again in :attr:`FileInfo.extra`.

    Raises:
        OptionError: not all splits of the mesh are loaded, or it was loaded from this file.
        OSError: the file cannot be written; nothing is left behind.
    """
    if not mesh.is_complete:
        raise OptionError(f"only {mesh.loaded_face_count} of {mesh.face_count} faces are loaded")
    loaded = [] if mesh.source is None else [InputFile(mesh.source, "the file that the mesh was loaded from")]
    check_outputs([OutputFile("output", path)], loaded)
    topology, face_counts = mesh.topology, mesh.topology.face_counts()
    bounds = _chunk_bounds(topology.split_count)
    info = FileInfo(
        vertex_count=topology.vertex_count,
        face_count=mesh.face_count,
        frame_count=mesh.frame_count,
        base_vertex_count=topology.base_count,
        base_face_count=mesh.base_face_count,
        split_count=topology.split_count,
        rank_count=topology.base_count + topology.split_count,
        chunks=[[0, 0, 0, 0, 0]] + [[first, int(face_counts[first]), 0, 0, 0] for first, _ in bounds],
        extra=extra or {},
    )
    write_chunks(path, info, [_base_parts(mesh)] + [_split_parts(mesh, *bound) for bound in bounds])


def read_info(path: str | os.PathLike[str]) -> FileInfo:
    """What the header of a file says.

    Raises:
        ProgressiveFileError: the file is no progressive mesh, or damaged.
        OSError: it cannot be read.
    """
    with ChunkFile(path) as file:
        return file.info


def load(
    path: str | os.PathLike[str], *, target_faces: int | None = None, split_count: int | None = None
) -> ProgressiveMesh:
    """Read a progressive mesh, or as much of it as a level needs.

    Args:
        path: the file.
        target_faces: read no further than this many faces need; None for all.
        split_count: read no further than this many splits; None for all.

    Raises:
        ProgressiveFileError: the file is no progressive mesh, damaged, or does not fit in memory.
        OSError: it cannot be read.
    """
    for mesh in stream(path):
        if split_count is not None and mesh.split_count >= split_count:
            break
        if target_faces is not None and mesh.loaded_face_count >= target_faces:
            break
    return mesh


def stream(path: str | os.PathLike[str]) -> Iterator[ProgressiveMesh]:
    """The base mesh, then after each chunk the mesh with all the splits so far.

    Raises:
        ProgressiveFileError: the file is no progressive mesh, damaged, or does not fit in memory.
        OSError: it cannot be read.
    """
    with ChunkFile(path) as file:
        decoder, bounds = _Decoder(file.info), [*file.info.chunks, [file.info.split_count, file.info.face_count]]
        for index in range(len(file.info.chunks)):
            parts = file.parts(index)
            try:
                if index == 0:
                    decoder.read_base(parts)
                    mesh = decoder.mesh(0, file.info.base_face_count)
                else:
                    decoder.read_splits(parts, bounds[index][:2], bounds[index + 1][:2])
                    mesh = decoder.mesh(*bounds[index + 1][:2])
            except ProgressiveFileError as error:
                raise ProgressiveFileError(f"{file.path}: chunk {index}: {error}") from error
            mesh.source = os.path.abspath(path)
            yield mesh


def _chunk_bounds(split_count: int) -> list[tuple[int, int]]:
    bounds, first, size = [], 0, FIRST_CHUNK
    while first < split_count:
        bounds.append((first, min(first + size, split_count)))
        first, size = first + size, min(2 * size, MOST_CHUNK)
    return bounds


def _deltas(values: np.ndarray) -> bytes:
    """Indices, as differences of neighbours."""
    return coding.pack(np.diff(values.astype(np.int32), axis=0, prepend=np.zeros_like(values[:1], dtype=np.int32)))


def _sums(part: bytes, count: int, width: int = 1) -> np.ndarray:
    """What :func:`_deltas` coded: (count,), or (count, width)."""
    values = np.cumsum(coding.unpack(part, count * width).reshape(count, width), axis=0, dtype=np.int32)
    return values if width > 1 else values[:, 0]


def _tracks(points: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Trajectories (n, F, 3) of some rows of (F, R, 3)."""
    return np.ascontiguousarray(np.take(points, rows, axis=1).transpose(1, 0, 2))


def _base_parts(mesh: ProgressiveMesh) -> list[bytes]:
    topology, count, face_count = mesh.topology, mesh.topology.base_count, mesh.base_face_count
    return [
        _deltas(topology.row_vertex[:count]),
        _deltas(topology.row_start[:count]),
        _deltas(topology.face_rank[:face_count]),
        _deltas(topology.face_index[:face_count]),
        coding.pack(topology.error[:1]),
        coding.encode_tracks(_tracks(mesh.points, np.arange(count))),
    ]


def _split_parts(mesh: ProgressiveMesh, first: int, last: int) -> list[bytes]:
    topology, splits = mesh.topology, slice(first, last)
    kept = topology.base_count + 2 * np.arange(first, last)
    face_counts = topology.face_counts()[first : last + 1]
    faces = slice(int(face_counts[0]), int(face_counts[-1]))
    tracks = [_tracks(mesh.points, rows) for rows in (topology.parent_row[splits], kept, kept + 1)]
    ratio = coding.split_ratios(*tracks)
    return [
        _deltas(topology.parent_row[splits]),
        _deltas(topology.row_vertex[kept + 1]),
        _deltas(topology.row_start[kept + 1]),
        coding.pack(np.diff(face_counts).astype(np.int32)),
        _deltas(topology.face_rank[faces]),
        _deltas(topology.face_index[faces]),
        coding.pack(topology.error[first + 1 : last + 1]),
        coding.pack(ratio),
        *coding.encode_splits(*tracks, ratio),
    ]


class _Decoder:
    """Puts chunks together, and checks every index in them: a file may come from anywhere."""

    def __init__(self, info: FileInfo) -> None:
        self._info = info
        rows, faces, splits = info.row_count, info.face_count, info.split_count
        self._row_vertex, self._row_start, self._row_stop = (np.empty(rows, dtype=np.int32) for _ in range(3))
        self._row_end = np.full(rows, splits, dtype=np.int32)
        self._parent_row = np.empty(splits, dtype=np.int32)
        self._error = np.empty(splits + 1, dtype=np.float32)
        self._face_rank = np.empty((faces, 3), dtype=np.int32)
        self._face_index, self._face_split = (np.full(faces, -1, dtype=np.int32) for _ in range(2))
        self._points = np.empty((info.frame_count, rows, 3), dtype=np.float32)

    def mesh(self, split_count: int, face_count: int) -> ProgressiveMesh:
        """The mesh with the splits so far."""
        rows = self._info.base_vertex_count + 2 * split_count
        topology = SplitTopology(
            base_count=self._info.base_vertex_count,
            row_vertex=self._row_vertex[:rows],
            row_start=self._row_start[:rows],
            parent_row=self._parent_row[:split_count],
            row_end=self._row_end[:rows].copy(),
            face_rank=self._face_rank[:face_count],
            face_index=self._face_index[:face_count],
            face_split=self._face_split[:face_count],
            error=self._error[: split_count + 1],
            vertex_count=self._info.vertex_count,
            face_count=self._info.face_count,
        )
        return ProgressiveMesh(topology, self._points[:, :rows])

    def read_base(self, parts: list[bytes]) -> None:
        """Take the first chunk."""
        _check_part_count(parts, 6)
        info, count = self._info, self._info.base_vertex_count
        vertex, start = _sums(parts[0], count), _sums(parts[1], count)
        _check_range("input vertex", vertex, info.vertex_count)
        _check_range("rank", start, info.rank_count)
        ascending = np.sort(start)
        if ascending[0] != 0 or (np.diff(ascending) <= 0).any():
            raise ProgressiveFileError("the ranks of the base mesh overlap")
        stop = np.empty_like(start)
        stop[np.argsort(start)] = np.append(ascending[1:], info.rank_count)
        self._row_vertex[:count], self._row_start[:count], self._row_stop[:count] = vertex, start, stop
        self._read_faces(parts[2], parts[3], slice(0, info.base_face_count))
        self._error[:1] = coding.unpack(parts[4], 1, np.float32)
        self._set_points(np.arange(count), coding.decode_tracks(parts[5], count, info.frame_count))

    def read_splits(self, parts: list[bytes], start: list[int], stop: list[int]) -> None:
        """Take a chunk of splits: from ``start`` to before ``stop``, each a split and a face."""
        _check_part_count(parts, 10)
        count, kept = stop[0] - start[0], self._info.base_vertex_count + 2 * np.arange(start[0], stop[0])
        parent, vertex, rank = (_sums(part, count) for part in parts[:3])
        _check_range("input vertex", vertex, self._info.vertex_count)
        waves = self._wave_of(parent, int(kept[0]))
        brought = coding.unpack(parts[3], count)
        if (brought < 0).any() or (brought > 2).any() or brought.sum() != stop[1] - start[1]:
            raise ProgressiveFileError("splits bring other faces than the header says")
        faces = slice(start[1], stop[1])
        self._read_faces(parts[4], parts[5], faces)
        self._face_split[faces] = np.repeat(np.arange(start[0], stop[0]), brought)
        self._error[start[0] + 1 : stop[0] + 1] = coding.unpack(parts[6], count, np.float32)
        ratio = coding.unpack(parts[7], count, np.float32)
        shape = (count, self._info.frame_count, 3)
        residuals = [coding.unpack(part, int(np.prod(shape))).reshape(shape) for part in parts[8:]]
        self._parent_row[start[0] : stop[0]] = parent
        for wave in range(int(waves.max(initial=-1)) + 1):
            chosen = np.flatnonzero(waves == wave)
            self._split_ranks(parent[chosen], kept[chosen], vertex[chosen], rank[chosen], start[0] + chosen)
            source = _tracks(self._points, parent[chosen])
            tracks = coding.decode_splits((residuals[0][chosen], residuals[1][chosen]), source, ratio[chosen])
            self._set_points(kept[chosen], tracks[0])
            self._set_points(kept[chosen] + 1, tracks[1])

    def _wave_of(self, parent: np.ndarray, first_row: int) -> np.ndarray:
        """How many splits of the same chunk each one comes after."""
        if (parent < 0).any() or (parent >= first_row + 2 * np.arange(len(parent))).any():
            raise ProgressiveFileError("a split ends a vertex that is not there yet")
        if len(np.unique(parent)) < len(parent) or (self._row_end[parent] < self._info.split_count).any():
            raise ProgressiveFileError("two splits end the same vertex")
        waves: list[int] = []
        for before in ((parent - first_row) // 2).tolist():
            waves.append(waves[before] + 1 if before >= 0 else 0)
        return np.array(waves, dtype=np.int64)

    def _split_ranks(
        self, parent: np.ndarray, kept: np.ndarray, vertex: np.ndarray, rank: np.ndarray, split: np.ndarray
    ) -> None:
        start, stop = self._row_start[parent], self._row_stop[parent]
        if (rank <= start).any() or (rank >= stop).any():
            raise ProgressiveFileError("a split parts ranks that its vertex does not have")
        self._row_vertex[kept], self._row_vertex[kept + 1] = self._row_vertex[parent], vertex
        self._row_start[kept], self._row_stop[kept] = start, rank
        self._row_start[kept + 1], self._row_stop[kept + 1] = rank, stop
        self._row_end[parent] = split

    def _read_faces(self, ranks: bytes, indices: bytes, faces: slice) -> None:
        count = faces.stop - faces.start
        self._face_rank[faces] = _sums(ranks, count, 3)
        self._face_index[faces] = _sums(indices, count)
        _check_range("rank of a corner", self._face_rank[faces], self._info.rank_count)
        # The caller's faces may have been more: those with a vertex twice were left out.
        _check_range("face", self._face_index[faces], 2**31 - 1)

    def _set_points(self, rows: np.ndarray, tracks: np.ndarray) -> None:
        if not np.isfinite(tracks).all():
            raise ProgressiveFileError("a point is not finite")
        self._points[:, rows] = tracks.transpose(1, 0, 2)


def _check_part_count(parts: list[bytes], count: int) -> None:
    if len(parts) != count:
        raise ProgressiveFileError(f"{len(parts)} parts where {count} belong")


def _check_range(name: str, values: np.ndarray, end: int) -> None:
    outside = (values < 0) | (values >= end)
    if outside.any():
        raise ProgressiveFileError(f"{name} {values[outside][0]} is not between 0 and {end - 1}")
