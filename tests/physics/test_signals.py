"""The smoother against a Kalman filter with RTS pass in NumPy, and the measurement model of a
quantised sensor against the truth.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, filtfilt

from zendsp.physics.kernel.native import native
from zendsp.physics.kernel.signals import (
    EDGE_FLOOR,
    find_resolution,
    measure,
    noise_beside_quantisation,
    smooth,
)

T = 0.002
COUNT = 2 * np.pi / 4096


def rts(
    y: np.ndarray, variance: np.ndarray, a_in: np.ndarray, sd: float, sd0: float, v0: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Textbook Kalman filter and Rauch-Tung-Striebel smoother of (q, qd, d), with matrix inverses:
    states (n, 3), variances (n, 3), -2 log-likelihood.
    """
    n = len(y)
    F = np.array([[1, T, T * T / 2], [0, 1, T], [0, 0, 1]])
    Q = sd**2 * np.array(
        [[T**5 / 20, T**4 / 8, T**3 / 6], [T**4 / 8, T**3 / 3, T**2 / 2], [T**3 / 6, T**2 / 2, T]]
    )
    x = np.array([y[0], v0, 0.0])
    P = np.diag([1e4 * variance[0], 1e4 * 1e4 * variance[0] + 1e-3, sd0**2])
    xf = np.empty((n, 3))
    Pf = np.empty((n, 3, 3))
    xp = np.empty((n, 3))
    Pp = np.empty((n, 3, 3))
    nll = 0.0
    for k in range(n):
        xp[k], Pp[k] = x, P
        if variance[k] > 0:
            S, e = P[0, 0] + variance[k], y[k] - x[0]
            K = P[:, 0] / S
            nll += np.log(S) + e * e / S
            x, P = x + K * e, P - np.outer(K, P[0])
        xf[k], Pf[k] = x, P
        x = F @ x + np.array([T * T / 2, T, 0]) * a_in[k]
        P = F @ P @ F.T + Q
    xs, Ps = xf.copy(), Pf.copy()
    for k in range(n - 2, -1, -1):
        C = Pf[k] @ F.T @ np.linalg.inv(Pp[k + 1])
        xs[k] = xf[k] + C @ (xs[k + 1] - xp[k + 1])
        Ps[k] = Pf[k] + C @ (Ps[k + 1] - Pp[k + 1]) @ C.T
    return xs, np.stack([np.diag(p) for p in Ps]), float(nll)


def test_smoother_is_the_rauch_tung_striebel_smoother() -> None:
    r = np.random.default_rng(0)
    n = 400
    t = np.arange(n) * T
    y = 0.3 * np.sin(7 * t) + 1e-3 * r.standard_normal(n)
    variance = np.full(n, 1e-6)
    variance[50:60] = -1.0  # samples that say nothing
    a_in = np.ascontiguousarray(2 * np.cos(5 * t))
    sd, sd0, v0 = 30.0, 40.0, 1.9
    xs, Ps, nll = rts(y, variance, a_in, sd, sd0, v0)
    lib = native()
    work, out, var, half = np.empty(14 * n), np.empty((3, n)), np.empty((3, n)), np.zeros(n)
    p = lib.doubles
    got = lib.lib.zf_smooth(
        n, T, sd, sd0, p(a_in), p(y), p(half), p(variance), float(y[0]), v0, p(work), p(out), p(var)
    )
    assert got == pytest.approx(nll, rel=1e-9)
    assert np.max(np.abs(out - xs.T) / np.ptp(xs, axis=0)[:, None]) < 1e-6
    # the textbook form loses digits to its inverses where variances are tiny
    np.testing.assert_allclose(var[:, 5:-5], Ps.T[:, 5:-5], rtol=2e-3)


def motion(speed: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    t = np.arange(4000) * T
    w = 2.0
    q = speed / w * np.sin(w * t) + 0.3
    return t, q, speed * np.cos(w * t), -speed * w * np.sin(w * t)


def test_true_position_lies_in_the_interval_of_every_plateau() -> None:
    _, q, _, _ = motion(0.1)
    m = measure(COUNT * np.round(q / COUNT), T, COUNT)
    plateau = m.half > 0
    assert plateau.mean() > 0.5  # slow: most samples are plateaus
    assert np.all(np.abs(m.value[plateau] - q[plateau]) <= m.half[plateau] * (1 + 1e-9))


def test_code_changes_are_measurements_with_the_variance_that_they_claim() -> None:
    _, q, qd, _ = motion(0.1)
    m = measure(COUNT * np.round(q / COUNT), T, COUNT)
    edge = (m.half == 0) & (np.abs(qd) > 0.02)
    error = (m.value - q)[edge] / np.sqrt(m.variance[edge])
    assert edge.sum() > 100
    assert 0.5 < np.sqrt(np.mean(error**2)) < 1.3  # one, if claimed exactly
    # and far better than the code itself
    assert np.sqrt(np.mean((m.value - q)[edge] ** 2)) < 0.5 * COUNT / np.sqrt(12)
    assert np.all(m.variance[edge] >= (EDGE_FLOOR * COUNT) ** 2)


def test_slow_quantised_motion_is_smoothed_to_a_fraction_of_a_count() -> None:
    _, q, qd, qdd = motion(0.1)
    m = measure(COUNT * np.round(q / COUNT), T, COUNT)
    got = smooth(m, T, (qdd + 0.05)[:, np.newaxis])  # the known acceleration is wrong by a constant
    inner = slice(200, -200)
    assert np.std((got.states[0] - q)[inner]) < 0.12 * COUNT
    assert np.std((got.states[1] - qd)[inner]) < 0.01 * np.max(np.abs(qd))
    # the smoother's own variances are honest about the velocity
    z = (got.states[1] - qd)[inner] / np.sqrt(got.variances[1][inner])
    assert 0.3 < np.sqrt(np.mean(z**2)) < 2.0


@pytest.mark.parametrize("resolution", [COUNT, 2e-7, 0.01])
def test_resolution_is_found_from_the_numbers(resolution: float) -> None:
    q = resolution * (200 * np.sin(np.arange(5000) * 0.003))
    assert find_resolution(resolution * np.round(q / resolution)) == pytest.approx(
        resolution, rel=1e-6
    )
    assert (
        find_resolution(q + 1e-3 * resolution * np.random.default_rng(0).standard_normal(5000))
        == 0.0
    )


def test_sensor_noise_is_told_from_quantisation() -> None:
    r = np.random.default_rng(2)
    _, q, _, _ = motion(3.0)
    quiet = COUNT * np.round(q / COUNT)
    loud = COUNT * np.round((q + 2 * COUNT * r.standard_normal(len(q))) / COUNT)
    assert noise_beside_quantisation(quiet, COUNT) < 0.35 * COUNT
    assert noise_beside_quantisation(loud, COUNT) == pytest.approx(2 * COUNT, rel=0.15)


@pytest.mark.parametrize("speed", [0.002, 0.05, 0.3, 3.0])  # counts a sample, at most
@pytest.mark.parametrize("noise", [0.5, 1.0, 3.0])
def test_sensor_noise_is_known_at_any_speed(speed: float, noise: float) -> None:
    time, r = np.arange(20_000) * 1e-3, np.random.default_rng(1)
    smooth = speed / (np.pi * 1e-3) * np.sin(np.pi * time) + 3 * np.sin(0.3 * time)
    coded = COUNT * np.round(smooth + noise * r.standard_normal(len(time)))
    assert noise_beside_quantisation(coded, COUNT) == pytest.approx(noise * COUNT, rel=0.1)
    assert noise_beside_quantisation(COUNT * np.round(smooth), COUNT) < 0.1 * COUNT


def test_noise_that_a_filter_took_out_of_neighbouring_samples_is_seen_over_longer_ones() -> None:
    time, r = np.arange(20_000) * 1e-3, np.random.default_rng(3)
    motion, white = np.sin(6 * time), 1e-3 * r.standard_normal(len(time))
    top, bottom = butter(2, 0.25)
    filtered = motion + filtfilt(top, bottom, white)
    assert noise_beside_quantisation(filtered, 0.0) > 0.3e-3
    assert noise_beside_quantisation(motion + white, 0.0) == pytest.approx(1e-3, rel=0.1)
    assert noise_beside_quantisation(motion, 0.0) < 1e-8


@pytest.mark.parametrize("noise", [0.1, 0.13, 0.2])
def test_noise_of_a_fraction_of_a_count_shows_where_a_motion_is_slow(noise: float) -> None:
    t = np.arange(20000) * 1e-3
    motion = COUNT * 200 * np.sin(0.9 * t)  # 0.18 counts a sample at most
    loud = motion + noise * COUNT * np.random.default_rng(7).standard_normal(len(t))
    found = noise_beside_quantisation(COUNT * np.round(loud / COUNT), COUNT)
    assert found == pytest.approx(noise * COUNT, rel=0.15)
    assert noise_beside_quantisation(COUNT * np.round(motion / COUNT), COUNT) < 0.05 * COUNT


@pytest.mark.parametrize("seed", [1, 2, 4])
def test_a_recording_with_little_slow_motion_has_no_less_noise_than_a_long_one(seed: int) -> None:
    """Of three recordings of one sensor two were said to have none of its 0.12 counts, and their
    median took them from the third: 3.7 % of the torque of a complete model seemed missing.
    """
    time, r = np.arange(3000) * 1e-3, np.random.default_rng(seed)
    motion = 100 * np.sin(3.5 * time)  # 0.35 counts a sample at most
    noisy = np.round(motion + 0.12 * r.standard_normal(len(time)))
    assert noise_beside_quantisation(noisy, 1.0) == pytest.approx(0.12, abs=0.03)
    assert noise_beside_quantisation(np.round(motion), 1.0) < 0.05


@pytest.mark.parametrize("pace", [0.45, 0.8, 1.04, 3.3])
def test_noise_is_told_in_motion_at_a_constant_number_of_counts_a_sample(pace: float) -> None:
    """Rounding errors are then equal from sample to sample. Subtracted as if they were white, they
    had left nothing of 0.3 counts of noise, and a perfect model seemed to lack a torque.
    """
    r, time = np.random.default_rng(1), np.arange(14000)
    speed = pace * np.where((time // 1700) % 2, 1, -1) * (1 + 0.02 * np.sin(time / 300))
    path = np.cumsum(speed)
    noisy = np.round(path + 0.3 * r.standard_normal(len(path)))
    assert noise_beside_quantisation(noisy, 1.0) == pytest.approx(0.3, rel=0.1)
    assert noise_beside_quantisation(np.round(path), 1.0) < 0.05
