"""Execute: every action of its table, and that a stored run holds all that is needed to repeat it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from steps import Step, Until, opened, short_run, slow_circle
from textual.widgets import Button, Input, OptionList
from waiting import PATIENCE_S
from waiting import until as wait_for

from zendsp.link import Target, local
from zendsp.reference import load_machine, load_reference, make_reference, save_reference
from zendsp.tui.app import ZendspApp
from zendsp.tui.dialogs import Choose, Form
from zendsp.tui.events import EventLog
from zendsp.tui.link_port import LinkPort, open_port
from zendsp.tui.play_job import PlayJob
from zendsp.tui.playing import Setup
from zendsp.tui.runs import list_runs
from zendsp.tui.scope import Scope
from zendsp.tui.screens.execute import ExecuteScreen

FAST = 3.0  # rad/s of joint 1; the way there goes at half of it, the motion at 4.35


def _unmet(screen: ExecuteScreen) -> list[str]:
    return [c.text for c in screen.conditions if not c.met]


def _conditions(screen: ExecuteScreen) -> str:
    return "\n".join(f"{'+' if c.met else '-'} {c.text}: {c.advice}" for c in screen.conditions)


async def test_the_trial_is_shown_before_start(
    lab: ZendspApp, target: Target, enabled: Step, until: Until, folder: Path
) -> None:
    hasty = folder / "references" / "hasty.mat"
    save_reference(make_reference("point_to_point", "imi_planar", duration=0, headroom=1.0), hasty)
    gentle = folder / "references" / "gentle.mat"
    save_reference(make_reference("point_to_point", "imi_planar"), gentle)
    async with lab.run_test(size=(160, 50)) as pilot:
        await enabled(lab, pilot)
        screen = await opened(lab, pilot, until, ExecuteScreen)
        lab.chosen = (gentle,)
        await until(
            pilot, lambda: "tried on a simulated twin" in _unmet(screen),
            "Start waits for the trial",
        )
        before = target.status().tick
        await until(pilot, lambda: screen.references and not _unmet(screen), "tried")
        shown = _conditions(screen)
        assert "+ no limit is passed in the simulation" in shown
        assert "of 245 N m (joint " in shown and "rad/s (joint " in shown and " %)" in shown, shown
        await pilot.press("s")
        await until(
            pilot,
            lambda: screen.job is not None
            and screen.job.progress.phase not in ("starting", "simulating"),
            "it starts",
        )
        events = [e.text for e in lab.session.events.since(0)[1]]
        assert any("no limit is passed in the simulation" in text for text in events)
        await until(pilot, lambda: screen.runs and screen.job is None, "played")
        assert target.status().tick > before

        lab.chosen = (hasty,)
        await until(
            pilot, lambda: "no limit is passed" in _unmet(screen),
            "what would trip is said before Start",
        )
        assert "in the simulation" in _conditions(screen) and "plan it slower" in _conditions(
            screen
        )
        assert screen.query_one("#run-start", Button).disabled
        tick = target.status().tick
        await pilot.press("s")
        await pilot.pause()
        assert screen.job is None and target.status().tick == tick, "and Start does nothing"

        lab.session.do("gain", lambda port: port.update({"Kp1": 1200.0}))
        await until(
            pilot, lambda: "tried on a simulated twin" in _unmet(screen),
            "another gain is another run",
        )


@pytest.mark.covers(
    "execute.choose", "execute.start", "execute.overlay", "execute.cyclic", "execute.settings",
    "execute.note",
)
async def test_a_reference_is_played_and_the_run_can_be_repeated(
    lab: ZendspApp, target: Target, enabled: Step, until: Until, folder: Path
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await enabled(lab, pilot)
        screen = await opened(lab, pilot, until, ExecuteScreen)
        await until(pilot, lambda: screen.conditions, "preflight is looked at")
        assert _unmet(screen) == ["reference chosen"]
        assert screen.query_one("#run-start", Button).disabled
        await pilot.press("o")
        await pilot.pause()
        assert isinstance(lab.screen, Choose)
        await pilot.press("enter")
        await until(
            pilot, lambda: screen.references and not _unmet(screen), "every condition is met"
        )
        await until(
            pilot, lambda: not screen.query_one("#run-start", Button).disabled, "Start is enabled"
        )
        assert screen.query_one("#run-preview", Scope).limits["rad"] == [-2.15, 2.15]

        await pilot.press("n")
        await pilot.pause()
        lab.screen.query_one("#f-name", Input).value = "first circle"
        lab.screen.query_one("#f-note", Input).value = "gains as shipped [N m/rad]"
        await pilot.press("enter")
        await pilot.press("c")
        await pilot.pause()
        assert isinstance(lab.screen, Form)
        lab.screen.query_one(Input).value = "2"
        await pilot.press("enter")
        await pilot.press("a")
        await pilot.pause()
        lab.screen.query_one("#f-channels", Input).value = "q e tau r1 r2"
        lab.screen.query_one("#f-decimation", Input).value = "2"
        lab.screen.query_one("#f-decimation", Input).focus()
        await pilot.press("enter")
        await pilot.pause()
        assert screen.setup == replace(
            Setup(), cycles=2, channels=("q", "e", "tau", "r1", "r2"), decimation=2,
            name="first circle", note="gains as shipped [N m/rad]",
        )
        await until(
            pilot, lambda: all(c.met for c in screen.look(lab.session.snapshot)),
            "tried with two cycles",
        )
        await pilot.press("s")
        await until(pilot, lambda: screen.job is not None, "the run begins")
        await until(pilot, lambda: list_runs(folder / "runs"), "the run is stored")
        await until(pilot, lambda: screen.runs, "and listed")
        run = list_runs(folder / "runs")[0]
        assert run.outcome == "complete" and run.name == "first circle" and run.lost == 0

        # everything to repeat it: data, parameters, source, flags, reference, note
        recording = run.recording()
        planned = load_reference(run.folder / "reference.mat")
        assert recording.note == "gains as shipped [N m/rad]"
        assert (
            recording.parameters["Kp1"] == 2000.0
            and "pd.c" in recording.sources
            and recording.flags
        )
        assert (run.folder / "pd.c").read_text() == (folder / "pd.c").read_text()
        assert len(recording) == pytest.approx(2 * planned.samples / 2, abs=3)
        # what the program followed is what was planned: two turns, rows interpolated on the target
        two = np.vstack((planned.q, planned.q))[::2]
        n = min(len(two), len(recording))
        away = np.abs(np.stack((recording["r1"], recording["r2"]), axis=1)[:n] - two[:n]).max()
        assert away < 3e-3  # one sample of shift at 1.4 rad/s is 1.4e-3 rad
        assert run.errors and max(run.errors.values()) < 0.1
        said = next(e.text for e in lab.session.events.since(0)[1] if "run complete" in e.text)
        assert all(f"{name} {value:.3g} rad" in said for name, value in run.errors.items())

        await pilot.press("space")
        await pilot.pause()
        assert screen.marked_runs == [run.folder]
        names = [c.name for c in screen.query_one("#run-preview", Scope).channels]
        assert names == ["first circle e[0]", "first circle e[1]"]
        await pilot.press("space", "c")
        await pilot.pause()
        assert screen.marked_runs == [] and screen.setup.cycles == 1
        assert target.status().state == "paused", "the fast clock ends with the run"


@pytest.mark.long("two joints begin there in the tests beside it; lost: seven")
async def test_a_run_of_seven_joints_begins_where_the_arm_stands(
    until: Until, tmp_path: Path
) -> None:
    # the arm stands at (0, −1.9, 0, 3, …) rad; the program's own q is still 0 before its first
    # sample
    machine = load_machine("wam7")
    (tmp_path / "references").mkdir()
    path = save_reference(
        make_reference("lspb", machine, duration=2.0), tmp_path / "references" / "lspb.mat"
    )
    with local("wam7", clock="fast", options=["--speed", "20"]) as target:
        app = ZendspApp(open_port, target=target.name, folder=tmp_path, frames=4.0)
        app.source = next(p for p in app.examples() if p.name == "wam_pd_gravity.c")
        async with app.run_test(size=(100, 30)) as pilot:
            await until(pilot, lambda: app.session.snapshot.link == "up", "link")
            await pilot.press("b")
            await until(
                pilot,
                lambda: app.session.snapshot.state == "loaded" and app.session.snapshot.variables,
                "built with motion.h beside it",
            )
            await pilot.press("o")
            await until(pilot, lambda: app.session.snapshot.drive == "homed", "powered")
            await pilot.press("e")
            await until(pilot, lambda: app.session.snapshot.drive == "enabled", "enabled")
            assert app.session.snapshot.position[1] == pytest.approx(-1.9, abs=1e-3)
            screen = await opened(app, pilot, until, ExecuteScreen)
            app.chosen = (path,)
            await until(pilot, lambda: screen.references and not _unmet(screen), "ready")
            await pilot.press("s")
            await until(pilot, lambda: screen.runs, "the run is stored")
            assert screen.runs[0].outcome == "complete"
            first = target.acquire_load()
            assert np.abs(first["r"][0] - first["q"][0]).max() < 1e-2, "no jump at the start"
            assert np.abs(np.diff(first["r"], axis=0)).max() * 1000.0 < machine.limits.speed.max()


async def test_references_that_lie_here_are_listed_and_others_are_chosen_by_their_path(
    app: ZendspApp, until: Until, tmp_path: Path
) -> None:
    """`zendsp reference --out motion.mat` saves where one stands, not in references/."""
    circle = make_reference("circle", "imi_planar")
    here = save_reference(circle, tmp_path / "motion.mat")
    path = save_reference(circle, tmp_path / "far" / "away" / "motion.mat")
    short_run(1.0).save(tmp_path / "recording.mat")
    async with app.run_test(size=(80, 24)) as pilot:
        screen = await opened(app, pilot, until, ExecuteScreen)
        await pilot.press("o")
        await pilot.pause()
        assert isinstance(app.screen, Choose)
        rows = app.screen.query_one(OptionList)
        assert [row.id for row in rows.options] == [str(here), ""], "a recording is no reference"
        await pilot.press("down", "enter")
        await pilot.pause()
        app.screen.query_one("#f-path", Input).value = str(path)
        await pilot.press("enter")
        await until(pilot, lambda: screen.references, "it is loaded")
        assert app.chosen == (path,)


@pytest.mark.covers("execute.abort")
async def test_abort_keeps_what_was_acquired(
    lab: ZendspApp, target: Target, enabled: Step, until: Until, folder: Path
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await enabled(lab, pilot)
        screen = await slow_circle(lab, pilot, until, folder)
        await pilot.press("b")
        await until(pilot, lambda: screen.job is None and screen.runs, "it ends and is stored")
        run = screen.runs[0]
        assert run.outcome == "aborted" and 0 < run.rows < 40_000
        assert target.status().trip is None, "an abort is no STOP"


def test_an_abort_in_the_middle_of_a_fast_motion_is_no_trip(tmp_path: Path) -> None:
    # with the shortest motion within the limits: a reference that stood still at once
    # would ask for 315 N m of 245
    found = SimpleNamespace(trip=None, simulated=True, good=True, text="as planned")
    with local("imi_planar", clock="real") as target:
        target.download("pd.c")
        target.enable()
        port = LinkPort(target)
        port.snapshot()
        job = PlayJob(
            SimpleNamespace(require=lambda: port, events=EventLog()),
            [make_reference("point_to_point", "imi_planar", duration=0)], [],
            load_machine("imi_planar"),
            Setup(), tmp_path, {}, SimpleNamespace(found=lambda plan: found),  # type: ignore[arg-type]
        )  # fmt: skip
        job.start()
        wait_for(lambda: not job.busy or np.abs(target["qd1"]) > FAST, "full speed")
        job.abort()
        run = job.result.result(PATIENCE_S)
        status = target.status()
        assert run is not None and run.outcome == "aborted", "and its rows are kept"
        assert status.trip is None and status.state == "paused"
        assert not target["hold"], "the next start moves"


async def test_start_stays_disabled_and_says_why(
    lab: ZendspApp, until: Until, folder: Path
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await until(pilot, lambda: lab.session.snapshot.link == "up", "link")
        screen = await opened(lab, pilot, until, ExecuteScreen)
        lab.chosen = (folder / "references" / "circle.mat",)
        await until(pilot, lambda: "program loaded" in _unmet(screen), "no program yet")
        assert screen.query_one("#run-start", Button).disabled
        await pilot.press("s")
        await pilot.pause()
        assert screen.job is None
        text = str(screen.query_one("#preflight").render())
        assert "program loaded: build one on Console" in text
        # the drives would go on by themselves (automatic), but Execute wants them enabled on
        # purpose
        assert "drives enabled" in _unmet(screen)


async def test_a_motion_that_trips_in_its_rehearsal_moves_nothing(
    lab: ZendspApp, target: Target, enabled: Step, until: Until, folder: Path
) -> None:
    hasty = make_reference("point_to_point", "imi_planar", duration=0.0, headroom=1.0)
    save_reference(hasty, folder / "references" / "circle.mat")
    async with lab.run_test(size=(100, 30)) as pilot:
        await enabled(lab, pilot)
        await pilot.press("s")  # while a program runs, the trial is made by Start
        await until(pilot, lambda: lab.session.snapshot.state == "running", "it runs")
        screen = await opened(lab, pilot, until, ExecuteScreen)
        lab.chosen = (folder / "references" / "circle.mat",)
        await until(
            pilot, lambda: screen.references and not _unmet(screen), "every condition is met"
        )
        await pilot.press("s")
        await until(
            pilot,
            lambda: any("nothing was moved" in e.text for e in lab.session.events.since(0)[1]),
            "the run is refused",
        )
        status = target.status()
        assert status.state == "paused" and status.trip is None and not target["use_table"]
        assert not list_runs(folder / "runs")
