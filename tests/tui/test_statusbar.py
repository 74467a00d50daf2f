"""The status bar at the top of every screen, at every width."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from textual.app import App, ComposeResult

from zendsp.link.outside import Outside
from zendsp.tui.colours import THEMES
from zendsp.tui.panels.drive import DrivePanel
from zendsp.tui.snapshot import LinkState, Snapshot, TripView
from zendsp.tui.statusbar import ENOUGH, StatusBar, Tabs, banner_lines
from zendsp.tui.stop_process import EMERGENCY
from zendsp_protocol.messages import JointInfo, Limits, MachineInfo


@pytest.mark.parametrize(
    ("width", "lines"),
    [
        (67, [f" ■ {EMERGENCY} "]),  # of 80 columns, beside the red field
        (47, ["NOT STOPPED: use the machine's emergency stop"]),
        (27, ["NOT STOPPED: use the", "machine's emergency stop"]),
        (12, ["NOT STOPPED:", "use the …"]),
        (11, ["NOT", "STOPPED: …"]),
    ],
)
def test_how_stop_ended_is_said_on_narrow_terminals_too(width: int, lines: list[str]) -> None:
    assert banner_lines(EMERGENCY, width) == lines
    assert all(len(line) <= width for line in lines)


@pytest.mark.parametrize("width", range(12))
def test_stop_is_said_on_a_bar_that_has_no_room_yet(width: int) -> None:
    """A screen that is built at that moment has no size; an error there would be the end of it."""
    assert banner_lines("stopped, at sample 209956", width)


class _Bar(App[None]):
    def compose(self) -> ComposeResult:
        yield StatusBar("execute")

    def on_mount(self) -> None:
        self.register_theme(THEMES[0])
        self.theme = THEMES[0].name


@pytest.mark.parametrize("width", [60, 80, 160])
async def test_a_long_name_leaves_room_for_what_the_target_does(width: int) -> None:
    name = "planar_arm_of_the_laboratory-13759-69478"
    app = _Bar()
    async with app.run_test(size=(width, 5)) as pilot:
        app.query_one(StatusBar).show(
            Snapshot(link="up", target=name, machine="imi_planar", state="running", drive="tripped")
        )
        await pilot.pause()
        tabs, line, _ = (strip.text for strip in app.screen._compositor.render_strips()[:3])
        for words in ("planar_arm", "▲ tripped", "● running", "cmd nobod"):
            assert words in line
        assert (f"{name} on imi_planar  ▲" in line) == (width == 160)
        assert "F5" in tabs and "Execute" in tabs and "rec" in tabs


@pytest.mark.parametrize(
    ("commander", "mine", "mover", "said"),
    [
        ("", False, "you", "cmd nobody  run you"),
        ("", False, "anna@lab", "cmd nobody  run anna@lab"),
        ("anna@lab", False, "anna@lab", "cmd anna@lab"),
        ("me@lab", True, "you", "cmd you"),
    ],
)
async def test_whose_run_moves_the_machine_is_said_once(
    commander: str, mine: bool, mover: str, said: str
) -> None:
    app = _Bar()
    async with app.run_test(size=(80, 5)) as pilot:
        app.query_one(StatusBar).show(
            Snapshot(
                link="up", target="imi", state="running", drive="running", commander=commander,
                mine=mine, moved_by=mover,
            )
        )
        await pilot.pause()
        line = app.screen._compositor.render_strips()[1].text
        assert said in line and line.count("run ") == said.count("run "), line


@pytest.mark.parametrize("width", [80, 200])
async def test_who_asked_for_stop_and_when_is_said_on_every_width(width: int) -> None:
    app, when = _Bar(), "anna@lab-pc:17463 at 03:11:00"
    said = f"STOP was requested by {when} (sample 17389); outputs are safe until acknowledged"
    seen = Snapshot(
        link="up", target="imi", machine="imi_planar", state="stopped", drive="stopped", mine=True,
        trip=TripView("stop", 17389, said, cause=f"STOP was requested by {when}"),
    )
    async with app.run_test(size=(width, 5)) as pilot:
        app.query_one(StatusBar).show(seen)
        await pilot.pause()
        line = app.screen._compositor.render_strips()[1].text
        assert when in line and "■ stopped" in line and "cmd you" in line, line


async def test_old_numbers_are_said_to_be_and_a_tiny_terminal_says_what_is_needed() -> None:
    """On a busy computer they stood still for seconds, and looked like those of now."""
    app, seen = _Bar(), Snapshot(link="up", target="imi", state="running", asked=time.monotonic())
    async with app.run_test(size=(80, 24)) as pilot:
        bar = app.query_one(StatusBar)
        assert "old" not in bar.loop(seen).plain
        assert "is 7 s old: this computer is busy" in bar.loop(
            replace(seen, asked=seen.asked - 7.0)
        ).plain
        assert ENOUGH not in app.query_one(Tabs).render().plain
        await pilot.resize_terminal(20, 5)
        await pilot.pause()
        assert app.query_one(Tabs).render().plain == f" {ENOUGH}" and len(ENOUGH) < 20


async def test_why_a_target_is_not_reached_is_said_on_the_bar() -> None:
    app, why = _Bar(), "imi runs on this computer, but $ZENDSP_CONNECT leads to"
    async with app.run_test(size=(80, 5)) as pilot:
        app.query_one(StatusBar).show(Snapshot(link="connecting", target="imi", complaint=why))
        await pilot.pause()
        first, second = (s.text for s in app.screen._compositor.render_strips()[1:3])
        assert "connecting to imi" in first and why in second


async def test_a_joint_outside_its_limit_is_told_on_every_screen_until_it_is_back() -> None:
    words = "joint 2 is 0.05 rad outside its limit of 2.15 rad"
    app = _Bar()
    async with app.run_test(size=(120, 5)) as pilot:
        seen = Snapshot(
            link="up", target="imi", machine="imi", state="paused", drive="homed",
            outside=(Outside(words, "home the machine (zendsp drive home)"),),
        )
        for shown, there in ((seen, True), (replace(seen, outside=()), False)):
            app.query_one(StatusBar).show(shown)
            await pilot.pause()
            line = app.screen._compositor.render_strips()[1].text
            assert (words in line) == there
        told = DrivePanel().flags(seen).plain
        assert f"{words}:\n  home the machine (h on Console)" in told


@pytest.mark.parametrize("after", ["(sample 25082); outputs are safe", "by other words, as safe"])
@pytest.mark.parametrize("width", [80, 120])
async def test_no_number_of_a_trip_is_cut_to_another(width: int, after: str) -> None:
    cause = "joint 2: position 2.15015 rad is beyond the limit of 2.15 rad"
    said = f"{cause} {after}"
    seen = Snapshot(
        link="up", target="imi_planar-23134-49991", machine="imi_planar", state="stopped",
        drive="tripped", mine=True, trip=TripView("position", 25082, said, cause=cause),
    )
    app = _Bar()
    async with app.run_test(size=(width, 5)) as pilot:
        app.query_one(StatusBar).show(seen)
        await pilot.pause()
        lines = [strip.text for strip in app.screen._compositor.render_strips()[1:3]]
        assert "▲ tripped" in lines[0]
        assert "position 2.15015 rad is beyond the limit of 2.15 rad" in lines[1], lines


async def test_a_wider_terminal_shows_more_of_a_line_that_does_not_change() -> None:
    app = _Bar()
    seen = Snapshot(
        link="up", target="imi", state="stopped", drive="tripped",
        trip=TripView("position", 25082, "joint 2: position 2.2 rad is beyond its limit, all said"),
    )
    async with app.run_test(size=(80, 5)) as pilot:
        app.query_one(StatusBar).show(seen)
        await pilot.pause()
        for width in (60, 200):
            await pilot.resize_terminal(width, 5)
            lines = [""]
            while len(lines[0]) != width:  # a loaded computer draws it later
                await pilot.pause(0.01)
                lines = [strip.text for strip in app.screen._compositor.render_strips()[1:3]]
            assert any("all said" in line for line in lines) == (width == 200), lines


async def test_the_positions_of_seven_joints_have_room_beside_the_scope() -> None:
    arm = MachineInfo("arm", joints=tuple(JointInfo(f"j{k}", unit="rad") for k in range(7)))
    shown = Snapshot(link="up", described=arm, position=(0.0, -1.9, 0.0, 3.00171, 1e-5, -2.0, 0.5))
    async with _Bar().run_test():
        told = DrivePanel().flags(shown).plain.splitlines()
    assert told[0].split() == ["pos", "0.0000", "-1.9000", "0.0000", "3.0017", "rad"]
    assert told[1].split() == ["0.0000", "-2.0000", "0.5000", "rad"]
    assert max(map(len, told)) <= 52  # of the panel on 120 columns


async def test_the_drives_say_how_much_of_its_range_each_joint_uses() -> None:
    arm = MachineInfo("arm", joints=tuple(JointInfo(f"j{k}", unit="rad") for k in range(5)))
    ends = (1.0, 1.0, 1.0, float("inf"), 2.0)
    limits = Limits(tuple(-end for end in ends), ends, ends, ends, ends)
    shown = Snapshot(
        link="up", described=arm, limits=limits, position=(0.0, -0.5, 0.95, 3.0, 2.1)
    )
    async with _Bar().run_test():
        told = DrivePanel().flags(shown)
    lines = told.plain.splitlines()
    assert lines[2:] == [
        "range      0 %      50 %      95 %         –", "         105 %"
    ]
    assert max(map(len, lines)) <= 52  # of the panel on 120 columns
    coloured = [told.plain[span.start : span.end].strip() for span in told.spans]
    assert [text for text in coloured if "%" in text] == ["95 %", "105 %"]


@pytest.mark.parametrize(
    "state, line",
    [
        ("running", "aout       -393      684.5      1000 mV"),
        ("paused", "held       -393      684.5      1000 mV, none acts"),
    ],
)
async def test_a_command_that_a_paused_machine_holds_is_not_shown_as_one_that_acts(
    state: str, line: str
) -> None:
    io = {"aout": np.array([-393.0, 684.5, 1000.0])}
    shown = Snapshot(link="up", state=state, joints=3, io=io)
    async with _Bar().run_test():
        told = DrivePanel().flags(shown).plain.splitlines()
    assert [x.split() for x in told if "mV" in x] == [line.split()]
    assert max(map(len, told)) <= 52  # of the panel on 120 columns


async def test_a_homing_is_told_on_every_screen() -> None:
    app = _Bar()
    seen = Snapshot(link="up", target="axis", state="running", drive="ready", homing=True)
    async with app.run_test(size=(80, 5)) as pilot:
        app.query_one(StatusBar).show(seen)
        await pilot.pause()
        line = app.screen._compositor.render_strips()[1].text
        assert "○ ready  ● homing" in line and "running" not in line


async def test_the_next_step_after_a_trip_is_shown_beside_the_state() -> None:
    seen = Snapshot(
        link="up", target="imi", machine="imi", state="stopped", drive="stopped", explicit=True,
        trip=TripView("host lost", 7, "the host that commanded the motion is gone"),
        steps=("acknowledge", "enable", "start"),
    )
    app = _Bar()
    async with app.run_test(size=(80, 5)) as pilot:
        app.query_one(StatusBar).show(seen)
        await pilot.pause()
        assert "■ stopped  ^k" in app.screen._compositor.render_strips()[1].text
        told = DrivePanel().ladder(seen).plain
        assert "next: ^k acknowledge, e enable, s start" in told
        assert len(told) <= 52  # of the panel on 120 columns
        rest = replace(seen, state="paused", drive="homed", trip=None, steps=("enable", "start"))
        assert DrivePanel().ladder(rest).plain.endswith("running  next e")
        going = replace(rest, state="running", drive="running", steps=("go_on",))
        assert DrivePanel().ladder(going).plain.endswith("hold = false lets it go on")


@pytest.mark.parametrize(
    ("link", "safe", "said"),
    [
        ("lost", True, "LINK LOST to imi: it has ended, machine safe; start it again"),
        ("lost", False, "LINK LOST to imi: it ended, machine NOT SAFE: emergency stop"),
        ("ended", True, "imi HAS ENDED, machine safe: Ctrl+O"),
        ("ended", False, "imi HAS ENDED, machine NOT SAFE: Ctrl+O"),
    ],
)
async def test_the_bar_tells_how_a_target_that_ended_left_its_machine(
    link: str, safe: bool, said: str
) -> None:
    app = _Bar()
    async with app.run_test(size=(80, 5)) as pilot:
        seen = Snapshot(link=LinkState(link), target="imi", gone=True, safe=safe)
        app.query_one(StatusBar).show(seen)
        await pilot.pause()
        assert said in app.screen._compositor.render_strips()[1].text


@pytest.mark.parametrize(
    ("gone", "policy", "said"),
    [
        (True, "stop", ("it has ended; start it again", "zendsp salvage")),
        (False, "hold", ("reconnecting", "heard last, at t = 7.0 s; it comes to rest")),
        (False, "stop", ("reconnecting", "heard last, at t = 7.0 s; it stops")),
    ],
)
async def test_a_lost_link_says_what_becomes_of_the_machine(
    gone: bool, policy: str, said: tuple[str, str]
) -> None:
    seen = Snapshot(
        link="lost", target="imi", state="running", mine=True, t=7.0, host_lost=policy, gone=gone
    )
    app = _Bar()
    async with app.run_test(size=(80, 5)) as pilot:
        app.query_one(StatusBar).show(seen)
        await pilot.pause()
        lines = [strip.text for strip in app.screen._compositor.render_strips()[1:3]]
        assert all(words in line for words, line in zip(said, lines, strict=True)), lines
