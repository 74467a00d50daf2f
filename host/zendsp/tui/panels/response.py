"""Frequency responses in one plot: magnitude and phase."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np
from rich.text import Text
from textual import events
from textual.app import ComposeResult
from textual.containers import Container, Vertical
from textual.widgets import Static

from zendsp.tui.scope.path import Axes, Curve, PathPlot

if TYPE_CHECKING:
    from zendsp.experiment.response import FrequencyResponse

LEAST_ROWS = 14  # for two plots over one another
ROOM = 6  # rows of a view for one of words


class ResponseView(Vertical):
    """Up to four frequency responses: dB and deg over frequency."""

    DEFAULT_CSS = """
    ResponseView #response-words { height: auto; }
    ResponseView #response-plots { height: 1fr; layout: vertical; }
    ResponseView.-beside #response-plots { layout: horizontal; }
    ResponseView PathPlot { width: 1fr; height: 1fr; min-height: 4; }
    """

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._words = ""

    def compose(self) -> ComposeResult:
        yield Static("", id="response-words", markup=False)
        with Container(id="response-plots"):
            yield PathPlot(id="magnitude")
            yield PathPlot(id="phase")

    def show(self, responses: Sequence[tuple[str, int, FrequencyResponse]]) -> None:
        """Draw other responses, each with a name and a colour."""
        self._words = "".join(r.summary() for _, _, r in responses[-1:])
        self._say()
        units = {r.unit for _, _, r in responses}
        above = f"dB of {', '.join(sorted(u or '1' for u in units))}" if any(units) else "dB"
        several = len(responses) > 1
        for plot, name in (("#magnitude", above), ("#phase", "deg")):
            curves = []
            for run, trace, r in responses:
                y = r.phase_deg if plot == "#phase" else r.magnitude_db
                xy = np.stack([np.log10(r.f), y], axis=1)
                curves.append(Curve(run if several else "", xy, trace))
                curves.append(Curve("", xy[r.sure], trace, "marks"))
            axes = Axes(("f [Hz]", name), equal=False, log_x=True)
            self.query_one(plot, PathPlot).show(curves, axes)

    def on_resize(self, event: events.Resize) -> None:
        self.set_class(event.size.height < LEAST_ROWS, "-beside")
        self._say()

    def _say(self) -> None:
        """Three lines of text, more where the view is high, and a mark where some are left out."""
        words, width = self._words, self.size.width
        if width:
            most = max(3, self.size.height // ROOM)
            words = "\n".join(wrap(words, width, max_lines=most, placeholder=" …"))
        self.query_one("#response-words", Static).update(Text(words))
