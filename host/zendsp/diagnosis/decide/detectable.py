"""The smallest effect that these recordings would have shown, for each joint and mechanism.

An effect leaves a trace in the innovations of the final model, less what calibration absorbs of it.
The trace's energy in the test recordings gives the evidence. Its torque decides whether it exceeds
the discrepancy and would be named. The smallest size that passes all of these is stated.

A first size comes from a linear estimate. An effect of that size is then implanted and judged as
the decision judges: calibrated numbers and observer are fitted without it to the recordings of the
fit, and the test recordings have to miss it. Of the phases of a wave, or the neutral positions of a
spring, the worst one counts. The search is not repeated for every size; ``zendsp prove --implant``
measures how well the figures hold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.checks import never_reverses
from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.confidence import least_stated
from zendsp.diagnosis.decide.contract import Verdict, is_stepped
from zendsp.diagnosis.decide.findings import CLOCK
from zendsp.diagnosis.decide.implants import (
    AMPLE,
    NOT_SEEN,
    NOT_SMALL,
    Implant,
    set_numbers,
    size_of,
)
from zendsp.diagnosis.decide.law_torque import kept_laws, torque_of
from zendsp.diagnosis.decide.moved import friction_moved
from zendsp.diagnosis.decide.patchwork import part_of_a_wave
from zendsp.diagnosis.decide.pieces import finest
from zendsp.diagnosis.decide.result import Detectable
from zendsp.diagnosis.decide.thresholds import (
    LAW_ERROR,
    LEFT_BY_A_LAW,
    SURE,
)
from zendsp.diagnosis.measure.curve import FRICTION
from zendsp.diagnosis.measure.discrepancy import (
    BANDS,
    as_torque,
    band_of,
    kept,
    mean_square,
    unseen_commands,
)
from zendsp.diagnosis.measure.significance import essence_of
from zendsp.diagnosis.search.screen import FIRST_ORDER, Screen, phase_of
from zendsp.physics.calibration.bounds import parameter_bounds
from zendsp.physics.calibration.fit import NEAR, Data, Fit, fit
from zendsp.physics.calibration.joint import JointRecord, facts
from zendsp.physics.calibration.terms import grid_of, make_term, usable
from zendsp.physics.effects import (
    Effect,
    get_effect,
    is_supported,
    library,
    mechanism_of,
    unit_of,
)
from zendsp.physics.model import Model, Term

Array = npt.NDArray[np.float64]

# of the best determined combination of calibrated numbers: one less determined absorbs nothing.
# Chosen
TOLD = 1e-6
# numbers of a law beside its size, phase and neutral point: the worst of each is stated
SHAPES = ("order", "period", "time_constant", "velocity")
GRID = 12  # points of an effect's grid at most; the worst of them is stated
# neutral points of a cubic spring along the travel. Of three the worst had a size of which 1.3
# times was too small to be told at a fourth (an examiner's case, four times of four). Of nine the
# worst was 12 % too small in a test, of seventeen less than a tenth
NEUTRALS = 17


def detectable(
    parts: Parts, given: Model, decisions: Sequence[Decision], jobs: int
) -> tuple[Detectable, ...]:
    """The smallest effects that would have been found.

    Returns
    -------
    tuple of Detectable
        One for each joint and ``sized`` effect that the joint does not have yet; of infinite size
        where even a large one would not have been found.
    """
    out = []
    for decision in decisions:
        out += _joint(parts, given, decision, jobs)
    return tuple(out)


def blind(
    parts: Parts, given: Model, decisions: Sequence[Decision], seen: Sequence[Detectable]
) -> list[Decision]:
    """The decisions, with all torque possibly unexplained at a complete joint where neither a
    friction nor a torque over position would have been seen, however large; or where calibration
    moved a given friction and no dry friction would have been seen, since the joint moves one way:
    the number may stand for one.
    """
    kinds = {*FRICTION, "position_torque"}
    shown = {x.joint for x in seen if x.mechanism in kinds and x.is_shown}
    dry = {x.joint for x in seen if x.effect == "coulomb" and x.is_shown}

    def hidden(d: Decision) -> bool:
        one_way = never_reverses(parts.fit, d.joint) and d.joint not in dry
        return d.joint not in shown or (one_way and friction_moved(given, d.final.model, d.joint))

    return [
        replace(d, after=replace(d.after, high=1.0))
        if d.kind == Verdict.COMPLETE and hidden(d)
        else d
        for d in decisions
    ]


def _joint(parts: Parts, given: Model, decision: Decision, jobs: int) -> list[Detectable]:
    test, joint, final = parts.test.within_limits_of(parts.fit), decision.joint, decision.final
    result, screen = _screened(test, decision, jobs)
    found, sought = _screened(parts.fit, decision, jobs)
    implant = Implant(parts, given, decision, jobs)
    after = max(decision.after.value, decision.after.often)
    # a joint that nothing drives has no actuator, and no transmission between a motor and itself
    never = ("actuator", "transmission") if joint in parts.undriven else ()
    sized = [e for e in library().values() if e.sized and mechanism_of(e.name) not in never]
    other = {names: implant.other(names) for names in {effect.aliases for effect in sized}}
    traces = {n: _Traces(sought, found, screen, result, terms) for n, terms in other.items()}
    kinds = {mechanism_of(effect.name) for effect in sized}
    # the error of the model's own laws of the kind, or what a law alone may leave
    laws = {m: kept_laws(given, final.model, joint, m) for m in kinds}
    error = {m: LAW_ERROR * torque_of(test, laws[m], final.model, joint) for m in kinds}
    scale = math.sqrt(mean_square(test, joint))
    unknown = unseen_commands(test, final.model, joint)
    have = {t.effect for t in final.model.at(joint)}
    out = []
    for effect in sized:
        name = effect.name
        if (name in have and not effect.repeatable) or not usable(effect, screen.records):
            continue
        if any(key in given.mechanism for key in (name, *effect.same_as)):
            continue
        beyond = min(math.hypot(after, error[mechanism_of(name)]), after / LEFT_BY_A_LAW)
        unseen = unknown if is_stepped(name) else 0.0
        beyond = max(after, beyond, unseen, least_stated(name, decision), finest(name, given))
        stands = is_supported(effect, have)  # or no search tries it
        trace = traces[effect.aliases]
        term = _smallest(trace, name, implant.energy, beyond * scale) if stands else None
        size, torque = _worst(implant, effect, term, beyond, screen.records[0])
        least = _least(effect, screen.records[0])
        size, torque = max(size, least), torque * max(1.0, least / size)
        parameter = effect.parameter(size_of(effect))
        if size > _most(effect, screen.records):
            size, torque = NOT_SEEN
        unit = unit_of(
            parameter.size,
            given.joint_kind(joint),
            given.actuator.command_unit,
            given.torque_unit(joint),
        )
        at = {n: term.value(n) for n in effect.grid if n in SHAPES} if term else {}
        out.append(Detectable(joint, mechanism_of(name), name, size, unit, torque, at))
    return out


def _least(effect: Effect, record: JointRecord) -> float:
    """The size below which an effect is never named: the search takes no smaller one, or its number
    may be nothing beside what is known of the clock.
    """
    least = effect.least(facts(record)).get(size_of(effect), 0.0) if effect.least else 0.0
    known = SURE * CLOCK * record.sample_time if effect.family == "timing" else 0.0
    return max(least, known)


def _worst(
    implant: Implant, effect: Effect, term: Term | None, beyond: float, record: JointRecord
) -> tuple[float, float]:
    """The size from which on an effect is seen, and its torque: at the worst of its points by a
    linear estimate; and from there a quarter period from it, or at the other neutral points.
    """
    if term is None:
        return NOT_SEEN
    found = implant.seen(term, beyond)
    phase, key = phase_of(effect), size_of(effect)
    others = [{phase: term.value(phase) + 0.5 * math.pi}] if phase else []
    if "neutral" in effect.grid:
        others = [{"neutral": p["neutral"]} for p in grid_of(effect, record, implant.final.model)]
    for at in others:
        if found != NOT_SEEN:
            found = implant.seen(set_numbers(term, {key: found[0], **at}), beyond)
    return found


def _screened(part: Data, decision: Decision, jobs: int) -> tuple[Fit, Screen]:
    """The final model's fit on some recordings, to compute the trace of an effect there."""
    joint, final = decision.joint, decision.final
    data = part.at_bandwidth(joint, final.data.bandwidth[joint - 1])
    result = fit(data, final.model, final.fit.handles, joints=(joint,), iterations=0, jobs=jobs)
    return result, Screen(data, result, joint, (joint,))


def _is_named(effect: Effect, point: dict[str, float], record: JointRecord) -> bool:
    """Whether a fit may end at these numbers and be named: within the limits of each, and off them
    where the effect is nothing there; a wave with a period within the travel. (A size was stated
    at the least time constant of a drift, at which one of eleven that were put in was named, and
    at a period of 1.6 times the travel, where a friction was a curve without a law.)
    """
    for name, value in point.items():
        low, high = parameter_bounds(effect.name, name, record)
        off = NEAR * value if name in essence_of(effect.name) else 0.0
        if not low + off <= value <= high - off:
            return False
    travel = facts(record).scale.position
    return not part_of_a_wave(make_term(effect, record.joint, point), 0, travel)


def _most(effect: Effect, records: Sequence[JointRecord]) -> float:
    """The size above which an effect is not stated: all torque or travel, beyond any fit, or no
    machine has it.
    """
    parameter = effect.parameter(size_of(effect))
    _, largest = parameter_bounds(effect.name, parameter.name, records[0])
    if parameter.size == "time":
        return min(FIRST_ORDER, largest)
    most = max(r.scale.of(parameter.size) for r in records)
    # one that acts upon another is seldom as large
    return min(most * NOT_SMALL if parameter.above else most, largest)


class _Traces:
    """Traces of effects in the innovations of the test recordings, after the calibrated numbers
    have absorbed what the recordings of the fit suggest: all but those of ``other`` terms, which
    would be the finding by another name.
    """

    def __init__(
        self, sought: Screen, found: Fit, screen: Screen, result: Fit, other: Sequence[int]
    ) -> None:
        self.sought, self.screen = sought, screen
        free = [
            h.place != "offset" and not (h.place == "term" and h.index in other)
            for h in found.handles
        ]
        there, here = (f.jacobian[: len(s.r), free] for f, s in ((found, sought), (result, screen)))
        unit = np.linalg.norm(there, axis=0)
        # without columns of no influence, or of a diverged prediction
        felt = (unit > 0.0) & np.isfinite(unit) & np.isfinite(here).all(axis=0)
        self.taken = np.linalg.pinv(there[:, felt] / unit[felt], rcond=TOLD)
        self.here = here[:, felt] / unit[felt]

    def of(self, term: Term) -> Array:
        """The trace of a term, (n,)."""
        there, here = (s.series([(term,)])[0] for s in (self.sought, self.screen))
        out: Array = here - self.here @ (self.taken @ there)
        return out


def _smallest(traces: _Traces, name: str, energy: float, torque: float) -> Term | None:
    """An effect at the worst point of its grid, of the size that leaves the required trace in the
    innovations (root of its energy) and in the torque (RMS, N m or N). None where the recording
    shows nothing of it.
    """
    screen, effect = traces.screen, get_effect(name)
    key = size_of(effect)
    record = screen.records[0]
    points = grid_of(effect, record, screen.model)
    points = points[:: max(1, len(points) // GRID)]
    if places := [point["neutral"] for point in points if "neutral" in point]:
        between = np.linspace(min(places), max(places), NEUTRALS)
        points = [{**points[0], "neutral": float(place)} for place in between]
    points = [point for point in points if _is_named(effect, point, record)]
    worst: tuple[float, dict[str, float]] | None = None
    for point in points:
        values, column = screen.least_seen(effect, point, traces.of)
        column = column / (values.get(key, 1.0) or 1.0)
        left = float(np.linalg.norm(column))
        if left <= 0:
            return None
        size = max(energy / left, AMPLE * torque / max(_torque(screen, column), 1e-300))
        # of a law that is not linear in its size, each point is another size
        if worst is None or (size > worst[0]) is (key not in point):
            worst = size, values
    return worst and make_term(effect, screen.joint, {**worst[1], key: worst[0]})


def _torque(screen: Screen, column: Array) -> float:
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
