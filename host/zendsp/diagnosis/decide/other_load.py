"""Another load in the held-out recordings, where inertia and gravity differ together.

The numbers of a body added between recordings are found on those to choose by, and judged on those
to test on. For machines of one joint; of an arm all joints together find the body of a recording
(``explain/other_bodies.py``), which is stated here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.confidence import sure_by
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.decide_bodies import BodyClaim, body_finding
from zendsp.diagnosis.decide.findings import Estimate, Finding, number
from zendsp.diagnosis.decide.moved import point_of
from zendsp.diagnosis.decide.thresholds import A_PART, LAWFUL, SURE, TOLERANCE
from zendsp.diagnosis.measure.discrepancy import discrepancy
from zendsp.diagnosis.measure.evidence import compare
from zendsp.diagnosis.measure.likelihood import Scored, fit_scored
from zendsp.diagnosis.measure.significance import INTEGRATION_ERROR
from zendsp.diagnosis.measure.windows import rms, window_error
from zendsp.diagnosis.search.bodies import FoundBody
from zendsp.physics.calibration.fit import Fit
from zendsp.physics.calibration.handles import Handle
from zendsp.physics.effects import unit_of
from zendsp.physics.model import Model
from zendsp_protocol.texts import enumerated

# most that is stated of a load, as of a fast ripple: eight were right; one was a friction that
# varies with the position, and left two fifths of the missing torque's energy
CONFIDENCE = 0.9


@dataclass(frozen=True)
class OtherLoad:
    """The report of another load, and the joint's decision with the held-out recordings' numbers.
    """

    finding: Finding
    decision: Decision


def other_load(parts: Parts, given: Model, decision: Decision, jobs: int) -> OtherLoad | None:
    """The load that all held-out recordings have and those of the fit lack; None where they have
    the same, or where more than inertia and gravity differs: in either recordings more stays
    unexplained than half of the load's torque, or those of the fit are explained by its numbers,
    too.
    """
    joint, base = decision.joint, decision.base
    held = {rec[joint - 1].recording for rec in parts.held.records}
    fitted = {rec[joint - 1].recording for rec in parts.fit.records}
    loaded = set(decision.loads)
    apart = held <= loaded and not fitted & loaded and parts.choose is not parts.test
    if given.joints > 1 or not apart:
        return None
    keys = [key for key, items in base.model.mechanism.items() if items[0].value != 0.0]
    handles = [Handle("mechanism", 0, key) for key in keys]
    choose = parts.choose.at_bandwidth(joint, base.data.bandwidth[joint - 1])
    own = fit_scored(choose, base.model, handles, (joint,), jobs=jobs, rounds=2)
    after = discrepancy(parts.test, own.model, joint)
    size = math.sqrt(max(decision.before.value**2 - after.value**2, 0.0))
    here, there = (discrepancy(parts.fit, m, joint) for m in (base.model, own.model))
    left = max(after.value, here.value)
    more = left > LAWFUL and left > A_PART * size
    # the recordings of the fit may have the same load, and another law had bent its numbers there
    alike = there.value < LAWFUL
    errors = [rms(window_error(parts.test, m, joint)) for m in (base.model, own.model)]
    evidence = compare(base, own, parts.test, joint)
    if more or alike or errors[1] > errors[0] or evidence.z < SURE:
        return None
    both = [_numbers(keys, scored.fit, given) for scored in (base, own)]
    if not any(_is_other(*(numbers[key] for numbers in both)) for key in keys):
        return None
    body, text = _body(given, *both)
    where = enumerated(sorted(loaded))
    effect = "payload" if "mass" in body else "inertia"
    finding = Finding(
        effect,
        joint,
        body,
        min(CONFIDENCE, sure_by(size, after.value)),
        1.0,
        (),
        (),
        f"{where} is of a machine with another load: {text}.",
        {"recordings": sorted(loaded)},
        "inertia",
        {effect: 1.0},
    )
    decided = replace(
        decision, kind=Verdict.MISSING, final=own, after=after, bare=after, alone=own, loads=()
    )
    return OtherLoad(finding, decided)


def of_one(
    recording: str, own: Scored, others: Scored, sizes: tuple[float, float], given: Model
) -> Finding | None:
    """The finding of a load that one recording of a single joint has, and those lack on which
    ``others`` were fitted; None where inertia or mass does not differ. ``sizes``: what is missing
    there without its own numbers and with them, as parts of the torque.
    """
    joint = own.joints[0]
    keys = [key for key, items in others.model.mechanism.items() if items[0].value != 0.0]
    both = [_numbers(keys, scored.fit, given) for scored in (others, own)]
    if not any(_is_other(*(numbers[key] for numbers in both)) for key in keys if key != "gravity"):
        return None
    body, text = _body(given, *both)
    effect = "payload" if "mass" in body else "inertia"
    lacks, left = sizes
    size = math.sqrt(max(lacks**2 - left**2, 0.0))
    return Finding(
        effect,
        joint,
        body,
        min(CONFIDENCE, sure_by(size, left)),
        1.0,
        (),
        (),
        f"{recording} is of a machine with another load than others: {text}.",
        {"recordings": [recording], "body": f"joint {joint}"},
        "inertia",
        {effect: 1.0},
    )


def _is_other(before: Estimate, now: Estimate) -> bool:
    """Whether a number is surely different, and by more than any number is known to."""
    change = abs(now.value - before.value)
    return change > max(SURE * math.hypot(before.std, now.std), TOLERANCE * abs(before.value))


def of_recordings(
    body: FoundBody, recordings: Sequence[str], lacks: float, left: float, given: Model
) -> Finding:
    """The finding of a body that recordings of an arm have and others lack. ``lacks``, ``left``:
    what is missing there without it and with it, as parts of the torque.
    """
    size = math.sqrt(max(lacks**2 - left**2, 0.0))
    sure = min(CONFIDENCE, sure_by(size, left))
    finding = body_finding(BodyClaim(body, {}, 0.0, sure), 1.0, given)
    return replace(
        finding,
        share=1.0,
        sentence=f"{enumerated(recordings)} {'is' if len(recordings) == 1 else 'are'} of a machine"
        f" with another load than others. {finding.sentence}",
        numbers={**finding.numbers, "recordings": list(recordings)},
    )


def of_load(findings: Sequence[Finding]) -> list[str]:
    """Notes on the models where recordings have another load."""
    loaded = [enumerated(f.numbers["recordings"]) for f in findings]
    if not loaded:
        return []
    if findings[0].is_elsewhere:
        return [
            f"{enumerated(loaded)}: the calibrated and the improved model carry no load of"
            " these recordings, and all else that is said here is of the others"
        ]
    return [
        f"the improved model carries the load of {loaded[0]}: it does not describe the recordings"
        " of the fit, which the calibrated one does"
    ]


def _numbers(keys: Sequence[str], fit: Fit, given: Model) -> dict[str, Estimate]:
    """The mechanism's numbers as fitted, with their standard deviations."""
    at = {h.key: i for i, h in enumerate(fit.handles) if h.place == "mechanism"}
    out = {}
    for key in keys:
        value = fit.model.mechanism[key][0].value
        std = fit.std[at[key]] if key in at else 0.0
        unit = unit_of(
            "torque" if key == "gravity" else "inertia",
            given.joint_kind(1),
            given.actuator.command_unit,
            given.torque_unit(1),
        )
        out[key] = Estimate(value, math.hypot(float(std), INTEGRATION_ERROR * value), unit)
    return out


def _body(
    given: Model, before: dict[str, Estimate], now: dict[str, Estimate]
) -> tuple[dict[str, Estimate], str]:
    """The load as a body, where its weight shows with the same sign as its inertia; otherwise as an
    added inertia. In words, with the numbers that it changes.
    """
    more = {key: now[key].value - before[key].value for key in now}
    std = {key: math.hypot(now[key].std, before[key].std) for key in now}
    text = enumerated(
        f"{key} {number(now[key])} instead of {number(before[key])}" for key in now
    )
    (inertia,) = (key for key in now if key != "gravity")
    amount = Estimate(more[inertia], std[inertia], now[inertia].unit)
    weight = more.get("gravity", 0.0)
    shows = abs(weight) > SURE * std.get("gravity", math.inf) and weight * amount.value > 0.0
    if given.joint_kind(1) == "linear" or not shows or amount.unit != "kg m²":
        return {"amount": amount}, text
    body = point_of(amount, Estimate(weight, std["gravity"], "N m"))
    mass = body["mass"].value
    size = replace(body["mass"], value=abs(mass))
    of = f"{'a payload' if mass > 0.0 else 'a loss'} of {number(size)}"
    return body, f"{text}, as by {of} at {number(body['com_x'])} from the axis"
