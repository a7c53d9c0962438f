"""Values blended from others with weights."""

from __future__ import annotations

import numpy as np

__all__ = ["blend"]


def blend(values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Weighted means, (R, ...) float64, of values (R, K, ...) with weights (R, K) that sum to one.

    They are taken from the first value on, so that K equal values give just that value, however the weights round.
    """
    values = values.astype(np.float64)
    if not np.isfinite(values).all():
        # An infinite value, as a painted weight may be, counts only where it has a weight.
        values = np.where(weight.reshape(*weight.shape, *[1] * (values.ndim - 2)) > 0, values, 0.0)
        # Infinities of both signs have no mean.
        with np.errstate(invalid="ignore"):
            infinite: np.ndarray = np.einsum("rk,rk...->r...", weight.astype(np.float64), values)
        return infinite
    first = values[:, :1]
    mean: np.ndarray = first[:, 0] + np.einsum("rk,rk...->r...", weight.astype(np.float64), values - first)
    return mean
