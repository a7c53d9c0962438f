"""Lossless coding of trajectories and indices: what a prediction misses, byte by byte, through an entropy coder.

A float's bits, read as an integer, grow with its value, so that the difference of two such integers is small where a
prediction is good. The first bytes of small differences are all zero, and zstandard finds that once equal bytes stand
together. Predictions are float32 sums and products that every machine rounds alike.
"""

from __future__ import annotations

import numpy as np
import zstandard

from warpqem.errors import ProgressiveFileError

__all__ = ["decode_splits", "decode_tracks", "encode_splits", "encode_tracks", "pack", "split_ratios", "unpack"]

# Beyond this level zstandard takes twice the time for a thousandth of the size.
LEVEL = 9


def pack(values: np.ndarray) -> bytes:
    """Bytes of 32-bit numbers, equal places together, compressed."""
    planes = np.ascontiguousarray(values).view(np.uint8).reshape(-1, 4).T
    return zstandard.ZstdCompressor(level=LEVEL).compress(np.ascontiguousarray(planes).tobytes())


def unpack(data: bytes | memoryview, count: int, dtype: type = np.int32) -> np.ndarray:
    """``count`` 32-bit numbers.

    Raises:
        ProgressiveFileError: the data is damaged, or holds another number of them.
    """
    try:
        planes = zstandard.ZstdDecompressor().decompress(bytes(data), max_output_size=max(1, 4 * count))
    except zstandard.ZstdError as error:
        raise ProgressiveFileError(f"compressed data is damaged ({error})") from error
    if len(planes) != 4 * count:
        raise ProgressiveFileError(f"{len(planes)} bytes where {4 * count} belong")
    values: np.ndarray = np.frombuffer(planes, dtype=np.uint8).reshape(4, -1).T.copy().view(dtype).ravel()
    return values


def encode_tracks(points: np.ndarray) -> bytes:
    """Trajectories (n, F, 3) float32: each frame predicted by the one before."""
    return pack(_residual(points, _before(points)))


def decode_tracks(data: bytes | memoryview, count: int, frame_count: int) -> np.ndarray:
    """What :func:`encode_tracks` coded."""
    residual = unpack(data, count * frame_count * 3).reshape(count, frame_count, 3)
    points = np.empty(residual.shape, dtype=np.float32)
    before = np.zeros((count, 3), dtype=np.float32)
    for t in range(frame_count):
        points[:, t] = before = _restore(residual[:, t], before)
    return points


def split_ratios(parent: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(n,) float32, by how much the second vertex of a split goes against the first, least squares over frames."""
    a, b = (x.astype(np.float64) - parent for x in (first, second))
    length = (a * a).sum(axis=(1, 2))
    ratio = np.divide(-(a * b).sum(axis=(1, 2)), length, out=np.zeros(len(a)), where=length > 0)
    return np.clip(ratio, -1e6, 1e6).astype(np.float32)


def encode_splits(parent: np.ndarray, first: np.ndarray, second: np.ndarray, ratio: np.ndarray) -> tuple[bytes, bytes]:
    """Trajectories (n, F, 3) float32 of the two vertices of each split.

    The first is predicted by its parent and by how it lay to it in the frame before; the second by the first one's
    mirror image about the parent, ``ratio`` times as far, corrected likewise.
    """
    guess = _mirrored(parent, first, ratio)
    return (
        pack(_residual(first, _follow(parent, _before(parent), _before(first)))),
        pack(_residual(second, _follow(guess, _before(guess), _before(second)))),
    )


def decode_splits(
    data: tuple[np.ndarray, np.ndarray], parent: np.ndarray, ratio: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What :func:`encode_splits` coded, from unpacked residuals (n, F, 3) int32."""
    first = _decode_following(data[0], parent)
    return first, _decode_following(data[1], _mirrored(parent, first, ratio))


def _decode_following(residual: np.ndarray, guide: np.ndarray) -> np.ndarray:
    points = np.empty(residual.shape, dtype=np.float32)
    guide_before, before = np.zeros_like(guide[:, 0]), np.zeros_like(guide[:, 0])
    for t in range(residual.shape[1]):
        points[:, t] = _restore(residual[:, t], _follow(guide[:, t], guide_before, before))
        guide_before, before = guide[:, t], points[:, t]
    return points


def _follow(guide: np.ndarray, guide_before: np.ndarray, before: np.ndarray) -> np.ndarray:
    """A point that lies to its guide as in the frame before."""
    return guide + (before - guide_before)


def _mirrored(parent: np.ndarray, first: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    away = ratio[:, None, None] * (first - parent)
    guess: np.ndarray = parent - away
    return guess


def _before(points: np.ndarray) -> np.ndarray:
    """The frame before of each frame; zeros before the first one."""
    shifted = np.zeros_like(points)
    shifted[:, 1:] = points[:, :-1]
    return shifted


def _ordered(values: np.ndarray) -> np.ndarray:
    """Integers (int32) in the order of float32 numbers, and back: the same operation, on bits."""
    bits = values.view(np.int32)
    return bits ^ ((bits >> 31) & np.int32(0x7FFFFFFF))


def _residual(values: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """What a prediction misses, its sign in the lowest bit."""
    with np.errstate(over="ignore"):
        missed = _ordered(values) - _ordered(_finite(predicted))
        return (missed << 1) ^ (missed >> 31)


def _restore(residual: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        missed = ((residual >> 1) & np.int32(0x7FFFFFFF)) ^ -(residual & 1)
        bits = missed + _ordered(_finite(predicted))
    values: np.ndarray = (bits ^ ((bits >> 31) & np.int32(0x7FFFFFFF))).view(np.float32)
    return values


def _finite(predicted: np.ndarray) -> np.ndarray:
    """Sums past the range of float32 predict nothing."""
    return np.where(np.isfinite(predicted), predicted, np.float32(0.0))
