"""Means along time, against scipy's."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from scipy.linalg.blas import dtbsv
from scipy.ndimage import binary_dilation, gaussian_filter1d, median_filter, uniform_filter1d
from scipy.signal import butter, savgol_filter, sosfiltfilt

from zendsp.physics.kernel.native import swung
from zendsp.physics.kernel.smooth import (
    ROWS,
    gaussian,
    lowpassed,
    moving_mean,
    moving_median,
    polynomial,
    widened,
)

SIZES = (5, 50, 2001)


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("width", [1, 2, 3, 10, 41])
def test_a_moving_mean_is_that_of_scipy(n: int, width: int) -> None:
    x = np.random.default_rng(n).normal(size=n).cumsum()
    # the same sums in the same order
    assert np.array_equal(moving_mean(x, width), uniform_filter1d(x, width))
    assert np.array_equal(moving_mean(x, width, "edge"), uniform_filter1d(x, width, mode="nearest"))


@pytest.mark.parametrize("n", [*SIZES, ROWS, ROWS + 1])
@pytest.mark.parametrize("width", [1, 2, 41])
def test_a_moving_median_is_that_of_scipy(n: int, width: int) -> None:
    x = np.random.default_rng(n).normal(size=n)
    assert np.array_equal(moving_median(x, width), median_filter(x, width, mode="nearest"))


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("sigma", [0.3, 1.7, 40.0])
def test_gaussian_smoothing_is_that_of_scipy(n: int, sigma: float) -> None:
    x = np.random.default_rng(n).normal(size=(3, n))
    # sums of at most 321 terms of order 1: rounding
    np.testing.assert_allclose(
        gaussian(x, sigma), gaussian_filter1d(x, sigma, axis=1, mode="nearest"), atol=1e-14
    )


@pytest.mark.parametrize(("n", "rate", "cutoff"), [(2000, 500.0, 10.0), (901, 100.0, 20.0)])
def test_a_low_pass_is_the_butterworth_of_scipy_away_from_the_ends(
    n: int, rate: float, cutoff: float
) -> None:
    x = np.cumsum(np.random.default_rng(n).normal(size=n))
    expected = sosfiltfilt(butter(4, cutoff, fs=rate, output="sos"), x)
    edge = round(0.5 * rate)  # what begins in another way is forgotten
    np.testing.assert_allclose(
        lowpassed(x, cutoff, rate)[edge:-edge], expected[edge:-edge], atol=1e-5 * x.std()
    )


@pytest.mark.parametrize("ends", ["interp", "wrap"])
@pytest.mark.parametrize(("window", "degree", "order"), [(5, 2, 0), (11, 3, 1), (41, 3, 2)])
def test_the_polynomial_of_a_window_is_savitzky_s_and_golay_s(
    window: int, degree: int, order: int, ends: Literal["interp", "wrap"]
) -> None:
    x, step = np.random.default_rng(window).normal(size=(200, 2)).cumsum(axis=0), 0.002
    expected = savgol_filter(x, window, degree, order, step, axis=0, mode=ends)
    about = 1e-11 * np.abs(expected).max()  # rounding of some tens of terms, also near the ends
    found = polynomial(x, window, degree, order, step, ends)
    np.testing.assert_allclose(found, expected, atol=about)
    column = polynomial(x[:, 1], window, degree, order, step, ends)
    np.testing.assert_allclose(column, found[:, 1], atol=about)


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("around", [1, 3, 60])
def test_a_mask_widens_as_scipy_dilates_it(n: int, around: int) -> None:
    mask = np.random.default_rng(n).random(n) > 0.9
    assert np.array_equal(widened(mask, around), binary_dilation(mask, iterations=around))


def test_what_hangs_on_a_joint_swings_as_the_triangular_band_says() -> None:
    a, h, first, second = np.random.default_rng(0).normal(size=500), 1e-3, 1.97, -0.98
    band = np.tile([[1.0], [-first], [-second]], len(a))
    expected = dtbsv(2, band, h * h * np.concatenate([[0.0], a[:-1]]), lower=1, diag=1)
    np.testing.assert_allclose(swung(a, h, first, second), expected, rtol=1e-9, atol=1e-18)
