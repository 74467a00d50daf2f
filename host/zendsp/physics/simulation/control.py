"""A controller of the model's, or one in Python, against the model of a machine."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import ModelError
from zendsp.physics.files.model_file import load_model
from zendsp.physics.files.model_write import model_text
from zendsp.physics.model import Model
from zendsp.physics.simulation.plant import INNER, Plant, joint_count
from zendsp.physics.simulation.run import (
    Controller,
    converge,
    recording,
    reference_rows,
    stretch,
)
from zendsp.recording import Recording
from zendsp.recording.notes import Extra
from zendsp.reference import Reference

Array = npt.NDArray[np.float64]


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
        Integration steps per sample, as for `simulate`.
    check : bool
        Halve the step until nothing changes, as for `simulate`.

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
    r, feed, mode = reference_rows(reference, model)
    if command is not None:
        extra_rows = np.asarray(command, dtype=np.float64).reshape(-1, n)
        feed = extra_rows if feed is None else feed + stretch(extra_rows, len(feed), hold=False)
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
    rr = stretch(r if r is not None else np.zeros((1, n)), rows, hold=True)
    ff = stretch(feed if feed is not None else np.zeros((1, n)), rows, hold=False)

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

    extra: Extra = {"simulation": {"inner": inner, "model": model_text(model)}}
    if check:
        inner, extra["step_check"] = converge(model, inner, lambda steps: run(steps)["q"])
        extra["simulation"]["inner"] = inner
    out = run(inner)
    if temperature is not None:
        warmth = np.atleast_1d(np.asarray(temperature, dtype=np.float64))[:, None]
        out["temperature"] = stretch(warmth, len(out["measured"]), hold=True)
    return recording(model, out, rr if r is not None else None, extra)


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
