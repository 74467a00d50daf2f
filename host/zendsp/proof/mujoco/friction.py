"""Dry and fluid friction: MuJoCo's own, and laws that it does not have by formulas of ours."""

from __future__ import annotations

from collections.abc import Callable
from math import copysign, exp, pi, sin, tanh

import numpy as np

from zendsp.proof.draft import Concealed, Scale
from zendsp.proof.mujoco.kit import MAKERS, Maker, maker, truth, unit
from zendsp.proof.mujoco.machines import Bench, Law, hardness

Rng = np.random.Generator


def unknown_dry(b: Bench, joint: int) -> None:
    """The reality has no other dry friction there, and the given model has none."""
    b.joints[joint].dry = 0.0
    b.hidden[joint].add("coulomb")


def smooth(s: Scale) -> float:
    """Speed over which our own dry friction turns around: a thousandth of the motion's speed."""
    return 1e-3 * s.v_rms


# dry friction


def mujoco_dry(soft: bool) -> Maker:
    """The maker of MuJoCo's own dry friction; ``soft``: it creeps before it breaks away."""
    def make(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
        unknown_dry(b, joint)
        j = b.joints[joint]
        j.dry = size * s.torque
        j.solref, j.solimp = hardness(soft)
        accepted = ("presliding",) if soft else ()
        note = f"MuJoCo's frictionloss, {'soft' if soft else 'hard'}"
        return truth(b, "coulomb", joint, size, {"level": (j.dry, unit(b))}, accepted, note=note)

    return make


MAKERS["dry_hard"] = mujoco_dry(False)
MAKERS["dry_soft"] = mujoco_dry(True)


@maker("dry_tanh")
def _tanh(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    level, width = size * s.torque, rng.uniform(0.005, 0.02) * s.v_rms
    unknown_dry(b, joint)
    b.laws.append((joint, lambda h: lambda t, q, v, u: -level * tanh(v / width)))
    note = f"level · tanh(v / {width:.3g})"
    return truth(b, "coulomb", joint, size, {"level": (level, unit(b))}, ("presliding",), note=note)


def lugre(fc: float, fs: float, vs: float, stiffness: float) -> Law:
    """Bristle friction of Canudas de Wit et al. 1995, undamped, the bristle stepped exactly for a
    held speed.
    """

    def fresh(h: float) -> Callable[[float, float, float, float], float]:
        z = 0.0

        def torque(t: float, q: float, v: float, u: float) -> float:
            nonlocal z
            level = fc + (fs - fc) * exp(-((v / vs) ** 2))
            rate = stiffness * abs(v) / level
            end = copysign(level / stiffness, v)
            old = z
            z = end + (z - end) * exp(-rate * h) if rate > 0 else z
            return -stiffness * 0.5 * (z + old)

        return torque

    return fresh


@maker("lugre")
def _lugre(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    level = size * s.torque
    unknown_dry(b, joint)
    bristle = s.reach * rng.uniform(0.002, 0.01)
    stiffness = level / bristle
    rise, slip = rng.uniform(1.2, 1.7), rng.uniform(0.03, 0.1) * s.v_rms
    b.laws.append((joint, lugre(level, rise * level, slip, stiffness)))
    return truth(
        b,
        "presliding",
        joint,
        size,
        {"stiffness": (stiffness, unit(b, "/rad"))},
        ("coulomb", "stribeck", "hysteresis"),
        unscored=("stiffness",),
        note="LuGre, no damping of the bristle",
    )


@maker("stribeck")
def _stribeck(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    level = size * s.torque
    unknown_dry(b, joint)
    slip, edge = rng.uniform(0.1, 0.3) * s.v_rms, smooth(s)
    top = level * rng.uniform(1.6, 2.4)

    def torque(t: float, q: float, v: float, u: float) -> float:
        return -(level + (top - level) * exp(-((v / slip) ** 2))) * tanh(v / edge)

    b.laws.append((joint, lambda h: torque))
    values = {"breakaway": (top, unit(b)), "velocity": (slip, "rad/s")}
    return truth(b, "stribeck", joint, size, values, ("coulomb",), unscored=("velocity",))


@maker("coulomb_asymmetry")
def _asymmetry(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    unknown_dry(b, joint)
    up, down, edge = size * s.torque * 1.3, size * s.torque * 0.7, smooth(s)
    b.laws.append((joint, lambda h: lambda t, q, v, u: -(up if v > 0 else down) * tanh(v / edge)))
    values = {"level_pos": (up, unit(b)), "level_neg": (down, unit(b))}
    return truth(
        b,
        "coulomb_asymmetry",
        joint,
        size,
        values,
        ("coulomb",),
        note="Coulomb and an offset, by algebra",
    )


@maker("load_friction")
def _load_friction(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    edge = smooth(s)
    b.laws.append((joint, lambda h: lambda t, q, v, u: -size * abs(u) * tanh(v / edge)))
    return truth(
        b, "load_friction", joint, size, {"coefficient": (size, "")}, unscored=("coefficient",)
    )


@maker("position_friction")
def _position_friction(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    level = 1.4 * size * s.torque
    period, phase, edge = s.reach * rng.uniform(0.3, 0.8), rng.uniform(-pi, pi), smooth(s)
    least = -b.joints[joint].dry  # no place drives the joint

    def torque(t: float, q: float, v: float, u: float) -> float:
        return -max(level * sin(2 * pi * q / period + phase), least) * tanh(v / edge)

    b.laws.append((joint, lambda h: torque))
    values = {"amplitude": (level, unit(b)), "period": (period, "rad")}
    return truth(b, "position_friction", joint, size, values)


@maker("friction_drift")
def _drift(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """Dry friction that the given model has, warming up: its level falls."""
    level, edge = 2.5 * size * s.torque, smooth(s)
    b.joints[joint].dry, b.nominal_dry[joint] = 0.0, 0.8 * level
    ratio, tau = -rng.uniform(0.4, 0.6), b.seconds * rng.uniform(0.2, 0.5)

    def torque(t: float, q: float, v: float, u: float) -> float:
        return -level * (1 + ratio * (1 - exp(-t / tau))) * tanh(v / edge)

    b.laws.append((joint, lambda h: torque))
    return truth(
        b, "friction_drift", joint, size, {"ratio": (ratio, ""), "time_constant": (tau, "s")},
        unscored=("time_constant", "ratio"),
    )  # fmt: skip


# fluid friction


@maker("viscous")
def _viscous(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    b.hidden[joint].add("viscous")
    c = size * s.torque / s.v_rms
    b.joints[joint].damping = c
    return truth(b, "viscous", joint, size, {"coefficient": (c, unit(b, " s/rad"))})


@maker("quadratic_drag")
def _drag(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    c = size * s.torque / float(np.sqrt(np.mean(s.v**4)))
    b.laws.append((joint, lambda h: lambda t, q, v, u: -c * v * abs(v)))
    return truth(b, "quadratic_drag", joint, size, {"coefficient": (c, unit(b, " s^2/rad^2"))})


@maker("viscous_asymmetry")
def _viscous_asymmetry(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    extra = 2 * size * s.torque / s.v_rms
    damping = b.joints[joint].damping
    b.laws.append((joint, lambda h: lambda t, q, v, u: -extra * v if v > 0 else 0.0))
    values = {
        "coefficient_pos": (damping + extra, unit(b, " s/rad")),
        "coefficient_neg": (damping, unit(b, " s/rad")),
    }
    return truth(b, "viscous_asymmetry", joint, size, values)
