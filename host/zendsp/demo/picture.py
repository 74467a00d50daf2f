"""The picture of the demo: the circle, the errors, the torques, and the timing of the loop."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from zendsp.recording import Recording
from zendsp.recording.plot import COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from zendsp.demo.live_loop import Change

SETTLED_S = 2.0  # the approach to the circle and the step of the gains are over
FloatArray = npt.NDArray[np.float64]


def draw(recording: Recording, changes: Sequence[Change], path: Path) -> None:
    """Draw the recording of the demo.

    Parameters
    ----------
    recording : Recording
        With q, r1, r2, e, tau, exec_us and late_us.
    changes : sequence of Change
        Where the gains were changed.
    path : Path
        PNG.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 7.2), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.0, 1.25))
    times = _change_times(recording)
    _paths(figure.add_subplot(grid[:2, 0]), recording, times, changes)
    _timing(figure.add_subplot(grid[2, 0]), recording)
    first = figure.add_subplot(grid[0, 1])
    _traces(first, recording, times, recording["e"] * 1e3, "error (mrad)")
    # The start from rest is far off by design and would flatten everything else.
    settled = recording["e"][recording.t > SETTLED_S] * 1e3
    first.set_ylim(1.15 * settled.min(), 1.15 * settled.max())
    _traces(figure.add_subplot(grid[1, 1], sharex=first), recording, times, recording["tau"], "torque (N m)")
    last = figure.add_subplot(grid[2, 1], sharex=first)
    _traces(last, recording, times, recording["q"], "position (rad)")
    last.set_xlabel("t (s)")
    figure.suptitle(f"{recording.machine}: a circle under pd.c, gains changed while it moves")
    figure.savefig(path, dpi=120)


def _change_times(recording: Recording) -> list[float]:
    """Times at which parameters changed, from the log that travels with the recording."""
    ticks = sorted({change.tick for change in recording.log})
    rate = recording.decimation / recording.sample_time
    return [tick / rate for tick in ticks]


def _paths(axis: Axes, recording: Recording, times: list[float], changes: Sequence[Change]) -> None:
    t = recording.t
    axis.plot(recording["r1"], recording["r2"], color="0.6", lw=5, alpha=0.5, label="reference")
    bounds = [0.0, *times, t[-1]]
    labels = ["gains of pd.c", *(change.why for change in changes)]
    for k, (start, end) in enumerate(itertools.pairwise(bounds)):
        part = (t >= start + (0.0 if k == 0 else 0.3)) & (t < end)
        axis.plot(
            *recording["q"][part].T,
            color=COLOURS[k],
            lw=1.2,
            label=labels[k] if k < len(labels) else None,
        )
    axis.set_aspect("equal")
    axis.set_xlabel("joint 1 (rad)")
    axis.set_ylabel("joint 2 (rad)")
    axis.set_title("one joint over the other")
    axis.legend(fontsize=8, loc="center", bbox_to_anchor=(0.55, 0.5))
    axis.grid(True, alpha=0.3)


def _traces(axis: Axes, recording: Recording, times: list[float], values: FloatArray, label: str) -> None:
    for k, column in enumerate(values.T):
        axis.plot(recording.t, column, color=COLOURS[k], lw=0.9, label=f"joint {k + 1}")
    for time in times:
        axis.axvline(time, color="0.3", lw=0.8, ls="--")
    axis.set_ylabel(label)
    axis.legend(fontsize=8, loc="upper right")
    axis.grid(True, alpha=0.3)


def _timing(axis: Axes, recording: Recording) -> None:
    shown = {"execution": recording["exec_us"], "lateness": recording["late_us"]}
    top = max(1.0, *(float(values.max()) for values in shown.values()))
    edges: list[float] = np.geomspace(0.01, 1.2 * top, 60).tolist()
    for k, (name, values) in enumerate(shown.items()):
        clipped = np.clip(values, edges[0], None)
        axis.hist(
            clipped,
            edges,
            histtype="stepfilled",
            alpha=0.6,
            color=COLOURS[k],
            label=f"{name}, max {values.max():.3g} µs",
        )
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlabel("µs")
    axis.set_ylabel("samples")
    axis.set_title(f"timing of the loop: {int(recording.timing.get('overruns', 0))} overruns", fontsize=10)
    axis.legend(fontsize=8)
