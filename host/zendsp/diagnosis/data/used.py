"""How the optional columns are used that a model names, in words; reading says why others are not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.sensors import SENSED
from zendsp.diagnosis.data.signals import Signals
from zendsp.physics.effects import library
from zendsp.physics.model import Model
from zendsp_protocol.texts import enumerated

Array = npt.NDArray[np.float64]
MAIN = ("time", "position", "command")  # of which no note is needed
HOW = {
    "position_load": "the transmission is measured by its difference from the position",
    "torque_measured": "it parts what acts before the sensor from what acts after it",
}


def used_columns(signals: Sequence[Signals], model: Model) -> list[str]:
    """A note for each optional column of the model: how it is used; or why not, where nothing else
    says so.

    Parameters
    ----------
    signals : sequence of Signals
        All recordings, with the columns that all of them have.
    model : Model
    """
    notes = [_reference(signals)] if "reference" in model.columns else []
    for role in [role for role in model.columns if role not in (*MAIN, "reference")]:
        each = [s.extra[role] for s in signals if role in s.extra]
        if not each:  # a recording lacks it, which is said
            continue
        if role not in SENSED:
            notes.append(_read_by_effects(role, each, model))
            continue
        finite = np.array([np.isfinite(values).all(axis=0) for values in each])
        # a current that shows the drive in one recording shows it for all
        used = np.flatnonzero(finite.any(axis=0) if role == "current" else finite.all(axis=0)) + 1
        if len(used):
            how = _follows(signals, used - 1) if role == "current" else HOW[role]
            notes.append(f"{role} of {_joints(used.tolist())} was used: {how}")
        elif not any(f"{role} of joint" in note for s in signals for note in s.notes):
            notes.append(f"{role} was not used: it holds no numbers")
    return notes


def columns_beside_a_call(signals: Sequence[Signals], model: Model) -> list[str]:
    """The same of a simulator that can only be called, which is compared by its positions."""
    notes = []
    for role in [role for role in model.columns if role not in MAIN]:
        if role != "reference":
            notes.append(f"{role} was not used: the simulator is compared by its position alone")
        elif model.kind == "python" and all(s.reference is not None for s in signals):
            notes.append(f"{_reference(signals)}, and handed to the simulator")
        else:
            notes.append(_reference(signals))
    return notes


def _reference(signals: Sequence[Signals]) -> str:
    lacking = [s.whole or s.name for s in signals if s.reference is None]
    if len(lacking) == len(signals):
        return "reference was not used: no recording has its column"
    but = f" (not in {', '.join(dict.fromkeys(lacking))})" if lacking else ""
    return f"reference was used to check the position{but}"


def _read_by_effects(role: str, each: Sequence[Array], model: Model) -> str:
    """The note on a column that laws read."""
    readers = [e.name for e in library().values() if role in e.reads]
    by = f"{enumerated(readers)} read{'s' if len(readers) == 1 else ''} it"
    low, high = min(float(v.min()) for v in each), max(float(v.max()) for v in each)
    if low == high and not any(t.effect in readers for t in model.terms):
        return f"{role} was not used: it is constant ({high:.4g}), and only {by}"
    return f"{role} was used ({low:.4g} to {high:.4g}): {by}"


def _follows(signals: Sequence[Signals], joints: npt.NDArray[np.intp]) -> str:
    """What a current shows that follows the command of some joints (0-based), and by what factor:
    a torque constant, or a drive that is told another unit.
    """
    factors = []
    for j in joints:
        having = [s for s in signals if "current" in s.extra]
        told = [(s.extra["current"][:, j], s.command[:, j]) for s in having]
        whole = [(x - x.mean(), u - u.mean()) for x, u in told if np.isfinite(x).all()]
        power = max(sum(float(u @ u) for _, u in whole), 1e-300)
        slope = sum(float(x @ u) for x, u in whole) / power
        factors.append(f"{slope:.3g}")
    shown = [effect.name for effect in library().values() if "current" in effect.shown_by]
    return (
        f"it follows the command ({', '.join(factors)} times it), so there is no"
        f" {enumerated(shown, 'or')}, and none was tried"
    )


def _joints(numbers: Sequence[int]) -> str:
    return f"joint{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))}"
