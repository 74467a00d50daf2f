"""A joint of an arm that is not where its sensor says, as after homing elsewhere: all torques are
those of an arm that is turned at this joint.

It is a hypothesis among those about bodies. Where no body predicts as well, the zero is a matter of
calibration: it is estimated, and the diagnosis is made with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.search.body_columns import Layout, Sums, by_zeros
from zendsp.diagnosis.search.body_explain import Explained, clear, seen
from zendsp.diagnosis.search.body_hypotheses import (
    LIMITS,
    BodyLimits,
    turned_joints,
    zeros,
)
from zendsp.diagnosis.search.body_numbers import weights_by
from zendsp.diagnosis.search.body_solver import Solver
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.model import Model, per_joint
from zendsp.physics.robots.bodies import Links
from zendsp.physics.term_numbers import kernel_model

Array = npt.NDArray[np.float64]


@dataclass
class OtherZero(Exception):
    """Joints have other zeros, and no body predicts as well.

    ``angles``: by joint (from 1), rad by which it is farther along than recorded; roughly.
    ``bandwidth``: rad/s, of the observers that see it.
    """

    angles: dict[int, float]
    bandwidth: float


def check_zero(data: Data, model: Model, best: Explained, limits: BodyLimits) -> None:
    """Raise ``OtherZero`` where the best explanation is one of a size that matters."""
    h = best.hypothesis
    if h.effect != "zero" or not (seen(best, limits) or clear(best, limits)):
        return
    # each torque of an arm follows from all of its angles, so another zero makes none less likely
    if np.any(best.joints < -limits.share * best.gain):
        return
    sure = np.abs(best.values) > limits.sure * best.std
    found = zip(turned_joints(h), best.values.tolist(), sure, strict=False)  # beside calibration
    angles = {joint: angle for joint, angle, known in found if known}

    def torque(links: Links, record: JointRecord) -> Array:
        columns = by_zeros(links, model, angles)[record.joint - 1]
        return np.asarray(sum(angle * columns[joint - 1] for joint, angle in angles.items()))

    if angles and np.max(weights_by(data, torque)) > limits.least:
        raise OtherZero(angles, limits.bandwidth)


def with_zero(
    given: Model, other: OtherZero, recorded_with: Callable[[Model], Data], jobs: int
) -> tuple[Model, dict[int, tuple[float, float]]]:
    """The given model with the zeros that the recordings have; by how much each joint is farther
    along than they say, and the standard deviation, rad.

    ``recorded_with``: the recordings, read by a model.
    """
    angles = np.array(list(other.angles.values()))
    std = np.full(len(angles), np.inf)
    for _ in range(LIMITS.rounds):
        model = _moved(given, other, angles)
        further, std = _estimate(recorded_with(model), model, other, jobs)
        angles = angles + further
        if np.all(np.abs(further) < LIMITS.moves * std):
            break
    each = zip(angles.tolist(), std.tolist(), strict=True)
    return _moved(given, other, angles), dict(zip(other.angles, each, strict=True))


def _moved(given: Model, other: OtherZero, angles: Array) -> Model:
    offset = [per_joint(given.sensor.offset, j + 1, 0.0) for j in range(given.joints)]
    for joint, angle in zip(other.angles, angles.tolist(), strict=True):
        offset[joint - 1] += angle
    return replace(given, sensor=replace(given.sensor, offset=tuple(offset)))


def _estimate(data: Data, model: Model, other: OtherZero, jobs: int) -> tuple[Array, Array]:
    links = data.records[0][0].links
    assert links is not None
    model = kernel_model(model)
    limits = replace(LIMITS, bandwidth=other.bandwidth)
    sums = Sums(data, model, limits, jobs)
    solver = Solver(sums, sums, Layout(model, links), limits)
    h = zeros(list(other.angles), model)
    values, turned = solver.estimate(h), len(other.angles)
    return values[:turned], solver.std(h, values)[:turned]
