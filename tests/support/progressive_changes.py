"""Random changes of what a progressive file holds, and of its bytes."""

from __future__ import annotations

import random
import re
from typing import Any

import numpy as np
import zstandard

from tests.support.progressive_files import SMALLEST, Chunks, Header, file_bytes, packed, zeros

INTEGERS = [0, 1, -1, 2, 3, 255, 2**15, 2**24, 2**31 - 1, 2**31, -(2**31), 2**32, 2**63 - 1, 2**63, 2**64, 10**30]
VALUES = [*INTEGERS, True, None, "", "1", 1.0, 0.5, -0.0, 1e308, [], {}, [0], {"a": 0}, [[]], "\ud800", "x" * 5000]
FLOAT_BITS = [0x7FC00000, -0x400000, 0x7F800000, -0x800000, 0x7F7FFFFF, 1, -(2**31), 0x3F800000]
PATHS = [
    "",
    "/",
    "A",
    "/A.points",
    "/A/../B",
    "../A",
    "/A{v=x}B",
    "/1",
    "/A" * 3000,
    "/__Prototype_1",
    "/A b",
    "/a[/b]",
]
TIMES = [1e300, -1e300, 5e-324, 0.0, 2**53, 10**19, "1", None, True, [1.0], -1.0, 1e16]
# JSON that Python reads though it is none, or that reads differently elsewhere.
TEXTS = [
    "NaN",
    "Infinity",
    "-Infinity",
    "1e999",
    "9" * 5000,
    "[" * 5000,
    '{"a":' * 5000,
    '"\\ud800"',
    "-0",
    "1E400",
    "",
]


# Changes of what a file holds.


def _change_bits(draw: random.Random, header: Header, chunks: Chunks) -> None:
    """Bits of a compressed part."""
    parts = draw.choice(chunks)
    index = draw.randrange(len(parts))
    data = bytearray(parts[index])
    for _ in range(draw.choice([1, 1, 3, 20]) if data else 0):
        data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
    parts[index] = bytes(data)


def change_numbers(draw: random.Random, header: Header, chunks: Chunks) -> None:
    """Numbers of a part, as they are coded."""
    parts = draw.choice(chunks)
    index = draw.randrange(len(parts))
    try:
        # Not those that are bombs already.
        if not 0 <= zstandard.frame_content_size(parts[index]) < 2**20:
            return
        data = zstandard.ZstdDecompressor().decompress(parts[index])
    except zstandard.ZstdError:
        return
    values = np.frombuffer(data, np.uint8).reshape(4, -1).T.copy().view(np.int32).ravel()
    for _ in range(draw.choice([1, 1, 2, 10])):
        if len(values):
            kind, place = draw.randrange(4), draw.randrange(len(values))
            if kind == 0:
                values[place] = draw.choice(FLOAT_BITS)
            elif kind == 1:
                values[place] = draw.randrange(-(2**31), 2**31)
            elif kind == 2:
                values[place] ^= draw.choice([1, 2, 3, 8])
            else:
                other = draw.randrange(len(values))
                values[[place, other]] = values[[other, place]]
    if draw.random() < 0.2:
        values = np.resize(values, draw.choice([0, len(values) // 2, len(values) + 1, 2 * len(values)]))
    parts[index] = packed(np.ascontiguousarray(values.view(np.uint8).reshape(-1, 4).T).tobytes())


def _replace_by_bomb(draw: random.Random, header: Header, chunks: Chunks) -> None:
    """A part that unpacks to much more, or to an unknown size."""
    parts = draw.choice(chunks)
    kind = draw.randrange(5)
    size = draw.choice([2**20, 2**28, 2**31, 2**32])
    if kind == 0:
        bomb = zeros(size)
    elif kind == 1:
        bomb = (
            b"\x28\xb5\x2f\xfd\xe0"
            + draw.choice([2**60, 2**63, 2**64 - 1, 2**64 - 2, 4]).to_bytes(8, "little")
            + b"\1\0\0"
        )
    elif kind == 2:
        # No size, and a window of up to 3.75 TiB, then zeros.
        bomb = b"\x28\xb5\x2f\xfd\x00" + bytes([draw.randrange(256)]) + zeros(2**24)[13:]
    elif kind == 3:
        compressor = zstandard.ZstdCompressor(level=1).compressobj()
        bomb = compressor.compress(bytes(draw.choice([0, 4, 12, 2**22]))) + compressor.flush()
    else:
        # A frame to skip, and one after another.
        bomb = b"\x50\x2a\x4d\x18" + draw.choice([0, 4, 2**31]).to_bytes(4, "little") + parts[0] + parts[-1]
    parts[draw.randrange(len(parts))] = bomb


def _grow_in_accord(draw: random.Random, header: Header, chunks: Chunks) -> None:
    """Counts that fit together, and streams of zeros as long as they say."""
    # What a file may unpack to is found on both sides of; many frames within it take seconds.
    factor, kind = draw.choice([2, 100, 10**6, 10**7, 10**9]), draw.randrange(3)
    if any(type(header.get(name)) is not int for name in SMALLEST if name.endswith("_count")):
        return
    if kind == 0:
        header["frame_count"] = frames = header["frame_count"] * factor
        rows = [header["base_vertex_count"]] + [
            stop - start for start, stop in _splits_of_chunks(header) if stop > start >= 0
        ]
        for parts, count in zip(chunks, rows, strict=False):
            for index in range(5 if len(parts) == 6 else 8, len(parts)):
                parts[index] = zeros(min(12 * count * frames, 2**31))
        if draw.random() < 0.5:
            # Few enough that the file stays small: a longer one accounts for a mesh that takes seconds.
            header["extra"]["times"] = list(range(min(frames, 2000)))
    elif kind == 1:
        header["vertex_count"] = draw.choice([2**31 - 1, header["vertex_count"] * factor])
    else:
        header["base_face_count"] += factor
        header["face_count"] += factor
        for entry in header["chunks"][1:]:
            entry[1] += factor
        chunks[0][2:4] = zeros(12 * factor), zeros(4 * factor)


def _splits_of_chunks(header: Header) -> list[tuple[int, int]]:
    starts = [entry[0] for entry in header["chunks"][1:]]
    return list(zip(starts, [*starts[1:], header["split_count"]], strict=False))


def _change_field(draw: random.Random, header: Header, chunks: Chunks) -> None:
    """An entry of the header, but for those that other changes look into."""
    name = draw.choice([name for name in header if name not in ("chunks", "extra")])
    kind = draw.randrange(5)
    if kind == 0:
        del header[name]
    elif kind == 1:
        header[draw.choice(["more", "", "vertexCount", "x" * 10**5])] = draw.choice(VALUES)
    elif kind == 2 and type(header[name]) is int:
        header[name] += draw.choice([1, -1, 2])
    elif kind == 3:
        header[name] = draw.choice(INTEGERS)
    else:
        header[name] = draw.choice(VALUES)


def _swap_chunks(draw: random.Random, header: Header, chunks: Chunks) -> None:
    kind = draw.randrange(5)
    one, other = draw.randrange(len(chunks)), draw.randrange(len(chunks))
    if kind == 0:
        chunks[one], chunks[other] = chunks[other], chunks[one]
    elif kind == 1:
        chunks[one] = list(chunks[other])
    elif kind == 2 and len(chunks[one]) > 1:
        draw.shuffle(chunks[one])
    elif kind == 3:
        chunks[one] = chunks[one] * draw.choice([0, 2, 1000])
    else:
        chunks[one] = [*chunks[one][: draw.randrange(len(chunks[one]) + 1)], b""]
    if not all(chunks):
        chunks[one] = [b""]


def _repeat_chunks(draw: random.Random, header: Header, chunks: Chunks) -> None:
    """More entries of the table, each for a chunk like one before."""
    index = draw.randrange(len(chunks))
    for _ in range(draw.choice([1, 2, 200])):
        header["chunks"].append(list(header["chunks"][index % len(header["chunks"])]))
        chunks.append(list(chunks[index]))
        if draw.random() < 0.8:
            header["chunks"][-1][0] += len(chunks)


def change_extra(draw: random.Random, header: Header, chunks: Chunks) -> None:
    extra = header["extra"]
    kind = draw.randrange(7)
    if kind == 0:
        extra[draw.choice(["prim", "times", "diagonal", "stage", "more"])] = draw.choice(VALUES)
    elif kind == 1:
        extra["prim"] = draw.choice(PATHS)
    elif kind == 2 and isinstance(extra.get("times"), list) and extra["times"]:
        extra["times"][draw.randrange(len(extra["times"]))] = draw.choice(TIMES)
    elif kind == 3 and isinstance(extra.get("times"), list):
        draw.shuffle(extra["times"])
        extra["times"] = extra["times"] * draw.choice([1, 2, 0])
    elif kind == 4 and isinstance(extra.get("stage"), dict) and extra["stage"]:
        extra["stage"][draw.choice(list(extra["stage"]))] = draw.choice([*VALUES, *TIMES, "X", "y", "Z"])
    elif kind == 5 and extra:
        del extra[draw.choice(list(extra))]
    else:
        deep: Any = 0
        for _ in range(draw.choice([10, 60, 70, 400])):
            deep = [deep] if draw.random() < 0.5 else {"a": deep}
        extra["deep"] = deep


def change_table(draw: random.Random, header: Header) -> None:
    """Entries of the table of chunks, without a look at where these are."""
    table = header["chunks"]
    entry = draw.choice(table)
    kind = draw.randrange(5)
    if kind == 0:
        entry[draw.randrange(5)] = draw.choice(VALUES)
    elif kind == 1:
        entry[2:] = draw.choice(table)[2:]
    elif kind == 2:
        table *= draw.choice([2, 1000])
    elif kind == 3:
        table[draw.randrange(len(table))] = draw.choice(VALUES)
    else:
        entry[draw.randrange(2, 4)] += draw.choice([1, -1, 8, 2**40])


# Changes of the bytes of a file.


def _damage(draw: random.Random, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(draw.choice([1, 1, 5])):
        changed[draw.randrange(draw.choice([24, len(data)]))] ^= 1 << draw.randrange(8)
    return bytes(changed)


def _cut(draw: random.Random, data: bytes) -> bytes:
    return data[: draw.choice([draw.randrange(64), draw.randrange(len(data)), len(data) - 1])]


def _prolong(draw: random.Random, data: bytes) -> bytes:
    return data + draw.choice([b"\0", data, draw.randbytes(300)])


def _change_text(draw: random.Random, data: bytes) -> bytes:
    """The text of the header, as it stands there."""
    length = int.from_bytes(data[8:16], "little")
    text = data[20 : 20 + length].decode(errors="replace")
    found = list(re.finditer(r'-?[\d.]+(?:e-?\d+)?|"\w*"|[\[\]{},:]', text))
    for _ in range(draw.choice([1, 1, 3])):
        token = draw.choice(found)
        new = draw.choice([*TEXTS, token[0] * 2, draw.choice(found)[0], text[: token.start()]])
        text = text[: token.start()] + new + text[token.end() :]
    encoded = text.encode(draw.choice(["utf-8", "utf-8", "utf-8", "utf-8", "utf-16"]))
    return file_bytes(encoded, []) + data[20 + length :]


CHANGES = [
    _change_bits,
    change_numbers,
    change_numbers,
    change_numbers,
    _replace_by_bomb,
    _grow_in_accord,
    _change_field,
    _change_field,
    _swap_chunks,
    _repeat_chunks,
    change_extra,
    change_extra,
]
LAST_CHANGES = [_damage, _cut, _prolong, _change_text, _change_text]
ALL_CHANGES = [*CHANGES, *CHANGES, *LAST_CHANGES]
