"""Hypotheses about the whole robot: a payload, a wrong link, a tilted base, and what must be told
from them.

Joint by joint a wrong body looks like a gain, a coupling, a gravity. Here all joints decide
together. To first order, the torque that a body adds along the measured motion leaves its response
in the observers' innovations (``physics.joint.response``), and torque is linear in ten numbers of
each link (``physics.bodies``). Beside them, every joint has nuisance columns of its own: offset,
viscous and dry friction, drag, rotor inertia. So friction that the model lacks does not pass for a
body, nor a body for friction. All that a hypothesis needs is in the blocks' Gram matrices:
estimate, evidence on other recordings and rivals cost next to nothing. What wins is estimated again
around itself, so that what a body does to the inertia is exact.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from zendsp.physics.bodies import Links, change_of, turned_gravity
from zendsp.physics.effects import get_effect
from zendsp.physics.fit import Data
from zendsp.physics.joint import JointRecord, effective_inertia, response, run
from zendsp.physics.model import Model, Quantity, Term, per_joint

Array = npt.NDArray[np.float64]
Progress = Callable[[str], None]


@dataclass(frozen=True)
class BodyLimits:
    """What the search for bodies takes for granted."""

    # rad/s of the observers: fast, since much is missing when bodies are looked for
    bandwidth: float = 64.0
    block: float = 1.0  # s: what an observer remembers, and a swing of an arm, lie within
    blocks: int = 16  # at least so many, or they are shorter
    # of the RMS speed: slower, a joint may stick, and says nothing of what pulls it
    still: float = 0.05
    memory: float = 0.1  # s for which an observer remembers that a joint stuck
    # standard deviations over the blocks within which two explanations are as good
    tie: float = 2.5
    share: float = 0.03  # of the best one's gain: nearer, two explanations are as good
    sure: float = 3.0  # standard deviations over the blocks from which an explanation is one
    part: float = 0.2  # of what some joint leaves has to go on the recordings that choose
    least: float = 0.01  # of some joint's RMS torque: less is no body that anybody would look for
    bodies: int = 3  # at most so many wrong bodies
    same: float = 0.02  # m from a link's centre of mass: what it carries there is its own
    spread: float = 0.3  # m: no payload's radius of gyration is larger
    reach: float = 1.0  # m: farther from its link's origin nothing is carried
    gain: float = 0.5  # no actuator gives half as much again, or half
    constant: float = 0.05  # relative standard deviation of the torque constants that makers state
    step: float = 1e-6  # relative, of numerical derivatives
    # a free parameter of the mechanism farther off than so much of itself is no calibration
    calibrated: float = 0.15
    rounds: int = 3  # estimates around the one before
    # m from the link's origin, of a payload's centre to begin with
    starts: tuple[float, ...] = (0.05, 0.15, 0.4)


LIMITS = BodyLimits()
NUISANCE = 6  # columns that every joint has for itself
OWN = 6  # further columns of one joint, its rivals to a body: gain, sin q, cos q, q, sin 2q, cos 2q
COM = ("com_x", "com_y", "com_z")
# what an explanation costs where several are as good: the fewest numbers, and the most frequent
# cause first
COST = {
    "payload": 4.0,
    "body": 1.0,
    "base_tilt": 1.0,
    "torque_gain": 1.0,
    "gravity": 2.0,
    "stiffness": 3.0,
    "unknown": 8.0,
}
TOOL = 2.0  # of a payload at the end of a chain
RARE = 4.0  # of causes that act on the whole machine: its gravity, all its gains


@dataclass(frozen=True)
class Hypothesis:
    """An explanation of what all joints leave.

    Attributes
    ----------
    effect : str
        Name in the library, or ``gravity_scale`` (g times a factor), ``calibration`` (the
        mechanism's own free parameters), ``nothing``; ``unknown`` is any torque of one joint's own
        position and command.
    joint : int
        1-based; the last joint that moves the body. 0: all joints.
    body : str
        Name of the link, empty where it is of none.
    free : tuple of str
        Names of its numbers.
    """

    effect: str
    joint: int = 0
    body: str = ""
    free: tuple[str, ...] = ()
    cost: float = 0.0

    @property
    def of_bodies(self) -> bool:
        """Whether it is about bodies or gravity, and not a rival of those."""
        return self.effect in ("payload", "body", "base_tilt")

    @property
    def name(self) -> str:
        """Name for a list of what cannot be told apart."""
        if self.effect == "torque_gain":
            return (
                f"torque_gain of joint {self.joint}" if self.joint else "torque_gain of all joints"
            )
        return self.effect + (
            f" of {self.body}" if self.body else f" of joint {self.joint}" if self.joint else ""
        )


@dataclass(frozen=True)
class Explained:
    """A hypothesis after its linear fit.

    Attributes
    ----------
    hypothesis : Hypothesis
    values : ndarray, shape (p,)
        Of ``hypothesis.free``.
    std : ndarray, shape (p,)
        Over the blocks.
    gain : float
        Deviance over ``nothing`` on the recordings that choose.
    z : float
        Standard deviations over their blocks.
    behind : float
        Standard deviations by which the best explanation predicts better; 0 for the best.
    joints : ndarray, shape (joints,)
        The gain by joints.
    blocks : ndarray, shape (blocks,)
        The gain by blocks.
    share : ndarray, shape (joints,)
        Of the squared innovations that ``nothing`` leaves at a joint, how much goes.
    """

    hypothesis: Hypothesis
    values: Array
    std: Array
    gain: float
    z: float
    behind: float
    joints: Array
    blocks: Array
    share: Array

    def __repr__(self) -> str:
        numbers = ", ".join(
            f"{n} = {v:.4g} ± {s:.2g}"
            for n, v, s in zip(self.hypothesis.free, self.values, self.std, strict=True)
        )
        return (
            f"<{self.hypothesis.name}: {numbers}; gain {self.gain:.0f}, z = {self.z:.1f}, behind"
            f" {self.behind:.1f}>"
        )


# standard deviations of the sensor's noise: an observer that is so far off has left the track
LOST = 1e6


class Sums:
    """Gram matrices of all columns and the innovations, per joint and block; the innovations are
    the last column.
    """

    def __init__(
        self, data: Data, model: Model, limits: BodyLimits = LIMITS, jobs: int = 1
    ) -> None:
        seconds = sum(rec[0].n * rec[0].sample_time for rec in data.records)
        block = min(limits.block, seconds / limits.blocks)
        grams: list[Array] = []
        counts: list[Array] = []
        for rec in data.records:
            starts = np.arange(0, rec[0].n, max(10, round(block / rec[0].sample_time)))
            with ThreadPoolExecutor(jobs) as pool:  # the kernel runs outside the interpreter's lock
                done = list(
                    pool.map(
                        lambda record, starts=starts: _grams(record, model, starts, limits), rec
                    )
                )
            grams.append(np.stack([g for g, _ in done]))
            counts.append(np.stack([c for _, c in done]).astype(np.float64))
        self.grams = np.concatenate(grams, axis=1)  # (joints, blocks, columns, columns)
        self.counts = np.concatenate(counts, axis=1)  # (joints, blocks)

    @property
    def whole(self) -> Array:
        """Sum over the blocks, (joints, columns, columns)."""
        return np.asarray(self.grams.sum(axis=1))


def _grams(
    record: JointRecord, model: Model, starts: Array, limits: BodyLimits
) -> tuple[Array, Array]:
    """Gram matrices (blocks, columns, columns) and numbers of samples (blocks,) of one joint."""
    columns, moving = _columns(record, model, limits)
    columns = np.ascontiguousarray(columns[:, moving].T)
    edges = np.searchsorted(np.flatnonzero(moving), [*starts, record.n])
    parts = [columns[a:b] for a, b in pairwise(edges)]
    return np.stack([part.T @ part for part in parts]), np.diff(edges)


def _columns(
    record: JointRecord, model: Model, limits: BodyLimits
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Responses of all columns and the innovations, (columns + 1, n), and the samples at which the
    joint moves.
    """
    bandwidth = min(limits.bandwidth, fastest_of(record))
    q, qd, qdd = record.motion.states
    speed, j = record.scale.speed, record.joint - 1
    links = record.links
    assert links is not None
    slow = limits.still * speed
    gain = per_joint(model.actuator.gain, record.joint, 1.0)
    own = [np.ones(record.n), qd, np.tanh(qd / slow), np.tanh(qd / slow / 8), qd * np.abs(qd), qdd]
    torques = [*own, *_shared(links, j, model, record), -gain * record.command]
    torques += [np.sin(q), np.cos(q), q - np.mean(q), np.sin(2 * q), np.cos(2 * q)]
    damping = sum(t.value("coefficient") for t in model.at(record.joint) if t.effect == "viscous")
    inertia = effective_inertia(record, model)
    all_torques = np.stack(torques)
    acts = np.any(all_torques != 0.0, axis=1)  # of the links, only those that the joint moves
    seen = np.zeros_like(all_torques)
    seen[acts] = response(record, bandwidth, inertia, np.full(record.n, damping), all_torques[acts])
    left = run(record, model, bandwidth).innovations
    still = max(3.0 * float(np.sqrt(np.median(record.motion.variances[1]))), slow)
    sticks = np.flatnonzero(np.abs(qd) < still)
    moving = record.counted.copy()
    for k in range(max(1, round(limits.memory / record.sample_time))):
        at = sticks + k
        moving[at[at < record.n]] = False
    moving[: round(0.5 / record.sample_time)] = False  # the observer settles
    if np.max(np.abs(left), initial=0.0) > LOST:
        moving[:] = False  # it has left the track: this joint tells nothing of bodies
    return np.concatenate([seen, left[None]]), moving


def fastest_of(record: JointRecord) -> float:
    """Fastest observer that a record's sample time allows, rad/s."""
    return 0.5 / record.sample_time


def _shared(links: Links, joint: int, model: Model, record: JointRecord) -> list[Array]:
    """Columns that all joints share: ten numbers of each link, tilt about x and y, gravity's size,
    mechanism parameters.
    """
    n = record.n
    out: list[Array] = []
    for k in range(len(links.bodies)):
        out += list(links.columns(joint, k)[1]) if links.moves(joint, k) else [np.zeros(n)] * 10
    weight = links.weight(joint)
    for key in ("angle_x", "angle_y"):
        tilt = Term("base_tilt", 1, {key: Quantity(1e-6)})
        out.append((turned_gravity(links.gravity, [tilt]) - links.gravity) / 1e-6 @ weight)
    out.append(links.gravity @ weight)
    qdd = record.others[joint, 2]
    for key in calibrated(model):
        basis = record.basis.get(key)
        if basis is not None:
            out.append(basis.inertia * qdd + basis.bias)
        else:
            out.append(np.sin(record.motion.states[0]) if key == "gravity" else np.zeros(n))
    return out


def calibrated(model: Model) -> tuple[str, ...]:
    """Mechanism parameters of a model that may be calibrated."""
    return tuple(
        key for key, items in model.mechanism.items() if any(i.free and i.value for i in items)
    )


class Layout:
    """Where the numbers of a hypothesis stand among the columns."""

    def __init__(self, model: Model, links: Links) -> None:
        self.model, self.links, self.keys = model, links, calibrated(model)
        self.given = np.array([model.mechanism[key][0].value for key in self.keys])
        self.joints = len(links.bodies)
        self.tilt = NUISANCE + 10 * self.joints
        self.scale = self.tilt + 2
        self.mechanism = self.scale + 1
        self.own = self.mechanism + len(self.keys)
        self.width = self.own + OWN

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
        """Coefficients of the columns, (joints, width); a last number ``gain`` is the error of all
        joints' actuators beside it.
        """
        if h.free and h.free[-1] == "gain":
            x = self.place(replace(h, free=h.free[:-1]), values[:-1])
            x[:, self.own] += values[-1]
            return x
        x = np.zeros((self.joints, self.width))
        if h.effect in ("payload", "body"):
            k = h.joint - 1
            at = NUISANCE + 10 * k
            x[:, at : at + 10] = change_of(self.term(h, values), self.links.bodies[k])
        elif h.effect == "base_tilt":
            x[:, self.tilt : self.tilt + 2] = values
        elif h.effect == "gravity_scale":
            x[:, self.scale] = values[0]
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
        return x


# of the ten numbers of a link (``NUMBERS``), those that each coordinate of its centre is in
_HOLDS = {"com_x": (1, 5, 6, 7, 8), "com_y": (2, 4, 6, 7, 9), "com_z": (3, 4, 5, 8, 9)}
UNFELT = 1e-9  # of the largest column of a link: rounding is 1e-16 of it


def felt(links: Links, link: int) -> tuple[str, ...]:
    """Coordinates of a link's centre that any joint feels: along parallel axes, a place in their
    direction is nothing to any of them.
    """
    sizes = np.zeros(10)
    for joint in range(len(links.bodies)):
        if links.moves(joint, link):
            sizes = np.maximum(sizes, np.abs(links.columns(joint, link)[1]).max(axis=1))
    seen = sizes > UNFELT * float(sizes.max())
    return tuple(key for key, at in _HOLDS.items() if seen[list(at)].any())


def hypotheses(model: Model, links: Links) -> list[Hypothesis]:
    """All that is tried."""
    out: list[Hypothesis] = []
    ends = {k for k in range(len(links.bodies)) if all(b.parent != k for b in links.bodies)}
    # its parameters know nothing of what lies beside the links' lines
    flat = model.kind == "planar2r"
    for k, b in enumerate(links.bodies):
        com = ("com_x",) if flat else felt(links, k)
        free = ("mass", *com)
        out.append(
            Hypothesis("payload", k + 1, b.name, free, TOOL if k in ends else COST["payload"])
        )
        if b.mass > 0:
            out.append(Hypothesis("body", k + 1, b.name, ("mass",), COST["body"] + 1))
            if com:
                out.append(Hypothesis("body", k + 1, b.name, com, COST["body"] + len(com)))
                out.append(Hypothesis("body", k + 1, b.name, free, COST["body"] + 1 + len(com)))
    if any(b.mass > 0 for b in links.bodies) and np.any(links.gravity):
        out.append(Hypothesis("base_tilt", free=("angle_x", "angle_y"), cost=COST["base_tilt"] + 2))
        out.append(Hypothesis("gravity_scale", free=("ratio",), cost=RARE))
    if keys := calibrated(model):
        out.append(Hypothesis("calibration", free=keys, cost=RARE))
    out.append(Hypothesis("torque_gain", free=("ratio",), cost=RARE))
    for j in range(1, len(links.bodies) + 1):
        for effect, free in (
            ("torque_gain", ("ratio",)),
            ("gravity", ("sine", "cosine")),
            ("stiffness", ("coefficient",)),
            ("unknown", tuple(f"c{i}" for i in range(OWN))),
        ):
            out.append(Hypothesis(effect, j, "", free, COST[effect]))
    return out


class Solver:
    """Linear fits of hypotheses to the recordings that fit, and their evidence on those that
    choose.

    ``origin`` are the coefficients of what the model behind the sums has already of the hypothesis;
    ``aside`` are the joints (1-based) whose own gain and functions of position are nuisance too,
    since they have a fault of their own.
    """

    def __init__(
        self,
        fit: Sums,
        choose: Sums,
        layout: Layout,
        limits: BodyLimits = LIMITS,
        origin: Array | None = None,
        aside: Collection[int] = (),
    ) -> None:
        self.fit, self.choose, self.layout, self.limits = fit, choose, layout, limits
        self.origin = np.zeros((layout.joints, layout.width)) if origin is None else origin
        whole, n = fit.whole, NUISANCE
        free, own = list(range(n)), list(range(layout.own, layout.width))
        # (x, 1) with the best nuisance
        self.complete = np.zeros((layout.joints, layout.width + 1, layout.width + 1 - n))
        self.complete[:, n:] = np.eye(layout.width + 1 - n)
        for j, g in enumerate(whole):
            out = free + own if j + 1 in aside else free
            self.complete[j, out] -= _solve(g[np.ix_(out, out)], g[out, n:])
        self.rest = np.einsum(
            "jab,jac,jcd->jbd", self.complete, whole, self.complete, optimize=True
        )
        self.counts = fit.counts.sum(axis=1)

    def _full(self, x: Array) -> Array:
        """Coefficients (joints, width) with the best nuisance and the innovations' 1, (joints,
        width + 1).
        """
        tail = np.concatenate([x[:, NUISANCE:], np.ones((len(x), 1))], axis=1)
        return np.asarray(np.einsum("jab,jb->ja", self.complete, tail))

    def _left(self, x: Array) -> Array:
        """Sum of squares that the fit leaves, per joint."""
        tail = np.concatenate([x[:, NUISANCE:], np.ones((len(x), 1))], axis=1)
        left = np.einsum("ja,jab,jb->j", tail, self.rest, tail)
        return np.asarray(np.maximum(left, 1e-9 * self.rest[:, -1, -1]))  # less is rounding

    def deviance(self, x: Array) -> float:
        """Of the fit, with the noise of each joint profiled out."""
        used = self.counts > NUISANCE
        return float(
            np.sum(
                self.counts[used]
                * np.log(np.maximum(self._left(x)[used], 1e-300) / self.counts[used])
            )
        )

    def at(self, h: Hypothesis, values: Array) -> Array:
        """Coefficients that a hypothesis adds to the model, (joints, width)."""
        return self.layout.place(h, values) - self.origin

    def estimate(self, h: Hypothesis, start: Array | None = None) -> Array:
        """Numbers that make the innovations of all joints most likely, (p,)."""
        begins = self._starts(h) if start is None else [start]
        ends = [self._descend(h, values) for values in begins]
        return min(ends, key=lambda end: end[1])[0]

    def _descend(self, h: Hypothesis, values: Array) -> tuple[Array, float]:
        """Levenberg-Marquardt from some numbers: where it ends, and its deviance."""
        best = self.deviance(self.at(h, values))
        damping = 1e-6
        for _ in range(30):
            x, jac = self._linear(h, values)
            left = self._left(x)
            # a joint that stands still tells nothing
            told = left > 1e-12 * float(np.max(left, initial=0.0))
            weight = np.where(told, self.counts / np.where(told, left, 1.0), 0.0)
            tail = np.concatenate([x[:, NUISANCE:], np.ones((len(x), 1))], axis=1)
            inner = np.einsum("jab,jbp->jap", self.rest[:, :-1, :-1], jac)
            normal = np.einsum("j,jap,jaq->pq", weight, jac, inner)
            slope = np.einsum(
                "j,jap,ja->p", weight, jac, np.einsum("jab,jb->ja", self.rest[:, :-1], tail)
            )
            while damping < 1e6:
                trial = values - _solve(normal + damping * np.diag(np.diag(normal)), slope)
                value = self.deviance(self.at(h, trial))
                if value <= best:
                    break
                damping *= 10
            else:
                break
            done = best - value < 1e-3
            values, best, damping = trial, value, max(damping / 10, 1e-9)
            if done:
                break
        return values, best

    def _linear(self, h: Hypothesis, values: Array) -> tuple[Array, Array]:
        """Coefficients and their derivatives without the nuisance, (joints, columns, p)."""
        x = self.at(h, values)
        step = self.limits.step * np.maximum(np.abs(values), 0.1)
        jac = [
            (self.at(h, values + step * e) - x) / step.sum(where=e > 0) for e in np.eye(len(values))
        ]
        return x, np.stack(jac, axis=2)[:, NUISANCE:]

    def _starts(self, h: Hypothesis) -> list[Array]:
        """Numbers to begin with: all zero, but for a payload, whose centre nobody can see without
        its mass.
        """
        if h.effect != "payload":
            return [np.zeros(len(h.free))]
        at = 10 * (h.joint - 1)  # mass and first moment are linear
        weight = self.counts / np.maximum(self._left(-self.origin), 1e-300)
        part = slice(at, at + len(h.free))
        normal = np.einsum("j,jab->ab", weight, self.rest[:, part, part])
        slope = np.einsum("j,ja->a", weight, self.rest[:, part, -1])
        mass, *moment = -_solve(normal + 1e-9 * np.diag(np.diag(normal)), slope)
        size = max(float(np.linalg.norm(moment)), 1e-6)
        heavy = [max(abs(float(mass)), 1e-3), *(size / distance for distance in self.limits.starts)]
        far = self.limits.reach
        return [np.array([m, *np.clip(np.array(moment) / m, -far, far)]) for m in heavy]

    def plausible(self, h: Hypothesis, values: Array) -> bool:
        """Whether numbers are those of a machine."""
        known = dict(zip(h.free, values.tolist(), strict=True))
        bodies = self.layout.links.bodies
        if h.effect == "payload":
            robot = sum(b.mass for b in bodies) or np.inf
            far = max(abs(known.get(key, 0.0)) for key in COM)
            wide = 0.0 <= known.get("inertia", 0.0) < known["mass"] * self.limits.spread**2
            return bool(0.0 < known["mass"] < robot and far < self.limits.reach and wide)
        if h.effect == "body":
            far = max(abs(known.get(key, 0.0)) for key in COM)
            link, mass = bodies[h.joint - 1], abs(known.get("mass", 0.0))
            # as a link of another density has, and thrice that
            most = 3.0 * float(np.max(link.inertia)) * mass / link.mass
            return bool(
                mass < link.mass
                and far < self.limits.reach
                and abs(known.get("inertia", 0.0)) <= most
            )
        if h.effect in ("torque_gain", "gravity_scale"):
            return bool(abs(known["ratio"]) < self.limits.gain)
        return True

    def std(self, h: Hypothesis, values: Array) -> Array:
        """Standard deviations from what the blocks disagree, (p,)."""
        if not len(values):
            return np.zeros(0)
        x, jac = self._linear(h, values)
        full, weight = self._full(x), self.counts / np.maximum(self._left(x), 1e-300)
        sense = np.einsum("jab,jbp->jap", self.complete[:, :, :-1], jac)
        force = np.einsum("jkab,jb->jka", self.fit.grams, full)
        scores = np.einsum("j,jap,jka->kp", weight, sense, force)
        normal = np.einsum("j,jap,jab,jbq->pq", weight, jac, self.rest[:, :-1, :-1], jac)
        inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
        paired = scores[:-1].T @ scores[1:]
        # neighbours are alike (Newey and West 1987)
        spread = scores.T @ scores + 0.5 * (paired + paired.T)
        return np.asarray(np.sqrt(np.maximum(np.diag(inverse @ spread @ inverse), 0.0)))

    def squares(self, x: Array) -> Array:
        """Squared innovations on the recordings that choose, per joint."""
        full = self._full(x)
        return np.asarray(np.einsum("ja,jkab,jb->j", full, self.choose.grams, full))

    def points(self, x: Array) -> Array:
        """Deviance of the blocks that choose, (joints, blocks)."""
        full = self._full(x)
        left = np.maximum(np.einsum("ja,jkab,jb->jk", full, self.choose.grams, full), 0.0)
        counts = self.choose.counts
        mean = left.sum(axis=1) / np.maximum(counts.sum(axis=1), 1.0)
        mean = np.maximum(mean, 1e-300)[:, None]
        return np.asarray(
            np.where(
                counts.sum(axis=1)[:, None] > NUISANCE, left / mean + counts * np.log(mean), 0.0
            )
        )


def _solve(a: Array, b: Array) -> Array:
    """Solution of a symmetric system in units of its diagonal; what nothing determines is 0."""
    unit = np.sqrt(np.maximum(np.diag(a), 0.0))
    unit = np.where(unit > 0, unit, 1.0)
    scaled = (b.T / unit).T
    if not (np.isfinite(a).all() and np.isfinite(scaled).all()):
        return np.zeros(b.shape)  # beyond numbers: nowhere to go from here
    return np.asarray(
        (np.linalg.lstsq(a / np.outer(unit, unit), scaled, rcond=1e-10)[0].T / unit).T
    )


def explain(solver: Solver, tried: Sequence[Hypothesis]) -> list[Explained]:
    """All hypotheses after their linear fits, the best first.

    Those that predict as well as the best one that is sure are ordered by what they cost; then all
    others by their gain.
    """
    nothing = solver.at(Hypothesis("nothing"), np.zeros(0))
    none, before = solver.points(nothing), solver.squares(nothing)
    before = np.where(before > 0, before, np.inf)
    out = []
    for h in tried:
        values = solver.estimate(h)
        if not solver.plausible(h, values):
            continue
        x = solver.at(h, values)
        gain = none - solver.points(x)
        blocks = gain.sum(axis=0)
        share = np.where(np.isfinite(before), 1.0 - solver.squares(x) / before, 0.0)
        out.append(
            Explained(
                h,
                values,
                solver.std(h, values),
                float(blocks.sum()),
                z_of(blocks),
                0.0,
                gain.sum(axis=1),
                blocks,
                share,
            )
        )
    sure = [e for e in out if e.z > solver.limits.sure]
    top = max(sure or out, key=lambda e: e.gain)
    out = [replace(e, behind=z_of(top.blocks - e.blocks) if e is not top else 0.0) for e in out]
    ties = [e for e in out if tied(e, top, solver.limits)]
    ties.sort(key=lambda e: (_cost(e, solver), -e.gain))
    others = sorted((e for e in out if not any(e is t for t in ties)), key=lambda e: -e.gain)
    return ties + others


def _cost(e: Explained, solver: Solver) -> float:
    """What an explanation costs; nothing where a model's free parameters need little to do as well.
    """
    if e.hypothesis.effect == "calibration":
        given = solver.layout.given
        if np.all(np.abs(e.values) < solver.limits.calibrated * np.abs(given)):
            return 0.0
    return e.hypothesis.cost


def tied(other: Explained, top: Explained, limits: BodyLimits = LIMITS) -> bool:
    """Whether an explanation predicts as well as the best one."""
    return other.behind < limits.tie or top.gain - other.gain < limits.share * abs(top.gain)


@dataclass(frozen=True)
class FoundBody:
    """What all joints together say of one body, or of gravity.

    Attributes
    ----------
    term : Term
        To be added to a model; its numbers bear their standard deviations and are held in fits of
        single joints.
    body : str
        Name of the link; empty for gravity.
    explained : Explained
        Values, evidence on the recordings that choose, and what each joint gains.
    indistinguishable : tuple of str
        Explanations that predict as well.
    rejected : tuple of Explained
        Those that predict worse, the best first.
    aside : frozenset of int
        Joints (1-based) with a fault of their own that is larger.
    """

    term: Term
    body: str
    explained: Explained
    indistinguishable: tuple[str, ...]
    rejected: tuple[Explained, ...]
    aside: frozenset[int] = frozenset()


@dataclass(frozen=True)
class BodySearch:
    """What is wrong with the bodies of a machine.

    ``model`` is the given one with it; ``tried`` are all explanations of the last round, ``aside``
    the joints that had been set aside by then for a fault of their own.
    """

    model: Model
    found: tuple[FoundBody, ...] = ()
    tried: tuple[Explained, ...] = ()
    aside: frozenset[int] = frozenset()


def find_bodies(
    fit: Data, choose: Data, model: Model, jobs: int, tell: Progress, limits: BodyLimits = LIMITS
) -> BodySearch:
    """Look for wrong bodies: payloads, links, gravity.

    Parameters
    ----------
    fit, choose : Data
        Recordings to fit to, and to choose by.
    model : Model
        The given one, in kernel form.
    jobs : int
        Threads.
    tell : callable
        Receives a sentence at each stage.
    limits : BodyLimits

    Returns
    -------
    BodySearch
        Proposals: whether they are claimed is decided on recordings that were not touched here.
    """
    links = fit.records[0][0].links
    # a single joint's payload is its inertia and its gravity
    if links is None or all(b.parent < 0 for b in links.bodies):
        return BodySearch(model)
    begun = model
    found: list[FoundBody] = []
    tried: list[Explained] = []
    aside: frozenset[int] = frozenset()
    while len(found) < limits.bodies:
        tell("bodies: a payload, a wrong link, a tilted base, and what looks like them")
        layout = Layout(model, links)
        solver, tried, aside = _round(
            Sums(fit, model, limits, jobs), Sums(choose, model, limits, jobs), layout, limits
        )
        best = tried[0]
        taken = {(f.term.effect, f.term.joint) for f in found}
        if (
            not counts(best, solver)
            or (best.hypothesis.effect, max(best.hypothesis.joint, 1)) in taken
        ):
            break
        best = refined(
            fit, choose, model, layout, own_mass(best, tried, links, limits), limits, jobs, aside
        )
        if weight_of(choose, layout, best) < limits.least:
            break
        h = best.hypothesis
        alike = [
            e.hypothesis
            for e in tried
            if tied(e, tried[0], limits) and e.hypothesis.effect != "unknown"
        ]
        same = tuple(
            dict.fromkeys(o.name for o in alike if (o.effect, o.joint) != (h.effect, h.joint))
        )
        others = tuple(e for e in tried[1:] if e.hypothesis not in alike and e.gain > 0)
        term = stated(layout, best)
        tell(f"bodies: {best.hypothesis.name}")
        found.append(FoundBody(term, best.hypothesis.body, best, same, others, aside))
        if "calibration" in same:  # what the body explains is not to be calibrated away
            held = {
                key: tuple(replace(q, free=False) for q in items)
                for key, items in begun.mechanism.items()
            }
            begun = replace(begun, mechanism=held)
        model = begun.with_terms((*begun.terms, *(f.term for f in found)))
    return BodySearch(model, tuple(found), tuple(tried), aside)


def _round(
    fit: Sums, choose: Sums, layout: Layout, limits: BodyLimits
) -> tuple[Solver, list[Explained], frozenset[int]]:
    """All explanations, the best first, once joints with a larger fault of their own are set aside.
    """
    everything = hypotheses(layout.model, layout.links)
    aside: set[int] = set()
    while True:
        solver = Solver(fit, choose, layout, limits, aside=aside)
        tried = explain(solver, [h for h in everything if h.of_bodies or h.joint not in aside])
        best = tried[0]
        if best.hypothesis.of_bodies or not best.hypothesis.joint or best.z < limits.sure:
            return solver, tried, frozenset(aside)
        aside.add(best.hypothesis.joint)


def counts(best: Explained, solver: Solver) -> bool:
    """Whether an explanation is about bodies, and one that the recordings to choose by bear out."""
    limits = solver.limits
    return (
        best.hypothesis.of_bodies and best.z > limits.sure and float(best.share.max()) > limits.part
    )


def own_mass(
    best: Explained, tried: Sequence[Explained], links: Links, limits: BodyLimits
) -> Explained:
    """The wrong mass of a link in place of a body that sits at its centre of mass."""
    h = best.hypothesis
    if "mass" not in h.free or h.free == ("mass",):
        return best
    body = links.bodies[h.joint - 1]
    known = dict(zip(h.free, best.values.tolist(), strict=True))
    mass, com = known["mass"], np.array([known.get(key, 0.0) for key in COM])
    away = com - body.com if h.effect == "payload" else com * (body.mass + mass) / (mass or 1e-12)
    if abs(mass) > 0.5 * body.mass or float(np.linalg.norm(away)) > limits.same:
        return best
    plain = [
        e
        for e in tried
        if (e.hypothesis.effect, e.hypothesis.joint, e.hypothesis.free)
        == ("body", h.joint, ("mass",))
    ]
    return plain[0] if plain else best


def refined(
    fit: Data,
    choose: Data,
    model: Model,
    layout: Layout,
    first: Explained,
    limits: BodyLimits = LIMITS,
    jobs: int = 1,
    aside: Collection[int] = (),
) -> Explained:
    """An explanation estimated again around itself, until its numbers stand; a mass with an inertia
    of its own where that shows.

    What a recording leaves unexplained pulls at the numbers by more than its blocks show, since it
    comes back with the poses. Another recording has other poses: standard deviations grow to what
    the two estimates differ by. They hold also where all actuators give a little more or less than
    stated, which looks much like mass.
    """
    h, values = first.hypothesis, first.values
    wider = (
        replace(h, free=(*h.free, "inertia")) if "mass" in h.free and "inertia" not in h.free else h
    )
    last, by_gain = first, np.zeros(len(values))
    for _ in range(limits.rounds):
        here = model.with_terms((*model.terms, layout.term(h, values)))
        sums = Sums(fit, here, limits, jobs)
        solver = Solver(sums, sums, layout, limits, layout.place(h, values), aside)
        new = solver.estimate(h, values)
        std = solver.std(h, new)
        if len(wider.free) > len(h.free):
            more = solver.estimate(wider, np.append(new, 0.0))
            spread = solver.std(wider, more)
            told_apart = spread[0] < max(3.0 * std[0], 0.01 * abs(more[0]))
            if abs(more[-1]) > 2.0 * spread[-1] and told_apart and solver.plausible(wider, more):
                h, new, std = wider, more, spread
        known = len(values)
        stands = (
            len(new) == known
            and float(np.max(np.abs(new - values) / np.maximum(std, 1e-300))) < 0.3
        )
        last, values = replace(first, hypothesis=h, values=new, std=std), new
        *beside, gain = solver.estimate(replace(h, free=(*h.free, "gain")), np.append(values, 0.0))
        by_gain = (np.array(beside) - values) * min(1.0, limits.constant / max(abs(gain), 1e-12))
        if stands:
            break
    here = model.with_terms((*model.terms, layout.term(h, values)))
    sums = Sums(choose, here, limits, jobs)
    solver = Solver(sums, sums, layout, limits, layout.place(h, values), aside)
    other = solver.estimate(h, values)
    apart = (other - values) ** 2 / np.maximum(last.std**2 + solver.std(h, other) ** 2, 1e-300)
    std = last.std * max(1.0, float(np.sqrt(np.mean(apart))))
    return replace(last, std=np.hypot(std, by_gain))


def stated(layout: Layout, e: Explained) -> Term:
    """The term of an explanation, with its standard deviations; no fit of a single joint moves it.
    """
    term = layout.term(e.hypothesis, e.values)
    spread = dict(zip(e.hypothesis.free, e.std.tolist(), strict=True))
    numbers = {
        key: replace(q, free=False, std=spread.get(key, 0.0)) for key, q in term.parameters.items()
    }
    return Term(term.effect, term.joint, numbers)


def weight_of(data: Data, layout: Layout, e: Explained) -> float:
    """RMS torque of an explanation at the joint where it is largest, as a part of that joint's RMS
    torque.
    """
    term = layout.term(e.hypothesis, e.values)
    most = 0.0
    for j in range(layout.joints):
        total = scale = 0.0
        for rec in data.records:
            record = rec[j]
            assert record.links is not None
            change = record.links.change([term], j)
            torque = change.bias + change.inertia * record.others[j, 2]
            total += float(torque @ torque)
            scale += record.scale.torque**2 * record.n
        most = max(most, float(np.sqrt(total / max(scale, 1e-300))))
    return most


def z_of(blocks: Array) -> float:
    """Mean of the blocks over its standard error, neighbours taken together."""
    n = len(blocks)
    if n < 4:
        return 0.0
    off = blocks - blocks.mean()
    variance = float(off @ off) + float(off[:-1] @ off[1:])
    return float(
        blocks.sum() / np.sqrt(max(variance, 1e-12 * float(blocks @ blocks), 1e-300) * n / (n - 1))
    )
