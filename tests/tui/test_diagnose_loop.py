"""Diagnose: the compensation and the next recording that follow from a diagnosis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import diagnosis_cases as cases
import pytest
from steps import Step, Until, dialog_words, stored_shown, text_of
from textual.widgets import OptionList

from zendsp.errors import ZendspError
from zendsp.link import Target
from zendsp.physics import load_model
from zendsp.physics.codegen.terms import why_not
from zendsp.physics.files.model_write import model_text
from zendsp.physics.model import Quantity, Term
from zendsp.reference import make_reference
from zendsp.tui.app import ZendspApp
from zendsp.tui.compensating import compensation_of, written_out
from zendsp.tui.dialogs import Message
from zendsp.tui.runs import DATA, list_runs
from zendsp.tui.screens.diagnose_loop import look_s
from zendsp.tui.screens.execute import ExecuteScreen
from zendsp_protocol.messages import Program


@pytest.mark.covers("diagnose.compensate")
async def test_compensation_fades_in_and_out_of_the_running_program(
    lab: ZendspApp, target: Target, enabled: Step, until: Until, folder: Path
) -> None:
    cases.stored(folder / "diagnoses")

    def share() -> float:
        return float(lab.session.snapshot.values.get("comp_share", -1.0))

    async with lab.run_test(size=(160, 48)) as pilot:
        await enabled(lab, pilot)
        screen = await stored_shown(pilot, until)
        await pilot.press("c")
        await until(pilot, lambda: isinstance(lab.screen, Message), "it offers to build")
        await pilot.press("enter")
        await until(pilot, lambda: share() == 0.0, "built with room, and off")
        assert (folder / "compensation.c").is_file()
        await pilot.press("f2")
        await pilot.pause()
        await until(pilot, lambda: lab.session.snapshot.drive in ("enabled", "homed"), "drives")
        if lab.session.snapshot.drive == "homed":
            await pilot.press("e")
            await until(pilot, lambda: lab.session.snapshot.drive == "enabled", "enabled")
        await pilot.press("s")
        await until(pilot, lambda: lab.session.snapshot.t > 3.0, "running on the circle")
        await pilot.press("f5")
        await pilot.pause()
        await pilot.press("c", "c")  # at once; a second press while it measures starts no other
        await until(pilot, lambda: "compensation off" in text_of(screen, "#loop-words"), "measures")
        await until(pilot, lambda: share() == 1.0, "on")
        assert screen.before["e1"] > 0.0, "the error without it was measured first"
        at = lab.session.snapshot.t
        await until(pilot, lambda: "compensation on" in text_of(screen, "#loop-words"), "it says")
        assert target.read(["comp_coulomb1_level"]).values["comp_coulomb1_level"] == 8.0
        await until(pilot, lambda: lab.session.snapshot.t > at + 3.0, "faded in, and 2 s more")
        await until(
            pilot, lambda: screen._rms().get("e1", 1.0) < 0.7 * screen.before["e1"],
            "the tracking error falls",
        )
        words = text_of(screen, "#loop-words")
        assert "→" in words and "rms over 4.5 s" in words, "a turn of the circle"
        assert words.count("rad") == 1 and len(words) <= 80, "whole, where there are 80 columns"
        await pilot.press("c")
        await until(pilot, lambda: share() == 0.0, "off")
        await pilot.press("c")
        await until(pilot, lambda: share() == 1.0, "on again, of a loop that is looked at already")
        screen.compensation = None  # as of the next diagnosis, where nothing is left to cancel
        line = screen.query_one("#findings", OptionList)
        await until(
            pilot,
            lambda: "nothing to cancel; the compensation in the program is on; c fades it out"
            in str(line.get_option_at_index(len(screen.entries) - 1).prompt),
            "that one is on is not hidden",
        )
        assert "compensation on" in text_of(screen, "#loop-words")
        await pilot.press("c")
        await until(pilot, lambda: share() == 0.0, "off")


TOLD = pytest.mark.long("compensation is faded in above; lost: what is said before it can be")


@TOLD
async def test_a_program_without_room_is_told_what_to_add(
    lab: ZendspApp, enabled: Step, until: Until, folder: Path
) -> None:
    cases.stored(folder / "diagnoses")
    source = folder / "pd.c"
    source.write_text(
        source.read_text()
        .replace('__has_include("compensation.c")', "0")
        .replace('#include "compensation.c"\n', "")
    )
    async with lab.run_test(size=(160, 48)) as pilot:
        await enabled(lab, pilot)
        screen = await stored_shown(pilot, until)
        await pilot.press("c")
        await until(pilot, lambda: isinstance(lab.screen, Message), "it says how")
        shown = dialog_words(pilot)
        assert "CompensationInit();" in shown and "tau[j] += Compensation(" in shown
        await pilot.press("enter")
        await until(pilot, (folder / "compensation.c").is_file, "written")
        assert screen.compensation is not None and screen.compensation.left_out == ()


@TOLD
async def test_a_program_that_runs_already_needs_no_source_to_be_chosen(
    lab: ZendspApp, target: Target, until: Until, folder: Path
) -> None:
    """As after ``zendsp run pd.c`` in another terminal: the target knows what it compiled."""
    cases.stored(folder / "diagnoses")
    lab.source, pd = None, folder / "pd.c"
    target.download(pd, ["-DHERE=1"])
    pd.write_text("another program")
    async with lab.run_test(size=(160, 48)) as pilot:
        await stored_shown(pilot, until)
        await until(pilot, lambda: lab.session.snapshot.program, "connected")
        await pilot.press("c")
        await until(pilot, lambda: isinstance(lab.screen, Message), "it says why not")
        said = dialog_words(pilot)
        assert "is not the pd.c that runs" in said and "Choose its source on Console" in said
        await pilot.press("escape")
        pd.unlink()
        await pilot.press("c")
        await until(pilot, lambda: isinstance(lab.screen, Message), "it offers to build")
        await pilot.press("enter")
        await until(pilot, lambda: lab.session.snapshot.values.get("comp_share") == 0.0, "built")
        assert "comp_coulomb1_level" in target.variables()
        assert "-DHERE=1" in target.program().flags
        assert lab.source == pd and "UserISR_INT2" in pd.read_text()


@pytest.mark.parametrize(
    ("values", "seconds"),
    [
        ({"turn_time": 4.5}, 4.5),
        ({"turn_time": 4.5, "use_table": True}, 2.0),
        ({"amplitude": 0.3, "period": 4.0, "use_table": True}, 8.0),  # sways about its table
        ({"amplitude": 0.0, "period": 4.0}, 2.0),
        ({"amplitude": 0.3, "period": 20.0}, 2.0),
        ({"amplitude": [0.1, 0.2], "period": "slow"}, 2.0),  # of a stranger's program
    ],
)
def test_errors_are_compared_over_whole_turns(values: dict[str, Any], seconds: float) -> None:
    # half a period of a sway with the compensation, the other without: 0.0115 → 0.0118, not 0.0034
    assert look_s(values) == seconds


def test_a_program_of_a_target_is_written_nowhere_else(tmp_path: Path) -> None:
    for sources, said in (
        ({}, "does not know the source"),
        ({"pd.c": "", "../up.h": ""}, "up.h of the running program does not belong"),
    ):
        with pytest.raises(ZendspError, match=said):
            written_out(Program(sources=sources), tmp_path)
    place, texts = written_out(Program(sources={"a.c": "b", "compensation.c": "c"}), tmp_path)
    assert place == tmp_path / "a.c" and texts == {"a.c": "b"}


def test_what_a_torque_cannot_cancel_is_left_out_and_said(tmp_path: Path) -> None:
    d = cases.stored(tmp_path)
    model = load_model(d.folder / "model.toml")
    late = Term("lag", 1, {"time_constant": Quantity(0.002)})
    (d.folder / "model.toml").write_text(model_text(model.with_terms((*model.terms, late))))
    d.report["findings"].append({**d.report["findings"][0], "effect": "lag"})
    made = compensation_of(d)
    assert made.left_out == (f"Not compensated: lag of joint 1 ({why_not('lag')}).",)
    assert made.values and not any("lag" in name for name in made.values)


@pytest.mark.long("runs are played and diagnosed by others; lost: both at once")
@pytest.mark.covers("diagnose.next")
async def test_the_proposed_motion_is_played_and_diagnosed_with_the_rest(
    lab: ZendspApp, enabled: Step, until: Until, folder: Path
) -> None:
    motion = make_reference("circle", "imi_planar", duration=3.0)
    d = cases.stored(folder / "diagnoses", motion=motion)
    Path(d.recordings[0]).write_text("t\n0\n")
    async with lab.run_test(size=(160, 48)) as pilot:
        await enabled(lab, pilot)
        screen = await stored_shown(pilot, until)
        asked: list[list[str]] = []
        screen.action_start = lambda: asked.append(screen.chosen("fit"))  # type: ignore[method-assign]
        await pilot.press("n")
        await until(pilot, lambda: isinstance(lab.screen, ExecuteScreen), "Execute is shown")
        execute = lab.screen
        assert isinstance(execute, ExecuteScreen)
        await until(
            pilot, lambda: execute.references and all(c.met for c in execute.conditions),
            "tried on the twin",
        )
        await pilot.press("s")
        await until(pilot, lambda: asked, "played, and diagnosed again")
        made = list_runs(folder / "runs")[0]
        assert asked[0] == [d.recordings[0], str(made.folder / DATA)]
        assert screen.model == d.model
        assert lab.screen is screen
