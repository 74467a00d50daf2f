"""The scope: what its raster, history, axes and measurements promise, without a terminal."""

from __future__ import annotations

import math
import unicodedata
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.style import Style

from zendsp.tui.colours import THEMES, trace_colours
from zendsp.tui.scope import Channel, History, ScopeSettings, encode, envelope, fill
from zendsp.tui.scope.lines import legend_lines
from zendsp.tui.scope.measure import cursor_lines, measure
from zendsp.tui.scope.path import Axes, Curve, plot_lines
from zendsp.tui.scope.picture import LIMIT, arrange, compose, fit_range
from zendsp.tui.scope.raster import braille
from zendsp.tui.scope.rolling import Rolling
from zendsp.tui.scope.ticks import duration, label, log_ticks, number, ticks
from zendsp.tui.scope.trigger import last_crossing
from zendsp.tui.values import show_value


def test_each_dot_is_the_braille_dot_that_unicode_names() -> None:
    numbers = {
        (0, 0): 1,
        (1, 0): 2,
        (2, 0): 3,
        (0, 1): 4,
        (1, 1): 5,
        (2, 1): 6,
        (3, 0): 7,
        (3, 1): 8,
    }
    for (row, column), n in numbers.items():
        dots = np.zeros((4, 2), dtype=bool)
        dots[row, column] = True
        assert unicodedata.name(braille(encode(dots)[0])) == f"BRAILLE PATTERN DOTS-{n}"
    assert braille(encode(np.zeros((4, 4), dtype=bool))[0]) == "  "


@pytest.mark.parametrize("samples", [1_000, 50_000])
def test_a_spike_of_one_sample_survives_any_zoom(samples: int) -> None:
    t = np.arange(samples) * 1e-3
    y = np.zeros((samples, 1))
    y[samples // 3] = 7.0
    low, high = envelope(t, y, 0.0, t[-1], 60)
    assert np.nanmax(high) == 7.0 and np.nanmin(low) == 0.0
    assert int((high[:, 0] > 3.5).sum()) <= 2  # and it stays narrow


def test_a_curve_of_few_samples_is_drawn_without_holes() -> None:
    t = np.array([0.0, 1.0, 2.0])
    low, high = envelope(t, np.array([[0.0], [10.0], [-5.0]]), 0.0, 2.0, 100)
    assert np.isfinite(low).all()
    # neighbouring columns share a value: no gap between them anywhere
    assert (
        np.maximum(low[1:, 0], low[:-1, 0]) <= np.minimum(high[1:, 0], high[:-1, 0]) + 1e-12
    ).all()
    dots = fill(low[:, 0], high[:, 0], -6.0, 11.0, 40)
    assert dots.any(axis=0).all()


def test_nan_draws_a_gap_and_nothing_else() -> None:
    t = np.arange(1000) * 1e-3
    y = np.sin(t)[:, None].copy()
    y[400:600] = np.nan
    low, _ = envelope(t, y, 0.0, 1.0, 100)
    assert np.isnan(low[41:59, 0]).all()
    assert np.isfinite(low[:39, 0]).all() and np.isfinite(low[61:99, 0]).all()


def test_infinity_is_a_gap_not_a_crash() -> None:
    t = np.arange(10.0)
    low, high = envelope(t, np.full((10, 1), np.inf), 0.0, 9.0, 20)
    assert np.isnan(low).all() and np.isnan(high).all()


def test_empty_data_and_an_empty_window_draw_nothing() -> None:
    low, _ = envelope(np.zeros(0), np.zeros((0, 2)), 0.0, 1.0, 10)
    assert low.shape == (10, 2) and np.isnan(low).all()
    low, _ = envelope(np.arange(5.0), np.zeros((5, 1)), 1.0, 1.0, 10)
    assert np.isnan(low).all()


@pytest.mark.parametrize("dots", [7, 40, 400])
@pytest.mark.parametrize("period_s", [1.013e-3, 0.041713])
def test_a_rolling_picture_is_that_of_all_rows(dots: int, period_s: float) -> None:
    """However few rows came, across gaps, restarts and in a ring that is full. No row is on a
    border, where it might be on either side.
    """
    random = np.random.default_rng(dots)
    history, rolling, tick = History(2, rows=1500), Rolling(), 1
    step = 1.0 / dots
    for k in range(120):
        n = int(random.integers(0, 60))
        if k == 70:
            tick = 1  # the target begins anew
        elif k % 9 == 0:
            tick += 50
        history.append(tick + np.arange(n), random.normal(size=(n, 2)), period_s)
        tick += n
        first, low, high = rolling.look(history, step, dots)
        t, y = history.newest()
        assert len(t) == 0 or first * step + 1.0 - step <= t[-1] <= first * step + 1.0
        whole = envelope(t, y, first * step, (first + dots) * step, dots)
        # at the left end the ring may have lost the row before the border meanwhile
        kept = slice(1, None) if history.count > 1500 else slice(None)
        assert np.allclose(low[kept], whole[0][kept], equal_nan=True)
        assert np.allclose(high[kept], whole[1][kept], equal_nan=True)


def test_a_picture_whose_curves_stand_still_does_not_move() -> None:
    history, rolling = History(1), Rolling()
    history.append(np.arange(100), np.zeros((100, 1)), 1e-3)
    assert rolling.moves(history, 0.15, 60)
    rolling.look(history, 0.15, 60)
    history.append(np.arange(100, 120), np.zeros((20, 1)), 1e-3)
    assert not rolling.moves(history, 0.15, 60), "the newest row is in the same column"
    assert rolling.moves(history, 0.15, 50)
    history.append(np.arange(120, 180), np.zeros((60, 1)), 1e-3)
    assert rolling.moves(history, 0.15, 60)


def test_where_traces_cross_both_stay_whole() -> None:
    t = np.linspace(0.0, 1.0, 500)
    y = np.stack((t, 1.0 - t), axis=1)
    settings = ScopeSettings(window=1.0)
    channels = [Channel("a"), Channel("b")]
    view, bands = (0.0, 1.0, 0.0), envelope(t, y, 0.0, 1.0, 80)
    both = compose(bands, channels, settings, view, {"": (0.0, 1.0)}, (40, 10))
    fixed = replace(settings, auto=False)
    ranges = {"": (both.lanes[0].bottom, both.lanes[0].top)}
    nothing = np.full_like(t, np.nan)
    for k in (0, 1):
        alone = np.stack((t if k == 0 else nothing, 1.0 - t if k == 1 else nothing), axis=1)
        bands = envelope(t, alone, 0.0, 1.0, 80)
        one = compose(bands, channels, fixed, view, ranges, (40, 10))
        mine = one.owner == k
        assert mine.any()
        assert (
            both.codes[mine] & one.codes[mine] == one.codes[mine]
        ).all(), "dots of one trace were lost under the other"


def test_units_get_lanes_and_a_low_screen_overlays_them() -> None:
    channels = [Channel("q", "rad"), Channel("tau", "N m"), Channel("e", "rad")]
    lanes = arrange(channels, ScopeSettings(), 20)
    assert [(lane.unit, lane.channels, lane.row) for lane in lanes] == [
        ("rad", (0, 2), 0),
        ("N m", (1,), 10),
    ]
    assert {lane.row for lane in arrange(channels, ScopeSettings(), 6)} == {0}


def test_the_axis_grows_at_once_and_shrinks_late() -> None:
    held = fit_range(np.array([-1.0]), np.array([1.0]), None)
    assert held[0] < -1.0 and held[1] > 1.0
    assert fit_range(np.array([-0.7]), np.array([0.7]), held) == held
    assert fit_range(np.array([-3.0]), np.array([1.0]), held)[0] < -3.0
    assert fit_range(np.array([0.0]), np.array([0.1]), held) != held
    low, high = fit_range(np.array([5.0]), np.array([5.0]), None)
    assert low < 5.0 < high  # a constant has an axis too


def test_limits_are_drawn_where_they_are_in_sight() -> None:
    t = np.linspace(0.0, 1.0, 100)
    y = np.sin(6 * t)[:, None]
    shown = envelope(t, y, 0.0, 1.0, 80), [Channel("q", "rad")], ScopeSettings(), (0, 1, 0), {}
    seen = compose(*shown, (40, 10), {"rad": [0.9, 50.0]})
    assert (seen.owner == LIMIT).any()
    unseen = compose(*shown, (40, 10), {"rad": [50.0]})
    assert not (unseen.owner == LIMIT).any()


def test_the_newest_crossing_is_found_between_samples() -> None:
    t = np.arange(1000) * 1e-3
    y = np.sin(2 * np.pi * 5 * t)
    assert last_crossing(t, y, 0.0, "rising", 0.95) == pytest.approx(0.8, abs=1e-6)
    assert last_crossing(t, y, 0.0, "falling", 0.95) == pytest.approx(0.9, abs=1e-6)
    assert last_crossing(t, y, 0.5, "rising", 0.05) == pytest.approx(
        np.arcsin(0.5) / (10 * np.pi), abs=1e-5
    )
    assert last_crossing(t, y, 2.0, "both", 1.0) is None


def test_history_is_bounded_keeps_order_and_shows_lost_rows() -> None:
    history = History(1, rows=100)
    for k in range(0, 1000, 7):
        history.append(np.arange(k, k + 7), np.arange(k, k + 7, dtype=float)[:, None], 0.001)
    t, y = history.newest()
    assert len(t) == 100 and (np.diff(t) > 0).all() and y[-1, 0] == 1000.0
    history.append(np.arange(1500, 1510), np.ones((10, 1)), 0.001)  # 499 samples are missing
    _, y = history.newest(12)
    assert int(np.isnan(y).sum()) == 1
    t, _ = history.since(1.505)
    assert t[0] <= 1.505 and len(t) <= 7


def test_a_restarted_target_begins_a_new_history() -> None:
    history = History(1)
    history.append(np.arange(50_000, 50_100), np.ones((100, 1)), 0.001)
    history.append(np.arange(0, 50), np.zeros((50, 1)), 0.001)
    t, _ = history.newest()
    assert len(t) == 50 and t[0] == 0.0


def test_numbers_on_axes_are_round_and_short() -> None:
    assert ticks(-0.3, 2.1, 4) == [0.0, 1.0, 2.0]
    assert len(ticks(-0.6, 0.6, 2)) >= 2, "an axis with one number has no scale"
    assert len(ticks(-4.9e-5, 4.9e-5, 2)) >= 2
    assert [label(v, 0.5) for v in (-0.5, 0.0, 1.5)] == ["-0.5", "0", "1.5"]
    assert label(123456.0, 1000.0) == "1.23e5"
    assert (duration(0.25), duration(2e-5), duration(300.0)) == ("250 ms", "20 µs", "5 min")
    assert (number(0.0), number(-0.0), number(float("nan")), number(3.14159265)) == (
        "0", "0", "—", "3.1416",
    )
    assert number(-1.877e-322) == "0", "what a filter leaves that dies away"
    assert show_value(np.array([-3070.0, 24113.0])) == "-3070 24113", "counts are whole"
    assert show_value(np.array([0.12345, 5.9e-323])) == "0.123 0"


def test_the_statistics_between_the_cursors_are_those_of_the_samples() -> None:
    t = np.linspace(0.0, 2.0, 2001)
    wave = 3.0 + 2.0 * np.sin(2.0 * np.pi * 5.0 * t)
    found = measure(t, wave, 1.5, 0.5)  # five whole periods, cursors the other way round
    assert found.mean == pytest.approx(3.0, abs=2e-3)
    assert found.deviation == pytest.approx(np.sqrt(2.0), rel=1e-3)
    assert found.rms == pytest.approx(np.sqrt(9.0 + 2.0), rel=1e-3)
    assert (found.low, found.high) == (pytest.approx(1.0), pytest.approx(5.0))
    assert np.isnan(found.rise), "a wave is no step"
    z, w = 0.3, 20.0
    wd = w * np.sqrt(1.0 - z * z)
    step = 1.0 - np.exp(-z * w * t) * (np.cos(wd * t) + z * w / wd * np.sin(wd * t))
    found = measure(t, 5.0 - 4.0 * step, 0.0, 2.0)  # downwards
    peak = np.exp(-np.pi * z / np.sqrt(1.0 - z * z))  # of a second-order system
    assert found.overshoot == pytest.approx(peak, rel=0.01)
    share = (t[np.argmax(step >= 0.9)] - t[np.argmax(step >= 0.1)])
    assert found.rise == pytest.approx(share, abs=2e-3)
    settings = ScopeSettings(cursor_a=0.0, cursor_b=1.0)
    whole: Any = SimpleNamespace(start=0.0, end=2.0, zero=0.0)
    line = cursor_lines(whole, settings, Channel("q"), t, -1234.5 * step[:, None], 66)[1]
    assert "rise " in line and line.endswith(f"over {100.0 * peak:.3g} % …"), "the range goes first"
    gap = np.where(t < 1.0, np.nan, 1.0)
    assert measure(t, gap, 0.0, 2.0).mean == 1.0 and np.isnan(measure(t, gap, 0.0, 0.5).mean)


def test_a_logarithmic_axis_has_round_numbers() -> None:
    def numbers(low: float, high: float, most: int) -> list[float]:
        return [float(f"{10.0**v:.3g}") for v in log_ticks(math.log10(low), math.log10(high), most)]

    assert numbers(0.5, 30.0, 8) == [0.5, 1.0, 2.0, 5.0, 10.0, 20.0]
    assert numbers(0.1, 1e4, 6) == [0.1, 1.0, 10.0, 100.0, 1e3, 1e4]
    assert len(numbers(3.1, 4.9, 6)) >= 2, "within a decade two numbers at the least"
    assert len(numbers(1e-12, 1e9, 4)) <= 5 and numbers(2.0, 2.0, 4) == []


@pytest.mark.parametrize("width", [80, 60, 160])
def test_every_curve_has_its_place_in_the_legend(width: int) -> None:
    names = ["q[0]", "q[1]", "e[0]", "e[1]", "tau[0]", "tau[1]", "r1", "r2"]
    texts = [
        [f" {k + 1}▐ {n}  -0.123456 N m/rad ", f" {k + 1}▐ {n}  -0.123456 ", f" {k + 1}▐ {n} "]
        for k, n in enumerate(names)
    ]
    lines = legend_lines(texts, width, 10)
    assert [k for line in lines for k, _ in line] == list(range(8)) and len(lines) <= 3
    assert all(sum(len(t) for _, t in line) <= width for line in lines)
    long = [[f" {k + 1}▐ {'a name of a signal' * 3} "] for k in range(8)]
    lines = legend_lines(long, width, 10)
    assert [k for line in lines for k, _ in line] == list(range(8)) and len(lines) <= 3
    assert legend_lines([], width, 10) == [[]]


@pytest.mark.parametrize("width", [24, 40, 100])
def test_no_name_beside_a_path_is_cut_in_silence(width: int) -> None:
    names = ["a run of a long name", "another run"]
    curves = [Curve(name, np.zeros((2, 2)), k) for k, name in enumerate(names)]
    axes = Axes(("f [Hz]", "dB"), equal=False, log_x=True, frame=(0.0, 2.0, 0.0, 1.0))
    lines = plot_lines(curves, axes, (width, 10), trace_colours(THEMES[0]), Style())
    legend = lines[0].text
    for name in names:
        assert name in legend or (f"{name[:2]}" in legend and "…" in legend)
    assert all(line.cell_length == width for line in lines)
    assert " f [Hz]" in lines[-1].text
