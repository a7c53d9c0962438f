"""Normals that move with the surface of the output: fitted in a few poses, and turned with it into all others.

A fitted normal is a tilt of the normal that the output's own faces give. That one follows every bend of the surface in
every frame; the tilt says what the faces leave out, and goes slowly from one fitted pose to the next.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["NormalFrames", "tilt_between"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]

# Shorter vectors than this, in parts of the longest edge, have no direction.
SHORTEST = 1e-12


class NormalFrames:
    """An orthonormal frame for each of R normals of a mesh in one pose; its third axis is the mean of their faces'.

    Attributes:
        axes: (R, 3, 3) float64, the three axes of each.
    """

    def __init__(self, points: npt.NDArray[np.floating], faces: Ints, corner_row: Ints, own: Floats) -> None:
        """Take a pose.

        Args:
            points: (V', 3).
            faces: (N', 3) int32.
            corner_row: (N', 3) int32, which of the R normals each corner has.
            own: (R, 3) unit vectors, the normals by the faces.
        """
        corner = points.astype(np.float64)[faces]
        # Into the face from each corner: no normal of a surface that is one points there.
        inwards = np.roll(corner, -1, axis=1) + np.roll(corner, 1, axis=1) - 2 * corner
        direction = np.zeros_like(own)
        # Of the first corner that has the normal.
        direction[corner_row.ravel()[::-1]] = inwards.reshape(-1, 3)[::-1]
        direction -= (direction * own).sum(axis=1, keepdims=True) * own
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        lost = length[:, 0] <= SHORTEST * (length.max(initial=0.0) or 1.0)
        # Whichever axis is furthest from the normal.
        other = np.eye(3)[np.abs(own[lost]).argmin(axis=1)]
        direction[lost] = other - (other * own[lost]).sum(axis=1, keepdims=True) * own[lost]
        along = direction / np.linalg.norm(direction, axis=1, keepdims=True)
        self.axes: Floats = np.stack([along, np.cross(own, along), own], axis=1)

    def tilt_of(self, normals: Floats) -> Floats:
        """Normals (R, 3) in their frames."""
        tilt: Floats = np.einsum("rkd,rd->rk", self.axes, normals)
        return tilt

    def tilted(self, tilt: Floats) -> Floats:
        """Normals (R, 3) from what `tilt_of` gives."""
        normals: Floats = np.einsum("rk,rkd->rd", tilt, self.axes)
        return normals


def tilt_between(key_frames: npt.NDArray[np.int64], tilts: Floats, frame: int) -> Floats:
    """The tilt (R, 3) in a frame between fitted ones, of length one.

    Args:
        key_frames: (K,) the fitted frames, ascending.
        tilts: (K, R, 3) float64, what `NormalFrames.tilt_of` gives there.
        frame: from the first to the last of them.
    """
    after = int(np.searchsorted(key_frames, frame))
    if key_frames[after] == frame:
        exact: Floats = tilts[after]
        return exact
    before = after - 1
    share = (frame - key_frames[before]) / (key_frames[after] - key_frames[before])
    total = (1.0 - share) * tilts[before] + share * tilts[after]
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > SHORTEST, total / np.maximum(length, SHORTEST), tilts[before])
