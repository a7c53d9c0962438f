"""PSNR, SSIM and overlap of silhouettes of two pictures."""

from __future__ import annotations

import numpy as np
import pytest

from warpqem.measure.image_similarity import OverlapSums, SimilaritySums, structural_similarity

GENERATOR = np.random.default_rng(5)
PICTURE = GENERATOR.integers(0, 256, (40, 52, 3), dtype=np.uint8)
ALL = np.ones((40, 52), dtype=bool)


def similarity(test: np.ndarray, counted: np.ndarray = ALL):
    sums = SimilaritySums()
    sums.add(PICTURE, test, counted)
    return sums.result()


def test_structural_similarity_is_that_of_scikit_image():
    metrics = pytest.importorskip("skimage.metrics")
    first = PICTURE[..., 0].astype(np.float64)
    second = np.clip(first + GENERATOR.normal(0.0, 30.0, first.shape), 0.0, 255.0)
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 255, "full": True}
    _, expected = metrics.structural_similarity(first, second, **options)
    np.testing.assert_allclose(structural_similarity(first, second), expected, atol=1e-12)


def test_psnr_is_that_of_the_mean_squared_difference():
    test = np.where(PICTURE > 127, PICTURE - 10, PICTURE + 10).astype(np.uint8)
    assert similarity(test).psnr == pytest.approx(20 * np.log10(255 / 10))


def test_equal_pictures_have_no_psnr_and_are_fully_similar():
    found = similarity(PICTURE)
    assert found.psnr is None
    assert found.ssim == pytest.approx(1.0, abs=1e-12)


def test_pixels_that_do_not_count_change_nothing():
    test = PICTURE.copy()
    test[:, 30:] = 0
    counted = ALL.copy()
    counted[:, 30 - 5 :] = False  # the window of the similarity reaches five pixels
    assert similarity(test, counted).psnr is None
    assert similarity(test, counted).ssim == pytest.approx(1.0, abs=1e-12)
    assert similarity(test).psnr < 20


def test_nothing_that_counts_has_no_similarity():
    assert similarity(PICTURE, ~ALL) is None


def test_overlap_is_what_both_cover_by_what_either_does():
    sums = OverlapSums()
    first, second = np.zeros((4, 4), dtype=np.float32), np.zeros((4, 4), dtype=np.float32)
    first[:2], second[1:3] = 1.0, 0.5
    assert sums.result() is None
    sums.add(first, second)
    assert sums.result() == pytest.approx(2.0 / 10.0)
