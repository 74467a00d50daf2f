"""Plots a recording: one panel for each unit, all on the same time axis."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from zendsp.errors import RecordingError
from zendsp.recording.names import element_names

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from zendsp.recording.samples import Samples

# Okabe and Ito 2008: told apart by readers with any kind of colour vision.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")


def plot(recording: Samples, names: Sequence[str] | None, path: str | Path | None) -> Figure:
    """See `Recording.plot`."""
    from zendsp.recording.shown import ShownFigure

    chosen = list(names) if names is not None else list(recording.names)
    if not chosen:
        raise RecordingError("nothing to plot: name at least one channel")
    panels: dict[str, list[str]] = {}
    for name in chosen:
        recording[name]  # raises for a name that is not there
        panels.setdefault(_unit(recording, name), []).append(name)
    figure = ShownFigure(figsize=(9.0, 1.2 + 1.9 * len(panels)), layout="constrained")
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axis, (unit, members) in zip(axes, panels.items(), strict=True):
        axis.set_prop_cycle(color=COLOURS)
        for name in members:
            values = recording[name]
            matrix = values.reshape(len(recording), -1)
            for label, column in zip(element_names(name, matrix.shape[1]), matrix.T, strict=True):
                axis.plot(recording.t, column, lw=1.0, label=label)
        axis.set_ylabel(unit or "–")
        axis.grid(True, alpha=0.3)
        # beside the curves, where it covers none
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.3, fontsize=8)
    axes[-1].set_xlabel("t (s)")
    title = " · ".join(
        part for part in (recording.target, recording.machine, recording.note) if part
    )
    if title:
        figure.suptitle(title, fontsize=10)
    save_figure(figure, path)
    return figure


def save_figure(figure: Figure, path: str | Path | None) -> None:
    """Write a figure as a picture, and make its folder where it is missing; with None write
    nothing.

    Raises
    ------
    RecordingError
        It cannot be written there, or not as a picture of that kind.
    """
    if path is None:
        return
    path = Path(path).expanduser()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=120)
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise RecordingError(f"{path}: cannot be written ({why})") from error


def _unit(recording: Samples, name: str) -> str:
    units = dict(zip(recording.columns, recording.column_units, strict=True)) | recording.units
    return units.get(name, "s" if name == "t" else "")
