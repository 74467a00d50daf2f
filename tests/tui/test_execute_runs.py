"""Execute: the list of runs, and what is done with a stored run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from steps import Until, opened, short_run
from textual.widgets import DataTable, Input

from zendsp.cli.progress import stages
from zendsp.recording import Recording
from zendsp.tui.app import ZendspApp
from zendsp.tui.dialogs import Form, Message
from zendsp.tui.runs import Outcome, list_runs, store_run
from zendsp.tui.scope import Scope
from zendsp.tui.screens.analysis import ProcessView, simulation_of
from zendsp.tui.screens.diagnose import DiagnoseScreen
from zendsp.tui.screens.execute import ExecuteScreen


@pytest.mark.long("tests beside it make and show runs; lost: what the keys of the list do")
@pytest.mark.covers(
    "execute.rename", "execute.compare", "execute.export", "execute.delete", "execute.simulate",
    "execute.diagnose",
)
async def test_the_list_of_runs(lab: ZendspApp, until: Until, folder: Path) -> None:
    for name, gain in (("soft", 100.0), ("stiff", 400.0)):
        store_run(
            folder / "runs",
            name,
            short_run(gain),
            references=[folder / "references" / "circle.mat"],
            sources={"pd.c": "int a;"},
        )
    async with lab.run_test(size=(100, 30)) as pilot:
        screen = await opened(lab, pilot, until, ExecuteScreen)
        await until(pilot, lambda: len(screen.runs) == 2, "two runs")
        screen.runs_table.focus()
        await pilot.press("d")
        await pilot.pause()
        assert lab.screen is screen, "nothing to compare yet"
        await pilot.press("space", "down", "space")
        await pilot.pause()
        assert len(screen.marked_runs) == 2
        assert len(screen.query_one("#run-preview", Scope).channels) == 4
        await pilot.press("d")
        await pilot.pause()
        assert isinstance(lab.screen, Message)
        shown = str(lab.screen.query_one(".words").render())
        assert "rms e[0]" in shown and "Kp1" in shown and "source of" in shown
        await pilot.press("escape", "r")
        await pilot.pause()
        lab.screen.query_one(Input).value = "renamed [rad]"
        await pilot.press("enter")
        await until(pilot, lambda: "renamed [rad]" in [r.name for r in screen.runs], "renamed")
        for suffix in (".mat", ".csv"):
            await pilot.press("x")
            await pilot.pause()
            lab.screen.query_one("#f-suffix").value = suffix  # type: ignore[attr-defined]
            lab.screen.query_one("#f-path", Input).value = str(folder / "out" / "run")
            lab.screen.query_one("#f-path", Input).focus()
            await pilot.press("enter")
            await until(pilot, lambda suffix=suffix: (folder / "out" / f"run{suffix}").is_file(),
                f"exported {suffix}")  # type: ignore[misc]
            assert np.allclose(
                Recording.load(folder / "out" / f"run{suffix}")["e"], short_run(1.0)["e"]
            )
        (folder / "arm.toml").write_text('name = "arm"\n')
        await pilot.press("S")
        await pilot.pause()
        assert isinstance(lab.screen, Form)
        lab.screen.query_one(Input).value = str(folder / "arm.toml")
        await pilot.pause()
        await pilot.press("enter")
        await pilot.pause()
        assert isinstance(lab.screen, ProcessView)
        await pilot.press("escape")
        await pilot.pause()
        meant = screen.this_run()
        assert meant is not None
        await pilot.press("D")
        await until(pilot, lambda: isinstance(lab.screen, DiagnoseScreen), "Diagnose is shown")
        assert isinstance(lab.screen, DiagnoseScreen)
        assert lab.screen.chosen("fit") == [str(meant.folder / "recording.mat")]
        await opened(lab, pilot, until, ExecuteScreen)
        await pilot.press("delete")
        await pilot.pause()
        await pilot.press("enter")
        await until(pilot, lambda: len(screen.runs) == 1, "gone from the list")
        assert len(list((folder / "runs" / ".trash").iterdir())) == 1, "but not deleted"


def test_simulate_this_repeats_the_run_and_keeps_the_result_beside_it(folder: Path) -> None:
    circle = folder / "references" / "circle.mat"
    taken = replace(
        short_run(300.0),
        parameters={
            "Kp1": 300.0, "hold": False, "Kp": [1.0, 2.0], "use_table": True, "row_rate": 1000,
        },
    )
    run = store_run(
        folder / "runs", "circle", taken, references=[circle], sources={"pd.c": "int a;"}
    )
    words, keep = simulation_of(run, folder / "runs")
    pairs = [words[k + 1] for k, word in enumerate(words) if word == "--set"]
    assert pairs == [
        "Kp1=300.0", "hold=false", "Kp=[1.0, 2.0]",
    ], "what the reference sets by itself is left to it"
    assert words[words.index("--channels") + 1] == "q,e" and words[-2:] == [
        "--reference", str(run.folder / "reference.mat"),
    ]
    t = np.arange(900) * 1e-3
    simulated = Recording.from_columns(
        {"q": t, "e": 0.0 * t}, 1e-3, parameters={"approach_time": 0.2}, machine="imi_planar"
    )
    assert keep() == "", "of a program that was not simulated there is nothing to keep"
    simulated.save(Path(words[words.index("--out") + 1]))
    assert "circle simulated" in keep()
    newest = list_runs(folder / "runs")[0]
    assert newest.outcome == Outcome.SIMULATED and len(newest.recording()) == len(taken)
    assert newest.recording()["q"][0] == pytest.approx(
        0.2
    ), "from the first row of the reference on, as in the run"


def test_a_process_that_is_watched_says_each_stage_as_a_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ZENDSP_PROGRESS", "lines")
    for quiet, seen in ((False, "fitting\nwriting\n"), (True, "")):
        with stages(quiet=quiet) as tell:
            tell("fitting")
            tell("writing")
        assert capsys.readouterr().err == seen


async def test_of_seven_joints_the_worst_is_listed_and_drawn_and_all_are_told(
    lab: ZendspApp, until: Until
) -> None:
    size = {3: 0.02, 5: 0.03}
    errors = {f"e[{k}]": np.full(50, size.get(k, 0.001)) for k in range(7)}
    made = Recording.from_columns(errors, 1e-3, units=dict.fromkeys(errors, "rad"))
    store_run(lab.workspace.runs, "reach", made)
    async with lab.run_test(size=(120, 36)) as pilot:
        await pilot.press("f3")
        screen = lab.screen
        await until(pilot, lambda: screen.query_one("#runs", DataTable).row_count, "listed")
        row = screen.query_one("#runs", DataTable).get_row_at(0)
        assert "0.03 rad e[5]" in [str(cell) for cell in row]
        told = str(screen.query_one("#progress").render())  # of the marked run
        assert all(f"e[{k}] {size.get(k, 0.001):g} rad" in told for k in range(7)), told
        await pilot.press("space")
        await pilot.pause()
        names = [c.name for c in screen.query_one("#run-preview", Scope).channels]
        assert names == ["reach e[3]", "reach e[5]"]
