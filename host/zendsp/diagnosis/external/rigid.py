"""A simulator that can only be called, as the rigid body inside it.

From a state of the measured motion a few rows are simulated under a constant torque; the second
difference of the answer is the acceleration there. A push of each joint gives the mass matrix, the
measured acceleration then the torque that the simulator needs for this motion, and a step of each
free number the derivative of both. That is what the diagnosis knows of a URDF, so that it goes the
same road, with the same search and the same decisions.

Only a simulator that starts from row 0 and answers a torque at once has this form. Others are
compared by their output (``blackbox``).
"""

from __future__ import annotations

import hashlib
import math
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.external.columns import Columns, Parameters
from zendsp.diagnosis.external.friction_inside import DRY, FrictionInside
from zendsp.diagnosis.external.likeness import alike_to, basis_of
from zendsp.diagnosis.external.numbers import folded
from zendsp.diagnosis.external.simulator import Simulator
from zendsp.diagnosis.progress import Progress, Step
from zendsp.errors import ModelError
from zendsp.physics.calibration.fit import TOO_FAR
from zendsp.physics.model import Model, per_joint
from zendsp.physics.robots.rigid import Basis

Array = npt.NDArray[np.float64]

ROWS_EACH = 2  # simulated from each state: the fewest with a second difference
# s that one simulation passes along the motion, where its torque is all but constant. With 16 ms
# its speed went astray by as much as a Coulomb friction of 0.05 % of the torque, which was claimed
PASSED = 0.004
# rad of the motion's mean frequency between states that splines join: an arm of two joints at 2 Hz
# then had its torque within 0.03 %
STATES_APART = 0.25
STATE_TIMES = (0.005, 0.06)  # s: between them, at least and at most
SLOW, FEWER = 0.02, 3  # s for a state of a simulator; one that needs longer is asked at a third
# of the RMS torque; and of a free number. Torques were linear in both, to all digits that matter
PUSHED, NUMBER_STEP = 0.5, 1e-3
# of the answer to a push: rigid bodies differ by up to 0.4 % from themselves after twice the push,
# or started anew; one behind a lag of 2 ms by 8 %
AGREES = 0.02
RIGID_SHARE = 0.7  # of the states at which it must be: one with friction of its own may stick
ASKED_AT_ONCE = 500  # simulations between two looks at Ctrl-C
STATES_ASKED = 48  # at which a simulator is asked whether it is a rigid body
# of a joint's torque: the derivatives by the numbers are no longer those. An arm that is linear in
# its numbers is off by 1e-4, one by masses and lengths that are off by a tenth, by 3e-2
BENT = 1e-3
REVERSES = 0.1  # of the speed: slower is a reversal
# of the speed: where there is dry friction inside, a slower joint is asked for at this speed, both
# ways. It passes 0.02 of it in the rows of an answer, at 2 Hz and 1 ms
SLIDES = 0.05
NOT_ITS_OWN = 1e-4  # of a joint's torque: a whole number does less, and is of another joint
MOVES_MASS = 1e-6  # relative change of the mass matrix by a number that is in it


@dataclass(frozen=True)
class State:
    """Motion of all joints, (n, joints) each."""

    q: Array
    qd: Array
    qdd: Array

    def at(self, rows: Any) -> State:
        """The motion at some rows."""
        return State(self.q[rows], self.qd[rows], self.qdd[rows])

    def __len__(self) -> int:
        return len(self.q)


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
        Mass matrices where a pushed simulator begins as any other, under the torque of its
        friction: with what its speed adds.
    good : ndarray, shape (states asked for,)
        Which of them these are.
    """

    at: State
    torque: Array
    mass: Array
    rest: Array
    answer: Array
    first: Array
    good: npt.NDArray[np.bool_]


@dataclass
class Called:
    """A simulator as a rigid body, along the motions that were asked for.

    Attributes
    ----------
    model : Model
        Expanded (``expanded``): every number has a name.
    torque : ndarray, shape (joints,)
        RMS of each joint, N m or N.
    probe : State
        Some states of the measured motion.
    about : dict
        Values of the numbers about which torques are taken as linear in them.
    tell : callable
        Receives a sentence while states are simulated.
    calls : int
        Simulations so far, of a few rows each.
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
    friction : FrictionInside
        What is inside the simulator, without which its torques are given.
    """

    model: Model
    simulator: Simulator
    sample_time: float
    torque: Array
    probe: State
    about: dict[str, float]
    tell: Progress = print
    calls: int = 0
    owner: int = field(default_factory=os.getpid)
    known: dict[bytes, list[dict[str, Basis]]] = field(default_factory=dict)
    in_mass: dict[str, bool] = field(default_factory=dict)
    feels: dict[tuple[str, int], bool] = field(default_factory=dict)
    does: set[tuple[str, int]] = field(default_factory=set)
    weight: tuple[float, float] | None = None
    friction: FrictionInside = field(default_factory=FrictionInside)
    seconds: float = math.inf  # a state takes, with its restart: the shortest, whatever else runs
    asked: int = 0  # states that the present motion needs
    begun: int = 0  # ``calls`` before it

    def __getstate__(self) -> dict[str, Any]:
        """Another process has only the records that were made."""
        none: dict[str, Any] = {"simulator": None, "known": {}, "owner": -1, "tell": None}
        return {**self.__dict__, **none}

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.torque)

    def numbers(self, **moved: float) -> Parameters:
        """The simulator's parameters, some of them moved."""
        return folded({**self.about, **moved})

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
        """Mass matrices at some positions (n, joints), in passing: (n, joints, joints)."""
        still = np.zeros_like(position)
        return self._body(self._sliding(State(position, still, still)), still, self.numbers())[0]

    def _along(self, motion: State) -> list[dict[str, Basis]]:
        n, rows = len(motion), np.arange(len(motion))
        poses = np.unique(np.r_[rows[:: self._every(motion)], n - 1])
        self.asked, self.begun = self._needed(len(poses)) + n // self._run, self.calls
        near = self.near(motion.at(poses))
        poses = poses[near.good]

        def everywhere(values: Array) -> Array:
            return _between(poses, values, rows)

        mass = everywhere(near.mass)
        torque = everywhere(near.torque - self.friction.torque(near.at.qd))
        torque = self._torque(motion, torque, mass)
        slope = everywhere(np.stack([self._slope(near, j) for j in range(self.joints)], axis=1))
        changes = {}
        for key in self.free:
            dm, dh = (everywhere(x) for x in self.moved(near, key))
            changes[key] = dm, _times(dm, motion.qdd) + dh
        out = []
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
        return states * (2 * (1 + self.joints) + 1 + self.joints + moved)

    def _every(self, motion: State) -> int:
        """Rows between the states at which the mass matrix is asked for: fewer in a fast motion."""
        speed, change = (np.sqrt(np.mean(x**2, axis=0)) for x in (motion.qd, motion.qdd))
        apart = STATES_APART * float(np.min(speed / np.maximum(change, 1e-300)))
        apart = min(max(apart, STATE_TIMES[0]), STATE_TIMES[1])
        slow = FEWER if SLOW < self.seconds < math.inf else 1
        return max(1, round(slow * apart / self.sample_time))

    def near(self, at: State) -> Near:
        """What the simulator is in some states, where its joints slide."""
        at = self._sliding(at)
        first, rest, _ = self._body(at, self.friction.torque(at.qd), self.numbers())
        torque = _times(first, at.qdd) + rest
        mass, rest, answer = self._body(at, torque, self.numbers(), first)
        good = _alike(first, mass)
        if np.mean(good) < RIGID_SHARE:
            good[:] = True
        return Near(
            at.at(good), torque[good], mass[good], rest[good], answer[good], first[good], good
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
            more, push = torque.copy(), PUSHED * self.torque[j]
            more[:, j] += push
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
        if key not in self.in_mass:
            some = np.unique(np.linspace(0, len(at) - 1, STATES_ASKED).astype(int))
            change = self._first(near, numbers, some) - near.first[some]
            self.in_mass[key] = bool(np.abs(change).max() > MOVES_MASS * np.abs(near.mass).max())
        change = np.zeros_like(near.mass)
        if self.in_mass[key]:  # what a pushed simulator's speed adds is in both
            change = self._first(near, numbers, np.arange(len(at))) - near.first
        came = self.accelerations(at, torque, numbers)
        came = self.accelerations(replace(at, qdd=came), torque, numbers)
        rest = torque - _times(near.mass + change, came)
        return change / step, (rest - near.rest) / step

    def _first(self, near: Near, numbers: Parameters, some: Any) -> Array:
        """Mass matrices as ``Near.first`` with other numbers, at some of its states."""
        at = near.at.at(some)
        return self._body(at, self.friction.torque(at.qd), numbers)[0]

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
        held = (torque + self.friction.torque(motion.qd))[rows].mean(axis=1)
        for count in np.unique(np.minimum(most, n - starts)):
            some = np.minimum(most, n - starts) == count
            at = rows[some][:, :count]
            answer = self.simulated(motion.at(at[:, 0]), held[some], numbers, count + 1)
            came = np.diff(answer, 2, axis=1) / self.sample_time**2  # (windows, count, joints)
            off = motion.qdd[at] - came
            out[at] = held[some][:, None] + np.einsum("wcij,wcj->wci", mass[at], off)
        out -= self.friction.torque(motion.qd)
        near = self._turns(motion.qd)
        if near.any():
            out[near] = self._turning(motion.at(near), torque[near], mass[near])
        return out

    # ---- dry friction inside

    def _slow(self, qd: Array) -> npt.NDArray[np.bool_]:
        """Where joints with dry friction inside are so slow that they may stick, (n, joints)."""
        slow: npt.NDArray[np.bool_] = np.abs(qd) < SLIDES * np.std(self.probe.qd, axis=0)
        return slow & (np.array(self.friction.sizes.get(DRY, 0.0)) > 0.0)

    def _sliding(self, at: State) -> State:
        """States in which no joint may stick: slow ones move a little faster, their own way."""
        slow, least = self._slow(at.qd), SLIDES * np.std(self.probe.qd, axis=0)
        return replace(at, qd=np.where(slow, np.where(at.qd < 0.0, -least, least), at.qd))

    def _turns(self, qd: Array) -> npt.NDArray[np.bool_]:
        """The rows whose simulation has a joint in it that may stick, (n,)."""
        slow, reach = self._slow(qd).any(axis=1), self._run + 1
        return np.convolve(slow, np.ones(2 * reach + 1), "same") > 0.5

    def _turning(self, at: State, torque: Array, mass: Array) -> Array:
        """The torque of the motion without friction where joints turn, (n, joints): on the line
        through the two of its both directions.
        """

        def asked(there: State, torque: Array, mass: Array) -> Array:
            rubbing = self.friction.torque(there.qd)
            came = self.accelerations(there, torque + rubbing, self.numbers())
            # a simulator that gets the torque of the motion passes it; what it falls behind is told
            return torque + _times(mass, there.qdd - came)

        slow, there = self._slow(at.qd), self._sliding(at)
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

    # ---- the simulator, a few rows at a time

    def accelerations(self, at: State, torque: Array, numbers: Parameters) -> Array:
        """Acceleration in some states under a torque, (n, joints)."""
        answer = self.simulated(at, torque, numbers, ROWS_EACH)
        return np.diff(answer, 2, axis=1)[:, 0] / self.sample_time**2

    def simulated(self, at: State, torque: Array, numbers: Parameters, rows: int) -> Array:
        """Positions under constant torques from a row before each state on, (n, rows + 1,
        joints).
        """
        h, n = self.sample_time, len(at)
        gain = [per_joint(self.model.actuator.gain, j + 1, 1.0) for j in range(self.joints)]
        t = h * np.arange(-1, rows)[None, :, None]
        q = at.q[:, None] + at.qd[:, None] * t + 0.5 * at.qdd[:, None] * t**2
        qd = at.qd[:, None] + at.qdd[:, None] * t
        command = np.repeat((torque / gain)[:, None], rows + 1, axis=1)
        if self.joints == 1:
            q, qd, command = q[..., 0], qd[..., 0], command[..., 0]
        clock: Array = h * np.arange(rows + 1, dtype=np.float64)
        recordings: list[Columns] = [
            {
                "time": clock, "sample_time": h, "position": q[i], "velocity": qd[i],
                "command": command[i], "reference": q[i],
            }
            for i in range(n)
        ]  # fmt: skip
        parts: list[Array] = []
        began = time.perf_counter()
        for first in range(0, n, ASKED_AT_ONCE):
            some = recordings[first : first + ASKED_AT_ONCE]
            parts += self.simulator.run(some, numbers)
            self.calls += len(some)
            self._progress()
        self.seconds = min(self.seconds, (time.perf_counter() - began) / max(n, 1))
        try:
            out = np.array(parts, dtype=np.float64)
        except ValueError:
            out = np.zeros(0)
        wanted = (n, rows + 1, self.joints)
        if out.size != np.prod(wanted):
            raise ModelError(
                f"{self.simulator.name} returned shape {np.shape(parts[0])}; expected {wanted[1:]}:"
                " a position for every row"
            )
        return out.reshape(wanted)

    def _progress(self) -> None:
        done = self.calls - self.begun
        tenths = min(10, 10 * done // max(self.asked, 1))
        bar = "█" * tenths + "░" * (10 - tenths)
        self.tell(Step.READING.says(f"asking the simulator along the motion {bar} {done} states"))


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
