"""Console: every action of its table, against a real target process on the fast clock."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from console_steps import console_of, events_of, mark_variable, recording_of, type_first
from steps import Step, Until
from textual.widgets import OptionList, TextArea
from textual.widgets._toast import Toast

from zendsp.errors import Refused
from zendsp.link import ParameterSet, Target, connect
from zendsp.tui.app import ZendspApp
from zendsp.tui.dialogs import Choose, Form, Message, Sliders
from zendsp.tui.dialogs.sliders import NAME, Slider
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


@pytest.mark.covers(
    "console.filter", "console.edit", "console.stage", "console.update", "console.undo",
    "console.initial", "console.initial_all",
)
async def test_variables_edit_stage_update_undo(
    lab: ZendspApp, target: Target, built: Step, until: Until
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await built(lab, pilot)
        console = console_of(lab)
        await mark_variable(lab, pilot, "Kp1")
        await pilot.press("enter")
        await pilot.pause()
        assert isinstance(lab.screen, Form)
        await type_first(pilot, "99999")
        assert isinstance(lab.screen, Form) and "outside" in str(
            lab.screen.query_one("#problem").render()
        )
        await type_first(pilot, "1500")
        await until(pilot, lambda: target["Kp1"] == 1500.0, "written at once")
        await until(
            pilot, lambda: console.key_to_applied_s == console.key_to_applied_s,
            "the sample is reported",
        )

        for name, value in (("Kp2", "250"), ("Kd2", "10")):
            await mark_variable(lab, pilot, name)
            await pilot.press("t")
            await type_first(pilot, value)
        assert console.staged == {"Kp2": 250.0, "Kd2": 10.0}
        assert target["Kp2"] == 300.0, "staged is not applied"
        await pilot.press("u")
        await pilot.pause()
        assert isinstance(lab.screen, Message)
        await pilot.press("enter")
        await until(pilot, lambda: not console.staged and target["Kp2"] == 250.0, "applied")
        ticks = {change.tick for change in target.log() if change.name in ("Kp2", "Kd2")}
        assert len(ticks) == 1, "both in one sample"

        await pilot.press("z")
        await until(
            pilot, lambda: target["Kp2"] == 300.0 and target["Kd2"] == 12.0, "undone together"
        )
        await until(pilot, lambda: lab.session.snapshot.values["Kp2"] == 300.0, "seen")
        await pilot.press("z")
        await until(pilot, lambda: target["Kp1"] == 2000.0, "and the one before")
        target["Kd1"] = 77.0
        await until(pilot, lambda: lab.session.snapshot.values["Kd1"] == 77.0, "seen")
        await mark_variable(lab, pilot, "Kd1")
        await pilot.press("i")
        assert console.staged == {"Kd1": 120.0}
        await pilot.press("z")
        assert console.staged == {}
        await pilot.press("I")
        assert console.staged == {"Kd1": 120.0}, "only what differs"

        await pilot.press("slash", *"gain")
        await until(
            pilot, lambda: console.variables.table.row_count == 4, "four gains by their description"
        )
        await pilot.press("escape")  # leaves the line, and shows all again
        assert lab.focused is console.variables.table
        await until(
            pilot, lambda: console.variables.table.row_count == len(lab.session.snapshot.variables),
            "all again",
        )


async def test_a_signal_cannot_be_written_and_units_stay_whole(
    lab: ZendspApp, built: Step, until: Until
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await built(lab, pilot)
        await mark_variable(lab, pilot, "q1")
        await pilot.press("enter")
        await until(pilot, lambda: "q1 is a signal" in events_of(lab), "refused in words")
        await mark_variable(lab, pilot, "Kp1")
        table = console_of(lab).variables.table
        shown = [table.render_line(y).text for y in range(table.size.height)]
        assert any("Kp1" in line and "N m/rad" in line for line in shown)


@pytest.mark.long("tests/e2e/test_cli.py has params; lost: in the terminal")
@pytest.mark.covers("console.sets")
async def test_parameter_sets_save_diff_and_stage(
    lab: ZendspApp, target: Target, built: Step, until: Until, folder: Path
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await built(lab, pilot)
        await until(pilot, lambda: "Kp1" in lab.session.snapshot.values, "values")
        await pilot.press("w")
        await pilot.pause()
        assert isinstance(lab.screen, Choose)
        await pilot.press("enter")
        await pilot.pause()
        await type_first(pilot, "calm")
        await until(pilot, lambda: (folder / "sets" / "calm.json").is_file(), "saved")
        assert ParameterSet.load(folder / "sets" / "calm.json").values["Kp1"] == 2000.0
        target.update(Kp1=900.0, Kd1=50.0)
        await until(pilot, lambda: lab.session.snapshot.values["Kp1"] == 900.0, "changed")
        await pilot.press("w", "down", "enter")
        await pilot.pause()
        assert isinstance(lab.screen, Message)
        shown = str(lab.screen.query_one(".words").render())
        assert "Kp1" in shown and "Kd1" in shown and "Kp2" not in shown
        await pilot.press("enter")
        await pilot.pause()
        assert console_of(lab).staged == {"Kp1": 2000.0, "Kd1": 120.0}
        ParameterSet({"Kp1": 700.0}).save(folder / "sets" / "stiff.json")
        await pilot.press("w", "down", "space", "down", "space", "enter")
        await pilot.pause()
        assert isinstance(lab.screen, Message)
        lines = str(lab.screen.query_one(".words").render()).splitlines()
        assert lines[0].split() == ["target", "stiff", "calm"]
        assert next(li for li in lines if "Kp1" in li).split() == ["Kp1", "900", "700", "2000"]
        await pilot.press("escape")


MATRIX = """#include "isr.h"
static double K[2][4] = {{1.0, 2.0, 3.0, 4.0}, {5.0, 6.0, 7.0, 8.0}}, r[2], wide[40], q[2];
void UserInit(void) {
    PARAMETER_ARRAY(K, "N m/rad", -100.0, 100.0, "gains");
    PARAMETER_ARRAY(r, "rad", -1.0, 1.0, "reference");
    PARAMETER_ARRAY(wide, "", -1.0, 1.0, "too many to show");
    SIGNAL(q, "rad", "positions");
}
void UserISR_INT2(void) { q[0] = READ_POSITION(0); }
"""


async def test_a_matrix_has_a_slider_for_each_element_and_says_where_the_scope_is_full(
    lab: ZendspApp, target: Target, until: Until
) -> None:
    target.download({"matrix.c": MATRIX})
    async with lab.run_test(size=(140, 50)) as pilot:
        await until(pilot, lambda: "r" in lab.session.snapshot.values, "values")
        await mark_variable(lab, pilot, "K")
        await pilot.press("k")
        await pilot.pause()
        dialog = lab.screen
        assert isinstance(dialog, Sliders)
        sliders = {s.variable.name: s for s in dialog.query(Slider)}
        assert len(sliders) == 10 and next(iter(sliders)) == "K[0,0]"
        assert sliders["K[1,2]"].value == 7.0 and sliders["r[1]"].value == 0.0
        await pilot.press("right")
        await until(pilot, lambda: target["K[0,0]"] == 2.0, "written, and nothing else")
        assert target["K[1,2]"] == 7.0
        await pilot.press("z")
        await until(pilot, lambda: target["K[0,0]"] == 1.0, "back")
        await pilot.press("right", "escape")
        await until(pilot, lambda: target["K[0,0]"] == 2.0, "written")
        await pilot.press("z")
        await until(pilot, lambda: target["K[0,0]"] == 1.0, "undone")
        console = console_of(lab)
        console.plot_names(["r[0]", "r[1]", "q[0]"])
        await mark_variable(lab, pilot, "K")
        await pilot.press("space")
        assert "K has 8 curves, 5 of 8 are free: K[5], K[6], K[7] are left out" in events_of(lab)
        await pilot.press("l", "l")
        assert "over one another: the axis is that of r[0], y chooses another" in events_of(lab)


@pytest.mark.covers("console.sliders")
async def test_sliders_move_parameters_by_key_and_mouse(
    lab: ZendspApp, target: Target, built: Step, until: Until
) -> None:
    async with lab.run_test(size=(140, 40)) as pilot:
        await built(lab, pilot)
        await until(pilot, lambda: "Kd1" in lab.session.snapshot.values, "values")
        await mark_variable(lab, pilot, "Kd1")
        await pilot.press("k")
        await pilot.pause()
        dialog = lab.screen
        assert isinstance(dialog, Sliders)
        slider = dialog.query(Slider).first()
        assert slider.variable.name == "Kd1" and slider.has_focus, "the marked one first"
        assert all(s.variable.name != "use_table" for s in dialog.query(Slider))
        await pilot.press("right", "shift+right", "ctrl+left")
        # 0 … 1000: 120 + 5 + 50 − 0.5
        await until(pilot, lambda: target["Kd1"] == 174.5, "written")
        assert await pilot.click(slider, offset=(NAME + slider.bar - 1, 0))
        await until(pilot, lambda: target["Kd1"] == 1000.0, "the right end, by mouse")
        await pilot.press("right")
        assert slider.value == 1000.0, "and not beyond"
        await pilot.press("z")
        await until(pilot, lambda: target["Kd1"] == 120.0, "all back in one sample")
        await pilot.press("down", "right")
        assert lab.focused is not slider
        other = lab.focused
        assert isinstance(other, Slider)
        name = other.variable.name
        await pilot.press("escape")
        await until(pilot, lambda: target[name] != other.variable.initial, "the last move counts")
        await until(
            pilot, lambda: lab.session.snapshot.values[name] != other.variable.initial,
            "seen here too",
        )
        await pilot.press("z")
        await until(pilot, lambda: target[name] == other.variable.initial, "undone")


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
