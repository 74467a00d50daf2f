"""The outcome in ten seconds, for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from zendsp.diagnosis.decide.contract import (
    WORDS,
    contradicted,
    dark,
    listed,
    nameless,
    nearest,
    spans,
    two_digits,
)
from zendsp_protocol.texts import counted

if TYPE_CHECKING:
    from zendsp.diagnosis.decide.contract import Verdict
    from zendsp.diagnosis.decide.result import Detectable, Diagnosis

REFINEMENTS = 6  # that a summary names
MISSED = 3  # of what may have been missed that a summary names
SMALLEST_SHARE = 1e-4  # of a torque: less is not told from nothing
LARGEST_SHARE = 9.99
SMALLER = 1.05  # times: a smaller fall of the error is not told as one
OFF = 3.0  # times the calibrated model's error: what is given is not what the machine has

TILTED = "how the base stands"


def word_of(mechanism: str, effects: Sequence[str]) -> str:
    """A mechanism in plain words; what couples joints may be a mass, friction or speed.

    Examples
    --------
    >>> word_of("inertia", ("coupling",)), word_of("inertia", ("inertia", "coupling"))
    ("the other joints' motion", 'a mass or an inertia')
    >>> word_of("inertia", ("base_tilt",))
    'how the base stands'
    """
    if set(effects) == {"base_tilt"}:
        return TILTED
    if set(effects) == {"coupling"}:
        return "the other joints' motion"
    return WORDS.get(mechanism, effects[0])


def doubted_in(d: Diagnosis) -> tuple[tuple[str, int], ...]:
    """Effects and joints of which the headline says that it cannot tell."""
    return contradicted(d.verdict, d.rejected)


def headline(d: Diagnosis) -> str:
    """The verdict in one sentence, the mechanism first; in two where the given numbers were off."""
    found = [(f.mechanism, (f.effect, *f.indistinguishable), f.joint) for f in d.findings]
    unseen = dark((x.joint, x.interval) for x in d.discrepancy)
    table = d.test or d.heldout
    left = nameless(((x.joint, x.share) for x in d.discrepancy), table.improved, d.noise_floor)
    doubted = doubted_in(d)
    near = nearest(d.verdict, d.rejected)
    if d.stopped and not d.findings:
        return "Ended by Ctrl-C before it was done: nothing is claimed."
    text = verdict_sentence(d.verdict, found, unseen, left, doubted or near)
    if d.verdict == "complete" and not (unseen or doubted) and table.given > OFF * table.calibrated:
        times = two_digits(table.given / table.calibrated)
        text += f" The given numbers were off: calibrated, it errs {times} times less (notes)."
    return f"So far, ended by Ctrl-C: {text}" if d.stopped else text


def verdict_sentence(
    verdict: Verdict,
    found: Sequence[tuple[str, Sequence[str], int]],
    unseen: Sequence[int] = (),
    left: Sequence[tuple[int, float]] = (),
    doubted: Sequence[tuple[str, int]] = (),
) -> str:
    """The verdict in one sentence, or two.

    Parameters
    ----------
    found : sequence of (mechanism, effects, joint)
        The effect that is named, and those that cannot be told from it.
    unseen : sequence of int
        Joints of which the recordings show nothing, see ``dark``.
    left : sequence of (joint, share)
        What of a joint's torque a complete model leaves, see ``nameless``.
    doubted : sequence of (effect, joint)
        What only the recordings of the fit say, see ``contradicted``; what an unexplained verdict
        is most like, see ``nearest``.

    Examples
    --------
    >>> verdict_sentence("missing", [("actuator", ("lag", "delay"), 1), ("actuator", ("lag",), 2)])
    'Missing physics: the actuator (lag or delay) at joint 1; the actuator (lag) at joint 2.'
    >>> same = [("dry_friction", ("coulomb",), joint) for joint in (1, 2, 3)]
    >>> verdict_sentence("missing", same)
    'Missing physics: dry friction (coulomb) at joints 1, 2 and 3.'
    >>> verdict_sentence("missing", [("inertia", ("payload",), 2)])
    'Other than the model says: a mass or an inertia (payload) at joint 2.'
    >>> verdict_sentence("complete", [], left=[(1, 0.015)]).rpartition(" and ")[2]
    'has no name: 1.5 % of the torque of joint 1.'
    >>> verdict_sentence("complete", [], doubted=[("backlash", 1)])[:73]
    'Cannot tell: the recordings of the fit are by far likelier with backlash '
    >>> verdict_sentence("unexplained", [], doubted=[("backlash", 1)])[:66]
    'Unexplained: something is missing that is most like backlash at jo'
    """
    if verdict == "complete" and unseen:
        return (
            "Cannot tell: nothing is seen to be missing, but the recordings to judge on leave open"
            f" up to all of the torque of {listed(unseen)}."
        )
    what = " and ".join(f"{effect} at joint {joint}" for effect, joint in doubted)
    if doubted and verdict == "unexplained":
        return (
            f"Unexplained: something is missing that is most like {what}, and not surely that; no"
            " physics is claimed."
        )
    if doubted:
        return (
            f"Cannot tell: the recordings of the fit are by far likelier with {what}, and the"
            " untouched ones do not show it. Hold out motion as fast as theirs."
        )
    if verdict == "complete" and left:
        shares = " and ".join(f"{percent(share)} of the torque of joint {j}" for j, share in left)
        return (
            "Complete: no known effect is missing that these recordings could show. What is left is"
            f" more than the error of the sensor and has no name: {shares}."
        )
    if verdict == "complete":
        return "Complete: nothing is missing that these recordings could show."
    if verdict == "unexplained":
        return (
            "Unexplained: something is missing that no known effect describes; no physics is"
            " claimed."
        )
    at: dict[int, list[str]] = {}
    for mechanism, effects, joint in found:
        word = word_of(mechanism, effects)
        if word != WORDS["disturbance"]:
            word += f" ({' or '.join(effects)})"
        if word not in at.setdefault(joint, []):
            at[joint].append(word)
    joints: dict[str, list[int]] = {}
    for joint, words in at.items():
        joints.setdefault(" and ".join(words), []).append(joint)
    where = [f"{what} at {listed(numbers)}" for what, numbers in joints.items()]
    masses = all(word_of(m, effects) in (WORDS["inertia"], TILTED) for m, effects, _ in found)
    begin = "Other than the model says" if masses else "Missing physics"
    return f"{begin}: {'; '.join(where)}."


def summary(d: Diagnosis) -> str:
    """Text of at most a screen: verdict, findings, fit, what could not be seen, what next."""
    lines = [headline(d), ""]
    for k, f in enumerate(d.findings, 1):
        lines.append(f"{k}. {f.effect}, joint {f.joint} (confidence {100 * f.confidence:.0f} %)")
        lines.append(f"   {f.sentence}")
    lines += d.unexplained.splitlines()
    if d.findings or d.unexplained:
        lines.append("")
    for e in d.errors:
        head = f"RMS position error over 0.25 s [{e.unit}]"
        lines.append(f"{head:<37}given    calibrated improved noise floor")
        for name, table in (
            (f"  recordings of the fit{e.of}", e.estimation),
            (f"  untouched recordings{e.of}", e.test),
        ):
            lines.append(
                f"{name:<37}{table.given:<9.3g}{table.calibrated:<11.3g}{table.improved:<9.3g}"
                f"{e.noise_floor:.3g}"
            )
    for r in d.regions[:2]:
        lines.append(
            f"mismatch: joint {r.joint}, {r}: {100 * r.share:.0f} % of it in"
            f" {100 * r.time_share:.0f} % of the time"
        )
    if d.times and d.unexplained:
        lines.append(f"mismatch: largest at {spans(d.times[:4], d.times_of)}")
    if d.refinements:
        more = len(d.refinements) - REFINEMENTS
        lines.append(
            "refinements: "
            + ", ".join(f"{f.effect} (joint {f.joint})" for f in d.refinements[:REFINEMENTS])
            + (f", and {more} more" if more > 0 else "")
        )
    for x in d.discrepancy[:7]:
        if d.verdict != "complete" or x.interval[1] < 1.0:
            left = unnamed(x.share, x.interval[1])
            lines.append(f"nothing named explains: joint {x.joint}, {left}")
    if d.detectable:
        lines.append(f"what may have been missed: {_missed(d.detectable)}")
    if d.next_recording:
        lines += ["", f"next: {d.next_recording.sentence}"]
    if d.notes:
        lines += ["", *[f"note: {n}" for n in d.notes]]
    lines.append(f"({d.seconds:.1f} s)")
    return "\n".join(lines)


def _missed(detectable: Sequence[Detectable]) -> str:
    """The largest that the recordings could hide, as parts of the torque, and how many more."""
    largest = sorted(detectable, key=lambda x: -x.share)[:MISSED]
    named = ", ".join(f"{x.effect} below {_sized(x)} (joint {x.joint})" for x in largest)
    more = len(detectable) - len(largest)
    return named + (f", and {counted(more, 'smaller one')}" if more else "")


def _sized(x: Detectable) -> str:
    return f"{x.size:.2g} {x.unit}".removesuffix(" 1")  # a pure number has no unit to be read


def unnamed(share: float, high: float) -> str:
    """What of a joint's torque nothing named explains, and at most where that says anything."""
    if share < SMALLEST_SHARE < high:
        return f"at most {percent(high)} of its torque, and perhaps nothing"
    most = f" (at most {percent(high)})" if SMALLEST_SHARE < high < 1.0 else ""
    return f"{percent(share)} of its torque{most}"


def before(given: float, calibrated: float, improved: float) -> tuple[str, float]:
    """The model with which the improved one is compared, and its error: the calibrated one, or the
    given one where all that was wrong were given numbers.

    Examples
    --------
    >>> before(4e-3, 3e-3, 1e-3), before(4e-3, 1e-3, 1e-3)
    (('of the calibrated model', 0.003), ('of the model as given', 0.004))
    """
    if calibrated < SMALLER * improved and given > SMALLER * calibrated:
        return "of the model as given", given
    return "of the calibrated model", calibrated


def percent(share: float) -> str:
    """Return a share of a torque as people read it.

    Examples
    --------
    >>> percent(0.0), percent(0.0351), percent(0.996)
    ('below 0.01 %', '3.5 %', '100 %')
    """
    if share < SMALLEST_SHARE:
        return f"below {100 * SMALLEST_SHARE:g} %"
    return f"{two_digits(100 * min(share, LARGEST_SHARE))} %"
