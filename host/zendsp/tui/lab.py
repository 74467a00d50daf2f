"""The application as its screens see it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from zendsp.tui.runs import Run
from zendsp.tui.session import Session
from zendsp.tui.workspace import Workspace


class Lab(Protocol):
    """What a screen may ask of :class:`zendsp.tui.app.ZendspApp`, where each is described."""

    session: Session
    workspace: Workspace
    channels: tuple[str, ...]
    chosen: tuple[Path, ...]  # references that Execute will play
    frame_s: float
    model: str  # model file that simulation and diagnosis were last given
    source: Path | None

    def drive(self, label: str, verb: str, **values: object) -> None: ...
    def play(self, path: Path) -> None: ...
    def diagnose(self, run: Run) -> None: ...
    def await_run(self, reference: Path, then: Callable[[Run], None]) -> None: ...
    def run_made(self, run: Run) -> None: ...
    def source_texts(self) -> dict[str, str]: ...
    def examples(self) -> list[Path]: ...
    def toast(self, text: str, level: str = "information") -> None: ...
    def expect_dialog(self) -> None: ...
    async def hand_over(self) -> None: ...
