"""Runs on disk: one folder each, with everything needed to repeat it.

    20261120-061502-circle/
        run.json          name, note, reference, phases, errors
        recording.mat     data, parameters, sources, flags, log, timing (zendsp.recording)
        reference.mat     what was played, where something was
        pd.c …            the sources, to be opened without any tool
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from zendsp.errors import RecordingError
from zendsp.recording import Recording
from zendsp.recording.files import rescue
from zendsp.recording.table import OF_RUN
from zendsp.tui.workspace import file_name
from zendsp_protocol import written

DATA, CARD = OF_RUN, "run.json"


class Outcome(StrEnum):
    """How a run ended; or, where no motion was played, what made the recording."""

    COMPLETE = "complete"
    ABORTED = "aborted"
    PAUSED = "paused by somebody"
    STOPPED = "stopped"
    TRIPPED = "tripped"
    CRASHED = "crashed"
    SIMULATED = "simulated"  # no machine has made it
    RESPONSE = "bode"  # its recording carries a frequency response


@dataclass(frozen=True)
class Run:
    """The card of a run; its data are loaded when asked for."""

    folder: Path
    name: str
    created: float  # Unix s
    machine: str = ""
    target: str = ""
    note: str = ""
    references: tuple[str, ...] = ()
    rows: int = 0
    seconds: float = 0.0
    lost: int = 0
    outcome: Outcome = Outcome.COMPLETE
    why: str = ""  # of a trip or a crash
    errors: Mapping[str, float] = field(default_factory=dict)  # rms of each error signal
    units: Mapping[str, str] = field(default_factory=dict)  # of these

    def rms(self, name: str, digits: int = 3) -> str:
        """One of the errors, with its unit where that is known."""
        return f"{self.errors[name]:.{digits}g} {self.units.get(name, '')}".rstrip()

    @property
    def worst(self) -> str:
        """The largest of the errors, with its name and unit; empty where there are none."""
        name = max(self.errors, key=lambda n: self.errors[n], default="")
        return f"{self.rms(name, 2)} {name}" if name else ""

    @property
    def ending(self) -> str:
        """The outcome and its reason."""
        return f"{self.outcome}: {self.why}" if self.why else str(self.outcome)

    def recording(self) -> Recording:
        """Load the data."""
        return Recording.load(self.folder / DATA)


def error_figures(recording: Recording) -> dict[str, float]:
    """The root mean square of every column that is an error by its name: e, e1, e[0], error …"""
    figures = {}
    for k, name in enumerate(recording.columns):
        stem = name.split("[")[0].rstrip("0123456789")
        if stem in ("e", "err", "error"):
            column = recording.data[:, k]
            figures[name] = (
                float(np.sqrt(np.mean(column * column))) if len(column) else float("nan")
            )
    return figures


def store_run(
    runs: Path,
    name: str,
    recording: Recording,
    *,
    references: Sequence[Path] = (),
    sources: Mapping[str, str] | None = None,
    outcome: Outcome = Outcome.COMPLETE,
    why: str = "",
) -> Run:
    """Store a run; its folder appears complete or not at all.

    Raises
    ------
    RecordingError
        It cannot be written there; the recording is elsewhere, and that is said.
    """
    created = time.time()
    stem = f"{time.strftime('%Y%m%d-%H%M%S', time.localtime(created))}-{file_name(name)}"
    folder = runs / stem
    n = 2
    while folder.exists():
        folder = runs / f"{stem}-{n}"
        n += 1
    beside = runs / f".{folder.name}.part"
    errors = error_figures(recording)
    run = Run(
        folder,
        name,
        created,
        recording.machine,
        recording.target,
        recording.note,
        tuple(path.name for path in references),
        len(recording),
        float(len(recording) * recording.sample_time),
        recording.lost,
        outcome,
        why,
        errors,
        {
            name: unit
            for name, unit in zip(recording.columns, recording.column_units, strict=True)
            if name in errors
        },
    )
    try:
        _write_run(beside, run, recording, references, recording.sources or sources or {})
        os.replace(beside, folder)
    except (OSError, RecordingError) as error:
        shutil.rmtree(beside, ignore_errors=True)
        elsewhere = rescue(recording, DATA)
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        kept = f"is lost: {error}" if elsewhere is None else f"is in {elsewhere}"
        raise RecordingError(  # where it is comes first: a narrow screen cuts the rest
            f"run {name!r} {kept}; it cannot be kept in {runs} ({reason})"
        ) from error
    return run


def _write_run(
    folder: Path,
    run: Run,
    recording: Recording,
    references: Sequence[Path],
    sources: Mapping[str, str],
) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    recording.save(folder / DATA)
    for name, text in sources.items():
        (folder / file_name(Path(name).name)).write_text(text)
    for path in references:
        shutil.copyfile(
            path, folder / ("reference.mat" if len(references) == 1 else file_name(path.name))
        )
    _write_card(folder, run)


def _write_card(folder: Path, run: Run) -> None:
    card = asdict(run) | {"outcome": run.ending}
    del card["folder"], card["why"]
    beside = folder / f"{CARD}.part"
    beside.write_text(json.dumps(card, indent=1) + "\n")
    os.replace(beside, folder / CARD)


def load_card(folder: Path) -> Run:
    """The card of one run; raises ValueError where the folder holds none."""
    try:
        card = written.json((folder / CARD).read_text())
        card["references"] = tuple(card.get("references", ()))
        outcome, _, why = card.pop("outcome", Outcome.COMPLETE).partition(": ")
        return Run(folder=folder, outcome=Outcome(outcome), why=why, **card)
    except (OSError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{folder.name} is not a run: {error}") from error


def list_runs(runs: Path) -> list[Run]:
    """The runs, newest first; other folders are ignored."""
    found = []
    if runs.is_dir():
        for folder in runs.iterdir():
            if folder.name.startswith(".") or not (folder / CARD).is_file():
                continue
            try:
                found.append(load_card(folder))
            except ValueError:
                continue
    return sorted(found, key=lambda run: run.created, reverse=True)


def rename_run(run: Run, name: str) -> Run:
    """Give a run another name. Its folder keeps its name, so that links to it stay valid."""
    renamed = replace(run, name=name)
    _write_card(run.folder, renamed)
    return renamed


def discard_run(run: Run) -> Path:
    """Move a run to the trash folder beside it; nothing is deleted."""
    trash = run.folder.parent / ".trash"
    trash.mkdir(exist_ok=True)
    place = trash / run.folder.name
    n = 2
    while place.exists():
        place = trash / f"{run.folder.name}-{n}"
        n += 1
    os.replace(run.folder, place)
    return place


def compare(runs: Sequence[Run]) -> str:
    """The differences between runs: errors, parameters, source."""
    import difflib

    recordings: list[Recording] = [run.recording() for run in runs]
    lines = [f"{'':14}" + "".join(f"{run.name[:18]:>20}" for run in runs)]
    for label, values in (
        ("seconds", [f"{r.seconds:.3f}" for r in runs]),
        ("rows lost", [str(r.lost) for r in runs]),
        ("outcome", [r.ending[:18] for r in runs]),
    ):
        lines.append(f"{label:14}" + "".join(f"{v:>20}" for v in values))
    for name in dict.fromkeys(n for run in runs for n in run.errors):
        cells = [run.rms(name, 4) if name in run.errors else "—" for run in runs]
        lines.append(f"{'rms ' + name:14}" + "".join(f"{c:>20}" for c in cells))
    lines.append("")
    different = _different_parameters(recordings)
    lines.append("parameters that differ:" if different else "parameters: the same")
    lines += [f"{name:14}" + "".join(f"{v:>20}" for v in values) for name, values in different]
    first = recordings[0]
    for run, other in zip(runs[1:], recordings[1:], strict=True):
        if other.source_hash == first.source_hash:
            lines.append(f"source of {run.name}: the same as {runs[0].name}")
            continue
        lines.append(f"source of {run.name} against {runs[0].name}:")
        for name in sorted(set(first.sources) | set(other.sources)):
            a = first.sources.get(name, "").splitlines()
            b = other.sources.get(name, "").splitlines()
            lines += list(
                difflib.unified_diff(
                    a, b, f"{runs[0].name}/{name}", f"{run.name}/{name}", lineterm="", n=1
                )
            )
    return "\n".join(lines)


def _different_parameters(recordings: Sequence[Recording]) -> list[tuple[str, list[str]]]:
    from zendsp.tui.values import differs, show_value

    rows = []
    for name in dict.fromkeys(n for r in recordings for n in r.parameters):
        values: list[Any] = [r.parameters.get(name) for r in recordings]
        if any(differs(values[0], v) for v in values[1:]):
            rows.append((name, ["—" if v is None else show_value(v, 2) for v in values]))
    return rows
