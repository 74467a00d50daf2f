"""An unknown key is refused in every table of every file that a user writes, and so is a hostile
text.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import tomli_w

from zendsp.errors import ZendspError
from zendsp.experiment.result import Result
from zendsp.link.parameters import ParameterSet
from zendsp.physics.effects import library
from zendsp.physics.files.model_file import KEYS, parse_model
from zendsp.physics.model import KINDS, PARAMETERS
from zendsp.reference.machine import load_machine
from zendsp.tui.scope.layouts import load_layout
from zendsp_protocol import written
from zendsp_target.access.lists import read_roles
from zendsp_target.concealed.load import load_concealed

Read = Callable[[Any, Path], Any]
ROOT = Path(__file__).resolve().parents[2]
ESTIMATE = {"value": 0.5, "std": 0.1, "unit": "N m"}
QUANTITY = {"value": 0.5, "free": False, "unit": "", "std": 0.1}


def _effect(name: str) -> dict[str, Any]:
    """A table [[effect]] with all that it may have."""
    table: dict[str, Any] = {"kind": name, "joint": 1}
    for p in library()[name].parameters:
        value = {"from_joint": 1.0, "law": 2.0}.get(
            p.name, p.default if p.default is not None else max(p.lower, min(p.upper, 0.5))
        )
        table[p.name] = QUANTITY | {"value": value}
    return table


def _model(kind: str) -> dict[str, Any]:
    """A model file with every table that the reader knows, and every parameter of this kind."""
    plain: dict[str, Any] = {
        "actuator": {"gain": QUANTITY, "limit": [1.0], "delay": 0.0, "unit": "V"},
        "controller": {"kp": 1.0},
        "sensor": {"side": "motor"},
        "columns": {"position": "q"},
        "limits": {"position": [-1.0, 1.0]},
        "discrepancy": {"torque": [0.01]},
        "effect": [_effect(name) for name in library()],
    }
    parameters = {name: dict(QUANTITY) for name in PARAMETERS[kind] or ()}
    if kind == "planar2r":  # whose masses have to be positive
        parameters["p1"]["value"] = 5.0
    return {"name": "m", "mechanism": {"kind": kind, "parameters": parameters}, **plain}


def _machine(name: str) -> dict[str, Any]:
    path = ROOT / "host" / "zendsp" / "reference" / "machines" / f"{name}.toml"
    return dict(written.toml(path.read_text(encoding="utf-8")))


def _bare() -> dict[str, Any]:
    """A machine of which only the limits are known."""
    known = _machine("imi_planar") | {"kind": "limits"}
    del known["parameters"]
    return known


def _saved(read: Callable[[str], Any], name: str) -> Read:
    """A reader of a file, for what stands in it, or for a text."""

    def reader(data: Any, folder: Path) -> Any:
        path = folder / name
        text = json.dumps(data) if name.endswith("json") else ""
        path.write_text(data if isinstance(data, str) else text or tomli_w.dumps(data))
        return read(str(path))

    return reader


_load_machine = _saved(load_machine.__wrapped__, "machine.toml")
CONCEALED = {
    "friction": "full", "effect": [{"kind": "viscous", "joint": 1, "coefficient": dict(QUANTITY)}]
}
LAYOUT = {
    "zendsp_layout": 1, "channels": [{"name": "q1", "unit": "rad", "formula": ""}],
    "settings": {"window": 2.0, "scales": {"q1": {"lane": 2, "low": -1.0, "high": 1.0}}},
}
RESULT = {
    "name": "friction", "title": "t", "machine": "m", "findings": [], "recordings": [],
    "values": {"level": dict(ESTIMATE)}, "mechanism": {"p1": dict(ESTIMATE)},
    "effect": [{"kind": "coulomb", "joint": 1, "level": dict(ESTIMATE)}],
}
SET = {"zendsp_parameters": 1, "program": "p", "target": "t", "note": "", "values": {"Kp1": 1.0}}
FILES: dict[str, tuple[dict[str, Any], Read]] = {
    **{
        f"model {kind}": (_model(kind), lambda data, _: parse_model(data, "bench.toml"))
        for kind in KINDS
        if PARAMETERS[kind]
    },
    **{
        f"machine {name}": (_machine(name), _load_machine)
        for name in ("imi_planar", "pendulum", "wam7")
    },
    "machine limits": (_bare(), _load_machine),
    "roles": ({"roles": {"anna": "tune"}}, _saved(read_roles, "roles.toml")),
    "concealed": (
        CONCEALED, _saved(lambda path: load_concealed(path, "imi_planar"), "concealed.toml")
    ),
    "parameters": (SET, _saved(ParameterSet.load, "set.json")),
    "layout": (LAYOUT, _saved(lambda path: load_layout(Path(path)), "layout.json")),
    "result": (RESULT, _saved(Result.load, "result.toml")),
}
# whose keys are names that the user gives
OWN = {
    ("roles", "roles"), ("parameters", "values"), ("layout", "settings", "scales"),
    ("result", "values"), ("result", "mechanism"), ("result", "effect", "0"),
}


def _tables(data: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where each table stands."""
    if isinstance(data, Mapping):
        yield at
    items = data.items() if isinstance(data, Mapping) else enumerate(data)
    for key, value in items:
        if isinstance(value, Mapping | list):
            yield from _tables(value, (*at, key))


def _misspelt(key: str) -> str:
    """Its last two letters the other way round, or the last one twice."""
    swapped = key[:-2] + key[-1] + key[-2:-1]
    return swapped if len(key) > 3 and swapped != key else key + key[-1]


@pytest.mark.parametrize("name", list(FILES))
def test_a_mistyped_key_is_refused_in_every_table(name: str, tmp_path: Path) -> None:
    whole, read = FILES[name]
    read(whole, tmp_path)
    taken = []
    for place in _tables(whole):
        if (name, *map(str, place)) in OWN:
            continue
        table: Any = whole
        for step in place:
            table = table[step]
        for key in table:
            other = copy.deepcopy(whole)
            there: Any = other
            for step in place:
                there = there[step]
            there[_misspelt(key)] = there[key]
            try:
                read(other, tmp_path)
            except ZendspError as error:
                if f"'{_misspelt(key)}'; did you mean " not in str(error):
                    taken.append(f"{place} {_misspelt(key)}: {error}")
            else:
                taken.append(f"{place} {_misspelt(key)}: accepted")
    assert not taken, "\n".join(taken)


@pytest.mark.parametrize("name", [name for name in FILES if not name.startswith("model ")])
@pytest.mark.parametrize("hostile", ["[" * 20_000 + "]" * 20_000, "9" * 20_000])
def test_a_text_that_no_reader_bears_is_refused(hostile: str, name: str, tmp_path: Path) -> None:
    whole, read = FILES[name]
    read(whole, tmp_path)
    (path,) = tmp_path.iterdir()
    text = f'{{"a": {hostile}}}' if path.suffix == ".json" else f"a = {hostile}\n"
    with pytest.raises(ZendspError, match=r"too deeply|4300 digits"):
        read(text, tmp_path)


def test_a_machine_without_a_model_has_no_parameters_and_a_kind_is_one_of_those_known(
    tmp_path: Path,
) -> None:
    with pytest.raises(ZendspError, match="no key 'parameters'"):
        _load_machine(_machine("imi_planar") | {"kind": "limits"}, tmp_path)
    with pytest.raises(ZendspError, match="'planr2r'; did you mean planar2r"):
        _load_machine(_machine("imi_planar") | {"kind": "planr2r"}, tmp_path)


def test_the_model_files_above_have_every_table_that_is_known() -> None:
    whole = _model("rotary")
    known = {key for key in KEYS if key} | {"effect"}
    assert known == {key for key, value in whole.items() if isinstance(value, dict | list)}
