"""The scope on a screen: data or none, freezing, the trigger, cursors, units."""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rich.style import Style
from textual.app import App, ComposeResult
from textual.geometry import Region
from waiting import PATIENCE_S

from zendsp.tui.colours import TraceColours
from zendsp.tui.scope import Channel, Scope
from zendsp.tui.scope.measure import whole_words
from zendsp.tui.scope.path import Axes, Curve, PathPlot, plot_lines
from zendsp.tui.scope.spectrum import ready
from zendsp.tui.scope.ticks import beside


class _Bench(App[None]):
    def compose(self) -> ComposeResult:
        yield Scope(id="scope")


class _Both(App[None]):
    def compose(self) -> ComposeResult:
        yield Scope(id="scope")
        yield PathPlot(id="path")


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


async def test_without_colours_the_widgets_survive_to_be_drawn_larger_than_their_last_picture(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """NO_COLOR's filter takes no segment without a style, as lines beneath the picture had been:
    the terminal ended, and with it the run that it had started.
    """
    monkeypatch.setenv("NO_COLOR", "1")
    app = _Both()
    async with app.run_test(size=(60, 15)) as pilot:
        app.query_one(Scope).show_channels([Channel("a", "rad")])
        app.query_one(PathPlot).show([Curve("a", _wave(100)[1])])
        await pilot.pause()
        for widget in (app.query_one(Scope), app.query_one(PathPlot)):
            width, height = widget.size
            lines = widget.render_lines(Region(0, 0, width, height + 40))
            assert [line.cell_length for line in lines] == [width] * (height + 40)


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
        text = "\n".join(scope.render_line(y).text for y in range(scope.size.height))
        assert "Δt 500 ms = 1/2 Hz" in text
        assert "Δy 1 rad" in text and "A…B mean" in text


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


@pytest.mark.parametrize("full", [30, 36, 44, 60, 100])
def test_the_name_of_an_axis_covers_no_number_of_it(full: int) -> None:
    x = np.linspace(-1.0, 1.0, 50)
    curve = Curve("law", np.stack((x, x), axis=1), 0, "line")
    pens = TraceColours(("#ffffff",), "#888888", "#ffffff")
    axes = Axes(("velocity [rad/s]", "torque [N m]"), equal=False)
    lines = [s.text for s in plot_lines([curve], axes, (full, 12), pens, Style())]
    assert len(lines) == 12 and all(len(line) == full for line in lines)
    feet = " ".join(lines[-2:])
    first, *_, last, name, unit = feet.split()
    assert (float(first), float(last), name, unit) == (-1.0, 1.0, "velocity", "[rad/s]")
    assert beside("-1.23e-10", 8) == "-1.23e-…" and beside("-1.5", 8) == "    -1.5"


def test_cursor_readings_are_never_cut_within_a_number() -> None:
    line = " Δt 1.5 s  tau1 Δy 0.006 N m  A 64.64 s 3.139  B 66.14 s 3.145"
    assert whole_words(line, 80) == line
    assert whole_words(line, len(line) - 1) == " Δt 1.5 s  tau1 Δy 0.006 N m  A 64.64 s 3.139 …"
    assert whole_words(line, 29) == " Δt 1.5 s …"
