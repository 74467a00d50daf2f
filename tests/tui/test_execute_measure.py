"""Execute: frequency responses and sweeps, by keys and mouse, as from the command line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from steps import Step, Until, nobody, opened
from textual.app import App, ComposeResult
from textual.geometry import Region
from textual.widgets import Button, DataTable, Input, Static

from zendsp.errors import LinkError, Refused
from zendsp.experiment import FrequencyResponse
from zendsp.link import Target
from zendsp.tui.app import ZendspApp
from zendsp.tui.dialogs import Form
from zendsp.tui.measure_job import MeasureJob
from zendsp.tui.panels.response import ResponseView
from zendsp.tui.panels.sweep import SweepView
from zendsp.tui.runs import Outcome, list_runs
from zendsp.tui.scope.path import PathPlot
from zendsp.tui.screens.console import ConsoleScreen
from zendsp.tui.screens.diagnose import DiagnoseScreen
from zendsp.tui.screens.execute import ExecuteScreen
from zendsp.tui.session import Session
from zendsp.tui.snapshot import Snapshot


def _type(app: ZendspApp, **values: str) -> None:
    for key, value in values.items():
        app.screen.query_one(f"#f-{key}", Input).value = value


LARGE = pytest.param((160, 45), marks=pytest.mark.long("a smaller terminal has less room"))


@pytest.mark.parametrize("size", [LARGE, (80, 24)])
async def test_no_button_moves_under_the_mouse(
    lab: ZendspApp, target: Target, built: Step, until: Until, size: tuple[int, int]
) -> None:
    def places() -> dict[str | None, Region]:
        return {b.id: b.region for b in lab.screen.query(Button)}

    async with lab.run_test(size=size) as pilot:
        await built(lab, pilot)
        for kind in (ExecuteScreen, DiagnoseScreen, ConsoleScreen):  # each has been there before
            await opened(lab, pilot, until, kind)
            await pilot.pause(3 * lab.frame_s)
        for key in ("f3", "f2", "f5", "f3"):
            screen = lab.screen
            await pilot.press(key)
            await until(pilot, lambda screen=screen: lab.screen is not screen, "another screen")  # type: ignore[misc]
            first = places()
            await pilot.pause(3 * lab.frame_s)
            assert places() == first, key


@pytest.mark.long("tests/experiment measures it; lost: kept and drawn in the terminal")
@pytest.mark.covers("execute.respond")
async def test_a_frequency_response_is_measured_kept_and_laid_over_another(
    lab: ZendspApp, target: Target, built: Step, until: Until
) -> None:
    async with lab.run_test(size=(160, 45)) as pilot:
        await built(lab, pilot)
        screen = await opened(lab, pilot, until, ExecuteScreen)
        await pilot.press("f")
        await until(pilot, lambda: isinstance(lab.screen, Form), "it asks")
        _type(lab, f_min="2", f_max="1", periods="2", amplitude="0.01")
        await pilot.press("enter")
        # a band that cannot be is refused in words, and nothing is kept
        await until(
            pilot,
            lambda: any("f_min below f_max" in e.text for e in lab.session.events.since(0)[1]),
            "the refusal is shown",
        )
        await until(pilot, lambda: screen.job is None, "over")
        assert not list_runs(lab.workspace.runs)
        stays = str(screen.query_one("#progress", Static).render())
        assert "f_min below f_max" in stays

        for gain, name in ((2000.0, "stiff"), (200.0, "soft")):
            await until(pilot, lambda: screen.job is None, "free")
            target.update(Kp1=gain)
            assert await pilot.click("#run-bode")
            await until(pilot, lambda: isinstance(lab.screen, Form), "the mouse asks too")
            assert lab.screen.query_one("#f-f_min", Input).value == "2.0", "what was typed last"
            _type(lab, f_max="40")
            await pilot.press("enter")
            await until(
                pilot, lambda: screen.job is None and screen.marked_runs, f"{name} is measured"
            )
            marked, screen.marked_runs = screen.marked_runs, []
        runs = list_runs(lab.workspace.runs)
        assert [r.outcome for r in runs] == [Outcome.RESPONSE] * 2
        assert {"e[0]", "tau[0]", "q[1]"} <= set(runs[0].recording().columns), "to be diagnosed"
        assert (runs[0].folder / "response.csv").read_text().startswith("f,magnitude_db,")
        soft, stiff = (FrequencyResponse.of(r.recording()) for r in runs)
        assert soft is not None and stiff is not None
        assert soft.magnitude_db[0] < stiff.magnitude_db[0] - 1.0, "friction holds the soft loop"
        screen.marked_runs = [r.folder for r in runs]
        screen.preview()
        view = screen.query_one(ResponseView)
        assert view.display and not screen.query_one("#run-preview").display
        magnitude = screen.query_one("#magnitude", PathPlot).curves
        assert len(magnitude) == 4 and len({c.trace for c in magnitude}) == 2
        assert np.allclose(magnitude[0].xy[:, 1], soft.magnitude_db)
        assert "−3 dB at" in str(screen.query_one("#response-words", Static).render())
        assert marked == [runs[0].folder]


@pytest.mark.long("tests/experiment sweeps; lost: its table in the terminal")
@pytest.mark.covers("execute.sweep")
async def test_a_sweep_shows_a_table_and_a_row_writes_its_values(
    lab: ZendspApp, target: Target, built: Step, until: Until, folder: Path
) -> None:
    async with lab.run_test(size=(160, 45)) as pilot:
        await built(lab, pilot)
        screen = await opened(lab, pilot, until, ExecuteScreen)
        await pilot.press("p")
        await pilot.pause()
        assert not isinstance(lab.screen, Form), "of a program that does not run there is none"
        await pilot.press("f2", "s")
        await until(pilot, lambda: lab.session.snapshot.state == "running", "it runs")
        await opened(lab, pilot, until, ExecuteScreen)
        assert await pilot.click("#run-sweep-button")
        await until(pilot, lambda: isinstance(lab.screen, Form), "the mouse asks")
        _type(lab, words="Kp1=1500")
        await pilot.pause()
        _type(lab, words="Kp1 1500")
        await until(
            pilot,
            lambda: "NAME=VALUES" in str(lab.screen.query_one("#problem", Static).render()),
            "what is typed is checked",
        )
        for typed, why in (
            ("Kp9=1,2", "the program has no Kp9: it has "),
            ("", "for example Kp1=1000:4000:4"),  # of this program
        ):
            _type(lab, words=typed)
            await until(
                pilot,
                lambda why=why: why in str(lab.screen.query_one("#problem", Static).render()),  # type: ignore[misc]
                why,
            )
        _type(lab, words="Kp1=500,2000 Kd1=120", channels="e1", seconds="1", settle="0")
        await pilot.press("enter")
        view = screen.query_one(SweepView)
        await until(pilot, lambda: screen.job is None and view.sweep is not None, "measured")
        assert view.display and view.sweep is not None
        assert [r["Kp1"] for r in view.sweep.rows] == [500.0, 2000.0]
        assert target["Kp1"] == 2000.0, "put back"
        table = screen.query_one("#sweep", DataTable)
        await until(pilot, lambda: table.has_focus, "the arrows choose a row")
        assert table.cursor_row == view.sweep.best_row()
        (kept,) = (folder / "sweeps").glob("*-Kp1-Kd1.csv")
        assert kept.read_text().startswith("Kp1,Kd1,rms e1,max e1,ended")
        table.move_cursor(row=0)
        await pilot.press("enter")
        await until(pilot, lambda: target["Kp1"] == 500.0, "the row's values are written")
        assert await pilot.click(table, offset=(6, 2))
        await until(pilot, lambda: table.cursor_row == 1, "a click marks")
        assert target["Kp1"] == 500.0, "and writes nothing yet"
        assert await pilot.click(table, offset=(6, 2))
        await until(pilot, lambda: target["Kp1"] == 2000.0, "a click on the marked row writes")


@pytest.mark.parametrize(("width", "rows"), [(80, 1), (160, 3)])
async def test_why_a_measurement_failed_leaves_room_for_what_start_needs(
    lab: ZendspApp, until: Until, width: int, rows: int
) -> None:
    async with lab.run_test(size=(width, 24)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.link == "up", "link")
        screen = await opened(lab, pilot, until, ExecuteScreen)

        def refuse(port: object, tell: object) -> None:
            raise Refused("the twin was stopped: " + 12 * "a long reason ")

        screen.job = MeasureJob(lab.session, "sweep", refuse, lambda found: found)  # type: ignore[arg-type]
        screen.job.start()
        shown = screen.query_one("#progress", Static)
        await until(pilot, lambda: "the twin was stopped" in str(shown.render()), "why")
        await until(pilot, lambda: shown.size.height >= rows, "its height")
        assert (shown.size.height == 1) == (rows == 1)


@pytest.mark.long("test_execute.py aborts a run; lost: a measurement")
async def test_a_measurement_can_be_aborted(
    lab: ZendspApp, target: Target, built: Step, until: Until, folder: Path
) -> None:
    async with lab.run_test(size=(80, 24)) as pilot:
        await built(lab, pilot)
        await pilot.press("s")
        await until(pilot, lambda: lab.session.snapshot.state == "running", "it runs")
        screen = await opened(lab, pilot, until, ExecuteScreen)
        await pilot.press("p")
        await until(pilot, lambda: isinstance(lab.screen, Form), "it asks")
        _type(lab, words="Kp1=700", channels="e1", seconds="3000")
        await pilot.press("enter")
        await until(pilot, lambda: isinstance(screen.job, MeasureJob), "it measures")
        await until(pilot, lambda: target["Kp1"] == 700.0, "the value is tried")
        await pilot.press("b")
        await until(pilot, lambda: screen.job is None, "it ends")
        assert target["Kp1"] == 2000.0, "as it was before"
        assert any("aborted" in e.text for e in lab.session.events.since(0)[1])
        assert not (folder / "sweeps").exists()

        await pilot.press("p")
        await until(pilot, lambda: isinstance(lab.screen, Form), "it asks")
        _type(lab, words="Kp1=700:800:1000", channels="e1", seconds="10")
        await pilot.press("enter")
        await until(pilot, lambda: screen.job is not None and screen.job.reached, "one run is done")
        await pilot.press("b")
        await until(pilot, lambda: screen.job is None, "it ends")
        view = screen.query_one(SweepView)
        assert view.display and view.sweep is not None and 0 < len(view.sweep.rows) < 1000
        (kept,) = (folder / "sweeps").glob("*-Kp1.csv")
        assert len(kept.read_text().splitlines()) == 1 + len(view.sweep.rows)


@pytest.mark.parametrize("reached", [None, "one row"])
def test_what_was_measured_until_the_link_was_lost_is_kept_and_the_loss_is_named(
    reached: str | None,
) -> None:
    """The reason is not that the terminal itself closed the connection."""
    session = Session(nobody)
    session.snapshot = Snapshot(link="lost")
    session.require = lambda: None  # type: ignore[method-assign, return-value, assignment]

    def measure(port: object, tell: Callable[[float], None]) -> str:
        tell(0.4)
        job.reached = reached
        raise LinkError("the connection to 'imi' is closed")

    job = MeasureJob(session, "sweep", measure, lambda found: f"kept {found}")  # type: ignore[arg-type]
    job.start()
    error = job.result.exception(10.0)
    assert str(error).startswith("the link was lost before it was done, at 40 %")
    assert job.left == (None if reached is None else "kept one row")
    assert ("is kept" in str(error)) == (reached is not None) == ("is kept" in job.progress.why)


class _Words(App[None]):
    def compose(self) -> ComposeResult:
        yield ResponseView()


@pytest.mark.parametrize(("height", "cut"), [(14, True), (36, False)])
async def test_text_about_a_response_is_cut_only_where_there_is_no_room(
    height: int, cut: bool
) -> None:
    app = _Words()
    async with app.run_test(size=(58, height)) as pilot:
        view = app.query_one(ResponseView)
        view._words = "not linear: measure at two amplitudes " * 6
        view._say()
        await pilot.pause()
        assert ("…" in str(app.query_one("#response-words", Static).render())) == cut
