"""Forms, lists and messages over a screen: their answers, and that STOP works beneath them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

import pytest
from steps import Until
from textual.events import Key
from textual.widgets import Input, OptionList
from textual.widgets._toast import Toast

from zendsp.tui.actions import ACTIONS, SCREENS
from zendsp.tui.app import ZendspApp
from zendsp.tui.dialogs import Choose, Field, Form, Message, Option, Sliders
from zendsp.tui.dialogs.source import SourceView
from zendsp.tui.footer import Keys
from zendsp.tui.screens.analysis import ProcessView
from zendsp.tui.snapshot import Snapshot, TripView, Variable


async def test_stop_works_under_every_dialog(
    app: ZendspApp, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pressed: list[str] = []
    monkeypatch.setattr(app.session.stops, "stop", lambda: pressed.append(over))
    source = tmp_path / "pd.c"
    source.write_text("int x;\n")
    dialogs = {
        "nothing": None,
        "form": Form("f", [Field("a", "a", "1")]),
        "choose": Choose("c", [Option("a", "a")], several=True),
        "message": Message("m", "text", agree="yes"),
        "source": SourceView(source, (), lambda _: None),
        "process": ProcessView("p", ["--help"], tmp_path),
    }
    async with app.run_test(size=(100, 30)) as pilot:
        for over, dialog in dialogs.items():
            if dialog is not None:
                await app.push_screen(dialog)
            await pilot.pause()
            await pilot.press("f9", "ctrl+@")
            await pilot.click(offset=(95, 1))
            await pilot.pause()
            assert pressed == [over, over, over], "by key, and by a click on the red field"
            pressed.clear()
            if dialog is not None:
                assert dialog.query_one(".box").region.y >= 3, "the status bar stays in sight"
                await pilot.press("escape")
                await pilot.pause()
        over = "palette"
        app.action_command_palette()
        await pilot.pause()
        await pilot.press("f9")
        await pilot.pause()
        assert pressed == [over]


async def test_no_key_acts_on_the_machine_under_a_dialog(
    app: ZendspApp, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def note(label: str, job: object) -> Future[str]:
        asked.append(label)
        return Future()

    for way in ("do", "do_first", "do_beside"):
        monkeypatch.setattr(app.session, way, note)
    tripped = Snapshot(link="up", state="paused", drive="tripped", trip=TripView("stop", 1, "x", 1))
    keys = [a.keys.split(",")[0] for a in ACTIONS if a.name not in ("stop", "help", "quit")]
    async with app.run_test(size=(80, 24)) as pilot:
        app.session.snapshot = tripped
        app.action_help()
        await pilot.pause()
        dialog = app.screen
        for key in keys:
            await pilot.press(key)
            if app.screen is not dialog:  # closed by a key of its own
                app.action_help()
                await pilot.pause()
                dialog = app.screen
            assert not asked, f"{key} acted beneath {dialog}"
        await pilot.press("escape", "ctrl+k")
        await pilot.pause()
        assert asked == ["acknowledge"], "once it is closed, the key acts"


async def test_screens_cannot_be_left_while_a_dialog_asks(app: ZendspApp) -> None:
    async with app.run_test() as pilot:
        await app.push_screen(Form("f", [Field("a", "a", "1")]))
        await pilot.press("f4")
        await pilot.pause()
        assert app.current_mode == "console"
        await pilot.press("escape", "f4")
        await pilot.pause()
        assert app.current_mode == "reference"


async def test_arrows_go_from_line_to_line_of_a_form(app: ZendspApp, until: Until) -> None:
    async with app.run_test() as pilot:
        form = Form("f", [Field("a", "a", "1"), Field("b", "b", "2"), Field("c", "c", "3")])
        await app.push_screen(form)
        await until(pilot, lambda: form.focused is form.query_one("#f-a"), "the first field")
        await pilot.press("down", "down", "up", "5")
        assert [form.query_one(f"#f-{key}", Input).value for key in "abc"] == ["1", "5", "3"]


async def test_a_click_on_a_label_or_a_unit_is_for_its_input(app: ZendspApp, until: Until) -> None:
    async with app.run_test() as pilot:
        fields = [Field("a", "gain", "1", "N m"), Field("b", "name", "x"), Field("c", "on", True)]
        form = Form("f", fields)
        await app.push_screen(form)
        await until(pilot, lambda: form.focused is form.query_one("#f-a"), "the first field")
        lines = list(form.query(".field"))
        for line, part, key in ((1, ".label", "b"), (0, ".unit", "a"), (2, ".label", "c")):
            await pilot.click(lines[line].query_one(part))
            await until(pilot, lambda key=key: form.focused is form.query_one(f"#f-{key}"), key)  # type: ignore[misc]


async def test_a_form_says_what_is_wrong_and_waits(app: ZendspApp, until: Until) -> None:
    results: list[object] = []
    async with app.run_test() as pilot:
        app.push_screen(
            Form("f", [Field("x", "Level", "1", unit="[V]", check=float)]), results.append
        )
        await until(
            pilot,
            lambda: app.focused is not None and app.focused.id == "f-x" and app.focused.has_focus,
            "the form is open",
        )
        await pilot.press("end", "x", "enter")
        await until(
            pilot,
            lambda: "Level" in str(app.screen.query_one("#problem").render()),
            "what is wrong is said",
        )
        assert results == []
        assert "[V]" in "".join(str(w.render()) for w in app.screen.query(".unit"))
        await pilot.press("backspace", "enter")
        await until(pilot, lambda: results, "the form is closed")
        assert results == [{"x": 1.0}] or results == [{"x": 11.0}]


async def test_toasts_and_lists_keep_units_in_brackets(app: ZendspApp) -> None:
    async with app.run_test(size=(100, 30)) as pilot:
        app.toast("q [rad] above 2.15 [rad]", "error")
        await app.push_screen(Choose("Curves", [Option("q", "q [rad]", "[N m]")]))
        await pilot.pause()
        picture = app.export_screenshot()
        assert picture.count("[rad]") >= 1 and "[N&#160;m]" in picture


@pytest.mark.parametrize(("rows", "shown"), [(24, 1), (60, 3)])
async def test_on_a_small_terminal_the_newest_toast_takes_the_place_of_those_before(
    rows: int, shown: int, app: ZendspApp, until: Until
) -> None:
    async with app.run_test(size=(80, rows), notifications=True) as pilot:
        for text in ("one is refused", "two is refused", "three is refused"):
            app.toast(text, "warning")

        def words() -> list[str]:
            return [str(toast.render()) for toast in app.screen.query(Toast)]

        await until(pilot, lambda: "three" in "".join(words()), "the newest is shown")
        assert len(words()) == shown, words()


@pytest.mark.parametrize("screen", SCREENS)
async def test_on_a_small_terminal_a_toast_covers_the_keys_at_the_bottom_and_no_value(
    screen: str, app: ZendspApp, until: Until
) -> None:
    async with app.run_test(size=(80, 24), notifications=True) as pilot:
        await app.action_show(screen)
        app.toast("the drives are not enabled: press e on Console, then start again", "warning")
        await until(pilot, lambda: app.screen.query(Toast), "it is shown")
        await until(pilot, lambda: app.screen.query_one(Toast).region.height, "it has its place")
        keys = app.screen.query_one(Keys).region
        assert app.screen.query_one(Toast).region.y == keys.y, "on the row of the keys alone"
        assert app.screen.query_one(Toast).region.width == keys.width, "all of it"


async def test_on_a_small_terminal_the_next_key_takes_a_toast_that_was_read(
    app: ZendspApp, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with app.run_test(size=(80, 24), notifications=True) as pilot:
        app.toast("one is refused", "warning")
        await until(pilot, lambda: app.screen.query(Toast), "it is shown")
        monkeypatch.setattr("zendsp.tui.app.READ_S", 1e9)
        await pilot.press("y")
        assert app.screen.query(Toast), "not at once: nobody has read it yet"
        monkeypatch.setattr("zendsp.tui.app.READ_S", 0.0)
        await pilot.press("y")
        await until(pilot, lambda: not app.screen.query(Toast), "it is taken away")


async def test_a_dialog_answers_once_however_often_a_key_is_pressed(app: ZendspApp) -> None:
    answers: list[list[str] | None] = []
    async with app.run_test(size=(100, 30)) as pilot:
        below = app.screen
        await app.push_screen(Choose("Curves", [Option("q", "q", "rad")]), answers.append)
        await pilot.pause()
        rows = app.screen.query_one(OptionList)
        for _ in range(3):  # before the first has closed it
            rows.action_select()
        await pilot.pause()
        assert answers == [["q"]]
        assert app.screen is below


async def test_a_list_filters_while_one_types_and_the_arrows_stay(app: ZendspApp) -> None:
    chosen: list[object] = []
    options = [Option(name, name, detail) for name, detail in (
        ("Kp1", "N m/rad"), ("Kp2", "N m/rad"), ("tau 2", "N m"))]  # fmt: skip
    async with app.run_test(size=(100, 30)) as pilot:
        await app.push_screen(Choose("Curves", options), chosen.append)
        await pilot.pause()
        rows = app.screen.query_one(OptionList)
        await pilot.press("k", "p")
        assert [o.id for o in rows.options] == ["Kp1", "Kp2"]
        await pilot.press("backspace", "backspace", "u", "space", "2")
        assert [o.id for o in rows.options] == ["tau 2"]
        await pilot.press("backspace", "backspace", "backspace", "k", "down", "enter")
        assert chosen == [["Kp2"]]


async def test_enter_chooses_from_the_filter_line_too(app: ZendspApp) -> None:
    chosen: list[object] = []
    async with app.run_test(size=(100, 30)) as pilot:
        options = [Option(name, name) for name in ("a.c", "pd.c")]
        await app.push_screen(Choose("Source", options), chosen.append)
        await pilot.pause()
        await pilot.press("slash", "p", "d", "enter")
        assert chosen == [["pd.c"]]


async def test_the_name_that_was_typed_whole_comes_first(app: ZendspApp) -> None:
    """Typing pd.c chooses pd.c, not joint_pd.c, which is listed before it."""
    chosen: list[object] = []
    names = ("a.c", "joint_pd.c", "pd.c", "pd.cpp")
    async with app.run_test(size=(100, 30)) as pilot:
        await app.push_screen(Choose("Source", [Option(n, n) for n in names]), chosen.append)
        await pilot.pause()
        await pilot.press("down", "down", "d", ".", "c")
        rows = app.screen.query_one(OptionList)
        assert [o.id for o in rows.options] == ["joint_pd.c", "pd.c", "pd.cpp"]
        assert rows.highlighted == 0, "the first of what is left"
        await pilot.press("backspace", "backspace", "backspace", "p", "d", ".", "c", "enter")
        assert chosen == [["pd.c"]]


async def test_a_name_typed_together_with_enter_is_chosen(app: ZendspApp, until: Until) -> None:
    """On a busy computer the first entry of the whole list had been chosen and built."""
    chosen: list[object] = []
    names = ("constant_torque.c", "joint_pd.c", "pd.c")
    async with app.run_test(size=(100, 30)) as pilot:
        await app.push_screen(Choose("Source", [Option(n, n) for n in names]), chosen.append)
        await pilot.pause()
        for key, character in (("p", "p"), ("d", "d"), ("full_stop", "."), ("c", "c")):
            app.post_message(Key(key, character))
        app.post_message(Key("enter", "\r"))
        await until(pilot, lambda: chosen, "the list is closed")
        assert chosen == [["pd.c"]]


def _type(app: ZendspApp, *keys: str) -> None:
    """At once, as a terminal hands on one read."""
    for key in keys:
        app.post_message(Key(key, key if len(key) == 1 else None))


async def test_keys_after_enter_go_to_the_dialog_that_it_opens(
    app: ZendspApp, until: Until
) -> None:
    """Typed letters of a name had been lost, or taken as commands."""
    asked: list[object] = []

    def ask_again(answer: object) -> None:
        asked.append(answer)
        if len(asked) < 3:
            app.push_screen(Form("A name", [Field("name", "Name", "")]), ask_again)

    async with app.run_test(size=(100, 30)) as pilot:
        commands: list[str] = []
        app.session.do = lambda label, job: commands.append(label)  # type: ignore[method-assign, assignment, return-value]
        app.push_screen(Choose("Layouts", [Option("old", "old")]), ask_again)
        _type(app, "o", "enter", "s", "p", "enter", "b", "enter")
        await until(pilot, lambda: len(asked) == 3, "all three are answered")
        assert asked == [["old"], {"name": "sp"}, {"name": "b"}]
        assert not commands


async def test_keys_after_a_refused_enter_go_on_in_the_form(app: ZendspApp, until: Until) -> None:
    entered: list[object] = []
    async with app.run_test(size=(100, 30)) as pilot:
        app.push_screen(Form("f", [Field("x", "Level", "", check=float)]), entered.append)
        _type(app, "x", "enter", "backspace", "4", "2", "enter")
        await until(pilot, lambda: entered, "the form is answered")
        assert entered == [{"x": 42.0}]


async def test_keys_after_the_last_answer_go_to_the_screen_below(
    app: ZendspApp, until: Until
) -> None:
    heard: list[str] = []

    async def answered(_: object) -> None:
        await asyncio.sleep(0.1)  # what an answer does takes its time
        heard.append("answer")

    async with app.run_test(size=(100, 30)) as pilot:
        app.action_next_theme = lambda: heard.append("key")  # type: ignore[method-assign]
        app.push_screen(Message("m", "text", agree="yes"), answered)
        _type(app, "enter", "ctrl+t")
        await until(pilot, lambda: len(heard) == 2, "both are heard")
        assert heard == ["answer", "key"]


async def test_a_key_keeps_its_order_behind_keys_that_wait(app: ZendspApp, until: Until) -> None:
    """"arm.toml" and Enter had become ar, Enter, and m.toml for the screen below."""
    chosen: list[object] = []
    async with app.run_test(size=(100, 30)) as pilot:
        await app.push_screen(Choose("Model", [Option(n, n) for n in ("a", "arm")]), chosen.append)
        await pilot.pause()
        app._held += [Key(letter, letter) for letter in "arm"]
        app.call_later(app.hand_over)  # behind what is in the queue already
        await app.on_event(Key("enter", None))
        assert [key.key for key in app._held] == ["a", "r", "m", "enter"]
        await until(pilot, lambda: chosen, "the list is closed")
        assert chosen == [["arm"]]


async def test_a_slider_that_has_no_room_comes_into_sight_and_the_keys_stay(
    app: ZendspApp, until: Until
) -> None:
    """In 24 rows the eleventh parameter moved out of sight."""
    parameters = [
        Variable(f"p{k}", "double", 1, "parameter", "N", 0.0, 10.0, 1.0, "") for k in range(15)
    ]
    values = {v.name: 1.0 for v in parameters}
    async with app.run_test(size=(80, 24)) as pilot:
        dialog = Sliders(parameters, lambda: values, lambda *_: None)
        await app.push_screen(dialog)
        await pilot.pause()
        box = dialog.query_one(".box").region
        assert box.contains_region(dialog.query_one(".hint").region)
        await pilot.press(*["down"] * 12)
        await until(
            pilot, lambda: app.focused is not None and box.contains_region(app.focused.region),
            "it is seen",
        )
        assert app.focused is list(dialog.query("Slider"))[12]


MANY = [Option(f"q{k}", f"q{k}") for k in range(40)]


@pytest.mark.parametrize(
    ("make", "last"),
    [
        (lambda: Choose("c", MANY, several=True), "#ok"),
        (lambda: Choose("c", MANY, text="Which of them? " * 9), "#keys"),
        (lambda: Message("m", "line\n" * 60), "#close"),
    ],
)
async def test_text_below_a_list_is_visible_in_24_rows(
    app: ZendspApp, until: Until, make: Callable[[], Choose | Message], last: str
) -> None:
    async with app.run_test(size=(80, 24)) as pilot:
        dialog = make()
        await app.push_screen(dialog)
        box, below = dialog.query_one(".box"), dialog.query_one(last)
        await until(pilot, lambda: box.region.contains_region(below.region), last)
        assert box.region.bottom <= 24 and dialog.query_one(".long").size.height >= 8
        await pilot.resize_terminal(80, 60)
        await until(pilot, lambda: dialog.query_one(".long").size.height >= 16, "room is used")


async def test_a_switch_shows_its_state_in_words(app: ZendspApp, until: Until) -> None:
    async with app.run_test(size=(80, 24)) as pilot:
        app.push_screen(Form("f", [Field("home", "Go home after", True)]))
        await pilot.pause()

        def row() -> str:
            lines = [strip.text for strip in app.screen._compositor.render_strips()]
            return next(line for line in lines if "Go home after" in line)

        await until(pilot, lambda: "● yes" in row(), "without a colour")
        await pilot.press("space")
        await until(pilot, lambda: "○ no" in row(), "switched")


async def test_no_line_of_a_message_lies_under_the_footer(app: ZendspApp, until: Until) -> None:
    """A sentence that just did not fit into one line lost its end at 120 columns."""
    async with app.run_test(size=(120, 40), notifications=True) as pilot:
        await pilot.press("f3")
        for length in range(54, 60):
            app.toast("a" * (length - 2) + " %", "error")
        await until(pilot, lambda: len(app.screen.query("Toast")) == 6, "they are shown")
        await until(
            pilot, lambda: all(t.region.height for t in app.screen.query("Toast")), "laid out"
        )
        assert max(t.region.bottom for t in app.screen.query("Toast")) < 40
        for toast in app.screen.query("Toast"):
            width, height = toast.content_size
            assert height == -(-len(str(toast.render())) // width), "each has its lines"
