"""A wrong body inside a simulator (a payload, a link of another mass).

It acts on all joints together. A simulator that can only be called has no links to which one could
be added, so that each joint explains its part by a law of its own: a torque gain, an inertia, a
gravity, which leaves something. A law that is right leaves nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import replace

from zendsp.diagnosis.decide.contract import Verdict, listed
from zendsp.diagnosis.decide.decide_bodies import like_bodies
from zendsp.diagnosis.decide.findings import Finding
from zendsp.diagnosis.decide.result import Diagnosis, FitTable, Workings
from zendsp.diagnosis.decide.thresholds import OF_STATE
from zendsp.physics.model import Model

FREED = (
    "What is missing at {} is a wrong body inside the simulator (a payload, or a link of another"
    " mass or length): with its numbers {} free, which the model file holds, {}"
)
PARTS = (
    "What is missing at {} ({}) may be parts of a wrong body inside the simulator (a payload, or a"
    " link of another mass): no law of a joint explains it. A body cannot be tried on a simulator"
    " that can only be called: give its masses as [mechanism.parameters], or the machine as URDF or"
    " MJCF"
)

BY_INERTIA = ("inertia", "coriolis")  # laws of a coupling


def like_a_part(effect: str) -> bool:
    """Whether a joint's part of a wrong body may look like this effect."""
    return effect in like_bodies() | {"inertia", "coupling"}


def like_parts(d: Diagnosis) -> list[Finding]:
    """The findings that may be a joint's part of a wrong body."""
    return [f for f in d.findings if like_a_part(f.effect)]


def of_no_law(d: Diagnosis) -> Diagnosis:
    """The diagnosis, which names nothing; where several joints lack what is like parts of a wrong
    body, it says so.
    """
    assert isinstance(d.workings, Workings)
    lacking = [x for x in d.workings.decisions if x.kind == Verdict.UNEXPLAINED]
    like = dict.fromkeys(x.near.effect for x in lacking if x.near and like_a_part(x.near.effect))
    if len(lacking) < 2 or not like:
        return d
    return replace(d, unexplained=_parts([x.joint for x in lacking], like, d))


def _parts(joints: Collection[int], like: Iterable[str], d: Diagnosis) -> str:
    """What is unexplained, after a sentence on a wrong body."""
    said = PARTS.format(listed(joints), ", ".join(like))
    return "\n".join(line for line in (said, d.unexplained) if line)


def incomplete_parts(d: Diagnosis) -> list[Finding]:
    """Those that leave at their joint what depends on its state, beyond the interval of the
    discrepancy.
    """
    return [f for f in like_parts(d) if f.joint in _left(d)]


def _left(d: Diagnosis) -> set[int]:
    """The joints that leave what depends on their state."""
    return {x.joint for x in d.discrepancy if x.interval[0] > OF_STATE}


def _may_be_a_body(d: Diagnosis) -> bool:
    """Whether laws of joints leave something, or several of them are claimed: a link's mass was a
    gain of each of two joints, 0.97 and 0.66 sure, which left nothing.
    """
    return bool(incomplete_parts(d)) or len(like_parts(d)) > 1


def without_parts(
    d: Diagnosis,
    given: Model,
    diagnose: Callable[[Model], Diagnosis],
    terms: Collection[str] = (),
) -> Diagnosis:
    """The diagnosis without laws that are each a part of a wrong body inside the simulator.

    Parameters
    ----------
    given : Model
        Of several joints.
    diagnose : callable
        Diagnoses with another given model.
    terms : collection of str
        Numbers of the simulator that are terms of the model.
    """
    if given.joints < 2 or d.verdict == Verdict.COMPLETE:
        return d
    if not d.findings:
        return of_no_law(d)
    return _of_the_mechanism(_told(d, given, diagnose, terms))


def of_what_was_asked(d: Diagnosis) -> Diagnosis:
    """A diagnosis that was ended early, without laws that may be parts of a wrong body inside: it
    was not asked for. Beside such parts a torque over the position may be one, too.
    """
    parts = []
    if _may_be_a_body(d):
        parts = [
            f for f in d.findings if like_a_part(f.effect) or f.mechanism == "position_torque"
        ]
    return _of_the_mechanism(_set_aside(d, parts))


def _of_the_mechanism(d: Diagnosis) -> Diagnosis:
    """The diagnosis without claimed couplings by inertia: what a joint feels of another one's
    motion comes from the bodies between them, and no joint has a law of its own for it.
    """
    return _set_aside(
        d, [f for f in d.findings if f.effect == "coupling" and f.numbers.get("law") in BY_INERTIA]
    )


def _set_aside(d: Diagnosis, parts: Collection[Finding]) -> Diagnosis:
    """The diagnosis in which some findings are no more than refinements, as they may be parts of a
    wrong body inside.
    """
    if not parts:
        return d
    rest = tuple(f for f in d.findings if f not in parts)
    said = d.unexplained
    if "wrong body inside" not in said:
        said = _parts({f.joint for f in parts}, dict.fromkeys(f.effect for f in parts), d)
    if not rest:
        return _unclaimed(replace(d, refinements=()), said)
    return replace(d, findings=rest, refinements=(*d.refinements, *parts), unexplained=said)


def _told(
    d: Diagnosis, given: Model, diagnose: Callable[[Model], Diagnosis], terms: Collection[str]
) -> Diagnosis:
    """The diagnosis with numbers set free that the model file holds, where that leaves fewer parts
    of a body; or without parts that leave something.
    """
    if not _may_be_a_body(d):
        return d
    held = [
        k for k, q in given.mechanism.items() if q[0].value and not q[0].free and k not in terms
    ]
    if held:
        again = diagnose(freed(given, terms))
        if len(again.findings) < len(d.findings) and not _may_be_a_body(again):
            rest = "less is left" if again.findings or again.unexplained else "nothing is left"
            joints = listed({f.joint for f in like_parts(d)})
            said = FREED.format(joints, ", ".join(held), rest)
            unexplained = "\n".join(line for line in (said, again.unexplained) if line)
            verdict = Verdict.MISSING if again.findings else Verdict.UNEXPLAINED
            return replace(again, verdict=verdict, unexplained=unexplained)
    parts, left = incomplete_parts(d), _left(d)
    if not parts or any(f.joint not in left for f in d.findings):
        return d
    said = _parts({f.joint for f in parts}, dict.fromkeys(f.effect for f in parts), d)
    return _unclaimed(d, said)


def _unclaimed(d: Diagnosis, said: str) -> Diagnosis:
    """The diagnosis, which claims nothing, with what is said instead."""
    return replace(
        d, verdict=Verdict.UNEXPLAINED, findings=(), improved=d.calibrated, unexplained=said,
        estimation=_calibrated(d.estimation), heldout=_calibrated(d.heldout),
        test=None if d.test is None else _calibrated(d.test), next_recording=None,
    )  # fmt: skip


def _calibrated(table: FitTable) -> FitTable:
    """The errors where nothing is claimed."""
    return replace(table, improved=table.calibrated)


def freed(model: Model, terms: Collection[str]) -> Model:
    """The model with all its numbers free, but those that are terms."""
    mechanism = {
        key: tuple(replace(q, free=key not in terms) for q in items)
        for key, items in model.mechanism.items()
    }
    return replace(model, mechanism=mechanism)
