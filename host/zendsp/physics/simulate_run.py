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

from zendsp.errors import ModelError, RecordingError
from zendsp.physics.model import Model, per_joint
from zendsp.physics.model_file import load_model
from zendsp.physics.model_write import model_text
from zendsp.physics.simulate_plant import INNER, Plant, joint_count
from zendsp.physics.simulate_program import Job, Outcome, compile_program, run_program
from zendsp.recording import Recording
from zendsp.recording.names import gather_vectors
from zendsp.reference import Reference, load_reference
from zendsp_isr.sources import Source

Array = npt.NDArray[np.float64]
Controller = Callable[[float, Array, Array], npt.ArrayLike]

MAX_INNER = 256
_LONGEST_S = 3600.0


def simulate(
    program: Source,
    model: Model | str | Path,
    *,
    reference: Reference | str | Path | None = None,
    seconds: float | None = None,
    parameters: Mapping[str, Any] | None = None,
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
    CompileFailed, RunnerDied, VariableError, AcquisitionError, ModelError
        As a target would say it.

    Examples
    --------
    >>> import zendsp
    >>> rec = zendsp.simulate("pd.c", "imi_planar.toml", seconds=2.0)  # doctest: +SKIP
    """
    model = load_model(model) if not isinstance(model, Model) else model
    planned = load_reference(reference) if isinstance(reference, str | Path) else reference
    if planned is not None and planned.joints != joint_count(model):
        raise ModelError(
            f"{model.name} has {joint_count(model)} joints, the reference {planned.joints}"
        )
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
    extra: dict[str, Any] = {"simulation": {"inner": inner, "model": model_text(model)}}
    if check:
        inner, extra["step_check"] = _converge(
            model, inner, lambda steps: run(steps, ["plant_q"]).columns["plant_q"]
        )
        extra["simulation"]["inner"] = inner
    outcome = run(inner, channels)
    if not outcome.columns:
        raise RecordingError("the program declares no SIGNAL: name channels, for example plant_q")
    extra["simulation"]["beyond"] = beyond(model, outcome)
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


def beyond(model: Model, outcome: Outcome) -> list[str]:
    """Return a sentence for each limit of the model that a run left: what, how far, what to do."""
    n, period = joint_count(model), model.sample_time or 0.0
    linear = model.joint_kind(1) == "linear"
    unit, torque = ("m", "N") if linear else ("rad", "N m")
    low, high = model.limits.get("position", (-np.inf, np.inf))
    said = []
    for j, r in enumerate(outcome.reached[:n], 1):
        far = max(r.low, r.high, key=abs)
        if outcome.ticks < outcome.wanted and abs(far) == max(
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
    more = [str(k + 1) for k in range(n, len(outcome.reached)) if outcome.reached[k].beyond >= 0]
    if more:
        said.append(
            f"the program commands joint {', '.join(more)}; {model.name} has {n}. Is it a program"
            " for another machine?"
        )
    return said


def _converge(
    model: Model, inner: int, positions: Callable[[int], Array]
) -> tuple[int, dict[str, Any]]:
    """Double the steps until the positions stand still to one count; the count that suffices, and
    what was found.
    """
    allowed = np.array(
        [per_joint(model.sensor.resolution, j + 1, 0.0) or 1e-5 for j in range(joint_count(model))]
    )
    last = positions(inner)
    changes = []
    while True:
        finer = positions(2 * inner)
        rows = min(len(last), len(finer))
        change = np.abs(finer[:rows] - last[:rows]).reshape(rows, -1).max(axis=0)
        changes.append({"inner": inner, "change": change.tolist()})
        done = bool(len(finer) == len(last) and np.all(change <= allowed))
        if done or 2 * inner >= MAX_INNER:
            return inner, {"converged": done, "allowed": allowed.tolist(), "halvings": changes}
        inner, last = 2 * inner, finer


def simulate_loop(
    model: Model | str | Path,
    reference: Reference | npt.ArrayLike | None = None,
    controller: Mapping[str, Any] | Controller | None = None,
    *,
    command: npt.ArrayLike | None = None,
    seconds: float | None = None,
    position: npt.ArrayLike | None = None,
    velocity: npt.ArrayLike | None = None,
    temperature: npt.ArrayLike | None = None,
    inner: int = INNER,
    check: bool = False,
) -> Recording:
    """Run a model in a loop with its own controller, or open loop, without any C program.

    Parameters
    ----------
    model : Model, or path of a model file
    reference : Reference or array_like, shape (N,) or (N, joints), optional
        Positions, one row a sample (a Reference is interpolated); the last row is held. The torque
        of a Reference is fed forward (in command units).
    controller : mapping or callable, optional
        A mapping as the model's ``[controller]``: kind "pd", kp, kd, and where wanted ki, cutoff
        (Hz, of the speed filter, 0: none). Default: the model's own. A callable (t, r, y) → command
        is called once a sample (slower).
    command : array_like, shape (N,) or (N, joints), optional
        The command itself, open loop; with a reference or a controller beside it, what is added to
        the controller's.
    seconds : float, optional
        Default: as long as the longer of reference and command.
    position, velocity : array_like, shape (joints,), optional
        Start; default: at rest in the first row of the reference.
    temperature : float or array_like, shape (N,), optional
        Of the machine, °C; the last one stays. 20 where absent.
    inner : int
        Integration steps per sample, as for :func:`simulate`.
    check : bool
        Halve the step until nothing changes, as for :func:`simulate`.

    Returns
    -------
    Recording
        Under the names of the model's ``[columns]`` (else position, command, reference): what the
        sensor said, the command, the reference, the temperature where it was given; and plant_q,
        plant_qd, plant_torque, the truth.

    Raises
    ------
    ModelError
        No controller and no command, or a controller of another kind.

    Examples
    --------
    >>> from zendsp.physics import parse_model, simulate_loop
    >>> bench = parse_model({"sample_time": 0.001, "mechanism": {"kind": "rotary", "parameters": {"inertia": 0.01}},
    ...                      "controller": {"kind": "pd", "kp": 2.0, "kd": 0.1}})
    >>> rec = simulate_loop(bench, [0.5], seconds=1.0)
    >>> round(float(rec["plant_q"][-1]), 2)
    0.5
    """  # noqa: E501
    model = load_model(model) if not isinstance(model, Model) else model
    if not model.sample_time:
        raise ModelError(f"{model.name}: lacks sample_time, which a simulation needs")
    n = joint_count(model)
    r, feed, mode = _reference_rows(reference, n, model.sample_time)
    if command is not None:
        extra_rows = np.asarray(command, dtype=np.float64).reshape(-1, n)
        feed = extra_rows if feed is None else feed + _stretch(extra_rows, len(feed), hold=False)
    law = (
        controller
        if controller is not None
        else {} if reference is None and command is not None else model.controller
    )
    open_loop = (not callable(law) and not law) or mode == "torque"
    if open_loop and feed is None:
        raise ModelError(
            f"{model.name}: has no [controller] and no command was given: there is nothing to"
            " drive it"
        )
    rows = max(len(r) if r is not None else 1, len(feed) if feed is not None else 1)
    if seconds is not None:
        rows = max(1, round(seconds / model.sample_time))
    start = position if position is not None else (r[0] if r is not None else None)
    if start is not None and model.sensor.matrix:
        start = np.array(model.sensor.matrix) @ np.broadcast_to(
            np.asarray(start, dtype=np.float64), (n,)
        ) + np.array(model.sensor.offset or (0.0,))
    rr = _stretch(r if r is not None else np.zeros((1, n)), rows, hold=True)
    ff = _stretch(feed if feed is not None else np.zeros((1, n)), rows, hold=False)

    def run(steps: int) -> dict[str, Array]:
        plant = Plant(
            model, rows + 1, inner=steps, position=start, velocity=velocity, temperature=temperature
        )
        out = (
            _python_loop(plant, law, rr, ff)
            if callable(law)
            else _c_loop(plant, {} if open_loop else law, rr, ff)
        )
        return {**out, "command": plant.recorded_command(out["command"])}

    extra: dict[str, Any] = {"simulation": {"inner": inner, "model": model_text(model)}}
    if check:
        inner, extra["step_check"] = _converge(model, inner, lambda steps: run(steps)["q"])
        extra["simulation"]["inner"] = inner
    out = run(inner)
    if temperature is not None:
        warmth = np.atleast_1d(np.asarray(temperature, dtype=np.float64))[:, None]
        out["temperature"] = _stretch(warmth, len(out["measured"]), hold=True)
    return _recording(model, out, rr if r is not None else None, extra)


def _reference_rows(
    reference: Any, n: int, sample_time: float
) -> tuple[Array | None, Array | None, str]:
    if reference is None:
        return None, None, ""
    if isinstance(reference, str | Path):
        reference = load_reference(reference)
    if isinstance(reference, Reference):
        if reference.joints != n:
            raise ModelError(f"the model has {n} joints, the reference {reference.joints}")
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


def _stretch(rows: Array, count: int, *, hold: bool) -> Array:
    """Exactly ``count`` rows: cut, or continued by the last row (hold) or by zeros."""
    out = np.zeros((count, rows.shape[1]))
    kept = min(count, len(rows))
    out[:kept] = rows[:kept]
    if hold:
        out[kept:] = rows[-1]
    return out


def _gains(law: Mapping[str, Any], key: str, n: int) -> Array:
    return np.ascontiguousarray(
        np.broadcast_to(np.asarray(law.get(key, 0.0), dtype=np.float64), (n,))
    )


def _c_loop(plant: Plant, law: Mapping[str, Any], r: Array, ff: Array) -> dict[str, Array]:
    if law and law.get("kind", "pd") not in ("pd", "pid"):
        raise ModelError(
            f"[controller] kind = {law.get('kind')!r}: expected \"pd\", or give a function (t, r,"
            " y) -> command"
        )
    n, d = plant.joints, plant.native.doubles
    out = {name: np.zeros_like(r) for name in ("measured", "command", "q", "qd", "torque")}
    limit = (
        np.array([plant.config.limit[j] for j in range(n)])
        if not plant.model.actuator.matrix
        else np.zeros(n)
    )
    r, ff = np.ascontiguousarray(r), np.ascontiguousarray(ff)
    gains = [_gains(law, key, n) for key in ("kp", "kd", "ki")]
    done = plant.native.lib.sim_loop(
        plant.pointer,
        len(r),
        d(r),
        d(ff),
        *(d(g) for g in gains),
        float(law.get("cutoff", 0.0)),
        d(limit),
        *(d(out[name]) for name in ("measured", "command", "q", "qd", "torque")),
    )
    return {name: values[:done] for name, values in out.items()}


def _python_loop(plant: Plant, law: Controller, r: Array, ff: Array) -> dict[str, Array]:
    rows: dict[str, list[Array]] = {
        name: [] for name in ("measured", "command", "q", "qd", "torque")
    }
    for k in range(len(r)):
        y = plant.measure()
        q, qd, _ = plant.truth()
        u = (
            np.broadcast_to(
                np.asarray(law(k * plant.period, r[k], y), dtype=np.float64), (plant.joints,)
            )
            + ff[k]
        )
        going = plant.advance(u)
        for name, value in (
            ("measured", y),
            ("command", u),
            ("q", q),
            ("qd", qd),
            ("torque", plant.truth()[2]),
        ):
            rows[name].append(value)
        if not going:
            break
    return {name: np.array(values) for name, values in rows.items()}


def _recording(
    model: Model, out: dict[str, Array], r: Array | None, extra: dict[str, Any]
) -> Recording:
    linear = model.joint_kind(1) == "linear"
    unit, torque = ("m", "N") if linear else ("rad", "N m")
    columns: dict[str, Array] = {}
    units: dict[str, str] = {}

    def put(role: str, values: Array, unit: str) -> None:
        names = model.columns.get(role, role)
        if isinstance(names, list):
            for j, name in enumerate(names):
                columns[name], units[name] = values[:, j], unit
        else:
            columns[str(names)], units[str(names)] = (
                values if values.shape[1] > 1 else values[:, 0]
            ), unit

    put("position", out["measured"], unit)
    put("command", out["command"], model.actuator.unit or torque)
    if r is not None:
        put("reference", r[: len(out["measured"])], unit)
    if "temperature" in out:
        put("temperature", out["temperature"], "°C")
    for name, key, u in (
        ("plant_q", "q", unit),
        ("plant_qd", "qd", f"{unit}/s"),
        ("plant_torque", "torque", torque),
    ):
        columns[name], units[name] = out[key] if out[key].shape[1] > 1 else out[key][:, 0], u
    columns, units = gather_vectors(columns, units)
    rec = Recording.from_columns(
        columns,
        sample_time=model.sample_time,
        units=units,
        machine=model.name,
        target="simulation",
        extra=extra,
    )
    return replace(rec, created=time.time())
