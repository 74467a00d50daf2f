"""The WAM paper's validation: joint errors of the arm and of its simulation, with each joint alone
and with all together.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.experiment.figures import BLUE, RED, label, make_figure, save
from zendsp.experiment.lab import Lab, needed, playing
from zendsp.experiment.result import Estimate, Result
from zendsp.experiment.wam_friction import JOINTS, MACHINE, POSE, friction
from zendsp.physics import parse_model, simulate
from zendsp.physics.codegen.urdf import dh_urdf
from zendsp.physics.model import Model
from zendsp.reference import load_machine, make_lspb

Array = npt.NDArray[np.float64]

STEP, DURATION = 0.5, 7.0  # rad, s: cruise at 0.083 rad/s
PROGRAM = "wam_pd_gravity.c"
CHANNELS = ("play_time", "q", "e")
# motor turns a joint turn; 4096 counts a turn of the motor
RATIO = (42.0, 28.25, 28.25, 18.0, 9.48, 9.48, 14.93)


def tracking(
    lab: Lab, joints: tuple[int, ...] = tuple(range(1, JOINTS + 1)), duration: float = DURATION
) -> Result:
    """Each joint moved alone by 0.5 rad along the paper's LSPB, then all together, on the machine
    and in simulation.
    """
    measured = needed(lab, "friction", friction)
    result = Result("tracking", "Joint error of the WAM, machine and simulation", MACHINE)
    errors: dict[str, tuple[Array, Array]] = {}
    with lab.bench(result.name) as bench:
        model = measured_model(measured, bench.folder)
        machine = load_machine(MACHINE)
        for name, moving in [*((f"joint{j}", (j,)) for j in joints), ("all", joints)]:
            goal = np.array(POSE)
            for j in moving:
                goal[j - 1] += (
                    STEP if goal[j - 1] + STEP < machine.limits.position_max[j - 1] else -STEP
                )
            reference = make_lspb(machine, start=POSE, goal=goal, duration=duration, blend_time=1.0)
            rec = bench.record(name, PROGRAM, CHANNELS, reference=reference, before=3.0, after=0.5)
            sim = simulate(
                PROGRAM, model, reference=reference, parameters={"approach_time": 3.0},
                channels=CHANNELS, position=machine.home, inner=8,
            )
            result.recordings.append(sim.save(bench.folder / f"{name}_simulation.npz").name)
            errors[name] = (
                rec["e"][playing(rec, reference.samples)],
                sim["e"][playing(sim, reference.samples)],
            )
        result.recordings, result.target = [*bench.recordings, *result.recordings], bench.where
        _report(result, errors, joints)
        result.figure = save(_draw(errors, joints), bench.folder / "tracking.png")
    return result


def measured_model(measured: Result, folder: Path) -> Model:
    """The WAM's published inertias with the measured friction; its URDF is written into the folder.
    """
    machine = load_machine(MACHINE)
    limits = {
        name: getattr(machine.limits, name).tolist()
        for name in ("position_min", "position_max", "torque", "speed")
    }
    file = folder / "wam7.urdf"
    file.write_text(dh_urdf("wam7", machine.parameters["link"], limits), encoding="utf-8")
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
    result: Result, errors: dict[str, tuple[Array, Array]], joints: tuple[int, ...]
) -> None:
    rows = []
    for name, (real, sim) in errors.items():
        for j in joints if name == "all" else (int(name[5:]),):
            real_rms, sim_rms, apart = (
                float(np.sqrt(np.mean(x[:, j - 1] ** 2))) for x in (real, sim, real - sim)
            )
            key = f"joint{j}_{'all' if name == 'all' else 'alone'}"
            result.values[f"{key}_machine"] = Estimate(real_rms, 0.0, "rad")
            result.values[f"{key}_simulation"] = Estimate(sim_rms, 0.0, "rad")
            result.values[f"{key}_apart"] = Estimate(100 * apart / real_rms, 0.0, "%")
            rows.append(
                {
                    "joint": j,
                    "moving": "all" if name == "all" else "alone",
                    "machine rms mrad": round(1e3 * real_rms, 3),
                    "simulation rms mrad": round(1e3 * sim_rms, 3),
                    "apart %": round(100 * apart / real_rms, 1),
                }
            )
    result.tables["errors"] = sorted(rows, key=lambda row: (row["moving"] != "alone", row["joint"]))


def _draw(errors: dict[str, tuple[Array, Array]], joints: tuple[int, ...]) -> Any:
    figure, axes = make_figure(len(joints), 2, width=9.5, height=1.5, sharex=True, sharey="row")
    for row, j in zip(axes, joints, strict=True):
        for axis, name in zip(row, (f"joint{j}", "all"), strict=True):
            real, sim = errors[name]
            t = 0.001 * np.arange(len(real))
            axis.plot(t, 1e3 * real[:, j - 1], color=BLUE, linewidth=1.5, label="machine")
            axis.plot(
                t, 1e3 * sim[: len(real), j - 1], "--", color=RED, linewidth=1.0, label="simulation"
            )
        label(row[0], "", f"joint {j} (mrad)")
    axes[0, 0].set_title("each joint alone: error", fontsize=10, loc="left")
    axes[0, 1].set_title("all seven together", fontsize=10, loc="left")
    axes[0, 0].legend(fontsize=8, frameon=False, ncols=2)
    for axis in axes[-1]:
        axis.set_xlabel("t (s)", fontsize=9)
    return figure
