"""Pushes of one joint with a torque of its own, while the others are held (programs/push.c)."""

from __future__ import annotations

from typing import Any

import numpy as np

from zendsp.errors import Unmeasured
from zendsp.experiment.coarse import cutoff_for
from zendsp.experiment.joints import STIFF, USED, Array, Known
from zendsp.experiment.knowing import PROGRAM
from zendsp.experiment.lab import Bench, push_program
from zendsp.link import Target
from zendsp.link.outside import positions
from zendsp.recording import Recording

TRAVEL_S = 2.0  # s, to the start position, at least
PUSHING, BRAKING, HELD = 2, 3, 4  # phases
RESET = 0.3  # s, of the integral that holds the joints of a machine whose weight is not known
REST_S = 0.5  # s, at rest before a push
CUTOFF = 80.0  # Hz, of the speed in push.c, where none is given


class Pusher:
    """Pushes joints of a machine, and remembers where they came to stand.

    Parameters
    ----------
    bench : Bench
    known : Known
    """

    def __init__(self, bench: Bench, known: Known) -> None:
        self.bench, self.known = bench, known
        self.gave: dict[int, list[dict[int, float]]] = {}  # way of each held joint, of each push
        self.began: Array = known.pose if known.stands is None else known.stands
        self.stands = self.began

    def push(
        self, name: str, joint: int, direction: int, place: float, seconds: float, **values: Any
    ) -> Recording:
        """Go to a place, rest, push; ``seconds`` of the push and what follows are recorded, on the
        real clock not much longer than until the joint is held again.

        Raises
        ------
        Unmeasured
            The joint did not stand still before the push, or something holds it up on its way.
        """
        known, axis = self.known, self.known.axes[joint]
        goal = known.at(joint, place)
        # on the fast clock a simulated machine begins again where it began at first
        starts = self.stands, self.began
        travel = max(travel_time(known, start, np.array(goal)) for start in starts)
        channels = ["q", "tau", "torque", "phase", "blocked"]
        gains = {"Kp": known.gain("kp"), "Kd": known.gain("kd"), "brake": known.gain("brake")}
        reset = 0.0 if known.program != PROGRAM else RESET
        # one count is seen as so much speed: two of them are none that ends a push
        J = np.array(known.gain("kd")) / (2.0 * STIFF)
        usual = cutoff_for(self.bench.machine.joints, J, STIFF / (2.0 * np.pi))
        cutoff = values.get("cutoff", CUTOFF if known.program != PROGRAM else usual)
        fastest = USED * axis.speed + 4.0 * np.pi * cutoff * abs(axis.count)
        values = {"cutoff": cutoff, **values}
        limits = {"lower": axis.low, "upper": axis.high, "fastest": fastest}
        given = {"reset": reset, "taken": False, **limits, **gains, **known.weights(), **values}
        try:
            rec = self.bench.record(
                name, push_program(), channels, seconds=1.5 * travel + REST_S + 0.3 + seconds,
                joint=joint, direction=direction, place=goal, travel_time=travel, rest_time=REST_S,
                done=_held, **given,
            )
        except Unmeasured:  # it was held up on its way, and others are still measured
            here = positions(self.bench.target.status(), self.bench.machine.joints)
            self.stands = np.array(here, dtype=np.float64)
            raise
        self.gave.setdefault(joint, []).append({k: s.way for k, s in self.bench.seen.items()})
        self.stands = rec["q"].reshape(len(rec), -1)[-1]
        if not (rec["phase"] == PUSHING).any():
            raise Unmeasured(
                f"joint {joint} did not stand at {place:.3g} {axis.unit} before the push: its"
                " weight is not known well enough; give a model (--model), or look at the recording"
            )
        return rec


def _held(target: Target) -> bool:
    """Whether the push is over, and the joint held where it came to stand."""
    return int(np.asarray(target["phase"])) == HELD


def travel_time(known: Known, start: Array, goal: Array) -> float:
    """Time for a way at 0.3 of the largest speed and torque, s (of a fifth-order way the peak speed
    is 15/8 d/T, the peak acceleration 10/sqrt(3) d/T^2).
    """
    time = TRAVEL_S
    for j, axis in known.axes.items():
        d = abs(float(goal[j - 1] - start[j - 1]))
        quick = 0.3 * axis.torque / max(axis.load.inertia, 1e-12)
        time = max(time, 1.875 * d / (0.3 * axis.speed), (5.7735 * d / quick) ** 0.5)
    return float(np.ceil(10.0 * time) / 10.0)


def columns(rec: Recording, name: str, joints: int) -> Array:
    """A channel of all joints, (N, joints), of a machine with one joint too."""
    return np.asarray(rec[name].reshape(len(rec), joints))
