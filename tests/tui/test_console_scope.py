"""Console: every action of its scope, against a real target process on the fast clock."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from console_steps import console_of, events_of, mark_variable, type_first
from steps import Step, Until, opened
from textual.widgets import Input

from zendsp.link import Target
from zendsp.tui.app import ZendspApp
from zendsp.tui.dialogs import Choose, Form
from zendsp.tui.scope import Scale, Scope
from zendsp.tui.screens.execute import ExecuteScreen
from zendsp_isr.build import source_root


@pytest.mark.covers(
    "console.plot", "console.channels", "console.mode", "console.trigger", "console.single",
    "console.freeze", "console.autoscale", "console.lanes", "console.cursors",
    "console.swap_cursor", "console.next_curve", "console.zoom(-1)", "console.zoom(1)",
    "console.pan(0.25)", "console.pan(-0.25)", "console.events",
)
async def test_every_key_of_the_scope(
    lab: ZendspApp, target: Target, built: Step, until: Until
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await built(lab, pilot)
        target.start()
        console = console_of(lab)
        scope = console.scope
        await until(pilot, lambda: scope.history.count > 2000, "live curves")
        names = lambda: [c.name for c in scope.channels]  # noqa: E731
        assert names()[:2] == ["q[0]", "q[1]"]
        await mark_variable(lab, pilot, "r1")
        await pilot.press("space")
        assert names()[-1] == "r1"
        await pilot.press("space")
        assert "r1" not in names()
        await pilot.press("c")
        await pilot.pause()
        assert isinstance(lab.screen, Choose)
        await pilot.press("space", "escape")
        await pilot.pause()
        console.plot_names(["q1", "e1"])
        await until(pilot, lambda: scope.history.count > 500, "live after the change")
        console.variables.table.focus()
        await pilot.press("m")
        assert scope.settings.mode == "trigger"
        await pilot.press("T")
        await pilot.pause()
        assert isinstance(lab.screen, Form)
        lab.screen.query_one("#f-level", Input).value = "0.2"
        lab.screen.query_one("#f-level", Input).focus()
        await pilot.press("enter")
        await pilot.pause()
        assert scope.settings.level == 0.2 and scope.settings.mode == "trigger"
        await pilot.press("n")
        await until(pilot, lambda: scope.paused, "the circle crosses 0.2 rad: one shot, frozen")
        t, y = scope.history.newest()
        assert scope.picture is not None
        assert float(np.interp(scope.picture.zero, t, y[:, 0])) == pytest.approx(0.2, abs=0.05)
        await pilot.press("m")
        assert scope.settings.mode == "roll" and not scope.paused
        await pilot.press("f")
        assert scope.paused
        await pilot.pause()
        end = scope.picture.end
        await pilot.press("left_square_bracket")
        await pilot.pause()
        assert scope.picture.end < end
        await pilot.press("right_square_bracket", "f")
        assert not scope.paused
        window = scope.settings.window
        await pilot.press("plus")
        assert scope.settings.window < window
        await pilot.press("minus")
        assert scope.settings.window == window
        await pilot.press("a")
        assert not scope.settings.auto
        await pilot.press("a", "l")
        assert scope.settings.auto and scope.settings.lanes == "curve"
        await pilot.press("l")
        assert scope.settings.lanes == "over"
        assert "scope: over one another" in events_of(lab)
        await pilot.press("y")
        assert scope.settings.selected == 1
        await pilot.press("x")
        assert scope.settings.cursors
        a, b = scope.settings.cursor_a, scope.settings.cursor_b
        await pilot.press("right", "v", "left")
        assert scope.settings.cursor_a > a and scope.settings.cursor_b < b
        await pilot.press("E")
        assert console.has_class("-events")


@pytest.mark.long("test_scope_views.py has each alone; lost: by keys")
@pytest.mark.covers(
    "console.view", "console.formula", "console.scale", "console.export", "console.layouts"
)
async def test_a_computed_curve_its_scale_its_files_and_its_layout(
    lab: ZendspApp,
    target: Target,
    built: Step,
    until: Until,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(folder / "config"))
    async with lab.run_test(size=(100, 30)) as pilot:
        await built(lab, pilot)
        target.start()
        console = console_of(lab)
        scope = console.scope
        console.plot_names(["r1", "q1", "e1"])
        await until(pilot, lambda: scope.history.count > 500, "a past")
        past, shown = scope.history.newest()
        await pilot.press("F")
        await pilot.pause()
        await type_first(pilot, "err = r1 - nobody")
        assert isinstance(lab.screen, Form), "refused where it was typed"
        await type_first(pilot, "err = r1 - q1")
        assert [c.name for c in scope.channels] == ["r1", "q1", "e1", "err"]
        assert scope.channels[3].unit == "rad" and console.curve_names() == ["r1", "q1", "e1"]
        rows = len(past) + 600
        await until(pilot, lambda: scope.history.count > rows, "live, with the computed curve")
        t, y = scope.history.newest()
        assert np.array_equal(t[: len(past)], past), "what was there before is still there"
        assert np.array_equal(y[: len(past), :3], shown) and np.isnan(y[: len(past), 3]).all()
        newest = lambda: scope.history.newest(500)[1]  # noqa: E731
        await until(pilot, lambda: not np.isnan(newest()).any(), "only rows with it")
        y = newest()
        assert np.array_equal(y[:, 3], y[:, 0] - y[:, 1]) and np.ptp(y[:, 3]) > 0.0
        scope.set(replace(scope.settings, selected=3))
        await pilot.press("L")
        await pilot.pause()
        lab.screen.query_one("#f-low", Input).value = "-0.5"
        await pilot.press("tab", "tab", "enter")
        await pilot.pause()
        assert scope.settings.scales == {"err": Scale(0, -0.5, None)}
        await pilot.press("W")
        await pilot.pause()
        await pilot.press(*"mine", "enter")  # a name that is typed at once is not lost
        await pilot.pause()
        await pilot.press("enter")
        assert (folder / "config/zendsp/layouts/mine.json").is_file()
        saved = (scope.channels, scope.settings)
        for view in ("xy", "spectrum"):
            await pilot.press("V")
            assert scope.settings.view == view
            await pilot.press("X")
            await pilot.pause()
            await type_first(pilot, f"{view}.csv")
            await until(pilot, lambda view=view: (folder / f"{view}.csv").is_file(), "written")
        await pilot.press("F")
        await pilot.pause()
        await type_first(pilot, "")
        assert [c.name for c in scope.channels] == ["r1", "q1", "e1"], "an empty line takes away"
        await pilot.press("W")
        await pilot.pause()
        await pilot.press("down", "enter")
        await until(pilot, lambda: (scope.channels, scope.settings) == saved, "as it was saved")
        assert await pilot.click(scope, offset=(2, 3))
        await pilot.pause()
        assert isinstance(lab.screen, Form), "a click on the axis asks for its scale"


async def test_curves_are_live_on_the_screen_that_is_shown(
    lab: ZendspApp, target: Target, built: Step, until: Until
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await built(lab, pilot)
        target.start()
        scope = console_of(lab).scope
        await until(pilot, lambda: scope.history.count > 100, "live on Console")
        execute = await opened(lab, pilot, until, ExecuteScreen)
        execute.follow_live(lab.session.snapshot)  # as Start of a run does
        run = execute.query_one("#run-live", Scope)
        await until(pilot, lambda: run.history.count > 100, "live on Execute")
        for key, shown in (("f2", scope), ("f3", run), ("f2", scope)):
            await pilot.press(key)
            seen = shown.history.latest
            await until(pilot, lambda s=shown, t=seen: s.history.latest > t + 1.0, f"live: {key}")  # type: ignore[misc]
            assert shown.history.channels == len(shown.channels)
            assert not shown.old
        target.pause()
        await until(pilot, lambda: lab.session.snapshot.state == "paused", "paused")
        await pilot.pause(0.3)
        assert not scope.old, "what is shown is where the machine is"


async def test_a_curve_that_the_next_program_lacks_is_told(
    lab: ZendspApp, target: Target, built: Step, until: Until
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await built(lab, pilot)
        console = console_of(lab)
        console.plot_names(["q1", "e1"])
        source = (source_root() / "programs" / "pd.c").read_text()
        target.download({"pd.c": source.replace("e1", "error_1")})
        await until(pilot, lambda: [c.name for c in console.scope.channels] == ["q1"], "renamed")
        assert "no longer shown, this program has not: e1" in events_of(lab)
