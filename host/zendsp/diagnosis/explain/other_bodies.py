"""Recordings of an arm with another load: what one body explains in one recording alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from zendsp.diagnosis.data.prepare import of_one_sensor, prepare
from zendsp.diagnosis.data.signals import MIN_SAMPLES, Signals
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.findings import Finding
from zendsp.diagnosis.decide.other_load import of_recordings
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
    """Recordings with another load: its body, and the parts of the joints' torques that are
    missing without it and with it.
    """

    names: tuple[str, ...]
    body: FoundBody
    lacks: float
    left: float

    @property
    def is_sure(self) -> bool:
        """Whether it explains its recordings: all joints below ``LAWFUL``, and most of what they
        lack.
        """
        return self.left < LAWFUL and self.explains_most

    @property
    def explains_most(self) -> bool:
        """Whether it explains most of what the joints lack."""
        return self.left**2 < (1.0 - PREDICTED) * self.lacks**2

    def finding(self, given: Model) -> Finding:
        """The load as a finding."""
        return of_recordings(self.body, self.names, self.lacks, self.left, given)


def other_bodies(
    found: Found, signals: Sequence[Sequence[Signals]], given: Model, jobs: int, tell: Progress
) -> tuple[Loaded, ...]:
    """The recordings of an arm with a load that others lack; each is explained by one body, which
    is found in it alone and contradicts the others.

    Asked where the joints lack torque without a law. Each body is found beside the ``given``
    model's own, and has to explain most of what the joints lack; beside what is found in the rest
    it has to explain all (``confirmed``).
    """
    joints = range(1, given.joints + 1)
    if not may_be_loaded(found, given):
        return ()
    each = pieces_of(signals)
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
        load = Loaded((name,), body, lacks[name], _left(every[name], given, body, jobs))
        others = (data for n, data in every.items() if n != name)
        if load.explains_most and any(_contradicts(data, given, body, jobs) for data in others):
            out.append(load)
    if len(out) == len(every):
        return ()
    whole = _as_one(out, each, given, jobs, tell) if len(out) > 1 else None
    return (whole,) if whole is not None and whole.explains_most else tuple(out)


def may_be_loaded(found: Found, given: Model) -> bool:
    """Whether recordings may have another load: joints of an arm lack torque without a law."""
    links = found.parts.fit.records[0][0].links
    kinds = {d.kind for d in found.decisions}
    is_open = not kinds.isdisjoint((Verdict.DISTURBANCE, Verdict.UNEXPLAINED))
    return given.joints > 1 and links is not None and is_open


def _as_one(
    loads: Sequence[Loaded],
    each: Mapping[str, Sequence[Signals]],
    given: Model,
    jobs: int,
    tell: Progress,
) -> Loaded | None:
    """One load that all loaded recordings share; None where no body is in all of them."""
    names = tuple(name for load in loads for name in load.names)
    pieces = [s for name in names for s in each[name]]
    body = _body_of(pieces, given, jobs, tell)
    if body is None:
        return None
    left = (_left(prepare(each[n], given, LIMITS.bandwidth), given, body, jobs) for n in names)
    return Loaded(names, body, max(load.lacks for load in loads), max(left))


def confirmed(
    loads: Sequence[Loaded], found: Found, signals: Sequence[Sequence[Signals]], jobs: int
) -> tuple[Loaded, ...]:
    """The loads beside what was ``found`` in the rest of the recordings, which a missing law may
    have hidden; empty where one of them does not explain its recording.
    """
    if all(load.is_sure for load in loads):
        return tuple(loads)
    each, model = pieces_of(signals), found.whole.improved
    beside = [
        replace(
            load,
            left=max(
                _left(prepare(each[name], model, LIMITS.bandwidth), model, load.body, jobs)
                for name in load.names
            ),
        )
        for load in loads
    ]
    return tuple(beside) if all(load.is_sure for load in beside) else ()


def pieces_of(signals: Sequence[Sequence[Signals]]) -> dict[str, list[Signals]]:
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
    """The one body that a part of a recording shows and the rest confirms: the longest piece, or
    half of it where the others are shorter than that.
    """
    longest, *others = sorted(pieces, key=lambda s: -len(s.time))
    rows, half = len(longest.time), len(longest.time) // 2
    if sum(len(s.time) for s in others) < half:
        if half < MIN_SAMPLES:
            return None
        end = longest.part(half, rows, f"{longest.name} end")
        longest, others = longest.part(0, half, f"{longest.name} begin"), [end, *others]
    first, *rest = (prepare([s], given, LIMITS.bandwidth) for s in (longest, *others))
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
