"""The common style of the figures of all experiments."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from zendsp.whole_file import writing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, GREY = "#1a1a1a", "#8a8a8a"
BLUE, RED, GREEN, AMBER = "#1f5fa8", "#c23b22", "#2f7d4f", "#c98a1b"


def make_figure(
    rows: int, columns: int, width: float = 9.0, height: float = 3.2, **options: Any
) -> tuple[Figure, Any]:
    """A figure of ``rows`` by ``columns`` panels, each ``height`` inches high, and its panels as a
    2-D array.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    for axis in axes.flat:
        style(axis)
    return figure, axes


def style(axis: Axes) -> None:
    """Thin frame, light grid."""
    axis.grid(True, color="#e3e3e3", linewidth=0.6)
    axis.set_axisbelow(True)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    axis.tick_params(labelsize=8, colors=INK)


def label(axis: Axes, x: str, y: str, title: str = "", legend: bool = False) -> None:
    """Axis texts."""
    axis.set_xlabel(x, fontsize=9)
    axis.set_ylabel(y, fontsize=9)
    if title:
        axis.set_title(title, fontsize=10, loc="left")
    if legend:
        axis.legend(fontsize=8, frameon=False)


def save(figure: Figure, path: Path) -> str:
    """Write a PNG of modest size; returns its name."""
    with writing(path):
        figure.savefig(path, dpi=110)
    return path.name
