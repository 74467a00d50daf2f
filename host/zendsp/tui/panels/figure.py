"""A chart of a report, drawn in the terminal."""

from __future__ import annotations

import numpy as np
from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Container, Vertical
from textual.widgets import Static

from zendsp.diagnosis.report.chart import Chart, Panel, Series
from zendsp.tui.scope.path import Axes, Curve, PathPlot, extent

Frame = tuple[float, float, float, float]
TRACES = {"before": 1, "after": 0, "law": 7, "floor": 2, "data": -1}
STYLES = {"line": "line", "dots": "dots", "means": "marks", "bars": "marks"}
LEAST_ROWS = 12  # for two panels over one another


class FigureView(Vertical):
    """Up to two panels of a chart, side by side or one above the other."""

    DEFAULT_CSS = """
    FigureView { height: 1fr; }
    FigureView #figure-title { height: 1; text-overflow: ellipsis; text-wrap: nowrap; }
    FigureView #figure-panels { height: 1fr; layout: vertical; }
    FigureView.-beside #figure-panels { layout: horizontal; }
    FigureView PathPlot { width: 1fr; height: 1fr; min-height: 4; }
    """

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.chart: Chart | None = None

    def compose(self) -> ComposeResult:
        yield Static("", id="figure-title", markup=False)
        with Container(id="figure-panels"):
            yield PathPlot(id="panel-0")
            yield PathPlot(id="panel-1")

    @property
    def plots(self) -> list[PathPlot]:
        """The panels."""
        return [self.query_one(f"#panel-{k}", PathPlot) for k in range(2)]

    def show(self, chart: Chart) -> None:
        """Draw another chart. Colour maps are left out."""
        self.chart = chart
        panels = [p for p in chart.panels if p.series][:2]
        if not chart.beside and self.size.height < LEAST_ROWS:
            panels = panels[:1]
        curves = [panel_curves(p) for p in panels]
        frame = common_frame(panels, curves) if chart.same else None
        self.set_class(chart.beside, "-beside")
        title = chart.title or panels[0].title
        self.query_one("#figure-title", Static).update(Text(title, "bold", no_wrap=True))
        for k, plot in enumerate(self.plots):
            plot.display = k < len(panels)
            if k < len(panels):
                p = panels[k]
                name = p.title if p.title != title else ""
                plot.show(
                    curves[k],
                    Axes((p.xlabel, p.ylabel), equal=False, title=name, frame=frame, log=p.log),
                )

    def on_resize(self) -> None:
        if self.chart is not None:
            self.show(self.chart)


def panel_curves(panel: Panel) -> list[Curve]:
    """The curves of a panel; its band, its broken line and the borders of its shaded spans are
    curves too.
    """
    curves = [_curve(s, panel.log) for s in panel.series]
    low, high = extent(curves)
    across = np.array([low[0], high[0]])
    levels = [(panel.level[0], panel.level[1])] if panel.level else []
    levels += [(edge, "") for edge in panel.band or ()]
    for value, name in levels:
        y = np.log10(value) if panel.log else value
        curves.append(Curve(name, np.stack([across, np.full(2, y)], axis=1), TRACES["floor"]))
    return curves


def _curve(series: Series, log: bool) -> Curve:
    y = series.y
    if log:
        with np.errstate(divide="ignore", invalid="ignore"):
            y = np.log10(y)
    xy = np.stack([series.x, y], axis=1).astype(np.float64)
    style = STYLES[series.kind]
    return Curve(series.label if style == "line" else "", xy, TRACES[series.role], style)


def common_frame(panels: list[Panel], curves: list[list[Curve]]) -> Frame:
    """The limits x0, x1, y0, y1 for panels that share their axes."""
    low, high = extent([c for part in curves for c in part])
    bottom, top = panels[0].limits or (float(low[1]), float(high[1]))
    left, right = float(low[0]), float(high[0])
    return (left, right, bottom, top) if right > left else (left - 1.0, left + 1.0, bottom, top)
