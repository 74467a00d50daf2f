"""The picture of the story: what the loop hid, what was missing, the fit on held-out data, and the
error before and after.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zendsp.demo.evidence import BOUNDARY_S, Array, Tracking, columns, of_body

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

    from zendsp.demo.story import Told

# Okabe and Ito 2008: told apart by readers with any kind of colour vision, and in grey.
MACHINE, MODEL, FOUND, QUIET = "#0072B2", "#D55E00", "#009E73", "0.55"
ONE_LINE = 75  # characters of the headline that fit beside one another
BINS = 80  # of a curve of means
BENT = "its own numbers, bent to make up\nfor what it lacks in the other motion"
LEAD_S = 0.2  # the first moment is the leap from rest and would set the scale


def draw(told: Told, path: Path) -> None:
    """Draw the story.

    Parameters
    ----------
    told : Told
        A story that was told to its end.
    path : Path
        PNG, 1920 pixels wide.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(
        {
            "font.size": 10, "axes.spines.top": False, "axes.spines.right": False,
            "axes.grid": True, "grid.alpha": 0.25,
        }
    ):
        figure = Figure(figsize=(12.8, 8.2), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1.0), hspace=0.06)
        left = grid[0, 0].subgridspec(2, 1, hspace=0.03)
        joint = told.joint
        top = figure.add_subplot(left[0])
        _position(top, told, joint)
        _command(figure.add_subplot(left[1], sharex=top), told, joint)
        _missing(figure.add_subplot(grid[0, 1]), told, joint)
        _error(figure.add_subplot(grid[1, 0]), told, joint)
        _fit(figure.add_subplot(grid[1, 1]), told)
        figure.suptitle(_headline(told), fontsize=13, fontweight="bold")
        figure.savefig(path, dpi=150)


def _headline(told: Told) -> str:
    truth = (
        ", ".join(
            f"{e['effect'].replace('_', ' ')} on joint {e['joint']}" for e in told.truth.effects
        )
        if told.truth
        else "?"
    )
    gap = "      " if len(truth) + len(told.found) < ONE_LINE else "\n"
    return f"concealed: {truth}{gap}found: {told.found}"


def _unit(told: Told) -> str:
    return told.diagnosis.unit


def _position(axis: Axes, told: Told, joint: int) -> None:
    t = np.arange(len(told.recorded.train)) * told.recorded.train.sample_time
    q, s = (
        columns(told.recorded.train, "q")[:, joint - 1],
        columns(told.recorded.simulated, "q")[:, joint - 1],
    )
    axis.plot(t, q, color=MACHINE, lw=2.4, alpha=0.45, label="machine")
    axis.plot(
        t[: len(s)], s[: len(t)], color=MODEL, lw=1.0, ls=(0, (4, 2)),
        label="simulated by the given model",
    )
    axis.set_ylabel(f"position ({_unit(told)})")
    size = 1e3 * told.recorded.hidden.position[joint - 1]
    axis.set_title(
        f"The loop {'hides' if told.recorded.hidden.hides(joint) else 'cannot hide'} it: joint"
        f" {joint} differs from its simulation by {size:.3g} m{_unit(told)}",
        loc="left",
    )
    # where the loop cannot hide it the simulation goes farther; as far again, where it runs away
    span = float(np.ptp(q)) or 1.0
    both = np.r_[q, np.clip(s, float(q.min()) - span, float(q.max()) + span)]
    span = float(np.ptp(both)) or 1.0
    axis.set_ylim(float(both.min()) - 0.08 * span, float(both.max()) + 0.35 * span)
    axis.legend(loc="upper right", fontsize=8, frameon=False, ncols=2)
    axis.tick_params(labelbottom=False)


def _command(axis: Axes, told: Told, joint: int) -> None:
    t = np.arange(len(told.recorded.train)) * told.recorded.train.sample_time
    u = columns(told.recorded.train, "tau")[:, joint - 1]
    s = columns(told.recorded.simulated, "tau")[:, joint - 1]
    rows = min(len(u), len(s))
    axis.axhline(0.0, color=QUIET, lw=0.8)
    axis.plot(t[:rows], u[:rows] - s[:rows], color=MODEL, lw=0.6)
    axis.set_ylabel("command\nbeyond it (N m)")
    axis.set_xlabel("time (s)")
    _scale(axis, u[:rows] - s[:rows], 0.1)
    axis.set_xlim(0.0, float(t[-1]))


def _missing(axis: Axes, told: Told, joint: int) -> None:
    """Torque that the calibrated and the improved model lack, over the variable in which the effect
    lives.
    """
    from zendsp.diagnosis.measure.curve import Axis as Over
    from zendsp.diagnosis.measure.curve import binned, curve_over
    from zendsp.diagnosis.report.laws import axis_of, drawn

    if told.tracking is not None and any(of_body(f) for f in told.diagnosis.findings):
        _joints(axis, told.tracking)
        return
    finding = told.diagnosis.findings[0] if told.diagnosis.findings else None
    over = axis_of(finding) if finding else Over("velocity")
    units = {
        "position": _unit(told),
        "velocity": f"{_unit(told)}/s",
        "acceleration": f"{_unit(told)}/s²",
        "command": "N m",
        "time": "s",
    }
    series = (
        ("given model, calibrated", told.diagnosis.missing, MODEL),
        ("with what was found", told.diagnosis.remaining, FOUND),
    )
    shown: list[Array] = []
    for label, parts, colour in series:
        curve = curve_over(parts[joint], over, finding.mechanism if finding else "")
        seen = (curve.samples.weight > 0) & np.isfinite(np.concatenate(drawn(parts[joint])))
        x, y = curve.samples.x[seen], curve.samples.torque[seen]
        shown.append(y)
        every = slice(None, None, max(1, len(x) // 4000))
        axis.plot(x[every], y[every], ".", ms=1.6, alpha=0.35, color=colour, rasterized=True)
        axis.plot([], [], "o", color=colour, label=label)
        at, mean, _ = binned(curve.samples, BINS)
        axis.plot(at, mean, color=colour, lw=1.8)
    _scale(axis, shown[0], 0.3)
    axis.axhline(0.0, color=QUIET, lw=0.8)
    where = over if over.joints else f"{over} of joint {joint}"
    axis.set_xlabel(f"{where} ({units[over.variable]})")
    axis.set_ylabel(f"missing torque{' against the motion' if curve.against else ''} (N m)")
    name = finding.effect.replace("_", " ") if finding else told.diagnosis.verdict
    axis.set_title(f"What the model lacks: {name}", loc="left")
    axis.legend(loc="upper left", fontsize=8, frameon=False)


def _plain_decades(axis: Axis) -> None:
    """Label an axis with three numbers a decade; ten in powers would overlap."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def _joints(axis: Axes, tracking: Tracking) -> None:
    """Draw the tracking error of every joint, before and after: all of them feel a body."""
    at = np.arange(1, len(tracking.before) + 1)
    for values, shift, colour, name in (
        (tracking.before, -0.2, MODEL, "before"),
        (tracking.after, 0.2, FOUND, "with what was found"),
    ):
        axis.bar(at + shift, 1e3 * np.array(values), width=0.38, color=colour, label=name)
    axis.set_yscale("log")
    _plain_decades(axis.yaxis)
    axis.set_ylim(top=8e3 * max(tracking.before))
    axis.set_xticks(at)
    axis.grid(False, axis="x")
    axis.set_xlabel("joint")
    axis.set_ylabel("tracking error (mrad RMS)")
    axis.set_title("All joints bear what it carries", loc="left")
    axis.legend(loc="upper left", fontsize=8, frameon=False)


def _error(axis: Axes, told: Told, joint: int) -> None:
    if told.work is None or told.tracking is None:
        axis.text(
            0.5, 0.5, "nothing was switched on", ha="center", va="center",
            transform=axis.transAxes, color=QUIET,
        )
        axis.set_axis_off()
        return
    joint = told.compensated[0] if told.compensated and joint not in told.compensated else joint
    at = (told.tracking.tick - told.work.start_tick) * told.work.sample_time
    t = np.arange(len(told.work)) * told.work.sample_time
    e = 1e3 * columns(told.work, "e")[:, joint - 1]
    counted = (t >= told.tracking.first_s) & (t < told.tracking.last_s)
    counted &= (t < at) | (t >= at + BOUNDARY_S)
    axis.plot(t, np.where(counted, np.nan, e), color=QUIET, lw=0.7)
    axis.plot(t, np.where(counted & (t < at), e, np.nan), color=MODEL, lw=0.7)
    axis.plot(t, np.where(counted & (t >= at), e, np.nan), color=FOUND, lw=0.7)
    low = _scale(axis, e[t > LEAD_S], 0.3)
    axis.axvline(at, color="0.2", lw=1.0, ls="--")
    b, a = 1e3 * told.tracking.before[joint - 1], 1e3 * told.tracking.after[joint - 1]
    words = f" one synchronous update, sample {told.tracking.tick}"
    axis.text(at, low, words, fontsize=8, va="bottom", color="0.2")
    for x, value, colour in ((0.25, b, MODEL), (0.78, a, FOUND)):
        axis.text(
            x, 0.94, f"{value:.3g} m{_unit(told)} RMS", color=colour, fontsize=13,
            fontweight="bold", ha="center", transform=axis.transAxes,
        )
    axis.set_xlabel("time (s); grey is not counted: setting out, settling after the update, rest")
    axis.set_ylabel(f"tracking error of joint {joint} (m{_unit(told)})")
    axis.set_title(
        (
            "Switched on in the running program"
            if told.compensated
            else "What was found is nothing that a torque can cancel"
        ),
        loc="left",
    )
    axis.set_xlim(0.0, float(t[-1]))


def _scale(axis: Axes, values: Array, headroom: float) -> float:
    """Set limits that show zero and all but the rarest values, with room for words above; return
    the lower one.
    """
    low, high = np.quantile(np.append(values, 0.0), (0.002, 0.998))
    span = max(float(high - low), 1e-9)
    axis.set_ylim(float(low) - 0.15 * span, float(high) + headroom * span)
    return float(low) - 0.13 * span


def _fit(axis: Axes, told: Told) -> None:
    held = told.diagnosis.heldout
    rows = (
        ("given", held.given, QUIET),
        ("calibrated", held.calibrated, MODEL),
        ("improved", held.improved, FOUND),
    )
    for k, (_, value, colour) in enumerate(rows):
        axis.barh(k, 1e3 * value, color=colour, height=0.6)
        axis.text(1e3 * value, k, f" {1e3 * value:.3g}", va="center", fontsize=11)
    if held.calibrated > held.given:
        axis.text(
            0.97 * 1e3 * held.calibrated, 1, BENT, fontsize=8, va="center", ha="right",
            color="white",
        )
    floor = 1e3 * told.diagnosis.noise_floor
    axis.axvline(floor, color="0.2", lw=1.0, ls="--")
    axis.text(floor, 2.62, " noise floor", fontsize=8, va="center", color="0.2")
    axis.set_yticks(range(len(rows)), [name for name, _, _ in rows])
    axis.set_ylim(2.8, -0.5)
    axis.set_xscale("log")
    _plain_decades(axis.xaxis)
    low, high = min(floor, 1e3 * held.improved), 1e3 * max(held.given, held.calibrated)
    axis.set_xlim(0.6 * low, 2.5 * high)
    axis.grid(False, axis="y")
    axis.set_xlabel(
        f"error of free simulation over 0.25 s on the held-out recording (m{_unit(told)})"
    )
    axis.set_title("The fit, on a motion it has not seen", loc="left")
