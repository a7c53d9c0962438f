"""Types of the arrays and meshes that public functions take, for type checkers; other modules check the values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    import trimesh
    import warp as wp

    from warpqem.frames.stream import FrameSource
    from warpqem.mesh_files.sequence import MeshSequence

__all__ = ["ArrayInput", "MeshPoints", "Points"]


class HasArrayInterface(Protocol):
    """An array in the memory of the host, such as those of NumPy."""

    @property
    def __array_interface__(self) -> Mapping[str, Any]:
        """Address, shape and type."""
        ...


class HasCudaArrayInterface(Protocol):
    """An array in the memory of a GPU, such as those of CuPy."""

    @property
    def __cuda_array_interface__(self) -> Mapping[str, Any]:
        """Address, shape and type."""
        ...


class HasDlpack(Protocol):
    """An array that others import by DLPack, such as a tensor of PyTorch."""

    def __dlpack__(self, *, stream: Any = ...) -> Any:
        """The capsule."""
        ...


if TYPE_CHECKING:
    # An array on the host or on a GPU, or nested lists.
    ArrayInput: TypeAlias = (
        np.ndarray[Any, Any] | wp.array[Any] | HasArrayInterface | HasCudaArrayInterface | HasDlpack | Sequence[Any]
    )
    # Points (F, V, 3) or (V, 3), or a source of frames.
    Points: TypeAlias = ArrayInput | FrameSource
    # The same, or a mesh that has faces of its own.
    MeshPoints: TypeAlias = Points | MeshSequence | trimesh.Trimesh
else:
    # What they name is loaded when it is used; here nothing is.
    ArrayInput = Points = MeshPoints = Any
