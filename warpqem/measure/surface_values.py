"""What a mesh is textured, shaded and coloured by: values at the corners of its triangles, read frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from warpqem.arguments.array_input import finite_array
from warpqem.arguments.array_record import ArrayRecord
from warpqem.errors import MeshShapeError

__all__ = ["CornerValues", "SurfaceValues", "shared_names", "shared_normals"]

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class CornerValues(ArrayRecord):
    """Values at the corners of the triangles of a mesh.

    Attributes:
        name: what messages call them.
        read: the values (N, 3, C) in a frame.
    """

    name: str
    read: Callable[[int], npt.NDArray[np.floating]]

    @classmethod
    def of(cls, name: str, values: npt.ArrayLike) -> CornerValues:
        """From an array, (N, 3, C), or (F, N, 3, C) for values of each frame.

        Raises:
            MeshShapeError: another shape or dtype, or a value that is not finite.
        """
        array = finite_array(values, name, ("N", 3, "C"), ("F", "N", 3, "C"))
        return cls(name, (lambda _: array) if array.ndim == 3 else array.__getitem__)

    def at(self, frame: int, face_count: int, width: int) -> Floats:
        """The values (face_count, 3, width) in a frame.

        Raises:
            MeshShapeError: they have another shape.
        """
        values = np.asarray(self.read(frame), dtype=np.float64)
        if values.shape != (face_count, 3, width):
            raise MeshShapeError(
                f"{self.name}: expected corner values of shape {(face_count, 3, width)}, got {values.shape}"
            )
        return values


def _of_frames(values: CornerValues, frames: npt.NDArray[np.int64]) -> CornerValues:
    return CornerValues(values.name, lambda frame: values.read(int(frames[frame])))


@dataclass(frozen=True)
class SurfaceValues:
    """The values of one mesh.

    Attributes:
        uvs: texture coordinates (N, 3, 2) by name.
        normals: shading normals (N, 3, 3) of any length; None without.
        colors: linear Rec. 709 colours (N, 3, 3) by name.
        unusable: why something by one of these names ("normals" for those) cannot be used.
    """

    uvs: Mapping[str, CornerValues] = field(default_factory=dict)
    normals: CornerValues | None = None
    colors: Mapping[str, CornerValues] = field(default_factory=dict)
    unusable: Mapping[str, str] = field(default_factory=dict)

    def of_frames(self, frames: npt.NDArray[np.int64]) -> SurfaceValues:
        """The values in some frames (K,), which are numbered from 0 on."""
        return replace(
            self,
            uvs={name: _of_frames(values, frames) for name, values in self.uvs.items()},
            normals=None if self.normals is None else _of_frames(self.normals, frames),
            colors={name: _of_frames(values, frames) for name, values in self.colors.items()},
        )


def shared_names(
    kind: str,
    label: str,
    reference: SurfaceValues,
    test: SurfaceValues,
    found: tuple[Mapping[str, CornerValues], Mapping[str, CornerValues]],
    reasons: dict[str, str],
) -> list[str]:
    """Names that both meshes have values of; ``reasons`` takes why others are not measured.

    Args:
        kind: what these values are, for messages.
        label: the key of the reason where neither has any.
        reference: the values of the reference.
        test: those of the test mesh.
        found: the part of both that counts.
        reasons: by name.
    """
    names = list(dict.fromkeys([*found[0], *found[1]]))
    shared = [name for name in names if name in found[0] and name in found[1]]
    for name in names:
        if name not in shared:
            reasons[name] = _missing(name, reference, test, name in found[0])
    if not names:
        reasons[label] = f"neither mesh has {kind}"
    return shared


def shared_normals(
    reference: SurfaceValues, test: SurfaceValues, reasons: dict[str, str]
) -> tuple[CornerValues, CornerValues] | None:
    """The normals of both meshes; None, with the reason, where one has none."""
    if reference.normals is not None and test.normals is not None:
        return reference.normals, test.normals
    if reference.normals is None and test.normals is None:
        unusable = reference.unusable.get("normals") or test.unusable.get("normals")
        reasons["normals"] = unusable or "neither mesh has normals"
    else:
        reasons["normals"] = _missing("normals", reference, test, reference.normals is not None)
    return None


def _missing(name: str, reference: SurfaceValues, test: SurfaceValues, in_reference: bool) -> str:
    side, values = ("test mesh", test) if in_reference else ("reference", reference)
    return f"the {side} has no {name}" if name not in values.unusable else f"{side}: {values.unusable[name]}"
