"""Whether a torque that comes and goes is one of the place, as of something springy that a joint
touches: whether its other visits to that place, however light, predict it there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.measure.acting import LACKING_BAND, lacks_of
from zendsp.diagnosis.measure.bursts import Bursts
from zendsp.diagnosis.measure.discrepancy import as_seen, band_of, reversals
from zendsp.diagnosis.measure.structure import ROWS, TAKEN, ranges_of, shapes, splines, unit
from zendsp.physics.calibration.fit import Data
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

OVER_PLACE = 14  # of a torque over the position
CELLS = 100  # of the position: a joint was in one at other times, or not
# s: an observer forgets within this (its poles at LACKING_BAND), so a shorter stay shows nothing
LEAST_STAY = 2.0 / LACKING_BAND
SAME_VISIT = 0.5  # s: nearer to a time is the same visit
SMOOTHED = 1e-3  # of the mean square of the shapes


@dataclass(frozen=True)
class Visits:
    """What other visits to the places of a torque say of it: the part of its energy at places where
    the joint was at other times too; and the part of that which they predict.
    """

    share: float
    predicted: float


@dataclass(frozen=True)
class _Along:
    """Samples of a recording: what a model lacks, (n,); the shapes that may explain it, (columns,
    n); the cell of the position; the time, s; and whether the joint moves.
    """

    recording: str
    lack: Array
    shapes: Array
    cells: npt.NDArray[np.int_]
    times: Array
    moves: Mask
    step: float

    def at(self, span: tuple[float, float], recording: str, beside: float = 0.0) -> Mask:
        """The samples within a time of a recording, and up to so many s ``beside`` it."""
        if recording != self.recording:
            return np.zeros(len(self.times), bool)
        return (self.times >= span[0] - beside) & (self.times <= span[1] + beside)


def other_visits(found: Bursts, parts: Sequence[Data], model: Model, joint: int) -> Visits:
    """What other visits to its places say of a torque that comes and goes. Functions of the
    position, and their products with the speed, are fitted to all other times, beside what
    calibration may have bent. They do not predict a push, as other visits are free of it; nor
    anything where the joint was there for less than an observer's memory.
    """
    along = _along(parts, model, joint)
    whole = there = energy = gained = seconds = 0.0
    for span, name in zip(found.intervals, found.recordings, strict=True):
        rest = [~a.at(span, name, SAME_VISIT) for a in along]
        seen = np.unique(np.concatenate([a.cells[use] for a, use in zip(along, rest, strict=True)]))
        bent, full = (_fitted(along, rest, few) for few in (True, False))
        for a in along:
            here = a.at(span, name)
            again = here & np.isin(a.cells, seen)
            whole += float(a.lack[here] @ a.lack[here])
            there += float(a.lack[again] @ a.lack[again])
            again &= a.moves
            lack, left = (
                a.lack[again] - th @ a.shapes[: len(th), again] for th in (bent, full)
            )
            energy += float(lack @ lack)
            gained += float(lack @ lack - left @ left)
            seconds += float(again.sum()) * a.step
    enough = seconds > LEAST_STAY and energy > 0.0
    return Visits(there / max(whole, 1e-300), gained / energy if enough else 0.0)


def _along(parts: Sequence[Data], model: Model, joint: int) -> list[_Along]:
    """All recordings, thinned."""
    whole = replace(parts[0], records=tuple(rec for part in parts for rec in part.records))
    ranges, lacks, out = ranges_of(whole, joint), lacks_of(whole, model, joint), []
    stride = max(1, sum(rec[0].n for rec in whole.records) // ROWS)
    for rec, lack, use in zip(whole.records, lacks.lacks, lacks.used, strict=True):
        record = rec[joint - 1]
        q, v, _ = record.motion.states
        place = unit(q, ranges.position)
        along = splines(place, OVER_PLACE)
        raw = np.concatenate([shapes(rec, joint, TAKEN, ranges), along, v / ranges.speed * along])
        rows = np.arange(use.start, use.start + len(lack), stride, dtype=np.int32)
        out.append(
            _Along(
                record.recording,
                lack[rows - use.start],
                as_seen(record, model, LACKING_BAND, raw, rows=rows),
                np.floor(CELLS * place[rows]).astype(int),
                np.asarray(record.t0 + record.sample_time * rows, float),
                ~reversals(record, band_of(record, LACKING_BAND))[rows],
                record.sample_time * stride,
            )
        )
    return out


def _fitted(along: Sequence[_Along], rest: Sequence[Mask], few: bool) -> Array:
    """The numbers of the shapes fitted to the ``rest``, or of the ``few`` that calibration may have
    bent, (columns,).
    """
    size = len(along[0].shapes) - 2 * OVER_PLACE * few
    square, product = np.zeros((size, size)), np.zeros(size)
    for a, there in zip(along, rest, strict=True):
        use = there & a.moves
        drawn = a.shapes[:size, use]
        square += drawn @ drawn.T
        product += drawn @ a.lack[use]
    level = SMOOTHED * float(np.trace(square)) / size
    return np.asarray(np.linalg.solve(square + max(level, 1e-300) * np.eye(size), product))
