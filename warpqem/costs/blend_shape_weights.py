"""Quadric scales for a neutral shape and its morph targets: what moves more keeps more detail.

"Surface simplification guided by morph-targets" (Berner & Rieger 2006) puts the distances between shapes in the place
of the paint of user-guided simplification (Kho & Garland 2003): those of a vertex between the neutral shape and every
target add up, ``DS = sum |target - neutral|`` (equation 8); the third of the vertices with the least of it has its
quadrics scaled by 0.33, the middle one by 0.66, the last by 1 (table 1). The other ways are what that paper leaves for
later: functions of the rank or of the distance itself, and of how far an animation really moves the targets.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from warpqem.arguments.array_input import FLOAT32_MAX, finite_array, first_beyond, real_array
from warpqem.arguments.array_types import ArrayInput, Points
from warpqem.arguments.number_input import shown
from warpqem.errors import MeshShapeError, OptionError
from warpqem.frames.blocks import frame_blocks
from warpqem.frames.checked_frames import check_source
from warpqem.frames.stream import ArrayFrames, FrameSource, read_ahead

__all__ = ["MIN_SCALE", "MORPH_METHODS", "morph_distances", "morph_weights"]

MORPH_METHODS = ("thirds", "rank", "distance", "usage")

# Scales of the paper's three groups, from the least moved to the most.
THIRDS = (0.33, 0.66, 1.0)
# Where scales grow linearly they start here, at the paper's least.
MIN_SCALE = THIRDS[0]

WeightFunction = Callable[[np.ndarray], Any]


def morph_weights(
    neutral: ArrayInput, targets: Points, method: str | WeightFunction = "thirds", usage: ArrayInput | None = None
) -> np.ndarray:
    """Quadric scales of the vertices of a mesh with morph targets, for :func:`warpqem.simplify`.

    Args:
        neutral: (V, 3) points of the neutral shape.
        targets: (T, V, 3) points of the targets, or a :class:`warpqem.FrameSource` of them.
        method: "thirds" as in the paper; "rank", from 0.33 to 1 linearly with a vertex's rank by distance, vertices
            as far as each other alike; "distance", linearly with the distance itself; "usage", the same, and ``usage``
            must be given; or a function that gets the distances (V,) and returns the scales (V,).
        usage: how much each target counts, (T,); or the weights of the targets over time, (F, T), of which the mean
            size counts. None for all alike.

    Returns:
        (V,) float32.

    Raises:
        MeshShapeError: an array of another shape.
        OptionError: there is no such method, "usage" is without ``usage``, or the function returned no scales.
    """
    if not (callable(method) or isinstance(method, str)):
        raise OptionError(f"method must be one of {', '.join(MORPH_METHODS)} or a function, got {shown(method)}")
    if isinstance(method, str) and method not in MORPH_METHODS:
        raise OptionError(f"unknown method {method!r} of morph weights; there are {', '.join(MORPH_METHODS)}")
    if method == "usage" and usage is None:
        raise OptionError("method 'usage' needs usage: the weights of the targets over time")
    distance = morph_distances(neutral, targets, usage)
    if callable(method):
        scale = _own_scale(method(distance), len(distance))
    elif method == "thirds":
        scale = _by_thirds(distance)
    elif method == "rank":
        scale = _linear(_mean_rank(distance))
    else:
        scale = _linear(distance)
    return scale.astype(np.float32)


def morph_distances(neutral: ArrayInput, targets: Points, usage: Any = None) -> np.ndarray:
    """``DS`` of every vertex, (V,) float64: distances from the neutral shape, summed over the targets by their usage.

    Arguments as for :func:`morph_weights`.
    """
    start = finite_array(neutral, "neutral", ("V", 3), expected="(V, 3) numbers", single=True)
    ends = check_source(targets, "targets") or _checked_targets(targets, start)
    if ends.vertex_count != len(start):
        raise MeshShapeError(f"targets have {ends.vertex_count} vertices, neutral has {len(start)}")
    total, shares = np.zeros(len(start)), _usage(usage, ends.frame_count)
    for frames, block in read_ahead(ends.read, frame_blocks(ends.frame_count, max(1, len(start)))):
        for target, share in zip(block, shares[frames], strict=True):
            with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is looked for in the sum
                total += share * np.linalg.norm(target.astype(np.float64) - start, axis=1)
    bad = np.flatnonzero(~np.isfinite(total))
    if len(bad):
        raise MeshShapeError(f"neutral or a target has a point that is not finite at vertex {bad[0]}")
    return total


def _checked_targets(targets: Any, neutral: np.ndarray) -> FrameSource:
    shape = ("T", len(neutral), 3)
    found = real_array(targets, "targets", shape, expected=f"(T, {len(neutral)}, 3) numbers")
    if not len(found):
        raise MeshShapeError(f"targets must be one shape at least, got {found.shape}")
    return ArrayFrames(found)


def _own_scale(scale: Any, vertex_count: int) -> np.ndarray:
    """What a caller's function returned."""
    name = "the function for morph weights"
    try:
        found = real_array(scale, name, (vertex_count,))
    except MeshShapeError as error:
        raise OptionError(f"{name} must return {vertex_count} numbers, one per vertex: {error}") from error
    where = first_beyond(found, FLOAT32_MAX)
    if where is not None:
        raise OptionError(f"{name} returned {found[where]} for vertex {where[0]}, expected finite numbers")
    return found


def _usage(usage: Any, target_count: int) -> np.ndarray:
    if usage is None:
        return np.ones(target_count)
    expected = f"({target_count},) or (F, {target_count}) numbers"
    share = real_array(usage, "usage", (target_count,), ("F", target_count), expected=expected, bools=True)
    if not len(share):
        raise MeshShapeError(f"usage must be of one frame at least, got shape {share.shape}")
    share = np.abs(share.astype(np.float64))
    if not np.isfinite(share).all():
        raise MeshShapeError(f"usage of target {np.argwhere(~np.isfinite(share))[0][-1]} is not finite")
    return share if share.ndim == 1 else share.mean(axis=0)


def _by_thirds(distance: np.ndarray) -> np.ndarray:
    """Table 1, with the index counted from one: up to N / 3 the least, from 2 N / 3 the greatest scale."""
    count = len(distance)
    index = np.arange(1, count + 1)
    group = np.where(3 * index <= count, 0, np.where(3 * index < 2 * count, 1, 2))
    scale = np.empty(count)
    scale[np.argsort(distance, kind="stable")] = np.asarray(THIRDS)[group]
    return scale


def _mean_rank(distance: np.ndarray) -> np.ndarray:
    """Rank by distance; equal distances share their mean rank."""
    _, group, size = np.unique(distance, return_inverse=True, return_counts=True)
    last = np.cumsum(size)
    return (last - (size + 1) / 2)[group.ravel()]


def _linear(value: np.ndarray) -> np.ndarray:
    """From the least scale at the least value to one at the greatest; one everywhere if all are equal."""
    low, high = value.min(initial=np.inf), value.max(initial=-np.inf)
    if not high > low:
        return np.ones(len(value))
    return MIN_SCALE + (1.0 - MIN_SCALE) * (value - low) / (high - low)
