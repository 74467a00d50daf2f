"""The curve of a torque over a variable: means over its range, of both directions of travel where
friction would hide itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.measure.where import Missing

Array = npt.NDArray[np.float64]
SLOW = 0.02  # of a joint's speed: below, it has no direction
IN_A_BIN = 5  # samples: a mean of fewer is not drawn
BINS = 40
# of these a mechanism's torque is a function
OVER = {
    "position_torque": ("position",),
    "dry_friction": ("velocity", "position"),
    "fluid_friction": ("velocity",),
    "actuator": ("command",),
}


@dataclass(frozen=True)
class Curve:
    """Samples of a torque over a variable, (n,), and the means in bins of it, (m,) each, with their
    standard deviations. ``against``: the torque is that against the motion.
    """

    variable: str
    x: Array
    torque: Array
    at: Array
    mean: Array
    spread: Array
    against: bool

    @property
    def explained(self) -> float:
        """Part of the energy of the samples that the curve explains."""
        level = np.interp(self.x, self.at, self.mean) if len(self.at) else np.zeros(len(self.x))
        return 1.0 - float(np.sum((self.torque - level) ** 2) / max(np.sum(self.torque**2), 1e-300))


def samples_of(missing: Missing, variable: str) -> Array:
    """Samples of a variable along a recording, (n,); ``variable`` may be ``"time"``, and
    ``"velocity of joint 2"`` or ``"velocity of joints 1 + 2"`` (their sum), as of other joints.
    """
    kind, _, joints = variable.partition(" of ")
    if not joints or missing.others is None:
        return missing.time if kind == "time" else missing.variables[kind]
    numbers = [int(word) for word in joints.split() if word.isdigit()]
    row = ("position", "velocity", "acceleration").index(kind)
    total: Array = missing.others[[j - 1 for j in numbers], row].sum(axis=0)
    return total


def curve_over(lacks: Sequence[Missing], variable: str, mechanism: str) -> Curve:
    """What is lacking over one variable of ``samples_of``.

    Dry friction over anything but velocity is turned over where the joint moves backwards: the mean
    of both directions would hide it.
    """
    x = np.concatenate([samples_of(m, variable) for m in lacks])
    torque = np.concatenate([m.torque for m in lacks])
    against = mechanism == "dry_friction" and variable != "velocity"
    if against:
        v = np.concatenate([m.variables["velocity"] for m in lacks])
        moves = np.abs(v) > SLOW * np.quantile(np.abs(v), 0.98)
        x, torque = x[moves], np.sign(v[moves]) * torque[moves]
    return Curve(variable, x, torque, *binned(x, torque), against)


def curve_of(lacks: Sequence[Missing], mechanism: str) -> Curve | None:
    """What is lacking over the variable on which it depends, of those that are a mechanism's own;
    None where it has none.
    """
    found = [curve_over(lacks, variable, mechanism) for variable in OVER.get(mechanism, ())]
    return max(found, key=lambda curve: curve.explained, default=None)


def binned(x: Array, y: Array, count: int = BINS) -> tuple[Array, Array, Array]:
    """Centres of bins of ``x`` that hold enough samples, means of ``y`` there, and their standard
    deviations.
    """
    edges = np.linspace(float(np.quantile(x, 0.001)), float(np.quantile(x, 0.999)), count + 1)
    bins = np.searchsorted(edges, x, side="right") - 1
    good = (bins >= 0) & (bins < count)
    bins, y = bins[good], y[good]
    n = np.bincount(bins, minlength=count)
    use = n >= IN_A_BIN
    mean = np.bincount(bins, y, count)[use] / n[use]
    square = np.bincount(bins, y**2, count)[use] / n[use]
    spread = np.sqrt(np.maximum(square - mean**2, 0) / n[use])
    return (0.5 * (edges[1:] + edges[:-1]))[use], mean, spread
