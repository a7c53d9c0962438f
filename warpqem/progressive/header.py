"""The header of a progressive mesh: what it says, and what it may say.

Everything in it is checked when it is read, types and ranges first, so that what comes after may rely on it.
"""

from __future__ import annotations

import json
import math
import reprlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any, NoReturn

from warpqem.errors import ProgressiveFileError

__all__ = ["MAX_FACES_PER_SPLIT", "MAX_HEADER_BYTES", "FileInfo", "header_bytes", "parse_header"]

# A header lists chunks of thousands of splits and a time for each frame; one longer than this is none.
MAX_HEADER_BYTES = 64 * 2**20
# Lists and objects in each other. Python's own limit is in the stack of whoever reads or writes them.
MAX_NESTED = 64
# Digits of an integer: 64 bits have 20. Python takes quadratic time for long ones.
MAX_DIGITS = 20
# Faces that a split brings at most: two, and their backs where faces lie on both sides of the same vertices.
MAX_FACES_PER_SPLIT = 4
# First split, first face, offset, length, CRC-32.
CHUNK_FIELDS = 5


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

    def loaded_counts(self, chunk_count: int) -> tuple[int, int]:
        """Splits and faces of the first chunks together; none at all has neither."""
        if chunk_count < len(self.chunks):
            return self.chunks[chunk_count][0], self.chunks[chunk_count][1]
        return self.split_count, self.face_count


def header_bytes(info: FileInfo) -> bytes:
    """The header as it stands in a file.

    Raises:
        ValueError: ``extra`` is nothing that :func:`parse_header` would read; the message says why.
    """
    if not isinstance(info.extra, dict):
        raise ValueError(f"{type(info.extra).__name__} where a dictionary belongs")
    try:
        text = json.dumps(vars(info), separators=(",", ":"), allow_nan=False)
        header = text.encode()
        if len(header) > MAX_HEADER_BYTES:
            raise ValueError(f"{len(header)} bytes of JSON, {MAX_HEADER_BYTES} are the most")
        _parse_json(header)
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(str(error)) from error
    return header


def parse_header(header: bytes) -> FileInfo:
    """Read and check a header.

    Raises:
        ProgressiveFileError: it says nothing that a file could hold.
    """
    try:
        entries = _parse_json(header)
    except (ValueError, RecursionError) as error:
        raise ProgressiveFileError(f"the header cannot be read ({error})") from error
    names = {one.name for one in fields(FileInfo)}
    if not isinstance(entries, dict) or not names - {"extra"} <= set(entries) <= names:
        found = list(entries) if isinstance(entries, dict) else entries
        raise ProgressiveFileError(f"the header cannot be read (it holds {reprlib.repr(found)})")
    info = FileInfo(**entries)
    _check_counts(info)
    _check_chunks(info)
    return info


def _parse_json(header: bytes) -> Any:
    """JSON (RFC 8259) without what a reader could take in two ways, or not at all."""
    value = json.loads(
        header.decode("utf-8"),
        object_pairs_hook=_object,
        parse_int=_integer,
        parse_float=_number,
        parse_constant=_no_number,
    )
    for depth, text in _texts(value):
        if depth > MAX_NESTED:
            raise ValueError(f"lists and objects nested more than {MAX_NESTED} deep")
        # Half a pair of surrogates is no text: no file, path or terminal takes it.
        text.encode("utf-8")
    return value


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        twice = Counter(key for key, _ in pairs).most_common(1)[0][0]
        raise ValueError(f"{reprlib.repr(twice)} is there twice")
    return found


def _integer(text: str) -> int:
    if len(text) > MAX_DIGITS:
        raise ValueError(f"an integer of {len(text)} digits")
    return int(text)


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        _no_number(text)
    return value


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{reprlib.repr(text)} is no number")


def _texts(value: Any) -> Iterator[tuple[int, str]]:
    """Each string, key and container of a JSON value with its depth, containers as empty strings."""
    waiting = [(0, value)]
    while waiting:
        depth, value = waiting.pop()
        if isinstance(value, str):
            yield depth, value
        elif isinstance(value, (dict, list)):
            yield depth + 1, ""
            inner = [*value, *value.values()] if isinstance(value, dict) else value
            waiting += [(depth + 1, one) for one in inner if isinstance(one, (str, dict, list))]


def _is_count(value: object, end: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < end


def _check_counts(info: FileInfo) -> None:
    counts = {name: value for name, value in vars(info).items() if name.endswith("_count")}
    for name, value in counts.items():
        if not _is_count(value, 2**31):
            raise ProgressiveFileError(f"{name} {reprlib.repr(value)} is no count")
    fits = (
        info.frame_count > 0
        and info.base_vertex_count > 0
        and info.rank_count == info.base_vertex_count + info.split_count <= info.vertex_count
        and info.base_face_count <= info.face_count <= info.base_face_count + MAX_FACES_PER_SPLIT * info.split_count
        and info.row_count < 2**31
        and isinstance(info.extra, dict)
    )
    if not fits:
        raise ProgressiveFileError(f"the counts in the header contradict each other: {counts}")


def _check_chunks(info: FileInfo) -> None:
    shape = isinstance(info.chunks, list) and all(
        isinstance(chunk, list) and len(chunk) == CHUNK_FIELDS and all(_is_count(n, 2**63) for n in chunk)
        for chunk in info.chunks
    )
    if not shape or not info.chunks:
        raise ProgressiveFileError("the list of chunks in the header cannot be read")
    starts = [chunk[0] for chunk in info.chunks[1:]]
    faces = [chunk[1] for chunk in info.chunks]
    if (
        starts != sorted(set(starts))
        or faces != sorted(faces)
        or (bool(starts) and (starts[0] != 0 or starts[-1] >= info.split_count))
        or (not starts and (info.split_count > 0 or info.face_count > info.base_face_count))
        or (len(faces) > 1 and faces[1] != info.base_face_count)
        or info.chunks[0][:2] != [0, 0]
        or faces[-1] > info.face_count
    ):
        raise ProgressiveFileError("the chunks in the header are out of order")
    # Chunks that share bytes would unpack them again and again.
    end = 0
    for index, (_, _, offset, length, _) in enumerate(info.chunks):
        if offset != end:
            raise ProgressiveFileError(f"chunk {index} begins at byte {offset}, the one before ends at {end}")
        end += length
