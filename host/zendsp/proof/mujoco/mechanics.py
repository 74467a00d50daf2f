"""Torques of position, bodies, and what stands between rotor and link."""

from __future__ import annotations

from dataclasses import replace
from math import pi, sin

import numpy as np

from zendsp.proof.case import Unusable
from zendsp.proof.draft import Concealed, Scale, Term
from zendsp.proof.mujoco.chain import numbers
from zendsp.proof.mujoco.kit import maker, truth, unit
from zendsp.proof.mujoco.machines import Bench
from zendsp.proof.mujoco.simulate import Nominal

Rng = np.random.Generator


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
        b,
        "gravity",
        joint,
        size,
        {"torque": (mass * 9.81 * reach, unit(b)), "angle": (0.0, "rad")},
        ("payload", "body"),
        ("inertia",),
        ("torque", "angle"),
        note="a weight beside the link",
    )


@maker("ripple")
def _ripple(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """Detents: as many as the encoder and the sampling can follow."""
    amplitude, phase = 1.4 * size * s.torque, rng.uniform(-pi, pi)
    order = (
        float(rng.integers(4, 25))
        if b.kind != "linear"
        else 2 * pi / (s.reach * rng.uniform(0.04, 0.15))
    )
    b.laws.append((joint, lambda h: lambda t, q, v, u: -amplitude * sin(order * q + phase)))
    values = {"order": (order, "1/rad"), "amplitude": (amplitude, unit(b))}
    return truth(b, "ripple", joint, size, values)


# inertia and bodies


@maker("inertia")
def _inertia(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    amount = size * s.torque / float(np.std(s.a))
    b.joints[joint].armature += amount
    b.fixed = True
    return truth(
        b, "inertia", joint, size, {"amount": (amount, "kg m^2")}, note="MuJoCo's armature"
    )


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
    values = {
        "mass": (mass, "kg"),
        **{f"com_{x}": (p, "m") for x, p in zip("xyz", place, strict=True)},
    }
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
    b.world.gravity = (
        -9.81 * float(np.sin(y)),
        9.81 * float(np.sin(x)),
        -9.81 * float(np.cos(np.hypot(x, y))),
    )
    values = {"angle_x": (float(x), "rad"), "angle_y": (float(y), "rad")}
    return truth(
        b, "base_tilt", 0, size, values, joints=tuple(range(b.n)), unscored=tuple(values),
        note="2 degrees",
    )


# transmission
TWO_SIDED = ("elasticity", "equality", "stiffening", "backlash")


def split(b: Bench, joint: int) -> tuple[float, float]:
    """Inertia of the rotor and of the load, of a joint that gets a spring or a gap: the model
    knows the rotor.
    """
    j = b.joints[joint]
    load = float(Nominal(b).inertia(np.array(b.centre))[joint]) - j.armature
    if not j.armature:
        j.armature = 0.2 * load
        b.known.append(Term("inertia", joint + 1, {"amount": j.armature}))
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
    return truth(
        b, "backlash", joint, size, values, unscored=("gap",) if b.n > 1 else (), note="joint range"
    )
