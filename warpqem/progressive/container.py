"""The container of a progressive mesh: a checked header, and chunks of parts.

Layout, little-endian::

    8 bytes   b"WPQMESH1"; the digit is the version of the format
    12 bytes  length of the header, uint64, and its CRC-32, uint32
    header    JSON: counts, the chunks, and what the caller added
    chunks    one right after the other: parts, each with its length before it, uint64
    zeros     as many as the size of the file needs to account for what it unpacks to, most often none

The first chunk is the base mesh; the others hold consecutive splits, so that reading may stop at any of them. What the
parts are is in :mod:`warpqem.progressive.file`, what the header holds in :mod:`warpqem.progressive.header`, and how
much a file may unpack to in :mod:`warpqem.progressive.memory_limit`.
"""

from __future__ import annotations

import os
import stat
import struct
import zlib
from pathlib import Path

from warpqem.errors import OptionError, ProgressiveFileError
from warpqem.files.file_kinds import check_regular
from warpqem.files.temporary import replacing
from warpqem.progressive.header import MAX_HEADER_BYTES, FileInfo, header_bytes, parse_header
from warpqem.progressive.memory_limit import min_file_bytes

__all__ = ["ChunkFile", "FileInfo", "write_chunks"]

MAGIC = b"WPQMESH1"
HEADER = struct.Struct("<QI")
LENGTH = struct.Struct("<Q")
# Bytes as they are, and no waiting for the other end of a pipe, in case that the file has become one.
OPEN_FLAGS = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_BINARY", "O_NONBLOCK", "O_NOCTTY"))


def write_chunks(path: str | os.PathLike[str], info: FileInfo, chunks: list[list[bytes]]) -> None:
    """Write a file under a temporary name and rename it.

    Args:
        path: the file, replaced if it exists.
        info: the header; ``chunks`` in it has the first split and the first face of each chunk, and gets the rest.
        chunks: the parts of each chunk.

    Raises:
        OptionError: ``info.extra`` is nothing that JSON holds, or too much.
        OSError: the file cannot be written; nothing is left behind.
    """
    payloads = [b"".join(LENGTH.pack(len(part)) + part for part in parts) for parts in chunks]
    offset = 0
    for entry, payload in zip(info.chunks, payloads, strict=True):
        entry[2:] = [offset, len(payload), zlib.crc32(payload)]
        offset += len(payload)
    try:
        header = header_bytes(info)
    except ValueError as error:
        raise OptionError(f"extra: {error}") from error
    with replacing(Path(path)) as temporary, open(temporary, "xb") as file:
        file.write(MAGIC + HEADER.pack(len(header), zlib.crc32(header)) + header)
        file.writelines(payloads)
        # Zeros at the end, which take no space where the file system knows holes.
        file.truncate(max(file.tell(), min_file_bytes(info)))
        file.flush()
        os.fsync(file.fileno())


class ChunkFile:
    """An open file, of which chunks are read when they are asked for.

    It is read, not mapped into memory: one that another program cuts short meanwhile would end the process. Every chunk
    is checked after it has been copied, so that what is decoded is what was checked.

    Args:
        path: the file.

    Attributes:
        info: its header.
        size: its size in bytes when it was opened.

    Raises:
        ProgressiveFileError: it is no progressive mesh, damaged, or no regular file.
        OSError: it cannot be read.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = os.fsdecode(path)
        check_regular(path, ProgressiveFileError)
        self._file = os.fdopen(os.open(self.path, OPEN_FLAGS), "rb")
        try:
            found = os.fstat(self._file.fileno())
            if not stat.S_ISREG(found.st_mode):
                raise ProgressiveFileError(f"{self.path}: no regular file")
            self.size = found.st_size
            self.info = self._read_header()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> ChunkFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def _read_header(self) -> FileInfo:
        start = len(MAGIC) + HEADER.size
        if not self.size:
            raise ProgressiveFileError(f"{self.path}: the file is empty")
        first = self._read(0, min(start, self.size))
        if first[:7] != MAGIC[:7]:
            raise ProgressiveFileError(f"{self.path}: this is no progressive mesh")
        if first[: len(MAGIC)] != MAGIC:
            version = first[7:8].decode("latin-1")
            raise ProgressiveFileError(f"{self.path}: version {version!r} of the format is not known, only 1 is")
        if len(first) < start:
            raise ProgressiveFileError(f"{self.path}: the file ends in its header")
        length, crc = HEADER.unpack(first[len(MAGIC) :])
        if length > MAX_HEADER_BYTES or start + length > self.size:
            raise ProgressiveFileError(f"{self.path}: the file ends in its header, which is {length} bytes long")
        header = self._read(start, length)
        if zlib.crc32(header) != crc:
            raise ProgressiveFileError(f"{self.path}: the header is damaged (its CRC-32 does not fit)")
        self._data_start = start + length
        try:
            return parse_header(header)
        except ProgressiveFileError as error:
            raise ProgressiveFileError(f"{self.path}: {error}") from error

    def _read(self, start: int, length: int) -> bytes:
        self._file.seek(start)
        data = self._file.read(length)
        if len(data) < length:
            raise ProgressiveFileError(f"{self.path}: the file has become shorter while it was read")
        return data

    def parts(self, chunk: int) -> list[memoryview]:
        """The parts of a chunk.

        Raises:
            ProgressiveFileError: the file ends before it, or the chunk is damaged.
            OSError: it cannot be read.
        """
        _, _, offset, length, crc = self.info.chunks[chunk]
        start = self._data_start + offset
        if start + length > self.size:
            raise ProgressiveFileError(f"{self.path}: the file ends in chunk {chunk} of {len(self.info.chunks)}")
        data = memoryview(self._read(start, length))
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
