"""Diagnoses on disk: one folder each, the report of ``zendsp diagnose --out`` with a card.

    diagnoses/20261120-061502-circle/
        diagnosis.json    name, model, recordings
        report.json …     docs/diagnosis.md
        *.chart.json      the numbers behind each figure
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import zip_longest
from pathlib import Path
from textwrap import wrap
from typing import Literal

from zendsp.diagnosis.decide.contract import FitReport, LeftReport, Report
from zendsp.diagnosis.decide.headline import percent
from zendsp.diagnosis.report.chart import SUFFIX, Chart, load_chart
from zendsp.tui.workspace import file_name
from zendsp_protocol import written

CARD = "diagnosis.json"
NEXT = "next_reference.mat"


@dataclass(frozen=True)
class Diagnosed:
    """One diagnosis: its card; its report is read when asked for."""

    folder: Path
    name: str
    created: float  # when it was begun, Unix s
    model: str
    recordings: tuple[str, ...]
    heldout: tuple[str, ...] = ()

    @cached_property
    def report(self) -> Report:
        """report.json of the contract."""
        report: Report = json.loads((self.folder / "report.json").read_text("utf-8"))
        return report

    @cached_property
    def charts(self) -> tuple[Chart, ...]:
        """Its figures as numbers, in the order of their names."""
        return tuple(load_chart(p) for p in sorted(self.folder.glob(f"*{SUFFIX}")))

    @property
    def written(self) -> bool:
        """Whether its report is there. The page report.html comes later, after the figures."""
        return (self.folder / "report.json").is_file()

    @property
    def when(self) -> str:
        """Day and time, as a list shows them."""
        return time.strftime("%m-%d %H:%M:%S", time.localtime(self.created))

    @property
    def page(self) -> Path:
        """The report to be read in a browser."""
        return self.folder / "report.html"

    @property
    def next_reference(self) -> Path | None:
        """The proposed motion, where one is proposed."""
        path = self.folder / NEXT
        return path if path.is_file() and self.report["next_recording"] else None


def begin(root: Path, name: str) -> tuple[Path, Path]:
    """The folder in which a diagnosis is made, and the one that it becomes once it is complete."""
    stem = f"{time.strftime('%Y%m%d-%H%M%S')}-{file_name(name)}"
    folder, n = root / stem, 2
    while folder.exists():
        folder, n = root / f"{stem}-{n}", n + 1
    return root / f".{folder.name}.part", folder


def keep(made: Diagnosed, folder: Path) -> Diagnosed:
    """Write the card beside a report and move the folder to its place."""
    card = replace(made, folder=folder)
    values = {key: value for key, value in asdict(card).items() if key != "folder"}
    (made.folder / CARD).write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
    os.replace(made.folder, folder)
    return card


def list_diagnoses(root: Path) -> list[Diagnosed]:
    """The diagnoses, newest first; other folders are ignored."""
    found = []
    for path in root.glob(f"*/{CARD}"):
        try:
            card = written.json(path.read_text("utf-8"))
            for key in ("recordings", "heldout"):
                card[key] = tuple(card[key])
            one = Diagnosed(folder=path.parent, **card)
        except (OSError, TypeError, KeyError, ValueError):
            continue
        if one.written:
            found.append(one)
    return sorted(found, key=lambda d: d.created, reverse=True)


COLUMN = 24  # columns of each of two that are compared: both go into 80


def compare(one: Diagnosed, other: Diagnosed) -> str:
    """The differences of two diagnoses, the first on the left."""
    rows: list[tuple[str, str, str]] = [
        ("", one.name, other.name),
        ("made", one.when, other.when),
        ("model", Path(one.model).name, Path(other.model).name),
        ("recordings", _names(one), _names(other)),
        ("verdict", one.report["verdict"], other.report["verdict"]),
    ]
    left, right = _findings(one.report), _findings(other.report)
    for key in dict.fromkeys([*left, *right]):
        rows.append((key, left.get(key, "—"), right.get(key, "—")))
    for name, a, b in zip(("calibrated", "improved"), _errors(one), _errors(other), strict=True):
        rows.append((f"untouched, {name}", a, b))
    ours, theirs = ({x["joint"]: x for x in d.report["discrepancy"]} for d in (one, other))
    for joint in sorted({*ours, *theirs}):
        rows.append((f"left, joint {joint}", _left(ours.get(joint)), _left(theirs.get(joint))))
    lines = [
        cells
        for name, *both in rows
        for cells in zip_longest([name], *(wrap(x, COLUMN) for x in both), fillvalue="")
    ]
    wide, middle = (max(len(cells[k]) for cells in lines) for k in range(2))
    return "\n".join(f"{a:{wide}}  {b:{middle}}  {c}" for a, b, c in lines)


def _names(d: Diagnosed) -> str:
    return ", ".join(recording_name(r) for r in d.recordings)


def recording_name(path: str) -> str:
    """The name by which a person knows a recording: that of a run's folder, or of the file."""
    file = Path(path)
    return file.parent.name if file.name == "recording.mat" else file.name


def _findings(report: Report) -> dict[str, str]:
    found = {}
    for f in report["findings"]:
        values = ", ".join(
            f"{n} {p['value']:.3g}{'' if p['unit'] == '1' else ' ' + p['unit']}"
            for n, p in f["parameters"].items()
        )
        found[f"{f['effect']}, joint {f['joint']}"] = f"{values} ({100 * f['confidence']:.0f} %)"
    return found


def other_fits(report: Report) -> list[FitReport]:
    """The errors in the other unit, where some joints slide and others turn; none in an older
    report.
    """
    return report.get("fit_other_unit", [])


def _errors(d: Diagnosed) -> tuple[str, str]:
    """The errors of the calibrated and of the improved model on untouched recordings."""
    def said(of: Literal["calibrated", "improved"]) -> str:
        fits = (d.report["fit"], *other_fits(d.report))
        values = ((fit["test"][of], fit["unit"]) for fit in fits)
        return ", ".join("—" if x is None else f"{x:.3g} {unit}" for x, unit in values)

    return said("calibrated"), said("improved")


def _left(item: LeftReport | None) -> str:
    return "—" if item is None or item["share"] is None else percent(item["share"])
