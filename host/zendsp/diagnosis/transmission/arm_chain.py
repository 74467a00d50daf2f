"""An arm with springs as one linear system along its motion: motors, links, springs, and the mass
matrix between the links.

The motion as known so far gives what is not linear (``Path``). Torques at motors and links that
nobody knows, white noise, stand for what the model lacks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.prepare import within_samples
from zendsp.diagnosis.transmission.arm_path import Path, Records
from zendsp.physics.effects import get_effect
from zendsp.physics.kernel.native import native
from zendsp.physics.kernel.signals import Array
from zendsp.physics.model import Model, Term
from zendsp.physics.term_numbers import added_inertia

MOTORS_PART = (0.02, 0.98)  # of a joint's inertia: the bounds of the kernel's ``share_inertia``
# of the first state: sensor errors, of a position; parts of a joint's usual speed and torque
FIRST_POSITION, FIRST_SPEED, FIRST_TORQUE = 10.0, 0.3, 0.3
STRENGTHS = (1e-6, 1e2)  # limits of unknown torques, as parts of the usual ones


@dataclass(frozen=True)
class Steps:
    """x(k + 1) = A x(k) + G f(k), a pose each; and A once more, by its few numbers.

    Attributes
    ----------
    A, G : ndarray, shapes (poses, states, states), (poses, states, torques)
    eased : ndarray, shape (poses, torques, springs)
        Accelerations by a spring's torque.
    bent : ndarray, shape (poses, 2 springs, 2 springs)
        What these torques sum up to over a sample, twice and once, by twists and their rates.
    motors, links : ndarray, shape (springs,)
        The places between which a spring is twisted.
    """

    A: Array
    G: Array
    eased: Array
    bent: Array
    motors: npt.NDArray[np.intp]
    links: npt.NDArray[np.intp]


@dataclass(frozen=True)
class Chain:
    """One recording of an arm. States: positions of the motors, of the links behind springs, then
    the speeds of both; torques act at each.

    Attributes
    ----------
    masses : ndarray, shape (poses, joints, joints)
        Of the links, one every ``every`` rows.
    steps : Steps
    torques : ndarray, shape (n, torques)
        Known ones.
    unsure : ndarray, shape (n, torques)
        Variance of dry friction where a motor may stand, (N m)² or N².
    links : ndarray, shape (joints,)
        The place of each joint's link among the positions.
    usual : ndarray, shape (torques,)
        The RMS torque of the joints.
    """

    masses: Array
    steps: Steps
    torques: Array
    unsure: Array
    seen: tuple[Array, Array, Array]  # value, half, variance, (n, joints) each
    start: tuple[Array, Array]  # first state and its variances
    links: npt.NDArray[np.intp]
    usual: Array
    sample_time: float
    every: int

    def smoothed(self, strength: Array) -> tuple[float, Array]:
        """-2 log-likelihood and states (n, states), where unknown torques are ``strength`` parts of
        the usual ones, (torques,).
        """
        return self._smoothed(strength, self.torques, self.seen[0], self.start[0])

    def deviance(self, strength: Array) -> float:
        """-2 log-likelihood, as ``smoothed`` says it, by the filter alone."""
        return self._run(strength, self.torques, self.seen[0], self.start[0], None)

    def link_motion(self, states: Array) -> Array:
        """Motion of the links within samples, (joints, 3, n)."""
        speeds = states[:, self.links + len(self.usual)]
        rate = np.gradient(speeds, self.sample_time, axis=0)
        motion = np.stack([states[:, self.links], speeds, rate])
        return np.stack([within_samples(m.T, self.sample_time) for m in motion.transpose(2, 1, 0)])

    def felt_errors(self, strength: Array) -> Array:
        """Torques at each joint that errors of the others' smoothed accelerations make, (joints,
        n): one draw (Durbin and Koopman 2002).
        """
        rng, n = np.random.default_rng(0), len(self.torques)
        known = np.zeros_like(self.torques)
        pushes = np.sqrt(self._variances(strength)) * rng.standard_normal(known.shape)
        pose = np.arange(n) // self.every
        moved = np.einsum("kij,kj->ki", self.steps.G[pose], pushes)
        states = np.empty((n, len(self.start[0])))
        states[0] = np.sqrt(self.start[1]) * rng.standard_normal(states.shape[1])
        for k in range(n - 1):
            states[k + 1] = self.steps.A[pose[k]] @ states[k] + moved[k]
        _, half, variance = self.seen
        noise = np.sqrt(np.maximum(variance, 0.0)) * rng.standard_normal(half.shape)
        value = states[:, : half.shape[1]] + noise
        _, found = self._smoothed(strength, known, value, 0.0 * self.start[0])
        off = self.link_motion(found - states)[:, 2]
        between = self.masses * (1.0 - np.eye(len(off)))
        return np.asarray(np.einsum("kij,jk->ik", between[pose], off))

    def _variances(self, strength: Array) -> Array:
        return np.ascontiguousarray(self.unsure + (strength * self.usual) ** 2)

    def _smoothed(
        self, strength: Array, torques: Array, value: Array, first: Array
    ) -> tuple[float, Array]:
        out = np.empty((len(torques), len(first)))
        return self._run(strength, torques, value, first, out), out

    def _run(
        self, strength: Array, torques: Array, value: Array, first: Array, out: Array | None
    ) -> float:
        """-2 log-likelihood. Fills ``out`` with the smoothed states."""
        lib = native()
        p, ffi = lib.doubles, lib.ffi
        (n, c), d, m = torques.shape, len(first), value.shape[1]
        s2, steps = self._variances(strength), self.steps
        places = [x.astype(np.int32) for x in (np.arange(m), steps.motors, steps.links)]
        z = ffi.new("zf_chain *")
        z.n, z.d, z.c, z.m, z.s = n, d, c, m, len(steps.motors)
        z.every, z.T, z.f, z.s2 = self.every, self.sample_time, p(torques), p(s2)
        z.A, z.G, z.eased, z.bent = p(steps.A), p(steps.G), p(steps.eased), p(steps.bent)
        value = np.ascontiguousarray(value)
        z.value, z.half, z.R = p(value), p(self.seen[1]), p(self.seen[2])
        z.at, z.motor, z.link = (ffi.cast("int *", ffi.from_buffer(x)) for x in places)
        z.x0, z.p0 = p(first), p(self.start[1])
        work = np.empty(m * (d + 2) if out is None else n * (m * (d + 2) + d))
        smoothed = ffi.NULL if out is None else p(out)
        return float(lib.lib.zf_smooth_chain(z, p(work), smoothed))


def springs_of(model: Model) -> dict[int, Term]:
    """The transmission of each joint (1-based) that has one."""
    return {t.joint: t for t in model.terms if get_effect(t.effect).family == "transmission"}


def chain_of(path: Path, model: Model) -> Chain | None:
    """An arm along a path with the springs of a model; None where the numbers of the model are
    those of no body.
    """
    rec, springs = path.rec, springs_of(model)
    sample_time = rec[0].sample_time
    links = np.arange(len(rec))
    for i, joint in enumerate(springs):
        links[joint - 1] = len(rec) + i
    whole = _with_motors(rec, model, path.masses, links)
    if not np.all(np.isfinite(whole)) or not np.linalg.eigvalsh(whole).min() > 0.0:
        return None
    steps = _discrete(whole, springs, links, sample_time)
    torques = np.zeros((len(path.at_links), len(rec) + len(springs)))
    unsure = np.zeros_like(torques)
    torques[:, links] = path.at_links
    torques[:, : len(rec)] += path.at_motors
    unsure[:, : len(rec)] = path.unsure
    usual = np.array([r.scale.torque for r in rec] + [rec[j - 1].scale.torque for j in springs])
    start = _start(path, springs, links, torques[0])
    return Chain(
        path.masses, steps, torques, unsure, path.seen, start, links, usual, sample_time, path.every
    )


def _with_motors(
    rec: Records, model: Model, masses: Array, links: npt.NDArray[np.intp]
) -> Array:
    """Mass matrices of motors and links, (poses, torques, torques), shared as the kernel does."""
    springs = springs_of(model)
    size = len(rec) + len(springs)
    whole = np.zeros((len(masses), size, size))
    whole[:, links[:, None], links] = masses
    for record in rec:
        j, extra = record.joint, added_inertia(model, record.joint)
        if j not in springs:
            whole[:, j - 1, j - 1] += extra
            continue
        bodies = masses[:, j - 1, j - 1]
        mean = springs[j].value("links_inertia") or record.reference_inertia(model, bodies)
        load = springs[j].value("load_inertia") or 0.5 * mean
        own = bodies + extra
        motor = np.clip(mean + extra - load, *np.outer(MOTORS_PART, own))
        whole[:, j - 1, j - 1] = motor
        whole[:, links[j - 1], links[j - 1]] = own - motor
    return whole


def _discrete(
    whole: Array, springs: Mapping[int, Term], links: npt.NDArray[np.intp], sample_time: float
) -> Steps:
    """The steps of bodies under torques that are held over a sample.

    A spring's torque depends on its twist e alone, and e'' on e, e' and on how the torques from
    outside alone would move it, which is constant over a sample. So the exponential of these says
    all.
    """
    T, c, s = sample_time, whole.shape[1], len(springs)
    inverse = np.linalg.inv(whole)
    motors = np.array([joint - 1 for joint in springs], np.intp)
    twist = np.zeros((s, c))
    twist[np.arange(s), motors], twist[np.arange(s), links[motors]] = 1.0, -1.0
    eased = inverse @ twist.T
    felt = twist @ eased
    stiff = np.array([term.value("stiffness") for term in springs.values()])
    damping = np.array([term.value("damping") for term in springs.values()])
    rate = np.zeros((len(whole), 3 * s, 3 * s))  # of e, T e' and T² e'' from outside, a row
    rate[:, :s, s : 2 * s] = rate[:, s : 2 * s, 2 * s :] = np.eye(s)
    rate[:, s : 2 * s, :s] = -(T**2) * felt * stiff
    rate[:, s : 2 * s, s : 2 * s] = -T * felt * damping
    free = np.eye(3 * s)[: 2 * s]  # without the springs
    free[:s, s : 2 * s] = free[s:, 2 * s :] = np.eye(s)
    free[:s, 2 * s :] = 0.5 * np.eye(s)
    # what the springs' torques sum up to: T times the speeds, and twice, the positions
    sums = free - _exponential(rate)[:, : 2 * s]
    sums = np.concatenate([np.linalg.solve(felt, sums[:, i : i + s]) for i in (0, s)], axis=1)
    sums[:, :, s : 2 * s] *= T
    sums[:, s:] /= T
    A, G = np.zeros((len(whole), 2 * c, 2 * c)), np.empty((len(whole), 2 * c, c))
    A[:] = np.eye(2 * c)
    A[:, :c, c:] = T * np.eye(c)
    for i, part in enumerate((slice(0, c), slice(c, 2 * c))):
        bent = eased @ sums[:, i * s : (i + 1) * s]
        for j in (0, 1):
            A[:, part, j * c : (j + 1) * c] -= bent[:, :, j * s : (j + 1) * s] @ twist
        outside = T**2 * bent[:, :, 2 * s :] @ eased.transpose(0, 2, 1)
        G[:, part] = (0.5 * T**2, T)[i] * inverse - outside
    bent = np.ascontiguousarray(sums[:, :, : 2 * s])
    return Steps(A, G, np.ascontiguousarray(-eased), bent, motors, links[motors])


def _exponential(rate: Array) -> Array:
    """exp of matrices, (..., d, d), by scaling and squaring."""
    size = max(float(np.max(np.abs(rate).sum(axis=-1), initial=0.0)), 1e-12)
    halvings = max(0, math.ceil(math.log2(size / 0.5)))
    rate = rate / 2.0**halvings
    out = term = np.broadcast_to(np.eye(rate.shape[-1]), rate.shape)
    for k in range(1, 14):  # 0.5^14 / 14!: rounding
        term = term @ rate / k
        out = out + term
    for _ in range(halvings):
        out = out @ out
    return out


def _start(
    path: Path, springs: Mapping[int, Term], links: npt.NDArray[np.intp], torques: Array
) -> tuple[Array, Array]:
    """The first state and its variances: springs hang as they bear the weight, or otherwise."""
    c = len(torques)
    first, variance = np.zeros(2 * c), np.zeros(2 * c)
    for j, record in enumerate(path.rec):
        for i in {j, int(links[j])}:
            first[i] = path.seen[0][0, j]
            first[c + i] = record.motion.states[1, path.first]
            variance[i] = (FIRST_POSITION * record.measurement.std) ** 2
            variance[c + i] = (FIRST_SPEED * record.scale.speed) ** 2
        if j + 1 in springs:
            stiffness = springs[j + 1].value("stiffness")
            bent = torques[links[j]] / stiffness
            first[links[j]] += bent
            variance[links[j]] += bent**2 + (FIRST_TORQUE * record.scale.torque / stiffness) ** 2
    return first, variance


def strongest(
    chain: Chain, begin: npt.NDArray[np.floating[Any]], steps: Sequence[float]
) -> Array:
    """The likeliest strengths of unknown torques, (torques,): all alike, the best of ``begin``,
    then each by factors of ``steps``. ``begin`` of (torques,) in rows: each as it is.
    """
    asked: dict[tuple[float, ...], float] = {}
    c = len(chain.usual)

    def ask(strength: Array) -> float:
        key = tuple(strength)
        if key not in asked:
            value = chain.deviance(strength)
            asked[key] = value if math.isfinite(value) else math.inf
        return asked[key]

    best = min((np.broadcast_to(s, c) for s in np.asarray(begin)), key=ask)
    for step in steps:
        for i in range(c):
            own = step ** np.eye(c)[i]
            for other in (best * own, best / own):
                while ask(other) < ask(best) - 1.0 and STRENGTHS[0] < other[i] < STRENGTHS[1]:
                    best, other = other, other * (other / best)
    return np.array(best)
