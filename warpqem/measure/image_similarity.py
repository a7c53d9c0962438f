"""How alike two pictures of one view are: peak signal-to-noise ratio, structural similarity, overlap of silhouettes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["OverlapSums", "Similarity", "SimilaritySums", "structural_similarity"]

Floats = npt.NDArray[np.float64]
Pixels = npt.NDArray[np.uint8]

# Of bytes.
PEAK = 255.0
# Wang et al. 2004, section III: an 11 x 11 window of a Gaussian of 1.5 pixels, and the constants of both terms.
WINDOW_RADIUS, WINDOW_SIGMA = 5, 1.5
LUMINANCE_CONSTANT, CONTRAST_CONSTANT = (0.01 * PEAK) ** 2, (0.03 * PEAK) ** 2
# Luma of Rec. 709 from encoded values.
LUMA = (0.2126, 0.7152, 0.0722)


@dataclass(frozen=True)
class Similarity:
    """How alike pictures are in the pixels that either silhouette covers.

    Attributes:
        psnr: peak signal-to-noise ratio of the encoded values in dB, by the mean squared difference over these pixels
            of all pictures; None where all of them are equal.
        ssim: mean structural similarity of the luma there (Wang et al. 2004), 1 where all of them are equal.
    """

    psnr: float | None
    ssim: float


class SimilaritySums:
    """Sums over pictures."""

    def __init__(self) -> None:
        """Of none."""
        self._squares = self._similarity = 0.0
        self._count = 0

    def add(self, reference: Pixels, test: Pixels, counted: npt.NDArray[np.bool_]) -> None:
        """Take a pair of pictures (height, width, 3), and which pixels (height, width) count."""
        difference = reference[counted].astype(np.float64) - test[counted].astype(np.float64)
        self._squares += float((difference**2).mean(axis=1).sum())
        self._similarity += float(structural_similarity(_luma(reference), _luma(test))[counted].sum())
        self._count += int(counted.sum())

    def result(self) -> Similarity | None:
        """What they come to; None without a pixel."""
        if not self._count:
            return None
        mean = self._squares / self._count
        psnr = None if mean == 0.0 else float(10.0 * np.log10(PEAK**2 / mean))
        return Similarity(psnr, self._similarity / self._count)


class OverlapSums:
    """Overlap of silhouettes over pictures."""

    def __init__(self) -> None:
        """Of none."""
        self._both = self._either = 0.0

    def add(self, reference: npt.NDArray[np.float32], test: npt.NDArray[np.float32]) -> None:
        """Take what two silhouettes cover of each pixel, (height, width), from 0 to 1."""
        self._both += float(np.minimum(reference, test).sum(dtype=np.float64))
        self._either += float(np.maximum(reference, test).sum(dtype=np.float64))

    def result(self) -> float | None:
        """What both cover by what either covers; None where nothing is covered."""
        return self._both / self._either if self._either else None


def structural_similarity(first: Floats, second: Floats) -> Floats:
    """Structural similarity index of two pictures (height, width) at each pixel (Wang et al. 2004, equation 13).

    Beyond the border a picture goes on as its mirror image.

    Args:
        first: values from 0 to 255.
        second: likewise.
    """
    mean, other = _blurred(first), _blurred(second)
    variance, other_variance = _blurred(first**2) - mean**2, _blurred(second**2) - other**2
    covariance = _blurred(first * second) - mean * other
    luminance = (2 * mean * other + LUMINANCE_CONSTANT) / (mean**2 + other**2 + LUMINANCE_CONSTANT)
    contrast = (2 * covariance + CONTRAST_CONSTANT) / (variance + other_variance + CONTRAST_CONSTANT)
    found: Floats = luminance * contrast
    return found


def _luma(picture: Pixels) -> Floats:
    found: Floats = picture.astype(np.float64) @ np.array(LUMA)
    return found


def _blurred(values: Floats) -> Floats:
    offsets = np.arange(-WINDOW_RADIUS, WINDOW_RADIUS + 1)
    weights = np.exp(-0.5 * (offsets / WINDOW_SIGMA) ** 2)
    weights /= weights.sum()
    for axis in (0, 1):
        width = [(WINDOW_RADIUS, WINDOW_RADIUS) if k == axis else (0, 0) for k in (0, 1)]
        padded = np.pad(values, width, mode="symmetric")
        length = values.shape[axis]
        values = sum(
            (w * np.take(padded, range(k, k + length), axis=axis) for k, w in enumerate(weights)),
            start=np.zeros_like(values),
        )
    return values
