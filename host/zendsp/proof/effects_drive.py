"""Concealed drives, sensors, couplings between joints, and pushes from outside."""

from __future__ import annotations

import numpy as np

from zendsp.proof.draft import Concealed, Draft, Scale
from zendsp.proof.effect_kit import Maker, Rng, effect, either, length, share, unit
from zendsp.proof.reality import CouplingTruth

MAKERS: dict[str, Maker] = {}


@effect(MAKERS, "ripple")
def _ripple(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    amplitude = 1.4 * share(s, size, rng)
    if d.kind == "linear":
        order = 2 * np.pi / float(rng.choice([0.0025, 0.005, 0.01]))
    else:
        order = float(rng.choice([3, 4, 6, 7, 8, 11, 12, 14, 18, 24]))
    phase = rng.uniform(-np.pi, np.pi)
    d.joints[joint].update(
        ripple_order=(order, 0.0), ripple_amplitude=(amplitude, 0.0), ripple_phase=(phase, 0.0)
    )
    return Concealed(
        "ripple",
        joint + 1,
        {
            "order": (order, f"1/{length(d)}"),
            "amplitude": (amplitude, unit(d)),
            "phase": (phase, "rad"),
        },
        size,
        unscored=["phase"],
    )


@effect(MAKERS, "torque_gain")
def _torque_gain(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    ratio = either(rng) * 0.2 * size * rng.uniform(0.7, 1.3)
    d.joints[joint]["gain"] = d.joints[joint].get("gain", 1.0) * (1 + ratio)
    d.fixed.update(d.parameters)
    accepted = ["inertia"]
    if rng.random() < 0.5:
        d.fixed_terms = True
        accepted = []
    elif d.parameters.get("gravity", 0.0) != 0.0:
        accepted += ["gravity"]
    return Concealed(
        "torque_gain",
        joint + 1,
        {"ratio": (ratio, "")},
        size,
        accepted=accepted,
        note="with friction free, an actuator gain and an inertia error differ by scale only",
    )


@effect(MAKERS, "torque_offset")
def _torque_offset(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    level = either(rng) * share(s, size, rng)
    d.joints[joint]["torque_offset"] = level
    return Concealed(
        "torque_offset",
        joint + 1,
        {"level": (level, unit(d))},
        size,
        accepted=["coulomb_asymmetry"],
        note="while it moves, asymmetric Coulomb is mean * sign(v) + a constant",
    )


@effect(MAKERS, "dead_zone")
def _dead_zone(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    width = share(s, size, rng) / d.joints[joint].get("gain", 1.0)
    d.joints[joint]["dead_zone"] = width
    return Concealed("dead_zone", joint + 1, {"width": (width, "command")}, size)


@effect(MAKERS, "saturation")
def _saturation(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    quantile = {1.0: 0.93, 0.3: 0.975, 0.1: 0.993}[size]
    level = float(np.quantile(np.abs(s.command), quantile)) * rng.uniform(0.97, 1.03)
    d.joints[joint]["saturation"] = level
    return Concealed("saturation", joint + 1, {"level": (level, "command")}, size)


@effect(MAKERS, "lag")
def _lag(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    seconds = 0.008 * size * rng.uniform(0.7, 1.3)
    d.joints[joint]["lag"] = seconds
    return Concealed("lag", joint + 1, {"time_constant": (seconds, "s")}, size)


@effect(MAKERS, "delay")
def _delay(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    seconds = 0.008 * size * rng.uniform(0.7, 1.3)
    d.joints[joint]["delay"] = d.joints[joint].get("delay", 0.0) + seconds
    return Concealed("delay", joint + 1, {"time": (seconds, "s")}, size)


@effect(MAKERS, "encoder_eccentricity")
def _eccentricity(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    amplitude = 0.03 * size * rng.uniform(0.7, 1.3)
    phase = rng.uniform(-np.pi, np.pi)
    d.joints[joint].update(eccentricity=amplitude, eccentricity_phase=phase)
    return Concealed(
        "encoder_eccentricity",
        joint + 1,
        {"amplitude": (amplitude, "rad"), "phase": (phase, "rad")},
        size,
        unscored=["phase"],
    )


@effect(MAKERS, "coupling")
def _coupling(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    other = int(rng.choice([i for i in (joint - 1, joint + 1) if 0 <= i < d.n]))
    law = str(rng.choice(["inertia", "coriolis", "viscous", "coulomb"]))
    torque = share(s, size, rng)
    # s is the joint that suffers; its neighbour's motion is of the same order by construction of
    # the references
    size_of = {
        "inertia": float(np.std(s.a)),
        "coriolis": float(np.mean(s.v**2)),
        "viscous": s.v_rms,
        "coulomb": 1.0,
    }
    c = torque / size_of[law]
    per = {
        "inertia": "kg m^2",
        "coriolis": "N m s^2/rad^2",
        "viscous": "N m s/rad",
        "coulomb": "N m",
    }[law]
    d.couplings.append(CouplingTruth(joint, other, law, c))
    joints = [joint + 1]
    if law == "inertia":  # a shared rotor acts on both
        d.couplings.append(CouplingTruth(other, joint, law, c))
        joints = [joint + 1, other + 1]
    return Concealed(
        "coupling", joint + 1, {"coefficient": (c, per)}, size, accepted_joints=joints,
        note=f"from joint {other + 1}, law {law}",
    )


def add_disturbance(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """A push or a few, at times that have nothing to do with the state, or a slow wander."""
    x = np.linspace(0, 1, 4001)
    torque = np.zeros_like(x)
    for _ in range(rng.integers(1, 5)):
        start, width = rng.uniform(0.05, 0.9), rng.uniform(0.01, 0.08)
        inside = np.clip((x - start) / width, 0, 1)
        torque += either(rng) * rng.uniform(0.6, 1.4) * np.sin(np.pi * inside) ** 2
    torque *= 5 * share(s, size, rng)
    d.disturbance.append((joint, torque))
    where = [
        round(float(v) * d.seconds, 3)
        for v in (x[np.abs(torque) > 0].min(), x[np.abs(torque) > 0].max())
    ]
    return Concealed(
        "disturbance",
        joint + 1,
        {},
        size,
        note=f"pushes between {where[0]} s and {where[1]} s",
        where=[{"variable": "time", "interval": where}],
    )
