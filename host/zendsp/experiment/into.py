"""Puts what an experiment found into a model file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from zendsp.errors import ModelError
from zendsp.experiment.result import Result
from zendsp.physics import load_model, model_text, parse_model
from zendsp.physics.model import Quantity

FRICTION = ("coulomb", "coulomb_asymmetry", "viscous", "viscous_asymmetry", "stribeck", "quadratic_drag", "friction_block", "presliding")


def put_into(result: Result, path: str | Path) -> list[str]:
    """Replace the friction of the joints that were measured, and the mechanism's parameters, by the result; the file is rewritten.

    Parameters
    ----------
    result : Result
    path : path
        A model file; comments in it are lost.

    Returns
    -------
    list of str
        What changed, a sentence each.

    Raises
    ------
    ModelError
        The result has nothing for a model, or the model has no such joint.
    """
    if not result.effects and not result.mechanism:
        raise ModelError(f"{result.name} finds nothing that a model file holds: there is nothing to put into {path}")
    model = load_model(path)
    found = parse_model({"name": "found", "mechanism": _shell(result), "effect": result.effects, "columns": {"position": [f"q{j}" for j in range(8)]}}, result.name)
    joints = sorted({term.joint for term in found.terms})
    if joints and joints[-1] > model.joints:
        raise ModelError(f"{path} has {model.joints} joints, {result.name} measured joint {joints[-1]}")
    kept = tuple(t for t in model.terms if t.joint not in joints or t.effect not in FRICTION)
    changes = [f"friction of joint {', '.join(map(str, joints))} replaced ({len(model.terms) - len(kept)} terms by {len(found.terms)})"] if joints else []
    mechanism = dict(model.mechanism)
    for name, estimate in result.mechanism.items():
        before = mechanism.get(name)
        mechanism[name] = (Quantity(estimate.value, True, estimate.unit, estimate.std),)
        changes.append(f"{name}: {estimate}" + (f" (was {before[0].value:.4g})" if before else ""))
    text = model_text(replace(model, terms=(*kept, *found.terms), mechanism=mechanism))
    if model.file and not Path(model.file).is_absolute():
        text = text.replace(str((model.folder / model.file).resolve()), model.file)
    scratch = Path(path).with_suffix(".toml.new")
    scratch.write_text(text, encoding="utf-8")
    scratch.replace(path)
    return changes


def _shell(result: Result) -> dict[str, object]:
    """A mechanism that any number of joints fits: only the effects are read through it."""
    return {"kind": "rotary", "parameters": {"inertia": 1.0}}
