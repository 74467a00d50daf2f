"""What a law's own variable can draw of another torque.

A law that is wrong leaves a function of its own variable. A small mechanism that depends on another
one, of which the motion makes no function of the law's, is not what the law leaves.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.measure.curve import FRICTION
from zendsp.diagnosis.measure.discrepancy import resisting
from zendsp.diagnosis.measure.structure import (
    MEMORY,
    ROWS,
    Ranges,
    ranges_of,
    shapes,
    splines,
    unit,
)
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.calibration.observed import trace
from zendsp.physics.effects import Effect, get_effect
from zendsp.physics.model import Model, Quantity, Term

Array = npt.NDArray[np.float64]
# of a function of the variable, as of one of the position in ``structure``
CURVE_PIECES = 14
THIRDS = 3  # each is predicted from the two others, as in ``structure``


def drawn_by_its_variable(data: Data, model: Model, law: Term, other: Term) -> float:
    """The part of a term's energy along recordings that functions of a law's own variable predict,
    each third of the time from the others; 1 where the law has no such variable, or the term is no
    function of the state.

    The variable of a friction is the position or the speed, with the direction; that of a time is
    the motion before. A friction that varies along the travel is no function of the speed, as a
    Stribeck curve is, if the joint passes the same places at different speeds.
    """
    one, more = get_effect(law.effect), get_effect(other.effect)
    if not _of_state(more) or not (_of_state(one) or one.family == "timing"):
        return 1.0
    records = [rec[law.joint - 1] for rec in data.records]
    known = resisting(records[0], model).known
    key = "own variable", len(records), one.name, id(other)
    if key not in known:
        # with the term, so that no other gets its id
        known[key] = other, _predicted(data, one, model, other)
    part: float = known[key][1]
    return part


def _of_state(effect: Effect) -> bool:
    """Whether an effect is a function of the position or the speed, and of the direction."""
    plain = not (effect.hidden or effect.coupled)
    of_these = effect.mechanism in ("position_torque", *FRICTION)
    return plain and of_these and effect.over in ("position", "velocity")


def _predicted(data: Data, law: Effect, model: Model, term: Term) -> float:
    """The predicted part of the term's energy."""
    joint, ranges = term.joint, ranges_of(data, term.joint)
    stride = max(1, sum(rec[joint - 1].n for rec in data.records) // ROWS)
    drawn, torques = [], []
    for rec in data.records:
        record = rec[joint - 1]
        remembers = law.family == "timing"
        curve = shapes(rec, joint, MEMORY, ranges) if remembers else _curve(record, law, ranges)
        drawn.append(curve[:, ::stride])
        torques.append(_torque(record, model, term)[::stride])
    a, b = np.concatenate(drawn, axis=1), np.concatenate(torques)
    energy = float(b @ b)
    if not energy > 0.0:
        return 1.0
    left = 0.0
    for part in np.array_split(np.arange(len(b)), THIRDS):
        others = np.ones(len(b), bool)
        others[part] = False
        theta = np.linalg.lstsq(a[:, others].T, b[others], rcond=None)[0]
        left += float(np.sum((b[part] - theta @ a[:, part]) ** 2))
    return min(max(1.0 - left / energy, 0.0), 1.0)


def _torque(record: JointRecord, model: Model, term: Term) -> Array:
    """The torque of a term, (n,); of a law with a number for each direction, in which they differ,
    as their mean is the law that it has replaced.
    """
    plain = get_effect(term.effect).symmetric
    if not plain:
        return trace(record, model, (term,), 0.0)
    number = get_effect(plain).parameters[0].name
    mean = sum(q.value for q in term.parameters.values()) / len(term.parameters)
    both = trace(record, model, (Term(plain, term.joint, {number: Quantity(mean)}),), 0.0)
    return trace(record, model, (term,), 0.0) - both


def _curve(record: JointRecord, law: Effect, ranges: Ranges) -> Array:
    """Functions of a law's own variable, (columns, n)."""
    q, v, _ = record.motion.states
    if law.over == "position":
        curve = splines(unit(q, ranges.position), CURVE_PIECES)
    else:  # finer where it is slow
        curve = splines(np.sqrt(np.clip(np.abs(v) / ranges.speed, 0.0, 1.0)), CURVE_PIECES)
    if law.symmetric:  # with a number for each direction
        return np.concatenate([curve * (v > 0.0), curve * (v <= 0.0)])
    return np.asarray(curve * np.sign(v) if law.mechanism in FRICTION else curve)
