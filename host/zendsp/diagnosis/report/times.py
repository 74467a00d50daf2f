"""The times in which torque is missing, with the joints at which it is, in words."""

from __future__ import annotations

from collections.abc import Sequence

from zendsp.diagnosis.decide.contract import listed, spans
from zendsp.diagnosis.decide.result import Diagnosis, Workings
from zendsp.diagnosis.measure.where import intervals, lies_in


def times_in_words(d: Diagnosis, of: Sequence[str], most: int, begin: float = 0.0) -> str:
    """The first of the times, s since ``begin``, each with its recording in ``of``, and of a
    machine of several joints with its joints.
    """
    shown = [(a - begin, b - begin) for a, b in d.times]
    if len(d.missing) < 2:
        return spans(shown, of, most)
    groups: dict[tuple[int, ...], list[int]] = {}
    for k in range(min(most, len(shown))):
        groups.setdefault(joints_at(d, k), []).append(k)
    told = [
        (f"{listed(joints)}: " if joints else "")
        + spans([shown[k] for k in at], [of[k] for k in at], len(at))
        for joints, at in groups.items()
    ]
    return "; ".join([*told, *([f"{len(shown) - most} more"] if len(shown) > most else [])])


def joints_at(d: Diagnosis, index: int) -> tuple[int, ...]:
    """The joints at which torque is missing in one of the times, from 0: those that are pushed
    then; or else those of which the time is, or a part of it.
    """
    (begin, end), name = d.times[index], d.times_of[index]
    decisions = d.workings.decisions if isinstance(d.workings, Workings) else ()
    pushes = ((x.joint, burst) for x in decisions for burst in (x.beside, x.bursts) if burst)
    pushed = {
        joint for joint, burst in pushes
        if ((begin, end), name) in zip(burst.intervals, burst.recordings, strict=True)
    }  # fmt: skip
    if pushed:
        return tuple(sorted(pushed))
    return tuple(
        joint
        for joint, parts in sorted(d.missing.items())
        for m in parts
        if m.recording == name and lies_in(m, begin, end)
        and any(a <= end and begin <= b for a, b, _ in intervals(m))
    )  # fmt: skip
