"""A real target process for the terminal's tests, on the fast clock."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from steps import COLLECTED, nobody
from textual.css.model import RuleSet
from textual.css.stylesheet import Stylesheet
from textual.pilot import Pilot
from waiting import PATIENCE_S

from zendsp.errors import ZendspError
from zendsp.link import Target, local
from zendsp.reference import make_reference, save_reference
from zendsp.tui.app import ZendspApp
from zendsp.tui.link_port import find_targets, open_port, start_machine

if TYPE_CHECKING:
    from steps import Until

ENDED_S = 10.0  # for what an application that has ended leaves behind
LOOK_S, RARELY_S = 0.02, 0.1  # between looks, at first and where it takes long


@pytest.fixture(autouse=True)
def _no_waiting_for_an_idle_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Textual's Pilot waits after each key until the process is idle, which it never is while
    curves roll.

    A key is done when its messages have been handed on, and that takes turns of the event loop, not
    time.
    """

    async def turns(min_sleep: float = 0.0, max_sleep: float = 0.0) -> None:
        for _ in range(60):
            await asyncio.sleep(0)
        await asyncio.sleep(0.005)

    monkeypatch.setattr("textual.app.wait_for_idle", turns)
    monkeypatch.setattr("textual.pilot.wait_for_idle", turns)


@pytest.fixture(autouse=True, scope="session")
def _styles_are_parsed_once() -> Iterator[None]:
    """Textual parses the styles of all widgets again for each application and each change of theme:
    the same text and the same variables give the same rules.
    """
    known: dict[tuple[object, ...], list[RuleSet]] = {}
    parse = Stylesheet._parse_rules

    def parsed(self: Stylesheet, css: str, *where: object, **more: object) -> list[RuleSet]:
        key = (css, where, tuple(more.items()), tuple(self._variables.items()))
        if key not in known:
            known[key] = parse(self, css, *where, **more)  # type: ignore[arg-type]
        return known[key]

    patch = pytest.MonkeyPatch()
    patch.setattr(Stylesheet, "_parse_rules", parsed)
    yield
    patch.undo()


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers", "covers(*names): actions of the table that a test carries out"
    )


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep what there is before the long ones are taken out."""
    config.stash[COLLECTED] = list(items)


@pytest.fixture(scope="session")
def shared_target() -> Iterator[Target]:
    # 20 machine seconds a second: quick, and leaves the CPU to the others
    target = local("imi_planar", clock="fast", options=["--speed", "10"], timeout=PATIENCE_S)
    yield target
    target.close()


@pytest.fixture
def target(shared_target: Target) -> Iterator[Target]:
    """The shared target, empty, with nobody in command."""
    yield shared_target
    for verb, arguments in (
        ("drive", {"action": "take", "force": True}),
        ("drive", {"action": "acknowledge"}),
        ("pause", {}),
        ("drive", {"action": "host_lost", "policy": "stop"}),
        ("drive", {"action": "auto"}),
        ("unload", {}),
        ("drive", {"action": "acknowledge"}),  # what a lost host latched in between
        ("drive", {"action": "release"}),
    ):
        with contextlib.suppress(ZendspError):
            shared_target.request(verb, **arguments)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A working folder with one planned circle and a copy of pd.c."""
    from importlib import resources

    (tmp_path / "references").mkdir()
    save_reference(
        make_reference("circle", "imi_planar", duration=3.0), tmp_path / "references" / "circle.mat"
    )
    source = resources.files("zendsp_isr").joinpath("programs", "pd.c").read_text()
    (tmp_path / "pd.c").write_text(source)
    return tmp_path


@pytest.fixture
def app(tmp_path: Path) -> ZendspApp:
    """The application, where there is no target."""
    return ZendspApp(nobody, folder=tmp_path, frames=4.0)


@pytest.fixture
def lab(target: Target, folder: Path) -> ZendspApp:
    """The application, about to connect to the target."""
    return ZendspApp(
        open_port, find_targets=find_targets, start_machine=start_machine, machines=("imi_planar",),
        target=target.name, folder=folder, source=folder / "pd.c", frames=4.0,
    )  # fmt: skip


@pytest.fixture
def until() -> Until:
    """Wait for a condition, with a deadline and a name for what did not come."""

    async def wait(pilot: Pilot[None], condition: Callable[[], object], what: str) -> None:
        ended, deadline = False, time.monotonic() + PATIENCE_S
        look = LOOK_S
        while not condition():
            if pilot.app._exit and not ended:  # nothing that the screen does comes any more
                ended, deadline = True, time.monotonic() + ENDED_S
            if time.monotonic() > deadline:
                app = pilot.app
                events = (
                    [e.text for e in app.session.events.since(0)[1]]
                    if isinstance(app, ZendspApp)
                    else []
                )
                raise AssertionError(f"did not happen: {what}; events: {events[-8:]}")
            await pilot.pause(look)
            look = min(1.2 * look, RARELY_S)  # each look takes some ms of the processor

    return wait


@pytest.fixture
def built(until: Until) -> Callable[[ZendspApp, Pilot[None]], Awaitable[None]]:
    """Connect and build pd.c through the Console."""

    async def run(app: ZendspApp, pilot: Pilot[None]) -> None:
        await until(pilot, lambda: app.session.snapshot.link == "up", "the link is up")
        await pilot.press("b")
        await until(
            pilot,
            lambda: app.session.snapshot.state == "loaded" and app.session.snapshot.variables,
            "built",
        )
        await until(pilot, lambda: app.session.channels, "the usual curves are followed")

    return run


@pytest.fixture
def enabled(
    built: Callable[[ZendspApp, Pilot[None]], Awaitable[None]], until: Until
) -> Callable[[ZendspApp, Pilot[None]], Awaitable[None]]:
    """Power and enable as well."""

    async def run(app: ZendspApp, pilot: Pilot[None]) -> None:
        await built(app, pilot)
        await pilot.press("o")
        await until(
            pilot, lambda: app.session.snapshot.drive == "homed" and app.session.snapshot.explicit,
            "powered",
        )
        await pilot.press("e")
        await until(pilot, lambda: app.session.snapshot.drive == "enabled", "enabled")

    return run
