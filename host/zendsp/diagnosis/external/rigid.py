"""A simulator that can only be called, as the rigid body inside it.

A push of each joint gives the mass matrix, the measured acceleration then the torque that the
simulator needs for this motion, and a step of each free number the derivative of both (``asked``
has how an acceleration is asked for). That is what the diagnosis knows of a URDF, so that it goes
the same road, with the same search and the same decisions.

Only a simulator that starts from row 0 and answers a torque at once has this form. Others are
compared by their output (``blackbox``).
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.external.asked import Asked, State
from zendsp.diagnosis.external.columns import Parameters
from zendsp.diagnosis.external.likeness import alike_to, basis_of
from zendsp.errors import ModelError
from zendsp.physics.calibration.fit import TOO_FAR
from zendsp.physics.model import Model
from zendsp.physics.robots.rigid import Basis

Array = npt.NDArray[np.float64]

# s that one simulation passes along the motion, where its torque is all but constant. With 16 ms
# its speed went astray by as much as a Coulomb friction of 0.05 % of the torque, which was claimed
PASSED = 0.004
# rad of the motion's mean frequency between states that splines join: at 0.25 an arm of two joints
# at 2 Hz had its torque within 0.03 %; at 0.35 FMUs of 26 arms are told as their URDFs are
STATES_APART = 0.35
STATE_TIMES = (0.005, 0.09)  # s: between them, at least and at most
SLOW, FEWER = 0.02, 3  # s for a state of a simulator; one that needs longer is asked at a third
# of the RMS torque; and of a free number. Torques were linear in both, to all digits that matter
PUSHED, NUMBER_STEP = 0.5, 1e-3
# of the answer to a push: rigid bodies differ by up to 0.4 % from themselves after twice the push,
# or started anew; one behind a lag of 2 ms by 8 %
AGREES = 0.02
RIGID_SHARE = 0.7  # of the states at which it must be: one with friction of its own may stick
STATES_ASKED = 48  # at which a simulator is asked whether it is a rigid body
# of a joint's torque: the derivatives by the numbers are no longer those. An arm that is linear in
# its numbers is off by 1e-4, one by masses and lengths that are off by a tenth, by 3e-2
BENT = 1e-3
POSES_APART = 0.2  # of the range: joints move by so much between poses that a spline joins
FAST = 1.0  # of the speed: a joint stops in no answer of two rows, whatever its weight does
REVERSES = 0.1  # of the speed: slower is a reversal
NOT_ITS_OWN = 1e-4  # of a joint's torque: a whole number does less, and is of another joint
SHOW_MASS = 6  # states at which a number is asked whether it is in the mass matrix
MOVES_MASS = 1e-6  # relative change of the mass matrix by a number that is in it


@dataclass(frozen=True)
class Near:
    """What a simulator is in some states, (n, …) each.

    Attributes
    ----------
    at : State
        Those in which pushes of two sizes say the same.
    torque : ndarray, shape (n, joints)
        With which they were simulated: nearly that of the motion.
    mass, rest : ndarray
        Mass matrices (n, joints, joints), and torque without acceleration (n, joints).
    answer : ndarray, shape (n, joints)
        Acceleration by ``torque``.
    first : ndarray, shape (n, joints, joints)
        Mass matrices where a pushed simulator begins as any other: with what its speed adds.
    before : ndarray, shape (n, joints)
        Torque with which ``first`` was asked for: roughly that of the motion.
    good : ndarray, shape (states asked for,)
        Which of them these are.
    """

    at: State
    torque: Array
    mass: Array
    rest: Array
    answer: Array
    first: Array
    before: Array
    good: npt.NDArray[np.bool_]


@dataclass
class Called(Asked):
    """A simulator as a rigid body, along the motions that were asked for.

    Attributes
    ----------
    owner : int
        The process that may call the simulator.
    known : dict
        What was answered, by motion.
    in_mass : dict
        Whether a number changes the mass matrix.
    feels : dict
        Whether a joint (from 0) feels a number.
    does : set
        Effects, each with its joint (from 1), that a free number is by another name.
    weight : tuple of float or None
        Of a simulator of one joint: its gravity torque, N m, and where it hangs, rad.
    """

    owner: int = field(default_factory=os.getpid)
    known: dict[bytes, list[dict[str, Basis]]] = field(default_factory=dict)
    in_mass: dict[str, bool] = field(default_factory=dict)
    feels: dict[tuple[str, int], bool] = field(default_factory=dict)
    does: set[tuple[str, int]] = field(default_factory=set)
    weight: tuple[float, float] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Another process has only the records that were made."""
        none: dict[str, Any] = {"simulator": None, "known": {}, "owner": -1, "tell": None}
        return {**self.__dict__, **none}

    @property
    def free(self) -> list[str]:
        """Names of the numbers that may be calibrated."""
        return [k for k, q in self.model.mechanism.items() if q[0].free and q[0].value != 0]

    def bases(self, motion: Sequence[Array]) -> list[dict[str, Basis]]:
        """As ``robots.rigid.bases``: the coefficients of each free number, and of the rest.

        Parameters
        ----------
        motion : list of ndarray, shape (3, n)
            q, qd, qdd of each joint.
        """
        stacked = np.ascontiguousarray(np.stack(list(motion)))
        key = hashlib.sha1(stacked.tobytes()).digest()
        if key not in self.known:
            if os.getpid() != self.owner:
                raise ModelError(f"{self.model.name}: its simulator is not in this process")
            state = State(*np.ascontiguousarray(stacked.transpose(1, 2, 0)))
            self.known[key] = self._along(state)
        return self.known[key]

    def masses(self, position: Array) -> Array:
        """Mass matrices along some positions (n, joints), in passing and without rotors: (n,
        joints, joints).
        """
        rows, steps = np.arange(len(position)), np.abs(np.diff(position, axis=0))
        few = np.ptp(position, axis=0) / np.maximum(steps.max(axis=0, initial=0.0), 1e-300)
        poses = np.unique(np.r_[rows[:: max(1, int(POSES_APART * few.min()))], rows[-1]])
        still = np.zeros_like(position[poses])
        at = self.sliding(State(position[poses], still, still), FAST)
        mass, *_ = self._body(at, self.inside.friction(at.qd), self.numbers())
        return _between(poses, mass, rows) - np.diag(self.inside.rotors(self.joints))

    def _along(self, motion: State) -> list[dict[str, Basis]]:
        n, rows = len(motion), np.arange(len(motion))
        poses = np.unique(np.r_[rows[:: self._every(motion)], n - 1])
        self.asked, self.begun = self._needed(len(poses)) + n // self._run, self.calls
        near = self.near(motion.at(poses))
        poses = poses[near.good]

        def everywhere(values: Array) -> Array:
            return _between(poses, values, rows)

        mass = everywhere(near.mass)
        rest = everywhere(near.rest - self.inside.friction(near.at.qd))
        torque = self._torque(motion, _times(mass, motion.qdd) + rest, mass)
        slope = everywhere(np.stack([self._slope(near, j) for j in range(self.joints)], axis=1))
        changes = {}
        for key in self.free:
            dm, dh = (everywhere(x) for x in self.moved(near, key))
            changes[key] = dm, _times(dm, motion.qdd) + dh
        rotors, out = self.inside.rotors(self.joints), []
        mass, torque = mass - np.diag(rotors), torque - rotors * motion.qdd
        for j in range(self.joints):
            own = {k: (dm[:, j, j], dt[:, j]) for k, (dm, dt) in changes.items()}
            felt = {k: x for k, x in own.items() if self._feels(k, j, x[1], torque[:, j])}
            self.does |= {(e, j + 1) for x in felt.values() for e in alike_to(motion, j, *x)}
            out.append(basis_of(motion.qdd[:, j], mass[:, j, j], torque[:, j], felt, self.about))
            fixed = out[-1]["fixed"]
            out[-1]["fixed"] = replace(fixed, slope=np.ascontiguousarray(slope[:, j]))
        return out

    def _feels(self, key: str, j: int, change: Array, torque: Array) -> bool:
        """Whether a joint (from 0) feels a number: the same in all recordings."""
        felt = abs(self.about[key]) * np.sqrt(np.mean(change**2))
        least = NOT_ITS_OWN * np.sqrt(np.mean(torque**2))
        return self.feels.setdefault((key, j), bool(felt > least))

    @property
    def _run(self) -> int:
        """Rows that one simulation passes along the motion."""
        return max(1, round(PASSED / self.sample_time))

    def _needed(self, states: int) -> int:
        """Simulations for so many states."""
        moved = sum(2 + (1 + self.joints) * self.in_mass.get(k, True) for k in self.free)
        return states * (4 * (1 + self.joints) + moved)

    def _every(self, motion: State) -> int:
        """Rows between the states at which the mass matrix is asked for: fewer in a fast motion."""
        speed, change = (np.sqrt(np.mean(x**2, axis=0)) for x in (motion.qd, motion.qdd))
        apart = STATES_APART * float(np.min(speed / np.maximum(change, 1e-300)))
        apart = min(max(apart, STATE_TIMES[0]), STATE_TIMES[1])
        slow = FEWER if SLOW < self.seconds < math.inf else 1
        return max(1, round(slow * apart / self.sample_time))

    def near(self, at: State) -> Near:
        """What the simulator is in some states, where its joints slide."""
        at = self.sliding(at)
        fast = at.no_slower(FAST * np.std(self.probe.qd, axis=0))
        roughly, rest, _ = self._body(fast, self.inside.friction(fast.qd), self.numbers())
        before = _times(roughly, at.qdd) + rest
        first, rest, _ = self._body(at, before, self.numbers())
        torque = _times(first, at.qdd) + rest
        mass, rest, answer = self._body(at, torque, self.numbers(), first)
        good = _alike(first, mass)
        if np.mean(good) < RIGID_SHARE:
            good[:] = True
        return Near(
            at.at(good), torque[good], mass[good], rest[good], answer[good], first[good],
            before[good], good,
        )

    def _body(
        self, at: State, torque: Array, numbers: Parameters, about: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Mass matrices (n, joints, joints), the torque without acceleration (n, joints), and the
        acceleration by the torque (n, joints). ``about``: mass matrices as far as known, by which a
        pushed simulator begins so that it passes the same state as one that is not. Otherwise its
        own speed would be in the answer: a viscosity of b had added b times a row to the inertia.
        """
        gives = None if about is None else np.linalg.pinv(about)
        base = self.accelerations(at, torque, numbers)
        if about is not None:
            at = replace(at, qdd=base)
            base = self.accelerations(at, torque, numbers)
        answers = []
        for j in range(self.joints):
            more, push = torque.copy(), PUSHED * self.torque[j] * np.where(at.qd[:, j] < 0, -1, 1)
            more[:, j] += push
            push = push[:, None]  # onwards, so that what slides goes on
            pushed = at if gives is None else replace(at, qdd=at.qdd + push * gives[:, :, j])
            answers.append((self.accelerations(pushed, more, numbers) - base) / push)
        mass: Array = np.asarray(np.linalg.pinv(np.stack(answers, axis=2)))
        return mass, torque - _times(mass, base), base

    def _slope(self, near: Near, j: int) -> Array:
        """Change of a joint's torque with its own position at the same motion, (n,)."""
        off = NUMBER_STEP * max(float(np.ptp(near.at.q[:, j])), 1e-6)
        q = near.at.q.copy()
        q[:, j] += off
        there = self.accelerations(replace(near.at, q=q), near.torque, self.numbers())
        out: Array = -_times(near.mass, there - near.answer)[:, j] / off
        return out

    def moved(self, near: Near, key: str) -> tuple[Array, Array]:
        """Derivatives of the mass matrix (n, joints, joints) and of the torque without acceleration
        (n, joints) by a free number.
        """
        at, torque = near.at, near.torque
        step = NUMBER_STEP * abs(self.about[key])
        numbers = self.numbers(**{key: self.about[key] + step})

        def changed(rows: slice) -> Array:  # what a pushed simulator's speed adds is in both
            return self._body(at.at(rows), near.before[rows], numbers)[0] - near.first[rows]

        if key not in self.in_mass:
            few = changed(slice(None, None, -(-len(at) // SHOW_MASS)))
            self.in_mass[key] = bool(np.abs(few).max() > MOVES_MASS * np.abs(near.mass).max())
        change = changed(slice(None)) if self.in_mass[key] else np.zeros_like(near.mass)
        came = self.accelerations(at, torque, numbers)
        came = self.accelerations(replace(at, qdd=came), torque, numbers)
        rest = torque - _times(near.mass + change, came)
        return change / step, (rest - near.rest) / step


    # ---- numbers in which the torque is not linear

    def bent(self, values: Mapping[str, float]) -> float:
        """How far the torque with other numbers is from what the derivatives say of them, as a part
        of the joint's torque: the largest of any joint.
        """
        near = self.near(self.probe)
        torque = near.torque.copy()
        for key in self.free:
            dm, dh = self.moved(near, key)
            torque += (values[key] - self.about[key]) * (_times(dm, near.at.qdd) + dh)
        numbers = self.numbers(**{k: values[k] for k in self.free})
        mass, rest, _ = self._body(near.at, torque, numbers, near.mass)
        off = torque - _times(mass, near.at.qdd) - rest
        return float(np.max(np.sqrt(np.mean(off**2, axis=0)) / self.torque))

    def calibrated(self, at: State, torque: Array) -> dict[str, float]:
        """The numbers with which the simulator needs nearly a measured torque (n, joints), by least
        squares beside friction, a spring and an offset of each joint.
        """
        near = self.near(at)
        moved = {}
        for key in self.free:
            dm, dh = self.moved(near, key)
            moved[key] = (_times(dm, near.at.qdd) + dh) / self.torque
        columns = [self.about[key] * x.T.ravel() for key, x in moved.items()]
        for j in range(self.joints):
            q, qd = near.at.q[:, j], near.at.qd[:, j]
            slow = REVERSES * float(np.std(qd)) + 1e-12
            for shape in (np.ones_like(q), q - q.mean(), qd, np.tanh(qd / slow)):
                column = np.zeros_like(near.at.q)
                column[:, j] = shape / max(float(np.std(shape)), 1.0)
                columns.append(column.T.ravel())
        off = ((torque[near.good] - near.torque) / self.torque).T.ravel()
        found = np.linalg.lstsq(np.stack(columns, axis=1), off, rcond=1e-6)[0]
        low, high = 1.0 / TOO_FAR, TOO_FAR
        given = {k: self.model.mechanism[k][0].value for k in self.free}
        return {
            key: given[key] * float(np.clip(self.about[key] / given[key] * (1 + by), low, high))
            for key, by in zip(moved, found, strict=False)
        }

    def begin(self, model: Model) -> None:
        """Take another model of the same simulator."""
        self.model = model
        self.known.clear()
        self.feels.clear()
        self.does.clear()

    def move_to(self, values: Mapping[str, float]) -> None:
        """Take torques as linear about other numbers."""
        self.about |= values
        self.known.clear()

    def _torque(self, motion: State, torque: Array, mass: Array) -> Array:
        """The torque that the simulator needs at every row, (n, joints)."""
        n = len(motion)
        starts, most = np.arange(0, n, self._run), self._run
        numbers, out = self.numbers(), torque.copy()
        rows = np.minimum(starts[:, None] + np.arange(most), n - 1)
        held = (torque + self.inside.friction(motion.qd))[rows].mean(axis=1)
        for count in np.unique(np.minimum(most, n - starts)):
            some = np.minimum(most, n - starts) == count
            at = rows[some][:, :count]
            answer = self.simulated(motion.at(at[:, 0]), held[some], numbers, count + 1)
            came = np.diff(answer, 2, axis=1) / self.sample_time**2  # (windows, count, joints)
            off = motion.qdd[at] - came
            out[at] = held[some][:, None] + np.einsum("wcij,wcj->wci", mass[at], off)
        out -= self.inside.friction(motion.qd)
        near = self._turns(motion.qd)
        if near.any():
            out[near] = self._turning(motion.at(near), torque[near], mass[near])
        return out

    # ---- dry friction inside

    def _turns(self, qd: Array) -> npt.NDArray[np.bool_]:
        """The rows whose simulation has a joint in it that may stick, (n,)."""
        slow, reach = self.slow(qd).any(axis=1), self._run + 1
        return np.convolve(slow, np.ones(2 * reach + 1), "same") > 0.5

    def _turning(self, at: State, torque: Array, mass: Array) -> Array:
        """The torque of the motion without friction where joints turn, (n, joints): on the line
        through the two of its both directions.
        """

        def asked(there: State, torque: Array, mass: Array) -> Array:
            rubbing = self.inside.friction(there.qd)
            came = self.accelerations(there, torque + rubbing, self.numbers())
            # a simulator that gets the torque of the motion passes it; what it falls behind is told
            return torque + _times(mass, there.qdd - came)

        slow, there = self.slow(at.qd), self.sliding(at)
        here = asked(there, torque, mass)
        out = here.copy()
        for j in np.flatnonzero(slow.any(axis=0)):
            rows = slow[:, j]
            other = there.at(rows)
            other.qd[:, j] *= -1.0
            back = asked(other, torque[rows], mass[rows])
            part = 0.5 * (1.0 - at.qd[rows, j] / there.qd[rows, j])
            out[rows] += part[:, None] * (back - here[rows])
        return out

def _times(mass: Array, x: Array) -> Array:
    return np.asarray(np.einsum("nij,nj->ni", mass, x))


def _alike(one: Array, other: Array) -> npt.NDArray[np.bool_]:
    """Where mass matrices agree, (n,): not where a joint sticks, or a command is cut."""
    size = np.abs(one).max(axis=(1, 2))
    return np.asarray(np.abs(other - one).max(axis=(1, 2)) < AGREES * size)


def _between(at: npt.NDArray[np.int64], values: Array, rows: npt.NDArray[np.int64]) -> Array:
    """Values at some rows, at all rows."""
    from scipy.interpolate import CubicSpline

    if len(at) == len(rows):
        return values
    if len(at) < 3:
        return np.repeat(values[:1], len(rows), axis=0)
    return np.ascontiguousarray(CubicSpline(at, values, axis=0)(np.clip(rows, at[0], at[-1])))
