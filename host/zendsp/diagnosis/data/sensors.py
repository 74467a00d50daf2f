"""The sensors beside the position: which columns are used, and why others are not.

A column without information of its own (a constant, a difference of the position, a multiple of the
command) becomes NaN at that joint, with a note.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import RecordingError
from zendsp.physics.kernel.smooth import moving_mean
from zendsp_protocol.texts import counted

Array = npt.NDArray[np.float64]

SENSED = ("velocity", "current", "position_load", "torque_measured")
SAME = 1e-3  # of its RMS: a velocity this near to a difference of positions is one
# correlation above which sign and unit of two sensors are compared, and the ratio of their motions
# that means another unit, since no spring stretches a whole motion so much. Both chosen: degrees
# are 57 times, a wrong sign correlates by -1
ALIKE_SIDES, SIDES_APART = 0.7, 3.0
SCALED = 0.05  # of its slope: a velocity further from the position's has another unit
FOLLOWS = 0.01  # of its RMS below 25 Hz: a current this near to the command follows it
EXACT = 1e-6  # of its size: a current this near to a multiple of the command is computed
TIMED = 0.5  # of a difference in RMS: less remains of one in time alone; decides only a wording
# a reading is lost where it stays while the joint moves on, or is none. It ends in a step between
# the two sensors that is larger than so many usual ones (their 98th percentile), and that takes
# back most of the difference; a load that is jerked goes on. A sensor that loses more of its rows
# than this is not used
DROPPED, USUAL, TAKEN_BACK, LOST = 8.0, 0.98, 0.5, 0.01
AVERAGED = 0.02  # s, of the mean that removes noise and sampling from a comparison


def read_sensed(name: str, role: str, get: Callable[[str], Any], spec: Any, shape: Any) -> Array:
    """One of ``SENSED`` from a recording, (n, joints); NaN at joints without: a column of NaN, or
    an empty name.

    Raises
    ------
    RecordingError
        Wrong number of rows or columns, or some values that are not finite.
    """
    n, joints = shape
    parts = []
    for item in spec if isinstance(spec, list) else [spec]:
        part = np.asarray(get(str(item)), float) if item else np.full(n, np.nan)
        parts.append(part[:, None] if part.ndim == 1 else part)
    same = all(len(part) == n for part in parts)
    values = np.concatenate(parts, axis=1) if same else np.zeros((0, 0))
    if values.shape != (n, joints):
        got = values.shape if same else tuple(len(part) for part in parts)
        raise RecordingError(
            f"{name}: {role} {spec!r} has shape {got}; expected {counted(n, 'row')} and"
            f" {counted(joints, 'column')}, one"
            ' a joint ("" for a joint without)'
        )
    for j in range(joints):
        bad = ~np.isfinite(values[:, j])
        if bad.any() and not bad.all():
            raise RecordingError(
                f"{name}: {role} of joint {j + 1} has {int(bad.sum())} values that are not finite"
                f" numbers (first in row {int(np.argmax(bad)) + 1}); expected none, or NaN"
                " throughout for a joint without this sensor"
            )
    return values


def judged(
    role: str, values: Array, position: Array, command: Array, sample_time: float
) -> tuple[Array, list[str]]:
    """A sensor's columns with NaN where they are not used, and a note for each of these.

    Parameters
    ----------
    role : str
        One of ``SENSED``.
    values, position, command : ndarray, shape (n, joints)
    sample_time : float
        s.
    """
    out = values.copy()
    reasons: dict[str, list[int]] = {}
    notes = []
    for j in range(values.shape[1]):
        x = values[:, j]
        if not np.isfinite(x).all():
            continue
        if float(np.ptp(x)) <= 1e-12 * max(1.0, float(np.max(np.abs(x)))):
            why = "it is constant"
        elif role == "velocity":
            why = _velocity(x, position[:, j], sample_time)
        elif role == "current":
            why = _current(x, command[:, j], sample_time)
        elif role == "position_load":
            lost = _dropped(x, position[:, j])
            share, first = float(np.mean(lost)), int(np.argmax(lost)) + 1
            if share < LOST:
                x = out[:, j] = _bridged(x, position[:, j], lost)
                why = _beyond(x, position[:, j])
            else:
                why = f"it drops out in {100 * share:.2g} % of its rows (first in row {first})"
            if lost.any() and not why:
                notes.append(
                    f"{role} of joint {j + 1} dropped out in {counted(int(lost.sum()), 'row')}"
                    f" (first in row {first}): they are filled in from those around them"
                )
        else:
            continue
        if why:
            out[:, j] = np.nan
            reasons.setdefault(why, []).append(j + 1)
    for why, joints in reasons.items():
        where = f"joint{'s' if len(joints) > 1 else ''} {', '.join(map(str, joints))}"
        notes.append(f"{role} of {where} was not used: {why}")
    return out, notes


def _mean(x: Array, sample_time: float) -> Array:
    width = max(1, round(AVERAGED / sample_time))
    return moving_mean(moving_mean(x, width), width)


def _velocity(x: Array, q: Array, sample_time: float) -> str:
    """The reason that a velocity is not used; there always is one, since the fit predicts
    positions.
    """
    size = float(np.sqrt(np.mean(x**2)))
    steps = np.diff(q) / sample_time
    ways = (np.gradient(q, sample_time), np.r_[steps, steps[-1]], np.r_[steps[0], steps])
    if min(float(np.sqrt(np.mean((x - w)[1:-1] ** 2))) for w in ways) < SAME * size:
        return "it is the difference of the position column"
    a, b = _mean(x, sample_time), _mean(ways[0], sample_time)
    slope = float(a @ b) / max(float(b @ b), 1e-300)

    def off(by: Array) -> float:
        return float(np.sqrt(np.mean(by**2))) / max(size, 1e-300)

    apart = off(a - slope * b)
    if abs(slope - 1.0) > SCALED:
        return (
            f"it is {slope:.3g} times the velocity of the position column: another unit, or the"
            " motor's before its gear?"
        )
    if apart < SAME:
        return "below 25 Hz it is the difference of the position column"
    both = np.stack([b, -np.gradient(b, sample_time)], axis=1)
    of = np.linalg.lstsq(both, a, rcond=None)[0]
    if off(a - both @ of) < TIMED * apart:
        late = 1e3 * float(of[1] / of[0])
        when = f"{late:.2g} ms late, as behind a filter" if late > 0 else f"{-late:.2g} ms early"
        return f"it is the position's velocity, {when}; the fit predicts positions"
    within = 5 * math.ceil(20 * apart)  # %: joints that hardly differ are told together
    return (
        f"it is the position's velocity to {within} % below 25 Hz, and the fit predicts positions"
    )


def _beyond(x: Array, q: Array) -> str:
    """The reason that a position beyond the transmission is not used; empty where it follows the
    motor's.
    """
    a, b = x - np.mean(x), q - np.mean(q)
    alike = float(a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-300)
    slope = float(np.linalg.norm(a)) / max(float(np.linalg.norm(b)), 1e-300)
    if abs(alike) < ALIKE_SIDES:  # within a gap the load may stand still
        return ""
    if alike < 0.0:
        return "it runs against the position column: the sign of one of them is wrong"
    if max(slope, 1.0 / max(slope, 1e-300)) > SIDES_APART:
        return (
            f"it moves {slope:.3g} times as far as the position column: degrees for rad, or the"
            " motor's side for the load's?"
        )
    return ""


def _dropped(x: Array, q: Array) -> npt.NDArray[np.bool_]:
    """The rows at which a position beyond the transmission dropped out, (n,): readings of zero, or
    the last one over and over, which end in a jump against the motor's position.
    """
    apart = x - q
    step = np.abs(np.diff(apart))
    far = np.r_[False, step > DROPPED * float(np.quantile(step, USUAL))]
    new = np.flatnonzero(np.diff(x) != 0) + 1
    out = np.zeros(len(x), bool)
    for first, end in zip(np.r_[0, new], np.r_[new, len(x)], strict=True):
        if first > 0 and end < len(x) and far[end] and (far[first] or end - first > 1):
            out[first:end] = abs(apart[end] - apart[first - 1]) < TAKEN_BACK * step[end - 1]
    return out


def _bridged(x: Array, q: Array, lost: npt.NDArray[np.bool_]) -> Array:
    """The position with the rows that it lost: as far from the motor's as those around them."""
    rows = np.arange(len(x))
    return np.where(lost, q + np.interp(rows, rows[~lost], (x - q)[~lost]), x)


def _current(x: Array, u: Array, sample_time: float) -> str:
    """The reason that a current is not used; empty where it shows that the drive follows its
    command.
    """
    if not np.any(u):
        return "there is no command beside it"
    basis = np.stack([u, np.ones_like(u)], axis=1)
    exact = x - basis @ np.linalg.lstsq(basis, x, rcond=None)[0]
    size = float(np.std(x))
    if float(np.std(exact)) < EXACT * size:
        return "it is the command times a constant, no measurement of its own"
    y = _mean(x, sample_time)
    apart = math.inf
    for told in (u, np.r_[u[:1], u[:-1]]):  # it may still follow the row before
        slow = np.stack([_mean(told, sample_time), np.ones_like(u)], axis=1)
        left = y - slow @ np.linalg.lstsq(slow, y, rcond=None)[0]
        apart = min(apart, float(np.std(left)) / max(float(np.std(y)), 1e-300))
    if apart > FOLLOWS:
        return (
            f"it differs from the command by {100 * apart:.2g} % below 25 Hz, so the drive does not"
            " do what it is told; name it as [columns] command, with the torque constant as"
            " [actuator] gain, to see the mechanics alone"
        )
    return ""
