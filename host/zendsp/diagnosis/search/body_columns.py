"""The torques that bodies add along the measured motion, as columns: their Gram matrices per joint
and block, and the columns of each hypothesis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property, partial
from itertools import pairwise
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.regression import rigid_torques
from zendsp.diagnosis.search.body_hypotheses import (
    COM,
    LIMITS,
    OF_A_LINK,
    OWN_COLUMNS,
    BodyLimits,
    Hypothesis,
    calibrated,
    turned_joints,
)
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord, effective_inertia
from zendsp.physics.calibration.observed import damping_along, response
from zendsp.physics.calibration.predict import run
from zendsp.physics.effects import get_effect
from zendsp.physics.kernel.threads import threads
from zendsp.physics.model import Model, Quantity, Term, per_joint
from zendsp.physics.robots.bodies import (
    NUMBERS,
    Links,
    body_terms,
    changed_by,
    numbers_of,
    turned_gravity,
)
from zendsp.physics.robots.rigid import SMALL

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
# of the RMS speed, at which a friction that falls with the speed (Stribeck 1902) has fallen. Each
# is twice the one before, so that their sums can bend at any speed between
FALLS = (0.1, 0.2, 0.4)
NUISANCE = 7 + len(FALLS)  # columns of each joint's own: constant, frictions, rotor


Columns = Callable[[JointRecord], Array]


def none(record: JointRecord) -> Array:
    """No further torques."""
    return np.zeros((0, record.n))


# standard deviations of the sensor's noise: an observer with a larger error has lost the track
LOST = 1e6


class Sums:
    """Gram matrices of all columns and the innovations, per joint and block; the innovations are
    the last column. ``turns``: for joints (from 1) roughly where another zero lies, rad; its torque
    is no straight line. ``more``: further torques of a joint, (columns, n). ``about``: the
    hypotheses that are asked for, empty: any. All other columns stay 0. For one payload that saves
    two thirds of them, and the columns of zeros, each of which takes the dynamics of the arm.
    """

    def __init__(
        self,
        data: Data,
        model: Model,
        limits: BodyLimits = LIMITS,
        jobs: int = 1,
        turns: Mapping[int, float] = MappingProxyType({}),
        more: Columns = none,
        about: Sequence[Hypothesis] = (),
    ) -> None:
        seconds = sum(rec[0].n * rec[0].sample_time for rec in data.records)
        block = min(limits.block, seconds / limits.blocks)
        # count of neighbouring blocks that are correlated
        self.alike = max(1, round(limits.block / block))
        grams: list[Array] = []
        counts: list[Array] = []
        for rec in data.records:
            starts = np.arange(0, rec[0].n, max(10, round(block / rec[0].sample_time)))
            columns = partial(
                _columns, model=model, limits=limits, turns=turns, more=more, about=about
            )
            work = partial(_grams, columns=columns, starts=starts)
            with threads(jobs) as each:
                done = list(each(work, rec))
            grams.append(np.stack([g for g, _ in done]))
            counts.append(np.stack([c for _, c in done]).astype(np.float64))
        self.grams = np.concatenate(grams, axis=1)  # (joints, blocks, columns, columns)
        self.counts = np.concatenate(counts, axis=1)  # (joints, blocks)

    def with_more(self, other: Sums) -> Sums:
        """The sums with the blocks of both."""
        return self._of(
            np.concatenate([self.grams, other.grams], axis=1),
            np.concatenate([self.counts, other.counts], axis=1),
        )

    def some(self, blocks: Bools) -> Sums:
        """The sums with some of the blocks."""
        return self._of(self.grams[:, blocks], self.counts[:, blocks])

    def with_torque(self, x: Array) -> Sums:
        """The sums with a torque in the recordings that the model lacks: coefficients of the
        columns, (joints, width).
        """
        added = np.concatenate([-x, np.ones((len(x), 1))], axis=1)
        left = product(self.grams, added[:, None])  # only the innovations change
        grams = self.grams.copy()
        grams[..., -1] = grams[..., -1, :] = left
        grams[..., -1, -1] = product(left, added)
        return self._of(grams, self.counts)

    def _of(self, grams: Array, counts: Array) -> Sums:
        out = copy(self)
        out.__dict__.pop("whole", None)
        out.grams, out.counts = grams, counts
        return out

    @cached_property
    def whole(self) -> Array:
        """Sum over the blocks, (joints, columns, columns)."""
        return np.asarray(self.grams.sum(axis=1))


def product(matrices: Array, vectors: Array) -> Array:
    """Products of matrices (..., a, b) with as many vectors (..., b)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _grams(
    record: JointRecord,
    columns: Callable[[JointRecord], tuple[Array, Bools, Bools]],
    starts: npt.NDArray[np.int_],
) -> tuple[Array, Array]:
    """Gram matrices (blocks, columns, columns) and numbers of samples (blocks,) of one joint."""
    seen, acts, moving = columns(record)
    seen = seen[:, moving]
    edges = np.searchsorted(np.flatnonzero(moving), [*starts, record.n])
    grams = np.zeros((len(starts), len(acts), len(acts)))
    at = np.ix_(acts, acts)
    for gram, (a, b) in zip(grams, pairwise(edges), strict=True):
        gram[at] = seen[:, a:b] @ seen[:, a:b].T
    return grams, np.diff(edges)


def _columns(
    record: JointRecord,
    model: Model,
    limits: BodyLimits,
    turns: Mapping[int, float],
    more: Columns,
    about: Sequence[Hypothesis],
) -> tuple[Array, Bools, Bools]:
    """Responses of the columns that are not 0, and the innovations; which of all columns these are,
    (columns + 1,); and the samples at which the joint moves.
    """
    bandwidth = min(limits.bandwidth, 0.5 / record.sample_time)  # as fast as samples allow
    q, qd, qdd = record.motion.states
    speed, j = record.scale.speed, record.joint - 1
    links = record.links
    assert links is not None
    slow = limits.still * speed
    gain = per_joint(model.actuator.gain, record.joint, 1.0)
    own = [np.ones(record.n), *_frictions(record, model, slow, limits.by_load), qdd]
    torques = [*own, *_shared(links, j, model, record, turns, about), -gain * record.command]
    torques += [np.sin(q), np.cos(q), q - np.mean(q), np.sin(2 * q), np.cos(2 * q)]
    torques += list(more(record))
    damping = damping_along(record, model)
    inertia = effective_inertia(record, model)
    acts = np.array([*(bool(np.any(t)) for t in torques), True])  # only links that the joint moves
    acting = np.stack([t for t, felt in zip(torques, acts[:-1], strict=True) if felt])
    seen = response(record, bandwidth, inertia, damping, acting)
    left = run(record, model, bandwidth).innovations
    still = max(3.0 * float(np.sqrt(np.median(record.motion.variances[1]))), slow)
    sticks = np.flatnonzero(np.abs(qd) < still)
    moving = record.counted.copy()
    for k in range(max(1, round(limits.memory / record.sample_time))):
        at = sticks + k
        moving[at[at < record.n]] = False
    moving[: round(0.5 / record.sample_time)] = False  # the observer settles
    if np.max(np.abs(left), initial=0.0) > LOST:
        moving[:] = False  # it has lost the track: this joint says nothing about bodies
    return np.concatenate([seen, left[None]]), acts, moving


def _frictions(
    record: JointRecord, model: Model, slow: float, by_load: bool
) -> list[Array]:
    """Torques that span the friction of a joint, each odd in its own speed: viscous, dry, drag, the
    falling friction of slow motion, and dry friction by load.
    """
    _, qd, qdd = record.motion.states
    inertia, bias = record.inertia_and_bias(model)
    dry = np.tanh(qd / slow)
    fall = [dry * np.exp(-((qd / (part * record.scale.speed)) ** 2)) for part in FALLS]
    load = np.abs(inertia * qdd + bias) * dry if by_load else np.zeros_like(dry)
    return [qd, dry, np.tanh(qd / slow / 8), qd * np.abs(qd), *fall, load]


def _shared(
    links: Links,
    joint: int,
    model: Model,
    record: JointRecord,
    turns: Mapping[int, float],
    about: Sequence[Hypothesis],
) -> list[Array]:
    """Columns that all joints share: ten numbers of each link, tilt about x and y, gravity's size,
    the joints' zeros, mechanism parameters.
    """
    n = record.n
    nothing = np.zeros(n)
    out: list[Array] = []
    for k in range(len(links.bodies)):
        asked = not about or any(h.of_bodies and h.joint == k + 1 for h in about)
        felt = asked and links.moves(joint, k)
        out += list(links.columns(joint, k)[1]) if felt else [nothing] * 10
    weight = links.weight(joint, body_terms(model))  # of what was found already too
    for key in ("angle_x", "angle_y"):
        tilt = Term("base_tilt", 1, {key: Quantity(1e-6)})
        out.append((turned_gravity(links.gravity, [tilt]) - links.gravity) / 1e-6 @ weight)
    out.append(links.gravity @ weight)
    if not about or any(h.effect == "zero" for h in about):
        out += list(by_zeros(links, model, turns)[joint])
    else:
        out += [nothing] * len(links.bodies)
    qdd = record.others[joint, 2]
    for key in calibrated(model):
        basis = record.basis.get(key)
        if basis is not None:
            out.append(basis.inertia * qdd + basis.bias)
        else:
            out.append(np.sin(record.motion.states[0]) if key == "gravity" else nothing)
    return out


def by_zeros(links: Links, model: Model, at: Mapping[int, float]) -> Array:
    """Torque at each joint per shift of each joint's zero, N m or N per rad, (joints, joints, n).
    ``at``: by joint (from 1) the shift, rad, over which the slope is taken; else a small one.
    """
    if model.kind != "planar2r":
        return links.zeros(at, body_terms(model))
    there, by = links.motion.copy(), at.get(2, SMALL)
    there[1, 0] += by
    one, other = (rigid_torques(model, list(x)) for x in (links.motion, there))
    return np.stack([0.0 * one, (other - one) / by], axis=1)


class Layout:
    """The map from the numbers of a hypothesis to coefficients of the columns."""

    def __init__(self, model: Model, links: Links) -> None:
        self.model, self.links, self.keys = model, links, calibrated(model)
        self.given = np.array([model.mechanism[key][0].value for key in self.keys])
        self.given_std = np.array([model.mechanism[key][0].std for key in self.keys])
        self.joints = len(links.bodies)
        self.rotors = model.kind != "planar2r"  # of which p1 and p2 are the motors' inertia, too
        self.tilt = NUISANCE + 10 * self.joints
        self.scale = self.tilt + 2
        self.zero = self.scale + 1
        self.mechanism = self.zero + self.joints
        self.own = self.mechanism + len(self.keys)
        self.width = self.own + OWN_COLUMNS
        self._columns: dict[Hypothesis, Array] = {}
        self._bodies = [(b, numbers_of(b.mass, b.com, b.inertia)) for b in links.bodies]

    def term(self, h: Hypothesis, values: Array) -> Term:
        """The hypothesis as a term of a model."""
        known = dict(zip(h.free, values.tolist(), strict=True))
        effect = get_effect(h.effect)
        return Term(
            h.effect,
            max(h.joint, 1),
            {
                p.name: Quantity(known.get(p.name, p.default or 0.0), p.name in known)
                for p in effect.parameters
            },
        )

    def place(self, h: Hypothesis, values: Array) -> Array:
        """Coefficients of the columns, (joints, width). A last number ``gain`` is a common error of
        all actuators.
        """
        return np.asarray(self.columns(h) @ self.coefficients(h, values))

    def coefficients(self, h: Hypothesis, values: Array) -> Array:
        """What a hypothesis multiplies its columns by, (c,): its numbers, or of a body the change
        of its link's ten.
        """
        if h.effect not in OF_A_LINK:
            return values
        known = dict(zip(h.free, values.tolist(), strict=True))
        mass, inertia = known.get("mass", 0.0), known.get("inertia", 0.0)
        com = np.array([known.get(key, 0.0) for key in COM])
        change = changed_by(h.effect, (mass, com, inertia), *self._bodies[h.joint - 1])
        return np.append(change, values[-1]) if "gain" in known else change

    def slopes(self, h: Hypothesis, values: Array, step: float) -> Array:
        """The derivatives of the coefficients by the numbers, (c, p), over a relative ``step``."""
        if h.effect not in OF_A_LINK:
            return np.eye(len(values))
        here, by = self.coefficients(h, values), step * np.maximum(np.abs(values), 0.1)
        ahead = (self.coefficients(h, values + e) for e in np.diag(by))
        return np.stack([(c - here) / width for c, width in zip(ahead, by, strict=True)], axis=1)

    def columns(self, h: Hypothesis) -> Array:
        """The columns that a hypothesis's coefficients multiply, (joints, width, c)."""
        if h not in self._columns:
            out = []
            own = replace(h, free=h.free[:-1]) if h.free[-1:] == ("gain",) else h
            for e in np.eye(len(NUMBERS) if h.effect in OF_A_LINK else len(own.free)):
                out.append(np.zeros((self.joints, self.width)))
                self._put(out[-1], own, e)
            if own is not h:
                out.append(np.zeros((self.joints, self.width)))
                out[-1][:, self.own] = 1.0
            nothing = np.zeros((self.joints, self.width, 0))
            self._columns[h] = np.stack(out, axis=2) if out else nothing
        return self._columns[h]

    def _put(self, x: Array, h: Hypothesis, values: Array) -> None:
        """Put the coefficients of a hypothesis into those of all columns, (joints, width)."""
        if h.effect in OF_A_LINK:
            at = NUISANCE + 10 * (h.joint - 1)
            x[:, at : at + 10] = values
        elif h.effect == "base_tilt":
            x[:, [self.tilt + ("angle_x", "angle_y").index(key) for key in h.free]] = values
        elif h.effect == "gravity_scale":
            x[:, self.scale] = values[0]
        elif h.effect == "zero":
            turned = [self.zero + joint - 1 for joint in turned_joints(h)]
            x[:, [*turned, *range(self.mechanism, self.own)]] = values
        elif h.effect == "inertia":
            x[:, NUISANCE + 10 * (h.joint - 1) + NUMBERS.index("izz")] = values[0]
        elif h.effect == "calibration":
            x[:, self.mechanism : self.own] = values
        elif h.effect == "torque_gain":
            rows = slice(None) if h.joint == 0 else slice(h.joint - 1, h.joint)
            x[rows, self.own] = values
        elif h.effect == "gravity":
            x[h.joint - 1, self.own + 1 : self.own + 3] = values
        elif h.effect == "stiffness":
            x[h.joint - 1, self.own + 3] = values[0]
        elif h.effect == "unknown":
            x[h.joint - 1, self.own :] = values
