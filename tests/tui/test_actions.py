"""One table of actions feeds keys, footer, help and palette."""

from __future__ import annotations

import ast
import inspect
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from steps import Until, nobody
from textual.widgets import Button

from zendsp.link import programs
from zendsp.tui.actions import ACTIONS, SCREENS, actions, in_keys, keys_of
from zendsp.tui.app import ZendspApp
from zendsp.tui.colours import THEMES
from zendsp.tui.dialogs import Message
from zendsp.tui.footer import Keys
from zendsp.tui.panels.drive import DrivePanel
from zendsp.tui.playing import Setup
from zendsp.tui.preflight import preflight
from zendsp.tui.screens.base import LabScreen
from zendsp.tui.screens.console_program import whole
from zendsp.tui.screens.console_scope import real
from zendsp.tui.snapshot import Snapshot, TripView
from zendsp.tui.statusbar import StatusBar, mean_and_max
from zendsp.tui.stop_process import EMERGENCY, StopState
from zendsp.tui.trial import Trial
from zendsp_target.serving import drives, enabling


def test_a_refusal_names_the_key_and_no_command_of_the_shell() -> None:
    texts = [
        node.value
        for module in (drives, enabling, programs)
        for node in ast.walk(ast.parse(inspect.getsource(module)))
        if isinstance(node, ast.Constant) and "zendsp drive " in str(node.value)
    ]
    assert len(texts) >= 6
    assert not [text for text in texts if "zendsp " in in_keys(text)]
    said = in_keys("home the machine (zendsp drive home), then take it ('zendsp target --name a')")
    assert said == "home the machine (h on Console), then take it (Ctrl+O)"


def test_no_key_has_two_meanings_on_a_screen() -> None:
    for screen in SCREENS:
        keys = Counter(
            key for a in ACTIONS if a.scope in ("app", screen) for key in a.keys.split(",")
        )
        assert not [key for key, n in keys.items() if n > 1]


def test_every_action_says_what_it_does() -> None:
    for a in ACTIONS:
        assert a.label and a.help.endswith("."), a
        assert a.scope in ("app", *SCREENS)


@pytest.mark.parametrize("screen", SCREENS)
async def test_footer_help_and_palette_come_from_the_table(app: ZendspApp, screen: str) -> None:
    async with app.run_test(size=(160, 48)) as pilot:
        await app.action_show(screen)
        await pilot.pause()
        assert isinstance(app.screen, LabScreen) and screen == app.screen.NAME
        for a in ACTIONS:
            if a.scope in ("app", screen):
                node = app if a.scope == "app" else app.screen
                assert hasattr(node, f"action_{a.name.split('(')[0]}"), a
        shown = {
            b.binding.description for b in app.screen.active_bindings.values() if b.binding.show
        }
        assert {a.label for a in ACTIONS if a.scope in ("app", screen) and a.footer} <= shown
        text = " ".join(app.screen.help_text().plain.split())
        assert all(a.help in text for a in ACTIONS if a.scope in ("app", screen))
        commands = [c.title for c in app.get_system_commands(app.screen)]
        wanted = [a for a in ACTIONS if a.scope in ("app", screen) and a.name != "command_palette"]
        assert commands[: len(wanted)] == [f"{a.label} ({a.shown_key})" for a in wanted]
        assert len(commands) == len(ACTIONS) - 1  # those of the other screens stand below


async def test_the_palette_runs_an_action_of_another_screen_on_that_screen(app: ZendspApp) -> None:
    async with app.run_test(size=(160, 48)) as pilot:
        await app.action_show("console")
        await pilot.pause()
        found = [c for c in app.get_system_commands(app.screen) if "on Execute" in c.title]
        chosen = next(c for c in found if c.title.startswith("Reference on Execute"))
        chosen.callback()
        await pilot.pause()
        screens = [s.NAME for s in app.screen_stack if isinstance(s, LabScreen)]
        assert screens == ["execute"]


async def test_a_stop_that_ended_before_the_screens_were_there_is_shown(
    app: ZendspApp, until: Until
) -> None:
    app.session.stops.tell(StopState.NOT_STOPPED, EMERGENCY, EMERGENCY)
    async with app.run_test(size=(80, 24)) as pilot:
        line = app.screen.query_one(StatusBar)._line1
        await until(pilot, lambda: EMERGENCY in line.text, "the banner")


async def test_a_trip_does_not_hide_that_the_machine_is_not_safe(app: ZendspApp) -> None:
    trip, crash = TripView("stop", 1, "STOP; outputs are safe"), "SIGSEGV; the machine is NOT SAFE"
    seen = Snapshot(link="up", target="imi", trip=trip, crash=crash)
    async with app.run_test(size=(80, 24)):
        bar = app.screen.query_one(StatusBar)
        assert trip.text in bar.trouble(seen).plain
        assert crash in bar.trouble(replace(seen, unsafe="the machine is NOT SAFE")).plain


def test_stop_has_priority_and_is_always_in_the_footer() -> None:
    stop = next(a for a in actions("app") if a.name == "stop")
    assert stop.priority and stop.footer and "f9" in stop.keys.split(",")


async def test_a_click_on_a_key_of_the_footer_presses_it_and_the_mouse_over_it_tells_what_it_does(
    app: ZendspApp, until: Until
) -> None:
    async with app.run_test(size=(160, 24)) as pilot:
        keys = app.screen.query_one(Keys)
        await until(pilot, lambda: keys.shown, "the keys are there")
        key, columns = next((k, c) for k, c in keys.shown.items() if k.action.endswith("help"))
        before = keys.render()
        await pilot.hover(Keys, offset=(columns.start, 0))
        help_of = next(a.help for a in actions("app") if a.name == "help")
        assert keys.tooltip == help_of and keys.render() != before
        await pilot.click(Keys, offset=(columns.stop, 0))
        assert isinstance(app.screen, LabScreen), "between two keys is none"
        await pilot.click(Keys, offset=(columns.start, 0))
        await until(pilot, lambda: isinstance(app.screen, Message), f"{key.description} is shown")


async def test_the_key_that_enables_is_called_by_what_it_would_do_now(
    app: ZendspApp, until: Until
) -> None:
    async with app.run_test(size=(160, 48)) as pilot:
        screen = app.screen
        assert isinstance(screen, LabScreen)
        panel, keys = screen.query_one(DrivePanel), screen.query_one(Keys)
        for drive, word in (("homed", "Enable"), ("running", "Disable"), ("tripped", "Enable")):
            seen = Snapshot(link="up", state="loaded", drive=drive)  # type: ignore[arg-type]
            app.session.snapshot = seen
            await until(pilot, lambda w=word: f"e {w} " in keys.render().plain, f"{drive}: {word}")  # type: ignore[misc]
            panel.show(seen)
            assert str(panel.query_one("#step-enable", Button).label) == f"{word} e"


async def test_the_footer_tells_key_from_words_in_every_theme_of_zendsp(
    app: ZendspApp, until: Until
) -> None:
    async with app.run_test(size=(160, 24)) as pilot:
        keys = app.screen.query_one(Keys)
        await until(pilot, lambda: keys.shown, "the keys are there")
        for theme in THEMES:
            app.theme = theme.name
            await pilot.pause()
            key, words, *_ = keys.render().spans
            colours = {span.style.color for span in (key, words)}  # type: ignore[union-attr]
            assert len(colours) == 2 and None not in colours, theme.name


async def test_hidden_widgets_cannot_take_the_focus(app: ZendspApp, until: Until) -> None:
    async with app.run_test(size=(80, 24)) as pilot:
        await until(
            pilot, lambda: app.focused is app.screen.query_one("#variables"), "the screen is ready"
        )
        seen = {w.id for w in app.screen.focus_chain}
        assert "variables" in seen and not {
            i for i in seen if (i or "").startswith("step-")
        }, "no hidden Power button under Enter"
        await pilot.press("E")
        await until(
            pilot,
            lambda: app.focused is app.screen.query_one("#events-box"),
            "the arrows scroll the events",
        )
        await pilot.press("E")
        await until(
            pilot,
            lambda: app.focused is app.screen.query_one("#variables"),
            "the arrows work again",
        )


def test_times_of_execution_carry_the_unit_that_is_meant() -> None:
    assert mean_and_max(1130.0, 27_400.0) == "1.13/27.4 µs"
    assert mean_and_max(473.0, 2.4e6) == "0.473 µs/2.40 ms"
    assert mean_and_max(1.2e6, 2.4e6) == "1.20/2.40 ms"
    assert mean_and_max(591.0, 131.68e6) == "0.591 µs/132 ms"


def test_whole_numbers_and_reals_are_refused_in_words() -> None:
    with pytest.raises(ValueError, match="'s' is not a whole number"):
        whole("s")
    with pytest.raises(ValueError, match="'1 V' is not a number; without its unit it is 1"):
        real("1 V")


def test_the_way_back_to_running_is_given_in_keys() -> None:
    steps = ("acknowledge", "enable", "start")
    assert keys_of(steps) == "^k, e, s"
    assert keys_of(steps, True) == "^k acknowledge, e enable, s start"
    assert keys_of(("release the emergency stop", *steps)) == "release the emergency stop"


def test_the_preflight_names_the_keys_that_are_still_missing() -> None:
    def advice(drive: str, explicit: bool, *failing: str) -> str:
        found = preflight(
            Snapshot(
                link="up", drive=drive, explicit=explicit,
                conditions=tuple((c, False, "") for c in failing),
            ),
            (), (), Setup(), False, Trial(), None,
        )  # fmt: skip
        (drives,) = [c for c in found if c.text == "drives enabled"]
        return "" if drives.met else drives.advice

    lost = preflight(Snapshot(link="lost", drive="running"), (), (), Setup(), False, Trial(), None)
    assert not any(c.met for c in lost), "nobody knows of anything whether it still is so"
    assert "comes back by itself" in lost[0].advice
    assert advice("off", True, "power", "homed").endswith(": power (o), home (h), enable (e)")
    assert advice("off", True, "power").endswith(": power (o), enable (e)"), "absolute encoders"
    assert advice("homed", False).endswith(": enable (e)"), "automatic: e switches the power on"
    assert advice("ready", False, "homed").endswith(": home (h), enable (e)"), "and so does h"
    assert advice("running", False).endswith(
        ": pause (p), enable (e)"
    ), "automatic: the first Start is refused as the second would be"
    assert advice("homed", True).endswith(": enable (e)"), "o would switch the power off"
    assert not advice("enabled", True) and not advice("running", True)


@pytest.mark.parametrize(
    ("found", "words", "event"),
    [
        ([("imi", "arm"), ("wam", "arm")], "Ctrl+O connects to imi, wam", "target imi answers"),
        ([], "Ctrl+O starts a simulated machine", "F5 diagnoses a file"),
    ],
)
async def test_an_empty_terminal_says_what_there_is_and_what_to_press(
    tmp_path: Path, until: Until, found: list[tuple[str, str]], words: str, event: str
) -> None:
    app = ZendspApp(nobody, folder=tmp_path, find_targets=lambda: found, frames=4.0)
    async with app.run_test(size=(100, 30)) as pilot:
        await until(pilot, lambda: app.session.snapshot.here is not None, "looked around")
        line = app.screen.query_one(StatusBar).where(app.session.snapshot)
        assert words in line.plain
        assert any(event in e.text for e in app.session.events.since(0)[1])


async def test_build_without_a_source_asks_for_one_and_builds_it(
    lab: ZendspApp, folder: Path, until: Until
) -> None:
    lab.source = None
    async with lab.run_test(size=(100, 30)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.link == "up", "the link is up")
        await pilot.press("b", "enter")  # pd.c is the first by name
        await until(pilot, lambda: lab.session.snapshot.state == "loaded", "built")
        assert lab.source == folder / "pd.c"
