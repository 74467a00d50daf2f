"""Recordings and reports for the tests of Diagnose."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from zendsp.diagnosis.report.chart import Chart, Panel, Series, save_chart
from zendsp.physics import load_model, model_text, parse_model, simulate_loop
from zendsp.physics.codegen.compensation import compensation
from zendsp.physics.files.shipped import model_folder
from zendsp.physics.model import Quantity, Term
from zendsp.reference import Reference, save_reference
from zendsp.tui.diagnoses import Diagnosed, begin, keep

RATE = 250.0
GIVEN: dict[str, Any] = {
    "name": "bench",
    "sample_time": 1.0 / RATE,
    "mechanism": {"kind": "rotary", "parameters": {"inertia": {"value": 0.01, "unit": "kg m^2"}}},
    "sensor": {"position_resolution": 1e-5},
    "controller": {"kind": "pd", "kp": [4.0], "kd": [0.2], "cutoff": 40.0},
    "columns": {"time": "t", "position": "q", "command": "u", "reference": "r"},
}


def bench(folder: Path, seconds: float = 4.0) -> tuple[Path, Path]:
    """A recording of a joint with dry friction, and its model without."""
    real = parse_model({**GIVEN, "effect": [{"kind": "coulomb", "joint": 1, "level": 0.05}]})
    t = np.arange(int(seconds * RATE)) / RATE
    motion = sum(0.3 * np.sin(w * t + p) for w, p in ((2.1, 0.0), (5.3, 1.0), (9.7, 2.0)))
    recording = simulate_loop(real, motion[:, None])
    table = np.column_stack([recording.t, *(recording[c] for c in ("q", "u", "r"))])
    run = folder / "bench.csv"
    np.savetxt(run, table, delimiter=",", header="t,q,u,r", comments="")
    model = folder / "bench.toml"
    model.write_text(model_text(parse_model(GIVEN)))
    return run, model


def stored(
    root: Path,
    name: str = "arm",
    *,
    level: float = 8.0,
    motion: Reference | None = None,
    verdict: str = "missing",
) -> Diagnosed:
    """A report of the planar arm as the diagnosis writes it: Coulomb friction at both joints."""
    given = load_model(model_folder() / "imi_planar.toml")
    bare = tuple(t for t in given.terms if t.effect != "coulomb")
    found = [
        Term("coulomb", j, {"level": Quantity(value)}) for j, value in ((1, level), (2, level / 4))
    ]
    if verdict != "missing":
        found = []
    improved = given.with_terms((*bare, *found))
    made, folder = begin(root, name)
    made.mkdir(parents=True)
    sentences = [f"Joint {t.joint} lacks Coulomb friction [N m]." for t in found]
    (made / "model.toml").write_text(model_text(improved))
    (made / "compensation.c").write_text(compensation(found, model=improved, sentences=sentences))
    (made / "report.html").write_text("<title>report</title>")
    (made / "report.json").write_text(json.dumps(_report(found, sentences, verdict, motion)))
    x = np.linspace(-2.0, 2.0, 400)
    for k, term in enumerate(found):
        lacks = np.sign(x) * term.value("level")
        before = (Series("dots", "data", x, lacks), Series("line", "law", x, lacks, "as found"))
        after = (Series("dots", "data", x, 0.0 * x),)
        panels = tuple(
            Panel("velocity [rad/s]", "torque [N m]", s, title, limits=(-10.0, 10.0))
            for s, title in ((before, "without coulomb"), (after, "with coulomb"))
        )
        title = f"Joint {term.joint}: torque that the model lacks"
        save_chart(
            Chart("law", sentences[k], f"law_{k}", panels, title, True, True, finding=k, joint=k),
            made,
        )
    if motion is not None:
        save_reference(motion, made / "next_reference.mat", check=False)
    model = model_folder() / "imi_planar.toml"
    recordings = (str(root / "first.csv"),)
    return keep(Diagnosed(made, name, time.time(), str(model), recordings), folder)


def _report(
    found: list[Term], sentences: list[str], verdict: str, motion: Reference | None
) -> dict[str, Any]:
    table = {"given": 3e-3, "calibrated": 2e-3, "improved": 1e-4}
    return {
        "verdict": verdict,
        "findings": [
            {
                "effect": t.effect,
                "joint": t.joint,
                "parameters": {"level": {"value": t.value("level"), "std": 0.01, "unit": "N m"}},
                "confidence": 0.97,
                "share": 0.6,
                "indistinguishable": ["stribeck"],
                "replaces": [],
                "mechanism": "dry_friction",
                "sentence": text,
            }
            for t, text in zip(found, sentences, strict=True)
        ],
        "refinements": [],
        "discrepancy": [{"joint": 1, "share": 0.01, "interval": [0.005, 0.02]}],
        "detectable": [
            {
                "joint": 1,
                "mechanism": "position_torque",
                "effect": "ripple",
                "size": 0.002,
                "unit": "N m",
            }
        ],
        "where": {"time": [], "state": []},
        "fit": {
            "quantity": "position",
            "unit": "rad",
            "estimation": table,
            "heldout": table,
            "test": table,
            "noise_floor": 9e-5,
        },
        "rejected": [],
        "next_recording": (
            {"sentence": "Move slowly to and fro.", "reference": "next_reference.mat"}
            if motion is not None
            else None
        ),
        "unexplained": "" if verdict != "unexplained" else "Joint 1: nothing known fits.",
        "notes": ["friction_temperature was not considered"],
        "seconds": 2.0,
    }
