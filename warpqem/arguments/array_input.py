"""Arrays from callers: taken in any form that holds one, checked for shape and kind of value, refused by name.

Every array argument of a public function comes through here, so that the same mistake gets the same error everywhere.
A view of the caller's memory is returned where one will do; nothing here writes to it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import warp as wp

from warpqem.errors import MeshShapeError, WarpqemError
from warpqem.runtime.device_arrays import warp_array

__all__ = [
    "FLOAT32_MAX",
    "INDEX_LIMIT",
    "Shape",
    "as_numpy",
    "finite_array",
    "first_beyond",
    "first_outside",
    "index_array",
    "is_empty",
    "read_warp_array",
    "real_array",
]

FLOAT32_MAX = float(np.finfo(np.float32).max)
# Kernels count vertices and corners of faces with 32-bit integers.
INDEX_LIMIT = 2**31 - 1
# Rows searched at once for the first wrong value, so that a broadcast array is never written out.
ROWS_AT_ONCE = 2**20

# Lengths of the axes; text stands for any length.
Shape = tuple["int | str", ...]


def as_numpy(array: Any, name: str) -> np.ndarray:
    """A NumPy view or copy of a NumPy, Warp, array-interface or DLPack array, or a sequence.

    Args:
        array: the argument.
        name: what messages call it.

    Raises:
        MeshShapeError: it is no array and cannot be made one, or some of its values are masked.
    """
    with _conversion(array, name):
        if isinstance(array, (list, tuple)) and any(isinstance(row, np.ma.MaskedArray) for row in array):
            array = np.ma.stack([np.ma.asarray(row) for row in array])
        found = _converted(array)
    if found.ndim == 0 and found.dtype.kind == "O":
        raise MeshShapeError(f"{name} must be an array, got {_described(array)}")
    if isinstance(array, np.ma.MaskedArray):
        _check_mask(array, name)
    return found


@contextlib.contextmanager
def _conversion(array: Any, name: str) -> Iterator[None]:
    """Name the argument in what is raised within."""
    try:
        yield
    except (MemoryError, WarpqemError):
        raise
    except Exception as error:
        # Whatever somebody's __array__ raises, and what NumPy says of rows of different lengths.
        reason = str(error).strip().split("\n")[0]
        raise MeshShapeError(
            f"{name} cannot be converted to an array ({type(array).__name__}: {type(error).__name__}: {reason})"
        ) from error


def read_warp_array(array: Any, name: str) -> wp.array:
    """A Warp array of numbers over the memory of one that is on a device; vectors are rows of three numbers.

    Args:
        array: one that :func:`warpqem.runtime.device.array_device` knows the device of.
        name: what messages call it.

    Raises:
        MeshShapeError: it gives none, or one of something other than numbers.
    """
    with _conversion(array, name):
        found = warp_array(array)
        assert found is not None
        scalar = getattr(found.dtype, "_wp_scalar_type_", found.dtype)
        # Raises TypeError for values that are no numbers.
        wp.dtype_to_numpy(scalar)
        return found if scalar is found.dtype else found.view(scalar)


def _converted(array: Any) -> np.ndarray:
    if isinstance(array, np.ndarray):
        # The plain array of a subclass: rows of a matrix are no matrices, nor values of a masked array masked.
        return array if type(array) is np.ndarray else np.asarray(array)
    if isinstance(array, (wp.array, wp.indexedarray)):
        copied: np.ndarray = array.numpy()
        return copied
    if hasattr(array, "__array_interface__"):
        return np.asarray(array)
    there = warp_array(array)
    if there is not None:
        fetched: np.ndarray = there.numpy()
        return fetched
    # Before __array__, which tensors on a GPU have only to raise from it.
    if hasattr(array, "__dlpack__"):
        imported: np.ndarray = wp.from_dlpack(array).numpy()
        return imported
    return np.asarray(array)


def _check_mask(array: np.ma.MaskedArray[Any, Any], name: str) -> None:
    """Refuse masked values, which NumPy hands over as if they were not masked."""
    mask = np.ma.getmaskarray(array)
    if mask.dtype != bool or not mask.any():
        return
    where = tuple(int(i) for i in np.argwhere(mask)[0])
    raise MeshShapeError(
        f"{name} has {int(mask.sum())} masked values, the first at {_place(where)}; expected values for all, such as "
        "those of filled()"
    )


def real_array(value: Any, name: str, *shapes: Shape, expected: str | None = None, bools: bool = False) -> np.ndarray:
    """Real numbers of one of the shapes; they may be infinite or NaN.

    Args:
        value: the argument.
        name: what messages call it.
        shapes: shapes that are taken.
        expected: what messages say is expected, instead of the shapes and the kind of value.
        bools: take False and True for 0 and 1.

    Raises:
        MeshShapeError: no array, of another shape, or of another kind of value.
    """
    array = as_numpy(value, name)
    _check_form(array, name, shapes, "fiub" if bools else "fiu", "real numbers", expected)
    return array


def finite_array(
    value: Any, name: str, *shapes: Shape, expected: str | None = None, single: bool = False
) -> np.ndarray:
    """The same, of which every value is finite.

    Args:
        value: the argument.
        name: what messages call it.
        shapes: shapes that are taken.
        expected: what messages say is expected, instead of the shapes and the kind of value.
        single: values must be finite in single precision too.

    Raises:
        MeshShapeError: see :func:`real_array`; or a value is not finite, which the message names with its place.
    """
    array = real_array(value, name, *shapes, expected=expected)
    where = first_beyond(array, FLOAT32_MAX if single else float(np.finfo(np.float64).max))
    if where is not None:
        raise MeshShapeError(f"{name} at {_place(where)} is {array[where]}, expected a finite number")
    return array


def index_array(value: Any, name: str, *shapes: Shape, expected: str | None = None) -> np.ndarray:
    """Integers of one of the shapes; see :func:`first_outside` for their range.

    Args:
        value: the argument.
        name: what messages call it.
        shapes: shapes that are taken.
        expected: what messages say is expected, instead of the shapes and the kind of value.

    Raises:
        MeshShapeError: no array, of another shape or kind of value, or with more values than 32-bit integers count.
    """
    array = as_numpy(value, name)
    _check_form(array, name, shapes, "iu", "integers", expected)
    if array.size > INDEX_LIMIT:
        raise MeshShapeError(
            f"{name} of shape {array.shape} has {array.size} indices, more than the {INDEX_LIMIT} that 32-bit "
            "integers count"
        )
    return array


def first_outside(indices: np.ndarray, count: int) -> tuple[int, ...] | None:
    """Place of the first index that is below 0 or not below ``count``; None where all are within."""
    # The least and the greatest take no memory, and less time than comparing every index.
    if not indices.size or (indices.min() >= 0 and indices.max() < count):
        return None
    return _first(indices, lambda rows: (rows < 0) | (rows >= count))


def first_beyond(values: np.ndarray, limit: float) -> tuple[int, ...] | None:
    """Place of the first value that is NaN or larger in size than ``limit``; None where there is none."""
    if values.dtype.kind != "f" or not values.size:
        return None
    # A limit beyond the dtype would become infinite in comparisons, and infinity pass.
    limit = min(limit, float(np.finfo(values.dtype).max))
    with np.errstate(invalid="ignore"):
        if values.min() >= -limit and values.max() <= limit:
            return None
        return _first(values, lambda rows: ~(np.abs(rows) <= limit))


def is_empty(array: Any) -> bool:
    """Whether a sequence is empty: NumPy makes an array of floats of it, whatever it was to hold."""
    return isinstance(array, (list, tuple)) and not len(array)


def _first(array: np.ndarray, is_wrong: Any) -> tuple[int, ...] | None:
    for start in range(0, len(array), ROWS_AT_ONCE):
        wrong = np.argwhere(is_wrong(array[start : start + ROWS_AT_ONCE]))
        if len(wrong):
            return (start + int(wrong[0, 0]), *(int(i) for i in wrong[0, 1:]))
    return None


def _check_form(
    array: np.ndarray, name: str, shapes: tuple[Shape, ...], kinds: str, what: str, expected: str | None
) -> None:
    fits = any(_fits(array.shape, shape) for shape in shapes)
    if fits and array.dtype.kind in kinds:
        return
    first = _first_value(array)
    if expected is not None:
        raise MeshShapeError(f"{name} must be {expected}, got shape {array.shape} dtype {array.dtype}{first}")
    if array.dtype.kind not in kinds:
        raise MeshShapeError(f"{name} must be {what}, got dtype {array.dtype}{first}")
    wanted = " or ".join(f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)})" for shape in shapes)
    raise MeshShapeError(f"{name} must have shape {wanted}, got {array.shape}")


def _fits(shape: tuple[int, ...], wanted: Shape) -> bool:
    pairs = zip(shape, wanted, strict=False)
    return len(shape) == len(wanted) and all(isinstance(want, str) or have == want for have, want in pairs)


def _first_value(array: np.ndarray) -> str:
    """The first of values that are no numbers, to tell what they are."""
    if not array.size or array.dtype.kind not in "OUScmM":
        return ""
    value = array.reshape(-1)[:1].tolist()[0]
    return f" (the first is {repr(value)[:60]})"


def _place(where: tuple[int, ...]) -> str:
    return f"index {where[0]}" if len(where) == 1 else str(where)


def _described(value: Any) -> str:
    """What somebody gave in the place of an array."""
    if value is None:
        return "None"
    return f"the class {value.__name__}" if isinstance(value, type) else f"a {type(value).__name__}"
