"""Draws the charts of a report as pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imsave
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

from zendsp.diagnosis.report.chart import Chart, Panel, Series

COLOURS = {  # apart for colour-blind readers, and in grey
    "before": "#b4451f",
    "after": "#1f5fa8",
    "data": "#9a9a9a",
    "floor": "#3a7d44",
    "law": "black",
}
NUMBERS = 7  # along an axis
SPAN, SPANS = "#e8c39e", "where more of it lies than elsewhere"
STYLE: Any = {
    "font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "figure.dpi": 110,
    "axes.grid": True, "grid.alpha": 0.25,
}


def draw(chart: Chart) -> Figure:
    """Draw one chart."""
    n = len(chart.panels)
    ratio = list(chart.ratio) or [1] * n
    with rc_context(STYLE):
        # no pyplot: its choice of a window is the user's
        figure = Figure(figsize=chart.size, layout="constrained")
        grid = figure.subplots(
            nrows=1 if chart.beside else n,
            ncols=n if chart.beside else 1,
            width_ratios=ratio if chart.beside else None,
            height_ratios=None if chart.beside else ratio,
            sharex=chart.same or not chart.beside,
            sharey=chart.same,
            squeeze=False,
        )
        axes: list[Axes] = list(grid.ravel())
        for k, (axis, panel) in enumerate(zip(axes, chart.panels, strict=True)):
            _fill(figure, axis, panel, inner=chart.same and k > 0)
            if not chart.beside and k < n - 1:
                axis.set_xlabel("")  # the last panel has it
        if any(panel.mesh for panel in chart.panels):  # room for the bar's label
            figure.get_layout_engine().set(wspace=0.08)  # type: ignore[union-attr, call-arg]
        if chart.title:
            figure.suptitle(chart.title, fontsize=10)
        _legend(figure, axes)
    return figure


def _fill(figure: Figure, axis: Axes, panel: Panel, *, inner: bool) -> None:
    for k, (begin, end) in enumerate(panel.spans):
        axis.axvspan(begin, end, color=SPAN, alpha=0.4, lw=0, label=None if k else SPANS)
    if panel.band is not None:
        axis.axhspan(*panel.band, color=COLOURS["floor"], alpha=0.2, lw=0)
    if panel.mesh is not None:
        m = panel.mesh
        picture = axis.pcolormesh(m.x, m.y, m.values, cmap="magma_r")
        figure.colorbar(picture, ax=axis, label=m.label)
    for series in panel.series:
        _series(axis, series)
    if panel.level is not None:
        value, label = panel.level
        axis.axhline(value, color=COLOURS["floor"], ls="--", lw=1, label=label)
    if panel.log:
        axis.set_yscale("log")
        axis.yaxis.set_major_locator(FixedLocator(places(*axis.get_ylim())))
        axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.yaxis.set_minor_formatter(NullFormatter())
    if panel.limits is not None:
        axis.set_ylim(*panel.limits)
    axis.set(xlabel=panel.xlabel, ylabel="" if inner else panel.ylabel, title=panel.title)


def places(low: float, high: float) -> list[float]:
    """The places of numbers on a logarithmic axis, about six: at powers of 10, or closer."""
    powers = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    found: list[float] = []
    for steps in ((1,), (1, 2, 5), range(1, 10), np.arange(10, 100) / 10):
        found = [float(p * s) for p in powers for s in steps if low <= p * s <= high]
        if len(found) > 2:
            break
    apart = (high / low) ** (1 / NUMBERS)  # else 0.0009 and 0.001 would touch
    kept = found[-1:]
    for place in found[-2::-1]:
        if kept[-1] >= apart * place:
            kept.append(place)
    return kept[::-1]


def _series(axis: Axes, s: Series) -> None:
    colour, label = COLOURS[s.role], s.label or None
    if s.kind == "line":
        thin = 0.7 if len(s.x) > 300 else 1.2
        thin *= 3.0 if s.role == "before" else 1.0  # visible beneath an equal line
        axis.plot(s.x, s.y, color=colour, lw=thin, label=label)
    elif s.kind == "dots":
        axis.plot(s.x, s.y, ".", color=colour, ms=1.5, alpha=0.35, rasterized=True, label=label)
    elif s.kind == "means":
        axis.errorbar(s.x, s.y, s.spread, color=colour, fmt="o", ms=3, lw=0.8, label=label)
    elif s.kind == "bars":
        width = 0.8 if s.spread is None else s.spread
        axis.bar(s.x, s.y, width=width, color=colour, alpha=0.8, label=label)
    else:
        raise ValueError(f"a series of kind {s.kind!r} cannot be drawn")


def _legend(figure: Figure, axes: Sequence[Axes]) -> None:
    """Put the legend below the figure, where it covers no data."""
    entries = {
        label: handle
        for axis in axes
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        list(entries.values()),
        list(entries),
        loc="outside lower center",
        ncols=4,
        frameon=False,
        fontsize=8,
    )


def draw_all(charts: Sequence[Chart], folder: Path) -> list[tuple[Chart, Path]]:
    """Write a PNG for each chart, and return both."""
    done = []
    for chart in charts:
        path = folder / f"{chart.name}.png"
        figure = draw(chart)
        canvas: Any = FigureCanvasAgg(figure)
        canvas.draw()  # once: savefig would draw it a second time
        imsave(path, canvas.buffer_rgba(), format="png", dpi=figure.dpi)
        done.append((chart, path))
    return done
