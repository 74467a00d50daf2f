"""The variables on which a missing torque depends: how much of it a mechanism's own variables
predict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.measure.discrepancy import (
    BANDS,
    as_seen,
    band_of,
    deviation,
    energy_blocks,
    kept,
    lacking,
    mean_square,
    noise,
    resisting,
    reversals,
)
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.kernel.native import swung
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]

ROWS = 8000  # rows of a regression
# multiples of the pieces of a function of the state: broad shapes, and narrow ones
DETAILS = (1, 3)
MEMORY = "memory"  # not a mechanism: any mechanism may have memory
# nor this: shapes that the fitted numbers of almost any model may have absorbed
TAKEN = "taken"
SWINGING = (0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)  # Hz
DAMPING = 0.15  # damping ratio: neighbours among these overlap
SHIFTED = 0.5  # s: least shift that brings a torque to another time
DRAWN_BYTES = 5e7  # of shapes of a recording at most: of 40 s at 1 kHz, all
SLOWER = 0.1  # of the sampling rate: fastest swing that the recording shows


def splines(u: Array, count: int) -> Array:
    """Quadratic B-splines over [0, 1], (count, n), by the recurrence of de Boor (1972); importing
    scipy.interpolate would take longer than all of them.
    """
    x = np.clip(u, 0.0, 1.0 - 1e-9)
    knots = np.r_[0.0, 0.0, np.linspace(0, 1, count - 1), 1.0, 1.0]
    piece = np.searchsorted(knots, x, side="right") - 3  # three splines are not 0 there
    before, left, right, after = (knots[piece + k] for k in (1, 2, 3, 4))
    falls, rises = (right - x) / (right - left), (x - left) / (right - left)
    lower, upper = falls / (right - before), rises / (after - left)
    out, at = np.zeros((count, len(x))), np.arange(len(x))
    out[piece, at] = (right - x) * lower
    out[piece + 1, at] = (x - before) * lower + (after - x) * upper
    out[piece + 2, at] = (x - left) * upper
    return out


def _products(a: Array, b: Array) -> Array:
    return np.asarray((a[:, None, :] * b[None, :, :]).reshape(-1, a.shape[1]))


@dataclass(frozen=True)
class Ranges:
    """Ranges of a joint's variables: position, speed, command, and the other joints' positions."""

    position: tuple[float, float]
    speed: float
    command: tuple[float, float]
    others: dict[int, tuple[float, float]]

    @property
    def all(self) -> tuple[object, ...]:
        """All of them, to tell them from other ranges."""
        return self.position, self.speed, self.command, *self.others.items()


def ranges_of(data: Data, joint: int) -> Ranges:
    """The ranges over all recordings."""
    records = [rec[joint - 1] for rec in data.records]
    q = np.concatenate([r.motion.states[0] for r in records])
    v = np.concatenate([np.abs(r.motion.states[1]) for r in records])
    u = np.concatenate([r.command for r in records])
    others = {}
    for other in (joint - 1, joint + 1):
        if 1 <= other <= data.joints:
            p = np.concatenate([rec[other - 1].motion.states[0] for rec in data.records])
            others[other] = (float(p.min()), float(p.max()))
    return Ranges(
        (float(q.min()), float(q.max())),
        max(float(np.quantile(v, 0.98)), 1e-12),
        (float(np.quantile(u, 0.005)), float(np.quantile(u, 0.995))),
        others,
    )


def unit(x: Array, limits: tuple[float, float]) -> Array:
    """Values scaled to their limits: 0 at the lower, 1 at the upper."""
    return np.asarray((x - limits[0]) / max(limits[1] - limits[0], 1e-300))


def shapes(
    rec: Sequence[JointRecord], joint: int, mechanism: str, ranges: Ranges, detail: int = 1
) -> Array:
    """Torques over time, (columns, n), whose sums are all torques of a mechanism, whatever its law:
    functions of its own variables, with ``detail`` times as many pieces along each.
    """
    record = rec[joint - 1]
    q, v, _ = record.motion.states
    place = unit(q, ranges.position)
    sign = np.tanh(v / (0.02 * ranges.speed))
    fast = np.sqrt(np.clip(np.abs(v) / ranges.speed, 0.0, 1.0))
    if mechanism == "position_torque":
        columns = [splines(place, 14 * detail)]
        for other, limits in ranges.others.items():
            there = unit(rec[other - 1].motion.states[0], limits)
            columns.append(_products(splines(place, 5), splines(there, 5)))
        return np.concatenate(columns)
    if mechanism == "dry_friction":
        level = sign * splines(fast, 6 * detail)
        along = _products(sign * splines(place, 8), splines(fast, 3))
        return np.concatenate([level, along, sign * splines(place, 8 * detail)])
    if mechanism == "fluid_friction":
        w = np.clip(v / ranges.speed, -1, 1)
        along = _products(np.stack([w * np.abs(w), w * w]), splines(place, 8))
        return np.concatenate([
            splines(0.5 + 0.5 * w, 8 * detail), along, w * splines(place, 8 * detail)
        ])
    if mechanism == "actuator":
        command = unit(record.command, ranges.command)
        return np.concatenate([splines(command, 10 * detail), command * splines(place, 6)])
    if mechanism == TAKEN:
        a = record.motion.states[2]
        inertia = a / max(float(np.std(a)), 1e-300)
        return np.stack(
            [inertia, v / ranges.speed, sign, np.sin(q), np.cos(q), np.ones_like(q)]
        )
    if mechanism == MEMORY:
        return _swung(record)
    return np.zeros((0, record.n))


def _swung(record: JointRecord) -> Array:
    """The swing of hanging loads: position and speed of damped masses on springs of several
    frequencies, carried along, (columns, n); zero where the sampling is too slow for one. Any
    linear law with memory is nearly a sum of them.
    """
    a, h = record.motion.states[2], record.sample_time
    columns = np.zeros((len(SWINGING), 2, record.n))
    for column, hertz in zip(columns, SWINGING, strict=True):
        if hertz * h < SLOWER:
            w = 2 * np.pi * hertz
            decay, turn = np.exp(-DAMPING * w * h), np.cos(w * np.sqrt(1 - DAMPING**2) * h)
            place = swung(a, h, 2 * decay * turn, -(decay**2))
            column[:] = w**2 * place, w * np.gradient(place, h)
    return columns.reshape(-1, record.n)


STRUCTURED = ("position_torque", "dry_friction", "fluid_friction", "actuator")


@dataclass(frozen=True)
class Structure:
    """The missing torque that a mechanism's own variables predict, on recordings to which the
    prediction was not fitted.

    ``size``: its RMS as a part of the RMS torque. ``share``: its part of the missing energy beyond
    the noise. ``z``: its evidence in standard deviations over blocks of time, large where the gain
    is even. ``apart``: the evidence against the gain by chance with the torque shifted in time; a
    torque that acts seldom gains in few blocks, but not by chance.
    """

    size: float
    share: float
    z: float
    apart: float = 0.0


def structure(
    parts: Sequence[Data],
    model: Model,
    joint: int,
    mechanisms: Sequence[str],
    turning: bool = True,
) -> Structure:
    """The part of the missing torque that is a function of the own variables of some mechanisms.

    Parameters
    ----------
    parts : sequence of Data
        Each part is predicted by a function fitted to all the others (cross-fitting).
    joint : int
        1-based.
    mechanisms : sequence of str
        Of ``STRUCTURED``.
    turning : bool
        Whether what acts where the joint turns round counts.
    """
    known = resisting(parts[0].records[0][joint - 1], model).known
    records = (rec[joint - 1].number for part in parts for rec in part.records)
    key = (*records, tuple(mechanisms), turning)
    if key not in known:
        known[key] = _structure(parts, model, joint, mechanisms, turning)
    found: Structure = known[key]
    return found


def _structure(
    parts: Sequence[Data], model: Model, joint: int, mechanisms: Sequence[str], turning: bool
) -> Structure:
    """The result of ``structure``, computed."""
    best, found_by = Structure(0.0, 0.0, 0.0), None
    whole = replace(parts[0], records=tuple(r for part in parts for r in part.records))
    scale = mean_square(whole, joint)
    ranges = ranges_of(whole, joint)
    shown = {
        d: [[drawn(rec, joint, mechanisms, ranges, d) for rec in part.records] for part in parts]
        for d in DETAILS
    }
    lacks = {band: [lacking(part, model, joint, band) for part in parts] for band in BANDS[:3]}
    noises = {
        band: [[noise(rec[joint - 1], model, band) for rec in part.records] for part in parts]
        for band in BANDS[:3]
    }
    for band, detail in product(BANDS[:3], DETAILS):
        used = [[counted(rec[joint - 1], band, turning) for rec in p.records] for p in parts]
        guesses = _predicted(parts, model, shown[detail], lacks[band], used, joint, band)
        if guesses is None:
            break
        sums, counts, excess = [], [], 0.0
        for part, guess, use, noisy in zip(parts, guesses, used, noises[band], strict=True):
            gains = [
                (lack**2 - (lack - here) ** 2) * there
                for (here, lack), there in zip(guess, use, strict=True)
            ]
            for (_, lack), there, rec, v in zip(guess, use, part.records, noisy, strict=True):
                excess += float(np.sum(((lack**2 - v) * there)[kept(rec[joint - 1], band)]))
            found = energy_blocks(part, gains, joint, band)
            sums.append(found[0])
            counts.append(found[1])
        gained = np.concatenate(sums)
        total, error = float(gained.sum()), deviation(gained)
        z = total / error if error > 0 else 0.0
        size = float(np.sqrt(max(0.0, total) / np.concatenate(counts).sum() / scale))
        if size > best.size and z > 1.0:
            share = min(1.0, total / excess) if excess > 0 else 1.0
            best, found_by = Structure(size, share, z), (guesses, used, joint, band)
    return replace(best, apart=_apart(parts, *found_by)) if found_by else best


def _predicted(
    parts: Sequence[Data],
    model: Model,
    drawn: Sequence[Sequence[Floats]],
    lacks: Sequence[Sequence[Array]],
    used: Sequence[Sequence[npt.NDArray[np.bool_]]],
    joint: int,
    band: float,
) -> list[list[tuple[Array, Array]]] | None:
    """The prediction of each part by the function fitted to all others, as the observer sees it,
    and the missing torque, (n,) each, one pair for each recording; None where there is nothing to
    fit, or no data to fit it to.
    """
    if not drawn[0][0].shape[0]:
        return None
    stride = max(1, sum(rec[0].n for part in parts for rec in part.records) // ROWS)
    normals = [
        _normal([rec[joint - 1] for rec in part.records], model, raw, lack, use, band, stride)
        for part, raw, lack, use in zip(parts, drawn, lacks, used, strict=True)
    ]
    out = []
    for k, part in enumerate(parts):
        others = [n for i, n in enumerate(normals) if i != k]
        square = np.sum([n[0] for n in others], axis=0)
        level = float(np.trace(square)) / len(square)
        if not level > 0.0:  # no sample of the others counts: the joint only reverses
            return None
        theta = np.linalg.solve(
            square + 1e-3 * level * np.eye(len(square)), np.sum([n[1] for n in others], axis=0)
        ).astype(np.float32)
        # an observer is linear: it sees a sum of torques as the sum of what it sees of each
        out.append(
            [
                (as_seen(rec[joint - 1], model, band, theta @ raw)[0], lack)
                for rec, raw, lack in zip(part.records, drawn[k], lacks[k], strict=True)
            ]
        )
    return out


def _apart(
    parts: Sequence[Data],
    guesses: Sequence[Sequence[tuple[Array, Array]]],
    used: Sequence[Sequence[npt.NDArray[np.bool_]]],
    joint: int,
    band: float,
) -> float:
    """The gain of a prediction against its gain by chance, in standard deviations. Chance is
    measured with the missing torque shifted in time by more than the observer's memory.
    """
    total = variance = 0.0
    for part, guess, use in zip(parts, guesses, used, strict=True):
        for (here, lack), there, rec in zip(guess, use, part.records, strict=True):
            record = rec[joint - 1]
            settled = kept(record, band)
            p = np.where(there, here, 0.0)[settled]
            n = len(p)
            with_lack = np.fft.irfft(np.fft.rfft(lack[settled]) * np.conj(np.fft.rfft(p)), n)
            away = min(n // 4, round(max(SHIFTED, 8.0 / band) / record.sample_time))
            moved = with_lack[away : n - away]
            total += 2.0 * float(with_lack[0] - moved.mean())
            variance += 4.0 * float(moved.var())
    return total / float(np.sqrt(variance)) if variance > 0.0 else 0.0


def counted(record: JointRecord, band: float, turning: bool) -> npt.NDArray[np.bool_]:
    """Samples that count, (n,)."""
    return np.ones(record.n, bool) if turning else ~reversals(record, band_of(record, band))


def _normal(
    records: Sequence[JointRecord],
    model: Model,
    drawn: Sequence[Floats],
    lacks: Sequence[Array],
    counted: Sequence[npt.NDArray[np.bool_]],
    band: float,
    stride: int,
) -> tuple[Array, Array]:
    """Normal equations of a part, thinned: squares (m, m) and products (m,) of the shapes
    ``drawn``, as the observer sees them.
    """
    m = drawn[0].shape[0]
    square, product = np.zeros((m, m)), np.zeros(m)
    for raw, lack, record, there in zip(drawn, lacks, records, counted, strict=True):
        use = kept(record, band)
        rows = (np.arange(len(lack), dtype=np.int32)[use][there[use]])[::stride].copy()
        a = as_seen(record, model, band, raw, rows=rows)
        square += a @ a.T
        product += a @ lack[rows]
    return square, product


def drawn(
    rec: Sequence[JointRecord], joint: int, mechanisms: Sequence[str], ranges: Ranges, detail: int
) -> Floats:
    """The shapes of all mechanisms, (m, n), in single precision, since reading them takes longest.
    Those of a mechanism are drawn once: no model changes them.
    """
    made, known = [], rec[joint - 1].shapes
    for mechanism in mechanisms:
        key = (mechanism, detail, ranges.all)
        found = known.get(key)
        if found is None:
            found = shapes(rec, joint, mechanism, ranges, detail).astype(np.float32)
            if sum(other.nbytes for other in list(known.values())) + found.nbytes < DRAWN_BYTES:
                known[key] = found
        made.append(found)
    return made[0] if len(made) == 1 else np.concatenate(made)
