"""Vertices at places that came further from the input than they were: how often each was, and what is held for them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.kernels import refit as kernels
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = ["FarLook", "FarPlaces"]


@dataclass(frozen=True)
class FarLook:
    """What the host knows of a look at all places.

    Attributes:
        far_count: vertices at far places.
        any_held: whether vertices were held back the last time before it.
        has_area: whether there is anything to fit.
        large_count: large faces of the input that were to be looked at.
    """

    far_count: int
    any_held: bool
    has_area: bool
    large_count: int

    @classmethod
    def from_numbers(cls, numbers: np.ndarray) -> list[FarLook]:
        """Looks, one after another, from what :meth:`FarPlaces.note` gave, (n * LOOK,) int32."""
        rows = numbers.reshape(-1, int(kernels.LOOK)).tolist()
        return [cls(far, bool(held), bool(area), large) for far, held, area, large in rows]


class FarPlaces:
    """The far places of one mesh; all on the device.

    Args:
        corner_vertex: (3N',) int32 on the device, the faces.
        vertex_count: vertices C.
        few: so many vertices are held as they are; for more, the surfaces are paired anew before.
        device: Warp device.

    Attributes:
        few: the same number.
    """

    def __init__(self, corner_vertex: wp.array, vertex_count: int, few: int, device: str) -> None:
        self._corner_vertex, self._device, self.few = corner_vertex, device, few
        self._times, self._rings = (new_arrays.zeros(vertex_count, dtype=wp.int32, device=device) for _ in range(2))
        self._none = new_arrays.zeros(1, dtype=wp.int32, device=device)

    def note(self, far: wp.array, any_held: wp.array, has_area: wp.array, large_count: wp.array | None) -> wp.array:
        """What is known of a look that marked vertices ``far`` (C,) int32: (LOOK,) int32 on the device."""
        look = new_arrays.zeros(int(kernels.LOOK), dtype=wp.int32, device=self._device)
        inputs = [far, any_held, has_area, self._none if large_count is None else large_count]
        launch(kernels.note_look, len(far), inputs, [look], device=self._device)
        return look

    def to_hold(self, far: wp.array, look: wp.array, room: int, attempt: int, *, many: bool = False) -> wp.array:
        """(C,) int32, not zero at vertices to hold: those far, with a ring more for each time that they were before.

        Args:
            far: (C,) int32, the marks of the look.
            look: what is known of it; where it was not complete, nothing is to be held.
            room: large faces that it had room for.
            attempt: attempts before this one.
            many: also where many vertices are far.
        """
        most = len(far) if many else self.few
        outputs = [self._times, self._rings]
        launch(kernels.count_times_far, len(far), [far, look, most, room], outputs, device=self._device)
        for _ in range(attempt):
            faces = len(self._corner_vertex) // 3
            launch(kernels.widen_rings, faces, [self._corner_vertex], [self._rings], device=self._device)
        return self._rings
