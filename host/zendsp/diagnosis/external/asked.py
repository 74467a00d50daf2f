"""A simulator that can only be called, asked for the accelerations in some states.

From a state a few rows are simulated under a constant torque; the second difference of the answer
is the acceleration there.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.external.columns import Columns, Parameters
from zendsp.diagnosis.external.inside import DRY, Inside
from zendsp.diagnosis.external.numbers import folded
from zendsp.diagnosis.external.simulator import Simulator
from zendsp.diagnosis.progress import Progress, Step
from zendsp.errors import ModelError
from zendsp.physics.model import Model, per_joint

Array = npt.NDArray[np.float64]

ROWS_EACH = 2  # simulated from each state: the fewest with a second difference
ASKED_AT_ONCE = 500  # simulations between two looks at Ctrl-C
# of the speed: where there is dry friction inside, a slower joint is asked for at this speed, both
# ways. It passes 0.02 of it in the rows of an answer, at 2 Hz and 1 ms
SLIDES = 0.05


@dataclass(frozen=True)
class State:
    """Motion of all joints, (n, joints) each."""

    q: Array
    qd: Array
    qdd: Array

    def at(self, rows: Any) -> State:
        """The motion at some rows."""
        return State(self.q[rows], self.qd[rows], self.qdd[rows])

    def no_slower(self, least: Array) -> State:
        """The motion, slow joints made faster, their own way."""
        qd = np.where(self.qd < 0.0, np.minimum(self.qd, -least), np.maximum(self.qd, least))
        return replace(self, qd=qd)

    def __len__(self) -> int:
        return len(self.q)


@dataclass
class Asked:
    """A simulator, and what is known of it.

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
    inside : Inside
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
    inside: Inside = field(default_factory=Inside)
    seconds: float = math.inf  # a state takes, with its restart: the shortest, whatever else runs
    asked: int = 0  # states that the present motion needs
    begun: int = 0  # ``calls`` before it

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.torque)

    def numbers(self, **moved: float) -> Parameters:
        """The simulator's parameters, some of them moved."""
        return folded({**self.about, **moved})

    def slow(self, qd: Array) -> npt.NDArray[np.bool_]:
        """Where joints with dry friction inside are so slow that they may stick, (n, joints)."""
        slow: npt.NDArray[np.bool_] = np.abs(qd) < SLIDES * np.std(self.probe.qd, axis=0)
        return slow & (np.array(self.inside.sizes.get(DRY, 0.0)) > 0.0)

    def sliding(self, at: State, least: float = SLIDES) -> State:
        """States in which no joint may stick: slow ones move a little faster, their own way.
        ``least``: of the speed.
        """
        rubs = np.array(self.inside.sizes.get(DRY, 0.0)) > 0.0
        return at.no_slower(rubs * least * np.std(self.probe.qd, axis=0))

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
