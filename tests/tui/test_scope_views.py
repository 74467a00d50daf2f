"""What the scope computes: formulas, XY, spectra, scales, files, layouts."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from textual.app import App, ComposeResult

from zendsp.errors import RecordingError, ZendspError
from zendsp.recording import Recording
from zendsp.tui.scope import Channel, History, Scale, Scope, ScopeSettings, envelope
from zendsp.tui.scope.export import Seen, check_name, export
from zendsp.tui.scope.formula import Computed, Formula, FormulaError, sources
from zendsp.tui.scope.layouts import Layout, load_layout, save_layout
from zendsp.tui.scope.picture import arrange, compose
from zendsp.tui.scope.plane import over_frequency, over_selected
from zendsp.tui.scope.spectrum import density, ready

UNITS = {"r1": "rad", "q1": "rad", "q[0]": "rad", "u": "N m"}
DT = 1e-3


def _run(formula: str, blocks: int = 7, **columns: np.ndarray) -> np.ndarray:
    """A formula over columns that come in blocks, as live rows do."""
    found = Formula.read(f"x = {formula}")
    history = History(1)
    computed = Computed([Channel("x", "", found.expression)], history.append)
    rows = np.stack([columns[name] for name in computed.sources], axis=1)
    for part in np.array_split(np.arange(len(rows)), blocks):
        computed(part.astype(np.int64), rows[part], DT)
    return history.newest()[1][:, 0]


def test_a_formula_names_its_signals_and_its_unit() -> None:
    error = Formula.read("e = r1 - q1", UNITS)
    assert (error.names, error.unit) == (("r1", "q1"), "rad")
    assert Formula.read("w = d(lp(q[0], 20))", UNITS).unit == "rad/s"
    assert Formula.read("p [W] = u * d(q1)", UNITS).unit == "W"
    assert Formula.read("p = u * q1", UNITS).unit == ""


@pytest.mark.parametrize(
    "text, why",
    [
        ("r1 - q1", "write name = expression"),
        ("e = r1 -", "is not an expression"),
        ("e = __import__('os')", "no function '__import__'"),
        ("e = q1.real", "has no place here"),
        ("e = (lambda: 1)()", "has no place here"),
        ("e = [q1 for q1 in u]", "has no place here"),
        ("e = 'text'", "has no place here"),
        ("e = q1 if u else r1", "has no place here"),
        ("e = r2 - q1", "no signal 'r2'"),
        ("q1 = r1 * 2", "is a signal of the program"),
        ("e [rad] = q1/0", "'q1/0' is no number, whatever the signals are"),
        ("e = sqrt(-1 - q1*q1)", "is no number, whatever"),
        ("e = sqrt(-q1)", None),
        ("e = lp(q1)", "takes? two|take two"),
        ("e = lp(q1, 0)", "0 Hz is none"),
        ("e = lp(q1, u)", "no number in Hz"),
        ("e = lp(q1, 1" + "0" * 180 + ")", None),
        ("e = " + "-" * 190 + "q1", None),
    ],
)
def test_a_formula_that_cannot_be_is_refused_with_a_reason(text: str, why: str | None) -> None:
    if why is None:  # long and deep, but possible: no crash
        Formula.read(text, UNITS)
        return
    with pytest.raises(FormulaError, match=why):
        Formula.read(text, UNITS)


def test_a_difference_of_two_signals() -> None:
    t = np.arange(500) * DT
    assert np.allclose(_run("r1 - 2*q1 + 1", r1=t, q1=t**2), t - 2 * t**2 + 1, atol=1e-15)


def test_a_derivative_does_not_see_the_borders_of_blocks() -> None:
    t = np.arange(2000) * DT
    found = _run("d(q)", 113, q=np.sin(7.0 * t))
    assert np.isnan(found[0])
    middle = t[1:] - DT / 2.0
    # a difference over DT is the derivative in its middle but for (7 DT)²/24 of it
    assert np.abs(found[1:] - 7.0 * np.cos(7.0 * middle)).max() < 7.0 * (7.0 * DT) ** 2 / 20.0


def test_the_filter_is_first_order_with_its_corner_where_it_says() -> None:
    t = np.arange(4000) * DT
    found = _run("lp(u, 5)", 37, u=(t > 0.0).astype(float))
    assert np.allclose(found, 1.0 - np.exp(-2 * np.pi * 5.0 * t), atol=1e-12), "of a step"
    sine = _run("lp(u, 5)", 37, u=np.sin(2 * np.pi * 5.0 * t))[2000:]
    # −3 dB at the corner; the hold of one sample adds (π 5 DT)² / 6
    assert np.abs(sine).max() == pytest.approx(np.sqrt(0.5), rel=1e-3)


def test_state_does_not_outlive_missing_rows() -> None:
    history = History(1)
    computed = Computed([Channel("x", "", "d(q)")], history.append)
    computed(np.arange(10), np.ones((10, 1)), DT)
    computed(np.arange(500, 510), np.full((10, 1), 9.0), DT)  # 490 rows never arrived
    y = history.newest()[1][:, 0]
    assert not np.nansum(np.abs(y)), "no spike of 8 over the gap"
    computed(np.arange(505, 512), np.full((7, 1), 9.0), DT)  # five of them came before
    assert len(history.newest()[0]) == 23


def test_an_undefined_value_is_a_gap() -> None:
    found = _run("sqrt(q) / (q - 3)", q=np.array([-1.0, 0.0, 3.0, 4.0]))
    assert np.isnan(found[0]) and np.isinf(found[2]) and found[3] == 2.0


def test_a_channel_used_by_several_curves_is_streamed_once() -> None:
    channels = [Channel("q1"), Channel("e", "", "r1 - q1"), Channel("w", "", "d(q1) + 0*t")]
    assert sources(channels) == ["q1", "r1"]


def test_the_density_of_noise_is_what_it_was_made_with() -> None:
    rng = np.random.default_rng(1)
    t = np.arange(20_000) * DT
    # white noise of variance v at 1 kHz has a one-sided density of √(2 v DT)
    f, amplitude = density(t, rng.normal(0.0, 0.3, (len(t), 1)))
    assert np.median(amplitude) == pytest.approx(0.3 * np.sqrt(2 * DT), rel=0.15)
    assert f[-1] == pytest.approx(500.0) and f[0] > 0.0


def test_a_sine_stands_at_its_frequency_with_its_power() -> None:
    t = np.arange(8000) * DT
    f, amplitude = density(t, (5.0 + 2.0 * np.sin(2 * np.pi * 40.0 * t))[:, None])
    assert f[np.argmax(amplitude[:, 0])] == pytest.approx(40.0, abs=f[0])
    near = abs(f - 40.0) < 2.0
    power = np.sum(amplitude[near, 0] ** 2) * f[0]
    assert power == pytest.approx(2.0, rel=0.02), "2²/2, whatever the window"


def test_a_spectrum_takes_the_longest_part_without_a_gap() -> None:
    t = np.arange(3000) * DT
    y = np.sin(2 * np.pi * 50.0 * t)[:, None].copy()
    y[500] = np.nan
    y = np.hstack((y, np.full_like(y, np.nan)))
    f, amplitude = density(t, y)
    assert f[np.argmax(amplitude[:, 0])] == pytest.approx(50.0, abs=f[0])
    assert len(density(t[:10], y[:10])[0]) == 0


def test_xy_is_over_the_selected_curve_with_equal_scales_where_units_are() -> None:
    channels = [Channel("q1", "rad"), Channel("q2", "rad"), Channel("u", "N m")]
    y = np.arange(9.0).reshape(3, 3)
    curves, axes = over_selected(channels[:2], 1, y[:, :2])
    assert axes.equal and axes.names == ("q2 [rad]", "rad") and curves[0].name == "q1"
    assert np.array_equal(curves[0].xy, y[:, [1, 0]])
    _, axes = over_selected(channels, 0, y)
    assert not axes.equal
    assert over_frequency(channels, np.ones(2), np.ones((2, 3)))[0][2].name == "u N m/√Hz"


def test_a_curve_may_have_a_lane_and_an_axis_of_its_own() -> None:
    channels = [Channel("a", "rad"), Channel("b", "rad"), Channel("c", "V")]
    each = arrange(channels, ScopeSettings(lanes="curve"), 24)
    assert [lane.channels for lane in each] == [(0,), (1,), (2,)]
    together = ScopeSettings(scales={"b": Scale(lane=1), "c": Scale(lane=1)})
    assert [(lane.channels, lane.unit) for lane in arrange(channels, together, 24)] == [
        ((0,), "rad"),
        ((1, 2), ""),
    ]
    t = np.linspace(0.0, 1.0, 50)
    y = np.stack((t, 100.0 * t, t), axis=1)
    fixed = ScopeSettings(scales={"b": Scale(low=-50.0, high=500.0)})
    seen = compose(envelope(t, y, 0.0, 1.0, 80), channels, fixed, (0.0, 1.0, 0.0), {}, (40, 24))
    mine = next(lane for lane in seen.lanes if lane.channels == (1,))
    assert (mine.bottom, mine.top) == (-50.0, 500.0)
    other = next(lane for lane in seen.lanes if lane.channels == (0,))
    assert other.top < 2.0, "the large curve no longer flattens the small one"


class _One(App[None]):
    def compose(self) -> ComposeResult:
        yield Scope()


@pytest.mark.parametrize("view", ["time", "xy", "spectrum"])
@pytest.mark.parametrize("size", [(80, 24), (200, 60), (20, 8)])
async def test_every_view_fills_any_size(view: str, size: tuple[int, int]) -> None:
    app = _One()
    async with app.run_test(size=size) as pilot:
        scope = app.query_one(Scope)
        scope.show_channels([Channel("x", "m"), Channel("y", "m")])
        t = np.arange(3000)
        rows = np.stack((np.cos(t / 50.0), np.sin(t / 50.0)), axis=1)
        scope.history.append(t, rows, DT)
        scope.set(replace(scope.settings, view=view))
        deadline = time.monotonic() + 60.0
        while view == "spectrum" and not ready() and time.monotonic() < deadline:
            await pilot.pause(0.05)
        scope.redraw()
        await pilot.pause()
        text = "\n".join(strip.text for strip in app.screen._compositor.render_strips())
        assert any("⠀" < c <= "⣿" for c in text), "something is drawn"
        if size[0] > 40:
            assert {"time": "ROLL 5 s", "xy": "x [m]", "spectrum": "m/√Hz"}[view] in text
        scope.show_channels([])
        await pilot.pause()


def test_export_writes_what_is_seen(tmp_path: Path) -> None:
    t = np.arange(1000) * DT
    seen = Seen((Channel("a", "rad"), Channel("b")), t, np.stack((t, -t), axis=1))
    again = Recording.load(export(seen, tmp_path / "a.csv"))
    assert np.array_equal(again["a"], t) and again.column_units[0] == "rad"
    for view in ("time", "xy", "spectrum"):
        for kind in ("png", "svg"):
            assert export(replace(seen, view=view), tmp_path / f"{view}.{kind}").stat().st_size
    spectrum = export(replace(seen, view="spectrum"), tmp_path / "s.csv").read_text()
    assert spectrum.splitlines()[0] == "f [Hz],a [rad/sqrt(Hz)],b [1/sqrt(Hz)]"
    with pytest.raises(RecordingError, match="a spectrum is written as"):
        export(replace(seen, view="spectrum"), tmp_path / "s.mat")
    with pytest.raises(RecordingError, match="nothing is seen"):
        export(replace(seen, t=t[:1], y=seen.y[:1]), tmp_path / "b.csv")
    with pytest.raises(RecordingError, match="cannot be written"):
        export(seen, tmp_path / "no" / "a.png")
    with pytest.raises(ValueError, match="end the name with"):
        check_name("a.doc")


def test_a_layout_comes_back_as_it_was(tmp_path: Path) -> None:
    settings = ScopeSettings(view="xy", lanes="curve", scales={"e": Scale(2, -1.0, 1.0)}, window=2)
    layout = Layout((Channel("q1", "rad"), Channel("e", "rad", "r1 - q1")), settings)
    path = save_layout(layout, tmp_path / "new" / "tune.json")
    assert load_layout(path) == layout


@pytest.mark.parametrize(
    "key, value",
    [("window", 1e9), ("view", "bar"), ("selected", 7), ("pre", -1), ("level", None)],
)
def test_an_edited_layout_that_is_impossible_is_refused(
    tmp_path: Path, key: str, value: object
) -> None:
    path = save_layout(Layout((Channel("q1"),), ScopeSettings()), tmp_path / "a.json")
    body = json.loads(path.read_text())
    body["settings"][key] = value
    path.write_text(json.dumps(body))
    with pytest.raises(ZendspError, match=key):
        load_layout(path)
    bad = Layout((Channel("x", "", "q1 if u else r1"),), ScopeSettings())
    with pytest.raises(ZendspError, match="has no place here"):
        load_layout(save_layout(bad, tmp_path / "b.json"))
    path.write_text(path.read_text()[:50])
    with pytest.raises(ZendspError, match="is not a layout"):
        load_layout(path)
