"""Actuators, measurement, and pushes from outside."""

from __future__ import annotations

from math import exp, pi

import numpy as np

from zendsp.proof.draft import Concealed, Scale
from zendsp.proof.mujoco.kit import maker, truth, unit
from zendsp.proof.mujoco.machines import Bench

Rng = np.random.Generator


# actuator


@maker("torque_gain")
def _gain(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    b.fixed = True
    b.joints[joint].gain *= 0.93
    return truth(
        b, "torque_gain", joint, size, {"ratio": (-0.07, "")},
        note="friction is free, inertia is not",
    )


@maker("gain_drift")
def _gain_drift(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    ratio, tau = -rng.uniform(0.06, 0.12), b.seconds * rng.uniform(0.2, 0.5)
    b.laws.append((joint, lambda h: lambda t, q, v, u: u * ratio * (1 - exp(-t / tau))))
    values = {"ratio": (ratio, ""), "time_constant": (tau, "s")}
    return truth(
        b, "gain_drift", joint, size, values, ("torque_gain",), unscored=("time_constant", "ratio")
    )


@maker("torque_offset")
def _offset(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    level = size * s.torque * float(rng.choice([-1.0, 1.0]))
    b.joints[joint].offset = level
    return truth(
        b, "torque_offset", joint, size, {"level": (level, unit(b))}, ("coulomb_asymmetry",),
        ("dry_friction",), note="while it moves, asymmetric Coulomb is a constant more",
    )  # fmt: skip


@maker("saturation")
def _saturation(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    level = float(np.quantile(np.abs(s.drive), 1 - 0.15 * size))
    b.joints[joint].force_limit = level
    command = level / b.joints[joint].gain
    return truth(
        b,
        "saturation",
        joint,
        size,
        {"level": (command, "command")},
        ("voltage_limit",),
        note="forcerange",
    )


@maker("voltage_limit")
def _voltage(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """Back-EMF leaves less torque at speed."""
    top = float(np.quantile(np.abs(s.drive), 1 - 0.4 * size))
    slope = 0.35 * top / s.v_peak

    def torque(t: float, q: float, v: float, u: float) -> float:
        return float(min(max(u, -top - slope * v), top - slope * v)) - u

    b.laws.append((joint, lambda h: torque))
    values = {"level": (top, unit(b)), "slope": (slope, unit(b, " s/rad"))}
    return truth(
        b, "voltage_limit", joint, size, values, ("saturation",), unscored=("level", "slope")
    )


@maker("dead_zone")
def _dead_zone(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    width = size * s.torque / b.joints[joint].gain
    b.joints[joint].dead_zone = width
    return truth(b, "dead_zone", joint, size, {"width": (width, "command")})


@maker("lag")
def _lag(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    seconds = max(0.03 * size / b.bandwidth * 12, 1.5 * b.sample_time)
    b.joints[joint].lag = seconds
    accepted = ("delay",) if seconds < 2.5 * b.sample_time else ()
    alone = b.n == 1  # a linear filter before the joint or behind its sensor is one
    return truth(
        b,
        "lag",
        joint,
        size,
        {"time_constant": (seconds, "s")},
        (*accepted, "position_filter") if alone else accepted,
        ("measurement",) if alone else (),
        note="filterexact",
    )


@maker("delay")
def _delay(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    seconds = b.sample_time * float(rng.choice([1.0, 1.5, 2.0, 3.0]))
    b.joints[joint].delay = seconds
    accepted = ("column_shift", "lag") if b.n == 1 else ("lag",)
    return truth(
        b, "delay", joint, size, {"time": (seconds, "s")}, accepted,
        ("measurement",) if b.n == 1 else (),
        note="with one joint a delay of the drive and a late column are one",
    )  # fmt: skip


# measurement


@maker("sensor_harmonic")
def _harmonic(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    order, amplitude = float(rng.choice([2.0, 3.0, 4.0])), 0.01 * max(size, 0.1) / 0.2 * s.reach / 4
    b.sensor.append((joint, order, amplitude, rng.uniform(-pi, pi)))
    values = {"order": (order, "1/rad"), "amplitude": (amplitude, "rad")}
    return truth(b, "sensor_harmonic", joint, size, values)


@maker("encoder_eccentricity")
def _eccentricity(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    amplitude = 0.02 * max(size, 0.1) / 0.2 * s.reach / 4
    b.sensor.append((joint, 1.0, amplitude, rng.uniform(-pi, pi)))
    return truth(b, "encoder_eccentricity", joint, size, {"amplitude": (amplitude, "rad")})


@maker("column_shift")
def _shift(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    rows = int(rng.choice([-2, -1, 1, 2]))
    b.faults.append(f"shift {rows}")
    late = ("delay",) if rows < 0 else ()
    return truth(
        b, "column_shift", 0, size, {"time": (rows * b.sample_time, "s")}, late,
        ("actuator",) if rows < 0 else (), unscored=("time",), joints=tuple(range(b.n)),
        note=f"the command column is {abs(rows)} rows {'late' if rows > 0 else 'early'}",
    )  # fmt: skip


@maker("position_filter")
def _filter(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    seconds = b.sample_time * rng.uniform(2.0, 5.0)
    b.faults.append(f"filter {seconds!r}")
    alone = b.n == 1  # as with lag
    return truth(
        b,
        "position_filter",
        0,
        size,
        {"time_constant": (seconds, "s")},
        ("lag",) if alone else (),
        ("actuator",) if alone else (),
        joints=tuple(range(b.n)),
        note="every position column low-passed",
    )


# from outside


@maker("disturbance")
def _push(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """A push of 3 s at the same times in every recording."""
    level = 1.5 * max(size, 0.2) * s.torque * float(rng.choice([-1.0, 1.0]))
    begin = b.seconds * rng.uniform(0.2, 0.6)
    b.pushes.append((joint, begin, begin + 3.0, level))
    out = truth(b, "disturbance", joint, size, {}, note=f"{level:.3g} from {begin:.2f} s for 3 s")
    out.where.append({"variable": "time", "interval": [round(begin, 3), round(begin + 3.0, 3)]})
    return out
