"""Runs a bench in MuJoCo: reference, controller, motor, own torques, sensor; one recording at a
time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from zendsp.extras import need
from zendsp.proof.draft import Array
from zendsp.proof.mujoco.chain import Joint, World, mjcf
from zendsp.proof.mujoco.machines import Bench
from zendsp.proof.reality import Run
from zendsp.proof.references import make_reference

Rng = np.random.Generator


class Unstable(RuntimeError):
    """This draw makes no sensible recording."""


def library() -> Any:
    """The package ``mujoco``."""
    return need("mujoco", "mujoco", "a reality simulated by MuJoCo")


class Nominal:
    """Inverse dynamics of what the given model says of the bodies: for controllers and for the
    oracle.
    """

    def __init__(self, bench: Bench) -> None:
        self.mj = library()
        plain = [Joint(armature=a) for a in bench.nominal_armature]
        text = mjcf(bench.nominal, plain, World(gravity=nominal_gravity(bench)), 1e-3, "Euler")
        self.model = self.mj.MjModel.from_xml_string(text)
        self.data = self.mj.MjData(self.model)

    def torque(self, q: Array, v: Array, a: Array) -> Array:
        """M(q) a + bias(q, v), N m, (n,)."""
        self.data.qpos[:], self.data.qvel[:], self.data.qacc[:] = q, v, a
        self.mj.mj_inverse(self.model, self.data)
        return np.array(self.data.qfrc_inverse)

    def along(self, q: Array, v: Array, a: Array) -> Array:
        """The same for every row, (rows, n)."""
        return np.array([self.torque(*row) for row in zip(q, v, a, strict=True)])

    def inertia(self, q: Array) -> Array:
        """Diagonal of the inertia matrix, kg m²."""
        zero = np.zeros_like(q)
        still = self.torque(q, zero, zero)
        return np.array(
            [(self.torque(q, zero, e) - still)[k] for k, e in enumerate(np.eye(q.size))]
        )


def nominal_gravity(bench: Bench) -> tuple[float, float, float]:
    """Gravity as the given model has it."""
    if bench.kind == "urdf":
        return (0.0, 0.0, -9.81)
    if bench.kind == "rotary" and bench.gravity != 0.0:
        return (0.0, 0.0, -9.81)
    return (0.0, 0.0, 0.0)


@dataclass
class Plan:
    """Stamps and reference of one recording."""

    t: Array  # (rows,)
    steps: list[int]  # substeps of each row
    r: Array  # (rows, n)
    rd: Array
    rdd: Array


def plan(bench: Bench, shape: str, rng: Rng) -> Plan:
    """Stamps, jittered where the bench says so, and the reference at them."""
    rows = round(bench.seconds / bench.sample_time)
    each = round(bench.sample_time / bench.substep)
    steps = np.full(rows, each)
    if "jitter" in bench.faults:
        steps += rng.integers(-(each // 4), each // 4 + 1, rows)
    t = np.concatenate([[0.0], np.cumsum(steps[:-1])]) * bench.substep
    grid = np.arange(rows + rows // 8, dtype=np.float64) * bench.sample_time
    parts = [np.zeros((rows, bench.n)) for _ in range(3)]
    for k in range(bench.n):
        curve = bench.centre[k] + make_reference(
            shape, grid, bench.amplitude[k], bench.speed[k], rng
        )
        first = np.gradient(curve, bench.sample_time)
        for part, values in zip(
            parts, (curve, first, np.gradient(first, bench.sample_time)), strict=True
        ):
            part[:, k] = np.interp(t, grid, values)
    return Plan(t, steps.tolist(), *parts)


class Controller:
    """PD with feedforward, cascaded PI, or computed torque; the measured position is all that it
    sees.
    """

    def __init__(self, bench: Bench, nominal: Nominal, p: Plan) -> None:
        self.kind, self.nominal, self.p = bench.controller, nominal, p
        inertia = nominal.inertia(np.array(bench.centre))
        w, zeta = bench.bandwidth, bench.damping
        self.kp, self.kd = inertia * w**2, 2 * zeta * inertia * w
        self.w, self.zeta = w, zeta
        self.speed_gain, self.integral_gain = 2 * inertia * w, inertia * w**2
        self.gain, self.limit = np.array(bench.stated_gain), np.array(bench.limit)
        self.smooth = bench.velocity_filter
        self.integral = np.zeros(bench.n)
        self.ahead = np.zeros_like(p.r)
        if bench.feedforward and self.kind != "computed":
            self.ahead = nominal.along(p.r, p.rd, p.rdd)
        self.last: Array | None = None
        self.v = np.zeros(bench.n)

    def command(self, k: int, y: Array, dt: float) -> Array:
        """What the motors are told for row k, command units."""
        last = y if self.last is None else self.last
        self.v = self.v + (dt / (dt + self.smooth)) * ((y - last) / dt - self.v)
        self.last = y
        e, ed = self.p.r[k] - y, self.p.rd[k] - self.v
        if self.kind == "computed":
            wanted = self.p.rdd[k] + self.w**2 * e + 2 * self.zeta * self.w * ed
            tau = self.nominal.torque(y, self.v, wanted)
        elif self.kind == "cascade":
            slip = self.p.rd[k] + 0.5 * self.w * e - self.v
            self.integral = self.integral + self.integral_gain * slip * dt
            tau = self.speed_gain * slip + self.integral + self.ahead[k]
        else:
            tau = self.kp * e + self.kd * ed + self.ahead[k]
        return np.asarray(np.minimum(np.maximum(tau / self.gain, -self.limit), self.limit))


def nuisance_of(bench: Bench, t: Array, size: list[float], rng: Rng) -> Array:
    """Coloured torque that is nobody's physics: noise through a low pass of 1 to 20 Hz, (rows, n).
    """
    out = np.zeros((t.size, bench.n))
    if bench.nuisance == 0.0:
        return out
    from scipy.signal import lfilter

    for k in range(bench.n):
        cut = float(np.exp(rng.uniform(0.0, np.log(20.0))))
        a = float(np.exp(-2 * np.pi * cut * bench.sample_time))
        x = lfilter([1 - a], [1, -a], rng.standard_normal(t.size))
        out[:, k] = bench.nuisance * size[k] * x / np.sqrt(np.mean(x**2))
    return out


class Row:
    """What acts from one row to the next: the command, where the drive is late; laws that MuJoCo
    does not have.
    """

    def __init__(self, mj: Any, model: Any, data: Any, bench: Bench, dof: list[int]) -> None:
        self.mj, self.model, self.data, self.dof = mj, model, data, dof
        self.h, self.motion = bench.substep, bench.motion
        self.torques = [(k, dof[k], law(self.h)) for k, law in bench.laws]
        for k, law in bench.twists:
            self.torques.append((k, int(model.joint(f"f{k}").dofadr[0]), law(self.h)))
        waits = [round(j.delay / self.h) for j in bench.joints]
        self.late = [[0.0] * wait for wait in waits]
        self.gains = [j.gain for j in bench.joints]
        self.touched = sorted({*dof, *(place for _, place, _ in self.torques)})

    def pass_by(self, now: float, steps: int, sent: Array, outside: Array) -> None:
        """Let the row's time pass: `sent` reaches the motors' gains, `outside` acts beside them."""
        data, late = self.data, any(self.late)
        data.qfrc_applied[self.dof] = outside
        data.ctrl[:] = sent
        if not self.torques and not late and self.motion is None:
            self.mj.mj_step(self.model, data, steps)
            return
        applied, where, speed = data.qfrc_applied, data.qpos.item, data.qvel.item
        acts = sent.tolist()
        tau = [gain * u for gain, u in zip(self.gains, acts, strict=True)]
        base = [0.0] * len(applied)
        for place, push in zip(self.dof, outside.tolist(), strict=True):
            base[place] = push
        for s in range(steps):
            if late:
                for i, line in enumerate(self.late):
                    line.append(acts[i])
                    value = line.pop(0)
                    data.ctrl[i], tau[i] = value, self.gains[i] * value
            t, total = now + s * self.h, base.copy()
            for i, place, torque in self.torques:
                total[place] += torque(t, where(place), speed(place), tau[i])
            for place in self.touched:
                applied[place] = total[place]
            if self.motion is not None:
                form, factor = self.motion
                applied[self.dof] += factor * form(t, data.qpos[self.dof], data.qvel[self.dof])
            self.mj.mj_step(self.model, data)


@dataclass(frozen=True)
class Record:
    """A recording and what only the simulator knows."""

    run: Run
    nuisance: Array  # torque, (rows, n)


def simulate(bench: Bench, shape: str, rng: Rng, size: list[float] | None = None) -> Record:
    """One recording.

    Parameters
    ----------
    shape : str
        Of the reference.
    size : list of float, optional
        RMS torque of each joint, by which the nuisance is measured; none: without nuisance.

    Raises
    ------
    Unstable
        The motion left its range or MuJoCo reset itself.
    """
    mj = library()
    model = mj.MjModel.from_xml_string(
        mjcf(bench.links, bench.joints, bench.world, bench.substep, bench.integrator)
    )
    data = mj.MjData(model)
    dof = [int(model.joint(f"j{k}").dofadr[0]) for k in range(bench.n)]
    p = plan(bench, shape, rng)
    start(mj, model, data, bench, p.r[0])
    controller = Controller(bench, Nominal(bench), p)
    rows, n = p.r.shape
    noise = bench.noise * np.array(bench.resolution) * rng.standard_normal((rows, n))
    nuisance = nuisance_of(bench, p.t, size or [0.0] * n, rng)
    outside = nuisance + np.array([j.offset for j in bench.joints])
    for i, begin, end, push in bench.pushes:
        outside[(begin <= p.t) & (p.t < end), i] += push
    row = Row(mj, model, data, bench, dof)
    width = np.array([j.dead_zone for j in bench.joints])
    grid, position, speed = np.array(bench.resolution), data.qpos, data.qvel
    q, v, y, u = (np.zeros((rows, n)) for _ in range(4))
    for k, steps in enumerate(p.steps):
        seen = q[k] = position[dof]
        v[k] = speed[dof]
        for i, order, size_, phase in bench.sensor:
            seen[i] += size_ * np.sin(order * q[k, i] + phase)
        y[k] = np.rint((seen + noise[k]) / grid) * grid
        sent = u[k] = controller.command(k, y[k], steps * bench.substep)
        if width.any():  # a dead zone takes off
            sent = np.sign(sent) * np.maximum(np.abs(sent) - width, 0.0)
        row.pass_by(float(p.t[k]), steps, sent, outside[k])
    if not np.all(np.isfinite(q)) or np.any(data.warning.number > 0):
        raise Unstable("MuJoCo lost the motion")
    return Record(Run(p.t, y, u, p.r, q, v, np.zeros(rows)), nuisance)


def start(mj: Any, model: Any, data: Any, bench: Bench, q: Array) -> None:
    """Put every joint at the reference's first position, at rest."""
    for k, joint in enumerate(bench.joints):
        if joint.two_sided:  # MuJoCo softens constraints by inertias without armature
            model.dof_invweight0[model.joint(f"j{k}").dofadr] = 1.0 / joint.armature
        data.joint(f"j{k}").qpos[0] = q[k]
        if joint.equality is not None:
            data.joint(f"f{k}").qpos[0] = q[k]
    mj.mj_forward(model, data)
