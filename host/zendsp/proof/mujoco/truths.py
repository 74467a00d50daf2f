"""What is concealed in a MuJoCo reality, by effect: MuJoCo's own parts where it has them, formulas of ours elsewhere.

Each maker changes the bench and returns the truth in the words of the contract. Sizes are shares of the RMS torque.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import copysign, exp, pi, sin, tanh

import numpy as np

from zendsp.proof.build_case import Unusable
from zendsp.proof.draft import Concealed, Scale
from zendsp.proof.mujoco.chain import numbers
from zendsp.proof.mujoco.machines import Bench, Law, hardness
from zendsp.proof.mujoco.simulate import Nominal

Rng = np.random.Generator
Maker = Callable[[Bench, int, Scale, float, Rng], Concealed]
MAKERS: dict[str, Maker] = {}


def maker(name: str) -> Callable[[Maker], Maker]:
    """Enter the function below as the maker of `name`."""

    def keep(function: Maker) -> Maker:
        MAKERS[name] = function
        return function

    return keep


def unit(b: Bench, per: str = "") -> str:
    force, length = ("N", "m") if b.kind == "linear" else ("N m", "rad")
    return f"{force}{per.replace('rad', length)}"


def truth(
    b: Bench, effect: str, joint: int, size: float, parameters: dict[str, tuple[float, str]],
    accepted: tuple[str, ...] = (), mechanisms: tuple[str, ...] = (), unscored: tuple[str, ...] = (),
    note: str = "", body: str = "", joints: tuple[int, ...] = (),
) -> Concealed:  # fmt: skip
    return Concealed(
        effect, joint + 1, parameters, size, accepted=list(accepted), unscored=list(unscored), note=note,
        mechanisms=list(mechanisms), body=body, accepted_joints=[j + 1 for j in joints],
    )  # fmt: skip


def unknown_dry(b: Bench, joint: int) -> None:
    """The reality has no other dry friction there, and the given model has none."""
    b.joints[joint].dry = 0.0
    b.hidden[joint].add("coulomb")


def smooth(s: Scale) -> float:
    """Speed over which our own dry friction turns around: a thousandth of the motion's speed."""
    return 1e-3 * s.v_rms


# dry friction


def mujoco_dry(soft: bool) -> Maker:
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


def lugre(fc: float, fs: float, vs: float, stiffness: float, damping: float) -> Law:
    """Bristle friction of Canudas de Wit et al. 1995, the bristle stepped exactly for a held speed."""

    def fresh(h: float) -> Callable[[float, float, float, float], float]:
        z = 0.0

        def torque(t: float, q: float, v: float, u: float) -> float:
            nonlocal z
            level = fc + (fs - fc) * exp(-((v / vs) ** 2))
            rate = stiffness * abs(v) / level
            end = copysign(level / stiffness, v)
            old = z
            z = end + (z - end) * exp(-rate * h) if rate > 0 else z
            return -(stiffness * 0.5 * (z + old) + damping * (z - old) / h)

        return torque

    return fresh


@maker("lugre")
def _lugre(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    level = size * s.torque
    unknown_dry(b, joint)
    bristle = s.reach * rng.uniform(0.002, 0.01)
    stiffness = level / bristle
    rise, slip = rng.uniform(1.2, 1.7), rng.uniform(0.03, 0.1) * s.v_rms
    b.laws.append((joint, lugre(level, rise * level, slip, stiffness, 0.0)))
    return truth(
        b, "presliding", joint, size, {"stiffness": (stiffness, unit(b, "/rad"))},
        ("coulomb", "stribeck", "hysteresis"), unscored=("stiffness",), note="LuGre, no damping of the bristle",
    )  # fmt: skip


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
        b, "coulomb_asymmetry", joint, size, values, ("coulomb",), note="Coulomb and an offset, by algebra"
    )


@maker("load_friction")
def _load_friction(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    edge = smooth(s)
    b.laws.append((joint, lambda h: lambda t, q, v, u: -size * abs(u) * tanh(v / edge)))
    return truth(b, "load_friction", joint, size, {"coefficient": (size, "")}, unscored=("coefficient",))


@maker("position_friction")
def _position_friction(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    level = 1.4 * size * s.torque
    period, phase, edge = s.reach * rng.uniform(0.3, 0.8), rng.uniform(-pi, pi), smooth(s)

    def torque(t: float, q: float, v: float, u: float) -> float:
        return -level * sin(2 * pi * q / period + phase) * tanh(v / edge)

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
    values = {"coefficient_pos": (damping + extra, unit(b, " s/rad")), "coefficient_neg": (damping, unit(b, " s/rad"))}
    return truth(b, "viscous_asymmetry", joint, size, values)


# torque of position


@maker("stiffness")
def _stiffness(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    k = size * s.torque / float(np.std(s.q))
    neutral = float(np.mean(s.q)) + rng.uniform(-0.3, 0.3) * s.reach
    b.joints[joint].stiffness, b.joints[joint].springref = k, neutral
    values = {"coefficient": (k, unit(b, "/rad")), "neutral": (neutral, "rad")}
    return truth(b, "stiffness", joint, size, values, note="MuJoCo's stiffness and springref")


@maker("cubic_stiffness")
def _cubic(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    middle = float(np.mean(s.q))
    k = size * s.torque / float(np.sqrt(np.mean((s.q - middle) ** 6)))
    b.laws.append((joint, lambda h: lambda t, q, v, u: -k * (q - middle) ** 3))
    return truth(b, "cubic_stiffness", joint, size, {"coefficient": (k, unit(b, "/rad^3"))})


@maker("gravity")
def _gravity(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """A weight screwed to the side of the link: unbalance, and a little inertia with it."""
    if b.gravity == 0.0:
        raise Unusable("it turns about a vertical axis")
    reach = 0.5 * abs(b.links[0].com[2])
    mass = 1.4 * size * s.torque / (9.81 * reach)
    side = float(rng.choice([-1.0, 1.0]))
    pos = numbers((side * reach, 0.0, 0.0))
    b.world.on_link[joint] = body_of("weight", pos, mass)
    return truth(
        b, "gravity", joint, size, {"torque": (mass * 9.81 * reach, unit(b)), "angle": (0.0, "rad")},
        ("payload", "body"), ("inertia",), ("torque", "angle"), note="a weight beside the link",
    )  # fmt: skip


@maker("ripple")
def _ripple(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """Detents: as many as the encoder and the sampling can follow."""
    amplitude, phase = 1.4 * size * s.torque, rng.uniform(-pi, pi)
    order = float(rng.integers(4, 25)) if b.kind != "linear" else 2 * pi / (s.reach * rng.uniform(0.04, 0.15))
    b.laws.append((joint, lambda h: lambda t, q, v, u: -amplitude * sin(order * q + phase)))
    values = {"order": (order, "1/rad"), "amplitude": (amplitude, unit(b))}
    return truth(b, "ripple", joint, size, values)


# inertia and bodies


@maker("inertia")
def _inertia(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    amount = size * s.torque / float(np.std(s.a))
    b.joints[joint].armature += amount
    b.fixed = True
    return truth(b, "inertia", joint, size, {"amount": (amount, "kg m^2")}, note="MuJoCo's armature")


def body_of(name: str, pos: str, mass: float) -> str:
    """A compact body that a link carries."""
    i = 0.4 * mass * 0.03**2
    return (
        f'<body name="{name}" pos="{pos}"><inertial pos="0 0 0" mass="{numbers(mass)}" '
        f'diaginertia="{numbers((i, i, i))}"/></body>'
    )


@maker("payload")
def _payload(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """0.5 to 5 kg at the tool."""
    last = b.n - 1
    mass = float(np.exp(rng.uniform(np.log(0.5), np.log(5.0))))
    way = 2 if b.machine == "mj_arm7" else 1
    place = [0.0, 0.0, 0.0]
    place[way] = rng.uniform(0.06, 0.15)
    place[(way + 1) % 3] = rng.uniform(-0.05, 0.05)
    b.world.on_link[last] = body_of("payload", numbers(place), mass)
    values = {"mass": (mass, "kg"), **{f"com_{x}": (p, "m") for x, p in zip("xyz", place, strict=True)}}
    return truth(
        b, "payload", last, size, values, ("body",), body=f"link{b.n}", joints=tuple(range(b.n)),
        note="at the tool",
    )  # fmt: skip


@maker("heavier")
def _heavier(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """One of the long links is 10 % heavier than the file says."""
    k = int(rng.integers(1, min(4, b.n)))
    before = b.links[k].mass
    b.links[k] = b.links[k].heavier(1.1)
    return truth(
        b, "body", k, size, {"mass": (0.1 * before, "kg")}, ("payload",), body=f"link{k + 1}",
        joints=tuple(range(b.n)), unscored=("mass",), note="10 % heavier",
    )  # fmt: skip


@maker("com")
def _com(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """The centre of mass of one long link is 3 cm elsewhere."""
    k = int(rng.integers(1, min(4, b.n)))
    way = [0.0, 0.0, 0.0]
    along = int(np.argmax(np.abs(b.links[k].com)))
    way[along] = 0.03 * float(rng.choice([-1.0, 1.0]))
    b.links[k] = b.links[k].moved((way[0], way[1], way[2]))
    values = {f"com_{x}": (w, "m") for x, w in zip("xyz", way, strict=True) if w}
    return truth(
        b, "body", k, size, values, ("payload",), body=f"link{k + 1}", joints=tuple(range(b.n)),
        unscored=tuple(values), note="centre of mass 3 cm off",
    )  # fmt: skip


@maker("base_tilt")
def _tilt(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """The base stands 2 degrees off the vertical."""
    way = rng.uniform(-pi, pi)
    x, y = np.deg2rad(2.0) * np.cos(way), np.deg2rad(2.0) * np.sin(way)
    b.world.gravity = (-9.81 * float(np.sin(y)), 9.81 * float(np.sin(x)), -9.81 * float(np.cos(np.hypot(x, y))))
    values = {"angle_x": (float(x), "rad"), "angle_y": (float(y), "rad")}
    return truth(
        b, "base_tilt", 0, size, values, joints=tuple(range(b.n)), unscored=tuple(values), note="2 degrees"
    )


# actuator


@maker("torque_gain")
def _gain(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    b.fixed = True
    b.joints[joint].gain *= 0.93
    return truth(b, "torque_gain", joint, size, {"ratio": (-0.07, "")}, note="friction is free, inertia is not")


@maker("gain_drift")
def _gain_drift(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    ratio, tau = -rng.uniform(0.06, 0.12), b.seconds * rng.uniform(0.2, 0.5)
    b.laws.append((joint, lambda h: lambda t, q, v, u: u * ratio * (1 - exp(-t / tau))))
    values = {"ratio": (ratio, ""), "time_constant": (tau, "s")}
    return truth(b, "gain_drift", joint, size, values, ("torque_gain",), unscored=("time_constant", "ratio"))


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
        b, "saturation", joint, size, {"level": (command, "command")}, ("voltage_limit",), note="forcerange"
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
    return truth(b, "voltage_limit", joint, size, values, ("saturation",), unscored=("level", "slope"))


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
    return truth(b, "lag", joint, size, {"time_constant": (seconds, "s")}, accepted, note="filterexact")


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


# transmission
TWO_SIDED = ("elasticity", "equality", "stiffening", "backlash")


def split(b: Bench, joint: int) -> tuple[float, float]:
    """Inertia of the rotor and of the load, of a joint that gets a spring or a gap."""
    j = b.joints[joint]
    load = float(Nominal(b).inertia(np.array(b.centre))[joint]) - j.armature
    j.armature = j.armature or 0.2 * load
    return j.armature, load


@maker("elasticity")
def _elasticity(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """A soft gear between rotor and link: an extra joint with a spring."""
    rotor, load = split(b, joint)
    w = b.bandwidth * rng.uniform(2.5, 5.0) / np.sqrt(max(size, 0.05) / 0.2)
    k = w**2 * load
    damping = 2 * 0.03 * np.sqrt(k * rotor * load / (rotor + load))
    b.joints[joint].spring = (float(k), float(damping))
    values = {"stiffness": (float(k), unit(b, "/rad")), "load_inertia": (load, "kg m^2")}
    return truth(
        b, "elasticity", joint, size, values, ("stiffening",),
        unscored=("load_inertia", "stiffness") if b.n > 1 else (), note="joint with a spring",
    )  # fmt: skip


@maker("equality")
def _equality(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """Rotor and link held together by a soft equality."""
    split(b, joint)
    b.joints[joint].equality = (rng.uniform(0.3, 0.6) / b.bandwidth, 0.2)
    return truth(
        b, "elasticity", joint, size, {}, ("stiffening", "presliding", "hysteresis"),
        note="soft equality of two joints",
    )  # fmt: skip


@maker("stiffening")
def _stiffening(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """A gear spring that hardens: seven tenths of its stiffness at rest, more with the twist."""
    out = _elasticity(b, joint, s, size, rng)
    stiffness, damping = b.joints[joint].spring or (0.0, 0.0)
    twist = 2 * s.torque / stiffness
    b.joints[joint].spring = (0.7 * stiffness, damping)
    cubic = 0.4 * stiffness / twist**2
    b.twists.append((joint, lambda h: lambda t, phi, rate, u: -cubic * phi**3))
    return replace(
        out, effect="stiffening", accepted=["elasticity", "backlash"], unscored=list(out.parameters)
    )


@maker("backlash")
def _backlash(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """A joint between rotor and link, free within its range."""
    split(b, joint)
    width = s.reach * 0.05 * size
    b.joints[joint].gap = (width, 2.5 * b.substep * 4, 1e-4 * s.torque / s.v_rms)
    values = {"gap": (width, "rad")}
    return truth(b, "backlash", joint, size, values, unscored=("gap",) if b.n > 1 else (), note="joint range")


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
    return truth(
        b, "position_filter", 0, size, {"time_constant": (seconds, "s")}, joints=tuple(range(b.n)),
        note="every position column low-passed",
    )  # fmt: skip


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
