"""Plays a proposed reference on a target and records it, in the columns that a model names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from zendsp.errors import Refused
from zendsp.experiment.player import Player
from zendsp.link import Target
from zendsp.physics.model import Model
from zendsp.recording import Recording
from zendsp.reference import Reference, check_fits
from zendsp_protocol.states import ProgramState, VariableKind

REST_S = 0.3  # after the last row


def run_reference(
    target: Target, reference: Reference, model: Model, like: Recording | None = None
) -> Recording:
    """Play a reference on a target and record the signals that the model's ``[columns]`` name.

    The target's program must follow the table ``ref`` (pd.c, or any program with motion.h). Where
    none is loaded, the program and the parameters of an earlier recording are used. A program that
    runs goes on as before; one that stood is paused afterwards, and its own tables and parameters
    are restored.

    Parameters
    ----------
    reference : Reference
        Position, one row a sample.
    model : Model
        Its columns are what is recorded.
    like : Recording, optional
        An earlier recording of this machine, with its program.

    Raises
    ------
    Refused
        No program that follows ``ref``, a reference beyond the limits of the target, or a trip.
    """
    _ready(target, model, like)
    _check(target, reference)
    names = target.variables()
    approach = float(np.asarray(target["approach_time"])) if "approach_time" in names else 0.0
    values = {"use_table": True, "row_rate": round(1.0 / reference.sample_time), "hold": False}
    recording, _ = Player(
        target, reference.tables(), values, _channels(model, names),
        approach + reference.duration + REST_S, "separating experiment",
    ).play()  # fmt: skip
    trip = target.status().trip
    if trip is not None and trip.reason:
        raise Refused(
            f"the separating experiment ended early: {trip.text}. What came before is not used"
        )
    return recording


def _ready(target: Target, model: Model, like: Recording | None) -> None:
    """Make sure that a program is loaded that can follow a table."""
    without = (ProgramState.EMPTY, ProgramState.CRASHED)
    if target.status().state in without and like is not None and like.sources:
        target.download(dict(like.sources), like.flags)
        declared = target.variables()
        target.update(
            None,
            **{
                n: v
                for n, v in like.parameters.items()
                if n in declared and declared[n].kind == VariableKind.PARAMETER
            },
        )
    loaded = target.variables() if target.status().state not in without else {}
    table = loaded.get("ref")
    if table is None or table.kind != VariableKind.TABLE or table.columns != model.joints:
        raise Refused(
            f"target {target.name} has no program that follows a table 'ref' of {model.joints}"
            " columns: load the one that made the recordings, for example 'zendsp run pd.c -t"
            f" {target.name}'"
        )


def _check(target: Target, reference: Reference) -> None:
    """Refuse a reference whose position or speed is beyond the target's limits."""
    machine, limits = target.machine(), target.limits()
    units = [joint.unit for joint in machine.joints]
    check_fits(reference, machine.name, units)
    for j in range(reference.joints):
        low, high = float(reference.q[:, j].min()), float(reference.q[:, j].max())
        least, most = limits.position_min[j], limits.position_max[j]
        if low < least or high > most:
            raise Refused(
                f"the reference takes joint {j + 1} to {low:.4g} … {high:.4g} {units[j]}; the"
                f" target allows {least:.4g} … {most:.4g} {units[j]}"
            )
        fastest = float(np.abs(reference.qd[:, j]).max())
        if fastest > limits.speed_max[j]:
            raise Refused(
                f"the reference moves joint {j + 1} at {fastest:.4g} {units[j]}/s; the target"
                f" allows {limits.speed_max[j]:.4g} {units[j]}/s"
            )


def _channels(model: Model, names: Any) -> Sequence[str]:
    """The channels for the columns of the model. Time is part of every recording; the reference is
    recorded only where the program has it as a signal.
    """
    channels: list[str] = []
    for role in ("position", "command", "reference"):
        column = model.columns.get(role)
        wanted = (
            [] if column is None else list(column) if isinstance(column, list) else [str(column)]
        )
        if role != "reference" or all(name.partition("[")[0] in names for name in wanted):
            channels += wanted
    return channels
