"""Joint errors of a machine and of its simulation by a model, with each joint alone and with all
together: the WAM paper's validation, on any machine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from zendsp.errors import ModelError
from zendsp.experiment import wam_friction
from zendsp.experiment.figures import BLUE, RED, label, make_figure, save
from zendsp.experiment.joints import rigid_of
from zendsp.experiment.knowing import weight_here
from zendsp.experiment.lab import Bench, Lab, needed, playing
from zendsp.experiment.result import Cell, Estimate, Result
from zendsp.experiment.standing import standing
from zendsp.experiment.wam_friction import JOINTS, POSE
from zendsp.physics import load_model, parse_model, simulate
from zendsp.physics.codegen.urdf import dh_urdf
from zendsp.physics.model import Model, per_joint
from zendsp.recording import Recording
from zendsp.reference import Limits, Machine, Reference, load_machine, make_limited, make_lspb
from zendsp.whole_file import write_whole, writing
from zendsp_protocol.messages import MachineInfo
from zendsp_protocol.texts import counted

Array = npt.NDArray[np.float64]

STEP = 0.5  # rad or m, at most …
SHARE = 0.2  # … and of the range of the joint
SPEED = 0.4  # of the largest speed, at most
BLEND = 1.0  # s
DURATION = 7.0  # s, as the paper: a cruise of 0.5 rad at 0.083 rad/s
BEFORE = 3.0  # s, to the first row
CHANNELS = ("play_time", "q", "e")
# motor turns a joint turn; 4096 counts a turn of the motor
RATIO = (42.0, 28.25, 28.25, 18.0, 9.48, 9.48, 14.93)


@dataclass(frozen=True)
class Plan:
    """What moves, from where and how far, and by which program; the model it is compared with."""

    machine: Machine
    model: Model
    program: str
    start: Array  # rad or m, of all joints
    way: Array  # rad or m, of each joint; 0: it has no drive
    units: tuple[str, ...]
    inner: int = 8  # steps of the simulation in a sample


def tracking(lab: Lab, joints: tuple[int, ...] = (), duration: float = DURATION) -> Result:
    """Each joint moved alone along the paper's LSPB, then all together, on the machine and in
    simulation.

    Parameters
    ----------
    lab : Lab
        With the model file of the machine. The WAM without one has its published inertias and the
        friction that is measured first.
    joints : tuple of int
        Which; default: all that have a drive.
    duration : float
        Of one way, s; longer where a joint would be too fast.
    """
    name = lab.machine_of("tracking")
    wam = lab.shipped("tracking") == wam_friction.MACHINE
    own = wam and lab.model is None
    measured = needed(lab, "friction", wam_friction.friction) if own else None
    model = load_model(lab.model) if lab.model is not None else None
    whose = "the WAM" if wam else name
    result = Result("tracking", f"Joint error of {whose}, machine and simulation", name)
    errors: dict[str, tuple[Array, Array]] = {}
    with lab.bench(result.name, result) as bench:
        if measured is not None:
            model = measured_model(measured, bench.folder)
        assert model is not None  # the bench has asked for one
        plan = _wam_plan(model) if wam else _any_plan(bench, model)
        moved = joints or tuple(int(j) + 1 for j in np.flatnonzero(plan.way))
        together = [("all", moved)] if len(moved) > 1 else []
        for run, moving in [*((f"joint{j}", (j,)) for j in moved), *together]:
            reference = _move(plan, moving, duration)
            rec = bench.record(
                run, plan.program, CHANNELS, reference=reference, before=BEFORE, after=0.5
            )
            sim = _simulated(plan, rec, reference)
            result.recordings.append(sim.save(bench.folder / f"{run}_simulation.npz").name)
            errors[run] = _error(rec, reference), _error(sim, reference)
        result.recordings, result.target = [*bench.recordings, *result.recordings], bench.where
        _report(result, errors, moved, plan)
        result.figure = save(_draw(errors, moved, plan), bench.folder / "tracking.png")
    return result


def _wam_plan(model: Model) -> Plan:
    """The paper's pose, step and control law."""
    machine, start = load_machine(wam_friction.MACHINE), np.array(POSE)
    way = np.where(start + STEP < machine.limits.position_max, STEP, -STEP)
    return Plan(machine, model, "wam_pd_gravity.c", start, way, ("rad",) * JOINTS)


def _any_plan(bench: Bench, model: Model) -> Plan:
    """Each joint by a share of its range from where it stands, towards the end that is farther."""
    told = bench.machine
    if model.joints != len(told.joints):
        raise ModelError(
            f"{model.name} has {counted(model.joints, 'joint')} and {told.name}"
            f" {len(told.joints)}: give a model of that machine"
        )
    start = standing(bench, weight_here(bench, rigid_of(model)), takes_model=True)
    low, high, speed, torque = np.array(
        [(j.position_min, j.position_max, j.speed_max, j.torque_max) for j in told.joints]
    ).T
    way = np.minimum(STEP, SHARE * (high - low))
    way *= np.where(high - start >= start - low, 1.0, -1.0)
    way[[j.command == "none" for j in told.joints]] = 0.0
    limits = Limits(low, high, speed, np.full(len(start), np.inf), torque)
    period = 1.0 / bench.target.status().rate_hz
    unit = " or ".join(sorted({j.unit for j in told.joints}, reverse=True))
    machine = make_limited(told.name, period, start, limits, unit)
    units = tuple(j.unit for j in told.joints)
    return Plan(machine, _completed(model, told), "joint_pd.c", start, way, units)


def _completed(model: Model, told: MachineInfo) -> Model:
    """The model with what it leaves open and the machine declares: the drives' limits, and the
    counts of the encoders.
    """
    actuator, sensor = model.actuator, model.sensor
    most = [j.torque_max for j in told.joints]
    if not actuator.limit and np.all(np.isfinite(most)):
        gains = [abs(per_joint(actuator.gain, j + 1, 1.0)) for j in range(model.joints)]
        limit = tuple(m / g for m, g in zip(most, gains, strict=True))
        actuator = replace(actuator, limit=limit)
    if not sensor.resolution:
        counts = tuple(1.0 / abs(j.counts_per_unit) for j in told.joints)
        sensor = replace(sensor, resolution=counts)
    return replace(model, actuator=actuator, sensor=sensor)


def _move(plan: Plan, moving: tuple[int, ...], duration: float) -> Reference:
    goal = plan.start.copy()
    for j in moving:
        goal[j - 1] += plan.way[j - 1]
    slowest = np.abs(goal - plan.start) / (SPEED * plan.machine.limits.speed)
    return make_lspb(
        plan.machine, start=plan.start, goal=goal, blend_time=BLEND,
        duration=max(duration, float(slowest.max()) + BLEND),
    )


def _simulated(plan: Plan, rec: Recording, reference: Reference) -> Recording:
    """The same motion by the model, from where the machine began, with the program's parameters as
    they were on the machine: it may take some from what that declares.
    """
    parameters = {
        k: v for k, v in rec.parameters.items() if k in ("J", "carried", "approach_time")
    } | {"approach_time": BEFORE}
    return simulate(
        plan.program, plan.model, reference=reference, parameters=parameters, channels=CHANNELS,
        position=np.atleast_1d(rec["q"][0]), inner=plan.inner,
    )


def _error(rec: Recording, reference: Reference) -> Array:
    """The joints' errors while the reference was played; (rows, joints)."""
    rows = playing(rec, reference.samples)
    return np.asarray(rec["e"][rows]).reshape(-1, reference.q.shape[1])


def measured_model(measured: Result, folder: Path) -> Model:
    """The WAM's published inertias with the measured friction; its URDF is written into the folder.
    """
    machine = load_machine(wam_friction.MACHINE)
    limits = {
        name: getattr(machine.limits, name).tolist()
        for name in ("position_min", "position_max", "torque", "speed")
    }
    file = folder / "wam7.urdf"
    with writing(file):
        write_whole(file, dh_urdf("wam7", machine.parameters["link"], limits))
    return parse_model(
        {
            "name": "wam7, measured",
            "sample_time": 0.001,
            "mechanism": {"kind": "urdf", "file": str(file.resolve())},
            "effect": [effect.table() for effect in measured.effects],
            "actuator": {
                "gain": [1.0] * JOINTS,
                "limit": [float(x) for x in machine.limits.torque],
                "delay": 0.00116,
            },
            "sensor": {"position_resolution": [2 * np.pi / 4096 / r for r in RATIO]},
            "columns": {"position": [f"q[{j}]" for j in range(JOINTS)]},
        }
    )


def _report(
    result: Result, errors: dict[str, tuple[Array, Array]], joints: tuple[int, ...], plan: Plan
) -> None:
    rows: list[dict[str, Cell]] = []
    for name, (real, sim) in errors.items():
        n = min(len(real), len(sim))
        for j in joints if name == "all" else (int(name[5:]),):
            real_rms, sim_rms, apart = (
                float(np.sqrt(np.mean(x[:, j - 1] ** 2))) for x in (real, sim, real[:n] - sim[:n])
            )
            unit = plan.units[j - 1]
            key = f"joint{j}_{'all' if name == 'all' else 'alone'}"
            result.values[f"{key}_machine"] = Estimate(real_rms, 0.0, unit)
            result.values[f"{key}_simulation"] = Estimate(sim_rms, 0.0, unit)
            result.values[f"{key}_apart"] = Estimate(100 * apart / real_rms, 0.0, "%")
            rows.append(
                {
                    "joint": j,
                    "moving": "all" if name == "all" else "alone",
                    f"machine rms m{unit}": round(1e3 * real_rms, 3),
                    f"simulation rms m{unit}": round(1e3 * sim_rms, 3),
                    "apart %": round(100 * apart / real_rms, 1),
                }
            )
    result.tables["errors"] = sorted(rows, key=lambda row: (row["moving"] != "alone", row["joint"]))


def _draw(
    errors: dict[str, tuple[Array, Array]], joints: tuple[int, ...], plan: Plan
) -> Figure:
    runs = ("", "all")[: 1 + ("all" in errors)]
    figure, axes = make_figure(
        len(joints), len(runs), width=9.5, height=max(1.5, 3.0 / len(joints)), sharex=True,
        sharey="row",
    )
    for row, j in zip(axes, joints, strict=True):
        for axis, name in zip(row, runs, strict=True):
            for error, style, colour, width, word in (
                (errors[name or f"joint{j}"][0], "-", BLUE, 1.5, "machine"),
                (errors[name or f"joint{j}"][1], "--", RED, 1.0, "simulation"),
            ):
                t = plan.machine.sample_time * np.arange(len(error))
                shown = 1e3 * error[:, j - 1]
                axis.plot(t, shown, style, color=colour, linewidth=width, label=word)
        label(row[0], "", f"joint {j} (m{plan.units[j - 1]})")
    axes[0, 0].set_title("each joint alone: error", fontsize=10, loc="left")
    if len(runs) > 1:
        axes[0, 1].set_title(f"all {len(joints)} together", fontsize=10, loc="left")
    axes[0, 0].legend(fontsize=8, frameon=False, ncols=2)
    for axis in axes[-1]:
        axis.set_xlabel("t (s)", fontsize=9)
    return figure
