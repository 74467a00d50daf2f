"""Reads model files (TOML). Where a key is wrong the error names it and what was expected."""

from __future__ import annotations

import math
import re
import sys
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from zendsp.errors import ModelError
from zendsp.physics.effects import get_effect, unit_of
from zendsp.physics.files.shipped import find_model
from zendsp.physics.model import (
    KINDS,
    PARAMETERS,
    REQUIRED,
    TREES,
    Actuator,
    ControllerTable,
    Discrepancy,
    FmuPorts,
    LimitsTable,
    Model,
    Quantity,
    Robot,
    Sensor,
    Term,
)
from zendsp.physics.robots.rigid import links_inertia
from zendsp.physics.robots.robot import joint_kinds, stated
from zendsp.recording.units import AS_WRITTEN, dimension, not_known, to_si
from zendsp_protocol import written
from zendsp_protocol.spelling import unknown_keys

OF_TREES = ("joints",)
OF_MJCF = ("take",)
OF_FMU = ("inputs", "outputs", "start_position", "start_velocity", "time_limit")
KEYS = {  # of each table, whether this version uses the value or only knows it
    "": (
        "name", "sample_time", "mechanism", "effect", "actuator", "sensor", "controller",
        "columns", "limits", "discrepancy",
    ),
    "mechanism": ("kind", "parameters", "file", "entry", "folder", *OF_TREES, *OF_MJCF, *OF_FMU),
    "actuator": ("gain", "limit", "hold", "delay", "matrix", "unit"),
    "sensor": ("position_resolution", "matrix", "offset", "side"),
    "controller": ("kind", "kp", "kd", "ki", "cutoff"),
    "columns": (
        "time", "position", "command", "reference", "velocity", "current", "temperature",
        "position_load", "torque_measured",
    ),
    "limits": ("position",),
    "discrepancy": ("torque", "state"),
}
NEEDED = {"urdf": "file", "mjcf": "file", "fmu": "file", "python": "entry"}
NAMED = {".xml": "mjcf", ".mjcf": "mjcf", ".urdf": "urdf", ".fmu": "fmu"}  # by their suffix
TAKE = ("all", "bodies", "servos")  # of an MJCF
QUANTITY = ("value", "free", "unit", "std")
UNIT_OF = {  # of numbers of a mechanism; of others any known one is taken
    ("rotary", "inertia"): "kg m^2", ("rotary", "gravity"): "N m", ("linear", "mass"): "kg",
    **dict.fromkeys((("planar2r", key) for key in ("p1", "p2", "p3")), "kg m^2"),
    ("planar2r", "l1"): "m", ("planar2r", "l2"): "m",
}  # fmt: skip


class _Reader:
    def __init__(self, path: str) -> None:
        self.path = path
        self.command_unit = ""

    def fail(self, key: str, expected: str, got: Any) -> ModelError:
        return ModelError(f"{self.path}: {key} = {got!r}: expected {expected}")

    def table(self, data: Mapping[str, Any], key: str) -> Mapping[str, Any]:
        value = data.get(key, {})
        if not isinstance(value, Mapping):
            raise self.fail(f"[{key}]", "a table", value)
        return value

    def only(self, data: Mapping[str, Any], allowed: Collection[str], where: str) -> None:
        """Refuse keys that nobody would read."""
        if said := unknown_keys(data, allowed, f"{self.path}: {where}"):
            raise ModelError(said)

    def number(self, key: str, value: Any, positive: bool = False) -> float:
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not abs(value) <= sys.float_info.max  # a whole number may be larger
        ):
            raise self.fail(key, "a finite number", value)
        if positive and value <= 0:
            raise self.fail(key, "a number above 0", value)
        return float(value)

    def numbers(self, key: str, value: Any, least: float = -math.inf) -> tuple[float, ...]:
        items = value if isinstance(value, list) else [value]
        numbers = tuple(self.number(key, item) for item in items)
        if not numbers or min(numbers) < least:
            raise self.fail(
                key, f"numbers of at least {least:g}" if numbers else "at least one number", value
            )
        return numbers

    def matrix(self, key: str, value: Any) -> tuple[tuple[float, ...], ...]:
        if not isinstance(value, list) or not all(isinstance(row, list) for row in value):
            raise self.fail(key, "a list of rows", value)
        rows = tuple(self.numbers(key, row) for row in value)
        if len({len(row) for row in rows}) != 1 or len(rows) != len(rows[0]):
            raise self.fail(key, "a square matrix", value)
        return rows

    def quantities(self, key: str, value: Any, wanted: str = "") -> tuple[Quantity, ...]:
        """Numbers with their unit, of the same kind as the ``wanted`` one where that is known."""
        table = value if isinstance(value, Mapping) else {"value": value}
        self.only(table, QUANTITY, key)
        if "value" not in table:
            raise self.fail(key, "{ value = … }", value)
        free = table.get("free", True)
        if not isinstance(free, bool):
            raise self.fail(f"{key}.free", "true or false", free)
        values = self.numbers(f"{key}.value", table["value"])
        stds = self.numbers(f"{key}.std", table.get("std", 0.0), 0.0)
        if len(stds) not in (1, len(values)):
            raise self.fail(f"{key}.std", f"one number, or {len(values)} as of value", table["std"])
        stds = stds * len(values) if len(stds) == 1 else stds
        written = str(table.get("unit", ""))
        factor, unit = self.to_si(key, written)
        kind, own = dimension(written), dimension(wanted)
        if written and wanted and unit != self.command_unit and None not in (kind, own):
            beside = self.command_unit and self.command_unit in written
            if kind != own and not beside and written not in AS_WRITTEN:
                raise self.fail(f"{key}.unit", f"{wanted}, or another unit of its kind", written)
        both = zip(values, stds, strict=True)
        return tuple(Quantity(v * factor, free, unit, s * factor) for v, s in both)

    def to_si(self, key: str, unit: str) -> tuple[float, str]:
        """Factor and SI unit; the unit of the command may be any, and is left."""
        own = re.escape(self.command_unit)
        if not unit or (own and re.search(rf"(?<![^\W\d_]){own}(?![^\W\d_])", unit)):
            return 1.0, unit
        known = to_si(unit)
        if known is None:
            raise ModelError(
                f"{self.path}: {key}: {not_known(unit)}. Write one of them, and the value in it; or"
                " none, and the value in SI units"
            )
        return known


def load_model(path: str | Path) -> Model:
    """Read a model file.

    Parameters
    ----------
    path : str or Path
        A TOML file as in docs/models.md, or the name of one that comes with zendsp.

    Returns
    -------
    Model

    Raises
    ------
    ModelError
        Where the file cannot be read or a key is not what the contract says; the message names the
        key.
    """
    path = find_model(path)
    try:
        data = written.toml(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError as error:
        raise ModelError(f"{path}: is not TOML: {error}{_named_in_one(path)}") from error
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise ModelError(f"{path}: is not TOML: {error}{_named_in_one(path)}") from error
    return parse_model(data, str(path))


def _named_in_one(path: Path) -> str:
    """What to do with a file that a model file names."""
    kind = NAMED.get(path.suffix.lower())
    if kind is None:
        return ""
    return (
        f'; a model file names it: [mechanism] kind = "{kind}", file = "{path.name}"'
        " ('zendsp model new RECORDING' begins one)"
    )


def parse_model(data: Mapping[str, Any], path: str = "model") -> Model:
    """Turn the contents of a model file into a Model; see ``load_model``.

    Parameters
    ----------
    data : mapping
        What the TOML file holds.
    path : str
        Of the file: named in errors, and its folder is where a URDF or a Python simulator is looked
        for.

    Returns
    -------
    Model

    Raises
    ------
    ModelError
        Which key, what was expected, what stands there.
    """
    read = _Reader(path)
    _check_keys(read, data)
    read.command_unit = str(read.table(data, "actuator").get("unit", ""))
    mechanism = read.table(data, "mechanism")
    kind, values = _mechanism(read, mechanism, path)
    # of the URDF or the Python module
    folder = Path(path).parent / str(mechanism.get("folder", ""))
    sample_time = data.get("sample_time")
    model = Model(
        name=str(data.get("name", Path(path).stem)),
        sample_time=(
            None if sample_time is None else read.number("sample_time", sample_time, positive=True)
        ),
        kind=kind,
        mechanism=values,
        actuator=_actuator(read, read.table(data, "actuator")),
        sensor=_sensor(read, read.table(data, "sensor")),
        controller=cast(ControllerTable, dict(read.table(data, "controller"))),
        columns=dict(read.table(data, "columns")),
        file=str(mechanism.get("file", "")),
        entry=str(mechanism.get("entry", "")),
        limits=_limits(read, read.table(data, "limits")),
        discrepancy=_discrepancy(read, read.table(data, "discrepancy")),
        folder=folder,
        fmu=_fmu(read, mechanism),
    )
    own: tuple[Term, ...] = ()
    robot = _robot(read, mechanism, "gain" in read.table(data, "actuator"))
    if kind == "urdf":
        model = replace(model, robot=Robot(robot.joints))
    if kind == "mjcf":
        own, actuator, robot = stated(replace(model, robot=robot), robot)
        model = replace(model, actuator=actuator, robot=robot)
    model = replace(model, joint_kinds=joint_kinds(model))
    effects = data.get("effect", [])
    if not isinstance(effects, list):
        raise read.fail("[[effect]]", "an array of tables", effects)
    return model.with_terms((*own, *(_term(read, item, model) for item in effects)))


def _check_keys(read: _Reader, data: Mapping[str, Any]) -> None:
    """Refuse keys that no model file has, and columns that are no names."""
    read.only(data, KEYS[""], "the file")
    arm = read.table(data, "mechanism")
    keys = {*arm, *read.table(arm, "parameters")}
    if arm.get("kind") in TREES and (theirs := {"inertia", "gravity", "mass"} & keys):
        raise ModelError(
            f"{read.path}: [mechanism] {min(theirs)}: of kind {arm['kind']!r} that stands in"
            f" {arm.get('file', 'its file')!r}: take the line away"
        )
    for key, allowed in KEYS.items():
        if key:
            read.only(read.table(data, key), allowed, f"[{key}]")
    for key, column in read.table(data, "columns").items():
        if not isinstance(column, str) and not (
            isinstance(column, list) and all(isinstance(name, str) for name in column)
        ):
            raise read.fail(f"[columns] {key}", "the name of a column, or a list of names", column)


def _mechanism(
    read: _Reader, mechanism: Mapping[str, Any], path: str
) -> tuple[str, dict[str, tuple[Quantity, ...]]]:
    """Kind and parameters of a mechanism, with all that its kind needs."""
    kind = mechanism.get("kind")
    if kind not in KINDS:
        raise read.fail("[mechanism] kind", " | ".join(KINDS), kind)
    for key, needed in NEEDED.items():
        if kind == key and not isinstance(mechanism.get(needed), str):
            raise read.fail(f"[mechanism] {needed}", "a string", mechanism.get(needed))
    parameters = read.table(mechanism, "parameters")
    known = PARAMETERS[kind]
    if known is not None:
        read.only(parameters, known, f"[mechanism.parameters] of kind {kind!r}")
    for owners, keys in ((TREES, OF_TREES), (("mjcf",), OF_MJCF), (("fmu",), OF_FMU)):
        for key in keys:
            if key in mechanism and kind not in owners:
                owner = " or ".join(map(repr, owners))
                raise ModelError(
                    f"{path}: [mechanism] {key} belongs to kind = {owner}, not {kind!r}"
                )
    values = {
        key: read.quantities(f"[mechanism.parameters] {key}", value, UNIT_OF.get((kind, key), ""))
        for key, value in parameters.items()
    }
    for key in REQUIRED[kind]:
        if key not in values:
            raise ModelError(
                f"{path}: [mechanism.parameters] lacks {key!r}, which kind = {kind!r} needs"
            )
        if key in ("inertia", "mass", "p1", "p2") and any(q.value <= 0 for q in values[key]):
            raise read.fail(
                f"[mechanism.parameters] {key}", "a number above 0", values[key][0].value
            )
    if kind == "planar2r":
        _check_masses(path, *(values[key][0].value for key in ("p1", "p2", "p3")))
    return kind, values


def _check_masses(path: str, p1: float, p2: float, p3: float) -> None:
    """Refuse a planar arm whose mass matrix [[p1 + 2 p3 c, p2 + p3 c], [·, p2]] is not positive at
    some angle: p1 is the inertia of both links about the first axis, p2 of the second about its
    own.
    """
    if (p1 - p2) * p2 <= p3**2:
        raise ModelError(
            f"{path}: [mechanism.parameters] p1 = {p1:.4g}, p2 = {p2:.4g} and p3 = {p3:.4g} kg m²"
            f" are no arm: its mass matrix is positive where (p1 - p2) p2 ="
            f" {(p1 - p2) * p2:.4g} exceeds p3² = {p3**2:.4g}. A unit?"
        )


def _fmu(read: _Reader, mechanism: Mapping[str, Any]) -> FmuPorts:
    ports: dict[str, tuple[str, ...]] = {}
    for key in OF_FMU:
        if key not in mechanism or key == "time_limit":
            continue
        value = mechanism[key]
        names = [value] if isinstance(value, str) else value
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise read.fail(f"[mechanism] {key}", "a variable's name, or a list of names", value)
        ports[key] = tuple(names)
    limit = mechanism.get("time_limit")
    seconds = 0.0
    if limit is not None:
        seconds = read.number("[mechanism] time_limit", limit, positive=True)
    return FmuPorts(**ports, time_limit=seconds)


def _robot(read: _Reader, mechanism: Mapping[str, Any], commands: bool) -> Robot:
    names = mechanism.get("joints", [])
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise read.fail("[mechanism] joints", "a list of names", names)
    take = mechanism.get("take", "all")
    if take not in TAKE:
        raise read.fail("[mechanism] take", " | ".join(TAKE), take)
    return Robot(tuple(names), take, commands)


def _limits(read: _Reader, table: Mapping[str, Any]) -> LimitsTable:
    """``position``: [low, high] for every joint, or a pair a joint."""
    if "position" in table:
        value = table["position"]
        several = isinstance(value, list) and bool(value) and isinstance(value[0], list)
        for pair in value if several else [value]:
            if len(read.numbers("[limits] position", pair)) != 2 or not pair[0] < pair[1]:
                raise read.fail("[limits] position", "[low, high], or one such pair a joint", value)
    return cast(LimitsTable, dict(table))


def _actuator(read: _Reader, data: Mapping[str, Any]) -> Actuator:
    gain = read.quantities("[actuator] gain", data.get("gain", {"value": 1.0, "free": False}))
    if any(q.value == 0 for q in gain):
        raise read.fail("[actuator] gain", "torque per unit of command, not 0", data["gain"])
    explicit = isinstance(data.get("gain"), Mapping) and data["gain"].get("free", False)
    return Actuator(
        gain=tuple(q.value for q in gain),
        gain_std=tuple(q.std for q in gain) if any(q.std for q in gain) else (),
        gain_free=bool(explicit),
        limit=read.numbers("[actuator] limit", data["limit"], least=0.0) if "limit" in data else (),
        hold=(
            read.number("[actuator] hold", data["hold"], positive=True) if "hold" in data else None
        ),
        delay=read.numbers("[actuator] delay", data.get("delay", 0.0), least=0.0)[0],
        matrix=read.matrix("[actuator] matrix", data["matrix"]) if "matrix" in data else (),
        unit=str(data.get("unit", "")),
    )


def _sensor(read: _Reader, data: Mapping[str, Any]) -> Sensor:
    side = data.get("side", "motor")
    if side not in ("motor", "load"):
        raise read.fail("[sensor] side", '"motor" or "load"', side)
    return Sensor(
        resolution=(
            read.numbers("[sensor] position_resolution", data["position_resolution"], least=0.0)
            if "position_resolution" in data
            else ()
        ),
        matrix=read.matrix("[sensor] matrix", data["matrix"]) if "matrix" in data else (),
        offset=read.numbers("[sensor] offset", data["offset"]) if "offset" in data else (),
        side=side,
    )


def _discrepancy(read: _Reader, data: Mapping[str, Any]) -> Discrepancy:
    return Discrepancy(
        *(
            read.numbers(f"[discrepancy] {key}", data[key], least=0.0) if key in data else ()
            for key in KEYS["discrepancy"]
        )
    )


def _with_links(data: Mapping[str, Any], model: Model, joint: int) -> Mapping[str, Any]:
    """An effect behind a transmission with the inertia of a robot's links, where it states none:
    all of them are then behind it.
    """
    needed = {p.name for p in get_effect(str(data["kind"])).parameters if p.default is None}
    if model.kind not in TREES or "load_inertia" not in needed:
        return data
    if {"load_inertia", "links_inertia"} & data.keys():
        return data
    links = links_inertia(model, joint)
    return {**data, "load_inertia": links, "links_inertia": links}


def _term(read: _Reader, data: Any, model: Model) -> Term:
    if not isinstance(data, Mapping) or "kind" not in data:
        raise read.fail("[[effect]]", 'a table with kind = "…"', data)
    effect = get_effect(str(data["kind"]))
    where = f"[[effect]] {effect.name}"
    read.only(data, ("kind", "joint", *(parameter.name for parameter in effect.parameters)), where)
    joint = data.get("joint", 1)
    if not isinstance(joint, int) or isinstance(joint, bool) or not 1 <= joint <= model.joints:
        raise read.fail(f"{where} joint", f"1 … {model.joints}", joint)
    data = _with_links(data, model, joint)
    values: dict[str, Quantity] = {}
    for parameter in effect.parameters:
        raw = data.get(parameter.name)
        if parameter.choices and isinstance(raw, str):
            if raw not in parameter.choices:
                raise read.fail(f"{where} {parameter.name}", " | ".join(parameter.choices), raw)
            raw = {"value": parameter.choices.index(raw), "free": False}
        if raw is None:
            if parameter.default is None:
                raise ModelError(
                    f"{read.path}: {where} lacks {parameter.name!r}: {parameter.meaning}"
                )
            values[parameter.name] = Quantity(parameter.default, free=False)
            continue
        # a current may stand for a torque: its unit is the command's, which may be any
        known = model.kind not in ("python", "fmu")  # of those nobody says whether a joint slides
        unit = unit_of(parameter.size, model.joint_kind(joint), model.actuator.unit)
        quantity = read.quantities(f"{where} {parameter.name}", raw, unit * known)[0]
        if not parameter.lower <= quantity.value <= parameter.upper:
            raise read.fail(
                f"{where} {parameter.name}",
                f"a number from {parameter.lower:g} to {parameter.upper:g}", quantity.value,
            )
        values[parameter.name] = (
            quantity if parameter.fitted else Quantity(quantity.value, False, quantity.unit)
        )
    return Term(effect.name, joint, values)
