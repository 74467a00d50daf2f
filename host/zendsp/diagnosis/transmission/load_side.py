"""The equation of a load behind a spring, by the two sensors alone.

k torsion + c its rate = -(J q̈ + friction) of the load: no torque of the drive is in it, so that
nothing that the drive or the motor's side lacks can bend what it tells. It tells no force, only
ratios: stiffness and dry friction for each unit of the load's inertia. The motor's position tells
the rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.decide.thresholds import SURE
from zendsp.diagnosis.transmission.sets import OPEN, Sets
from zendsp.diagnosis.transmission.torsion import Array, Twist, lowpass
from zendsp.diagnosis.transmission.torsion_fit import regress, rms
from zendsp.physics.calibration.handles import Tie

# of a ratio: twelve simulated belts, linear and rotary, came out 0.1 to 0.8 % off
OF_A_RATIO = 0.005
# of the stiffness for each unit of the load: one that is known worse is no tie
TIGHT = 0.02
# Hz, of the low-pass for a contact; and of its stiffness: 10 000 N m/rad came out as 9 350, 400 as
# 388
CONTACTS, OF_A_CONTACT = 60.0, 0.05
MOVING = 100  # least rows under way of a recording
# chosen terms with which this equation is the load's: others bend its torsion
SPRINGS = frozenset({"spring", "step", "cubic"})


def _under_way(twist: Twist) -> Twist:
    """The twist with the rows around which the load keeps its direction for a period of the
    low-pass. At a reversal friction may hold it, and nearer to one a row averages both directions:
    a dry friction of five came out 3 % too small from all rows that move, 1 % from these.
    """
    side = np.where(twist.kept, np.sign(twist.qd), 0.0)
    return replace(twist, kept=twist.kept & _steady(side, twist))


def _steady(side: Array, twist: Twist) -> npt.NDArray[np.bool_]:
    """The rows around which a side, not 0, stays the same for a period of the low-pass."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # takes half a second

    rows = 2 * round(1.0 / (twist.band * twist.sample_time)) + 1
    alike = maximum_filter1d(side, rows) == minimum_filter1d(side, rows)
    return np.asarray(alike & (side != 0.0))


def _acceleration(twist: Twist) -> Array:
    """The load's acceleration, (n,)."""
    h = twist.sample_time
    return np.asarray(twist.qdd + np.gradient(np.gradient(twist.torsion, h), h))


def _place(twist: Twist, turns: bool) -> list[Array]:
    """What weight or the sensors' pitch adds, (n,) each."""
    return [np.sin(twist.q), np.cos(twist.q)] if turns else [twist.q]


def _columns(twist: Twist, turns: bool, hardens: bool) -> Array:
    """What the load's torsion consists of, (n, columns) of the kept rows: its acceleration and
    direction, its cube where the spring ``hardens``, its rate, and what weight or the sensors'
    pitch adds.
    """
    bend = [(twist.torsion - np.mean(twist.torsion[twist.kept])) ** 3] if hardens else []
    parts = [_acceleration(twist), np.sign(twist.qd), *bend, twist.extra["rate"]]
    parts += _place(twist, turns)
    return np.stack(parts, axis=1)[twist.kept]


@dataclass(frozen=True)
class LoadSide:
    """What two sensors tell of a load on a spring, for each unit of its inertia: ``ties``, the
    stiffness, and that of the bend cubed, which are held in every fit; and the ``dry`` friction,
    with which a fit begins (0: none is sure). Of a ``gap`` its full width, with its standard
    deviation, and the contact's stiffness.
    """

    ties: tuple[Tie, ...]
    dry: float = 0.0
    gap: tuple[float, float] | None = None


def gap_side(straight: Sets, turns: bool) -> LoadSide | None:
    """The same of a load behind a gap: which side is closed its own acceleration says, where the
    motor's inertia, and with it the transmitted torque, is known only roughly. A gap of 12 mrad
    came out at 11.4 to 12.0, by the motor's torque at 9.2 ± 3.
    """
    fit, columns = [], []
    for raw in straight.fit:
        slow = lowpass(raw, CONTACTS)
        own = _acceleration(slow)
        size = rms([own[slow.kept]])
        side = np.where(np.abs(own) > OPEN * size, np.sign(own), 0.0)
        slow = replace(slow, kept=slow.kept & _steady(side, slow))
        parts = [own, side, np.sign(slow.qd), slow.extra["rate"], *_place(slow, turns)]
        fit.append(slow)
        columns.append(np.stack(parts, axis=1)[slow.kept])
    if min(int(t.kept.sum()) for t in fit) < MOVING:
        return None
    found = regress(fit, columns, False)
    of_load, width = -found.x[0], -2.0 * found.x[1]
    std = np.sqrt(np.diag(found.covariance)[:2])
    relative = math.hypot(std[0] / of_load, OF_A_CONTACT)
    if not (of_load > 0.0 and width > 2.0 * SURE * std[1] and relative < 2.0 * OF_A_CONTACT):
        return None
    tie = Tie("stiffness", 1.0 / of_load, relative / of_load, gap=True)
    return LoadSide((tie,), gap=(float(width), float(2.0 * std[1])))


def load_side(slow: Sets, terms: Sequence[str], turns: bool) -> LoadSide | None:
    """None where the two sensors show no spring alone, or know its stiffness less than ``TIGHT``.
    ``terms``: those that describe the torsion; ``turns``: of a rotary joint.
    """
    if "spring" not in terms or not SPRINGS.issuperset(terms):
        return None
    fit = [_under_way(t) for t in slow.fit]
    if min(int(t.kept.sum()) for t in fit) < MOVING:
        return None
    hardens = "cubic" in terms
    found = regress(fit, [_columns(t, turns, hardens) for t in fit], False)
    # a load's inertia and friction, and its bend cubed, for each unit of stiffness
    of_load, of_dry, of_cube = -found.x[:3]
    std = np.sqrt(np.diag(found.covariance)[:3])
    relative = math.hypot(std[0] / of_load, OF_A_RATIO)
    if not (of_load > 0.0 and relative < TIGHT):
        return None
    dry = float(of_dry / of_load) if of_dry > SURE * std[1] else 0.0
    ties = [Tie("stiffness", 1.0 / of_load, relative / of_load)]
    if hardens:
        cube, spread = max(of_cube / of_load, 0.0), std[2] / of_load
        ties.append(Tie("stiffness3", cube, math.hypot(spread, relative * cube)))
    return LoadSide(tuple(ties), dry)
