"""The text of a model file: what `load_model` reads again."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import tomli_w

from zendsp.physics.model import Model, Quantity, Term
from zendsp.physics.term_numbers import chosen


def _number(value: float) -> float:
    return float(f"{value:.10g}")


def _quantity(items: tuple[Quantity, ...]) -> dict[str, Any]:
    out: dict[str, Any] = {
        "value": _number(items[0].value) if len(items) == 1 else [_number(q.value) for q in items]
    }
    if not all(q.free for q in items):
        out["free"] = False
    stds = [_number(q.std) for q in items]
    if max(stds) > 0:
        out["std"] = stds[0] if len({*stds}) == 1 else stds
    if items[0].unit:
        out["unit"] = items[0].unit
    return out


def model_text(model: Model, *, beside: bool = False) -> str:
    """The model as TOML text that ``load_model`` reads back.

    Parameters
    ----------
    model : Model
    beside : bool
        The text goes beside the model's MJCF, as ``write_mjcf`` wrote it: what stands there is not
        said again.

    Returns
    -------
    str
    """
    data: dict[str, Any] = {"name": model.name}
    if model.sample_time:
        data["sample_time"] = model.sample_time
    data["mechanism"] = _mechanism_table(model, beside)
    if model.terms:
        data["effect"] = [_term_table(term) for term in model.terms]
    data["actuator"] = _actuator_table(model, beside)
    data["sensor"] = _sensor_table(model)
    for key, table in (
        ("controller", model.controller),
        ("columns", model.columns),
        ("limits", model.limits),
        ("discrepancy", _discrepancy_table(model)),
    ):
        if table:
            data[key] = dict(table)
    return tomli_w.dumps(data)


def _discrepancy_table(model: Model) -> dict[str, Any]:
    each = asdict(model.discrepancy)
    return {key: [float(f"{x:.3g}") for x in values] for key, values in each.items() if values}


def _mechanism_table(model: Model, beside: bool) -> dict[str, Any]:
    mechanism: dict[str, Any] = {"kind": model.kind}
    if model.file:
        mechanism["file"] = model.file if beside else str((model.folder / model.file).resolve())
    # all that counts stands in this file, the bodies aside
    if model.kind == "mjcf" and not beside:
        mechanism["take"] = "servos" if model.robot.servos else "bodies"
    if model.robot.joints:
        mechanism["joints"] = list(model.robot.joints)
    stated = asdict(model.fmu).items()
    mechanism |= {k: list(v) if isinstance(v, tuple) else v for k, v in stated if v}
    if model.entry:
        mechanism["entry"] = model.entry
        mechanism["folder"] = str(model.folder.resolve())
    mechanism["parameters"] = {key: _quantity(items) for key, items in model.mechanism.items()}
    return mechanism


def _term_table(term: Term) -> dict[str, Any]:
    row: dict[str, Any] = {"kind": term.effect, "joint": term.joint}
    plain = chosen(term)
    for name, quantity in term.parameters.items():
        row[name] = plain[name] if name in plain else _quantity((quantity,))
    return row


def _actuator_table(model: Model, beside: bool) -> dict[str, Any]:
    a = model.actuator
    gain: Any = _number(a.gain[0]) if len(a.gain) == 1 else [_number(g) for g in a.gain]
    stated: dict[str, Any] = {"value": gain, "free": a.gain_free}
    if a.gain_std:
        stds = [_number(s) for s in a.gain_std]
        stated["std"] = stds[0] if len(stds) == 1 else stds
    actuator: dict[str, Any] = {"gain": stated, "delay": a.delay}
    if beside and not model.robot.commands:
        del actuator["gain"]
    if a.limit:
        actuator["limit"] = a.limit[0] if len(a.limit) == 1 else list(a.limit)
    if a.hold is not None:
        actuator["hold"] = a.hold
    if a.matrix:
        actuator["matrix"] = [list(row) for row in a.matrix]
    if a.unit:
        actuator["unit"] = a.unit
    return actuator


def _sensor_table(model: Model) -> dict[str, Any]:
    s = model.sensor
    sensor: dict[str, Any] = {"side": s.side}
    if s.resolution:
        sensor["position_resolution"] = (
            s.resolution[0] if len(s.resolution) == 1 else list(s.resolution)
        )
    if s.matrix:
        sensor["matrix"] = [list(row) for row in s.matrix]
    if s.offset:
        sensor["offset"] = list(s.offset)
    return sensor
