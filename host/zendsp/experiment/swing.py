"""An optimal swing of any joint that stands alone: planned with the measured friction and replayed,
or planned without it and compensated, as the pendulum's paper compares.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import ReferenceError_, Refused
from zendsp.experiment import pendulum_swing, spun_shaft
from zendsp.experiment.knowing import with_values
from zendsp.experiment.lab import Lab, own_program
from zendsp.experiment.mechanics import mechanical
from zendsp.experiment.pendulum_swing import AFTER, Plans, compare
from zendsp.experiment.result import Result
from zendsp.extras import need
from zendsp.reference import Limits, Machine, Reference, make_swing
from zendsp.reference.dynamics import G
from zendsp_protocol.messages import JointInfo

Array = npt.NDArray[np.float64]

TORQUE = 0.625  # of the largest torque: 0.5 of the pendulum's 0.8 N m
SPEED = 0.6  # of the largest speed
PERIODS = 1.14  # of the hanging joint's own: 0.8 s of the pendulum
SHARE, WAY = 0.4, 0.8  # of the range; rad or m: how far where upright is out of reach
FREE = 4.0 * np.pi  # rad: a wider range does not bound a swing
ASIDE = 0.1  # of the range, kept free at its ends
FASTER = 0.3  # of the largest torque: what a joint without weight is accelerated by, at least
LONGER, TRIES = 1.3, 8  # a duration in which there is no swing is made longer so often
BANDWIDTH, DAMPING = 3.0, 0.5  # Hz and ratio of the loop around the swing
STEEP = 100.0  # s/rad or s/m, of the friction that is compensated, as the paper
# values of mechanical: one of each
NEEDED = (
    ("inertia1", "mass1"), ("coulomb1",), ("viscous1",), ("weight1", "weight_sine1"),
    ("weight1", "weight_cosine1"),
)
CHANNELS = ("play_time", "q", "qd", "tau", "r")
BEFORE = 2.0  # s, to where the joint hangs


@dataclass(frozen=True)
class Joint:
    """What was measured of the joint, and what it declares."""

    own: JointInfo
    inertia: float
    friction: float
    viscous: float
    sine: float  # weight: sine sin q + cosine cos q + constant
    cosine: float
    constant: float

    @property
    def weight(self) -> float:
        """Largest weight that changes with the position."""
        return float(np.hypot(self.sine, self.cosine))

    @property
    def hangs(self) -> float:
        """Where the joint hangs, rad."""
        return float(np.arctan2(-self.cosine, self.sine))


def swing(lab: Lab) -> Result:
    """Swing with the least energy from where the joint hangs to upright, or where that is out of
    its range, or nothing hangs, as far as it may; three ways.
    """
    name = lab.machine_of("swing")
    if lab.shipped("swing") == spun_shaft.MACHINE:
        return pendulum_swing.swing(lab)
    need("casadi", "swing", "the optimal swing", Refused)  # before anything moves
    measured = with_values(lab, "mechanical", mechanical, NEEDED)
    result = Result("swing", f"Optimal swing of {name}, three ways", name)
    with lab.bench(result.name, result) as bench:
        joint = _joint(measured, bench.machine.joints[0])
        stands = bench.record("where_it_stands", own_program("swing.c"), CHANNELS, seconds=0.05)
        start, goal = _ends(joint, float(stands["q"][0]))
        period = 1.0 / bench.target.status().rate_hz
        with_friction, without = _plans(joint, start, goal, period)
        stiff = joint.inertia * (2.0 * np.pi * BANDWIDTH) ** 2
        kp, kv = stiff, 2.0 * DAMPING * (stiff * joint.inertia) ** 0.5
        options: dict[str, Any] = {
            "before": BEFORE, "after": AFTER, "kp": kp, "kv": kv, "beta": STEEP,
            "sine": joint.sine, "cosine": joint.cosine, "constant": joint.constant,
        }
        recs = {
            run: bench.record(
                run.replace(" ", "_"), own_program("swing.c"), CHANNELS, reference=plan,
                follow=follow, fc=fc, **options,
            )
            for run, plan, follow, fc in (
                ("open loop", with_friction, False, 0.0),
                ("closed loop", with_friction, True, 0.0),
                ("feedback level", without, True, joint.friction),
            )
        }
        plans = Plans(with_friction, without, joint.own.unit, f"{BANDWIDTH:g} Hz", goal)
        compare(result, recs, plans, bench)
    return result


def _joint(measured: Result, own: JointInfo) -> Joint:
    def value(name: str) -> float:
        return measured.values[name].value if name in measured.values else 0.0

    return Joint(
        own, value("inertia1") or value("mass1"), max(value("coulomb1"), 0.0),
        max(value("viscous1"), 0.0), value("weight_sine1"), value("weight_cosine1"),
        value("weight1"),
    )


def _ends(joint: Joint, place: float) -> tuple[float, float]:
    """Where the swing begins and ends: from hanging to upright where the range allows; else as far
    from there as it may; of a joint that hangs nowhere, a share of its range.
    """
    low, high = joint.own.position_min, joint.own.position_max
    aside = ASIDE * (high - low) if high - low < FREE else 0.0
    low, high = low + aside, high - aside
    if joint.weight > joint.friction:
        turns = 2.0 * np.pi * np.round((place - joint.hangs) / (2.0 * np.pi))
        start = float(np.clip(joint.hangs + turns, low, high))
        up = [joint.hangs + turns + sign * np.pi for sign in (1.0, -1.0)]
        if reached := [g for g in up if low <= g <= high]:
            return start, float(reached[0])
        return start, float(high if high - start >= start - low else low)
    way = min(WAY, SHARE * (joint.own.position_max - joint.own.position_min))
    start = float(np.clip(place, low, high))
    return start, start + (way if high - start >= start - low else -way)


def _plans(
    joint: Joint, start: float, goal: float, period: float
) -> tuple[Reference, Reference]:
    """Swings with the measured friction and without, of one duration."""
    zero = joint.hangs + 2.0 * np.pi * np.round((start - joint.hangs) / (2.0 * np.pi))
    if joint.weight <= joint.friction:
        zero = start
    own = joint.own
    most = TORQUE * own.torque_max
    speed = SPEED * own.speed_max
    # k_a = 1 and R_a = 0: the drive's voltage is its speed, and bounds nothing else
    parameters = {
        "theta1": joint.inertia, "theta2": joint.weight / G, "theta3": joint.friction,
        "beta": STEEP, "viscous": joint.viscous, "k_a": 1.0, "R_a": 0.0, "supply": speed,
    }
    bounds = (own.position_min, own.position_max, speed, np.inf, own.torque_max)
    limits = Limits(*(np.array([x]) for x in bounds))
    machine = Machine(
        own.name, own.name, "pendulum", 1, period, np.array([0.0]), limits, parameters
    )
    way = abs(goal - start)
    pushed = 2.0 * (joint.inertia * way / (FASTER * own.torque_max)) ** 0.5
    duration = max(2.0 * way / speed, pushed)
    if joint.weight > joint.friction:
        duration = max(duration, PERIODS * 2.0 * np.pi * (joint.inertia / joint.weight) ** 0.5)
    limit = most - abs(joint.constant)
    for _ in range(TRIES):
        with contextlib.suppress(ReferenceError_):
            first, second = (
                _placed(
                    make_swing(
                        machine, start=start - zero, goal=goal - zero, duration=duration,
                        torque_limit=limit, friction=friction,
                    ),
                    joint,
                    zero,
                )
                for friction in (joint.friction, 0.0)
            )
            if _within(first, own) and _within(second, own):
                return first, second
        duration *= LONGER
    force = "N m" if own.unit == "rad" else "N"
    raise Refused(
        f"{own.name}: no swing of {way:.3g} {own.unit} within {own.position_min:g} to"
        f" {own.position_max:g} {own.unit} is found with {limit:.3g} {force}"
        f" ({100 * TORQUE:g} % of its largest, less its weight) and {speed:.3g} {own.unit}/s: look"
        " at what mechanical found, and at the limits that the machine declares"
    )


def _within(plan: Reference, own: JointInfo) -> bool:
    """Whether a plan, which may swing back first, keeps half of the distance off the range's ends.
    """
    aside = 0.5 * ASIDE * (own.position_max - own.position_min)
    least, most = float(plan.q.min()), float(plan.q.max())
    free = own.position_max - own.position_min >= FREE
    return free or own.position_min + aside <= least <= most <= own.position_max - aside


def _placed(plan: Reference, joint: Joint, zero: float) -> Reference:
    """The plan in the joint's own position, with the weight that is the same everywhere."""
    assert plan.tau is not None
    return replace(plan, q=plan.q + zero, tau=plan.tau + joint.constant)
