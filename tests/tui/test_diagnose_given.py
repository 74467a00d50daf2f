"""Diagnose: the recordings and the model that are given."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import diagnosis_cases as cases
import numpy as np
import pytest
from steps import Until, alone, answer, text_of
from textual.widgets import DataTable, OptionList

from zendsp.physics import load_model
from zendsp.recording import Recording
from zendsp.tui.dialogs import Choose
from zendsp.tui.runs import DATA, Outcome, store_run


async def test_a_recording_of_another_folder_is_added_by_its_path(
    tmp_path: Path, until: Until
) -> None:
    run, _ = cases.bench(tmp_path)
    (tmp_path / "here").mkdir()
    async with alone(tmp_path / "here", until) as (pilot, screen):
        await pilot.press("a")
        await answer(pilot, str(run))
        await until(pilot, lambda: screen.chosen("fit") == [str(run)], "none lies here: its path")
        await pilot.press("a")
        await answer(pilot, str(run))
        assert screen.added == [str(run)], "it is there once"


@pytest.mark.long("test_files.py of journeys begins one; lost: by a key")
async def test_a_model_is_begun_from_the_recording_where_there_is_none(
    tmp_path: Path, until: Until
) -> None:
    run, model = cases.bench(tmp_path, seconds=2.0)
    model.unlink()
    async with alone(tmp_path, until) as (pilot, screen):
        screen.added, screen.roles = [str(run)], {str(run): "fit"}
        await pilot.press("s")
        await until(pilot, lambda: screen.said and not screen.busy, "it is begun")
        assert screen.model == str(model), "named like the recording"
        assert load_model(model).joints == 1
        assert screen.shown is None, "what is asked comes before a diagnosis"
        assert "Answer them in bench.toml" in text_of(screen, "#words")
        await pilot.press("m")
        await pilot.pause()
        assert isinstance(pilot.app.screen, Choose)
        await pilot.press("up", "enter")  # the last line: another one is begun
        await until(pilot, lambda: screen.model != str(model), "beside the first")
        assert Path(screen.model).name == "bench-2.toml"


async def test_the_model_of_another_machine_is_not_taken(tmp_path: Path, until: Until) -> None:
    (tmp_path / "mine.toml").write_text(cases.bench(tmp_path)[1].read_text())  # names itself bench
    recording = Recording.from_columns({"q": np.zeros(100)}, 1e-3, units={"q": "rad"})
    store_run(tmp_path / "runs", "other", replace(recording, machine="arm"))
    async with alone(tmp_path, until) as (pilot, screen):
        assert screen.model == ""
        await pilot.press("s")
        await pilot.pause()
        assert isinstance(pilot.app.screen, Choose), "one of another name may be meant: it is asked"
        await pilot.press("escape")
        store_run(tmp_path / "runs", "own", replace(recording, machine="bench"))
        screen.fill()
        assert Path(screen.model).parent == tmp_path


@pytest.mark.parametrize("models", [1, 2])
async def test_of_a_machine_that_is_not_known_yet_only_the_only_model_is_taken(
    models: int, tmp_path: Path, until: Until
) -> None:
    """In a clone the screen began before its target's machine was known, and kept emps.toml."""
    text = cases.bench(tmp_path)[1].read_text()
    if models > 1:
        (tmp_path / "another.toml").write_text(text)
    async with alone(tmp_path, until) as (_, screen):
        assert screen._machine() == ""
        assert (screen.model == "") is (models > 1)


async def test_the_model_follows_the_machine_that_was_recorded_until_one_is_chosen(
    tmp_path: Path, until: Until
) -> None:
    recording = Recording.from_columns({"q": np.zeros(100)}, 1e-3, units={"q": "rad"})
    store_run(tmp_path / "runs", "circle", replace(recording, machine="imi_planar"))
    async with alone(tmp_path, until) as (_, screen):
        assert Path(screen.model).name == "imi_planar.toml"
        store_run(tmp_path / "runs", "reach", replace(recording, machine="wam7"))
        screen.fill()
        assert Path(screen.model).name == "wam7.toml", "the other's would be refused"
        bode = replace(recording, machine="pendulum")
        store_run(tmp_path / "runs", "bode", bode, outcome=Outcome.RESPONSE)
        screen.fill()
        assert Path(screen.model).name == "wam7.toml", "of what is marked, not of the newest"
        screen._take_model(str(Path(screen.model).with_name("imi_planar.toml")))
        screen.fill()
        assert Path(screen.model).name == "imi_planar.toml", "as it was chosen"


@pytest.mark.covers("diagnose.use")
async def test_the_last_motion_is_marked_and_others_can_be_held_out(
    tmp_path: Path, until: Until
) -> None:
    recording = Recording.from_columns({"q": np.zeros(100)}, 1e-3, units={"q": "rad"})
    old = store_run(tmp_path / "runs", "old", recording)
    new = store_run(tmp_path / "runs", "new", replace(recording, note="2"))
    async with alone(tmp_path, until) as (pilot, screen):
        assert screen.chosen("fit") == [str(new.folder / DATA)]
        new = store_run(tmp_path / "runs", "newer", replace(recording, note="3"))
        screen.fill()
        assert screen.chosen("fit") == [str(new.folder / DATA)], "made after the screen was shown"
        bode = store_run(tmp_path / "runs", "bode", recording, outcome=Outcome.RESPONSE)
        screen.fill()
        assert screen.chosen("fit") == [str(new.folder / DATA)], "a small motion about one place"
        shutil.rmtree(bode.folder)
        screen.fill()
        screen.query_one("#recordings", DataTable).focus()
        await pilot.press("down", "down", "space", "space")
        assert screen.chosen("held out") == [str(old.folder / DATA)]
        await pilot.press("space", "up", "up", "space", "space")
        assert not screen.chosen("fit") and not screen.chosen("held out")
        screen.query_one("#findings", OptionList).focus()
        await pilot.press("space")
        assert not screen.chosen("fit"), "what is not in focus is not changed"


async def test_names_in_a_list_are_whole_also_when_drawn_at_once(
    tmp_path: Path, until: Until
) -> None:
    """The picture between the rows and Textual's next idle moment stayed: "benc" of bench.csv."""
    async with alone(tmp_path, until) as (pilot, screen):
        table = screen.query_one("#recordings", DataTable)
        screen.added = [str(tmp_path / "bench.csv")]
        screen.fill()
        assert "bench.csv" in table.render_line(1).text
        await pilot.pause()
        assert "bench.csv" in table.render_line(1).text


async def test_two_runs_of_one_name_are_told_apart_by_their_seconds(
    tmp_path: Path, until: Until
) -> None:
    recording = Recording.from_columns({"q": np.zeros(100)}, 1e-3, units={"q": "rad"})
    for second in (1.0, 2.0):  # of the same minute
        run = store_run(tmp_path / "runs", "pd", recording)
        card = run.folder / "run.json"
        card.write_text(json.dumps(json.loads(card.read_text()) | {"created": second}))
    async with alone(tmp_path, until) as (_, screen):
        table = screen.query_one("#recordings", DataTable)
        times = {str(table.get_row_at(k)[2]) for k in range(2)}
        assert len(times) == 2, times
