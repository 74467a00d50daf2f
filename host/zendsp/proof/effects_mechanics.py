"""Concealed mechanics: gravity, springs, inertia, transmissions with a spring or a gap, hysteresis.
"""

from __future__ import annotations

import numpy as np

from zendsp.proof.draft import Concealed, Draft, Scale
from zendsp.proof.effect_kit import (
    Maker,
    Rng,
    at_rest,
    effect,
    either,
    inertia_of,
    length,
    share,
    unit,
)

MAKERS: dict[str, Maker] = {}


@effect(MAKERS, "gravity")
def _gravity(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    level = 1.4 * share(s, size, rng)
    angle = rng.uniform(-np.pi, np.pi)
    unscored: list[str] = []
    if d.kind == "rotary" and d.parameters.get("gravity", 0.0) == 0.0:
        d.absent.add("gravity")
    elif d.kind == "rotary":  # a tilted base: only the part across the known one survives the refit
        angle = either(rng) * np.pi / 2
        unscored = ["torque", "angle"]
    d.joints[joint].update(gravity=level, gravity_angle=angle)
    return Concealed(
        "gravity",
        joint + 1,
        {"torque": (level, unit(d)), "angle": (angle, "rad")},
        size,
        accepted=["ripple"],
        unscored=unscored,
        note="ripple of order 1 is the same equation",
    )


@effect(MAKERS, "stiffness")
def _stiffness(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    neutral = float(s.q.mean() + 0.3 * s.reach * rng.uniform(-1, 1))
    k = share(s, size, rng) / float(np.sqrt(np.mean((s.q - neutral) ** 2)))
    d.joints[joint].update(stiffness=k, neutral=neutral)
    return Concealed(
        "stiffness",
        joint + 1,
        {"coefficient": (k, unit(d, per="/rad")), "neutral": (neutral, length(d))},
        size,
    )


@effect(MAKERS, "cubic_stiffness")
def _cubic(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    neutral = float(s.q.mean() + 0.15 * s.reach * rng.uniform(-1, 1))
    k = share(s, size, rng) / float(np.sqrt(np.mean((s.q - neutral) ** 6)))
    d.joints[joint].update(cubic=k, cubic_neutral=neutral)
    return Concealed(
        "cubic_stiffness",
        joint + 1,
        {"coefficient": (k, unit(d, per="/rad^3")), "neutral": (neutral, length(d))},
        size,
    )


@effect(MAKERS, "inertia")
def _inertia(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    amount = share(s, size, rng) / float(np.sqrt(np.mean(s.a**2)))
    d.joints[joint]["extra_inertia"] = amount
    accepted = ["torque_gain"]
    names = list(d.parameters)
    d.fixed.update(names)
    unscored: list[str] = []
    if d.kind == "rotary" and d.parameters.get("gravity", 0.0) != 0.0:  # a payload changes both
        more = amount * rng.uniform(0.8, 1.2) * d.parameters["gravity"] / d.parameters["inertia"]
        d.joints[joint].update(gravity=more, gravity_angle=0.0)
        accepted += ["gravity"]
    what = "kg" if d.kind == "linear" else "kg m^2"
    return Concealed(
        "inertia",
        joint + 1,
        {"amount": (amount, what)},
        size,
        accepted=accepted,
        unscored=unscored,
        note="with friction free, an actuator gain and an inertia error differ by scale only",
    )


@effect(MAKERS, "elasticity")
def _elasticity(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    total = inertia_of(d, joint)
    load = total * rng.uniform(0.35, 0.7)
    hz = rng.uniform(7.0, 12.0) / np.sqrt(size)  # resonance of motor against load
    k = (2 * np.pi * hz) ** 2 * load * (total - load) / total
    damping = 2 * rng.uniform(0.02, 0.08) * np.sqrt(k * load * (total - load) / total)
    split(d, joint, load, k, damping, 0.0)
    u = {"stiffness": (k, unit(d, per="/rad")), "damping": (damping, unit(d, per=" s/rad"))}
    return Concealed(
        "elasticity", joint + 1, {**u, "load_inertia": _load_unit(d, load)}, size,
        unscored=["damping"],
    )


@effect(MAKERS, "backlash")
def _backlash(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    total = inertia_of(d, joint)
    load = total * rng.uniform(0.35, 0.7)
    gap = 0.03 * size * s.reach / 3 * rng.uniform(0.7, 1.3)
    hz = rng.uniform(30.0, 60.0)
    k = (2 * np.pi * hz) ** 2 * load * (total - load) / total
    split(d, joint, load, k, 2 * 0.1 * np.sqrt(k * load * (total - load) / total), gap)
    u = {
        "gap": (gap, length(d)),
        "stiffness": (k, unit(d, per="/rad")),
        "load_inertia": _load_unit(d, load),
    }
    return Concealed("backlash", joint + 1, u, size, unscored=["stiffness"], where=at_rest(joint))


def _load_unit(d: Draft, load: float) -> tuple[float, str]:
    return load, "kg" if d.kind == "linear" else "kg m^2"


def split(d: Draft, joint: int, load: float, k: float, damping: float, gap: float) -> None:
    """Divide one inertia into motor and load with a spring between them; the rigid total stays."""
    motor = inertia_of(d, joint) - load
    d.joints[joint].update(
        trans_stiffness=k, trans_damping=damping, trans_gap=gap, motor_inertia=motor
    )
    d.joints[joint]["extra_inertia"] = d.joints[joint].get("extra_inertia", 0.0) - motor


@effect(MAKERS, "hysteresis")
def _hysteresis(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    force = share(s, size, rng)
    bend = s.reach * rng.uniform(0.04, 0.12)
    exponent = float(rng.choice([1.0, 1.5, 2.0]))
    d.joints[joint].update(bw_force=force, bw_stiffness=force / bend, bw_exponent=exponent)
    return Concealed(
        "hysteresis",
        joint + 1,
        {
            "force": (force, unit(d)),
            "stiffness": (force / bend, unit(d, per="/rad")),
            "exponent": (exponent, ""),
        },
        size,
        unscored=["exponent"],
    )
