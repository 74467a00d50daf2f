"""The scope: what its raster promises, without a terminal where possible."""

from __future__ import annotations

import math
import time
import unicodedata
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rich.style import Style
from textual.app import App, ComposeResult
from textual.color import Color
from waiting import PATIENCE_S

from zendsp.tui.colours import DARK, LIGHT, THEMES, trace_colours
from zendsp.tui.scope import Channel, History, Scope, ScopeSettings, encode, envelope, fill
from zendsp.tui.scope.lines import legend_lines
from zendsp.tui.scope.measure import measure
from zendsp.tui.scope.path import Axes, Curve, plot_lines
from zendsp.tui.scope.picture import LIMIT, arrange, compose, fit_range
from zendsp.tui.scope.raster import braille
from zendsp.tui.scope.rolling import Rolling
from zendsp.tui.scope.spectrum import ready
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


def test_nan_opens_a_gap_and_nothing_else() -> None:
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
        "0",
        "0",
        "—",
        "3.1416",
    )
    assert number(-1.877e-322) == "0", "what a filter leaves that dies away"
    assert show_value(np.array([-3070.0, 24113.0])) == "-3070 24113", "counts are whole"
    assert show_value(np.array([0.12345, 5.9e-323])) == "0.123 0"


def _contrast(a: str, b: str) -> float:
    la, lb = (Color.parse(c).rgb for c in (a, b))

    def luminance(rgb: tuple[int, int, int]) -> float:
        parts = [
            c / 255 / 12.92 if c / 255 <= 0.03928 else ((c / 255 + 0.055) / 1.055) ** 2.4
            for c in rgb
        ]
        return 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2]

    high, low = sorted((luminance(la), luminance(lb)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_traces_stand_out_from_dark_and_light_backgrounds() -> None:
    assert min(_contrast(c, "#0E1216") for c in DARK) >= 3.0  # WCAG 1.4.11 for graphics
    assert min(_contrast(c, "#F4F5F6") for c in LIGHT) >= 3.0


def _machado(rgb: np.ndarray, kind: str) -> np.ndarray:
    """Colours as seen with full dichromacy (Machado, Oliveira, Fernandes 2009, table 1, severity
    1.0), linear RGB.
    """
    matrix = {
        "protan": [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ],
        "deutan": [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ],
    }[kind]
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return np.clip(linear @ np.array(matrix).T, 0.0, 1.0)


def _lab(linear: np.ndarray) -> np.ndarray:
    xyz = (
        linear
        @ np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]).T
    )
    f = np.cbrt(xyz / np.array([0.9505, 1.0, 1.089]))
    return np.stack(
        (116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])), axis=1
    )


@pytest.mark.parametrize("kind", ["protan", "deutan"])
@pytest.mark.parametrize("palette", [DARK, LIGHT], ids=["dark", "light"])
def test_all_eight_traces_stay_apart_for_colour_blind_eyes(
    kind: str, palette: tuple[str, ...]
) -> None:
    rgb = np.array([Color.parse(c).rgb for c in palette]) / 255.0
    lab = _lab(_machado(rgb, kind))
    apart = np.linalg.norm(lab[:, None] - lab[None], axis=2) + 1e3 * np.eye(8)
    # CIE 1976: 2.3 is just noticeable; lines of dots need a few times that
    assert apart.min() > 15.0


class _Bench(App[None]):
    def compose(self) -> ComposeResult:
        yield Scope(id="scope")


def _wave(n: int) -> tuple[np.ndarray, np.ndarray]:
    k = np.arange(n)
    return k, np.stack((np.sin(k / 159.2), np.cos(k / 159.2)), axis=1)


async def test_the_widget_survives_no_data_resizing_and_tiny_sizes() -> None:
    app = _Bench()
    async with app.run_test(size=(80, 24)) as pilot:
        scope = app.query_one(Scope)
        await pilot.pause()
        scope.show_channels([Channel("a", "rad"), Channel("b", "N m")])
        for size in ((80, 24), (20, 8), (9, 3), (200, 60), (40, 6)):
            await pilot.resize_terminal(*size)
            await pilot.pause()
            scope.history.append(*_wave(500), 0.001)
            scope.redraw()
            await pilot.pause()
            for row in range(scope.size.height):
                assert scope.render_line(row).cell_length == scope.size.width


async def test_a_frozen_picture_keeps_its_data_and_the_history_can_be_visited() -> None:
    app = _Bench()
    async with app.run_test(size=(100, 30)) as pilot:
        scope = app.query_one(Scope)
        scope.show_channels([Channel("a"), Channel("b")])
        scope.set(replace(scope.settings, window=1.0))
        ticks_, y = _wave(5000)
        scope.history.append(ticks_, y, 0.001)
        scope.pause(True)
        await pilot.pause()
        assert scope.picture is not None
        before, end = scope.picture.codes.copy(), scope.picture.end
        scope.history.append(ticks_ + 5000, y * 9.0, 0.001)
        scope.redraw()
        await pilot.pause()
        assert (scope.picture.codes == before).all()
        scope.pan(2.0)
        await pilot.pause()
        assert scope.picture.end == pytest.approx(end - 2.0, abs=0.02)
        scope.pause(False)
        await pilot.pause()
        assert scope.picture.end > end + 4.0


async def test_a_picture_without_new_rows_says_that_it_is_old(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 100.0
    monkeypatch.setattr("zendsp.tui.scope.widget.time", SimpleNamespace(monotonic=lambda: now))
    app = _Bench()
    async with app.run_test(size=(100, 30)) as pilot:
        scope = app.query_one(Scope)
        scope.show_channels([Channel("a"), Channel("b")])
        await pilot.pause()
        ticks_, y = _wave(2000)
        scope.history.append(ticks_, y, 0.001)
        for now, machine_s, old in (
            (100.0, 2.0, False),
            (160.0, 2.0, False),  # the machine does not go on either
            (160.5, 2.5, False),
            (162.0, 4.0, True),
        ):
            scope.mark_old(machine_s)
            await pilot.pause()
            assert ("OLD ROLL 5 s" in scope.render_line(0).text) == old, (now, machine_s)
        scope.history.append(ticks_ + 3000, y, 0.001)
        scope.mark_old(5.0)
        await pilot.pause()
        assert " ROLL 5 s" in scope.render_line(0).text and "OLD" not in scope.render_line(0).text


async def test_the_trigger_stands_where_the_pre_trigger_says_and_single_freezes() -> None:
    app = _Bench()
    async with app.run_test(size=(109, 30)) as pilot:
        scope = app.query_one(Scope)
        scope.show_channels([Channel("a"), Channel("b")])
        scope.set(
            replace(scope.settings, mode="trigger", window=0.5, pre=0.3, level=0.5, edge="rising")
        )
        ticks_, y = _wave(3000)
        scope.history.append(ticks_, y, 0.001)
        scope.redraw()
        await pilot.pause()
        picture = scope.picture
        assert picture is not None
        at = picture.start + 0.3 * 0.5
        assert picture.zero == pytest.approx(at)
        assert (
            np.sin(at * 1000 / 159.2) == pytest.approx(0.5, abs=0.01)
            and np.cos(at * 1000 / 159.2) > 0
        )
        scope.arm_single()
        await pilot.pause()
        assert not scope.paused, "crossings before arming do not count"
        scope.history.append(ticks_ + 3000, y, 0.001)
        scope.redraw()
        await pilot.pause()
        assert scope.paused and not scope.single


async def test_cursors_measure_time_and_value() -> None:
    app = _Bench()
    async with app.run_test(size=(109, 30)) as pilot:
        scope = app.query_one(Scope)
        scope.show_channels([Channel("ramp", "rad")])
        k = np.arange(2001)
        scope.history.append(k, (k * 0.002)[:, None], 0.001)
        scope.set(replace(scope.settings, window=1.0, cursors=True, cursor_a=0.25, cursor_b=0.75))
        await pilot.pause()
        text = scope.readout(*scope.history.newest())
        assert "Δt 500 ms = 1/2 Hz" in text
        assert "Δy 1 rad" in text


async def test_units_in_brackets_reach_the_screen() -> None:
    app = _Bench()
    async with app.run_test(size=(100, 30)) as pilot:
        scope = app.query_one(Scope)
        scope.show_channels([Channel("q [rad]", "[N m]")])
        scope.history.append(np.arange(100), np.ones((100, 1)), 0.001)
        scope.redraw()
        await pilot.pause()
        text = "\n".join(scope.render_line(r).text for r in range(scope.size.height))
        assert "q [rad]" in text and "[N m]" in text


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


@pytest.mark.parametrize(
    ("view", "numbers"), [("spectrum", "1 10 1e-4 0.01"), ("xy", "-1.0 0 1.0")]
)
async def test_there_are_numbers_on_the_axes_before_there_is_data(view: str, numbers: str) -> None:
    class One(App[None]):
        def compose(self) -> ComposeResult:
            yield Scope()

    app = One()
    async with app.run_test(size=(80, 16)) as pilot:
        scope = app.query_one(Scope)
        scope.show_channels([Channel("x", "m"), Channel("y", "m")])
        scope.set(replace(scope.settings, view=view))
        deadline = time.monotonic() + PATIENCE_S
        while not ready() and time.monotonic() < deadline:
            await pilot.pause(0.05)
        scope.redraw()
        await pilot.pause()
        shown = "\n".join(strip.text for strip in app.screen._compositor.render_strips()).split()
        found = {word.strip("▏") for word in shown}
        assert found.issuperset(numbers.split()), sorted(found)


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
