"""Launches in parts: one kernel over many items, split over the threads of the device.

Each part is a launch of its own over consecutive items. An argument is the same for all parts, or one of these:

    launch_in_parts(square, len(x), [rows_of(x)], [rows_of(result)], device=device)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import warp as wp

from warpqem.runtime.cpu_threads import launch_parts, part_count
from warpqem.runtime.launches import launch

__all__ = ["FIRST_ITEM", "PerPart", "columns_of", "corners_of", "launch_in_parts", "rows_of", "starts_of"]


@dataclass(frozen=True)
class PerPart:
    """An argument that is another one in each part.

    Attributes:
        of: makes it from the slice of the items that the part works on.
    """

    of: Callable[[slice], Any]


# The number of a part's first item, for kernels that see whole arrays.
FIRST_ITEM = PerPart(lambda part: part.start)


def rows_of(array: wp.array) -> PerPart:
    """The part's own rows of an array (n, ...) of n items."""
    return PerPart(lambda part: array if _is_whole(part, len(array)) else array[part])


def columns_of(array: wp.array) -> PerPart:
    """The part's own columns of an array (m, n) of n items."""
    return PerPart(lambda part: array if _is_whole(part, array.shape[1]) else array[:, part])


def corners_of(array: wp.array) -> PerPart:
    """The part's own rows of an array (3n, ...) of the corners of n faces."""
    return PerPart(lambda part: array if _is_whole(part, len(array) // 3) else array[3 * part.start : 3 * part.stop])


def starts_of(array: wp.array) -> PerPart:
    """Where the lists of the part's own items begin, and the last one ends, of an array (n+1,) for n items."""
    return PerPart(lambda part: array if _is_whole(part, len(array) - 1) else array[part.start : part.stop + 1])


def _is_whole(part: slice, count: int) -> bool:
    """Whether a part is all there is: a slice of an array takes the host longer than a launch."""
    return bool(part.start == 0 and part.stop == count)


def launch_in_parts(
    kernel: wp.Kernel,
    dim: int | tuple[int, ...],
    inputs: Sequence[Any],
    outputs: Sequence[Any] = (),
    *,
    device: str,
    min_items: int = 1,
) -> None:
    """Launch a kernel in parts along the first dimension, one for each thread of the device.

    Args:
        kernel: the kernel.
        dim: items, or items and further dimensions that stay whole.
        inputs: arguments, the same for all parts or :class:`PerPart`.
        outputs: likewise; parts write apart from each other.
        device: Warp device.
        min_items: items that are worth a thread.
    """
    count, *rest = (dim,) if isinstance(dim, int) else dim
    if part_count(count, device, min_items) == 1:
        whole = slice(0, count)
        launch(kernel, dim, _of_part(inputs, whole), _of_part(outputs, whole), device=device)
        return

    def launch_part(part: slice) -> None:
        given = _of_part(inputs, part), _of_part(outputs, part)
        launch(kernel, (part.stop - part.start, *rest), *given, device=device)

    launch_parts(launch_part, count, device, min_items)


def _of_part(arguments: Sequence[Any], part: slice) -> list[Any]:
    return [argument.of(part) if type(argument) is PerPart else argument for argument in arguments]
