"""Simulation on the host: the user's C code, or a controller of the model's, against the model of a
machine. No target, no network.

Nothing is random and nothing depends on the clock: the same input gives the same recording.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import RecordingError
from zendsp.physics.files.model_file import load_model
from zendsp.physics.files.model_write import model_text
from zendsp.physics.model import Model, per_joint, position_limits
from zendsp.physics.simulation.loaded import Job, Outcome
from zendsp.physics.simulation.plant import INNER, Plant, joint_count
from zendsp.physics.simulation.program import compile_program, run_program
from zendsp.recording import Recording
from zendsp.recording.names import gather_vectors
from zendsp.recording.notes import Extra, Halving, StepCheck
from zendsp.reference import Reference, check_fits, load_reference
from zendsp_isr.sources import Source
from zendsp_protocol.texts import counted, joint_units
from zendsp_protocol.values import Assignable

Array = npt.NDArray[np.float64]
Controller = Callable[[float, Array, Array], npt.ArrayLike]
MAX_INNER = 256
_LONGEST_S = 3600.0
_FOR_ANOTHER = "Is it a program for another machine, or does an index run too far?"


def simulate(
    program: Source,
    model: Model | str | Path,
    *,
    reference: Reference | str | Path | None = None,
    seconds: float | None = None,
    parameters: Mapping[str, Assignable] | None = None,
    channels: Sequence[str] | None = None,
    position: npt.ArrayLike | None = None,
    velocity: npt.ArrayLike | None = None,
    inner: int = INNER,
    decimation: int = 1,
    flags: Sequence[str] = (),
    check: bool = False,
    background: int = 0,
    timeout: float = 60.0,
) -> Recording:
    """Run a control program, as it is, against the host's model of a machine.

    The order within a sample is that of a target: sensors, user code, one sample of motion.
    ``[actuator] delay`` of the model says when a command acts; a machine on a target has one
    sample.

    Parameters
    ----------
    program : path, name of a shipped example, or mapping of file name to text
        C code written for ``isr.h``; it runs in a child process.
    model : Model, or path of a model file
    reference : Reference, or path of a reference file, optional
        Goes into the program's tables ``ref`` and ``ref_tau``; ``use_table`` and ``row_rate`` are
        set where the program has them.
    seconds : float, optional
        Default: approach, reference and half a second; 10 s where there is no reference.
    parameters : mapping of name to value, optional
        Set after ``UserInit``, checked against the declared limits.
    channels : sequence of str, optional
        As in an acquisition: variables, elements "q[0]", and tick, t, enc, aout, measured, plant_q,
        plant_qd, plant_torque (the true motion, which no target can give). Default: every SIGNAL of
        the program.
    position, velocity : array_like, shape (joints,), optional
        Start, rad or m, and per s. Default: at rest in the first row of the reference, or at 0.
    inner : int
        Integration steps per sample.
    decimation : int
        Every how many samples a row is kept.
    flags : sequence of str
        Further flags for the compiler, as "-DN=1".
    check : bool
        Repeat with half the step until no position changes by more than one count of its sensor
        (1e-5 of a rad or m where it is continuous); ``extra["step_check"]`` tells what was found,
        with ``"converged": False`` where even 256 steps a sample differ.
    background : int
        How many times ``UserBackground`` is called between two samples.
    timeout : float
        Of real time, s.

    Returns
    -------
    Recording
        Of the same form as an acquisition.

        ``extra["simulation"]["beyond"]`` has a sentence for each limit of the model that it left.

    Raises
    ------
    CompileFailed, RunnerDied, VariableError, AcquisitionError, ModelError, ReferenceError_
        As a target would say it.

    Examples
    --------
    >>> import zendsp
    >>> rec = zendsp.simulate("pd.c", "imi_planar.toml", seconds=2.0)  # doctest: +SKIP
    """
    model = load_model(model) if not isinstance(model, Model) else model
    planned = load_reference(reference) if isinstance(reference, str | Path) else reference
    told = check_fits(planned, model.name, _units(model)) if planned is not None else ""
    build = compile_program(program, flags)
    tables = planned.tables() if planned is not None else {}
    defaults = (
        {"use_table": True, "row_rate": round(1.0 / planned.sample_time)}
        if planned is not None
        else {}
    )
    if position is None and planned is not None:
        position = planned.q[0]
    longest = (
        seconds
        if seconds is not None
        else min(_LONGEST_S, 70.0 + (planned.duration if planned else 0.0))
    )

    def run(steps: int, wanted: Sequence[str] | None) -> Outcome:
        plant = Plant(
            model,
            round(longest / (model.sample_time or 1.0)) + 2,
            inner=steps,
            position=position,
            velocity=velocity,
        )
        job = Job(dict(parameters or {}), defaults, tables, seconds, wanted, decimation, background)
        return run_program(build, plant, job, timeout)

    began = time.time()
    extra: Extra = {"simulation": {"inner": inner, "model": model_text(model)}}
    if check:
        inner, extra["step_check"] = converge(
            model, inner, lambda steps: run(steps, ["plant_q"]).columns["plant_q"]
        )
        extra["simulation"]["inner"] = inner
    outcome = run(inner, channels)
    if not outcome.columns:
        raise RecordingError("the program declares no SIGNAL: name channels, for example plant_q")
    extra["simulation"]["beyond"] = beyond(model, outcome)
    if told:
        extra["simulation"]["reference"] = told
    return Recording.from_columns(
        outcome.columns,
        sample_time=(model.sample_time or 0.0) * decimation,
        units=outcome.units,
        decimation=decimation,
        parameters=outcome.parameters,
        sources=dict(build.sources),
        compiler=build.compiler,
        flags=build.flags,
        machine=model.name,
        target="simulation",
        created=began,
        extra=extra,
    )


def _units(model: Model) -> list[str]:
    """Of each joint's position."""
    return [model.position_unit(j + 1) for j in range(joint_count(model))]


def beyond(model: Model, outcome: Outcome) -> list[str]:
    """Return a sentence for each limit of the model that a run left: what, how far, what to do."""
    n, period = joint_count(model), model.sample_time or 0.0
    none = _names_none(outcome, n, model.name)
    ran_away = outcome.ticks < outcome.wanted and not none
    said = []
    for j, r in enumerate(outcome.reached[:n], 1):
        unit = model.position_unit(j)
        torque = "N" if unit == "m" else "N m"
        low, high = position_limits(model, j)
        far = max(r.low, r.high, key=abs)
        if ran_away and abs(far) == max(
            abs(v) for q in outcome.reached[:n] for v in (q.low, q.high)
        ):
            said.append(
                f"joint {j} ran away: {far:.4g} {unit} after {outcome.ticks} of {outcome.wanted}"
                f" samples. Is the program one for {model.name}? Else take smaller gains"
            )
        elif r.low < low or r.high > high:
            said.append(
                f"joint {j} leaves its limits: {far:.4g} {unit}, allowed {low:g} … {high:g} {unit}."
                " Begin elsewhere (--position), or plan a smaller motion"
            )
        if r.beyond >= 0 and r.limit > 0.0:
            said.append(
                f"joint {j}: a command of {r.command:.4g} {torque}, the limit is {r.limit:.4g}"
                f" {torque} (first at {r.beyond * period:.4g} s). A target would stop the machine:"
                " take smaller gains, or a slower motion"
            )
    if none:
        last = outcome.ticks - 1
        said.append(
            f"stopped in sample {last} ({last * period:.4g} s), where a target would stop the"
            f" machine: {none}"
        )
    return said


def _names_none(outcome: Outcome, n: int, machine: str) -> str:
    """What a program names that a machine of n joints has not; empty where it has it all."""
    more = [str(k + 1) for k in range(n, len(outcome.reached)) if outcome.reached[k].beyond >= 0]
    if more:
        return f"the program commands joint {', '.join(more)}; {machine} has {n}. {_FOR_ANOTHER}"
    if not outcome.outside:
        return ""
    named = outcome.outside - (outcome.outside > 0)
    return (
        f"the program names joint or channel [{named}], counted from 0, and {machine} has"
        f" {counted(n, 'joint')}. {_FOR_ANOTHER}"
    )


def converge(model: Model, inner: int, positions: Callable[[int], Array]) -> tuple[int, StepCheck]:
    """Double the steps until the positions stand still to one count; the count that suffices, and
    what was found.
    """
    allowed = np.array(
        [per_joint(model.sensor.resolution, j + 1, 0.0) or 1e-5 for j in range(joint_count(model))]
    )
    last = positions(inner)
    changes: list[Halving] = []
    while True:
        finer = positions(2 * inner)
        rows = min(len(last), len(finer))
        change = np.abs(finer[:rows] - last[:rows]).reshape(rows, -1).max(axis=0)
        changes.append({"inner": inner, "change": change.tolist()})
        done = bool(len(finer) == len(last) and np.all(change <= allowed))
        if done or 2 * inner >= MAX_INNER:
            return inner, {
                "converged": done, "units": _units(model), "allowed": allowed.tolist(),
                "halvings": changes,
            }
        inner, last = 2 * inner, finer


def reference_rows(
    reference: Any, model: Model
) -> tuple[Array | None, Array | None, str]:
    """A reference as rows at the model's sample time, (rows, joints): positions, torques to feed
    forward, and the mode in which it is played. None where there are none.
    """
    n, sample_time = joint_count(model), model.sample_time or 0.0
    if reference is None:
        return None, None, ""
    if isinstance(reference, str | Path):
        reference = load_reference(reference)
    if isinstance(reference, Reference):
        check_fits(reference, model.name, _units(model))
        if abs(reference.sample_time - sample_time) < 1e-9:
            return (
                np.array(reference.q),
                None if reference.tau is None else np.array(reference.tau),
                reference.mode,
            )
        t = np.arange(round(reference.duration / sample_time) + 1) * sample_time
        q = np.stack([np.interp(t, reference.t, column) for column in reference.q.T], axis=1)
        # a torque is held
        row = np.minimum((t / reference.sample_time + 1e-9).astype(int), reference.samples - 1)
        return q, None if reference.tau is None else reference.tau[row], reference.mode
    return np.asarray(reference, dtype=np.float64).reshape(-1, n), None, "position"


def stretch(rows: Array, count: int, *, hold: bool) -> Array:
    """Exactly ``count`` rows: cut, or continued by the last row (hold) or by zeros."""
    out = np.zeros((count, rows.shape[1]))
    kept = min(count, len(rows))
    out[:kept] = rows[:kept]
    if hold:
        out[kept:] = rows[-1]
    return out


def recording(model: Model, out: dict[str, Array], r: Array | None, extra: Extra) -> Recording:
    """What a simulation recorded, under the model's column names and units, with the true state as
    ``plant_…``.
    """
    of_joints = _units(model)
    unit, speed, torque = (
        joint_units(words, of_joints, len(of_joints)) for words in ("{q}", "{q}/s", "{tau}")
    )
    columns: dict[str, Array] = {}
    units: dict[str, str] = {}

    def put(role: str, values: Array, unit: str) -> None:
        names = model.columns.get(role, role)
        if isinstance(names, list):
            each = unit.split(", ")  # one where all joints are alike
            for j, name in enumerate(names):
                if not name:  # of a joint that nothing drives
                    continue
                columns[name], units[name] = values[:, j], each[min(j, len(each) - 1)]
        else:
            columns[str(names)] = values if values.shape[1] > 1 else values[:, 0]
            units[str(names)] = unit

    put("position", out["measured"], unit)
    put("command", out["command"], model.actuator.unit or torque)
    if r is not None:
        put("reference", r[: len(out["measured"])], unit)
    if "temperature" in out:
        put("temperature", out["temperature"], "°C")
    for name, key, u in (
        ("plant_q", "q", unit),
        ("plant_qd", "qd", speed),
        ("plant_torque", "torque", torque),
    ):
        columns[name], units[name] = out[key] if out[key].shape[1] > 1 else out[key][:, 0], u
    columns, units = gather_vectors(columns, units)
    rec = Recording.from_columns(
        columns, sample_time=model.sample_time, units=units, machine=model.name,
        target="simulation", extra=extra,
    )
    return replace(rec, created=time.time())
