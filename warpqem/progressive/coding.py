"""Lossless coding of trajectories and indices: what a prediction misses, byte by byte, through an entropy coder.

A float's bits, read as an integer, grow with its value, so that the difference of two such integers is small where a
prediction is good. The first bytes of small differences are all zero, and zstandard finds that once equal bytes stand
together. Predictions are float32 sums and products that every machine rounds alike.
"""

from __future__ import annotations

import math

import numpy as np
import zstandard

from warpqem.errors import ProgressiveFileError

__all__ = [
    "LARGEST_RATIO",
    "Residuals",
    "decode_splits",
    "decode_tracks",
    "encode_splits",
    "encode_tracks",
    "pack",
    "restore_tracks",
    "split_ratios",
    "unpack",
]

# Beyond this level zstandard takes twice the time for a thousandth of the size.
LEVEL = 9
# A second vertex that goes farther than this against the first is not predicted by it.
LARGEST_RATIO = 1e6


def pack(values: np.ndarray) -> bytes:
    """Bytes of 32-bit numbers, equal places together, compressed."""
    planes = np.ascontiguousarray(values).view(np.uint8).reshape(-1, 4).T
    return zstandard.ZstdCompressor(level=LEVEL).compress(np.ascontiguousarray(planes).tobytes())


def unpack(data: bytes | memoryview, count: int, dtype: type = np.int32) -> np.ndarray:
    """``count`` 32-bit numbers.

    Raises:
        ProgressiveFileError: the data is damaged, or holds another number of them.
    """
    return Residuals(data, count).rows(slice(None)).view(dtype)


class Residuals:
    """Rows of 32-bit numbers that still lie byte by byte: those that are asked for are put together.

    Args:
        data: what :func:`pack` made of them.
        shape: rows, and what is in each.

    Raises:
        ProgressiveFileError: the data is damaged, or holds another number of them.
    """

    def __init__(self, data: bytes | memoryview, *shape: int) -> None:
        self._shape = shape[1:]
        self._planes = np.frombuffer(_decompress(data, 4 * math.prod(shape)), dtype=np.uint8).reshape(
            4, shape[0], math.prod(shape[1:])
        )

    def rows(self, chosen: slice | np.ndarray) -> np.ndarray:
        """Some of the rows, int32."""
        planes = self._planes[:, chosen]
        values = np.empty((*planes.shape[1:], 4), dtype=np.uint8)
        for place, plane in enumerate(planes):
            values[..., place] = plane
        return values.view(np.int32).reshape(planes.shape[1], *self._shape)


def _decompress(data: bytes | memoryview, size: int) -> bytes:
    """Exactly so many bytes. The size that the frame names is checked first: unpacking allocates it at once."""
    try:
        said = zstandard.frame_content_size(data)
        if said != size:
            found = "data of unknown size" if said < 0 else f"{said} bytes"
            raise ProgressiveFileError(f"{found} where {size} belong")
        values = zstandard.ZstdDecompressor().decompress(data, max_output_size=max(1, size), allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise ProgressiveFileError(f"compressed data is damaged ({error})") from error
    if len(values) != size:
        raise ProgressiveFileError(f"{len(values)} bytes where {size} belong")
    return values


def encode_tracks(points: np.ndarray) -> bytes:
    """Trajectories (n, F, 3) float32: each frame predicted by the one before."""
    return pack(_residual(points, _before(points)))


def decode_tracks(data: bytes | memoryview, count: int, frame_count: int) -> np.ndarray:
    """What :func:`encode_tracks` coded."""
    return restore_tracks(Residuals(data, count, frame_count, 3).rows(slice(None)))


def restore_tracks(residual: np.ndarray) -> np.ndarray:
    """Finite trajectories (n, F, 3) float32 from what their predictions miss, int32.

    The frame before predicts, and is finite, so that the bits are sums over time. Where it is not, a number that is not
    finite comes out, for the caller to refuse.
    """
    return _from_ordered(np.cumsum(_signed(residual), axis=1, dtype=np.int32))


def split_ratios(parent: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(n,) float32, by how much the second vertex of a split goes against the first, least squares over frames."""
    a, b = (x.astype(np.float64) - parent for x in (first, second))
    length = (a * a).sum(axis=(1, 2))
    ratio = np.divide(-(a * b).sum(axis=(1, 2)), length, out=np.zeros(len(a)), where=length > 0)
    return np.clip(ratio, -LARGEST_RATIO, LARGEST_RATIO).astype(np.float32)


def encode_splits(parent: np.ndarray, first: np.ndarray, second: np.ndarray, ratio: np.ndarray) -> tuple[bytes, bytes]:
    """Trajectories (n, F, 3) float32 of the two vertices of each split.

    The first is predicted by its parent and by how it lay to it in the frame before; the second by the first one's
    mirror image about the parent, ``ratio`` times as far, corrected likewise.
    """
    # What overflows predicts nothing.
    with np.errstate(over="ignore", invalid="ignore"):
        guess = _mirrored(parent, first, ratio)
        return (
            pack(_residual(first, _follow(parent, _before(parent), _before(first)))),
            pack(_residual(second, _follow(guess, _before(guess), _before(second)))),
        )


def decode_splits(
    data: tuple[np.ndarray, np.ndarray], parent: np.ndarray, ratio: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What :func:`encode_splits` coded, from unpacked residuals (n, F, 3) int32."""
    with np.errstate(over="ignore", invalid="ignore"):
        first = _decode_following(data[0], parent)
        return first, _decode_following(data[1], _mirrored(parent, first, ratio))


def _decode_following(residual: np.ndarray, guide: np.ndarray) -> np.ndarray:
    # What belongs to one frame lies together while it is restored from the frame before.
    missed = np.ascontiguousarray(_signed(residual).transpose(1, 0, 2))
    guide = guide.transpose(1, 0, 2)
    points = np.empty(missed.shape, dtype=np.float32)
    guide_before = before = np.zeros(points.shape[1:], dtype=np.float32)
    for t, frame in enumerate(points):
        predicted = _finite(_follow(guide[t], guide_before, before))
        frame[...] = _from_ordered(missed[t] + _ordered(predicted))
        guide_before, before = guide[t], frame
    return points.transpose(1, 0, 2)


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
    """Integers (int32) in the order of float32 numbers."""
    return _flipped(values.view(np.int32))


def _from_ordered(order: np.ndarray) -> np.ndarray:
    """The numbers, float32, of such integers."""
    values: np.ndarray = _flipped(order).view(np.float32)
    return values


def _flipped(bits: np.ndarray) -> np.ndarray:
    """Sign and magnitude to two's complement, and back: the same operation."""
    flipped: np.ndarray = bits ^ ((bits >> 31) & np.int32(0x7FFFFFFF))
    return flipped


def _residual(values: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """What a prediction misses, its sign in the lowest bit."""
    with np.errstate(over="ignore"):
        missed = _ordered(values) - _ordered(_finite(predicted))
        return (missed << 1) ^ (missed >> 31)


def _signed(residual: np.ndarray) -> np.ndarray:
    """What :func:`_residual` made of a difference, back."""
    missed: np.ndarray = ((residual >> 1) & np.int32(0x7FFFFFFF)) ^ -(residual & 1)
    return missed


def _finite(predicted: np.ndarray) -> np.ndarray:
    """Sums past the range of float32 predict nothing."""
    return np.where(np.isfinite(predicted), predicted, np.float32(0.0))
