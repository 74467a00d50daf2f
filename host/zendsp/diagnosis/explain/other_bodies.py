"""Recordings of an arm with another load: what one body explains in one recording alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from zendsp.diagnosis.data.prepare import of_one_sensor, prepare
from zendsp.diagnosis.data.signals import MIN_SAMPLES, Signals
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.findings import Finding
from zendsp.diagnosis.decide.other_load import of_one_recording
from zendsp.diagnosis.decide.thresholds import LAWFUL, PREDICTED
from zendsp.diagnosis.explain.machine import Found
from zendsp.diagnosis.measure.discrepancy import discrepancy
from zendsp.diagnosis.measure.likelihood import calibrate_joint
from zendsp.diagnosis.progress import Progress, Step
from zendsp.diagnosis.search.bodies import FoundBody, find_bodies
from zendsp.diagnosis.search.body_hypotheses import LIMITS
from zendsp.diagnosis.search.joint_zeros import OtherZero
from zendsp.physics.calibration.fit import Data
from zendsp.physics.model import Model


@dataclass(frozen=True)
class Loaded:
    """A recording with another load: its body, and the parts of the joints' torques that are
    missing without it and with it.
    """

    name: str
    body: FoundBody
    lacks: float
    left: float

    @property
    def is_sure(self) -> bool:
        """Whether it explains its recording: all joints below ``LAWFUL``, and most of what they
        lack.
        """
        return self.left < LAWFUL and self.explains_most

    @property
    def explains_most(self) -> bool:
        """Whether it explains most of what the joints lack."""
        return self.left**2 < (1.0 - PREDICTED) * self.lacks**2

    def finding(self, given: Model) -> Finding:
        """The load as a finding."""
        return of_one_recording(self.body, self.name, self.lacks, self.left, given)


def other_bodies(
    found: Found, signals: Sequence[Sequence[Signals]], given: Model, jobs: int, tell: Progress
) -> tuple[Loaded, ...]:
    """The recordings of an arm with a load that others lack; each is explained by one body, which
    is found in it alone and contradicts the others.

    Asked where the joints lack torque without a law. Each body is found beside the ``given``
    model's own, and has to explain most of what the joints lack; beside what is found in the rest
    it has to explain all (``confirmed``).
    """
    joints, links = range(1, given.joints + 1), found.parts.fit.records[0][0].links
    open_ones = [
        d.joint for d in found.decisions if d.kind in (Verdict.DISTURBANCE, Verdict.UNEXPLAINED)
    ]
    if given.joints == 1 or links is None or not open_ones:
        return ()
    each = _by_recording(signals)
    if len(each) < 2:
        return ()
    tell(Step.ASSEMBLING.says("what each recording says of bodies"))
    every = {name: prepare(own, given, LIMITS.bandwidth) for name, own in each.items()}
    lacks = {
        name: max(discrepancy(data, found.whole.calibrated, j).value for j in joints)
        for name, data in every.items()
    }
    out = []
    for name in every:
        body = _body_of(each[name], given, jobs, tell) if lacks[name] > LAWFUL else None
        if body is None:
            continue
        load = Loaded(name, body, lacks[name], _left(every[name], given, body, jobs))
        others = (data for n, data in every.items() if n != name)
        if load.explains_most and any(_contradicts(data, given, body, jobs) for data in others):
            out.append(load)
    return tuple(out) if len(out) < len(every) else ()


def confirmed(
    loads: Sequence[Loaded], found: Found, signals: Sequence[Sequence[Signals]], jobs: int
) -> tuple[Loaded, ...]:
    """The loads beside what was ``found`` in the rest of the recordings, which a missing law may
    have hidden; empty where one of them does not explain its recording.
    """
    if all(load.is_sure for load in loads):
        return tuple(loads)
    each, model = _by_recording(signals), found.whole.improved
    beside = [
        replace(
            load,
            left=_left(prepare(each[load.name], model, LIMITS.bandwidth), model, load.body, jobs),
        )
        for load in loads
    ]
    return tuple(beside) if all(load.is_sure for load in beside) else ()


def _by_recording(signals: Sequence[Sequence[Signals]]) -> dict[str, list[Signals]]:
    """The pieces of each recording, in their order."""
    out: dict[str, list[Signals]] = {}
    seen: set[int] = set()
    for part, own in zip(signals, of_one_sensor(signals), strict=True):
        if id(part) not in seen:  # those to choose by may be those to test on
            for s in own:
                out.setdefault(s.whole or s.name, []).append(s)
        seen.add(id(part))
    return out


def _body_of(
    pieces: Sequence[Signals], given: Model, jobs: int, tell: Progress
) -> FoundBody | None:
    """The one body that a part of a recording shows and the rest confirms."""
    if len(pieces) == 1:
        (s,) = pieces
        rows, half = len(s.time), len(s.time) // 2
        if half < MIN_SAMPLES:
            return None
        pieces = (s.part(0, half, f"{s.name} begin"), s.part(half, rows, f"{s.name} end"))
    first, *rest = (prepare([s], given, LIMITS.bandwidth) for s in pieces)
    more = replace(rest[0], records=tuple(rec for data in rest for rec in data.records))
    try:
        bodies = find_bodies(first, more, given, jobs, tell).found
    except OtherZero:  # of one recording alone: all together did not say so
        return None
    alone = len(bodies) == 1 and bodies[0].term.effect in ("payload", "body")
    return bodies[0] if alone else None


def _contradicts(data: Data, given: Model, body: FoundBody, jobs: int) -> bool:
    """Whether recordings lack torque with a body, and less without it: one that is pushed lacks
    some either way.
    """
    left = _left(data, given, body, jobs)
    return left > LAWFUL and left > _left(data, given, None, jobs)


def _left(data: Data, given: Model, body: FoundBody | None, jobs: int) -> float:
    """The largest part of a joint's torque that stays unexplained with a body, where each joint is
    calibrated on these recordings alone.
    """
    model = given.with_terms((*given.terms, body.term)) if body else given
    each = [calibrate_joint(data, model, j, jobs).model for j in range(1, given.joints + 1)]
    return max(discrepancy(data, m, j).value for j, m in enumerate(each, 1))
