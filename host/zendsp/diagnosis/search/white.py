"""Whether what a model leaves is white."""

from __future__ import annotations

import math

import numpy as np

from zendsp.diagnosis.measure.likelihood import Scored
from zendsp.diagnosis.search.short_fits import SETTLED
from zendsp.physics.calibration.predict import run

WHITE = 1.2  # slow variation of the innovations, over that of white noise
# of the samples with a change of the count: with fewer (slow motion), whiteness is not tested
CODES = 0.5
LARGEST_BLOCK = 4.5  # standard deviations: a block of white innovations is not larger


def is_white(scored: Scored, joint: int) -> bool:
    """Whether the innovations of a slow observer are white: no more slow variation than white
    noise, and no block that stands out.
    """
    bandwidth = scored.data.bandwidth[joint - 1]
    if bandwidth > SETTLED:
        return False
    means, total, count = [], 0.0, 0
    for rec in scored.data.records:
        record = rec[joint - 1]
        r = run(record, scored.model, bandwidth, inner=scored.data.inner).innovations[
            record.counted
        ]
        if len(r) < CODES * record.n:
            return False
        size = max(10, round(0.1 / record.sample_time))
        r = r[size : size + (len(r) - size) // size * size]
        means.append(r.reshape(-1, size).sum(axis=1) / math.sqrt(size))
        total += float(r @ r)
        count += len(r)
    sums = np.concatenate(means) / math.sqrt(max(total / max(count, 1), 1e-300))
    return float(np.mean(sums**2)) < WHITE and float(np.max(np.abs(sums))) < LARGEST_BLOCK
