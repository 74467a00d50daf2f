"""Writes what the scope shows to a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from zendsp.errors import RecordingError
from zendsp.recording import Recording
from zendsp.recording.files import WRITERS
from zendsp.tui.scope.settings import Channel
from zendsp.tui.scope.spectrum import density

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = npt.NDArray[np.float64]
PICTURES = (".png", ".svg", ".pdf")


@dataclass(frozen=True)
class Seen:
    """Rows within the picture, and the view in which they are shown."""

    channels: tuple[Channel, ...]
    t: Floats  # s, shape (n,)
    y: Floats  # shape (n, channels)
    view: str = "time"
    selected: int = 0


def check_name(text: str) -> str:
    """The name of a file that can be written; another is refused."""
    kinds = (*PICTURES, *WRITERS)
    if Path(text).suffix.lower() not in kinds:
        raise ValueError(f"end the name with {', '.join(kinds[:-1])} or {kinds[-1]}")
    return text


def export(seen: Seen, path: Path) -> Path:
    """Write the rows, or draw them; of a spectrum, frequencies and densities.

    Parameters
    ----------
    path : Path
        Its suffix chooses.

    Raises
    ------
    RecordingError
        There is nothing to write, or it cannot be written.
    """
    if len(seen.t) < 2:
        raise RecordingError("nothing is seen yet: start the program, or widen the time (-)")
    if path.suffix.lower() in PICTURES:
        return _draw(seen, path)
    if seen.view != "spectrum":
        columns = {c.name: seen.y[:, k] for k, c in enumerate(seen.channels)}
        units = {c.name: c.unit for c in seen.channels if c.unit}
        return Path(Recording.from_columns(columns, t=seen.t, units=units).save(path))
    if path.suffix.lower() != ".csv":
        raise RecordingError(f"{path}: a spectrum is written as .csv, .png, .svg or .pdf")
    f, amplitude = density(seen.t, seen.y)
    header = ["f [Hz]", *(f"{c.name} [{c.unit or 1}/sqrt(Hz)]" for c in seen.channels)]
    try:
        np.savetxt(path, np.column_stack((f, amplitude)), delimiter=",", fmt="%.9g",
                   header=",".join(header), comments="")  # fmt: skip
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written ({error.strerror})") from error
    return path


def _draw(seen: Seen, path: Path) -> Path:
    from matplotlib.figure import Figure

    if seen.view == "xy":
        figure = Figure((5.0, 5.0), layout="constrained")
        axis = figure.add_subplot()
        base = seen.channels[seen.selected]
        for k, c in enumerate(seen.channels):
            if k != seen.selected or len(seen.channels) == 1:
                axis.plot(seen.y[:, seen.selected], seen.y[:, k], label=_named(c))
        axis.set_xlabel(_named(base))
    elif seen.view == "spectrum":
        f, amplitude = density(seen.t, seen.y)
        figure = Figure((7.0, 4.0), layout="constrained")
        axis = figure.add_subplot()
        for k, c in enumerate(seen.channels):
            axis.loglog(f, amplitude[:, k], label=f"{c.name} [{c.unit or 1}/√Hz]")
        axis.set_xlabel("f [Hz]")
    else:
        figure = _over_time(seen.channels, seen.t, seen.y)
        axis = figure.axes[-1]
        axis.set_xlabel("t [s]")
    for part in figure.axes:
        part.grid(True, alpha=0.3)
        part.legend(loc="upper right", fontsize="small")
    try:
        figure.savefig(path, dpi=150)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written ({error.strerror})") from error
    return path


def _over_time(channels: Sequence[Channel], t: Floats, y: Floats) -> Figure:
    """One panel for each unit."""
    from matplotlib.figure import Figure

    units = list(dict.fromkeys(c.unit for c in channels))
    figure = Figure((7.0, 1.2 + 1.8 * len(units)), layout="constrained")
    panels = figure.subplots(len(units), 1, sharex=True, squeeze=False)[:, 0]
    for panel, unit in zip(panels, units, strict=True):
        for k, c in enumerate(channels):
            if c.unit == unit:
                panel.plot(t, y[:, k], label=c.name, linewidth=0.9)
        panel.set_ylabel(unit)
    return figure


def _named(channel: Channel) -> str:
    return f"{channel.name} [{channel.unit}]" if channel.unit else channel.name
