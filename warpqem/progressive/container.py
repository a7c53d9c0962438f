"""The container of a progressive mesh: a checked header, and chunks of parts.

Layout, little-endian::

    8 bytes   b"WPQMESH1"; the digit is the version of the format
    12 bytes  length of the header, uint64, and its CRC-32, uint32
    header    JSON: counts, the chunks, and what the caller added
    chunks    parts, each with its length before it, uint64

The first chunk is the base mesh; the others hold consecutive splits, so that reading may stop at any of them. What the
parts are is in :mod:`warpqem.progressive.file`.
"""

from __future__ import annotations

import json
import mmap
import os
import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from warpqem.errors import ProgressiveFileError
from warpqem.memory import available_memory, format_bytes
from warpqem.temporary import replacing

__all__ = ["ChunkFile", "FileInfo", "write_chunks"]

MAGIC = b"WPQMESH1"
HEADER = struct.Struct("<QI")
LENGTH = struct.Struct("<Q")
# A header lists chunks of thousands of splits; one longer than this is none.
MOST_HEADER_BYTES = 64 * 2**20


@dataclass(frozen=True)
class FileInfo:
    """What the header of a file says.

    Attributes:
        vertex_count, face_count, frame_count: of the input.
        base_vertex_count, base_face_count: of the base mesh.
        split_count: splits from there to the input.
        rank_count: input vertices with a face.
        chunks: first split, first face, offset, length in bytes and CRC-32 of each chunk; the base mesh is the first.
        extra: what the caller added, JSON.
    """

    vertex_count: int
    face_count: int
    frame_count: int
    base_vertex_count: int
    base_face_count: int
    split_count: int
    rank_count: int
    chunks: list[list[int]]
    extra: dict[str, Any] = field(default_factory=dict)

    @property
    def row_count(self) -> int:
        """Vertices that ever were."""
        return self.base_vertex_count + 2 * self.split_count


def write_chunks(path: str | os.PathLike[str], info: FileInfo, chunks: list[list[bytes]]) -> None:
    """Write a file under a temporary name and rename it.

    Args:
        path: the file, replaced if it exists.
        info: the header; ``chunks`` in it has the first split and the first face of each chunk, and gets the rest.
        chunks: the parts of each chunk.

    Raises:
        OSError: the file cannot be written; nothing is left behind.
    """
    payloads = [b"".join(LENGTH.pack(len(part)) + part for part in parts) for parts in chunks]
    offset = 0
    for entry, payload in zip(info.chunks, payloads, strict=True):
        entry[2:] = [offset, len(payload), zlib.crc32(payload)]
        offset += len(payload)
    header = json.dumps(vars(info), separators=(",", ":")).encode()
    with replacing(Path(path)) as temporary, open(temporary, "xb") as file:
        file.write(MAGIC + HEADER.pack(len(header), zlib.crc32(header)) + header)
        file.writelines(payloads)
        file.flush()
        os.fsync(file.fileno())


class ChunkFile:
    """An open file, mapped into memory.

    Args:
        path: the file.

    Raises:
        ProgressiveFileError: it is no progressive mesh, damaged, or what it holds does not fit in memory.
        OSError: it cannot be read.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = os.fspath(path)
        with open(path, "rb") as file:
            try:
                self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            except ValueError:
                raise ProgressiveFileError(f"{self.path}: the file is empty") from None
        try:
            self.info = self._read_header()
        except BaseException:
            self._map.close()
            raise

    def __enter__(self) -> ChunkFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._map.close()

    def _read_header(self) -> FileInfo:
        start = len(MAGIC) + HEADER.size
        if self._map[:7] != MAGIC[:7]:
            raise ProgressiveFileError(f"{self.path}: this is no progressive mesh")
        if self._map[: len(MAGIC)] != MAGIC:
            version = self._map[7:8].decode("latin-1")
            raise ProgressiveFileError(f"{self.path}: version {version!r} of the format is not known, only 1 is")
        if len(self._map) < start:
            raise ProgressiveFileError(f"{self.path}: the file ends in its header")
        length, crc = HEADER.unpack(self._map[len(MAGIC) : start])
        if length > MOST_HEADER_BYTES or start + length > len(self._map):
            raise ProgressiveFileError(f"{self.path}: the file ends in its header, which is {length} bytes long")
        header = self._map[start : start + length]
        if zlib.crc32(header) != crc:
            raise ProgressiveFileError(f"{self.path}: the header is damaged (its CRC-32 does not fit)")
        self._data_start = start + length
        try:
            info = FileInfo(**json.loads(header))
        except (ValueError, TypeError, RecursionError) as error:
            raise ProgressiveFileError(f"{self.path}: the header cannot be read ({error})") from error
        self._check(info)
        return info

    def _check(self, info: FileInfo) -> None:
        counts = {name: value for name, value in vars(info).items() if name.endswith("_count")}
        for name, value in counts.items():
            if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**31:
                raise ProgressiveFileError(f"{self.path}: {name} {value!r} is no count")
        fits = (
            info.frame_count > 0
            and info.base_vertex_count > 0
            and info.rank_count == info.base_vertex_count + info.split_count <= info.vertex_count
            and info.base_face_count <= info.face_count <= info.base_face_count + 2 * info.split_count
            and isinstance(info.extra, dict)
        )
        if not fits:
            raise ProgressiveFileError(f"{self.path}: the counts in the header contradict each other: {counts}")
        shape = isinstance(info.chunks, list) and all(
            isinstance(chunk, list) and len(chunk) == 5 and all(isinstance(n, int) and n >= 0 for n in chunk)
            for chunk in info.chunks
        )
        if not shape or not info.chunks:
            raise ProgressiveFileError(f"{self.path}: the list of chunks in the header cannot be read")
        starts = [chunk[0] for chunk in info.chunks[1:]]
        faces = [chunk[1] for chunk in info.chunks]
        if (
            starts != sorted(set(starts))
            or faces != sorted(faces)
            or (bool(starts) and (starts[0] != 0 or starts[-1] >= info.split_count))
            or (not starts and info.split_count > 0)
            or (len(faces) > 1 and faces[1] != info.base_face_count)
            or faces[0] != 0
            or faces[-1] > info.face_count
        ):
            raise ProgressiveFileError(f"{self.path}: the chunks in the header are out of order")
        needed, free = 12 * info.row_count * info.frame_count, available_memory("cpu")
        if free is not None and needed > free:
            raise ProgressiveFileError(
                f"{self.path}: {info.row_count} vertices in {info.frame_count} frames take {format_bytes(needed)}, "
                f"{format_bytes(free)} of memory are free"
            )

    def parts(self, chunk: int) -> list[bytes]:
        """The parts of a chunk."""
        _, _, offset, length, crc = self.info.chunks[chunk]
        start = self._data_start + offset
        if start + length > len(self._map):
            raise ProgressiveFileError(f"{self.path}: the file ends in chunk {chunk} of {len(self.info.chunks)}")
        data = self._map[start : start + length]
        if zlib.crc32(data) != crc:
            raise ProgressiveFileError(f"{self.path}: chunk {chunk} is damaged (its CRC-32 does not fit)")
        parts, at = [], 0
        while at < length:
            if at + LENGTH.size > length:
                raise ProgressiveFileError(f"{self.path}: chunk {chunk} ends in a part")
            (size,) = LENGTH.unpack(data[at : at + LENGTH.size])
            at += LENGTH.size
            if at + size > length:
                raise ProgressiveFileError(f"{self.path}: chunk {chunk} ends in a part")
            parts.append(data[at : at + size])
            at += size
        return parts
