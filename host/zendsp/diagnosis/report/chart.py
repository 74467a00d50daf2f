"""The figures of a report as numbers, drawn as pictures in the page and as braille in the terminal.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp_protocol import written

Array = npt.NDArray[np.floating[Any]]
SUFFIX = ".chart.json"
DIGITS = 6  # of each number in a file: finer than any screen or page


@dataclass(frozen=True)
class Series:
    """Points of one curve.

    ``kind``: "line", "dots", "means" (with their spread) or "bars" (each as wide as its spread).
    ``role`` chooses the colour: "before", "after", "data", "law" or "floor".
    """

    kind: str
    role: str
    x: Array
    y: Array
    label: str = ""
    spread: Array | None = None


@dataclass(frozen=True)
class Mesh:
    """A value for each cell of a plane; NaN where there is none."""

    x: Array  # edges
    y: Array  # edges
    values: Array  # (len(y) - 1, len(x) - 1)
    label: str


@dataclass(frozen=True)
class Panel:
    """One pair of axes."""

    xlabel: str
    ylabel: str
    series: tuple[Series, ...] = ()
    title: str = ""
    log: bool = False  # of y
    limits: tuple[float, float] | None = None  # of y
    level: tuple[float, str] | None = None  # a broken line across, with its label
    band: tuple[float, float] | None = None  # of y, shaded
    spans: tuple[tuple[float, float], ...] = ()  # of x, shaded
    mesh: Mesh | None = None
    clock: bool = False  # x is the time of one recording, by its own clock


@dataclass(frozen=True)
class Chart:
    """One figure: where it belongs in the report, and its axes."""

    section: str  # "fit", "law", "where" or "white"
    caption: str
    name: str  # of its files, without suffix
    panels: tuple[Panel, ...]
    title: str = ""
    beside: bool = False  # panels stand side by side, else over one another
    same: bool = False  # panels share both axes; panels over one another always share x
    ratio: tuple[float, ...] = ()  # of the panels' heights or widths
    size: tuple[float, float] = (7.2, 3.0)  # inch
    finding: int = -1  # index of the finding that it shows, or -1
    joint: int = 0
    note: str = ""  # a sentence below it


def save_chart(chart: Chart, folder: Path) -> Path:
    """Write the numbers of a chart as JSON, beside its picture."""
    path = folder / f"{chart.name}{SUFFIX}"
    path.write_text(json.dumps(_plain(chart), ensure_ascii=False), encoding="utf-8")
    return path


def load_chart(path: Path) -> Chart:
    """Read what :func:`save_chart` wrote.

    Raises
    ------
    ValueError
        The file holds no chart.
    """
    try:
        raw = written.json(path.read_text(encoding="utf-8"))
        panels = tuple(_panel(p) for p in raw.pop("panels"))
        for name in ("ratio", "size"):
            raw[name] = tuple(raw[name])
        return Chart(panels=panels, **raw)
    except (OSError, KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{path.name} holds no chart: {error}") from error


def _panel(raw: dict[str, Any]) -> Panel:
    series = tuple(
        Series(
            s["kind"],
            s["role"],
            _array(s["x"]),
            _array(s["y"]),
            s["label"],
            None if s["spread"] is None else _array(s["spread"]),
        )
        for s in raw.pop("series")
    )
    mesh = raw.pop("mesh")
    if mesh is not None:
        mesh = Mesh(_array(mesh["x"]), _array(mesh["y"]), _array(mesh["values"]), mesh["label"])
    for name in ("limits", "level", "band"):
        raw[name] = None if raw[name] is None else tuple(raw[name])
    raw["spans"] = tuple((a, b) for a, b in raw["spans"])
    return Panel(series=series, mesh=mesh, **raw)


def _array(raw: Any) -> Array:
    return np.array(raw, dtype=np.float64)  # null becomes NaN


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        rows = value if value.ndim > 1 else value.tolist()
        return [_plain(v) for v in rows] if value.ndim > 1 else [_number(v) for v in rows]
    if isinstance(value, float | np.floating):
        return _number(float(value))
    if isinstance(value, tuple):
        return [_plain(v) for v in value]
    if hasattr(value, "__dataclass_fields__"):
        return {name: _plain(getattr(value, name)) for name in value.__dataclass_fields__}
    return value


def _number(value: float) -> float | None:
    return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
