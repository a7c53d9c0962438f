"""The memory that a file may take: a multiple of its own size.

Compressed data says little about what it unpacks to: 66 KB of zstandard hold 2 GiB of zeros, and counts in a header
cost nothing at all. So what a file unpacks to is computed from its counts before anything is allocated, and held
against its size. Files that are written here are long enough for that (:func:`min_file_bytes`).
"""

from __future__ import annotations

from warpqem.errors import ProgressiveFileError
from warpqem.progressive.header import FileInfo
from warpqem.runtime.memory import available_memory, format_bytes, parse_bytes

__all__ = ["check_memory", "min_file_bytes", "unpacked_bytes"]

# Any file may unpack to this much, which every machine has: a short clip of a mesh at rest compresses without end.
FREE_BYTES = 64 * 2**20
# Beyond that, bytes in memory for each byte of the file. Meshes in motion take 1 to 10, those that rest in 99 of 100
# frames about 200.
MAX_RATIO = 256

# Bytes of the arrays of a loaded mesh beside its points: for each row its input vertex, ranks from and to, and the
# split that ends it, twice; for each split its parent, error and face count; for each face three ranks, index and
# split; for each input vertex its entry of a vertex map.
ROW_BYTES, SPLIT_BYTES, FACE_BYTES, VERTEX_BYTES = 20, 16, 20, 4


def unpacked_bytes(info: FileInfo, chunk_count: int | None = None) -> int:
    """Bytes of a loaded mesh.

    Args:
        info: the header.
        chunk_count: chunks that are loaded; None for all.
    """
    split_count, face_count = info.loaded_counts(len(info.chunks) if chunk_count is None else chunk_count)
    rows = info.base_vertex_count + 2 * split_count
    return (
        (12 * info.frame_count + ROW_BYTES) * rows
        + SPLIT_BYTES * split_count
        + FACE_BYTES * face_count
        + VERTEX_BYTES * info.vertex_count
    )


def min_file_bytes(info: FileInfo) -> int:
    """The size of a file from which all of it is loaded without a word about memory."""
    needed = unpacked_bytes(info)
    return 0 if needed <= FREE_BYTES else -(-needed // MAX_RATIO)


def check_memory(path: str, info: FileInfo, chunk_count: int, file_bytes: int, memory: int | str | None = None) -> None:
    """Refuse to load what the size of the file does not account for, or what is not free.

    Args:
        path: named in messages.
        info: the header.
        chunk_count: chunks that are going to be loaded.
        file_bytes: size of the file.
        memory: what loading may take, in bytes or as text such as "8G"; None for what the size of the file allows.

    Raises:
        ProgressiveFileError: it is too much.
        OptionError: ``memory`` is no number of bytes.
    """
    needed = unpacked_bytes(info, chunk_count)
    split_count, face_count = info.loaded_counts(chunk_count)
    what = (
        f"{path}: {info.base_vertex_count + 2 * split_count} vertices in {info.frame_count} frames with {face_count} "
        f"faces take {format_bytes(needed)}"
    )
    free = available_memory("cpu")
    if free is not None and needed > free:
        raise ProgressiveFileError(f"{what}, {format_bytes(free)} of memory are free")
    if memory is not None:
        limit = parse_bytes(memory)
        if needed > limit:
            raise ProgressiveFileError(f"{what}, more than the {format_bytes(limit)} that memory allows")
    elif needed > max(FREE_BYTES, MAX_RATIO * file_bytes):
        raise ProgressiveFileError(
            f"{what}, more than a file of {file_bytes} bytes may without being trusted ({format_bytes(FREE_BYTES)}, or "
            f"{MAX_RATIO} times its size); where it is trusted, say how much with memory (--memory)"
        )
