"""Save and load progressive meshes: see :mod:`warpqem.progressive.container` for the file as a whole.

Numbers are coded by :mod:`warpqem.progressive.coding`, without loss. Parts of the base mesh: input vertices and lowest
ranks of its vertices, ranks and indices of its faces, the error, the trajectories. Parts of a chunk of splits: the row
that each ends, the input vertex and lowest rank that part from it, the number of faces it brings, their ranks and
indices, the error, the ratio of its vertices, and their trajectories.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, cast

import numpy as np

from warpqem.arguments.json_types import Json
from warpqem.arguments.number_input import shown, whole_number
from warpqem.errors import MemoryLimitError, OptionError, ProgressiveFileError, WarpqemError
from warpqem.files.outputs import InputFile, OutputFile, check_outputs
from warpqem.progressive import coding
from warpqem.progressive.container import ChunkFile, FileInfo, write_chunks
from warpqem.progressive.decoder import ChunkDecoder
from warpqem.progressive.memory_limit import check_memory
from warpqem.progressive.progressive_mesh import ProgressiveMesh

__all__ = ["ProgressiveFile", "load", "read_info", "save", "stream"]

_log = logging.getLogger(__name__)

# The first chunk of splits is small, so that something finer comes soon; each one after is twice as long, up to a size
# that keeps the coder's overhead small.
FIRST_CHUNK, MAX_CHUNK = 1024, 32768


def save(mesh: ProgressiveMesh, path: str | os.PathLike[str], extra: Mapping[str, Json] | None = None) -> None:
    """Write a progressive mesh under a temporary name and rename it.

    Args:
        mesh: the mesh, with all its splits.
        path: the file, replaced if it exists.
        extra: anything that JSON holds, to be found again in :attr:`FileInfo.extra`; numbers are finite, integers have
            at most 20 digits, and lists and objects are at most 62 deep.

    Raises:
        OptionError: not all splits of the mesh are loaded, it was loaded from this file, ``extra`` is nothing that JSON
            holds.
        OSError: the file cannot be written; nothing is left behind.
    """
    if not isinstance(mesh, ProgressiveMesh):
        raise OptionError(f"mesh must be a ProgressiveMesh, got {shown(mesh)}")
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
        # It is checked where the header is coded.
        extra={} if extra is None else cast(dict[str, Any], extra),
    )
    write_chunks(path, info, [_base_parts(mesh)] + [_split_parts(mesh, *bound) for bound in bounds])


class ProgressiveFile:
    """An open file: what its header says, and its meshes, read when they are asked for.

    All that is read of one belongs together, also where another file takes its name meanwhile.

    Args:
        path: the file.

    Attributes:
        path: its name.
        info: its header.

    Raises:
        ProgressiveFileError: the file is no progressive mesh, or damaged.
        OSError: it cannot be read.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = os.fsdecode(path)
        with self._errors_named():
            self._file = ChunkFile(path)
        self.info = self._file.info
        _log.info("%s: reading", self.path)

    def __enter__(self) -> ProgressiveFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.__exit__()

    def load(
        self, *, target_faces: int | None = None, split_count: int | None = None, memory: int | str | None = None
    ) -> ProgressiveMesh:
        """As :func:`load`."""
        chunk_count = len(self.info.chunks)
        for count in range(1, chunk_count):
            splits, faces = self.info.loaded_counts(count)
            if (split_count is not None and splits >= split_count) or (
                target_faces is not None and faces >= target_faces
            ):
                chunk_count = count
                break
        with self._errors_named():
            decoder = self._decoder(chunk_count, memory)
            for index in range(chunk_count):
                self._decode(decoder, index)
            return self._mesh(decoder, chunk_count)

    def stream(self, *, memory: int | str | None = None) -> Iterator[ProgressiveMesh]:
        """As :func:`stream`."""
        chunk_count = len(self.info.chunks)
        with self._errors_named():
            decoder = self._decoder(chunk_count, memory)
        for index in range(chunk_count):
            with self._errors_named():
                self._decode(decoder, index)
                mesh = self._mesh(decoder, index + 1)
            yield mesh

    def _mesh(self, decoder: ChunkDecoder, chunk_count: int) -> ProgressiveMesh:
        mesh = decoder.mesh(chunk_count)
        mesh.source = os.path.abspath(self.path)
        return mesh

    def _decoder(self, chunk_count: int, memory: int | str | None) -> ChunkDecoder:
        check_memory(self.path, self.info, chunk_count, self._file.size, memory)
        return ChunkDecoder(self.info, chunk_count)

    def _decode(self, decoder: ChunkDecoder, index: int) -> None:
        parts = self._file.parts(index)
        try:
            decoder.read(index, parts)
        except ProgressiveFileError as error:
            raise ProgressiveFileError(f"{self.path}: chunk {index}: {error}") from error

    @contextmanager
    def _errors_named(self) -> Iterator[None]:
        try:
            yield
        except MemoryError as error:
            if isinstance(error, WarpqemError):
                raise
            raise MemoryLimitError(f"{self.path}: there is not enough memory to load it") from error


def read_info(path: str | os.PathLike[str]) -> FileInfo:
    """What the header of a file says.

    Raises:
        ProgressiveFileError: the file is no progressive mesh, or damaged.
        OSError: it cannot be read.
    """
    with ProgressiveFile(path) as file:
        return file.info


def load(
    path: str | os.PathLike[str],
    *,
    target_faces: int | None = None,
    split_count: int | None = None,
    memory: int | str | None = None,
) -> ProgressiveMesh:
    """Read a progressive mesh, or as much of it as a level needs.

    Files from anywhere are safe to load: one that is damaged, or made to do harm, ends in an error.

    Args:
        path: the file.
        target_faces: read no further than this many faces need; None for all.
        split_count: read no further than this many splits; None for all.
        memory: what the mesh may take, in bytes or as text such as "8G"; None for 64 MiB, or 256 times the size of the
            file where that is more, which is enough for all files that :func:`save` writes.

    Raises:
        ProgressiveFileError: the file is no progressive mesh, damaged, or takes more memory than it may or is free.
        MemoryLimitError: memory has run out on the way.
        OptionError: a number that is none, or ``memory`` is no number of bytes.
        OSError: it cannot be read.
    """
    if target_faces is not None:
        target_faces = whole_number(target_faces, "target_faces")
    if split_count is not None:
        split_count = whole_number(split_count, "split_count", least=0)
    with ProgressiveFile(path) as file:
        return file.load(target_faces=target_faces, split_count=split_count, memory=memory)


def stream(path: str | os.PathLike[str], *, memory: int | str | None = None) -> Iterator[ProgressiveMesh]:
    """The base mesh, then after each chunk the mesh with all the splits so far.

    Args:
        path: the file.
        memory: as for :func:`load`.

    Raises:
        ProgressiveFileError, MemoryLimitError, OptionError, OSError: as for :func:`load`.
    """
    with ProgressiveFile(path) as file:
        yield from file.stream(memory=memory)


def _chunk_bounds(split_count: int) -> list[tuple[int, int]]:
    bounds, first, size = [], 0, FIRST_CHUNK
    while first < split_count:
        bounds.append((first, min(first + size, split_count)))
        first, size = first + size, min(2 * size, MAX_CHUNK)
    return bounds


def _deltas(values: np.ndarray) -> bytes:
    """Indices, as differences of neighbours."""
    return coding.pack(np.diff(values.astype(np.int32), axis=0, prepend=np.zeros_like(values[:1], dtype=np.int32)))


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
    parent, first_end, second_end = (
        _tracks(mesh.points, rows) for rows in (topology.parent_row[splits], kept, kept + 1)
    )
    ratio = coding.split_ratios(parent, first_end, second_end)
    return [
        _deltas(topology.parent_row[splits]),
        _deltas(topology.row_vertex[kept + 1]),
        _deltas(topology.row_start[kept + 1]),
        coding.pack(np.diff(face_counts).astype(np.int32)),
        _deltas(topology.face_rank[faces]),
        _deltas(topology.face_index[faces]),
        coding.pack(topology.error[first + 1 : last + 1]),
        coding.pack(ratio),
        *coding.encode_splits(parent, first_end, second_end, ratio),
    ]
