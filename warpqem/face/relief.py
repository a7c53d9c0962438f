"""The relief of a face: how far forward its surface reaches, on an even grid seen from the front.

Walks over a relief do not depend on where the vertices lie, nor on their number.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

__all__ = ["Relief", "make_relief"]

# Triangles that span more pixels are cut no finer than this each way; a face fills a few hundred.
MAX_CUTS = 256


@dataclass(frozen=True)
class Relief:
    """Heights on a grid.

    Attributes:
        height: (H, W) float64, forward; rows upwards, columns to the person's left. Holes are filled.
        inside: (H, W) bool, where there is a surface.
        origin: left and up coordinates of the first sample.
        pixel: distance between samples.
    """

    height: np.ndarray
    inside: np.ndarray
    origin: tuple[float, float]
    pixel: float

    def column(self, left: float) -> int:
        """The column nearest to a left coordinate."""
        return int(np.clip(round((left - self.origin[0]) / self.pixel), 0, self.height.shape[1] - 1))

    def row(self, up: float) -> int:
        """The row nearest to an up coordinate."""
        return int(np.clip(round((up - self.origin[1]) / self.pixel), 0, self.height.shape[0] - 1))

    def left(self, column: int) -> float:
        """The left coordinate of a column."""
        return self.origin[0] + column * self.pixel

    def up(self, row: int) -> float:
        """The up coordinate of a row."""
        return self.origin[1] + row * self.pixel

    def along_row(self, up: float, half: float = 0.0) -> np.ndarray:
        """(W,) heights at an up coordinate, the mean over that much above and below."""
        rows = slice(self.row(up - half), self.row(up + half) + 1)
        return np.where(self.inside[rows].all(axis=0), self.height[rows].mean(axis=0), np.nan)

    def along_column(self, left: float, half: float = 0.0) -> np.ndarray:
        """(H,) heights at a left coordinate, the mean over that much to both sides."""
        columns = slice(self.column(left - half), self.column(left + half) + 1)
        return np.where(self.inside[:, columns].all(axis=1), self.height[:, columns].mean(axis=1), np.nan)

    def smoothed(self, sigma: float) -> Relief:
        """The same, smoothed by a Gaussian of that width."""
        from scipy.ndimage import gaussian_filter

        return replace(self, height=gaussian_filter(self.height, sigma / self.pixel, mode="nearest"))

    def mirrored(self) -> Relief:
        """Left and right exchanged; the grid must have its middle at left = 0."""
        return replace(self, height=self.height[:, ::-1], inside=self.inside[:, ::-1])

    def evened(self) -> Relief:
        """The mean of both sides."""
        other = self.mirrored()
        return replace(self, height=(self.height + other.height) / 2, inside=self.inside & other.inside)


def make_relief(
    points: np.ndarray, faces: np.ndarray, low: tuple[float, float], high: tuple[float, float], pixel: float
) -> Relief:
    """The relief of a surface.

    Args:
        points: (V, 3) left, up and forward coordinates.
        faces: (N, 3) int.
        low: the least left and up coordinate.
        high: the largest.
        pixel: distance between samples.
    """
    from scipy.ndimage import distance_transform_edt

    shape = tuple(round((high[axis] - low[axis]) / pixel) + 1 for axis in (1, 0))
    best = np.full(shape[0] * shape[1], -np.inf)
    corner = points[faces].astype(np.float64)
    corner[..., :2] = (corner[..., :2] - low) / pixel
    least, most = (
        bound(bound(corner[:, 0, :2], corner[:, 1, :2]), corner[:, 2, :2]) for bound in (np.minimum, np.maximum)
    )
    reach = np.maximum(most[:, 0] - least[:, 0], most[:, 1] - least[:, 1])
    outside = (most[:, 0] < 0) | (most[:, 1] < 0) | (least[:, 0] > shape[1] - 1) | (least[:, 1] > shape[0] - 1)
    # Samples lie closer than the pixels, so that none is left out; numbers of cuts are powers of two, to be few.
    cuts = np.minimum(2 ** np.ceil(np.log2(np.maximum(1.5 * reach, 1.0))).astype(int), MAX_CUTS)
    for count in np.unique(cuts):
        i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
        kept = i + j <= count
        weight = np.stack([i[kept], j[kept], count - i[kept] - j[kept]], axis=1) / count
        sample = (weight @ corner[(cuts == count) & ~outside]).reshape(-1, 3)
        at = np.rint(sample[:, :2]).astype(np.int64)
        on = (at[:, 0] >= 0) & (at[:, 1] >= 0) & (at[:, 0] < shape[1]) & (at[:, 1] < shape[0])
        np.maximum.at(best, at[on, 1] * shape[1] + at[on, 0], sample[on, 2])
    height = best.reshape(shape)
    inside = np.isfinite(height)
    if inside.any():
        nearest = distance_transform_edt(~inside, return_distances=False, return_indices=True)
        height = height[tuple(nearest)]
    return Relief(height, inside, (float(low[0]), float(low[1])), float(pixel))
