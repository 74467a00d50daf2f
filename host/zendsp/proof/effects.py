"""How each effect of the contract is put into a true machine, at a size that is a knob.

Every function changes the draft's truth, says which friction laws the given model has, and returns what was concealed in
the contract's words. ``size`` 1 is clearly felt (torque effects: about a fifth of the torque's RMS), 0.3 and 0.1 are
that much smaller. ``accepted`` names only what is the same equation by algebra; what a given recording cannot separate is
measured by the oracle, not declared here.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zendsp.proof.draft import Concealed, Draft, Scale
from zendsp.proof.reality import CouplingTruth

Rng = np.random.Generator
Maker = Callable[[Draft, int, Scale, float, Rng], Concealed]
EFFECTS: dict[str, Maker] = {}


def effect(name: str) -> Callable[[Maker], Maker]:
    """Register the function below as the maker of effect `name`."""

    def keep(maker: Maker) -> Maker:
        EFFECTS[name] = maker
        return maker

    return keep


def share(scale: Scale, size: float, rng: Rng) -> float:
    """Torque of an effect: a fifth of the torque's RMS times the knob, spread by 30 % either way."""
    return float(0.2 * size * scale.torque * rng.uniform(0.7, 1.3))


def unit(d: Draft, *, per: str = "", prefix: str = "") -> str:
    """Unit of a torque of this machine (N m or N), per rad or m to some power."""
    force, length = ("N", "m") if d.kind == "linear" else ("N m", "rad")
    return f"{prefix}{force}{per.replace('rad', length)}"


def length(d: Draft) -> str:
    """Unit of a position of this machine."""
    return "m" if d.kind == "linear" else "rad"


def either(rng: Rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def friction(d: Draft, joint: int) -> float:
    """Mean Coulomb level of a joint's truth."""
    j = d.joints[joint]
    return float(0.5 * (j.get("coulomb_pos", 0.0) + j.get("coulomb_neg", 0.0)))


def at_rest(joint: int) -> list[dict[str, object]]:
    """The place of what acts at low speed."""
    return [{"variable": "velocity", "joint": joint + 1, "value": 0.0}]


def set_friction(d: Draft, joint: int, *, coulomb: float | None = None, viscous: float | None = None) -> None:
    if coulomb is not None:
        d.joints[joint].update(coulomb_pos=coulomb, coulomb_neg=coulomb)
    if viscous is not None:
        d.joints[joint].update(viscous_pos=viscous, viscous_neg=viscous)


@effect("viscous")
def _viscous(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    b = share(s, size, rng) / s.v_rms
    set_friction(d, joint, viscous=b)
    d.terms[joint] = {"coulomb"}
    return Concealed("viscous", joint + 1, {"coefficient": (b, unit(d, per=" s/rad"))}, size)


@effect("coulomb")
def _coulomb(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    level = share(s, size, rng)
    set_friction(d, joint, coulomb=level)
    d.terms[joint] = {"viscous"}
    return Concealed("coulomb", joint + 1, {"level": (level, unit(d))}, size)


@effect("coulomb_asymmetry")
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


@effect("viscous_asymmetry")
def _viscous_asymmetry(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    half, way = share(s, size, rng) / s.v_rms, either(rng)
    mean = max(d.joints[joint].get("viscous_pos", 0.0), 1.3 * half)
    pos, neg = mean + way * half, mean - way * half
    d.joints[joint].update(viscous_pos=pos, viscous_neg=neg)
    u = unit(d, per=" s/rad")
    return Concealed(
        "viscous_asymmetry", joint + 1, {"coefficient_pos": (pos, u), "coefficient_neg": (neg, u)}, size
    )


@effect("stribeck")
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


@effect("presliding")
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
        {"stiffness": (stiffness, unit(d, per="/rad")), "damping": (damping, unit(d, per=" s/rad"))},
        size,
        unscored=["damping"],
        where=at_rest(joint),
    )


@effect("quadratic_drag")
def _drag(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    c = share(s, size, rng) / float(np.sqrt(np.mean(s.v**4)))
    d.joints[joint]["drag"] = c
    return Concealed("quadratic_drag", joint + 1, {"coefficient": (c, unit(d, per=" s^2/rad^2"))}, size)


@effect("load_friction")
def _load_friction(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    mu = share(s, size, rng) / s.torque
    d.joints[joint]["load_mu"] = mu
    return Concealed("load_friction", joint + 1, {"coefficient": (mu, "")}, size)


@effect("position_friction")
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


@effect("friction_drift")
def _friction_drift(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    set_friction(d, joint, coulomb=max(friction(d, joint), 0.8 * share(s, 1.0, rng)))
    ratio = size * rng.uniform(0.5, 1.0) * (1.0 if rng.random() < 0.6 else -0.6)
    seconds = d.seconds * rng.uniform(0.15, 0.4)
    d.joints[joint].update(drift_ratio=ratio, drift_time=seconds)
    return Concealed(
        "friction_drift", joint + 1, {"ratio": (ratio, ""), "time_constant": (seconds, "s")}, size
    )


@effect("gravity")
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


@effect("stiffness")
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


@effect("cubic_stiffness")
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


def inertia_of(d: Draft, joint: int) -> float:
    """Typical inertia that joint's motor feels."""
    if d.kind in ("rotary", "linear"):
        return next(iter(d.parameters.values()))
    if d.kind == "planar2r":
        return d.parameters["p1"] if joint == 0 else d.parameters["p2"]
    return float([1.2, 1.2, 0.3, 0.3, 0.02, 0.02, 0.002][joint])


@effect("inertia")
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


@effect("elasticity")
def _elasticity(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    total = inertia_of(d, joint)
    load = total * rng.uniform(0.35, 0.7)
    hz = rng.uniform(7.0, 12.0) / np.sqrt(size)  # resonance of motor against load
    k = (2 * np.pi * hz) ** 2 * load * (total - load) / total
    damping = 2 * rng.uniform(0.02, 0.08) * np.sqrt(k * load * (total - load) / total)
    split(d, joint, load, k, damping, 0.0)
    u = {"stiffness": (k, unit(d, per="/rad")), "damping": (damping, unit(d, per=" s/rad"))}
    return Concealed(
        "elasticity", joint + 1, {**u, "load_inertia": load_unit(d, load)}, size, unscored=["damping"]
    )


@effect("backlash")
def _backlash(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    total = inertia_of(d, joint)
    load = total * rng.uniform(0.35, 0.7)
    gap = 0.03 * size * s.reach / 3 * rng.uniform(0.7, 1.3)
    hz = rng.uniform(30.0, 60.0)
    k = (2 * np.pi * hz) ** 2 * load * (total - load) / total
    split(d, joint, load, k, 2 * 0.1 * np.sqrt(k * load * (total - load) / total), gap)
    u = {"gap": (gap, length(d)), "stiffness": (k, unit(d, per="/rad")), "load_inertia": load_unit(d, load)}
    return Concealed("backlash", joint + 1, u, size, unscored=["stiffness"], where=at_rest(joint))


def load_unit(d: Draft, load: float) -> tuple[float, str]:
    return load, "kg" if d.kind == "linear" else "kg m^2"


def split(d: Draft, joint: int, load: float, k: float, damping: float, gap: float) -> None:
    """Divide one inertia into motor and load with a spring between them; the rigid total stays."""
    motor = inertia_of(d, joint) - load
    d.joints[joint].update(trans_stiffness=k, trans_damping=damping, trans_gap=gap, motor_inertia=motor)
    d.joints[joint]["extra_inertia"] = d.joints[joint].get("extra_inertia", 0.0) - motor


@effect("hysteresis")
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


@effect("ripple")
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
        {"order": (order, f"1/{length(d)}"), "amplitude": (amplitude, unit(d)), "phase": (phase, "rad")},
        size,
        unscored=["phase"],
    )


@effect("torque_gain")
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


@effect("torque_offset")
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


@effect("dead_zone")
def _dead_zone(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    width = share(s, size, rng) / d.joints[joint].get("gain", 1.0)
    d.joints[joint]["dead_zone"] = width
    return Concealed("dead_zone", joint + 1, {"width": (width, "command")}, size)


@effect("saturation")
def _saturation(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    quantile = {1.0: 0.93, 0.3: 0.975, 0.1: 0.993}[size]
    level = float(np.quantile(np.abs(s.command), quantile)) * rng.uniform(0.97, 1.03)
    d.joints[joint]["saturation"] = level
    return Concealed("saturation", joint + 1, {"level": (level, "command")}, size)


@effect("lag")
def _lag(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    seconds = 0.008 * size * rng.uniform(0.7, 1.3)
    d.joints[joint]["lag"] = seconds
    return Concealed("lag", joint + 1, {"time_constant": (seconds, "s")}, size)


@effect("delay")
def _delay(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    seconds = 0.008 * size * rng.uniform(0.7, 1.3)
    d.joints[joint]["delay"] = d.joints[joint].get("delay", 0.0) + seconds
    return Concealed("delay", joint + 1, {"time": (seconds, "s")}, size)


@effect("encoder_eccentricity")
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


@effect("coupling")
def _coupling(d: Draft, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    other = int(rng.choice([i for i in (joint - 1, joint + 1) if 0 <= i < d.n]))
    law = str(rng.choice(["inertia", "coriolis", "viscous", "coulomb"]))
    torque = share(s, size, rng)
    # s is the joint that suffers; its neighbour's motion is of the same order by construction of the references
    size_of = {
        "inertia": float(np.std(s.a)),
        "coriolis": float(np.mean(s.v**2)),
        "viscous": s.v_rms,
        "coulomb": 1.0,
    }
    c = torque / size_of[law]
    per = {"inertia": "kg m^2", "coriolis": "N m s^2/rad^2", "viscous": "N m s/rad", "coulomb": "N m"}[law]
    d.couplings.append(CouplingTruth(joint, other, law, c))
    joints = [joint + 1]
    if law == "inertia":  # a shared rotor acts on both
        d.couplings.append(CouplingTruth(other, joint, law, c))
        joints = [joint + 1, other + 1]
    return Concealed(
        "coupling",
        joint + 1,
        {"coefficient": (c, per)},
        size,
        accepted_joints=joints,
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
        round(float(v) * d.seconds, 3) for v in (x[np.abs(torque) > 0].min(), x[np.abs(torque) > 0].max())
    ]
    return Concealed(
        "disturbance",
        joint + 1,
        {},
        size,
        note=f"pushes between {where[0]} s and {where[1]} s",
        where=[{"variable": "time", "interval": where}],
    )


EFFECTS["disturbance"] = add_disturbance
SINGLE = tuple(EFFECTS)
