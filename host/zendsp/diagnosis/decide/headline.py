"""The verdict in a sentence: what a report, a terminal and report.json begin with."""

from __future__ import annotations

import math
from collections.abc import Sequence

from zendsp.diagnosis.decide.contract import WORDS, Verdict, listed, two_digits
from zendsp.diagnosis.decide.thresholds import STATED_BESIDE
from zendsp.diagnosis.measure.discrepancy import BANDS
from zendsp_protocol.texts import enumerated

SMALLEST_SHARE = 1e-4  # of a torque: less cannot be told from zero
LARGEST_SHARE = 9.99
SEEN = BANDS[0] / math.tau  # Hz: the fastest torque that an observer sees in full

TILTED = "how the base stands"
Said = tuple[str, Sequence[str], int, float]  # word, effects, joint and confidence of a finding


def word_of(mechanism: str, effects: Sequence[str]) -> str:
    """A mechanism in plain words; a coupling of joints by its law.

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


def verdict_sentence(
    verdict: Verdict,
    found: Sequence[Said],
    unseen: Sequence[int] = (),
    left: Sequence[tuple[int, float]] = (),
    near: Sequence[tuple[str, int]] = (),
    doubted: Sequence[tuple[str, int]] = (),
    loads: Sequence[int] = (),
) -> str:
    """The verdict in one sentence, or two.

    Parameters
    ----------
    found : sequence of (word, effects, joint, confidence)
        ``word``: the mechanism's, see ``word_of``. ``effects``: the named one, and those that
        cannot be told from it. ``confidence``: below 0.7 it is called doubtful.
    unseen : sequence of int
        Joints about which the recordings show nothing, see ``dark``.
    left : sequence of (joint, share)
        The part of a joint's torque that a complete model leaves, see ``nameless``.
    near, doubted : sequence of (effect, joint)
        The law nearest to an unexplained torque, see ``nearest``; and what only the recordings of
        the fit show, where nothing else is unexplained, see ``contradicted``.
    loads : sequence of int
        Unexplained joints whose recordings are each explained by numbers of their own.

    Examples
    --------
    >>> drives = [("the actuator", ("lag", "delay"), 1, 0.9), ("the actuator", ("lag",), 2, 0.9)]
    >>> verdict_sentence(Verdict.MISSING, drives)
    'Missing physics: the actuator (lag or delay) at joint 1; the actuator (lag) at joint 2.'
    >>> same = [("dry friction", ("coulomb",), joint, 0.9) for joint in (1, 2, 3)]
    >>> verdict_sentence(Verdict.MISSING, same)
    'Missing physics: dry friction (coulomb) at joints 1, 2 and 3.'
    >>> drives = [(what, (what,), 1, 0.9) for what in ("lag", "delay", "creep")]
    >>> verdict_sentence(Verdict.MISSING, drives)
    'Missing physics: lag (lag), delay (delay) and creep (creep) at joint 1.'
    >>> two = [("lag", ("lag",), 1, 0.9), ("delay", ("delay",), 2, 0.4)]
    >>> verdict_sentence(Verdict.MISSING, two)
    'Missing physics: lag (lag) at joint 1. Doubtful: delay (delay, 40 %) at joint 2.'
    >>> verdict_sentence(Verdict.MISSING, [("lag", ("lag",), 1, 0.4)])
    'Perhaps missing physics: lag (lag, 40 %) at joint 1.'
    >>> verdict_sentence(Verdict.MISSING, [(WORDS["inertia"], ("payload",), 2, 0.9)])
    'Other than the model says: a mass or an inertia (payload) at joint 2.'
    >>> verdict_sentence(Verdict.MISSING, [(TILTED, ("base_tilt",), 1, 0.9)])
    'Other than the model says: how the base stands (base_tilt).'
    >>> verdict_sentence(Verdict.COMPLETE, [], left=[(1, 0.015)]).rpartition(" and ")[2]
    'has no name: 1.5 % of the torque of joint 1.'
    >>> verdict_sentence(Verdict.UNEXPLAINED, [], doubted=[("backlash", 1)])[:73]
    'Cannot tell: the recordings of the fit are by far likelier with backlash '
    >>> verdict_sentence(Verdict.UNEXPLAINED, [], near=[("backlash", 1)])[:66]
    'Unexplained: something is missing that is most like backlash at jo'
    """
    if verdict == Verdict.COMPLETE and unseen:
        return (
            "Cannot tell: nothing is seen to be missing, but the recordings to judge on leave open"
            f" up to all of the torque of {listed(unseen)}."
        )
    if doubted:
        return (
            f"Cannot tell: the recordings of the fit are by far likelier with {_at(doubted)}, and"
            " the untouched ones show too little of it. Hold out motion like theirs."
        )
    if loads and verdict == Verdict.UNEXPLAINED:
        return (
            f"Unexplained: no one set of numbers describes all recordings of {listed(loads)}, and"
            " numbers of its own describe each: another load perhaps (notes); no physics is"
            " claimed."
        )
    if near and verdict == Verdict.UNEXPLAINED:
        return (
            f"Unexplained: something is missing that is most like {_at(near)}, and not surely that;"
            " no physics is claimed."
        )
    if verdict == Verdict.COMPLETE and left:
        shares = enumerated(f"{percent(share)} of the torque of joint {j}" for j, share in left)
        return (
            "Complete: no known effect is missing that these recordings could show. What is left is"
            f" more than the error of the sensor and has no name: {shares}."
        )
    if verdict == Verdict.COMPLETE:
        return "Complete: nothing is missing that these recordings could show."
    if verdict == Verdict.UNEXPLAINED:
        return (
            "Unexplained: something is missing that no known effect surely describes; no physics"
            " is claimed."
        )
    return _missing(found)


def complete_below(times: float) -> str:
    """The verdict where a model leaves hardly any torque that observers can see, and the position
    errs so many times what a perfect model would.

    Examples
    --------
    >>> complete_below(5.04)[:60]
    'Complete below 10 Hz: nothing is missing that these recordin'
    """
    return (
        f"Complete below {SEEN:.0f} Hz: nothing is missing that these recordings could show. But"
        f" the position errs {two_digits(times)} times as much as its sensor: by numbers slightly"
        " off, or by something faster (notes)."
    )


def _missing(found: Sequence[Said]) -> str:
    """The findings in a sentence; the doubtful ones in one of their own, with their confidence."""
    masses = all(word in (WORDS["inertia"], TILTED) for word, *_ in found)
    sure = [f for f in found if f[3] >= STATED_BESIDE]
    doubtful = [f for f in found if f[3] < STATED_BESIDE]
    begin = "Other than the model says" if masses else "Missing physics"
    perhaps = "Doubtful" if sure else f"Perhaps {begin[0].lower()}{begin[1:]}"
    said = [(begin, _places(sure, False)), (perhaps, _places(doubtful, True))]
    return " ".join(f"{what}: {places}." for what, places in said if places)


def _places(found: Sequence[Said], confidence: bool) -> str:
    """What is missing at which joints, with its confidence if asked for."""
    at: dict[int, list[str]] = {}
    for word, effects, joint, probability in found:
        within = [] if word == WORDS["disturbance"] else [" or ".join(effects)]
        within += [f"{100 * probability:.0f} %"] * confidence
        what = f"{word} ({', '.join(within)})" if within else word
        if what not in at.setdefault(joint, []):
            at[joint].append(what)
    joints: dict[str, list[int]] = {}
    for joint, words in at.items():
        *first, last = words
        joints.setdefault(f"{', '.join(first)} and {last}" if first else last, []).append(joint)
    where = [  # a base is no joint's
        what if what.startswith(TILTED) and " and " not in what else f"{what} at {listed(numbers)}"
        for what, numbers in joints.items()
    ]
    return "; ".join(where)


def _at(laws: Sequence[tuple[str, int]]) -> str:
    return enumerated(f"{effect} at joint {joint}" for effect, joint in laws)


def percent(share: float) -> str:
    """A share of a torque in per cent, rounded for people.

    Examples
    --------
    >>> percent(0.0), percent(0.0351), percent(0.996)
    ('below 0.01 %', '3.5 %', '100 %')
    """
    if share < SMALLEST_SHARE:
        return f"below {100 * SMALLEST_SHARE:g} %"
    return f"{two_digits(100 * min(share, LARGEST_SHARE))} %"
