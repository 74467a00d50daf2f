"""Puts the result of an experiment into a model file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from zendsp.errors import ModelError
from zendsp.experiment.names import present_name
from zendsp.experiment.registry import EXPERIMENTS, Experiment
from zendsp.experiment.result import Result
from zendsp.physics import load_model, model_text, parse_model
from zendsp.physics.effects import Effect, get_effect
from zendsp.physics.model import PARAMETERS, Model, Quantity
from zendsp.reference import load_machine
from zendsp.reference.machine import MACHINES
from zendsp.whole_file import write_whole
from zendsp_protocol.messages import MachineInfo
from zendsp_protocol.texts import counted

FRICTION = ("dry_friction", "fluid_friction")  # mechanisms
# a mechanism that any number of joints fits: only the effects are read through it
_SHELL = {"kind": "rotary", "parameters": {"inertia": 1.0}}


def fit_model(
    names: Sequence[str], path: str | Path, machine: MachineInfo | None = None
) -> list[str]:
    """Which of these experiments measure a number of this model file.

    Parameters
    ----------
    names : sequence of str
        Of experiments; unknown ones are left out.
    path : path
        A model file.
    machine : MachineInfo, optional
        On which they are made; default: each on the machine that is started for it.

    Returns
    -------
    list of str

    Raises
    ------
    ModelError
        None of them does.

    Examples
    --------
    >>> fit_model(["circle", "friction-curve"], "examples/models/imi_planar.toml")  # doctest: +SKIP
    ['friction-curve']
    """
    model = load_model(path)
    known = [e for name in names if (e := EXPERIMENTS.get(present_name(name)))]
    holding = [e for e in known if e.models]

    def measured(e: Experiment) -> tuple[str, int]:
        if machine is not None:
            return machine.name, len(machine.joints)
        return e.shipped, load_machine(e.shipped).joints

    fitting = [e.name for e in holding if measured(e)[1] == model.joints]
    if holding and not fitting:
        _require_joints(*measured(holding[0]), model, path)
    if known and not fitting:
        do = ", ".join(e.name for e in EXPERIMENTS.values() if e.models)
        raise ModelError(
            f"{', '.join(e.name for e in known)} finds nothing that a model file holds; {do} do"
        )
    return fitting


def _require_joints(machine: str, joints: int, model: Model, path: str | Path) -> None:
    if joints != model.joints:
        raise ModelError(
            f"{path} has {counted(model.joints, 'joint')} and {machine}, which was measured,"
            f" {joints}: give a"
            " model of that machine"
        )


def put_into(result: Result, path: str | Path) -> list[str]:
    """Replace the friction of the joints that were measured, and the mechanism's parameters, by the
    result, and rewrite the file.

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
        The result has nothing for a model, or the model is of another machine; the file stays as it
        was.
    """
    if not result.effects and not result.mechanism:
        raise ModelError(
            f"{result.name} finds nothing that a model file holds: there is nothing to put into"
            f" {path}"
        )
    model = load_model(path)
    if result.machine in MACHINES:
        _require_joints(result.machine, load_machine(result.machine).joints, model, path)
    taken, joints = with_effects(model, result)
    added = len(result.effects)
    removed = len(model.terms) - len(taken.terms) + added
    changes = (
        [
            f"friction of joint {', '.join(map(str, joints))} replaced"
            f" ({removed} terms by {added})"
        ]
        if joints
        else []
    )
    mechanism, may = dict(model.mechanism), PARAMETERS[model.kind] or ()
    if not result.effects and not any(name in may for name in result.mechanism):
        raise ModelError(
            f"{path}: a mechanism of kind {model.kind} has no {' or '.join(result.mechanism)}"
        )
    for name, estimate in result.mechanism.items():
        if name not in may:
            changes.append(f"{name}: {estimate} stays out: the file of the {model.kind} has it")
            continue
        old = mechanism.get(name)
        mechanism[name] = (Quantity(estimate.value, True, estimate.unit, estimate.std),)
        changes.append(f"{name}: {estimate}" + (f" (was {old[0].value:.4g})" if old else ""))
    text = model_text(replace(taken, mechanism=mechanism))
    if model.file and not Path(model.file).is_absolute():
        text = text.replace(str((model.folder / model.file).resolve()), model.file)
    write_whole(Path(path), text)
    return changes


def with_effects(model: Model, result: Result) -> tuple[Model, list[int]]:
    """A model whose joints that were measured have the friction that was found, and those joints
    (1-based).
    """
    found = parse_model(
        {
            "name": "found",
            "mechanism": _SHELL,
            "effect": [effect.table() for effect in result.effects],
            "columns": {"position": [f"q{j}" for j in range(8)]},
        },
        result.name,
    )
    joints = sorted({term.joint for term in found.terms})
    anew = {term.effect for term in found.terms}
    kept = tuple(
        t
        for t in model.terms
        if t.joint not in joints or not (t.effect in anew or _of_speed(get_effect(t.effect)))
    )
    return model.with_terms((*kept, *found.terms)), joints


def _of_speed(effect: Effect) -> bool:
    """Whether an effect is friction as a function of speed, which the experiments measure."""
    return effect.mechanism in FRICTION and effect.over == "velocity"
