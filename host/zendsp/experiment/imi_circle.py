"""The planar arm on a circle under inverse dynamics, with and without friction compensation, in
simulation and on the machine.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.experiment.figures import BLUE, GREY, RED, label, make_figure, save
from zendsp.experiment.imi_fit import fit
from zendsp.experiment.imi_friction import MACHINE, P1, P2, P3
from zendsp.experiment.lab import Lab, needed, playing
from zendsp.experiment.result import Estimate, Result
from zendsp.physics import parse_model, simulate
from zendsp.physics.model import Model
from zendsp.reference import Reference, load_machine, make_circle

Array = npt.NDArray[np.float64]

CHANNELS = ("play_time", "q", "r", "e", "tau", "friction")
RADIUS, DURATION = 0.15, 4.5  # m, s
PROGRAM = "inverse_dynamics.c"


def circle(lab: Lab, slower: tuple[float, ...] = (9.0, 18.0, 36.0)) -> Result:
    """The paper's test: a circle in 4.5 s, in four ways; and slower circles, whose error does not
    fall below a floor.
    """
    curves = needed(lab, "friction-curve", fit)
    result = Result(
        "circle", "Circle under inverse dynamics, with and without friction compensation",
        MACHINE,
    )
    machine = load_machine(MACHINE)
    model = measured_model(curves)
    gains = compensation_values(curves)
    reference = make_circle(machine, radius=RADIUS, duration=DURATION)
    errors: dict[tuple[str, bool], Array] = {}
    floor: list[tuple[float, Array]] = []
    with lab.bench(result.name) as bench:
        for compensate in (False, True):
            word = "with" if compensate else "without"
            values: dict[str, Any] = {**gains, "compensate": compensate}
            rec = bench.record(f"machine_{word}", PROGRAM, CHANNELS, reference=reference, **values)
            errors["machine", compensate] = rec["e"][playing(rec, reference.samples)]
            sim = simulate(
                PROGRAM, model, reference=reference, parameters={**values, "approach_time": 1.0},
                channels=CHANNELS, position=[0.0, 0.0], check=not compensate,
            )
            result.recordings.append(sim.save(bench.folder / f"simulation_{word}.npz").name)
            errors["simulation", compensate] = sim["e"][playing(sim, reference.samples)]
        plain = bench.record(
            "machine_published_figures", PROGRAM, CHANNELS, reference=reference, compensate=True
        )
        for duration in slower:
            slow = make_circle(machine, radius=RADIUS, duration=duration)
            rec = bench.record(
                f"machine_{duration:g}s", PROGRAM, CHANNELS, reference=slow, decimation=2, **gains,
                compensate=True,
            )
            floor.append((duration, rms(rec["e"][playing(rec, slow.samples // 2)])))
        result.recordings, result.target = [*bench.recordings, *result.recordings], bench.where
        floor.insert(0, (DURATION, rms(errors["machine", True])))
        _report(result, errors, floor)
        gain = 1.0 - rms(plain["e"][playing(plain, reference.samples)]) / rms(
            errors["machine", False]
        )
        for joint, value in enumerate(gain, start=1):
            result.values[f"published_improvement_joint{joint}"] = Estimate(
                float(100 * value), 0.0, "%"
            )
        result.figure = save(_draw(errors, reference), bench.folder / "circle.png")
    return result


def measured_model(curves: Result) -> Model:
    """The arm with the friction that the experiments found."""
    return parse_model(
        {
            "name": "imi_planar, measured",
            "sample_time": 0.001,
            "mechanism": {"kind": "planar2r", "parameters": {"p1": P1, "p2": P2, "p3": P3}},
            "effect": [effect.table() for effect in curves.effects],
            "actuator": {"gain": [1.0, 1.0], "limit": [245.0, 39.2], "delay": 0.00116},
            "sensor": {"position_resolution": 4.0906154344e-5},
        }
    )


def compensation_values(curves: Result) -> dict[str, Any]:
    """Parameters of inverse_dynamics.c from the fitted curves."""
    rows = {row["joint"]: row for row in curves.tables["program"]}
    return {
        "low1": rows[1]["low"],
        "high1": rows[1]["high"],
        "low2": rows[2]["low"],
        "high2": rows[2]["high"],
        "split": [rows[1]["split"], rows[2]["split"]],
    }


def rms(error: Array) -> Array:
    """The root mean square of each joint's error."""
    return np.asarray(np.sqrt(np.mean(error**2, axis=0)))


def _report(
    result: Result, errors: dict[tuple[str, bool], Array], floor: list[tuple[float, Array]]
) -> None:
    for (where, compensate), error in errors.items():
        for joint, value in enumerate(rms(error), start=1):
            result.values[f"{where}_{'with' if compensate else 'without'}_joint{joint}"] = Estimate(
                float(value), 0.0, "rad"
            )
    for where in ("machine", "simulation"):
        gain = 1.0 - rms(errors[where, True]) / rms(errors[where, False])
        for joint, value in enumerate(gain, start=1):
            result.values[f"{where}_improvement_joint{joint}"] = Estimate(
                float(100 * value), 0.0, "%"
            )
    for compensate in (False, True):
        apart = rms(errors["machine", compensate] - errors["simulation", compensate]) / rms(
            errors["machine", compensate]
        )
        for joint, value in enumerate(apart, start=1):
            result.values[
                f"simulation_differs_{'with' if compensate else 'without'}_joint{joint}"
            ] = Estimate(float(100 * value), 0.0, "%")
    result.tables["errors"] = [
        {
            "joint": j + 1,
            "run": f"{where}, {'with' if c else 'without'} compensation",
            "rms rad": float(f"{rms(e)[j]:.3g}"),
            "largest rad": float(f"{np.abs(e[:, j]).max():.3g}"),
        }
        for j in range(2)
        for (where, c), e in errors.items()
    ]
    result.tables["slower circles, compensated"] = [
        {
            "duration s": d,
            "rms joint 1 rad": float(f"{e[0]:.3g}"),
            "rms joint 2 rad": float(f"{e[1]:.3g}"),
        }
        for d, e in floor
    ]


def _draw(errors: dict[tuple[str, bool], Array], reference: Reference) -> Any:
    figure, axes = make_figure(2, 1, height=2.9, sharex=True)
    looks = {
        ("machine", False): (RED, "-", 1.6),
        ("simulation", False): ("black", "--", 0.9),
        ("machine", True): (BLUE, "-", 1.6),
        ("simulation", True): (GREY, "--", 0.9),
    }
    for joint, axis in enumerate(axes[:, 0]):
        for (where, compensate), (colour, dash, width) in looks.items():
            e = errors[where, compensate][:, joint] * 1e3
            words = f"{where}, {'with' if compensate else 'without'} compensation"
            axis.plot(reference.t[: len(e)], e, dash, color=colour, linewidth=width, label=words)
        top = np.abs(errors["machine", False][:, joint]).max() * 1e3
        axis.set_ylim(-1.2 * top, (1.75 if joint == 0 else 1.2) * top)
        label(axis, "", "error (mrad)", f"joint {joint + 1}")
    axes[0, 0].legend(fontsize=8, frameon=False, ncols=2, loc="upper right")
    axes[1, 0].set_xlabel("t (s)", fontsize=9)
    return figure
