"""Keys that are typed before their dialog is there, or faster than a screen."""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import Future

import pytest
from steps import Until
from textual.events import Key
from textual.widgets import Input

from zendsp.tui.app import ZendspApp
from zendsp.tui.dialogs import Choose, Field, Form


def _asked(lab: ZendspApp) -> list[str]:
    """What the session is asked to do from now on, in place of doing it."""
    asked: list[str] = []

    def do(label: str, job: object) -> Future[None]:
        asked.append(label)
        return Future()

    lab.session.do = do  # type: ignore[method-assign, assignment]
    return asked


async def test_keys_typed_before_a_dialog_opens_are_no_commands(
    lab: ZendspApp, until: Until
) -> None:
    asked = _asked(lab)
    seek = threading.Event()

    def slow() -> list[tuple[str, str]]:
        seek.wait(30.0)
        return [("one", "a target")]

    lab.targets._find = slow
    async with lab.run_test(size=(100, 30)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.link == "up", "the link is up")
        asked.clear()
        await pilot.press("ctrl+o", "b", "s", "o")
        assert not isinstance(lab.screen, Choose), "typed before the dialog was there"
        seek.set()
        await until(
            pilot, lambda: isinstance(lab.screen, Choose) and lab.screen.opened and not lab._held,
            "handed over",
        )
        assert not asked
        await pilot.press("escape", "b")
        await until(pilot, lambda: bool(asked), "a command once more")


@pytest.mark.parametrize("opens", ["slash", "O"])
async def test_what_a_fast_hand_types_after_a_key_that_opens_an_input_is_no_command(
    lab: ZendspApp, until: Until, opens: str
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.link == "up", "the link is up")
        asked = _asked(lab)
        for key in (opens, "p", "s", "d"):  # at once, as a terminal hands on one read
            lab.post_message(Key(key, {"slash": "/"}.get(key, key)))
        await until(
            pilot, lambda: [line.value for line in lab.screen.query(Input)] == ["psd"],
            "the input has what was typed",
        )
        assert not asked


async def test_a_key_that_comes_back_when_an_input_has_the_focus_is_no_command(
    lab: ZendspApp, until: Until
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.link == "up", "the link is up")
        before = lab.focused
        await pilot.press("slash")
        await until(pilot, lambda: isinstance(lab.focused, Input), "the filter")
        line = lab.focused
        asked = _asked(lab)
        lab.screen.set_focus(before)
        await lab.on_event(Key("p", "p"))  # is on its way through the table, and up again
        lab.screen.set_focus(line)
        await until(pilot, lambda: line.value == "p", "the input has it")
        assert not asked


async def test_a_key_that_works_everywhere_does_not_overtake_those_of_a_slow_screen(
    lab: ZendspApp, until: Until
) -> None:
    """On Enable, then Execute, the e had become a letter in the dialog that followed."""
    async with lab.run_test(size=(100, 30)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.link == "up", "the link is up")
        asked, seen = _asked(lab), asyncio.Event()
        lab.screen.call_later(seen.wait)
        for key in ("e", "f3", "o"):
            lab.post_message(Key(key, key if len(key) == 1 else None))
        await asyncio.sleep(0.1)  # the pilot would wait for the screen
        before = lab.current_mode
        seen.set()
        assert before == "console"
        await until(pilot, lambda: isinstance(lab.screen, Choose), "all have come")
        assert asked == ["enable"] and lab.current_mode == "execute"
        await until(pilot, lambda: lab.screen.opened, "it takes keys")
        assert lab.screen.query_one(Input).value == ""


async def test_keys_that_come_back_from_a_slow_screen_do_not_fall_behind_later_ones(
    lab: ZendspApp, until: Until
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.link == "up", "the link is up")
        typed = [Key(key, key) for key in "abc"]
        lab.expect_dialog()
        for at in (2, 0, 1):  # c reaches the application while a and b are still on their way up
            await lab.on_event(typed[at])
        lab.push_screen(Form("A name", [Field("name", "Name", "")]))
        await until(
            pilot, lambda: [line.value for line in lab.screen.query(Input)] == ["abc"],
            "in the order in which they were typed",
        )


async def test_keys_typed_after_enter_are_not_part_of_the_entry(
    lab: ZendspApp, until: Until
) -> None:
    entered: list[object] = []
    async with lab.run_test(size=(100, 30)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.link == "up", "the link is up")
        lab.push_screen(Form("A name", [Field("name", "Name", "")]), entered.append)
        for key in ("a", "enter", "b"):  # at once, as a terminal hands on one read
            lab.post_message(Key(key, {"enter": "\r"}.get(key, key)))
        await until(pilot, lambda: bool(entered), "the form is answered")
        assert entered == [{"name": "a"}]
