"""Diagnose: from a recording to findings on the screen."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import diagnosis_cases as cases
import numpy as np
import pytest
from steps import Until, alone, answer, dialog_words, stored_shown, text_of
from textual.widgets import OptionList, Static

from zendsp.diagnosis.report.chart import load_chart
from zendsp.physics import load_model
from zendsp.tui import command
from zendsp.tui.diagnoses import compare, list_diagnoses
from zendsp.tui.dialogs import Choose, Message
from zendsp.tui.panels.figure import FigureView
from zendsp.tui.screens import diagnose_loop
from zendsp.tui.screens.diagnose import DiagnoseScreen


def _keys(screen: DiagnoseScreen) -> list[str]:
    return [e.key for e in screen.entries]


def _drawn(screen: DiagnoseScreen) -> None:
    """Both panels are there, as wide as their place, with dots in them."""
    for plot in screen.query_one(FigureView).plots:
        assert plot.display and plot.curves
        lines = [plot.render_line(y) for y in range(plot.size.height)]
        assert all(line.cell_length == plot.size.width for line in lines)
        dots = [c for line in lines for c in line.text if 0x2800 < ord(c) <= 0x28FF]
        assert len(dots) > 20


def _changed(monkeypatch: pytest.MonkeyPatch, change: str) -> None:
    """Let the process that diagnoses run these lines of Python first."""
    begin = "from zendsp.parent import die_with; die_with({})\nimport time, zendsp.cli\n"
    rest = change + "from zendsp.__main__ import main\nmain()\n"
    monkeypatch.setattr(command, "call", lambda parent: begin.format(parent) + rest)


def _model_line(screen: DiagnoseScreen) -> str:
    return screen.query_one("#given-model").render_line(0).text


@pytest.mark.covers("diagnose.start", "diagnose.add", "diagnose.model")
async def test_a_file_is_diagnosed_and_the_finding_is_drawn(tmp_path: Path, until: Until) -> None:
    run, model = cases.bench(tmp_path)
    async with alone(tmp_path, until, (80, 24)) as (pilot, screen):
        await pilot.press("s")
        assert not screen.busy, "nothing to diagnose yet, and it says so"
        await pilot.press("a")
        await pilot.pause()
        assert isinstance(pilot.app.screen, Choose), "the recordings that lie here"
        await pilot.press("enter")
        await until(pilot, lambda: screen.chosen("fit") == [str(run)], "the one that lies here")
        await pilot.press("m")
        await pilot.pause()
        assert isinstance(pilot.app.screen, Choose)
        await pilot.press("enter")  # the model that lies here
        await pilot.pause()
        assert screen.model == str(model)
        await until(pilot, lambda: model.name in _model_line(screen), "its name; it lies here")
        await pilot.press("s")
        assert screen.busy
        await until(pilot, lambda: len(screen.said) > 2, "stages are shown as they begin")
        await until(pilot, lambda: screen.shown and not screen.busy, "diagnosed")
        assert screen.shown is not None
        assert screen.shown.report["findings"][0]["effect"] == "coulomb"
        assert "Missing physics: dry friction (coulomb) at joint 1" in text_of(screen, "#verdict")
        assert {"finding-0", "error_joint1", "torque_joint1", "unseen", "loop"} <= set(
            _keys(screen)
        )
        figure = screen.query_one(FigureView)
        await until(pilot, lambda: figure.display and figure.chart is not None, "the figure")
        law = load_chart(screen.shown.folder / "law_1_coulomb_joint1.chart.json")
        assert figure.chart is not None and figure.chart.name == law.name
        assert np.array_equal(figure.plots[0].curves[0].xy[:, 1], law.panels[0].series[0].y)
        _drawn(screen)
        assert [d.folder for d in list_diagnoses(tmp_path / "diagnoses")] == [screen.shown.folder]
        assert not list((tmp_path / "diagnoses").glob(".*")), "nothing half is left"


@pytest.mark.long("the next test shows them too; lost: that they come before the pictures")
async def test_findings_are_shown_while_the_report_is_still_drawn(
    tmp_path: Path, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, model = cases.bench(tmp_path)
    drawn = tmp_path / "drawn"
    _changed(
        monkeypatch,
        f"""\
import pathlib
import zendsp.diagnosis.report.drawing as drawing
real = drawing.draw_all
def slow(charts, folder):
    while not pathlib.Path({str(drawn)!r}).exists():
        time.sleep(0.05)
    return real(charts, folder)
drawing.draw_all = slow
""",
    )
    async with alone(tmp_path, until) as (pilot, screen):
        screen.added, screen.roles, screen.model = [str(run)], {str(run): "fit"}, str(model)
        await pilot.press("s")
        await until(pilot, lambda: screen.shown is not None, "what is found, before it is drawn")
        assert screen.busy and screen.shown is not None and not screen.shown.page.exists()
        await until(pilot, lambda: screen.query_one(FigureView).chart is not None, "its figure")
        await pilot.press("down", "v")
        log = screen.lab.session.events
        await until(
            pilot, lambda: any("being drawn" in e.text for e in log.since(0)[1]), "no report yet"
        )
        chosen = screen.query_one("#findings", OptionList).highlighted
        drawn.touch()
        await until(pilot, lambda: not screen.busy, "the report is whole")
        assert screen.shown.page.exists() and screen.shown.folder.name[0] != "."
        assert chosen == screen.query_one("#findings", OptionList).highlighted == 1
        drawn.unlink()
        await pilot.press("s")
        await until(pilot, lambda: screen.shown is not None, "once more")
        await pilot.press("ctrl+c")
        await until(pilot, lambda: not screen.busy, "cancelled")
        assert screen.shown is None and not screen.entries, "nothing half is left, nor shown"


def test_the_numbers_of_a_figure_come_back_as_they_were_written(tmp_path: Path) -> None:
    d = cases.stored(tmp_path)
    law = d.charts[0]
    assert law.section == "law" and law.same and law.panels[0].limits == (-10.0, 10.0)
    assert np.array_equal(law.panels[0].series[1].y, np.sign(law.panels[0].series[1].x) * 8.0)


def test_two_diagnoses_stand_side_by_side_in_80_columns(tmp_path: Path) -> None:
    one, other = (cases.stored(tmp_path, name) for name in ("one", "other"))
    other = replace(other, recordings=(*other.recordings, "20261123-164112-next-of-small.mat"))
    lines = compare(one, other).splitlines()
    assert max(map(len, lines)) <= 74  # as wide as the dialog is there
    at = lines[0].index("other")
    (next_line,) = (line for line in lines if line.endswith("small.mat"))
    assert next_line[:at].strip() == "", "goes on in its own column"


async def test_a_long_finding_goes_on_beside_its_label(tmp_path: Path, until: Until) -> None:
    d = cases.stored(tmp_path / "diagnoses")
    d.report["findings"][0]["sentence"] = "A spring pulls " + "and pulls " * 10 + "on joint 1."
    async with alone(tmp_path, until, (80, 24)) as (pilot, screen):
        screen.open(d)
        await pilot.pause()
        lines = screen.query_one("#findings", OptionList)
        first, second = (lines.render_line(y).text for y in (0, 1))
        assert first.lstrip().startswith("97 %  A spring pulls") and "on joint 1." in second
        assert second.startswith(" " * first.index("A spring") + "pulls and")


async def test_a_line_that_says_it_all_leaves_no_empty_space_below_the_list(
    tmp_path: Path, until: Until
) -> None:
    """The list was cut in mid-sentence above empty lines."""
    d = cases.stored(tmp_path / "diagnoses")
    d.report["unexplained"] = "Joint 1: a torque is missing that " + "nothing known predicts, " * 20
    async with alone(tmp_path, until, (120, 40)) as (pilot, screen):
        screen.open(d)
        lines = screen.query_one("#findings", OptionList)
        keys = [e.key for e in screen.entries]
        lines.highlighted = keys.index("unexplained")
        await until(pilot, lambda: not screen.query_one("#detail").is_on_screen, "it is hidden")
        assert lines.max_scroll_y == 0, "all of the list is seen"
        lines.highlighted = keys.index("unseen")
        await until(pilot, lambda: screen.query_one("#words").is_on_screen, "it has more to say")


async def test_where_nothing_is_named_nothing_is_said_of_what_a_torque_cannot_cancel(
    tmp_path: Path, until: Until
) -> None:
    d = cases.stored(tmp_path / "diagnoses", verdict="complete")
    async with alone(tmp_path, until, (120, 40)) as (pilot, screen):
        screen.open(d)
        assert screen.entries[-1].text.plain.endswith("nothing is named that a torque could cancel")
        await pilot.press("c")
        await until(pilot, lambda: isinstance(pilot.app.screen, Message), "c says so")
        assert "Nothing is named that a torque could cancel." in dialog_words(pilot)


@pytest.mark.covers("diagnose.cancel")
async def test_a_diagnosis_is_cancelled_and_leaves_nothing(
    tmp_path: Path, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, model = cases.bench(tmp_path, seconds=1.0)
    waits = "import time; print('pid', os.getpid(), flush=True); time.sleep(600)"
    monkeypatch.setattr(command, "call", lambda parent: waits)
    async with alone(tmp_path, until) as (pilot, screen):
        screen.added, screen.roles, screen.model = [str(run)], {str(run): "fit"}, str(model)
        for key in ("ctrl+c", "escape"):
            await pilot.press("s")
            await until(pilot, lambda: screen.said, "it runs")
            pid = int(screen.said[0].split()[1])
            await pilot.press(key)
            await until(pilot, lambda: not screen.busy, f"{key} ends it")
            with pytest.raises(ProcessLookupError):
                os.kill(pid, 0)
            assert "cancelled" in screen.said[-1]
        assert not list((tmp_path / "diagnoses").glob("*")), "nothing half is left"


async def test_what_was_found_before_a_diagnosis_was_cancelled_is_shown(
    tmp_path: Path, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, model = cases.bench(tmp_path)
    _changed(
        monkeypatch,
        """\
import zendsp.diagnosis.engine as engine
def slow(*_):
    print("slow", flush=True)
    time.sleep(600)
engine.detectable = slow
""",
    )
    async with alone(tmp_path, until) as (pilot, screen):
        screen.added, screen.roles, screen.model = [str(run)], {str(run): "fit"}, str(model)
        await pilot.press("s")
        await until(pilot, lambda: "slow" in screen.said, "the search is done")
        await pilot.press("ctrl+c")
        await until(pilot, lambda: screen.shown and not screen.busy, "so far")
        assert text_of(screen, "#verdict").startswith("So far, interrupted: Missing physics")
        assert screen.shown is not None and screen.shown.page.exists()
        await pilot.press("s")
        await until(pilot, lambda: "slow" in screen.said, "once more")
        screen.action_cancel()
        screen.action_cancel()
        await until(pilot, lambda: not screen.busy, "at once")
        assert len(list_diagnoses(tmp_path / "diagnoses")) == 1, "twice, it keeps nothing"


async def test_a_click_on_what_has_to_wait_says_why_as_its_key_does(
    tmp_path: Path, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, model = cases.bench(tmp_path, seconds=1.0)
    monkeypatch.setattr(command, "call", lambda parent: "import time; time.sleep(600)")
    async with alone(tmp_path, until) as (pilot, screen):
        said: list[str] = []
        monkeypatch.setattr(screen, "say", lambda text, *_: said.append(text))
        screen.added, screen.roles, screen.model = [str(run)], {str(run): "fit"}, str(model)
        assert await pilot.click("#do-report")
        await until(pilot, lambda: "diagnose first" in " ".join(said), "there is no report yet")
        screen.said = ["— cancelled —"]
        screen.query_one("#words", Static).update("— cancelled —")
        assert await pilot.click("#do-start")
        await until(pilot, lambda: screen.busy, "a click starts")
        assert "cancelled" not in text_of(screen, "#words"), "that was the one before"
        await until(pilot, lambda: screen.query_one("#do-start").has_class("-waits"), "drawn so")
        for _ in range(20):  # a click while the screen is laid out anew may pass beside it
            await pilot.click("#do-start")
            await pilot.pause(0.1)
            if any("runs already" in text for text in said):
                break
        assert any("runs already" in text for text in said), said
        screen.action_cancel()
        await until(pilot, lambda: not screen.busy, "it ends")


async def test_a_failed_diagnosis_says_why(tmp_path: Path, until: Until) -> None:
    run, _ = cases.bench(tmp_path, seconds=1.0)
    (tmp_path / "bad.toml").write_text('name = "bad"\n')
    async with alone(tmp_path, until) as (pilot, screen):
        screen.added, screen.roles = [str(run)], {str(run): "fit"}
        screen.model = str(tmp_path / "bad.toml")
        await pilot.press("s")
        await until(pilot, lambda: screen.said and not screen.busy, "it ends")
        assert "bad.toml" in screen.said[-1] and "bad.toml" in text_of(screen, "#words")
        assert screen.shown is None


@pytest.mark.covers("diagnose.report", "diagnose.save", "diagnose.earlier", "diagnose.compare")
async def test_an_earlier_diagnosis_is_opened_saved_and_compared(
    tmp_path: Path, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = cases.stored(tmp_path / "diagnoses", "first", level=6.0)
    second = cases.stored(tmp_path / "diagnoses", "second", level=8.0)
    pages: list[str] = []
    monkeypatch.setattr(diagnose_loop, "graphical", lambda: bool(pages))
    monkeypatch.setattr("webbrowser.open", lambda url: not pages.append(url))
    async with alone(tmp_path, until, (200, 60)) as (pilot, screen):
        await stored_shown(pilot, until)
        await until(pilot, lambda: screen.query_one(FigureView).display, "its first figure")
        await pilot.pause()
        _drawn(screen)
        assert screen.shown is not None and screen.shown.folder == second.folder
        assert _keys(screen) == [
            "finding-0", "finding-1", "fit", "left-1", "unseen", "notes", "loop"
        ]  # fmt: skip
        await pilot.press("down", "down", "down", "down")
        assert "ripple" in text_of(screen, "#words") and "0.002 N m" in text_of(screen, "#words")
        await pilot.press("w")
        await answer(pilot, str(tmp_path / "better.toml"))
        levels = [t.value("level") for t in load_model(tmp_path / "better.toml").terms
            if t.effect == "coulomb"]  # fmt: skip
        assert levels == [8.0, 2.0]
        await pilot.press("d", "enter")
        await pilot.pause()
        shown = dialog_words(pilot)
        row = next(line for line in shown.splitlines() if line.startswith("coulomb, joint 1"))
        assert row.index("level 6 N m") < row.index("level 8 N m"), shown
        assert max(map(len, shown.splitlines())) <= 74, "as wide as the dialog is at 80 columns"
        assert f"{first.name}  " in shown and second.name in shown
        (made,) = (line.split(maxsplit=1)[1] for line in shown.splitlines() if "made" in line)
        assert first.when in made and second.when in made, "of one recording, perhaps"
        await pilot.press("escape", "v")
        await until(pilot, lambda: isinstance(pilot.app.screen, Message), "no browser: where it is")
        assert str(second.page.name) in dialog_words(pilot)
        pages.append("from now on there is one")
        await pilot.press("escape", "v")
        await until(pilot, lambda: second.page.as_uri() in pages, "opened")
