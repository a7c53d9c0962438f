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
MAX_ZEROS = 128 * 2**10

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

# A fan of seven faces in three frames, as the first version of the format was written at first (base64).
MADE_BEFORE = """
V1BRTUVTSDHVAAAAAAAAANlpI9R7InZlcnRleF9jb3VudCI6OCwiZmFjZV9jb3VudCI6NywiZnJhbWVfY291bnQiOjMsImJhc2VfdmVydGV4X2Nv
dW50IjozLCJiYXNlX2ZhY2VfY291bnQiOjEsInNwbGl0X2NvdW50Ijo1LCJyYW5rX2NvdW50Ijo4LCJjaHVua3MiOltbMCwwLDAsMjU0LDI5MzI3
ODQ0NThdLFswLDEsMjU0LDY4NSwxNDk5MDMxODY2XV0sImV4dHJhIjp7InRpbWVzIjpbMS4wLDIuMCwzLjBdfX0VAAAAAAAAACi1L/0gDGEAAAAB
AQAAAAAAAAAAABUAAAAAAAAAKLUv/SAMYQAAAAQCAAAAAAAAAAAAFQAAAAAAAAAotS/9IAxhAAAABAYAAAAAAAAAAAANAAAAAAAAACi1L/0gBCEA
AAAAAAANAAAAAAAAACi1L/0gBCEAAC+6OT51AAAAAAAAACi1L/0gbGEDAMGz+HdLh7x6cci5gV+BOoeG/MiSgRVltqExHptsbY3QcjeGY5uv4hSR
IUcA5Wg04l0iT+nhaLGJQCgBHiMPAczON6QMoD0Cbpr5Nw8AyK8Gr318ewAAAgAA8X18eAAA9fgAAHt9eAEA8/UAABkAAAAAAAAAKLUv/SAUhQAA
UAAD/wL9AAD/AP8BANgKEhkAAAAAAAAAKLUv/SAUhQAAUAQC/QICAAD/AAABANgKEhkAAAAAAAAAKLUv/SAUhQAAUAL/BvwCAP8A/wABANgKEhUA
AAAAAAAAKLUv/SAUZQAAMAECAQEBAAEAMigCLgAAAAAAAAAotS/9IEgtAQDYAAcCAPz/AP4EAAUCAPz8AAMBAAAAAP//AP8AAwA1MQAMZlbGGwAA
AAAAAAAotS/9IBiVAABgAgIB/AIDAAAA/wAAAQDhShIdAAAAAAAAACi1L/0gFKEAABME/f0A4opkZAASvYGBAD49PT0AHQAAAAAAAAAotS/9IBSh
AABYZHjRjHSc8GVD85Y2YUc+Pj8/P70AAAAAAAAAKLUv/SC0oQUATvH4eWTkvcPLdKZEBb9kJwL3RlmCPWb6RzJ0kGCCIwACWAACOLqCMUI+sf/5
Uey9QIZdGZQeSlkH58e1Foa60ejidiKD5+GzY8HiGwCengD0ZK/ifjAmLUInNxQXhAt5lQlfep7bWFMUmNEApGg3awBMswYdNDY3AABFAQCVM843
JJI0PwAEAgEBAAAAAAAAe30AAHgAAHUAAQB4AAAB9QAAAN94AAB2AAB2AHx4AHcAAXUAvQAAAAAAAAAotS/9ILShBQB2ODWmQijvn4TAfEO81/Zs
dKaNZUKw/MOqwL2gf1IHALIoAHJD/PBE9s8cuYO5ctybwwLXMMjY9K7PvXXMWkQh7GHsOhTyy9oxHD4zACcLALBhHVJwLHhex9sn+loEmOdFiroh
GAjjDTM9AiEmLgssAK9YC5xMNSUAADIDAH1lCxUvC0U+ARsAGPIAdwIAeAAAAHwAAO4AAPABAHkAAAEAAAQAAHkAAHcAAHcAAHkAAAABAAA=
"""

# What a file may say of its stage.
UNITS = {"up_axis": "Y", "metres_per_unit": 0.01, "time_codes_per_second": 24.0, "frames_per_second": 24.0}
NOTES = {"prim": "/Root/Mesh", "times": [1.0, 2.0, 3.0], "diagonal": 3.5, "stage": UNITS}


def packed(data: bytes) -> bytes:
    """Bytes as a part of a chunk holds them."""
    return zstandard.ZstdCompressor(level=9).compress(data)


def smallest_parts() -> list[bytes]:
    """The one chunk of `SMALLEST`."""
    return [packed(bytes(size)) for size in (4, 4, 0, 0, 4, 12)]


def zeros(size: int) -> bytes:
    """A frame of so many zeros, a 30 000th of them long; it says how many they are."""
    whole = (max(size, 1) - 1) // MAX_ZEROS
    rest = size - whole * MAX_ZEROS

    def block(length: int, is_last: int) -> bytes:
        """Of type 1, the byte and how often it stands there."""
        return (is_last | 1 << 1 | length << 3).to_bytes(3, "little") + b"\0"

    # Magic number, and a single segment with a size of 8 bytes (RFC 8878).
    return b"\x28\xb5\x2f\xfd\xe0" + size.to_bytes(8, "little") + block(MAX_ZEROS, 0) * whole + block(rest, 1)


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


def changed(good: Path, chunk: int, part: int, data: bytes) -> Path:
    """The file with another part in it."""
    header, chunks = read_file(good)
    chunks[chunk][part] = data
    return write_file(good.with_name("changed.wpqm"), header, chunks)
