"""The result of an experiment: values with their uncertainty, terms for a model file, tables,
warnings, recordings and a figure.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import tomli_w

from zendsp.errors import RecordingError
from zendsp.experiment.names import present_name
from zendsp.whole_file import write_whole, writing
from zendsp_protocol import written
from zendsp_protocol.spelling import unknown_keys
from zendsp_protocol.views import html_table, sentence, with_std

_KEYS = (
    "name", "title", "machine", "target", "figure", "findings", "warnings", "recordings", "values",
    "mechanism", "effect", "table",
)


Cell: TypeAlias = str | float | list[float]
Row: TypeAlias = Mapping[str, Cell]  # of a table: by the name of its column


@dataclass(frozen=True)
class Estimate:
    """A number, its standard deviation (0 where unknown) and its unit."""

    value: float
    std: float = 0.0
    unit: str = ""

    def __str__(self) -> str:
        return with_std(self.value, self.std, self.unit)


@dataclass(frozen=True)
class FoundEffect:
    """An effect of the library at one joint (1-based), with its parameters as measured."""

    kind: str
    joint: int
    parameters: Mapping[str, Estimate]

    def table(self) -> dict[str, Any]:
        """The ``[[effect]]`` table for a model file."""
        parameters = {name: _table(e) for name, e in self.parameters.items()}
        return {"kind": self.kind, "joint": self.joint, **parameters}


@dataclass(repr=False)
class Result:
    """One experiment's outcome.

    Attributes
    ----------
    name, title, machine : str
    values : dict of str to Estimate
    effects : list of FoundEffect
        That a model file can take in.
    mechanism : dict of str to Estimate
        ``[mechanism.parameters]`` that it can take in.
    tables : dict of str to list of Row
        For people; what is computed with is read by `number`.
    findings, warnings : list of str
        Sentences.
    recordings : list of str
        Files, relative to the result's own.
    figure : str
        File, relative to the result's own; "" where there is none.
    target : str
        Which target it was, and on which clock.
    """

    name: str
    title: str
    machine: str
    values: dict[str, Estimate] = field(default_factory=dict)
    effects: list[FoundEffect] = field(default_factory=list)
    mechanism: dict[str, Estimate] = field(default_factory=dict)
    tables: dict[str, list[Row]] = field(default_factory=dict)
    findings: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    recordings: list[str] = field(default_factory=list)
    figure: str = ""
    target: str = ""

    def __repr__(self) -> str:
        values = ", ".join(f"{name} {e}" for name, e in list(self.values.items())[:3])
        more = ", …" if len(self.values) > 3 else ""
        return f"<Result {self.name} on {self.machine}: {values}{more}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: what was found, every value, and what to be careful about."""
        said = "".join(sentence(text) for text in (self.title, *self.findings))
        rows = [(name, str(e)) for name, e in (self.values | self.mechanism).items()]
        careful = "".join(sentence(f"careful: {text}") for text in self.warnings)
        return said + html_table(("", "value"), rows) + careful

    def text(self) -> str:
        """The result as TOML."""
        data: dict[str, Any] = {
            key: getattr(self, key)
            for key in ("name", "title", "machine", "target", "figure")
            if getattr(self, key)
        }
        for key in ("findings", "warnings", "recordings"):
            if getattr(self, key):
                data[key] = getattr(self, key)
        data["values"] = {name: _table(e) for name, e in self.values.items()}
        if self.mechanism:
            data["mechanism"] = {name: _table(e) for name, e in self.mechanism.items()}
        if self.effects:
            data["effect"] = [effect.table() for effect in self.effects]
        if self.tables:
            data["table"] = _plain(self.tables)
        return tomli_w.dumps(data)

    def save(self, path: Path) -> Path:
        """Write it as TOML.

        Raises
        ------
        RecordingError
            It cannot be written there.
        """
        with writing(path):
            write_whole(path, self.text())
        return path

    @classmethod
    def load(cls, path: str | Path) -> Result:
        """Read a result file.

        Raises
        ------
        RecordingError
            Not a result file.
        """
        try:
            data = written.toml(Path(path).read_text(encoding="utf-8"))
            result = cls(present_name(data["name"]), data["title"], data["machine"])
            if said := _mistyped(data, str(path)):
                raise RecordingError(said)
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, KeyError) as error:
            raise RecordingError(f"{path}: is not the result of an experiment: {error}") from error
        result.values = {k: _estimate(v) for k, v in data.get("values", {}).items()}
        result.mechanism = {k: _estimate(v) for k, v in data.get("mechanism", {}).items()}
        result.effects = [_effect(row) for row in data.get("effect", [])]
        result.tables = data.get("table", {})
        for key in ("findings", "warnings", "recordings", "figure", "target"):
            setattr(result, key, data.get(key, getattr(result, key)))
        return result


def number(row: Row, name: str) -> float:
    """A cell that is a number."""
    cell = row[name]
    if not isinstance(cell, int | float):
        raise RecordingError(f"{name}: {cell!r} is no number")
    return float(cell)


def _mistyped(data: Mapping[str, Any], where: str) -> str:
    """A sentence on keys that are not read. Keys of values, tables and effects are names, which may
    be any.
    """
    estimates = [
        (f"{where}: [{table}.{name}]", value)
        for table in ("values", "mechanism")
        for name, value in data.get(table, {}).items()
    ]
    for row in data.get("effect", []):
        estimates += [(f"{where}: effect {row.get('kind')}: {k}", v) for k, v in row.items()]
    said = [unknown_keys(data, _KEYS, f"{where}: the file")]
    said += [
        unknown_keys(value, tuple(Estimate.__dataclass_fields__), at)
        for at, value in estimates
        if isinstance(value, Mapping)
    ]
    return "\n".join(filter(None, said))


def _table(e: Estimate) -> dict[str, Any]:
    return {
        "value": float(e.value),
        **({"std": float(e.std)} if e.std > 0 else {}),
        **({"unit": e.unit} if e.unit else {}),
    }


def _effect(row: Mapping[str, Any]) -> FoundEffect:
    parameters = {
        name: _estimate(value if isinstance(value, Mapping) else {"value": value})
        for name, value in row.items()
        if name not in ("kind", "joint")
    }
    return FoundEffect(str(row["kind"]), int(row["joint"]), parameters)


def _estimate(data: Mapping[str, Any]) -> Estimate:
    return Estimate(float(data["value"]), float(data.get("std", 0.0)), str(data.get("unit", "")))


def _plain(value: Any) -> Any:
    """Numbers and containers in types that TOML has."""
    if isinstance(value, Estimate):
        return _table(value)
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return value.item() if hasattr(value, "item") else value
