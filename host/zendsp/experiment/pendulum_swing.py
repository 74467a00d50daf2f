"""The pendulum paper's comparison on the pendulum: an optimal swing planned with friction in its
model, in open and closed loop, and friction compensated by feedback.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from zendsp.experiment.figures import BLUE, GREEN, GREY, RED, label, make_figure, save
from zendsp.experiment.knowing import with_values
from zendsp.experiment.lab import Bench, Lab, playing
from zendsp.experiment.result import Estimate, Result
from zendsp.experiment.spun_shaft import MACHINE, mechanical
from zendsp.recording import Recording
from zendsp.reference import Machine, Reference, load_machine, make_swing

Array = npt.NDArray[np.float64]

GOAL = math.pi
AFTER = 1.5  # s, to see whether it stays
NEEDED = (("theta1",), ("theta2",), ("theta3",), ("viscous",))  # values of mechanical
RUNS = ("open loop", "closed loop", "feedback level")
CHANNELS = ("play_time", "q", "qd", "tau", "r", "adc")


@dataclass(frozen=True)
class Plans:
    """Swings planned with the measured friction and without any, and how the drawing says it."""

    with_friction: Reference
    without: Reference
    unit: str = "rad"
    gains: str = "kp = 1.2, kv = 0.005"
    goal: float = GOAL


def swing(lab: Lab, duration: float = 0.8, torque: float = 0.5, brake: float = 0.08) -> Result:
    """Swing to upright with the least energy: planned with the measured friction and replayed, or
    planned without it and compensated.
    """
    measured = with_values(lab, "mechanical", mechanical, NEEDED)
    result = Result("swing", "Optimal swing of the pendulum, three ways", MACHINE)
    machine = measured_machine(measured)
    with_friction = make_swing(machine, goal=GOAL, duration=duration, torque_limit=torque)
    without = make_swing(machine, goal=GOAL, duration=duration, torque_limit=torque, friction=0.0)
    # a swing begins at rest, within the bristles: so does the motion that these numbers are of
    fc = from_rest(measured, "theta3")
    recs: dict[str, Recording] = {}
    with lab.bench(result.name, result, brake=brake) as bench:
        options: dict[str, Any] = {"before": 0.0, "after": AFTER}
        recs["open loop"] = bench.record(
            "open_loop", "pendulum_track.c", CHANNELS, reference=with_friction, kp=0.0, kv=0.0,
            **options,
        )
        recs["closed loop"] = bench.record(
            "closed_loop", "pendulum_track.c", CHANNELS, reference=with_friction, kp=1.2, kv=0.005,
            **options,
        )
        recs["feedback level"] = bench.record(
            "feedback_level", "pendulum_compensation.c", CHANNELS, reference=without, fc=fc,
            kp=1.2, kv=0.005, **options,
        )
        compare(result, recs, Plans(with_friction, without), bench)
    return result


def from_rest(measured: Result, name: str) -> float:
    """A number that was measured from rest; an older result has only one of each."""
    return measured.values.get(f"{name}_from_rest", measured.values[name]).value


def measured_machine(measured: Result) -> Machine:
    """The nominal pendulum with the parameters that the experiment found."""
    nominal = load_machine(MACHINE)
    found = {name: from_rest(measured, name) for name in ("theta1", "theta2", "theta3", "viscous")}
    return replace(nominal, parameters={**nominal.parameters, **found})


def _rows(rec: Recording) -> slice:
    return slice(playing(rec, 0).start, len(rec))


def compare(result: Result, recs: dict[str, Recording], plans: Plans, bench: Bench) -> None:
    """Add to the result what the runs reached, their table and their figure."""
    result.recordings, result.target = bench.recordings, bench.where
    for name, rec in recs.items():
        plan = plans.without if name == "feedback level" else plans.with_friction
        _measure(result, name, rec, plan, plans)
    result.tables["runs"] = [
        {
            "run": name,
            **{
                key: str(result.values[f"{name.replace(' ', '_')}_{key}"])
                for key in ("final_error", "path_rms", "torque_activity")
            },
        }
        for name in RUNS
    ]
    result.figure = save(_draw(recs, plans), bench.folder / "swing.png")


def _measure(
    result: Result, name: str, rec: Recording, reference: Reference, plans: Plans
) -> None:
    rows = _rows(rec)
    q, tau = rec["q"][rows], rec["tau"][rows]
    n = min(reference.samples, len(q))
    key = name.replace(" ", "_")
    force = "N m" if plans.unit == "rad" else "N"
    result.values[f"{key}_final_error"] = Estimate(float(abs(q[-1] - plans.goal)), 0.0, plans.unit)
    result.values[f"{key}_path_rms"] = Estimate(
        float(np.sqrt(np.mean((q[:n] - reference.q[:n, 0]) ** 2))), 0.0, plans.unit
    )
    # oscillation of the command: mean |change of torque| a second, the plan's own taken off
    own = float(np.abs(np.diff(reference.tau[:, 0])).sum()) if reference.tau is not None else 0.0
    result.values[f"{key}_torque_activity"] = Estimate(
        float(np.abs(np.diff(tau)).sum() - own), 0.0, force
    )


def _draw(recs: dict[str, Recording], plans: Plans) -> Figure:
    """Draw position and speed, torque and, where it is sensed, current; the plans are dashed."""
    figure, axes = make_figure(2, 2, width=11.0, height=2.7, sharex=True)
    (position, speed), (torque, current) = axes
    for plan, colour, name in (
        (plans.with_friction, "black", "plan with friction"),
        (plans.without, GREY, "plan without friction"),
    ):
        lines: dict[str, Any] = {"color": colour, "linestyle": "--", "linewidth": 1.0}
        position.plot(plan.t, plan.q[:, 0], label=name, **lines)
        speed.plot(plan.t, plan.qd[:, 0], **lines)
        if plan.tau is not None:
            torque.plot(plan.t, plan.tau[:, 0], **lines)
    position.axhline(plans.goal, color=GREY, linewidth=0.6)
    words = {
        "open loop": "open loop",
        "closed loop": f"closed loop, {plans.gains}",
        "feedback level": "friction compensated at the feedback level",
    }
    sensed = all("adc" in rec for rec in recs.values())
    for (name, rec), colour in zip(recs.items(), (BLUE, GREEN, RED), strict=True):
        rows = _rows(rec)
        t = rec.t[rows] - rec.t[rows.start]
        position.plot(t, rec["q"][rows], color=colour, linewidth=1.4, label=words[name])
        speed.plot(t, rec["qd"][rows], color=colour, linewidth=1.0)
        torque.plot(t, rec["tau"][rows], color=colour, linewidth=1.0)
        if sensed:
            current.plot(t, rec["adc"][rows, 0], color=colour, linewidth=1.0)
    force = "N m" if plans.unit == "rad" else "N"
    label(position, "", f"position ({plans.unit})", legend=True)
    label(speed, "", f"speed ({plans.unit}/s)")
    label(torque, "t (s)", f"torque ({force})" if force == "N m" else "force (N)")
    if sensed:
        label(current, "t (s)", "measured current (A)")
    else:
        current.set_axis_off()
    return figure
