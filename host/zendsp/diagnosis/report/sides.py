"""The two models that a figure compares, and the observer under which they differ most clearly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zendsp.diagnosis.decide.assemble import Assembled
from zendsp.diagnosis.decide.findings import Finding, torque_word
from zendsp.diagnosis.decide.result import Diagnosis
from zendsp.diagnosis.measure.discrepancy import BANDS
from zendsp.diagnosis.measure.where import Missing, mismatch
from zendsp.diagnosis.transmission.findings import measured
from zendsp.physics.calibration.fit import Data
from zendsp.physics.effects import library
from zendsp.physics.model import Model


@dataclass(frozen=True)
class Sides:
    """Two models of a joint that a figure compares, in kernel form; the same where nothing was
    found.

    Attributes
    ----------
    was, now : str
        Labels of their lines.
    lacking : str
        What a title calls ``before``, the model that lacks something.
    by_law : bool
        Whether ``before`` is ``after`` without one law.
    """

    before: Model
    after: Model
    was: str
    now: str
    lacking: str = "calibrated model"
    by_law: bool = False


def sides(findings: Sequence[Finding], given: Model, whole: Assembled, joint: int) -> Sides:
    """The calibrated and the improved model; the given and the calibrated one, for a joint at which
    only given numbers were wrong; the calibrated one alone, where no physics is claimed.

    Parameters
    ----------
    given : Model
        In kernel form, as those of ``whole``.
    """
    if all(f.effect == "disturbance" for f in findings):  # which no model predicts
        return Sides(whole.calibrated, whole.calibrated, "calibrated", "calibrated")
    here = [f for f in findings if f.joint == joint]
    if here and all(_absorbed(whole.improved, f) for f in here):
        return as_given(given, whole.improved)
    return Sides(whole.calibrated, whole.improved, "calibrated", "improved")


def as_given(given: Model, improved: Model) -> Sides:
    """The model with its given numbers, and with those that calibration found."""
    return Sides(given, improved, "as given", "calibrated", lacking="model as given")


def _absorbed(improved: Model, finding: Finding) -> bool:
    """Whether calibration absorbed a finding: it has a law but no term in the improved model. False
    for findings by two sensors on a transmission, which have no torque, and for a load of the
    held-out recordings only.
    """
    terms = [t for t in improved.at(finding.joint) if t.effect == finding.effect]
    elsewhere = measured(finding) or "recordings" in finding.numbers
    return finding.effect in library() and not terms and not elsewhere


def units_at(d: Diagnosis, joint: int) -> dict[str, str]:
    """Unit of each variable at a joint."""
    q = "m" if d.given.joint_kind(joint) == "linear" else "rad"
    force = d.given.torque_unit(joint)
    return {
        "position": q,
        "velocity": f"{q}/s",
        "speed": f"{q}/s",
        "acceleration": f"{q}/s²",
        "command": d.given.actuator.command_unit or force,
        "time": "s",
        "torque": force,
    }


def torque_label(unit: str) -> str:
    """The label of an axis for torques."""
    return f"{torque_word(unit)} [{unit}]"


def clearest(data: Data, two: Sides, joint: int) -> tuple[float, list[Missing], list[Missing]]:
    """The fastest observer for which the difference of two models (or what a single one lacks)
    exceeds the noise, or else the one for which it is clearest: its band, rad/s, and what each
    model lacks.
    """
    best = -math.inf
    for band in BANDS:
        before, after = (mismatch(data, model, joint, band) for model in (two.before, two.after))
        alone = two.before is two.after
        law = before if alone else between(before, after)
        energy = sum(float(np.sum(m.weight * m.torque**2)) for m in law)
        count = sum(np.count_nonzero(m.weight) for m in law)
        clear = energy / max(count, 1) - alone  # to that of the noise, which two models share
        if clear > best:
            best, found = clear, (band, before, after)
        if clear > 1.0:
            break
    return found


def between(before: Sequence[Missing], after: Sequence[Missing]) -> list[Missing]:
    """The torque between two models with the uncertainty of both."""
    return [
        replace(a, torque=a.torque - b.torque, std=np.hypot(a.std, b.std))
        for a, b in zip(before, after, strict=True)
    ]
