"""Console: every action of its table, against a real target process on the fast clock."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from console_steps import events_of, mark_variable, recording_of, type_first
from steps import Step, Until
from textual.widgets import OptionList, TextArea
from textual.widgets._toast import Toast

from zendsp.errors import Refused
from zendsp.link import Target, connect
from zendsp.tui.app import ZendspApp
from zendsp.tui.dialogs import Choose, Message
from zendsp.tui.dialogs.source import SourceView
from zendsp.tui.runs import list_runs
from zendsp.tui.scope import Scope
from zendsp.tui.screens.analysis import ProcessView
from zendsp.tui.screens.console_program import first_words
from zendsp.tui.screens.diagnose import DiagnoseScreen
from zendsp_isr.sources import shipped_programs


@pytest.mark.covers(
    "app.command", "app.acknowledge", "console.power", "console.home", "console.enable",
    "console.start", "console.pause", "console.host_lost", "console.build",
)
async def test_the_safe_sequence_by_keys(
    lab: ZendspApp, target: Target, built: Step, until: Until
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await built(lab, pilot)
        snap = lambda: lab.session.snapshot  # noqa: E731
        await pilot.press("o")
        await until(pilot, lambda: snap().explicit and snap().mine, "powered; who powers, commands")
        await pilot.press("s")
        await until(
            pilot, lambda: "starting is refused: enabled" in events_of(lab),
            "start without enable is refused by name",
        )
        await pilot.press("h")
        await until(
            pilot,
            lambda: "home: homed" in events_of(lab) or "homed" in events_of(lab).split("\n")[-1],
            "homed",
        )
        assert target.status().homed
        await pilot.press("e")
        await until(pilot, lambda: snap().drive == "enabled", "enabled")
        await pilot.press("s")
        await until(
            pilot, lambda: snap().drive == "running" and target.status().state == "running",
            "running",
        )
        await pilot.press("p")
        await until(pilot, lambda: snap().state == "paused", "paused")
        await pilot.press("e")
        await until(pilot, lambda: snap().drive == "homed", "disabled")
        await pilot.press("H", "down", "enter")
        await until(pilot, lambda: target.drive_status().host_lost == "hold", "policy")
        await pilot.press("ctrl+r")
        await until(pilot, lambda: target.drive_status().commander == "", "given back")
        target.take_command()
        await until(pilot, lambda: snap().commander and not snap().mine, "somebody else commands")
        await pilot.press("e")
        await until(
            pilot, lambda: "exclusive right" in events_of(lab), "refused, and it says who commands"
        )
        await pilot.press("ctrl+r")
        await pilot.pause()
        assert isinstance(lab.screen, Message)
        await pilot.press("enter")
        await until(pilot, lambda: snap().mine, "taken over deliberately")
        await pilot.press("f9")
        await until(pilot, lambda: snap().drive == "stopped", "stopped")
        await until(
            pilot, lambda: not lab.session.stops.unseen(time.monotonic()), "somebody saw it"
        )
        await pilot.press("ctrl+k")
        await until(pilot, lambda: snap().drive == "homed" and snap().trip is None, "acknowledged")
        await pilot.press("o")
        await until(pilot, lambda: snap().drive == "off", "power off")


async def test_a_target_without_a_program_says_which_key_builds_one(
    lab: ZendspApp, until: Until
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.link == "up", "link")
        scope = lab.screen.query_one(Scope)
        await until(pilot, lambda: "no program is loaded" in scope.empty_text, "said")
        assert f"b builds {lab.source.name}" in scope.empty_text


def test_what_a_shipped_program_is_for_is_said_where_it_is_chosen() -> None:
    said = {path.name: first_words(path) for path in shipped_programs()}
    assert said["joint_pd.c"].startswith("PID in every joint, for any machine")
    assert all(10 < len(words) < 200 for words in said.values()), said


async def test_a_refused_enable_names_each_condition(
    lab: ZendspApp, target: Target, until: Until
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.link == "up", "link")
        await pilot.press("o")
        await until(pilot, lambda: lab.session.snapshot.explicit, "powered")
        await pilot.press("e")
        await until(pilot, lambda: "enabling is refused" in events_of(lab), "refused")
        text = events_of(lab)
        assert "program: no code is loaded" in text
        assert "homed, limits, sensors, stop input: known once a program is loaded" in text
        assert target.drive_status().state in ("ready", "off")


@pytest.mark.covers("console.open_source", "console.source")
async def test_a_compile_error_is_shown_at_its_line_and_mended_in_place(
    lab: ZendspApp, target: Target, built: Step, until: Until, folder: Path
) -> None:
    bad = folder / "bad.c"
    bad.write_text(
        '#include "isr.h"\nstatic double a;\nvoid UserInit(void) { a = 1.0 }\n'
        "void UserISR_INT2(void) {}\nvoid UserBackground(void) {}\n"
    )
    async with lab.run_test(size=(100, 30), notifications=True) as pilot:
        await built(lab, pilot)
        before = target.status().program
        await pilot.press("O")
        await pilot.pause()
        assert isinstance(lab.screen, Choose)
        await pilot.press("enter")  # bad.c is the first by name
        await until(pilot, lambda: lab.source == bad, "chosen")
        said = "bad.c is chosen: b builds it"
        assert said in events_of(lab)
        await until(
            pilot, lambda: any(said in str(toast.render()) for toast in lab.screen.query(Toast)),
            "said where the log is not in sight",
        )
        await pilot.press("b")
        await until(pilot, lambda: "bad.c:3:" in events_of(lab), "file and line in the log")
        assert target.status().program == before, "the running program is not touched"
        await pilot.press("g")
        await pilot.pause()
        assert isinstance(lab.screen, SourceView)
        area = lab.screen.query_one(TextArea)
        assert area.cursor_location[0] + 1 == 3
        area.text = area.text.replace("a = 1.0 }", "a = 1.0; }")
        await pilot.press("ctrl+b")
        await until(
            pilot, lambda: target.status().program not in ("", before), "built and downloaded"
        )
        assert "a = 1.0; }" in bad.read_text()


@pytest.mark.long("tests of each screen open it; lost: from the console")
@pytest.mark.covers("console.record", "console.simulate", "console.diagnose")
async def test_record_then_open_simulation_and_diagnosis(
    lab: ZendspApp, target: Target, built: Step, until: Until, folder: Path
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await recording_of(lab, target, pilot, built, until, "1.5")
        await until(pilot, lambda: list_runs(folder / "runs"), "the run is kept")
        run = list_runs(folder / "runs")[0]
        recording = run.recording()
        assert len(recording) == 1500 and recording.lost == 0 and "pd.c" in recording.sources
        (folder / "arm.toml").write_text('name = "arm"\n')
        await pilot.press("S")
        await pilot.pause()
        await type_first(pilot, str(folder / "arm.toml"))
        view = lab.screen
        assert isinstance(view, ProcessView)
        await until(pilot, lambda: view.status is not None, "the worker process ends and says so")
        await pilot.press("escape", "D")
        await until(pilot, lambda: isinstance(lab.screen, DiagnoseScreen), "Diagnose is shown")
        assert isinstance(lab.screen, DiagnoseScreen)
        assert lab.screen.chosen("fit") == [str(run.folder / "recording.mat")]


@pytest.mark.covers("console.record")
async def test_while_it_records_gains_change_and_r_ends_it_with_what_there_is(
    lab: ZendspApp, target: Target, built: Step, until: Until, folder: Path
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await recording_of(lab, target, pilot, built, until, "200")
        await until(pilot, lambda: lab.session.snapshot.recording, "it records")
        await mark_variable(lab, pilot, "Kp1")
        await pilot.press("enter")
        await pilot.pause()
        await type_first(pilot, "1900")
        await until(pilot, lambda: target["Kp1"] == 1900.0, "the gain is written meanwhile")
        await pilot.press("r")
        await until(pilot, lambda: list_runs(folder / "runs"), "what there is is kept")
        recording = list_runs(folder / "runs")[0].recording()
        assert 0 < len(recording) < 200_000 and recording.lost == 0
        assert [change.name for change in recording.log] == ["Kp1"]


@pytest.mark.covers("console.record")
async def test_a_recording_that_a_pause_cut_short_is_kept(
    lab: ZendspApp, target: Target, built: Step, until: Until, folder: Path
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await recording_of(lab, target, pilot, built, until, "200")
        await until(pilot, lambda: lab.session.snapshot.recording, "it records")
        await pilot.press("p")
        await until(pilot, lambda: list_runs(folder / "runs"), "what there is is kept")
        assert 0 < len(list_runs(folder / "runs")[0].recording()) < 200_000
        why = "paused before the recording was complete"
        await until(pilot, lambda: why in events_of(lab), "it says so")


@pytest.mark.covers(
    "app.show('console')", "app.show('execute')", "app.show('reference')", "app.show('diagnose')",
    "app.help", "app.next_theme", "app.command_palette", "app.quit",
)
async def test_keys_that_work_everywhere(lab: ZendspApp, until: Until) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.link == "up", "link")
        for key, name in (
            ("f3", "execute"),
            ("f4", "reference"),
            ("f5", "diagnose"),
            ("f2", "console"),
        ):
            await pilot.press(key)
            await until(pilot, lambda name=name: lab.current_mode == name,
                name)  # type: ignore[misc]
        await pilot.press("f1")
        await pilot.pause()
        assert isinstance(lab.screen, Message)
        await pilot.press("escape", "ctrl+t")
        assert lab.theme == "zendsp-day"
        await pilot.press("ctrl+p")
        await pilot.pause()
        assert type(lab.screen).__name__ == "CommandPalette"
        await pilot.press("escape")
        await pilot.pause()
        await pilot.press("ctrl+q")
        await until(pilot, lambda: not lab.is_running or lab._exit, "it ends")


@pytest.mark.covers("app.connect")
async def test_connect_offers_running_targets_and_machines(
    lab: ZendspApp, target: Target, until: Until
) -> None:
    lab._target = ""
    async with lab.run_test(size=(100, 30)) as pilot:
        await pilot.press("ctrl+o")
        await until(
            pilot, lambda: isinstance(lab.screen, Choose) and isinstance(lab.focused, OptionList),
            "the list",
        )
        await pilot.press(*target.name)
        await until(
            pilot, lambda: lab.screen.query_one(OptionList).option_count == 1,
            "the filter leaves one",
        )
        await pilot.press("enter")
        await until(
            pilot,
            lambda: lab.session.snapshot.link == "up"
            and lab.session.snapshot.target == target.name,
            "connected",
        )


async def test_a_second_host_cannot_command_what_the_terminal_commands(
    lab: ZendspApp, target: Target, enabled: Step, until: Until
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await enabled(lab, pilot)
        with connect(target.name) as other:
            with pytest.raises(Refused, match="exclusive right"):
                other.start()
            with pytest.raises(Refused, match="exclusive right"):
                other["Kp1"] = 1.0
            assert other["Kp1"] == 2000.0, "reading is free"
            other.stop()
        await until(pilot, lambda: lab.session.snapshot.drive == "stopped", "STOP is free as well")
