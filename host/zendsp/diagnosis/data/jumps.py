"""Steps of a position that no motion makes: single rows that stand out, and a counter that begins
anew.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from zendsp.physics.kernel.signals import ALL_OF_RANGE
from zendsp.physics.kernel.smooth import moving_median

Array = npt.NDArray[np.float64]

JUMP_QUANTILE = 0.999  # of the steps: a fast step of the motion
JUMP_USUAL, JUMP_NEAR = 8, 20  # times that, and times the median step around it: a jump
JUMP_COUNTS = 6  # of the sensor
JUMP_SPAN = 0.004  # of the position's span
JUMP_ROWS = 20  # before a jump, and after it, that show the usual step there
BACK = 0.1  # of a jump: most that the next row leaves of a spike: chosen, not measured
LASTING_ROWS = 5  # rows: a fast motion lasts longer than half of them, a spike and a jump do not
RARE_ROWS = 0.01  # of the rows at most: a sensor with more of them is not to be mended


def stands_out(
    step: Array, k: int, span: float, count: float, usual: float, rows: int = 1
) -> bool:
    """Whether a step is a jump: a speed of one sample that the motion around it does not have.

    Parameters
    ----------
    step : ndarray, shape (n,)
        Differences of a position, rad or m.
    k : int
        Which of them.
    span : float
        Of the position.
    count : float
        Of the sensor, 0 where it has none.
    usual : float
        A fast step of the motion.
    rows : int
        Steps that belong to it: 2 of a row that stands out and goes back.
    """
    around = (step[max(0, k - JUMP_ROWS) : k], step[k + rows : k + rows + JUMP_ROWS])
    near = max((float(np.median(np.abs(x))) for x in around if len(x)), default=0.0)
    least = (JUMP_USUAL * usual, JUMP_COUNTS * count, JUMP_NEAR * near, JUMP_SPAN * span)
    return bool(abs(step[k]) > max(least))


def _lasting(step: Array) -> float:
    """A fast step of the motion, without steps that stand alone."""
    return float(np.quantile(moving_median(np.abs(step), LASTING_ROWS), JUMP_QUANTILE))


def without_spikes(y: Array, count: float) -> tuple[Array, list[int]]:
    """A position without single rows that stand out and go back: there the line between the
    neighbours stands; and those rows, from 0. None where more than one in a hundred does.
    """
    step = np.diff(y)
    jump = np.abs(step)
    goes_back = np.abs(step[:-1] + step[1:]) < BACK * np.minimum(jump[:-1], jump[1:])
    usual, span = _lasting(step), float(np.ptp(y))
    least = max(JUMP_COUNTS * count, JUMP_USUAL * usual)
    rows = [
        int(k) + 1
        for k in np.flatnonzero(goes_back & (jump[:-1] > least))
        if stands_out(step, int(k), span, count, usual, rows=2)
    ]
    if len(rows) > RARE_ROWS * len(y):
        return y, []
    out = y.copy()
    for k in rows:
        out[k] = 0.5 * (y[k - 1] + y[k + 1])
    return out, rows


def counter_range(y: Array, count: float) -> float:
    """The range after which a sensor's counter begins anew, in units of the position; 0 where it
    does not.
    """
    step, span = np.diff(y), float(np.ptp(y))
    usual = _lasting(step)
    jumps = np.flatnonzero(np.abs(step) > ALL_OF_RANGE * span)
    if len(jumps) < 2 or ALL_OF_RANGE * span < max(JUMP_USUAL * usual, JUMP_COUNTS * count):
        return 0.0
    # the joint moves on by a step as its neighbours, against the jump
    beside = 0.5 * (step[np.maximum(jumps - 1, 0)] + step[np.minimum(jumps + 1, len(step) - 1)])
    ranges = np.abs(step[jumps] - beside)
    size = float(np.median(ranges))
    # a sensor that drops out reads one value, and is back elsewhere
    between = zip(jumps[:-1] + 1, jumps[1:] + 1, strict=True)
    dropped = any(b - a >= LASTING_ROWS and np.ptp(y[a:b]) == 0.0 for a, b in between)
    if dropped or np.max(np.abs(ranges - size)) > usual + count:
        return 0.0
    if count <= 0:
        return size
    whole = size / count
    binary = 2.0 ** np.round(np.log2(whole))  # what an overflow is, unless a gear is between
    return float(count * (binary if abs(binary - whole) * count <= usual + count else round(whole)))
