"""How an arm really moves: bodies by Pinocchio, dry friction as a set-valued law of its own.

Coordinates are the motors' angles and, behind a spring or a gap, the angle of that link. In a step
dry friction is the impulse within its limits that leaves the slowest joints: one that stays within
them sticks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from arms.arm import GRAVITY, Arm

Array = npt.NDArray[np.float64]
Torque = Callable[[float, Array, Array], Array]  # time, angles, speeds -> added torque

STEP = 2e-4  # s
SWEEPS = 30  # of the impulses, at most


@dataclass(frozen=True)
class Spring:
    """Between motor and link of a joint."""

    joint: int  # from 0
    stiffness: float  # N m/rad
    damping: float  # N m s/rad
    gap: float = 0.0  # rad, full width


@dataclass(frozen=True)
class Wave:
    """link = motor + amplitude sin(order motor + phase)."""

    joint: int  # from 0
    order: float
    amplitude: float  # rad
    phase: float


@dataclass(frozen=True)
class Stribeck:
    """Friction of a joint above its Coulomb level, at rest."""

    joint: int  # from 0
    more: float  # N m
    velocity: float  # rad/s


LEAST, MOST = 0.5, 5.0  # kg, of a payload


@dataclass(frozen=True)
class Rough:
    """What real friction has beside a straight line over the speed, in every joint."""

    more: float = 0.3  # of the dry friction, at rest
    velocity: float = 0.05  # rad/s, at which that falls
    power: float = 0.7  # of the speed, of the viscous friction
    load: float = 0.02  # of what the bodies ask of the joint

    def level(self, coulomb: Array, w: Array, borne: Array) -> Array:
        """N m, of the dry friction."""
        fall = np.exp(-((w / self.velocity) ** 2))
        return coulomb * (1.0 + self.more * fall) + self.load * np.abs(borne)

    def fluid(self, viscous: Array, w: Array) -> Array:
        """N m, of the rest."""
        return viscous * np.sign(w) * np.abs(w) ** self.power

    def line(self, arm: Arm) -> Arm:
        """The arm with the straight line through its friction from 0.02 to 1.5 rad/s, without
        load.
        """
        w = np.linspace(0.02, 1.5, 75)[:, None] * np.ones(arm.n)
        curve = self.level(arm.coulomb, w, np.zeros(arm.n)) + self.fluid(arm.viscous, w)
        slope, level = np.polyfit(w[:, 0], curve, 1)
        return replace(arm, coulomb=level, viscous=slope)


@dataclass(frozen=True)
class Payload:
    """A ball that a link carries."""

    kg: float
    where: tuple[float, float, float]  # m, of its centre in the link's frame
    link: int = -1  # from 0; -1: the last
    radius: float = 0.05  # m


@dataclass(frozen=True)
class Added:
    """What an arm has beside its bodies, rotors, viscous and dry friction."""

    spring: Spring | None = None
    wave: Wave | None = None
    stribeck: Stribeck | None = None
    payload: Payload | None = None
    rough: Rough | None = None
    tilt: tuple[float, float] = (0.0, 0.0)  # rad, of gravity about x, then y of the base
    gain: Array | None = None
    offset: Array | None = None
    torque: Torque | None = None

    def times(self, size: float) -> Added:
        """The same, larger."""
        out, torque = self, self.torque
        if (s := self.spring) is not None:
            out = replace(out, spring=replace(s, stiffness=s.stiffness / size, gap=size * s.gap))
        if (w := self.wave) is not None:
            out = replace(out, wave=replace(w, amplitude=size * w.amplitude))
        if (f := self.stribeck) is not None:
            out = replace(out, stribeck=replace(f, more=size * f.more))
        if (p := self.payload) is not None:
            out = replace(out, payload=replace(p, kg=float(np.clip(size * p.kg, LEAST, MOST))))
        if self.gain is not None:
            out = replace(out, gain=1.0 + size * (self.gain - 1.0))
        if self.offset is not None:
            out = replace(out, offset=size * self.offset)
        if torque is not None:
            out = replace(out, torque=lambda t, q, qd: size * torque(t, q, qd))
        return out


NOTHING = Added()


def bodies(arm: Arm, added: Added = NOTHING) -> pin.Model:
    """The links of an arm and what they carry, without rotors."""
    model, payload = pin.Model(), added.payload
    about_x, about_y = (pin.utils.rotate(k, a) for k, a in zip("xy", added.tilt, strict=True))
    model.gravity.linear = about_y @ about_x @ np.array(GRAVITY)
    parent = 0
    for k in range(arm.n):
        axis = pin.JointModelRevoluteUnaligned(arm.axis[k])
        parent = model.addJoint(parent, axis, pin.SE3(np.eye(3), arm.place[k]), f"j{k + 1}")
        link = pin.Inertia(arm.mass[k], arm.com[k], np.diag(arm.inertia[k]))
        model.appendBodyToJoint(parent, link, pin.SE3.Identity())
    if payload is not None:
        own = 0.4 * payload.kg * payload.radius**2 * np.eye(3)
        body = pin.Inertia(payload.kg, np.array(payload.where), own)
        model.appendBodyToJoint(payload.link % arm.n + 1, body, pin.SE3.Identity())
    return model


class Reality:
    """An arm that moves."""

    def __init__(self, arm: Arm, added: Added) -> None:
        self.arm, self.added = arm, added
        self.model = bodies(arm, added)
        self.data = self.model.createData()
        n = arm.n
        size = n + (added.spring is not None)
        self.z, self.w, self.a = np.zeros(size), np.zeros(size), np.zeros(size)
        self.before = np.zeros(n)
        self.time = 0.0
        self.own = np.diag(np.r_[arm.rotor, np.zeros(size - n)])
        if added.wave is not None:  # a motion begins with all links at 0
            w = added.wave
            for _ in range(50):
                self.z[w.joint] = -w.amplitude * np.sin(w.order * self.z[w.joint] + w.phase)

    @property
    def motors(self) -> Array:
        """The motors' angles."""
        return self.z[: self.arm.n]

    def _links(self, z: Array, w: Array) -> tuple[Array, Array, Array]:
        """Angles of the links, their derivatives by the coordinates, and what is left of their
        acceleration without that of the coordinates.
        """
        n, q = self.arm.n, z[: self.arm.n].copy()
        by, rest = np.eye(n, len(z)), np.zeros(n)
        if (spring := self.added.spring) is not None:
            j = spring.joint
            q[j], by[j, j], by[j, n] = z[n], 0.0, 1.0
        if (wave := self.added.wave) is not None:
            j = wave.joint
            at = wave.order * z[j] + wave.phase
            q[j] += wave.amplitude * np.sin(at)
            by[j, j] = 1.0 + wave.amplitude * wave.order * np.cos(at)
            rest[j] = -wave.amplitude * wave.order**2 * np.sin(at) * w[j] ** 2
        return q, by, rest

    def _transmitted(self, z: Array, w: Array) -> float:
        spring = self.added.spring
        assert spring is not None
        twist, speed = z[spring.joint] - z[-1], w[spring.joint] - w[-1]
        if not spring.gap:
            return spring.stiffness * twist + spring.damping * speed
        beyond = twist - np.clip(twist, -spring.gap / 2, spring.gap / 2)
        return float(spring.stiffness * beyond + (spring.damping * speed if beyond else 0.0))

    def _limits(self, w: Array, borne: Array) -> Array:
        level = self.arm.coulomb.copy()
        if (rough := self.added.rough) is not None:
            level = rough.level(level, w, borne)
        if (s := self.added.stribeck) is not None:
            level[s.joint] += s.more * np.exp(-((w[s.joint] / s.velocity) ** 2))
        return level

    def _fluid(self, w: Array) -> Array:
        rough = self.added.rough
        return self.arm.viscous * w if rough is None else rough.fluid(self.arm.viscous, w)

    def advance(self, u: Array, seconds: float) -> None:
        """Move on under a command that is held."""
        n, added = self.arm.n, self.added
        drive = u * (1.0 if added.gain is None else added.gain)
        drive = drive + (0.0 if added.offset is None else added.offset)
        for _ in range(round(seconds / STEP)):
            z, w = self.z + 0.5 * STEP * self.w, self.w + 0.5 * STEP * self.a
            q, by, rest = self._links(z, w)
            mass = pin.crba(self.model, self.data, q)
            mass = by.T @ (np.triu(mass) + np.triu(mass, 1).T) @ by + self.own
            torque = -(by.T @ pin.rnea(self.model, self.data, q, by @ w, rest))
            limit = STEP * self._limits(w[:n], torque[:n])
            torque[:n] += drive - self._fluid(w[:n])
            if added.torque is not None:
                torque[:n] += added.torque(self.time + 0.5 * STEP, q, by @ w)
            if (spring := added.spring) is not None:
                through = self._transmitted(z, w)
                torque[spring.joint] -= through
                torque[-1] += through
            gives = np.linalg.inv(mass)
            speed = self._rubbed(self.w + STEP * (gives @ torque), gives, limit)
            self.z = self.z + 0.5 * STEP * (self.w + speed)
            self.a, self.w = (speed - self.w) / STEP, speed
            self.time += STEP

    def _rubbed(self, free: Array, gives: Array, limit: Array) -> Array:
        """Speeds after the impulses of dry friction."""
        n = self.arm.n
        push = np.clip(self.before, -limit, limit)
        for _ in range(SWEEPS):
            moved = 0.0
            speed = free + gives[:, :n] @ push
            for i in range(n):
                wanted = float(np.clip(push[i] - speed[i] / gives[i, i], -limit[i], limit[i]))
                change = wanted - push[i]
                if change:
                    speed = speed + gives[:, i] * change
                    push[i] = wanted
                    moved = max(moved, abs(change) / limit[i])
            if moved < 1e-9:
                break
        self.before = push
        return free + gives[:, :n] @ push


@dataclass(frozen=True)
class Laboratory:
    """How an arm is moved and recorded."""

    sample_time: float  # s
    seconds: float
    count: float  # rad
    fastest: float = 1.2  # Hz, of a motion
    bandwidth: float = 22.0  # rad/s, of the control
    forward: float = 0.85  # of the bodies' torque, by feedforward


def wanted(arm: Arm, lab: Laboratory, rng: np.random.Generator) -> Array:
    """A sum of sines for each joint, (rows, joints), from 0."""
    t = np.arange(0.0, lab.seconds, lab.sample_time)
    out = np.zeros((len(t), arm.n))
    for j in range(arm.n):
        f, phase = rng.uniform(0.08, lab.fastest, 6), rng.uniform(0.0, 2 * np.pi, 6)
        size = 1 / np.sqrt(f)
        r = (size[:, None] * np.sin(2 * np.pi * f[:, None] * t + phase[:, None])).sum(axis=0)
        r = (r - r[0]) * np.minimum(1.0, t / 0.5)
        out[:, j] = r * arm.reach[j] / np.abs(r).max()
    return out


def record(true: Arm, given: Arm, added: Added, lab: Laboratory, seed: int) -> dict[str, Array]:
    """A recording of PD control with feedforward of the given bodies."""
    rng = np.random.default_rng(seed)
    h, n = lab.sample_time, true.n
    r = wanted(given, lab, rng)
    rd = np.gradient(r, h, axis=0)
    rdd = np.gradient(rd, h, axis=0)
    known = bodies(given)
    data = known.createData()
    size = np.diag(pin.crba(known, data, np.zeros(n))) + given.rotor
    reality, speed, rows = Reality(true, added), np.zeros(n), []
    last = np.zeros(n)
    for k in range(len(r)):
        noisy = reality.motors + rng.normal(0.0, 0.2 * lab.count, n)
        q = np.round(noisy / lab.count) * lab.count
        if k:
            speed += h / (h + 0.005) * ((q - last) / h - speed)
        last = q
        forward = lab.forward * (pin.rnea(known, data, r[k], rd[k], rdd[k]) + given.rotor * rdd[k])
        kp, kd = size * lab.bandwidth**2, 1.4 * size * lab.bandwidth
        u = kp * (r[k] - q) + kd * (rd[k] - speed) + forward
        rows.append(np.r_[k * h, q, u, r[k]])
        reality.advance(u, h)
    table = np.array(rows)
    t, q, u, r = table[:, 0], *np.split(table[:, 1:], 3, axis=1)
    return {"t": t, "q": q, "u": u, "r": r}
