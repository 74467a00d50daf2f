"""Held-out evidence: how much better a hypothesis predicts recordings that it was not fitted to,
block by block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.measure.discrepancy import BANDS, deviation
from zendsp.diagnosis.measure.likelihood import Scored, fastest
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.calibration.predict import run
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

OFF_TRACK = 1e4  # medians: a larger innovation only shows that the prediction has lost track
BLOCK = 0.25  # s; shorter where the recordings would give fewer than 40 blocks, never below 0.05 s
SETTLED_SHARE = 0.1  # of a recording: settling within it costs only a block at the start
# median deviations: a few blocks in which a model loses track must not decide
DRAWN_IN = 10.0
# of -2 log density: a block that gains less says hardly anything. In a recording that mostly rests
# the median block gained 1e-7, which reduced twelve starts from rest, 40 each, to 1e-5
TELLS = 1.0
# share of a recording in which the unmeasured state of a load behind a spring settles
RING = 0.3


@dataclass(frozen=True)
class Evidence:
    """The gain in deviance of one hypothesis over another on some recordings: in total, and in
    standard deviations over blocks of time.
    """

    gain: float
    z: float
    blocks: Array


def compare(before: Scored, after: Scored, test: Data, joint: int) -> Evidence:
    """The evidence for ``after`` over ``before`` on recordings that neither was fitted to.

    Parameters
    ----------
    before, after : Scored
        Each predicts with the observer of its own fit, or a faster one.
    joint : int
        1-based.

    Returns
    -------
    Evidence
        Its z accounts for correlated neighbouring blocks (Newey and West 1987).
    """
    settle = max(settling(before, joint), settling(after, joint))
    return evidence(
        block_scores(before, test, joint, settle) - block_scores(after, test, joint, settle)
    )


def heard_slowly(before: Scored, after: Scored, test: Data, joint: int) -> float:
    """The largest z of ``compare`` over slower observers. Fast disturbances (a controller that
    reacts to encoder counts, stick-slip friction) may make the blocks of fast observers so
    different that they show nothing slow.
    """
    settle = max(settling(before, joint), settling(after, joint))
    most = 0.0
    for band in BANDS:
        if band < min(s.data.bandwidth[joint - 1] for s in (before, after)):
            slow = test.at_bandwidth(joint, band)
            scores = [
                _blocks(point_deviance(slow, s.model, joint), slow, settle) for s in (before, after)
            ]
            most = max(most, evidence(scores[0] - scores[1]).z)
    return most


def evidence(values: Array) -> Evidence:
    """The evidence from the gain of each block."""
    if len(values) < 2:
        return Evidence(float(values.sum()), 0.0, values)
    width = DRAWN_IN * max(float(np.median(np.abs(values))), TELLS)
    drawn = np.clip(values, -width, width)
    error = deviation(drawn)
    return Evidence(float(drawn.sum()), float(drawn.sum()) / error if error > 0 else 0.0, values)


def settling(scored: Scored, joint: int) -> float:
    """The share of a recording in which an observer of a model settles."""
    return (
        RING
        if any(get_effect(t.effect).family == "transmission" for t in scored.model.at(joint))
        else 0.1
    )


def block_scores(scored: Scored, data: Data, joint: int, settle: float = 0.1) -> Array:
    """-2 log density of each block of time, all recordings one after the other. At most the share
    ``settle`` of each is left out.

    The observer is that of the fit or a faster one, whichever suits these recordings best. Process
    noise belongs to a recording, not to a hypothesis; and a slow observer that misses one contact
    or one start from rest never recovers.
    """
    bandwidth = scored.data.bandwidth[joint - 1]
    best: list[Array] | None = None
    least = np.inf
    while best is None or bandwidth <= fastest(data):
        points = point_deviance(data.at_bandwidth(joint, bandwidth), scored.model, joint)
        total = sum(float(p.sum()) for p in points)
        if best is None or total < least:
            best, least = points, total
        bandwidth *= 2
    return _blocks(best, data, settle)


def _blocks(points: Sequence[Array], data: Data, settle: float) -> Array:
    """Sums over blocks of time, all recordings one after the other."""
    seconds = sum(rec[0].n * rec[0].sample_time for rec in data.records)
    block = min(BLOCK, max(0.05, seconds / 40))
    out = []
    for d, rec in zip(points, data.records, strict=True):
        size = max(10, round(block / rec[0].sample_time))
        skip = min(size, len(d) // 10) if settle <= SETTLED_SHARE else round(settle * len(d))
        usable = d[skip:]
        count = len(usable) // size
        if count:
            out.append(usable[: count * size].reshape(count, size).sum(axis=1))
    return np.concatenate(out) if out else np.zeros(1)


def point_deviance(data: Data, model: Model, joint: int) -> list[Array]:
    """-2 log density of each sample that counts, per recording, with the noise scale that suits
    these recordings best.
    """
    runs, total, count = [], 0.0, 0
    for rec in data.records:
        record = rec[joint - 1]
        r = _sizes(data, record, model)
        runs.append((record, r))
        total += float(r @ r)
        count += int(record.counted.sum())
    scale = max(total / max(count, 1), 1e-9)
    out = []
    for record, r in runs:
        w = record.gains(data.bandwidth[joint - 1])[2]
        value = r**2 / scale
        counted = record.counted
        value[counted] += np.log(scale) - 2 * np.log(w[counted])
        out.append(value)
    return out


def _sizes(data: Data, record: JointRecord, model: Model) -> Array:
    """Absolute innovations, capped where the prediction has lost track, (n,)."""
    ran = run(record, model, data.bandwidth[record.joint - 1], inner=data.inner, begun=True)
    r: Array = np.abs(ran.innovations)
    if float(np.max(r, initial=0.0)) <= OFF_TRACK:
        return r
    usual = float(np.median(r[record.counted])) if record.counted.any() else 1.0
    return np.asarray(np.minimum(r, OFF_TRACK * max(1.0, usual)))
