"""Held-out evidence: how much better a hypothesis predicts recordings that it was not fitted to, block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.score import Scored, fastest
from zendsp.physics.fit import Data
from zendsp.physics.joint import JointRecord, effective_inertia, run
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

LOST = 1e4  # medians: an innovation beyond says only that the prediction has left the track
BLOCK = 0.25  # s; shorter where the recordings would give fewer than 40 blocks, never below 0.05 s


@dataclass(frozen=True)
class Evidence:
    """Gain in deviance of one hypothesis over another on some recordings: total, and mean over standard error of the blocks."""

    gain: float
    z: float
    blocks: Array

    @property
    def positive(self) -> float:
        """Share of blocks that gain."""
        return float(np.mean(self.blocks > 0)) if len(self.blocks) else 0.0

    @property
    def sign(self) -> float:
        """Standard deviations of the sign test: what a few blocks lose, however much, does not outweigh that nearly all gain."""
        return (2.0 * self.positive - 1.0) * float(np.sqrt(len(self.blocks)))


def point_deviance(data: Data, model: Model, joint: int) -> list[Array]:
    """-2 log density of each sample that counts, per recording, with the noise scale that suits these recordings best."""
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
    """Absolute innovations, drawn in where the prediction has left the track, (n,)."""
    r = np.abs(run(record, model, data.bandwidth[record.joint - 1], inner=data.inner).innovations)
    usual = float(np.median(r[record.counted])) if record.counted.any() else 1.0
    return np.asarray(np.minimum(r, LOST * max(1.0, usual)))


def compare(before: Scored, after: Scored, test: Data, joint: int) -> Evidence:
    """Evidence for ``after`` over ``before`` on recordings that neither was fitted to.

    Parameters
    ----------
    before, after : Scored
        Each predicts with its own observer, as found in its own fit, or with a faster one.
    test : Data
    joint : int
        1-based.

    Returns
    -------
    Evidence
    """
    a = _points(before, test, joint)
    b = _points(after, test, joint)
    return evidence([x - y for x, y in zip(a, b, strict=True)], test, settle=_settling(before, after, joint))


def compare_errors(before: Scored, after: Scored, test: Data, joint: int) -> Evidence:
    """As ``compare`` by the squared errors alone, both predicted by the observer of ``after`` (Diebold and Mariano 1995).

    What acts at a few instants only is spread by a likelihood over all the others, through the scale of the noise; here, what both
    predict alike counts for nothing.
    """
    data = test.at_bandwidth(joint, after.data.bandwidth[joint - 1])
    errors = []
    for scored in (before, after):
        errors.append([_sizes(data, rec[joint - 1], scored.model) ** 2 for rec in data.records])
    count = sum(int(rec[joint - 1].counted.sum()) for rec in data.records)
    scale = max(sum(float(x.sum()) for x in errors[1]) / max(count, 1), 1e-9)
    return evidence([(x - y) / scale for x, y in zip(*errors, strict=True)], data, settle=_settling(before, after, joint))


def _settling(before: Scored, after: Scored, joint: int) -> float:
    """Share of a recording in which an observer settles; a load behind a spring, whose own state nobody measured, rings longer."""
    return 0.3 if any(t.effect in ("elasticity", "backlash") for m in (before.model, after.model) for t in m.at(joint)) else 0.1


def _points(scored: Scored, test: Data, joint: int) -> list[Array]:
    """Per recording, with the observer of the fit or a faster one, whichever suits these recordings best.

    How much noise the world adds belongs to a recording, not to a hypothesis; a slow observer that misses one contact or one start
    from rest never finds the track again.
    """
    bandwidth, best, least = scored.data.bandwidth[joint - 1], None, np.inf
    while best is None or bandwidth <= fastest(test):
        points = point_deviance(test.at_bandwidth(joint, bandwidth), scored.model, joint)
        total = sum(float(p.sum()) for p in points)
        if best is None or total < least:
            best, least = points, total
        bandwidth *= 2
    return best


def evidence(differences: Sequence[Array], data: Data, settle: float = 0.1) -> Evidence:
    """Blocks of summed differences, their total and z; at most the share ``settle`` of each recording is left out at its beginning."""
    blocks = []
    seconds = sum(rec[0].n * rec[0].sample_time for rec in data.records)
    block = min(BLOCK, max(0.05, seconds / 40))
    for d, rec in zip(differences, data.records, strict=True):
        size = max(10, round(block / rec[0].sample_time))
        skip = min(size, len(d) // 10) if settle <= 0.1 else round(settle * len(d))
        usable = d[skip:]
        count = len(usable) // size
        if count:
            blocks.append(usable[: count * size].reshape(count, size).sum(axis=1))
    values = np.concatenate(blocks) if blocks else np.zeros(1)
    if len(values) < 2:
        return Evidence(float(values.sum()), 0.0, values)
    # a few blocks where either model loses the track must not decide: values beyond ten median deviations are drawn in
    width = 10 * max(float(np.median(np.abs(values))), 1e-12)
    drawn = np.clip(values, -width, width)
    error = float(np.std(drawn, ddof=1)) * np.sqrt(len(drawn))
    return Evidence(float(drawn.sum()), float(drawn.sum()) / error if error > 0 else 0.0, values)


def torque_share(before: Scored, after: Scored, joint: int, bandwidth: float = 32.0) -> float:
    """How large the difference between two hypotheses is as a torque, relative to the torque in the recording (RMS over RMS).

    An observer's correction of the velocity is a torque; the two hypotheses are corrected by the same observer.
    """
    squares, count, scale = 0.0, 0, 1.0
    for rec in before.data.records:
        record = rec[joint - 1]
        _, k2, w = record.gains(bandwidth)
        inertia = effective_inertia(record, before.model)
        a = run(record, before.model, bandwidth, inner=before.data.inner).innovations
        b = run(record, after.model, bandwidth, inner=before.data.inner).innovations
        difference = np.where(w > 0, (a - b) / np.maximum(w, 1e-300), 0.0) * k2 * inertia / record.sample_time
        skip = min(record.n // 10, round(0.5 / record.sample_time))
        squares += float(np.sum(difference[skip:] ** 2))
        count += record.n - skip
        scale = max(record.scale.torque, 1e-300)
    return float(np.sqrt(squares / max(count, 1))) / scale


def unmodelled_torque(scored: Scored, joint: int) -> float:
    """Process noise that a model needs, as a torque within the observer's band relative to the RMS torque of the recording.

    An observer of bandwidth w stands for white acceleration of w² sqrt(R) a sample, of which the band holds sqrt(w T).
    """
    bandwidth = scored.data.bandwidth[joint - 1]
    record = scored.data.records[0][joint - 1]
    m = record.measurement
    white = (
        m.resolution**2 / 12 + m.noise**2
        if m.resolution > 0 or m.noise > 0
        else float(np.median(np.abs(m.variance)))
    )
    inertia = float(np.mean(effective_inertia(record, scored.model)))
    return (
        float(inertia * bandwidth**2 * np.sqrt(white) * np.sqrt(bandwidth * record.sample_time))
        / record.scale.torque
    )
