"""The findings and model terms of claims about a transmission."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.confidence import sure_by
from zendsp.diagnosis.decide.contract import DetailsReport
from zendsp.diagnosis.decide.findings import Estimate, Finding, number, sentence
from zendsp.diagnosis.decide.thresholds import PLAIN, TOLERANCE
from zendsp.diagnosis.measure.evidence import compare
from zendsp.diagnosis.measure.likelihood import calibrate_joint
from zendsp.diagnosis.transmission.claims import Claim
from zendsp.diagnosis.transmission.load_side import OF_A_CONTACT as CONTACT_KNOWN
from zendsp.diagnosis.transmission.load_side import LoadSide
from zendsp.diagnosis.transmission.motor_side import Motor, joint_inertia
from zendsp.diagnosis.transmission.torsion import has_bodies
from zendsp.physics.calibration.handles import LEADER
from zendsp.physics.calibration.joint import facts
from zendsp.physics.effects import get_effect, unit_of
from zendsp.physics.model import Model, Quantity, Term

SENSORS = "both sides"  # the sensors that showed a transmission
OF_A_GAP = 0.01  # of its width: simulated ones of 12 mrad came out 0.3 to 0.6 % too narrow
# the same by the load's own acceleration: one of 12 mrad came out at 12.02 or 11.44, by how the
# motor's motion was smoothed. It is stated so, and held in the fit, which predicted half as well
# where it was free
BY_ITS_LOAD = 0.05

# start values of a fit to the motor's position: largest load, as a part of the joint's inertia,
# where loosely known; Hz of a contact of unmeasured stiffness; twice the damping ratios of a spring
# and a contact
MOST_LOAD, CONTACT = 0.9, 35.0
OF_A_SPRING, OF_A_CONTACT = 0.1, 0.8
# of a number: one less certain is fitted to the motor's position too. A spring held at 300 +- 30 N
# m/rad predicted half as well as a free one; a contact held at 100 instead of 120 caused a torque
# gain of -17 %
LOOSE = 0.02

# of a stiffness and of a wave's amplitude: at four simulated joints with both sensors they were
# 0.04 to 0.7 % off, with stated 0.002 to 0.06 %
MEASURED = 0.005
OF_AN_ORDER = 5e-4  # simulated ones of 6 came out at 6.0012 over 1.2 periods, 5.9969 over five


def load_behind(model: Model, inertia: float, motor: Motor) -> tuple[float, float]:
    """The inertia behind the transmission with its standard deviation; 0 where the model's bodies
    give it. The joint's whole inertia is a given number.
    """
    if has_bodies(model):
        return 0.0, 0.0
    return max(inertia - motor.inertia, 0.02 * inertia), math.hypot(motor.std, TOLERANCE * inertia)


def findings_of(
    parts: Parts,
    model: Model,
    joint: int,
    scale: float,
    claims: Sequence[Claim],
    load: tuple[float, float],
    side: LoadSide | None = None,
) -> tuple[tuple[Finding, ...], tuple[Term, ...]]:
    """The findings with the contract's names, and the terms for the model."""
    by = {c.name: c for c in claims}
    made: list[tuple[str, Claim, dict[str, tuple[float, float]], DetailsReport]] = []
    spring = by.get("spring")
    if spring is not None:
        stiffness = -1.0 / spring.value
        sure = CONTACT_KNOWN if "gap" in by else MEASURED
        relative = math.hypot(spring.std / spring.value, sure)
        numbers = {"stiffness": (stiffness, relative * stiffness)}
        if spring.damping[0] > PLAIN * spring.damping[1]:
            numbers["damping"] = spring.damping
        if load[0]:
            numbers["load_inertia"] = load
        details: DetailsReport = {
            "compliance": -spring.value,
            "compliance_std": relative * abs(spring.value),
        }
        name = "elasticity"
        if "gap" in by:
            pressed = 2.0 * scale * relative * abs(spring.value)
            name, numbers = "backlash", {"gap": _gap(by["gap"], side, pressed), **numbers}
        elif "cubic" in by:
            name = "stiffening"
            numbers["stiffness3"] = _hardening(by["cubic"], stiffness, relative, scale, side)
        made.append((name, spring, numbers, details))
    elif "gap" in by:
        numbers = {"gap": _gap(by["gap"], side)}
        if load[0]:
            numbers["load_inertia"] = load
        made.append(("backlash", by["gap"], numbers, {}))
    if "step" in by and spring is None:
        step = by["step"]
        made.append(("hysteresis", step, {"step": (-2 * step.value, 2 * step.std)}, {}))
    if "loop" in by and spring is not None:
        loop = by["loop"]
        held = loop.value / spring.value
        made.append(
            ("hysteresis", loop, {"step": (-2 * loop.value, 2 * loop.std)}, {"torque": held})
        )
    for w in (c for c in claims if c.name == "wave"):
        numbers = {
            "order": (w.order, math.hypot(w.order_std, OF_AN_ORDER * w.order)),
            "amplitude": (w.value, math.hypot(w.std, MEASURED * w.value)),
            "phase": (w.phase, w.std / w.value),
        }
        made.append(("transmission_error", w, numbers, {}))
    everything = sum(c.size**2 for _, c, _, _ in made) or 1.0
    findings = tuple(
        _finding(model, joint, name, claim, numbers, details, claim.size**2 / everything)
        for name, claim, numbers, details in made
    )
    terms = tuple(_term(model, parts, name, joint, numbers, side) for name, _, numbers, _ in made)
    return findings, tuple(t for t in terms if t is not None)


def _hardening(
    claim: Claim, stiffness: float, relative: float, scale: float, side: LoadSide | None
) -> tuple[float, float]:
    """The stiffness of the bend cubed, and its standard deviation: by the load's own equation, or
    from two terms of the compliance's series in the torque. ``relative``: of the stiffness.
    """
    told = {t.key: t for t in side.ties} if side is not None else {}
    if "stiffness3" in told:
        cube, load = told["stiffness3"], stiffness / told["stiffness"].ratio
        return cube.ratio * load, math.hypot(cube.std, cube.ratio * relative) * load
    bend = claim.value * stiffness**4 / scale**2
    return bend, math.hypot(claim.std / claim.value, 4.0 * relative) * bend


def _gap(claim: Claim, side: LoadSide | None, pressed: float = 0.0) -> tuple[float, float]:
    """The full width of a gap and its standard deviation: by the load's own equation, or with the
    yielding of both contacts under the RMS torque, known to ``pressed``, subtracted.
    """
    if side is not None and side.gap is not None:
        return side.gap[0], math.hypot(side.gap[1], OF_A_GAP * side.gap[0])
    width = -2.0 * claim.value
    return width, math.hypot(2.0 * claim.std, OF_A_GAP * width, pressed)


def _term(
    model: Model,
    parts: Parts,
    name: str,
    joint: int,
    numbers: dict[str, tuple[float, float]],
    side: LoadSide | None,
) -> Term | None:
    """The term for the model: numbers that the two sensors know well are held; those known no
    better than ``LOOSE`` are fitted to the motor's position. None where the kernel has no such law.

    Of what was not measured, all bodies are the load, and damping starts at a twentieth of
    critical, since the motor's position shows how a load rings. A contact starts with more: one
    that bounces for ever gives no gradient.
    """
    if name == "hysteresis":
        return None
    known = dict(numbers)
    loose = {p for p, (value, std) in known.items() if std >= LOOSE * abs(value)}
    if name != "transmission_error":
        inertia = joint_inertia(parts.fit, model, joint)
        load, std = known.setdefault("load_inertia", (_bodies(parts, model, joint), 0.0))
        if "load_inertia" in loose:  # a motor without inertia would follow any motion
            load = min(load, MOST_LOAD * inertia)
            known["load_inertia"] = load, std
            if side is not None:
                known |= {t.key: (t.ratio * load, t.std * load) for t in side.ties}
        known.setdefault("stiffness", ((2 * math.pi * CONTACT) ** 2 * min(load, inertia), 0.0))
        loss = OF_A_CONTACT if name == "backlash" else OF_A_SPRING
        damping = loss * math.sqrt(known["stiffness"][0] * min(load, inertia))
        known.setdefault("damping", (damping, 0.0))
        dry = side.dry * load if side is not None else 0.0
        known["load_dry"] = dry, 0.0
        known["links_inertia"] = facts(parts.fit.records[0][joint - 1]).links, 0.0
        loose |= {"load_dry"} if dry else set()
    values = {
        p.name: Quantity(
            max(known[p.name][0], p.lower),
            p.name in loose or (p.fitted and p.name not in numbers),
            "",
            known[p.name][1],
        )
        for p in get_effect(name).parameters
    }
    return Term(name, joint, values)


def rubbing(model: Model, joint: int, side: LoadSide | None) -> tuple[Term, ...]:
    """The model's own spring with the dry friction of its load, where two sensors show some."""
    own = [t for t in model.at(joint) if "load_dry" in t.parameters]
    if side is None or not side.dry or not own:
        return ()
    level = Quantity(side.dry * own[0].value(LEADER))
    return (replace(own[0], parameters={**own[0].parameters, "load_dry": level}),)


def _bodies(parts: Parts, model: Model, joint: int) -> float:
    """The mean inertia of the bodies behind a joint, kg m² or kg."""
    record = parts.fit.records[0][joint - 1]
    return facts(record).links or float(np.mean(record.inertia_and_bias(model)[0]))


def _finding(
    model: Model,
    joint: int,
    name: str,
    claim: Claim,
    numbers: dict[str, tuple[float, float]],
    details: DetailsReport,
    share: float,
) -> Finding:
    effect = get_effect(name)
    kind, torque = model.joint_kind(joint), model.torque_unit(joint)
    values = {}
    for key, (value, std) in numbers.items():
        size = next((p.size for p in effect.parameters if p.name == key), "position")
        values[key] = Estimate(value, std, unit_of(size, kind, model.actuator.command_unit, torque))
    same = claim.same
    sure = sure_by(claim.size, claim.left) * (0.5 + 0.5 / (1 + len(same)))
    return Finding(
        name,
        joint,
        values,
        sure,
        share,
        same,
        (),
        _words(name, joint, values, details, torque, same),
        {"details": {"sensors": SENSORS, **details}},
        effect.mechanism,
        {name: 1.0},
    )


def _words(
    name: str,
    joint: int,
    values: dict[str, Estimate],
    details: DetailsReport,
    torque: str,
    same: Sequence[str],
) -> str:
    """A finding in words."""
    if name == "hysteresis" and "torque" in details:
        text = (
            f"The transmission of joint {joint} has hysteresis: unloaded, it stands"
            f" {number(values['step'])} apart after the one torque and after the other (up to"
            f" {details['torque']:.2g} {torque} hold it there)."
        )
    elif name == "hysteresis":
        text = (
            f"The transmission of joint {joint} steps by {number(values['step'])} as the direction"
            " changes: lost motion, or a spring behind dry friction."
        )
    elif name == "elasticity":
        text = f"Joint {joint} is elastic: stiffness {number(values['stiffness'])}."
        if "load_dry" in values:
            text += f" Its load rubs by itself: {number(values['load_dry'])}."
    else:
        text = sentence(Term(name, joint, {}), values)
    text += " Measured by the sensors on both sides of its transmission."
    if same:
        text += f" This recording cannot tell it from {', '.join(same)}."
    return text


def restated(found: Finding, improved: Model) -> Finding:
    """A finding with the numbers of the improved model, where the ratio of a load to its spring was
    held in the fit: the motor's position then tells what the two sensors leave open.
    """
    for term in improved.at(found.joint):
        known = {k: q for k, q in term.parameters.items() if q.std > 0.0}
        if term.effect == found.effect and {"stiffness", LEADER}.issubset(known):
            kind, torque = improved.joint_kind(found.joint), improved.torque_unit(found.joint)
            gapped = "gap" in known
            sure = {"stiffness": CONTACT_KNOWN, "gap": BY_ITS_LOAD} if gapped else {}
            sizes = {p.name: p.size for p in get_effect(term.effect).parameters}
            values = {
                k: Estimate(
                    known[k].value,
                    math.hypot(known[k].std, sure.get(k, MEASURED) * known[k].value),
                    unit_of(sizes[k], kind, improved.actuator.command_unit, torque),
                )
                for k in known
                if k in found.parameters or k == "load_dry"
            }
            details = found.numbers["details"]
            spring = values["stiffness"]
            details = {
                **details,
                "compliance": 1.0 / spring.value,
                "compliance_std": spring.std / spring.value**2,
            }
            text = _words(
                found.effect, found.joint, values, details, torque, found.indistinguishable
            )
            return replace(found, parameters=values, sentence=text, numbers={"details": details})
    return found


def helpful(
    parts: Parts, model: Model, joint: int, terms: tuple[Term, ...], jobs: int
) -> tuple[Term, ...]:
    """The measured terms, where the motor's own prediction is no worse with them."""
    if not terms:
        return ()
    plain = calibrate_joint(parts.fit, model, joint, jobs)
    bent = calibrate_joint(parts.fit, model.with_terms((*model.terms, *terms)), joint, jobs)
    return terms if compare(plain, bent, parts.choose, joint).gain > 0 else ()


def measured(finding: Finding) -> bool:
    """Whether a finding comes from the sensors on both sides of a transmission."""
    details = finding.numbers.get("details")
    return details is not None and details.get("sensors") == SENSORS
