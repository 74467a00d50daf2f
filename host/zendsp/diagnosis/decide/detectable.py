"""What these recordings would have shown: for each joint and mechanism the smallest effect that the
decision would have claimed.

An effect of some size leaves its trace in the innovations of the model that was found; what the
calibrated parameters can imitate is taken out of it. From the trace's energy in the recordings to
test on follows the evidence that an effect of that size would have had there, and from its torque
whether it would have stood out of the discrepancy, and been named: the smallest size that passes
all of these is stated.
The decision itself is not run again for every size; ``zendsp prove --implant`` measures how well
the figures hold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import LAWS_OF, Decision
from zendsp.diagnosis.decide.confidence import least_stated
from zendsp.diagnosis.decide.pieces import dependence, finest, kept_laws, torque_of
from zendsp.diagnosis.decide.result import Detectable
from zendsp.diagnosis.decide.thresholds import FALSE_DISCOVERIES, LAW_ERROR, LEFT_BY_A_LAW
from zendsp.diagnosis.measure.discrepancy import BANDS, as_torque, band_of, kept, mean_square
from zendsp.diagnosis.search.screen import Screen
from zendsp.physics.calibration.fit import Data, fit
from zendsp.physics.calibration.terms import grid_of, make_term, usable
from zendsp.physics.effects import get_effect, library, mechanism_of, unit_of
from zendsp.physics.model import Model

POWER = 1.28  # standard deviations: nine in ten
HELD = 1.0  # of the RMS torque: an effect that is larger is not in these recordings
GRID = 12  # points of an effect's grid at most; of them the one that is seen worst is stated


def detectable(
    parts: Parts, given: Model, decisions: Sequence[Decision], jobs: int
) -> tuple[Detectable, ...]:
    """The smallest effects that would have been found.

    Parameters
    ----------
    parts : Parts
    given : Model
    decisions : sequence of Decision
    jobs : int

    Returns
    -------
    tuple of Detectable
        One for each joint and ``sized`` effect that the joint does not have yet.
    """
    out = []
    for decision in decisions:
        out += _joint(parts.test, given, decision, jobs)
    return tuple(out)


def _joint(test: Data, given: Model, decision: Decision, jobs: int) -> list[Detectable]:
    joint, final = decision.joint, decision.final
    data = test.at_bandwidth(joint, final.data.bandwidth[joint - 1])
    result = fit(data, final.model, final.fit.handles, joints=(joint,), iterations=0, jobs=jobs)
    screen = Screen(data, result, joint, (joint,))
    variance = float(result.residual @ result.residual) / max(len(result.residual), 1)
    variance *= dependence(final, test, joint)
    needed = math.log(test.joints * len(LAWS_OF) / FALSE_DISCOVERIES)
    # a gain of G = |c|² s² / σ² is 2 log e in the mean, with standard deviation 2 √G
    root = POWER + math.sqrt(POWER**2 + 2.0 * needed)
    after = decision.after.value
    sized = [effect for effect in library().values() if effect.sized]
    kinds = {mechanism_of(effect.name) for effect in sized}
    # what the model's own laws of the kind may be wrong by, where a law by itself leaves too much
    laws = {m: kept_laws(given, final.model, joint, m) for m in kinds}
    error = {m: LAW_ERROR * torque_of(test, laws[m], final.model, joint) for m in kinds}
    scale = math.sqrt(mean_square(test, joint))
    have = {t.effect for t in final.model.at(joint)}
    out = []
    for effect in sized:
        name = effect.name
        if (name in have and not effect.repeatable) or not usable(effect, screen.records):
            continue
        if any(key in given.mechanism for key in effect.same_as):
            continue
        beyond = min(math.hypot(after, error[mechanism_of(name)]), after / LEFT_BY_A_LAW)
        beyond = max(after, beyond, least_stated(name, decision), finest(name))
        size = _smallest(screen, name, variance, root, beyond, scale)
        if size is None:
            continue
        key = effect.linear[0] if effect.linear else effect.parameters[0].name
        parameter = effect.parameter(key)
        unit = unit_of(
            parameter.size,
            given.joint_kind(joint),
            given.actuator.unit,
            given.torque_unit(joint),
        )
        out.append(Detectable(joint, mechanism_of(name), name, size[0], unit, size[1]))
    return out


def _smallest(
    screen: Screen, name: str, variance: float, root: float, beyond: float, scale: float
) -> tuple[float, float] | None:
    """Size, and the torque that it makes as a part of the RMS torque; None where the recording
    shows nothing of it at all.
    """
    effect = get_effect(name)
    points = grid_of(effect, screen.records[0], screen.model) or [{}]
    points = points[:: max(1, len(points) // GRID)]
    worst: tuple[float, float] | None = None
    for point in points:
        values = screen._directions(effect, point)[0]
        key = effect.linear[0] if effect.linear else effect.parameters[0].name
        unit = values.get(key, 1.0) or 1.0
        term = make_term(effect, screen.joint, {**values, key: unit})
        column = screen.series([(term,)])[0] / unit
        whole = _torque(screen, column) / scale
        column = column - screen.q @ (screen.q.T @ column)
        energy = float(column @ column)
        if energy <= 0:
            return None
        torque = _torque(screen, column) / scale
        size = max(root * math.sqrt(variance / energy), beyond / max(torque, 1e-300))
        if size * whole > HELD:  # more than the recording holds: it shows nothing of it
            return None
        if worst is None or size > worst[0]:
            worst = size, size * torque
    return worst


def _torque(screen: Screen, column: np.ndarray) -> float:  # type: ignore[type-arg]
    """RMS torque of a trace in the innovations, N m or N."""
    total, count, at = 0.0, 0, 0
    for record in screen.records:
        here = band_of(record, screen.bandwidth)
        part = as_torque(record, screen.model, column[at : at + record.n], here)[
            kept(record, min(here, BANDS[0]))
        ]
        total += float(part @ part)
        count += len(part)
        at += record.n
    return math.sqrt(total / max(count, 1))
