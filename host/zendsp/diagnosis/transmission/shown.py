"""What two sensors show of a transmission, claimed or not: its compliance, its hysteresis, and the
least of both that would have been claimed.

Torsion is regressed on the torque and on the direction of motion together, with all recordings.
Where a turn was not completed, it is so with and without an eccentric disc, which may stand for a
torque over the position that the model lacks, too; how far the two differ is in what is stated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zendsp.diagnosis.decide.claims import needed
from zendsp.diagnosis.decide.findings import Estimate, number
from zendsp.diagnosis.decide.result import Detectable
from zendsp.diagnosis.transmission.claims import AS_EFFECT, unexplained
from zendsp.diagnosis.transmission.sets import Sets, compliance_unit
from zendsp.diagnosis.transmission.terms import fitted, may_be_off
from zendsp.diagnosis.transmission.torsion import Twist, lowpass
from zendsp.diagnosis.transmission.torsion_fit import columns_of, numbers_of, rms
from zendsp.physics.model import Model

POWER = 1.28  # standard deviations: for a chance of nine in ten
STATED = "spring", "step"
KINDS = {"spring": "compliance", "step": "hysteresis"}
WIDTH = 2.0  # a hysteresis is stated by its full width


@dataclass(frozen=True)
class Shown:
    """Compliance, rad/(N m) or m/N, and full width of a hysteresis, rad or m, by their terms."""

    values: dict[str, Estimate]
    least: dict[str, Estimate]  # that would have been claimed

    def unclaimed(self, joint: int, found: Sequence[str]) -> tuple[str, tuple[Detectable, ...]]:
        """A sentence on what is not among the ``found`` terms, and what would have been seen."""
        rest = [t for t in STATED if t not in found]
        seen = (
            Detectable(joint, "transmission", AS_EFFECT[t], e.value, e.unit, 0.0)
            for t, e in self.least.items()
            if t in rest
        )
        values = " and ".join(f"a {KINDS[t]} of {number(self.values[t])}" for t in rest)
        least = " and ".join(f"{self.least[t].value:.2g} {self.least[t].unit}" for t in rest)
        text = f"joint {joint}: its two sensors show {values}, not surely; {least} would be sure"
        return text, tuple(seen)


def shown(slow: Sets, scale: float, model: Model, joint: int) -> Shown:
    """The numbers of a joint from its torsion without lag and errors over the angle; ``scale`` is
    `torque_scale`.
    """
    parts = [slow.fit, slow.choose] + ([slow.test] if slow.test is not slow.choose else [])
    rows = [t for part in parts for t in _once(part)]
    discs = (False, True) if may_be_off(slow) else (False,)
    fits = [fitted(rows, STATED, off, scale) for off in discs]
    best = min(fits, key=lambda f: rms(f.residual))
    units = {"spring": compliance_unit(model, joint), "step": _unit(model, joint)}
    values, least = {}, {}
    for term in STATED:
        per = WIDTH if term == "step" else 1.0
        value, std = numbers_of(STATED, best, scale)[term]
        others = [numbers_of(STATED, f, scale)[term][0] - value for f in fits]
        spread = math.hypot(std, max(map(abs, others)) / 2.0)
        values[term] = Estimate(-per * value, per * spread, units[term])
        size = max(_least(slow, term, off, scale, model) for off in discs)
        least[term] = Estimate(per * size, 0.0, units[term])
    return Shown(values, least)


def misread(raw: Sets, band: float, model: Model, joint: int) -> str:
    """What the sensors would show if the lag of one were left in: a compliance and a hysteresis."""
    parts = [lowpass(t, band) for t in raw.fit]
    columns = [np.stack([t.torque, t.extra["direction"]], axis=1)[t.kept] for t in parts]
    a = np.concatenate([c - c.mean(axis=0) for c in columns])
    y = np.concatenate([t.torsion[t.kept] - t.torsion[t.kept].mean() for t in parts])
    norms = np.linalg.norm(a, axis=0)
    spring, step = np.linalg.lstsq(a / np.where(norms > 0, norms, 1.0), y, rcond=1e-9)[0] / norms
    return (
        f"a compliance of {-spring:.2g} {compliance_unit(model, joint)} and a hysteresis of"
        f" {-WIDTH * step:.2g} {_unit(model, joint)}"
    )


def _once(part: Sequence[Twist]) -> list[Twist]:
    """The rows of a part that are evidence: two parts of one recording hold the same rows."""
    return [replace(t, kept=t.kept & t.judging) for t in part]


def _unit(model: Model, joint: int) -> str:
    return "m" if model.joint_kind(joint) == "linear" else "rad"


def _least(slow: Sets, term: str, off: bool, scale: float, model: Model) -> float:
    """The smallest size of a term that would have been claimed, with 90 % probability."""
    alone = fitted(slow.test, (term,), off, scale)
    nothing = fitted(slow.test, (), off, scale)
    ones = [columns_of(t, (term,), scale)[:, 0] for t in slow.test]
    units = []
    for twist, column in zip(slow.test, ones, strict=True):
        torsion = np.zeros_like(twist.q)
        torsion[twist.kept] = column
        units.append(replace(twist, torsion=torsion))
    size = max(rms(fitted(units, (), off, scale).residual), 1e-300)
    count = sum(len(r) for r in alone.residual)
    error = math.hypot(
        math.sqrt(float(alone.covariance[0, 0])),
        max(t.noise for t in slow.test) / (size * math.sqrt(count)),
    )
    root = POWER + math.sqrt(POWER**2 + 2.0 * needed(model.joints))
    left = unexplained(nothing.residual, slow.test)
    return max(root * error, left / size)
