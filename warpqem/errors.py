"""Named errors of warpqem. Every message says what was wrong, where, and with which value."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from warpqem.pipeline.result import SimplifiedMesh

__all__ = [
    "BatchError",
    "CancelledError",
    "DegenerateMeshError",
    "DeviceError",
    "FaceIndexError",
    "FeaturePointError",
    "FrameSourceError",
    "MemoryLimitError",
    "MeshFileError",
    "MeshShapeError",
    "NonFinitePointError",
    "OptionError",
    "ProcessLimitError",
    "ProgressiveFileError",
    "StageError",
    "UnreachableTargetError",
    "UsdLibraryError",
    "VaryingTopologyError",
    "WarpqemError",
]


class WarpqemError(Exception):
    """Base of every error that warpqem raises on purpose."""


class MeshShapeError(WarpqemError, ValueError):
    """An array has the wrong shape or dtype."""


class FrameSourceError(MeshShapeError):
    """A frame source is incomplete, or its frames are not what it announces or what it gave before."""


class NonFinitePointError(WarpqemError, ValueError):
    """A point is NaN or infinite; the message names vertex and frame."""


class FaceIndexError(WarpqemError, IndexError):
    """A face refers to a vertex that does not exist."""


class DegenerateMeshError(WarpqemError, ValueError):
    """The mesh has no extent, no usable face, or no point."""


class FeaturePointError(WarpqemError, ValueError):
    """A mesh has no face that is known to have feature points, or too few of them."""


class OptionError(WarpqemError, ValueError):
    """An option has a value outside its range, or two options exclude each other.

    Names of options stand in backticks in what it is made of, which its text leaves out: the command line writes flags
    instead, see ``warpqem.cli.flag_names``.
    """

    @property
    def marked(self) -> str:
        """The text with names of options in backticks."""
        return str(self.args[0]) if self.args else ""

    def __str__(self) -> str:
        return re.sub(r"`([a-z_]+)`", r"\1", self.marked)


class DeviceError(WarpqemError, RuntimeError):
    """The Warp device asked for does not exist on this machine."""


class UnreachableTargetError(WarpqemError, RuntimeError):
    """No legal edge collapse leads to the face count asked for; the message names the count reached.

    Attributes:
        result: the :class:`warpqem.SimplifiedMesh` as far as legal collapses go, for callers who can use it.
    """

    def __init__(self, message: str, result: SimplifiedMesh | None = None) -> None:
        super().__init__(message)
        self.result = result


class CancelledError(WarpqemError, RuntimeError):
    """A call was ended by its ``cancel`` from another thread; nothing of its result is left."""


class BatchError(WarpqemError, RuntimeError):
    """A batch as a whole cannot go on: its folder is in use, or no process can be started."""


class MemoryLimitError(WarpqemError, MemoryError):
    """The work cannot be done in the memory it may take; the message says what is needed and what would help."""


class ProcessLimitError(WarpqemError, RuntimeError):
    """A limit of the process (ulimit) leaves too little to work with; the message names the limit."""


class ProgressiveFileError(WarpqemError, ValueError):
    """A file holds no progressive mesh, or a damaged one; the message names the file and the chunk."""


class MeshFileError(WarpqemError):
    """A mesh file cannot be read or written, or is no frame of its sequence; the message names file and difference."""


class StageError(WarpqemError):
    """A USD stage, prim or attribute cannot be read or written; the message names prim, attribute and time."""


class VaryingTopologyError(StageError):
    """The topology of a USD mesh varies over time where one topology is needed; the message names the time."""


class UsdLibraryError(WarpqemError, ImportError):
    """USD's Python library is missing, cannot be loaded or is too old; the message says what to install."""
