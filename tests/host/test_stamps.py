"""Time stamps that are a rounding of an even clock are told from stamps that jitter."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from zendsp.recording.stamps import EvenClock, even_clock, even_times

Array = npt.NDArray[np.float64]
ROWS = 4000


def rounded(
    rate: float, quantum: float, lost: Array | list[int], cut: bool = False
) -> tuple[Array, Array]:
    """Stamps of an even clock, written with few digits, and the number of each row's sample."""
    count = np.delete(np.arange(ROWS), np.asarray(lost, dtype=np.int64))
    true = (count + 0.3127) / rate
    return np.around((np.floor if cut else np.round)(true / quantum) * quantum, 9), count


def found(stamps: Array, stated: float | None = None) -> EvenClock:
    clock = even_clock(stamps, stated)
    assert clock is not None
    return clock


RATES = [
    (rate, quantum)
    for quantum, rates in {
        0.01: (30.0, 43.7, 60.0, 80.0, 90.0),
        0.001: (130.0, 240.0, 300.0, 400.0, 512.0, 640.0, 700.0, 800.0, 900.0),
        0.0001: (300.0, 333.0, 1024.0, 3000.0, 8000.0),
    }.items()
    for rate in rates
]


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize("lost", [0, 1, 5, 200])
@pytest.mark.parametrize(("rate", "quantum"), RATES)
def test_rounded_stamps_of_any_rate_are_an_even_clock_and_missing_rows_are_seen(
    rate: float, quantum: float, lost: int, cut: bool
) -> None:
    """At 800 Hz, in ms, 4000 of 16000 rows seemed to be missing, and at 400 Hz the sample time was
    3 ms.
    """
    gone = np.random.default_rng(lost).choice(np.arange(1, ROWS - 1), lost, replace=False)
    stamps, count = rounded(rate, quantum, gone, cut)
    clock = found(stamps)
    np.testing.assert_array_equal(clock.count, count - count[0])
    # the two ends are known to a quantum
    assert abs(clock.period * rate - 1.0) * ROWS / rate < 1.1 * quantum


@pytest.mark.parametrize("rate", [400.0, 800.0])
@pytest.mark.parametrize("lost", [[], [700, 3000, 3001]])
def test_a_stated_sample_time_is_taken_only_where_the_stamps_agree(
    rate: float, lost: list[int]
) -> None:
    stamps, count = rounded(rate, 0.001, lost)
    assert found(stamps, 1.0 / rate).period == 1.0 / rate
    for wrong in (1.001 / rate, 0.003, 0.001):
        clock = found(stamps, wrong)
        assert clock.period == pytest.approx(1.0 / rate, rel=1e-4)
        np.testing.assert_array_equal(clock.count, count - count[0])


@pytest.mark.parametrize("begin", [4095.0, 8190.0, 16000.0])  # s; the quantum doubles at 2^n
@pytest.mark.parametrize("lost", [[], [700, 3000, 3001]])
def test_stamps_in_single_precision_hours_after_the_start_are_an_even_clock(
    begin: float, lost: list[int]
) -> None:
    count = np.delete(np.arange(ROWS), lost)
    stamps = (begin + count / 400.0).astype(np.float32).astype(np.float64)
    for written in (stamps, np.around(stamps, 6)):
        clock = found(written)
        np.testing.assert_array_equal(clock.count, count)
        assert clock.period * 400.0 == pytest.approx(1.0, rel=1e-4)


def test_a_clock_that_runs_a_little_fast_is_even_too() -> None:
    stamps, count = rounded(400.0 * (1 + 5e-5), 0.001, [800])
    np.testing.assert_array_equal(found(stamps, 0.0025).count, count)


@pytest.mark.parametrize("jitter", [0.0004, 0.0007])  # s
@pytest.mark.parametrize("quantum", [0.001, 0.0001, 1e-6])
def test_stamps_that_jitter_by_more_than_they_are_rounded_are_no_even_clock(
    jitter: float, quantum: float
) -> None:
    true = (np.arange(ROWS) + 0.3127) / 400.0
    true += np.random.default_rng(1).uniform(-jitter, jitter, ROWS)
    assert even_clock(np.around(np.round(true / quantum) * quantum, 9)) is None


def test_stamps_that_jitter_about_whole_multiples_of_the_widest_are_no_even_clock() -> None:
    """Rows were read up to a quarter of a sample early or late. In half of such recordings the
    shortest step, the mean of all others and the longest were one, two and three times the same,
    and a complete pendulum was unexplained.
    """
    for seed in range(8):
        late = np.random.default_rng(seed).uniform(-0.25, 0.25, 20_000)
        assert even_clock((np.arange(late.size) + late) * 0.001) is None


def test_a_clock_whose_steps_wander_is_no_even_clock() -> None:
    """A loop that waits for a while after each sample, stamped in ms."""
    steps = np.random.default_rng(2).choice([0.002, 0.003], ROWS)
    assert even_clock(np.cumsum(steps)) is None


@pytest.mark.parametrize("lost", [[700], [700, 3000, 3001]])
def test_rows_missing_from_stamps_as_coarse_as_the_sample_time_are_missing(
    lost: list[int],
) -> None:
    """A clock slower by a few ten thousandths would explain the same stamps."""
    stamps, count = rounded(1000.0, 0.001, lost)
    np.testing.assert_array_equal(found(stamps).count, count - count[0])


def test_times_are_put_back_to_the_even_clock_and_others_are_kept() -> None:
    stamps, count = rounded(400.0, 0.001, [900])
    np.testing.assert_allclose(np.diff(even_times(stamps)), np.diff(count) / 400.0, rtol=1e-4)
    for other in (stamps[::-1], np.where(count == 50, np.nan, stamps), np.cumsum(stamps)):
        assert even_times(other) is other
