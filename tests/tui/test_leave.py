"""Leaving the terminal while the machine moves asks what is to become of it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from textual.widgets import OptionList

from zendsp.errors import NotStopped
from zendsp.link import Target
from zendsp.tui.app import ZendspApp
from zendsp.tui.dialogs import Choose
from zendsp.tui.dialogs.leave import Leave, may_move
from zendsp.tui.snapshot import LinkState

if TYPE_CHECKING:
    from steps import Until


@pytest.mark.parametrize("answer", ["stay", "stop", "leave", "not stopped"])
@pytest.mark.parametrize("size", [(80, 24), (200, 60)], ids=["small", "large"])
async def test_leaving_a_machine_that_moves_is_asked(
    lab: ZendspApp, target: Target, until: Until, answer: str, size: tuple[int, int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    target.download("pd.c")
    target.start()
    async with lab.run_test(size=size) as pilot:
        await until(pilot, lambda: lab.session.snapshot.state == "running", "it runs")
        await pilot.press("ctrl+q")
        await until(pilot, lambda: isinstance(lab.screen, Leave), "the question")
        await pilot.press("ctrl+q")
        assert len(lab.screen_stack) == 2 and not lab._exit, "asked once, and not gone"
        if answer == "not stopped":

            def fails() -> str:
                raise NotStopped("no word")

            monkeypatch.setattr(lab.session.require(), "stop", fails)
        downs = {"stay": 0, "stop": 1, "leave": 2, "not stopped": 1}[answer]
        await pilot.press(*["down"] * downs, "enter")
        if answer in ("stop", "leave"):
            await until(pilot, lambda: lab._exit, "it ends")
        else:
            await until(pilot, lambda: not isinstance(lab.screen, Leave), "the question goes")
        if answer == "not stopped":
            verdict = lab.session.stops.verdict
            assert verdict is not None and verdict.state == "not stopped" and not lab._exit
        assert (target.status().trip is not None) is (answer == "stop")
        assert lab._exit is (answer in ("stop", "leave"))


async def test_the_question_follows_what_becomes_of_the_machine_beneath(
    lab: ZendspApp, target: Target, until: Until
) -> None:
    target.download("pd.c")
    target.start()
    async with lab.run_test(size=(80, 24)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.state == "running", "it runs")
        await pilot.press("ctrl+q")
        await until(pilot, lambda: isinstance(lab.screen, Leave), "the question")
        await until(pilot, lambda: lab.screen.query(OptionList), "its lines")

        def said() -> str:
            rows = lab.screen.query_one(OptionList)
            lines = [str(rows.get_option_at_index(i).prompt) for i in range(rows.option_count)]
            return "\n".join([str(lab.screen.query_one(".box").border_title), *lines])

        assert "The machine moves" in said() and "the program goes on" in said()
        await pilot.press("down")
        target.pause()  # by somebody else
        await until(pilot, lambda: "The machine stands" in said(), "the title follows")
        assert "goes on" not in said(), said()
        assert lab.screen.query_one(OptionList).highlighted == 1, "the marked line stays marked"
        target.stop()
        await until(pilot, lambda: "The machine is stopped" in said(), "and once more")


async def test_leaving_a_machine_that_ran_when_the_link_was_lost_is_asked(
    lab: ZendspApp, target: Target, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl+Q left at once beneath "NOT STOPPED: use the machine's emergency stop"."""
    target.download("pd.c")
    target.start()
    async with lab.run_test(size=(80, 24)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.state == "running", "it runs")
        lost = replace(lab.session.snapshot, link=LinkState.LOST)
        assert may_move(lost) and not may_move(replace(lost, gone=True))
        known = property(lambda _: lost, lambda *_: None)  # whatever the poller hears
        monkeypatch.setattr(type(lab.session), "snapshot", known, raising=False)
        await pilot.press("ctrl+q")
        await until(pilot, lambda: isinstance(lab.screen, Leave), "the question")
        await until(pilot, lambda: lab.screen.query(OptionList), "its lines")
        assert lab.screen.query_one(".box").border_title == "The link is lost"
        lines = lab.screen.query_one(OptionList)
        assert "the program goes on" in str(lines.get_option_at_index(2).prompt)
        await pilot.press("enter")
        await until(pilot, lambda: not isinstance(lab.screen, Leave), "it stays")
        assert not lab._exit


async def test_leaving_a_machine_that_stands_is_not_questioned(
    lab: ZendspApp, target: Target, until: Until
) -> None:
    target.download("pd.c")
    async with lab.run_test(size=(80, 24)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.state == "loaded", "link")
        await pilot.press("ctrl+q")
        await until(pilot, lambda: lab._exit, "it ends")


@pytest.mark.covers("app.suspend")
async def test_the_terminal_does_not_sleep_and_says_what_a_lost_host_would_mean(
    lab: ZendspApp, target: Target, until: Until
) -> None:
    def said() -> str:
        return "\n".join(e.text for e in lab.session.events.since(0)[1])

    async with lab.run_test(size=(80, 24)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.link == "up", "link")
        await pilot.press("ctrl+z")
        await until(pilot, lambda: "lost host; Ctrl+Q leaves" in said(), "the line")
        lab.session.require().drive("take")
        lab.session.require().drive("host_lost", policy="hold")
        await until(pilot, lambda: lab.session.snapshot.mine, "it commands")
        await until(pilot, lambda: lab.session.snapshot.host_lost == "hold", "the policy")
        await pilot.press("ctrl+z")
        await until(pilot, lambda: "its program brings it to rest" in said(), "the policy is told")


async def test_ctrl_c_where_it_ends_nothing_says_what_leaves_and_what_stops(
    lab: ZendspApp, until: Until
) -> None:
    async with lab.run_test(size=(80, 24)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.link == "up", "link")
        await pilot.press("ctrl+c")
        await until(pilot, lambda: bool(lab._notifications), "a message")
        (said,) = [n.message for n in lab._notifications]
        assert said == "Ctrl+C ends nothing here: Ctrl+Q leaves, F9 is STOP"


@pytest.mark.parametrize("answer", ["stay", "build"])
async def test_a_build_that_ends_a_program_that_moves_the_machine_is_asked(
    lab: ZendspApp, target: Target, until: Until, answer: str
) -> None:
    target.download("pd.c")
    target.start()
    async with lab.run_test(size=(80, 24)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.state == "running", "it runs")
        await pilot.press("b")
        await until(pilot, lambda: isinstance(lab.screen, Choose), "the question")
        assert target.status().state == "running"
        await pilot.press(*["down"] * (answer == "build"), "enter")
        if answer == "build":
            await until(pilot, lambda: lab.session.snapshot.state == "loaded", "built")
        else:
            await until(pilot, lambda: not isinstance(lab.screen, Choose), "the question goes")
            assert target.status().state == "running"
