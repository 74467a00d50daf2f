"""The curve of a torque over a variable: means over its range, for friction with its sign reversed
in backward motion.

Each sample is weighted by its inverse variance. Samples of one pass are correlated, so the standard
error of a mean comes from passes: blocks of time with a few samples in a bin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.measure.discrepancy import ENERGY_BLOCK
from zendsp.diagnosis.measure.where import Missing

Array = npt.NDArray[np.float64]
SLOW = 0.02  # of a joint's speed: below, it has no direction
IN_A_BIN = 5  # least samples of a mean that is drawn
BINS = 40
COMMON = 4.0  # passes: weight of the scatter over all bins beside that of one bin
DRY, FLUID = FRICTION = ("dry_friction", "fluid_friction")
# the variables of each mechanism's torque
OVER = {
    "position_torque": ("position",),
    DRY: ("velocity", "position"),
    FLUID: ("velocity", "position"),
    "actuator": ("command",),
}


@dataclass(frozen=True)
class Axis:
    """The variable of a curve: position, velocity, acceleration, command or time of its joint, or a
    motion of the named joints (1-based; the sum of several).
    """

    variable: str
    joints: tuple[int, ...] = ()

    def __str__(self) -> str:
        if not self.joints:
            return self.variable
        which = " + ".join(map(str, self.joints))
        return f"{self.variable} of joint{'s' if len(self.joints) > 1 else ''} {which}"


@dataclass(frozen=True)
class Samples:
    """Torque over a variable, (n,) each: inverse variances, and the block of time of each."""

    x: Array
    torque: Array
    weight: Array
    block: npt.NDArray[np.int_]


@dataclass(frozen=True)
class Curve:
    """Samples of a torque over a variable, and its means in bins, (m,) each, with their standard
    errors. ``against``: the torque is counted against the motion.
    """

    axis: Axis
    samples: Samples
    at: Array
    mean: Array
    spread: Array
    against: bool

    @property
    def explained(self) -> float:
        """The part of the samples' energy that the curve explains."""
        s = self.samples
        level = np.interp(s.x, self.at, self.mean) if len(self.at) else np.zeros(len(s.x))
        total = float(np.sum(s.weight * s.torque**2))
        return 1.0 - float(np.sum(s.weight * (s.torque - level) ** 2)) / max(total, 1e-300)


def samples_of(missing: Missing, axis: Axis) -> Array:
    """The variable of an axis along a recording, (n,)."""
    if not axis.joints or missing.others is None:
        return missing.time if axis.variable == "time" else missing.along(axis.variable)
    row = ("position", "velocity", "acceleration").index(axis.variable)
    total: Array = missing.others[[j - 1 for j in axis.joints], row].sum(axis=0)
    return total


def curve_over(lacks: Sequence[Missing], axis: Axis, mechanism: str) -> Curve:
    """The curve of the missing torque over an axis.

    Friction over anything but velocity has its sign reversed in backward motion, since the mean of
    both directions would hide it.
    """
    samples = samples_over(lacks, axis)
    against = mechanism in FRICTION and axis.variable != "velocity"
    if against:
        v = np.concatenate([m.variables["velocity"] for m in lacks])
        moves = np.abs(v) > SLOW * np.quantile(np.abs(v), 0.98)
        s = samples
        samples = Samples(s.x, np.sign(v) * s.torque, moves * s.weight, s.block)
    return Curve(axis, samples, *binned(samples), against)


def samples_over(lacks: Sequence[Missing], axis: Axis) -> Samples:
    """The missing torque over an axis, all recordings one after the other."""
    blocks, first = [], 0
    for m in lacks:
        blocks.append(first + ((m.time - m.time[0]) / ENERGY_BLOCK).astype(int))
        first = int(blocks[-1][-1]) + 1
    return Samples(
        np.concatenate([samples_of(m, axis) for m in lacks]),
        np.concatenate([m.torque for m in lacks]),
        np.concatenate([m.weight for m in lacks]),
        np.concatenate(blocks),
    )


def curve_of(lacks: Sequence[Missing], mechanism: str) -> Curve | None:
    """The curve of the missing torque over the best of a mechanism's own variables; None where it
    has none.
    """
    found = [curve_over(lacks, Axis(variable), mechanism) for variable in OVER.get(mechanism, ())]
    return max(found, key=lambda curve: curve.explained, default=None)


def binned(samples: Samples, count: int = BINS) -> tuple[Array, Array, Array]:
    """Centres of the bins with enough samples, the mean torque there, and its standard errors."""
    x, weight = samples.x, samples.weight
    edges = np.linspace(float(np.quantile(x, 0.001)), float(np.quantile(x, 0.999)), count + 1)
    bins = np.searchsorted(edges, x, side="right") - 1
    good = (bins >= 0) & (bins < count) & (weight > 0)
    bins, weight, y, block = bins[good], weight[good], samples.torque[good], samples.block[good]
    total = np.bincount(bins, weight, count)
    per = 1.0 / np.where(total > 0, total, np.inf)
    mean = np.bincount(bins, weight * y, count) * per
    # the scatter of passes about the mean, in each bin, combined with that of all bins as a
    # multiple of what the weights predict: two passes may agree by chance
    blocks = int(block.max(initial=0)) + 1
    apart = np.bincount(bins * blocks + block, weight * (y - mean[bins]), count * blocks)
    passes = np.bincount(np.unique(bins * blocks + block) // blocks, minlength=count)
    free = np.maximum(passes - 1, 0)
    own = np.sum(apart.reshape(count, blocks) ** 2, axis=1) * per**2
    own *= passes / np.maximum(free, 1)
    several = free > 0
    common = float(np.mean((own * total)[several])) if several.any() else 1.0
    variance = (free * own + COMMON * common * per) / (free + COMMON)
    use = np.bincount(bins, minlength=count) >= IN_A_BIN
    return (0.5 * (edges[1:] + edges[:-1]))[use], mean[use], np.sqrt(variance[use])
