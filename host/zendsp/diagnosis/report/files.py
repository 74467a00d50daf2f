"""Writes the report folder: report.json, report.html, figures and their numbers, model.toml and
calibrated.toml, compensation.c, next_reference.mat.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from zendsp.diagnosis.decide.contract import Report
from zendsp.diagnosis.decide.moved import MOVED_NUMBERS
from zendsp.diagnosis.decide.result import Diagnosis
from zendsp.diagnosis.progress import Progress, Step
from zendsp.diagnosis.report.chart import SUFFIX, save_chart
from zendsp.diagnosis.report.figures import charts
from zendsp.diagnosis.report.laws import as_stated
from zendsp.physics.effects import get_effect, mechanism_of
from zendsp.physics.files.model_write import model_text
from zendsp.physics.model import Model

FILES = (  # of a report, beside its figures: they replace those of an earlier one
    "model.toml", "calibrated.toml", "model.mjcf", "compensation.c", "report.json", "report.html",
    "next_reference.mat",
)  # fmt: skip


def would_replace(folders: Iterable[Path], inputs: Iterable[Path]) -> Path | None:
    """The first of the files that a diagnosis reads which a report in one of the folders would
    replace; None where there is none.
    """
    theirs = {folder.expanduser().resolve() / name for folder in folders for name in FILES}
    return next((path for path in inputs if path.expanduser().resolve() in theirs), None)


def write_report(
    d: Diagnosis,
    out: str | Path,
    *,
    pictures: bool = True,
    progress: Progress | None = None,
) -> Path:
    """Write everything that ``zendsp diagnose --out`` promises.

    Parameters
    ----------
    out : path
        Folder, made where it does not exist.
    pictures : bool
        Also report.html, its figures and their numbers (matplotlib is imported only then).
    progress : callable, optional
        Called with a sentence before the pictures are drawn, which takes seconds. All else is
        written by then, report.json last.

    Returns
    -------
    Path
        The folder.
    """
    folder = Path(out).expanduser()
    folder.mkdir(parents=True, exist_ok=True)
    _clear(folder)
    (folder / "model.toml").write_text(_improved_text(d.improved, folder), encoding="utf-8")
    (folder / "calibrated.toml").write_text(model_text(d.calibrated), encoding="utf-8")
    _compensation(d, folder)
    if d.next_recording is not None and d.next_recording.reference is not None:  # no_reference
        from zendsp.reference import Reference, save_reference

        q, period = d.next_recording.reference
        reference = Reference(q, period, kind="separating", unit=d.units)
        save_reference(reference, folder / "next_reference.mat", check=False)
    drawn = charts(d) if pictures else []
    for chart in drawn:
        save_chart(chart, folder)
    half = folder / ".report.json"
    half.write_text(report_text(d), encoding="utf-8")
    os.replace(half, folder / "report.json")
    if pictures:
        if progress is not None:
            progress(Step.REPORTING.says("drawing the figures"))
        from zendsp.diagnosis.report.drawing import draw_all
        from zendsp.diagnosis.report.html import page

        figures = draw_all(drawn, folder)
        (folder / "report.html").write_text(page(d, figures), encoding="utf-8")
    return folder


def no_reference(d: Diagnosis) -> str:
    """The reason that no next_reference.mat is written; empty where one is."""
    if d.stopped:
        return "it was not asked for after the interrupt"
    if d.next_recording is None and not d.doubted:
        open_ = "what is left has no name, and no rival to be told from"
        return open_ if d.nameless else "nothing is left open"
    if d.next_recording is None:
        return "no motion can be proposed for what is open"
    if not d.next_recording.tells:
        return "no motion tells apart what is left open"
    if d.next_recording.free:
        beside = (
            " To move what is driven beside it, 'zendsp reference' plans motions."
            if len(d.undriven) < d.given.joints
            else ""
        )
        return (
            f"joint {d.next_recording.free} follows no reference, since nothing drives it: let it"
            f" go by hand, or push it, and record.{beside}"
        )
    by_hand = (
        "where an experiment is named, it is set up by hand; where that is a motion,"
        " 'zendsp reference' plans one"
    )
    return by_hand if d.next_recording.reference is None else ""


def _clear(folder: Path) -> None:
    """Remove files of an earlier diagnosis that this one may not overwrite, and links: through
    these it would write into files elsewhere.
    """
    for name in ("model.toml", "calibrated.toml", "model.mjcf", "compensation.c", ".report.json"):
        if (folder / name).is_symlink():
            (folder / name).unlink()
    for chart in folder.glob(f"*{SUFFIX}"):
        chart.with_name(chart.name.removesuffix(SUFFIX) + ".png").unlink(missing_ok=True)
        chart.unlink()
    for name in ("report.json", "report.html", "next_reference.mat"):
        (folder / name).unlink(missing_ok=True)


def left_out(model: Model) -> list[str]:
    """A note on what ``model.mjcf`` does not hold; none where the model is no MJCF."""
    if model.kind != "mjcf":
        return []
    if model.robot.take != "all":
        return ["no model.mjcf is written: this model takes only the bodies from its MJCF"]
    from zendsp.physics.robots.mjcf_write import inexpressible

    stay = [
        f"{'the inertia of ' * ('mass' in t.parameters and not t.value('mass'))}{t.effect}"
        f" (joint {t.joint})"
        for t in inexpressible(model)
    ]
    if not stay:
        return []
    return [
        f"the report's model.mjcf holds what was found, except {', '.join(dict.fromkeys(stay))}:"
        " MuJoCo cannot express that; it stands as [[effect]] in the model.toml beside it"
    ]


def _improved_text(model: Model, folder: Path) -> str:
    """The text of the improved model's file. An MJCF gets a model.mjcf of its own, where that can
    be written.
    """
    if model.kind != "mjcf":
        return model_text(model)
    from zendsp.physics.robots.mjcf_write import write_mjcf

    written = write_mjcf(model, folder.resolve() / "model.mjcf")
    return model_text(model) if written is None else model_text(written, beside=True)


def report_text(d: Diagnosis) -> str:
    """The text of report.json."""
    return json.dumps(finite(d.report()), indent=1, ensure_ascii=False, allow_nan=False)


def _compensation(d: Diagnosis, folder: Path) -> None:
    try:
        from zendsp.physics.codegen.compensation import compensation
        from zendsp.physics.codegen.terms import compensable
    except ImportError:
        return
    report = d.report()
    found = stands_for(report)
    terms = [t for t in d.improved.terms if (t.effect, t.joint) in found]
    sentences = [f.sentence for f in d.findings]
    for joint, mechanism in _without_law(report):
        drawn = any(t.joint == joint and mechanism_of(t.effect) == mechanism for t in terms)
        sentences.append(
            f"Of the torque without a law at joint {joint}, ripples stand for its curve: as far as"
            " was recorded, and no further."
            if drawn
            else f"Not compensated: the torque without a law at joint {joint}. Its curve is in"
            " report.json."
        )
    free = {f["joint"] for f in report["findings"]}.intersection(report.get("undriven", ()))
    sentences += [f"Not compensated: joint {j}, which nothing drives." for j in sorted(free)]
    left = [t for t in d.improved.terms if not any(t is x for x in terms)]
    names = {(r["effect"], r["joint"]) for r in report["refinements"]}
    refining = [t for t in left if (t.effect, t.joint) in names]
    if refining:
        more = dict.fromkeys(t.effect for t in refining)
        said = f"What only refines the fit is left out ({', '.join(more)})."
        if any(compensable(t) for t in refining):
            said += (
                " With what of it a torque can cancel, and what the given model had: zendsp model2c"
                " model.toml --effects-only."
            )
        sentences.append(said)
    sentences += [f"Not compensated: {note}." for note in d.notes if MOVED_NUMBERS in note]
    sentences.append(
        "What the given model had, gravity and inertia too, is left out as well; zendsp model2c"
        " model.toml writes functions of all of it."
    )
    (folder / "compensation.c").write_text(
        compensation([as_stated(d, t) for t in terms], model=d.improved, sentences=sentences),
        encoding="utf-8",
    )


def _without_law(report: Report) -> set[tuple[int, str]]:
    """Joint and mechanism of findings without a law."""
    return {(f["joint"], f["mechanism"]) for f in report["findings"] if f["effect"] == "unknown"}


def stands_for(report: Report) -> set[tuple[str, int]]:
    """Effect and joint of the terms of the improved model that may be compensated: those of
    findings, the Coulomb level of a found Stribeck curve, and ripples among the refinements that
    describe a torque over position without a law. Other refinements may be bent to anything: a
    friction could drive the joint, and a spring grows without limit outside the recorded range.
    None of a joint that nothing drives.
    """
    stand = {(f["effect"], f["joint"]) for f in report["findings"]}
    # a breakaway is counted from zero, so the level to which the friction falls belongs to it
    falls = {f["joint"] for f in report["findings"] if f["effect"] == "stribeck"}
    stand |= {
        ("coulomb", r["joint"])
        for r in report["refinements"]
        if r["effect"] == "coulomb" and r["joint"] in falls
    }
    # the weight of a found inertia belongs to it
    weighs = (f["joint"] for f in report["findings"] if "weight" in f.get("details", {}))
    stand |= {("gravity", joint) for joint in weighs}
    for joint, mechanism in _without_law(report):
        drawn = [
            r["effect"]
            for r in report["refinements"]
            if (r["joint"], r["mechanism"]) == (joint, mechanism)
        ]
        if mechanism == "position_torque" and all("order" in get_effect(e).names for e in drawn):
            stand |= {(effect, joint) for effect in drawn}
    return {(effect, joint) for effect, joint in stand if joint not in report.get("undriven", ())}


def finite(value: Any) -> Any:
    """The value with infinities and NaN as null, since JSON has neither."""
    if isinstance(value, dict):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [finite(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
