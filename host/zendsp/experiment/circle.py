"""A circle of the tip under computed torque, with and without friction compensation, in simulation
and on the machine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import Refused
from zendsp.experiment.figures import BLUE, GREY, RED, label, make_figure, save
from zendsp.experiment.friction_curve import friction_curve
from zendsp.experiment.joints import bare
from zendsp.experiment.knowing import as_found, shipped
from zendsp.experiment.lab import Bench, Lab, needed, own_program, playing, told
from zendsp.experiment.model_update import with_effects
from zendsp.experiment.planar_arm import MACHINE, P1, P2, P3
from zendsp.experiment.plane import Plane, circle_of, fitting_circle, plane_of, slow_enough
from zendsp.experiment.push import travel_time
from zendsp.experiment.registry import EXPERIMENTS
from zendsp.experiment.result import Estimate, Result
from zendsp.physics import load_model, model_code, parse_model, simulate
from zendsp.physics.model import Model
from zendsp.reference import Reference, load_machine, make_circle

Array = npt.NDArray[np.float64]

CHANNELS = ("play_time", "q", "r", "e", "tau", "friction")
RADIUS, DURATION = 0.15, 4.5  # m, s
PROGRAM = "inverse_dynamics.c"
STILL = 0.005  # rad/s: below about this speed a joint counts as standing
TRIES, SLOWER = 12, 1.3  # durations that are tried, each longer by so much


@dataclass(frozen=True)
class Task:
    """A circle that a machine can make.

    Attributes
    ----------
    joints : tuple of int
        That move, 1-based.
    duration : float
        s.
    circle : callable
        Duration to reference.
    loop : callable
        Whether friction is compensated, to program and parameters.
    model : Model
        That is simulated.
    pose : list of float
        Where the simulation begins.
    before : float
        Time to the first row, s.
    """

    joints: tuple[int, int]
    duration: float
    circle: Callable[[float], Reference]
    loop: Callable[[bool], tuple[str | Mapping[str, str], dict[str, Any]]]
    model: Model
    pose: list[float]
    before: float = 1.0

    def errors(self, rec: Any, samples: int) -> Array:
        """Errors of the joints that move, while the reference was played."""
        return np.asarray(rec["e"][playing(rec, samples)][:, [j - 1 for j in self.joints]])


def circle(lab: Lab, slower: tuple[float, ...] = (2.0, 4.0, 8.0)) -> Result:
    """The planar-arm paper's test: a circle, in four ways; and slower circles, whose error does not
    fall below a floor.

    Parameters
    ----------
    lab : Lab
        With a model of the machine (``--model``), where that is not the shipped arm: two
        neighbouring joints whose axes are parallel, urdf, mjcf or planar2r.
    slower : tuple of float
        Durations of those, in that of the first.
    """
    arm = shipped(lab)
    plane = _plane(lab) if arm is None else None  # before anything moves
    joints = plane.joints if plane is not None else ()
    curves = needed(lab, "friction-curve", lambda lab: friction_curve(lab, joints))
    result = Result(
        "circle", "Circle under inverse dynamics, with and without friction compensation",
        curves.machine,
    )
    floor: list[tuple[float, Array]] = []
    with lab.bench(result.name, result) as bench:
        task = _arm_task(curves) if plane is None else _task(bench, lab, plane, curves)
        reference = task.circle(task.duration)
        errors = _four_ways(bench, task, reference, result)
        if arm is not None:
            _published(bench, reference, result, errors)
        program, values = task.loop(True)
        for times in slower:
            slow = task.circle(task.duration * times)
            rec = bench.record(
                f"machine_{task.duration * times:g}s", program, CHANNELS, reference=slow,
                decimation=2, before=task.before, **values,
            )  # fmt: skip
            floor.append((task.duration * times, rms(task.errors(rec, slow.samples // 2))))
        result.recordings, result.target = [*bench.recordings, *result.recordings], bench.where
        floor.insert(0, (task.duration, rms(errors["machine", True])))
        _report(result, task.joints, errors, floor)
        result.figure = save(_draw(errors, task.joints, reference), bench.folder / "circle.png")
    if plane is not None and plane.tip:
        result.warnings.append(
            f"The model does not say where the tip of link {plane.joints[1]} is: it is taken"
            f" {plane.tip}, {plane.lengths[1]:.3g} m from the axis."
        )
    return result


def _four_ways(
    bench: Bench, task: Task, reference: Reference, result: Result
) -> dict[tuple[str, bool], Array]:
    """The errors of the machine and of the simulation, each with and without compensation."""
    errors: dict[tuple[str, bool], Array] = {}
    for compensate in (False, True):
        word = "with" if compensate else "without"
        program, values = task.loop(compensate)
        rec = bench.record(
            f"machine_{word}", program, CHANNELS, reference=reference, before=task.before, **values
        )
        errors["machine", compensate] = task.errors(rec, reference.samples)
        sim = simulate(
            program, task.model, reference=reference,
            parameters={**values, "approach_time": task.before}, channels=CHANNELS,
            position=task.pose, check=not compensate,
        )  # fmt: skip
        result.recordings.append(sim.save(bench.folder / f"simulation_{word}.npz").name)
        errors["simulation", compensate] = task.errors(sim, reference.samples)
    return errors


def _published(
    bench: Bench, reference: Reference, result: Result, errors: Mapping[tuple[str, bool], Array]
) -> None:
    """What the published friction of the arm gains."""
    plain = bench.record(
        "machine_published_figures", PROGRAM, CHANNELS, reference=reference, compensate=True
    )
    gain = 1.0 - rms(plain["e"][playing(plain, reference.samples)]) / rms(errors["machine", False])
    for joint, value in enumerate(gain, start=1):
        name = f"published_improvement_joint{joint}"
        result.values[name] = Estimate(float(100 * value), 0.0, "%")


def _plane(lab: Lab) -> Plane:
    """The joints that move, by the lab's model; Refused where the machine lacks something."""
    if lab.target is not None:
        lacks = EXPERIMENTS["circle"].lacking(told(lab.target), lab.model is not None)
        if lacks:
            raise Refused(f"experiment circle {lacks}")
    assert lab.model is not None
    return plane_of(load_model(lab.model), str(lab.model))


def _arm_task(curves: Result) -> Task:
    """The paper's circle on the shipped arm."""
    machine, gains = load_machine(MACHINE), compensation_values(curves)
    return Task(
        (1, 2), DURATION,
        lambda duration: make_circle(machine, radius=RADIUS, duration=duration),
        lambda compensate: (PROGRAM, {**gains, "compensate": compensate}),
        measured_model(curves), [0.0, 0.0],
    )  # fmt: skip


def _task(bench: Bench, lab: Lab, plane: Plane, curves: Result) -> Task:
    """A circle within the ranges, speeds and torques of two joints of a machine."""
    assert lab.model is not None
    low = Result.load(lab.folder / "low-speed" / "result.toml")
    known = as_found(bench, lab, low)
    model, measured = with_effects(load_model(lab.model), curves)
    lacking = [j for j in plane.joints if j not in measured]
    if lacking:
        raise Refused(
            f"circle: friction of joint {lacking[0]} was not measured; the result of friction-curve"
            " says why"
        )
    period = 1.0 / bench.target.status().rate_hz
    place = fitting_circle(plane, known, period)
    duration = DURATION
    for _ in range(TRIES):
        planned = circle_of(plane, known, place, (duration, period))
        if slow_enough(planned, known):
            break
        duration *= SLOWER
    stands = known.pose if known.stands is None else known.stands
    codes = {True: model_code(model), False: model_code(bare(model))}
    values = {"model_sign_speed": STILL}
    return Task(
        plane.joints, duration,
        lambda duration: circle_of(plane, known, place, (duration, period)),
        lambda compensate: (_program(codes[compensate]), values if compensate else {}),
        model, known.pose.tolist(), travel_time(known, stands, planned.q[0]),
    )  # fmt: skip


def _program(model: str) -> dict[str, str]:
    """The loop with this model."""
    return own_program("computed_torque.c") | {"model.c": model}


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
    result: Result,
    joints: tuple[int, int],
    errors: dict[tuple[str, bool], Array],
    floor: list[tuple[float, Array]],
) -> None:
    for (where, compensate), error in errors.items():
        for joint, value in zip(joints, rms(error), strict=True):
            result.values[f"{where}_{'with' if compensate else 'without'}_joint{joint}"] = Estimate(
                float(value), 0.0, "rad"
            )
    for where in ("machine", "simulation"):
        gain = 1.0 - rms(errors[where, True]) / rms(errors[where, False])
        for joint, value in zip(joints, gain, strict=True):
            result.values[f"{where}_improvement_joint{joint}"] = Estimate(
                float(100 * value), 0.0, "%"
            )
    for compensate in (False, True):
        apart = rms(errors["machine", compensate] - errors["simulation", compensate]) / rms(
            errors["machine", compensate]
        )
        for joint, value in zip(joints, apart, strict=True):
            result.values[
                f"simulation_differs_{'with' if compensate else 'without'}_joint{joint}"
            ] = Estimate(float(100 * value), 0.0, "%")
    result.tables["errors"] = [
        {
            "joint": joints[j],
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
            f"rms joint {joints[0]} rad": float(f"{e[0]:.3g}"),
            f"rms joint {joints[1]} rad": float(f"{e[1]:.3g}"),
        }
        for d, e in floor
    ]


def _draw(
    errors: dict[tuple[str, bool], Array], joints: tuple[int, int], reference: Reference
) -> Any:
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
        label(axis, "", "error (mrad)", f"joint {joints[joint]}")
    axes[0, 0].legend(fontsize=8, frameon=False, ncols=2, loc="upper right")
    axes[1, 0].set_xlabel("t (s)", fontsize=9)
    return figure
