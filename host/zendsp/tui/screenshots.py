"""Pictures of the screens for the README, made by ``zendsp tui --screenshots DIR`` from a real
target in its own process.
"""

from __future__ import annotations

import asyncio
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from textual.pilot import Pilot
from textual.widgets import Input

from zendsp.reference import make_reference, save_reference
from zendsp.tui.app import ZendspApp
from zendsp.tui.link_port import open_port, start_machine
from zendsp.tui.scope.spectrum import ready
from zendsp.tui.screens.execute import ExecuteScreen
from zendsp.tui.snapshot import LinkState
from zendsp.tui.svg import portable
from zendsp_protocol.states import DriveState, ProgramState

PATIENCE_S = 180.0  # for a diagnosis on a busy machine


async def _until(pilot: Pilot[None], condition: Callable[[], bool]) -> None:
    """Wait for a condition; a busy computer may take long."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > deadline:
            app = pilot.app
            said = (
                [e.text for e in app.session.events.since(0)[1][-6:]]
                if isinstance(app, ZendspApp)
                else []
            )
            raise TimeoutError(
                "a screen did not come to the state that its picture needs; the last events:"
                f" {said}"
            )
        await pilot.pause(0.05)


async def _keys(pilot: Pilot[None], *keys: str) -> None:
    for key in keys:
        await pilot.press(key)
        await pilot.pause(0.3)


def _app(work: Path, first: str) -> ZendspApp:
    app = ZendspApp(
        open_port, start_machine=start_machine, machines=("imi_planar",), folder=work, first=first,
        begin="imi_planar",
    )
    app.source = next(p for p in app.examples() if p.name == "pd.c")
    return app


async def _enabled(app: ZendspApp, pilot: Pilot[None]) -> None:
    """Build the program, switch the power on, enable."""
    await _until(pilot, lambda: app.session.snapshot.link == LinkState.UP)
    await pilot.press("b")
    await _until(
        pilot,
        lambda: (
            app.session.snapshot.state == ProgramState.LOADED
            and bool(app.session.snapshot.variables)
        ),
    )
    await _keys(pilot, "o", "e")
    await _until(pilot, lambda: app.session.snapshot.drive == DriveState.ENABLED)


async def _console(folder: Path, work: Path, size: tuple[int, int], name: str) -> list[Path]:
    app, made = _app(work, "console"), []
    async with app.run_test(size=size) as pilot:
        await _enabled(app, pilot)
        await pilot.press("s")
        await _until(pilot, lambda: app.session.snapshot.t > 6.0)
        made.append(_write(app, folder / f"{name}.svg"))
        if size[0] > 100:
            await _keys(pilot, "x", "t", "5", "0", "0", "enter", "u")
            made.append(_write(app, folder / "console-update.svg"))
            await _keys(pilot, "escape", "x", "k")
            made.append(_write(app, folder / "console-sliders.svg"))
            await _keys(pilot, "escape", "V", "V")
            await _until(pilot, ready)
            await pilot.pause(0.5)
            made.append(_write(app, folder / "console-spectrum.svg"))
            await _keys(pilot, "V", "f9")
            await _until(pilot, lambda: app.session.snapshot.drive == DriveState.STOPPED)
            await pilot.pause(0.5)
            made.append(_write(app, folder / "console-stop.svg"))
    return made


async def _execute(folder: Path, work: Path) -> list[Path]:
    app, made = _app(work, "console"), []
    async with app.run_test(size=(160, 48)) as pilot:
        await _enabled(app, pilot)
        app.chosen = (work / "references" / "circle.mat",)
        await _keys(pilot, "f3")
        await pilot.pause(1.0)
        screen = app.screen
        assert isinstance(screen, ExecuteScreen)
        await _until(
            pilot, lambda: bool(screen.references) and all(c.met for c in screen.conditions)
        )
        await _keys(pilot, "s")
        await _until(pilot, lambda: app.session.snapshot.t > 4.0)
        made.append(_write(app, folder / "execute.svg"))
        await _until(pilot, lambda: bool(screen.runs))
        await pilot.pause(1.0)
        await _keys(pilot, "space")
        made.append(_write(app, folder / "execute-runs.svg"))
        await _measure(app, pilot, "f", f_min="1", periods="3")
        made.append(_write(app, folder / "execute-bode.svg"))
    return made


async def _measure(app: ZendspApp, pilot: Pilot[None], key: str, **values: str) -> None:
    """Fill in the form of a measurement, and wait for its end."""
    await _keys(pilot, key)
    for name, value in values.items():
        app.screen.query_one(f"#f-{name}", Input).value = value
    await _keys(pilot, "enter")
    screen = app.screen
    assert isinstance(screen, ExecuteScreen)
    await _until(pilot, lambda: screen.job is None)
    await pilot.pause(0.5)


async def _reference(folder: Path, work: Path) -> list[Path]:
    from zendsp.tui.screens.reference import ReferenceScreen

    made = []
    app = ZendspApp(open_port, folder=work, first="reference")
    async with app.run_test(size=(160, 48)) as pilot:
        screen = app.screen
        assert isinstance(screen, ReferenceScreen)
        await _until(pilot, lambda: screen.plan is not None)
        await pilot.pause(1.0)
        made.append(_write(app, folder / "reference.svg"))
        screen.open_reference(work / "references" / "circle.mat")
        screen.view = "path"
        await pilot.pause(1.0)
        screen.refresh_plan()
        await pilot.pause(0.5)
        made.append(_write(app, folder / "reference-path.svg"))
    return made


def _bench(work: Path) -> tuple[Path, Path]:
    """Write a recording of a joint with friction and a ripple, and a model without them."""
    from zendsp.physics import model_text, parse_model, simulate_loop

    known = {
        "name": "bench",
        "sample_time": 0.004,
        "mechanism": {"kind": "rotary", "parameters": {"inertia": 0.01}},
        "sensor": {"position_resolution": 1e-5},
        "columns": {"time": "t", "position": "q", "command": "u"},
    }
    real = {
        **known,
        "controller": {"kind": "pd", "kp": [4.0], "kd": [0.2], "cutoff": 40.0},
        "columns": {**known["columns"], "reference": "r"},  # type: ignore[dict-item]
        "effect": [
            {"kind": "coulomb", "joint": 1, "level": 0.05},
            {"kind": "ripple", "joint": 1, "order": 7.0, "amplitude": 0.03, "phase": 0.4},
        ],
    }
    t = 0.004 * np.arange(3000)
    motion = sum(0.4 * np.sin(w * t + p) for w, p in ((2.1, 0.0), (5.3, 1.0), (9.7, 2.0)))
    made = simulate_loop(parse_model(real), np.asarray(motion)[:, None])
    table = np.column_stack([made.t, made["q"], made["u"]])
    run, model = work / "bench.csv", work / "bench.toml"
    np.savetxt(run, table, delimiter=",", header="t,q,u", comments="")
    model.write_text(model_text(parse_model(known)))
    return run, model


async def _diagnose(folder: Path, work: Path) -> list[Path]:
    from zendsp.tui.screens.diagnose import DiagnoseScreen

    run, model = _bench(work)
    app = ZendspApp(open_port, folder=work, first="diagnose")
    async with app.run_test(size=(160, 48)) as pilot:
        screen = app.screen
        assert isinstance(screen, DiagnoseScreen)
        screen.added, screen.roles, screen.model = [str(run)], {str(run): "fit"}, str(model)
        screen.fill()
        await pilot.press("s")
        await _until(pilot, lambda: screen.shown is not None and not screen.busy)
        await pilot.pause(1.0)
        return [_write(app, folder / "diagnose.svg")]


def _write(app: ZendspApp, path: Path) -> Path:
    path.write_text(portable(app.export_screenshot(title=path.stem)))
    return path


def take_screenshots(folder: Path) -> list[Path]:
    """Run the application against a simulated arm in real time and write one SVG for each picture.

    Parameters
    ----------
    folder : path
        Made where it does not exist.

    Returns
    -------
    list of path
        The files, in order.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        (work / "references").mkdir()
        save_reference(make_reference("circle", "imi_planar"), work / "references" / "circle.mat")

        async def everything() -> list[Path]:
            made = await _reference(folder, work)
            made += await _diagnose(folder, work)
            made += await _console(folder, work, (160, 48), "console")
            made += await _console(folder, work, (80, 24), "console-80x24")
            return made + await _execute(folder, work)

        return asyncio.run(everything())
