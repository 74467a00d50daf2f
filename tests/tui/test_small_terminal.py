"""Every screen and its keys fit on small terminals, in every theme."""

from __future__ import annotations

import re

import numpy as np
import pytest
from rich.style import Style
from steps import Until
from textual.app import App, ComposeResult
from textual.containers import VerticalScroll
from textual.widgets import DataTable, Static

from zendsp.recording import Recording
from zendsp.tui.actions import SCREENS
from zendsp.tui.app import ZendspApp
from zendsp.tui.dialogs import Message
from zendsp.tui.footer import Keys
from zendsp.tui.panels.table import Column, LiveTable
from zendsp.tui.runs import Outcome, store_run
from zendsp.tui.screens.base import LabScreen
from zendsp.tui.statusbar import Tabs


async def test_on_a_small_terminal_the_help_keeps_its_columns(app: ZendspApp) -> None:
    async with app.run_test(size=(80, 24)) as pilot:
        await app.action_show("console")
        await pilot.press("f1")
        await pilot.pause()
        words = app.screen.query_one(".words", Static)
        below = app.screen_stack[-2]
        assert isinstance(below, LabScreen)
        lines = below.help_text().plain.splitlines()
        assert max(map(len, lines)) <= words.size.width, "nothing wraps to the left margin"
        assert any(line.startswith(24 * " ") for line in lines)


@pytest.mark.parametrize("agree", ["", "OK"])
async def test_keys_scroll_a_text_that_is_longer_than_its_box(
    app: ZendspApp, until: Until, agree: str
) -> None:
    async with app.run_test(size=(80, 24)) as pilot:
        await app.push_screen(Message("Keys", "\n".join(map(str, range(99))), agree))
        text = app.screen.query_one(VerticalScroll)
        await until(pilot, lambda: 0 < text.size.height < 24, "the box fits the terminal")
        at = [text.scroll_target_y]
        for key in ("pagedown", "down", "end"):
            await pilot.press(key)
            at.append(text.scroll_target_y)
        assert at == sorted(set(at)) and at[-1] == text.max_scroll_y, "further down with each"
        for key in ("up", "pageup", "home"):
            await pilot.press(key)
            at.append(text.scroll_target_y)
        assert at[4:] == sorted(set(at[4:]), reverse=True) and at[-1] == 0
        await pilot.press("enter")
        assert not isinstance(app.screen, Message), "the button has the focus still"


async def test_the_time_is_in_sight_on_80_columns(app: ZendspApp, until: Until) -> None:
    async with app.run_test(size=(80, 24)) as pilot:

        def line() -> str:
            return app.screen.query_one(Tabs).render().plain

        await until(
            pilot, lambda: re.search(r"rec \d\d:\d\d:\d\d *$", line()[:67]), "the time is shown"
        )
        assert "F5 Diagnose" in line()


async def test_every_screen_fits_from_80_by_24_up(app: ZendspApp, until: Until) -> None:
    async with app.run_test(size=(80, 24)) as pilot:
        for screen in SCREENS:
            await app.action_show(screen)
            for size in ((80, 24), (100, 30), (160, 48), (220, 60), (80, 24)):
                await pilot.resize_terminal(*size)
                bar, footer = app.screen.query_one("StatusBar"), app.screen.query_one(Keys)
                await until(pilot, lambda bar=bar, wide=size[0]: bar.region.width == wide,
                    f"{screen} is laid out for {size}")  # type: ignore[misc]
                await pilot.pause()
                assert bar.region.y == 0
                assert footer.region.bottom == size[1]
                body = [
                    w
                    for w in app.screen.children
                    if w not in (bar, footer) and w.region.height and w.display
                ]
                assert body, screen
                assert all(
                    w.region.y >= bar.region.bottom and w.region.bottom <= footer.region.y
                    for w in body
                ), (screen, size)
                assert app.screen.query_one("StopButton").region.width >= 12
                assert all(w.region.height >= 5 for w in app.screen.query("Scope") if w.display), (
                    screen,
                    size,
                )


@pytest.mark.long("the footer is made of the table, every screen fits; lost: its widths")
async def test_no_key_of_the_footer_is_cut(app: ZendspApp, until: Until) -> None:
    async with app.run_test(size=(160, 24)) as pilot:
        for screen in SCREENS:
            await app.action_show(screen)
            for wide in (160, 80, 60, 100):
                await pilot.resize_terminal(wide, 24)
                keys = app.screen.query_one(Keys)
                there = lambda wide=wide, keys=keys: keys.size.width == wide and keys.shown  # noqa: E731
                await until(pilot, there, f"{screen} on {wide} columns")
                line = keys.render().plain
                assert keys.size.height == 1 and len(line.rstrip()) <= wide
                for key, columns in keys.shown.items():
                    said = line[columns.start : columns.stop]
                    assert said == f"{key.display} {key.description}", (screen, wide)
                shown = {key.action.removeprefix("app.") for key in keys.shown}
                assert {"stop", "help"} < shown, (screen, wide)
                assert ("command_palette" in shown) >= (wide == 160), (screen, wide)


async def test_themes_change_and_the_scope_follows(app: ZendspApp) -> None:
    from zendsp.tui.scope import Scope

    async with app.run_test() as pilot:
        await pilot.pause()
        before = app.theme
        await pilot.press("ctrl+t")
        await pilot.pause()
        assert app.theme == "zendsp-day" != before
        scope = app.screen.query_one(Scope)
        scope.render_line(0)
        assert scope._pens[0].color is not None and scope._pens[0].color.name.lower() == "#0067b6"


async def test_every_theme_that_can_be_chosen_has_colours_that_can_be_painted(
    app: ZendspApp,
) -> None:
    """Themes that leave the colours to the terminal ended the application."""
    async with app.run_test() as pilot:
        await pilot.pause()
        assert "ansi-dark" not in app.available_themes and "nord" in app.available_themes
        for name in app.available_themes:
            app.theme = name
            assert Style(color=app.theme_variables["error"]).color is not None, name


async def test_a_number_that_is_cut_says_so() -> None:
    class One(App[None]):
        def compose(self) -> ComposeResult:
            yield LiveTable((Column("value", 8, right=True),))

    async with One().run_test() as pilot:
        table = pilot.app.query_one(LiveTable)
        table.set_rows([("e", (("-0.00576 0.00887", Style()),))])
        await pilot.pause()
        assert table.render_line(1).text.strip() == "-0.0057…"


async def test_how_a_run_ended_is_seen_before_the_errors_of_seven_joints(app: ZendspApp) -> None:
    async with app.run_test(size=(100, 30)) as pilot:
        await pilot.press("f3")
        await pilot.pause()
        columns = [str(c.label) for c in app.screen.query_one("#runs", DataTable).ordered_columns]
        assert columns.index("outcome") < columns.index("worst rms")


@pytest.mark.long("a number that is cut says so: a quicker test; lost: in this list")
async def test_numbers_in_the_list_of_runs_are_never_truncated_to_another_number(
    app: ZendspApp, until: Until
) -> None:
    e = {f"e[{k}]": np.full(1000, v) for k, v in enumerate((0.00427, 0.00407))}
    rec = Recording.from_columns(e, 1e-3)
    for name, outcome in 20 * (("circle", Outcome.COMPLETE), ("a-longer-name", Outcome.PAUSED)):
        store_run(app.workspace.runs, name, rec, outcome=outcome)  # so many that there is a bar
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("f3")
        await pilot.pause()
        table = app.screen.query_one("#runs", DataTable)
        for width in (80, 88, 142, 200):
            await pilot.resize_terminal(width, 24 if width == 80 else 45)
            bar = app.screen.query_one("StatusBar")
            await until(pilot, lambda bar=bar, wide=width: bar.region.width == wide,
                f"laid out for {width}")  # type: ignore[misc]
            await pilot.pause()
            rows = [table.get_row_at(k) for k in range(table.row_count)]
            whole = {word for row in rows for cell in row for word in str(cell).split()}
            assert {"0.0043", "e[0]"} < whole
            cut = 0
            for x in range(0, 40, 3):
                table.scroll_to(x=x, animate=False)
                await pilot.pause()
                for y in range(1, table.size.height):
                    line = table.render_line(y).text
                    seen = line[: table.scrollable_content_region.width].split()
                    assert all(word in whole or "…" in word for word in seen), (width, x, seen)
                    cut += any("…" in word for word in seen)
            assert cut or table.max_scroll_x == 0
