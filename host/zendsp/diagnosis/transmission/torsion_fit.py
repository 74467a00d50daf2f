"""Least squares of torsion: the columns of each term, the fit, its numbers and its evidence.

Errors of the sensor pair are removed from each recording: its zero, a lag of one column, and, where
a turn was not completed, an eccentric disc.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from zendsp.diagnosis.data.series import repeats
from zendsp.diagnosis.measure.discrepancy import deviation
from zendsp.diagnosis.measure.evidence import BLOCK, Evidence
from zendsp.diagnosis.transmission.torsion import Array, Twist, judged

GAP_CROSSED = 0.1  # of the RMS torque: range over which a gap is crossed
# of the RMS torque: levels at which parts held by a transmission's friction yield (Prandtl's model)
YIELDS = (0.15, 0.4, 1.0)
# columns of a term, and its number from their coefficients
TERMS: dict[str, tuple[float, ...]] = {
    "spring": (1.0, 0.0),
    "cubic": (1.0,),
    "gap": (1.0,),
    "step": (1.0,),
    "loop": YIELDS,
    "disc": (1.0, 0.0),
}


def nuisance(twist: Twist, off_centre: bool) -> Array:
    """Columns of the sensors' own errors, (n, columns) of the kept rows, orthonormal."""
    columns = [np.ones_like(twist.q), twist.qd]
    if off_centre:
        columns += [np.sin(twist.q), np.cos(twist.q)]
    matrix = np.stack(columns, axis=1)[twist.kept]
    norms = np.linalg.norm(matrix, axis=0)
    return np.asarray(np.linalg.qr(matrix / np.where(norms > 0, norms, 1.0))[0])


def gap_shape(torque: Array) -> Array:
    """The side on which a gap is closed, -1 … 1."""
    size = float(np.sqrt(np.mean(torque**2)))
    return np.asarray(np.tanh(torque / (GAP_CROSSED * max(size, 1e-300))))


def columns_of(twist: Twist, terms: Sequence[str], scale: float) -> Array:
    """Columns of some terms, (n, columns) of the kept rows.

    ``spring``: torque and its damping; ``cubic``; ``gap``; ``step`` with direction; ``loop``: what
    yields with the torque later than the spring; ``disc``: an eccentric one, or torque over the
    position that bends the spring and is not in the model's. Errors over the angle are made by
    ``wave``.
    """
    made: dict[str, Callable[[], list[Array]]] = {
        "spring": lambda: [twist.torque, twist.extra.get("rate", twist.q)],
        "cubic": lambda: [twist.torque * (twist.torque / scale) ** 2],
        "gap": lambda: [gap_shape(twist.torque)],
        "step": lambda: [twist.extra.get("direction", twist.q)],
        "loop": lambda: [play(twist.torque, part * scale) for part in YIELDS],
        "disc": lambda: [np.sin(twist.q), np.cos(twist.q)],
    }
    listed = [column for term in terms for column in made[term]()]
    if not listed:
        return np.zeros((int(twist.kept.sum()), 0))
    return np.stack(listed, axis=1)[twist.kept]


def play(torque: Array, yields: float) -> Array:
    """A play operator of the torque: it follows a reversal only beyond twice ``yields``, (n,)."""
    out, at = [], 0.0
    for here in torque.tolist():  # Python floats are five times faster
        at = max(here - yields, min(here + yields, at))
        out.append(at)
    return np.array(out)


def wave(twist: Twist, order: float) -> Array:
    """Sine and cosine of an order over the angle, (n, 2) of the kept rows."""
    angle = order * twist.q[twist.kept]
    return np.stack([np.sin(angle), np.cos(angle)], axis=1)


@dataclass(frozen=True)
class Linear:
    """A least-squares fit: coefficients with their covariance, and the residual of each recording.
    """

    x: Array
    covariance: Array
    residual: list[Array]


def numbers_of(terms: Sequence[str], fit: Linear, scale: float) -> dict[str, tuple[float, float]]:
    """The numbers of some terms with standard deviations: compliance at large torques, half a gap,
    half the width of a hysteresis at zero torque.
    """
    at = np.cumsum([0, *(len(TERMS[t]) for t in terms)])
    out = {}
    for term, begin in zip(terms, at[:-1], strict=True):
        weights = np.zeros(len(fit.x))
        weights[begin : begin + len(TERMS[term])] = np.array(TERMS[term]) * (
            scale if term == "loop" else 1.0
        )
        if term == "spring" and "loop" in terms:  # where all of it has yielded
            weights[at[terms.index("loop")] :][: len(YIELDS)] = 1.0
        spread = math.sqrt(max(float(weights @ fit.covariance @ weights), 0.0))
        out[term] = float(weights @ fit.x), spread
    return out


def regress(
    twists: Sequence[Twist], columns: Sequence[Array], off_centre: bool, known: Array | None = None
) -> Linear:
    """A least-squares fit of torsion to columns, with the sensors' own errors removed from each
    recording; ``known`` coefficients are only applied.
    """
    left, right = [], []
    for twist, matrix in zip(twists, columns, strict=True):
        q = nuisance(twist, off_centre)
        y = twist.torsion[twist.kept]
        left.append(matrix - q @ (q.T @ matrix))
        right.append(y - q @ (q.T @ y))
    a, b = np.concatenate(left), np.concatenate(right)
    norms = np.linalg.norm(a, axis=0)
    norms[norms == 0] = 1.0
    if known is None:
        x = np.linalg.lstsq(a / norms, b, rcond=1e-9)[0] / norms
    else:
        x = known
    residual = [y - m @ x for m, y in zip(left, right, strict=True)]
    r = np.concatenate(residual)
    alike = max(repeats(e, t.sample_time) for e, t in zip(residual, twists, strict=True))
    variance = float(r @ r) / max(len(r) - len(x), 1) * alike
    inverse = np.linalg.pinv((a / norms).T @ (a / norms)) if len(x) else np.zeros((0, 0))
    return Linear(x, variance * inverse / np.outer(norms, norms), residual)


def evidence(
    before: Sequence[Array], after: Sequence[Array], twists: Sequence[Twist]
) -> tuple[Evidence, float]:
    """The gain in log density of one set of residuals over another, and the logarithm of the
    e-value, by the rule of ``measure/evidence.py``.
    """
    points = []
    before, after = judged(twists, before), judged(twists, after)
    for parts in (before, after):
        r = np.concatenate(parts)
        scale = max(float(r @ r) / max(len(r), 1), 1e-300)
        points.append([e**2 / scale + np.log(scale) for e in parts])
    blocks = []
    for b, a, twist in zip(*points, twists, strict=True):
        size = max(2, round(BLOCK / twist.sample_time))
        count = len(b) // size
        if count:
            blocks.append((b - a)[: count * size].reshape(count, size).sum(axis=1))
    values = np.concatenate(blocks) if blocks else np.zeros(1)
    gain, error = float(values.sum()), deviation(values)
    z = gain / error if 0 < error < np.inf else 0.0
    alike = max(repeats(e, t.sample_time) for e, t in zip(before, twists, strict=True))
    return Evidence(gain, z, values), 0.5 * gain / alike


def rms(parts: Sequence[Array]) -> float:
    """Root mean square over recordings."""
    r = np.concatenate(parts)
    return float(np.sqrt(np.mean(r**2))) if len(r) else 0.0
