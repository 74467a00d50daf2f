"""The picture of a reference: position, velocity, acceleration and torque within their limits, and
the tip's path.
"""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zendsp.recording.plot import save_figure
from zendsp.reference.core import Reference
from zendsp.reference.kinematics import forward_kinematics
from zendsp.reference.machine import Machine

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette: told apart by colour-blind readers as well.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
TITLE = 110  # columns that fit above a plot


def _draw(ax: Axes, reference: Reference, x: np.ndarray, low: np.ndarray, high: np.ndarray,
    label: str) -> None:  # type: ignore[type-arg]
    for j in range(reference.joints):
        ax.plot(reference.t, x[:, j], color=COLOURS[j % 7], lw=1.3, label=f"joint {j + 1}")
    span = max(float(np.ptp(x)), 1e-9)
    bottom, top = float(x.min()) - 0.1 * span, float(x.max()) + 0.1 * span
    beyond = []
    for j in range(reference.joints):
        near = [limit for limit in (low[j], high[j]) if bottom - span < limit < top + span]
        for limit in near:
            ax.axhline(float(limit), color=COLOURS[j % 7], lw=0.9, ls="--", alpha=0.6)
        if len(near) < 2:
            both = f"±{high[j]:.4g}" if low[j] == -high[j] else f"{low[j]:.4g} to {high[j]:.4g}"
            beyond.append(f"joint {j + 1} {both}")
    if beyond:  # far from the motion, a line would squash the curves
        told = textwrap.fill(f"limits beyond the picture: {', '.join(beyond)}", TITLE)
        ax.set_title(told, loc="right", fontsize="x-small")
    ax.set_ylabel(label)
    ax.grid(alpha=0.3)


def plot_reference(
    reference: Reference, machine: Machine, path: str | Path | None = None
) -> Figure:
    """Draw a reference over its limits (dashed), and save the picture where a path is given.

    Parameters
    ----------
    reference : Reference
        The motion.
    machine : Machine
        Its limits and, for a planar arm, the path of the tip.
    path : path, optional
        ``.png``, ``.svg`` or ``.pdf``.

    Returns
    -------
    matplotlib.figure.Figure
        The figure, not shown.

    Examples
    --------
    >>> from zendsp.reference import load_machine, make_reference
    >>> figure = plot_reference(make_reference("circle", "imi_planar"), load_machine("imi_planar"))
    >>> len(figure.axes)
    5
    """
    from matplotlib.lines import Line2D

    from zendsp.recording.shown import ShownFigure

    planar = machine.kind == "planar2r"
    figure = ShownFigure(figsize=(11 if planar else 8, 8), layout="constrained")
    limits, unit = machine.limits, reference.unit
    torque = machine.torque(reference)
    current = None if torque is None else machine.current(torque)
    most = machine.current(limits.torque)
    motion = [
        (reference.q, limits.position_min, limits.position_max, f"q [{unit}]"),
        (reference.qd, -limits.speed, limits.speed, f"qd [{unit}/s]"),
        (reference.qdd, -limits.acceleration, limits.acceleration, f"qdd [{unit}/s²]"),
        (torque, -limits.torque, limits.torque, "tau [N m]"),
    ]
    if most is not None:
        motion.append((current, -most, most, "i [A]"))
    shown = motion[:1] + motion[3:] if reference.jumps else motion  # a step has no speed
    rows = [(x, low, high, label) for x, low, high, label in shown if x is not None]
    grid = figure.add_gridspec(
        len(rows), 2 if planar else 1, width_ratios=(1.5, 1) if planar else None
    )
    for i, (x, low, high, label) in enumerate(rows):
        ax = figure.add_subplot(grid[i, 0])
        _draw(ax, reference, x, low, high, label)
    ax.set_xlabel("t [s]")
    figure.suptitle(
        f"{reference.kind} on {machine.name}, {reference.duration:g} s, sample time"
        f" {reference.sample_time:g} s"
    )
    limit = Line2D([], [], color="#777777", lw=0.9, ls="--", label="limit")
    joints = ax.lines[: reference.joints]
    # beside the plots, where it covers no curve
    figure.legend(handles=[*joints, limit], loc="outside lower center", ncols=8, fontsize="small")
    if planar:
        tip = forward_kinematics(machine, reference.q)
        reach = float(machine.parameters["l1"]) + float(machine.parameters["l2"])
        ax = figure.add_subplot(grid[:, 1])
        angle = np.linspace(-np.pi, np.pi, 181)
        ax.plot(reach * np.cos(angle), reach * np.sin(angle), color="#999999", lw=0.9, ls="--")
        ax.plot(tip[:, 0], tip[:, 1], color=COLOURS[0])
        ax.plot(*tip[0], "o", color=COLOURS[2], label="start")
        ax.plot(*tip[-1], "s", color=COLOURS[1], ms=5, fillstyle="none", label="end")
        ax.plot(0, 0, "k+")
        ax.set_aspect("equal")
        ax.set_xlabel("x [m]")
        ax.set_ylabel("y [m]")
        ax.legend(fontsize="small")
        ax.grid(alpha=0.3)
    save_figure(figure, path)
    return figure
