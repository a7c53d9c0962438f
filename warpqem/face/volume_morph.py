"""Volume morph: the space around one face bent so that its feature points come to those of another."""

from __future__ import annotations

import numpy as np

from warpqem.errors import FeaturePointError
from warpqem.face.feature_points import FacialFeatures

__all__ = ["VolumeMorph", "shared_points"]

# Radial basis functions with a linear part need four points, not in a plane; with so few a face is not yet its own.
MIN_POINTS = 8
# Multiquadrics are round at their points within this distance, in noses, and grow linearly beyond. Functions that come
# to a point there would turn motion vectors one way on its one side and another way on the other.
ROUNDING = 0.3
# Step of the differences that give the morph's derivative, in noses of the source.
STEP = 1e-3


def shared_points(source: FacialFeatures, target: FacialFeatures) -> tuple[str, ...]:
    """The points that both faces have.

    Raises:
        FeaturePointError: they are too few.
    """
    names = tuple(name for name in source.names if name in target.vertices)
    if len(names) < MIN_POINTS:
        raise FeaturePointError(f"the faces share {len(names)} feature points, at least {MIN_POINTS} are needed")
    return names


class VolumeMorph:
    """A smooth map of space that takes n points to n others: multiquadrics (Hardy 1971) and a linear part.

    Args:
        source: (n, 3) points.
        target: (n, 3) where they go.
        scale: unit of length for the derivative, such as a nose.
    """

    def __init__(self, source: np.ndarray, target: np.ndarray, scale: float) -> None:
        from scipy.interpolate import RBFInterpolator

        # Points that fall on one vertex say one thing.
        _, first = np.unique(source, axis=0, return_index=True)
        first.sort()
        self._map = RBFInterpolator(
            source[first], target[first], kernel="multiquadric", epsilon=1.0 / (ROUNDING * scale), degree=1
        )
        self._step = STEP * scale

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Where points (V, 3) go."""
        return np.asarray(self._map(points))

    def derivative(self, points: np.ndarray) -> np.ndarray:
        """(V, 3, 3) derivative of the map: how it turns and scales motion vectors at points (V, 3)."""
        columns = []
        for axis in range(3):
            step = np.zeros(3)
            step[axis] = self._step
            columns.append((self(points + step) - self(points - step)) / (2.0 * self._step))
        return np.stack(columns, axis=2)
