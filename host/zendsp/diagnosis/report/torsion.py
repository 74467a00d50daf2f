"""The figure of a transmission measured by two sensors: its torsion over torque, position or speed,
without the law and with it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.decide.findings import Finding
from zendsp.diagnosis.decide.result import Diagnosis, Workings
from zendsp.diagnosis.measure.curve import Axis, Curve, Samples, binned
from zendsp.diagnosis.measure.discrepancy import ENERGY_BLOCK
from zendsp.diagnosis.report.chart import Chart
from zendsp.diagnosis.report.curve_panels import two_panels
from zendsp.diagnosis.report.sides import units_at
from zendsp.diagnosis.transmission.findings import measured
from zendsp.diagnosis.transmission.motor_side import joint_inertia, with_motor_torque
from zendsp.diagnosis.transmission.torsion import (
    OF_BODIES,
    OF_MOTOR,
    Twist,
    has_bodies,
    lowpass,
    twists,
)
from zendsp.diagnosis.transmission.torsion_fit import Linear, columns_of, regress, wave

Array = npt.NDArray[np.float64]
TERMS = {  # the part of the torsion that each law explains
    "elasticity": ("spring",),
    "stiffening": ("spring", "cubic"),
    "backlash": ("gap",),
    "hysteresis": ("step",),
}


def torsion_chart(d: Diagnosis, w: Workings, finding: Finding, index: int) -> Chart | None:
    """What does the torsion look like, and what stays unexplained? None where no recording of the
    fit shows it.
    """
    joint, model = finding.joint, w.whole.calibrated
    if any("position_load" not in rec[joint - 1].columns for rec in w.train.records):
        return None
    period = 2 * np.pi / _order(finding) if finding.effect == "transmission_error" else 0.0
    parts = twists(w.train, model, joint)
    if not period:  # which may pass too fast for the load to follow its motor stiffly
        parts = [lowpass(t, OF_BODIES if has_bodies(model) else OF_MOTOR) for t in parts]
    columns_there = w.train.records[0][joint - 1].columns
    if not period and not has_bodies(model) and "torque_measured" not in columns_there:
        parts, _, _ = with_motor_torque(parts, (), joint_inertia(w.train, model, joint), False)
    scale = float(np.sqrt(np.mean(np.concatenate([t.torque for t in parts]) ** 2)))
    named = {f.effect: f for f in d.findings if f.joint == joint}
    others = [f for f in named.values() if f.effect != finding.effect and measured(f)]
    columns, own = [], 0
    for t in parts:
        first = _columns(t, finding, scale)
        own = first.shape[1]
        columns.append(np.hstack([first, *(_columns(t, f, scale) for f in others)]))
    fit, columns = _fitted(parts, columns, finding, scale)
    laws = [matrix[:, :own] @ fit.x[:own] for matrix in columns]
    stepping = finding.effect == "hysteresis" and not _late(finding)
    variable = "position" if period else "velocity" if stepping else "torque"
    x = np.concatenate([_over(t, variable) for t in parts])
    x = np.mod(x, period) if period else x
    block, first_block = [], 0
    for t in parts:
        seconds = np.flatnonzero(t.kept) * t.sample_time
        block.append(first_block + (seconds / ENERGY_BLOCK).astype(int))
        first_block = int(block[-1][-1]) + 1
    law, left = np.concatenate(laws), np.concatenate(fit.residual)
    curves = [
        _curve(variable, Samples(x, y, np.ones(len(x)), np.concatenate(block)))
        for y in (law, law + left, left)
    ]
    units = units_at(d, joint)
    unit = units["position"]
    along = f"position within a period of {period:.4g} {unit} [{unit}]" if period else ""
    chart = two_panels(d, finding, index, curves, (f"without {finding.effect}", "with it"), unit)
    return replace(
        chart,
        title=f"Joint {joint}: torsion, the load's sensor less the motor's",
        panels=tuple(
            replace(p, ylabel=f"torsion [{unit}]", xlabel=along or p.xlabel) for p in chart.panels
        ),
    )


def _fitted(
    parts: list[Twist], columns: list[Array], finding: Finding, scale: float
) -> tuple[Linear, list[Array]]:
    """The torsion regressed on some columns, and the columns; with those of an eccentric disc where
    the stated compliance was found beside one.
    """
    plain = regress(parts, columns, off_centre=False)
    stated = finding.numbers.get("details", {}).get("compliance")
    if stated is None:
        return plain, columns
    beside = [
        np.hstack([c, columns_of(t, ("disc",), scale)])
        for c, t in zip(columns, parts, strict=True)
    ]
    disc = regress(parts, beside, off_centre=False)
    off = [abs(stated + fit.x[0]) for fit in (plain, disc)]
    return (disc, beside) if off[1] < off[0] else (plain, columns)


def _curve(variable: str, samples: Samples) -> Curve:
    return Curve(Axis(variable), samples, *binned(samples), against=False)


def _order(finding: Finding) -> float:
    return max(finding.parameters["order"].value, 1e-300)


def _late(finding: Finding) -> bool:
    """Whether a hysteresis follows the torque, not the direction of motion."""
    return "torque" in finding.numbers.get("details", {})


def _columns(t: Twist, finding: Finding, scale: float) -> Array:
    if finding.effect == "transmission_error":
        return wave(t, _order(finding))
    terms = ("loop",) if _late(finding) else TERMS.get(finding.effect, ())
    matrix = columns_of(t, terms, scale)
    return matrix[:, :1] if finding.effect == "elasticity" else matrix


def _over(t: Twist, variable: str) -> Array:
    """The informative rows of a variable."""
    return {"torque": t.torque, "position": t.q, "velocity": t.qd}[variable][t.kept]
