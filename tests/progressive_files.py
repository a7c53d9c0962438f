"""Progressive files taken apart and put together again, with checksums that fit whatever is in them."""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import zstandard

from warpqem.progressive.container import HEADER, LENGTH, MAGIC

Header = dict[str, Any]
Chunks = list[list[bytes]]

# What unpacks to the most for its size: a run of one byte takes four bytes for each 128 KiB.
MOST_ZEROS = 128 * 2**10

# The smallest file there is: one vertex in one frame.
SMALLEST: Header = {
    "vertex_count": 1,
    "face_count": 0,
    "frame_count": 1,
    "base_vertex_count": 1,
    "base_face_count": 0,
    "split_count": 0,
    "rank_count": 1,
    "chunks": [[0, 0, 0, 0, 0]],
    "extra": {},
}


def packed(data: bytes) -> bytes:
    """Bytes as a part of a chunk holds them."""
    return zstandard.ZstdCompressor(level=9).compress(data)


def smallest_parts() -> list[bytes]:
    """The one chunk of `SMALLEST`."""
    return [packed(bytes(size)) for size in (4, 4, 0, 0, 4, 12)]


def zeros(size: int) -> bytes:
    """A frame of so many zeros, a 30 000th of them long; it says how many they are."""
    blocks = -(-size // MOST_ZEROS)
    sizes = [MOST_ZEROS] * (blocks - 1) + [size - MOST_ZEROS * (blocks - 1)]
    # Magic number; single segment with a size of 8 bytes; for each block its last-block flag, type 1 and size (RFC 8878).
    body = b"".join(
        (int(index == blocks - 1) | 1 << 1 | length << 3).to_bytes(3, "little") + b"\0"
        for index, length in enumerate(sizes)
    )
    return b"\x28\xb5\x2f\xfd\xe0" + size.to_bytes(8, "little") + body


def read_file(path: Path) -> tuple[Header, Chunks]:
    """The header of a file, and the parts of its chunks."""
    data = path.read_bytes()
    start = len(MAGIC) + HEADER.size
    length, _ = HEADER.unpack(data[len(MAGIC) : start])
    header = json.loads(data[start : start + length])
    chunks = []
    for _, _, offset, size, _ in header["chunks"]:
        at, parts = start + length + offset, []
        end = at + size
        while at < end:
            (part,) = LENGTH.unpack(data[at : at + LENGTH.size])
            parts.append(data[at + LENGTH.size : at + LENGTH.size + part])
            at += LENGTH.size + part
        chunks.append(parts)
    return header, chunks


def payload(parts: Sequence[bytes]) -> bytes:
    """A chunk."""
    return b"".join(LENGTH.pack(len(part)) + part for part in parts)


def with_table(header: Header, chunks: Chunks) -> Header:
    """The header with offset, length and CRC-32 of each chunk."""
    table, offset = [], 0
    for entry, parts in zip(header["chunks"], chunks, strict=True):
        data = payload(parts)
        table.append([*entry[:2], offset, len(data), zlib.crc32(data)])
        offset += len(data)
    return {**header, "chunks": table}


def file_bytes(header: bytes | Header, chunks: Chunks) -> bytes:
    """A file of a header, as it is, and chunks."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return MAGIC + HEADER.pack(len(text), zlib.crc32(text)) + text + b"".join(map(payload, chunks))


def write_file(path: Path, header: Header, chunks: Chunks) -> Path:
    """A file whose chunks are where the header says."""
    path.write_bytes(file_bytes(with_table(header, chunks), chunks))
    return path
