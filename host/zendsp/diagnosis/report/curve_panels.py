"""Panels of a torque over its variable: samples, means with their errors, and the law."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.decide.findings import Finding
from zendsp.diagnosis.decide.result import Diagnosis
from zendsp.diagnosis.measure.curve import Curve, Samples
from zendsp.diagnosis.report.chart import Chart, Panel, Series
from zendsp.diagnosis.report.sides import torque_label, units_at

Array = npt.NDArray[np.float64]
DOTS = 4000  # of a panel
CONTRADICTS = 4.0  # standard errors: what is further away contradicts a law, or a mean
LITTLE = 0.1  # of a law: a smaller difference from it is not mentioned
BRIDGED = 3.5  # widths of a bin that a line may cross: two empty bins, and rounding


def law_name(finding: Finding, index: int) -> str:
    """The file name of a law's figure; ``index`` is that of the finding, from 0."""
    return f"law_{index + 1}_{finding.effect}_joint{finding.joint}"


def two_panels(
    d: Diagnosis,
    finding: Finding,
    index: int,
    curves: Sequence[Curve],
    titles: tuple[str, str],
    unit: str = "",
) -> Chart:
    """The chart of three curves, without a title: the law, the missing torque without it, and with
    it.

    Parameters
    ----------
    unit : str
        Unit of the curves; that of the joint's torque where empty.
    """
    joint, law = finding.joint, curves[0]
    line = Series("line", "law", *broken(law.at, law.mean), f"{finding.effect}, as found")
    panels = [
        curve_panel(d, joint, curve, role, title, *lines)
        for curve, role, title, lines in zip(
            curves[1:], ("before", "after"), titles, ((line,), ()), strict=True
        )
    ]
    limits = common_limits(panels)
    unit = unit or units_at(d, joint)["torque"]
    return Chart(
        "law",
        finding.sentence,
        law_name(finding, index),
        tuple(replace(p, limits=limits) for p in panels),
        beside=True,
        same=True,
        size=(7.2, 3.2),
        finding=index,
        joint=joint,
        note=beside_the_law(law, curves[2], panels[0].xlabel, unit),
    )


def broken(at: Array, mean: Array) -> tuple[Array, Array]:
    """A line over bins, with NaN where it would cross more than two empty bins."""
    apart = np.diff(at)
    gaps = np.flatnonzero(apart > BRIDGED * np.min(apart, initial=np.inf)) + 1
    return np.insert(at, gaps, at[gaps - 1]), np.insert(mean, gaps, np.nan)


def beside_the_law(law: Curve, after: Curve, xlabel: str, unit: str) -> str:
    """A sentence on whether the means lie on the law; bars are their standard errors."""
    size = np.sqrt(np.mean(law.mean**2)) if len(law.mean) else 0.0
    apart = np.abs(after.mean) / np.maximum(after.spread, 1e-300)
    beside = (apart > CONTRADICTS) & (np.abs(after.mean) > LITTLE * size)
    if not beside.any():
        bars, most = "Bars are standard errors", math.ceil(np.max(apart, initial=0.0))
        if most > CONTRADICTS:
            return f"{bars}: what lies beside the law is less than a tenth of it."
        return f"{bars}: the means lie on the law within {f'{most} of ' if most > 1 else ''}them."
    k = int(np.argmax(np.where(beside, np.abs(after.mean), 0.0)))
    what, of = _what_of(xlabel)
    at = f"{what} {after.at[k]:.2g} {of}".rstrip()
    return (
        f"Beside the law something is left: {abs(after.mean[k]):.2g} {unit} at {at},"
        f" {apart[k]:.0f} standard errors (the bars)."
    )


def off_the_means(curve: Curve, size: float, xlabel: str, unit: str) -> str:
    """A sentence on dots that lie off their means by more than their noise, as branches of a loop
    do, where they do most; "" where none do.

    Parameters
    ----------
    size : float
        Of the torque that is shown, RMS: a smaller part of it is not mentioned.
    """
    s, at = curve.samples, curve.at
    if len(at) < 2:
        return ""
    near = np.searchsorted(0.5 * (at[1:] + at[:-1]), s.x)
    weight = s.weight * (np.abs(s.x - at[near]) <= 0.51 * np.diff(at).min())
    apart = (s.torque - np.interp(s.x, at, curve.mean)) ** 2
    energy, total, count = (
        np.bincount(near, w, len(at)) for w in (weight * apart, weight, weight > 0.0)
    )
    scatter = np.sqrt(energy / np.maximum(total, 1e-300))
    k = int(np.argmax(np.where(energy > CONTRADICTS**2 * count, scatter, 0.0)))
    if not energy[k] > CONTRADICTS**2 * count[k] or scatter[k] < LITTLE * size:
        return ""
    what, of = _what_of(xlabel)
    where = 0.0 if abs(at[k]) < 1e-9 * np.ptp(at) else at[k]
    return (
        f" Dots lie off the means, by {scatter[k]:.2g} {unit} (RMS) at {what} {where:.2g} {of}:"
        f" that torque depends on more than the {what}, or passes too fast to be followed."
    ).replace("  ", " ")


def _what_of(xlabel: str) -> tuple[str, str]:
    """Variable and unit of an axis' label."""
    what, _, of = xlabel.rstrip("]").partition(" [")
    return what, of


def curve_panel(
    d: Diagnosis, joint: int, curve: Curve, role: str, title: str, *lines: Series
) -> Panel:
    """The panel of a curve: samples and means."""
    units = units_at(d, joint)
    label = torque_label(units["torque"])
    dots = _as_they_count(curve.samples)
    series = (
        Series("dots", "data", dots.x, dots.torque),
        Series("means", role, curve.at, curve.mean, f"{title}: means", curve.spread),
        *lines,
    )
    return Panel(
        f"{curve.axis} [{units[curve.axis.variable]}]",
        label.replace(" [", " against the motion [") if curve.against else label,
        series,
        title,
    )


def _as_they_count(samples: Samples) -> Samples:
    """A selection of the samples, in proportion to their weight."""
    order = np.cumsum(samples.weight)
    at = np.linspace(0.0, order[-1], DOTS, endpoint=False)
    some = np.unique(np.searchsorted(order, at, side="right"))
    some = some[some < len(order)]
    s = samples
    return Samples(s.x[some], s.torque[some], s.weight[some], s.block[some])


def common_limits(panels: Sequence[Panel]) -> tuple[float, float]:
    """Limits for panels with the same axes: they hold all means with usual error bars, the whole
    law, and all but a few dots.
    """
    shown: list[npt.NDArray[np.floating[Any]]] = []
    for panel in panels:
        for s in panel.series:
            if s.kind == "dots":
                shown += [np.quantile(s.y, [0.01, 0.99])] if len(s.y) else []
            elif s.spread is None or not len(s.y):
                shown.append(s.y)
            else:
                bar = np.minimum(s.spread, 3.0 * np.median(s.spread))
                shown += [s.y - bar, s.y + bar]
    values = np.concatenate(shown)
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (-1.0, 1.0)
    room = 0.08 * (high - low) or 1.0
    return low - room, high + room
