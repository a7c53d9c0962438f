"""Array values of USD attributes as NumPy arrays and back, with all their samples."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd, UsdGeom, Vt

__all__ = [
    "Samples",
    "anchored",
    "blocked_codes",
    "element_size",
    "from_numpy",
    "is_continuous",
    "is_normal",
    "is_quaternion",
    "primvar_samples",
    "reads_as_indices",
    "sample_codes",
    "to_numpy",
]

_QUATERNIONS = (Vt.QuathArray, Vt.QuatfArray, Vt.QuatdArray)


class Samples(Mapping[Usd.TimeCode, npt.NDArray[Any]]):
    """The values of an attribute at its samples, each read when it is asked for, so that they are never all in memory.

    Args:
        codes: When there are samples.
        read: The value at one of them.
    """

    def __init__(self, codes: Sequence[Usd.TimeCode], read: Callable[[Usd.TimeCode], npt.NDArray[Any]]) -> None:
        self._codes, self._read = list(codes), read
        # Most attributes have one sample, which is asked for several times.
        self._last: tuple[Usd.TimeCode, npt.NDArray[Any]] | None = None

    def __getitem__(self, code: Usd.TimeCode) -> npt.NDArray[Any]:
        if self._last is None or self._last[0] != code:
            self._last = None
            self._last = (code, self._read(code))
        return self._last[1]

    def __contains__(self, code: object) -> bool:
        return code in self._codes

    def __iter__(self) -> Iterator[Usd.TimeCode]:
        return iter(self._codes)

    def __len__(self) -> int:
        return len(self._codes)

    def map(self, change: Callable[[npt.NDArray[Any]], npt.NDArray[Any]]) -> Samples:
        """The same samples, changed one by one."""
        return Samples(self._codes, lambda code: change(self[code]))


def sample_codes(*attributes: Usd.Attribute) -> list[Usd.TimeCode]:
    """Where attributes have values: the default time if one has a default value, then every time sample of any.

    Times at which one of them is blocked are left out.
    """
    present = [attribute for attribute in attributes if attribute and attribute.HasAuthoredValue()]
    codes = []
    if any(attribute.Get(Usd.TimeCode.Default()) is not None for attribute in present):
        codes.append(Usd.TimeCode.Default())
    times = {time for attribute in present for time in attribute.GetTimeSamples()}
    return codes + [
        Usd.TimeCode(time) for time in sorted(times) if all(attribute.Get(time) is not None for attribute in present)
    ]


def is_of_one_type(attribute: Usd.Attribute, codes: Sequence[Usd.TimeCode]) -> bool:
    """False where samples are of different types, which a damaged file may hold; there is no blending those."""
    return len({type(attribute.Get(code)) for code in codes}) <= 1


def blocked_codes(attribute: Usd.Attribute) -> list[Usd.TimeCode]:
    """The time samples of an attribute that say it has no value."""
    return [Usd.TimeCode(time) for time in attribute.GetTimeSamples() if attribute.Get(time) is None]


def anchored(value: Sdf.AssetPath, layer: Sdf.Layer) -> Sdf.AssetPath:
    """An asset path that means the same in any layer: absolute, unless it is looked up on the search path."""
    if value.resolvedPath:
        return Sdf.AssetPath(value.resolvedPath)
    if value.path.startswith(("./", "../")):
        return Sdf.AssetPath(layer.ComputeAbsolutePath(value.path))
    return value


def to_numpy(value: Any, element_size: int = 1) -> npt.NDArray[Any] | None:
    """An array value as (elements, ...), or (elements, element_size, ...); None if it is no whole number of elements.

    Quaternions come as (elements, 4) in the order i, j, k, real; strings, tokens and asset paths as objects.
    """
    if value is None or not hasattr(value, "__len__") or isinstance(value, str):
        return None
    if hasattr(type(value), "FromNumpy"):
        array = np.array(value)
    else:
        array = np.empty(len(value), dtype=object)
        array[:] = list(value)
    if element_size == 1:
        return array
    if element_size < 1 or len(array) % element_size:
        return None
    return array.reshape(-1, element_size, *array.shape[1:])


def from_numpy(array: npt.NDArray[Any], like: Any, element_size: int = 1) -> Any:
    """An array as `to_numpy` gives it, as a Vt array of the type of `like`."""
    if element_size != 1:
        array = array.reshape(-1, *array.shape[2:])
    kind = type(like)
    if hasattr(kind, "FromNumpy"):
        return kind.FromNumpy(np.ascontiguousarray(array, dtype=np.array(like).dtype))
    return kind(array.tolist())


def is_continuous(value: Any) -> bool:
    """True if values between two entries make sense: real numbers, vectors, matrices, quaternions."""
    return hasattr(type(value), "FromNumpy") and np.array(value[:1] if len(value) else value).dtype.kind == "f"


def is_quaternion(value: Any) -> bool:
    """True for an array of quaternions."""
    return isinstance(value, _QUATERNIONS)


def is_normal(type_name: Sdf.ValueTypeName) -> bool:
    """True for unit directions that stand on a surface."""
    return str(type_name.role) == "Normal"


def reads_as_indices(indices: Usd.Attribute) -> bool:
    """True of indices of the type that USD takes as such; it passes over others."""
    return indices.GetTypeName() == Sdf.ValueTypeNames.IntArray


def element_size(primvar: UsdGeom.Primvar, count: int | None) -> int:
    """How many values of a primvar make one element: its elementSize, or one where only that gives so many elements.

    Exporters write the number of all values there, or leave it at nought.

    Args:
        primvar: The primvar.
        count: Elements that there should be; None where nothing says.
    """
    size: int = primvar.GetElementSize()
    if count is None or size == 1 or _element_count(primvar, size) == count:
        return size
    return 1 if _element_count(primvar, 1) == count else size


def _element_count(primvar: UsdGeom.Primvar, size: int) -> int | None:
    samples = primvar_samples(primvar, size)
    return None if samples is None else len(next(iter(samples.values())))


def primvar_samples(primvar: UsdGeom.Primvar, size: int | None = None) -> Samples | None:
    """The values of a primvar without its indices, (elements, ...) at each sample.

    Samples at which only the values or only the indices are there are left out.

    Args:
        primvar: The primvar.
        size: Values of one element; None for its elementSize.

    Returns:
        The samples; None if there are none, an index has no value or is no whole number, or they are of several types.
    """
    attribute, indices = primvar.GetAttr(), primvar.GetIndicesAttr()
    has_indices = bool(indices and indices.HasAuthoredValue())
    codes = [
        code
        for code in sample_codes(attribute, indices)
        if attribute.Get(code) is not None and (not has_indices or indices.Get(code) is not None)
    ]

    def find(code: Usd.TimeCode) -> npt.NDArray[Any] | None:
        values = to_numpy(attribute.Get(code), primvar.GetElementSize() if size is None else size)
        if values is None or not has_indices:
            return values
        index = to_numpy(indices.Get(code))
        if index is None or index.dtype.kind not in "iu":
            return None
        if len(index) and (index.min() < 0 or index.max() >= len(values)):
            return None
        return values[index]

    def read(code: Usd.TimeCode) -> npt.NDArray[Any]:
        values = find(code)
        assert values is not None
        return values

    if not codes or not is_of_one_type(attribute, codes) or any(find(code) is None for code in codes):
        return None
    return Samples(codes, read)
