"""Concealed friction: viscous, dry, at rest, with load, position and time."""

from __future__ import annotations

import numpy as np

from zendsp.proof.draft import Concealed, Draft, Scale
from zendsp.proof.effect_kit import (
    Maker,
    Rng,
    at_rest,
    effect,
    either,
    friction,
    inertia_of,
    length,
    set_friction,
    share,
    unit,
)

MAKERS: dict[str, Maker] = {}


@effect(MAKERS, "viscous")
def _viscous(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    b = share(s, size, rng) / s.v_rms
    set_friction(d, joint, viscous=b)
    d.terms[joint] = {"coulomb"}
    return Concealed("viscous", joint + 1, {"coefficient": (b, unit(d, per=" s/rad"))}, size)


@effect(MAKERS, "coulomb")
def _coulomb(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    level = share(s, size, rng)
    set_friction(d, joint, coulomb=level)
    d.terms[joint] = {"viscous"}
    return Concealed("coulomb", joint + 1, {"level": (level, unit(d))}, size)


@effect(MAKERS, "coulomb_asymmetry")
def _coulomb_asymmetry(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    half, way = share(s, size, rng), either(rng)
    mean = max(friction(d, joint), 1.3 * half)
    pos, neg = mean + way * half, mean - way * half
    d.joints[joint].update(coulomb_pos=pos, coulomb_neg=neg)
    return Concealed(
        "coulomb_asymmetry",
        joint + 1,
        {"level_pos": (pos, unit(d)), "level_neg": (neg, unit(d))},
        size,
        accepted=["torque_offset"],
        note="while it moves, asymmetric Coulomb is mean * sign(v) + a constant",
    )


@effect(MAKERS, "viscous_asymmetry")
def _viscous_asymmetry(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    half, way = share(s, size, rng) / s.v_rms, either(rng)
    mean = max(d.joints[joint].get("viscous_pos", 0.0), 1.3 * half)
    pos, neg = mean + way * half, mean - way * half
    d.joints[joint].update(viscous_pos=pos, viscous_neg=neg)
    u = unit(d, per=" s/rad")
    return Concealed(
        "viscous_asymmetry",
        joint + 1,
        {"coefficient_pos": (pos, u), "coefficient_neg": (neg, u)},
        size,
    )


@effect(MAKERS, "stribeck")
def _stribeck(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    velocity = s.v_rms * rng.uniform(0.08, 0.25)
    extra = 1.5 * share(s, size, rng)
    level = max(friction(d, joint), 0.7 * extra)
    set_friction(d, joint, coulomb=level)
    d.joints[joint].update(stribeck_extra=extra, stribeck_velocity=velocity)
    return Concealed(
        "stribeck",
        joint + 1,
        {"breakaway": (level + extra, unit(d)), "velocity": (velocity, f"{length(d)}/s")},
        size,
        where=at_rest(joint),
    )


@effect(MAKERS, "presliding")
def _presliding(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    level = max(friction(d, joint), share(s, 1.0, rng))
    set_friction(d, joint, coulomb=level)
    bend = 0.03 * size * s.reach / 3 * rng.uniform(0.7, 1.3)  # 30 mrad in 3 rad of travel at size 1
    stiffness = level / bend
    damping = 0.0 if rng.random() < 0.5 else 0.3 * np.sqrt(stiffness * inertia_of(d, joint))
    d.joints[joint].update(bristle_stiffness=stiffness, bristle_damping=damping)
    return Concealed(
        "presliding",
        joint + 1,
        {
            "stiffness": (stiffness, unit(d, per="/rad")),
            "damping": (damping, unit(d, per=" s/rad")),
        },
        size,
        unscored=["damping"],
        where=at_rest(joint),
    )


@effect(MAKERS, "quadratic_drag")
def _drag(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    c = share(s, size, rng) / float(np.sqrt(np.mean(s.v**4)))
    d.joints[joint]["drag"] = c
    return Concealed(
        "quadratic_drag", joint + 1, {"coefficient": (c, unit(d, per=" s^2/rad^2"))}, size
    )


@effect(MAKERS, "load_friction")
def _load_friction(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    mu = share(s, size, rng) / s.torque
    d.joints[joint]["load_mu"] = mu
    return Concealed("load_friction", joint + 1, {"coefficient": (mu, "")}, size)


@effect(MAKERS, "position_friction")
def _position_friction(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    amplitude = share(s, size, rng) * 1.4
    set_friction(d, joint, coulomb=max(friction(d, joint), 1.15 * amplitude))
    if d.kind == "linear":
        period = s.reach * rng.uniform(0.15, 0.5)
    else:
        period = 2 * np.pi / rng.integers(max(1, int(7 / s.reach)), max(3, int(24 / s.reach)) + 1)
    phase = rng.uniform(-np.pi, np.pi)
    d.joints[joint].update(level_amplitude=amplitude, level_period=period, level_phase=phase)
    return Concealed(
        "position_friction",
        joint + 1,
        {"amplitude": (amplitude, unit(d)), "period": (period, length(d)), "phase": (phase, "rad")},
        size,
        unscored=["phase"],
    )


@effect(MAKERS, "friction_drift")
def _friction_drift(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    set_friction(d, joint, coulomb=max(friction(d, joint), 0.8 * share(s, 1.0, rng)))
    ratio = size * rng.uniform(0.5, 1.0) * (1.0 if rng.random() < 0.6 else -0.6)
    seconds = d.seconds * rng.uniform(0.15, 0.4)
    d.joints[joint].update(drift_ratio=ratio, drift_time=seconds)
    return Concealed(
        "friction_drift", joint + 1, {"ratio": (ratio, ""), "time_constant": (seconds, "s")}, size
    )
