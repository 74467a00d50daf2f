"""What follows from the motion of an arm's links as known so far, whatever springs the arm has: the
mass matrix between them, their weight, the torques of motors and friction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from zendsp.diagnosis.data.prepare import POSES, within_samples
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.calibration.observed import sensed, trace
from zendsp.physics.calibration.predict import run
from zendsp.physics.effects import get_effect
from zendsp.physics.kernel.signals import Array
from zendsp.physics.kernel.smooth import widened
from zendsp.physics.model import Model, per_joint
from zendsp.physics.robots.rigid import bases

Records = tuple[JointRecord, ...]
# A motor may stand that is slower than so many standard deviations of the smoothed speed, and so
# long before and after, s: smoothing rounds off the stop
MAY_STAND, AROUND_A_STOP = 3.0, 0.01
# friction and the like: what else a joint has is a torque of the actuator, or no torque
OF_MOTION = ("torque", "load", "viscous", "dry", "scale", "dry_scale")


@dataclass(frozen=True)
class Path:
    """The motion of an arm's links as known so far, and what follows from it whatever springs the
    arm has.

    Attributes
    ----------
    masses : ndarray, shape (poses, joints, joints)
    at_motors, at_links, unsure : ndarray, shape (n, joints)
        Known torques, and the variance of dry friction where a motor may stand, (N m)² or N².
    lively : ndarray, shape (n,)
        Squares of the accelerations, each joint's over its mean, added up.
    first : int
        The row of the recordings with which it begins.
    """

    rec: Records
    masses: Array
    at_motors: Array
    at_links: Array
    unsure: Array
    seen: tuple[Array, Array, Array]
    every: int
    lively: Array
    first: int = 0

    def liveliest(self, seconds: float) -> Path:
        """The stretch of about this length in which the joints are accelerated most."""
        rows = round(seconds / self.rec[0].sample_time)
        if len(self.lively) <= rows:
            return self
        sums = np.concatenate([[0.0], np.cumsum(self.lively)])
        start = int(np.argmax(sums[rows:] - sums[:-rows]))
        cut = slice(start // self.every * self.every, start + rows)  # a pose is its first row
        seen = tuple(np.ascontiguousarray(x[cut]) for x in self.seen)
        return replace(
            self,
            masses=self.masses[cut.start // self.every : -(-cut.stop // self.every)],
            at_motors=self.at_motors[cut],
            at_links=self.at_links[cut],
            unsure=self.unsure[cut],
            seen=(seen[0], seen[1], seen[2]),
            lively=self.lively[cut],
            first=self.first + cut.start,
        )


def path_along(rec: Records, data: Data, model: Model, motion: Array) -> Path:
    """The motion of an arm's links, (joints, 3, n), as a ``Path``."""
    every = max(1, round(POSES / rec[0].sample_time))
    shift = [per_joint(model.sensor.offset, r.joint, 0.0) - r.base_offset for r in rec]
    value, half, variance = (
        np.ascontiguousarray(np.stack([getattr(r.measurement, name) for r in rec], axis=1))
        for name in ("value", "half", "variance")
    )
    value += np.array(shift) - np.stack([_sensor_error(r, model) for r in rec], axis=1)
    masses = masses_along(rec, model, motion[:, :, ::every])
    torques = _torques(rec, data, model, motion)
    squares = np.square(motion[:, 2])
    lively = (squares / np.maximum(squares.mean(axis=1, keepdims=True), 1e-300)).sum(axis=0)
    return Path(rec, masses, *torques, (value, half, variance), every, lively)


def rigid_along(rec: Records, model: Model, motion: Array) -> list[tuple[Array, Array]]:
    """Inertia and bias of each joint along a motion of all links, (joints, 3, m)."""
    base, nothing = bases(model, list(motion)), np.zeros(motion.shape[2])
    return [
        replace(
            r, command=nothing, others=motion, basis=b, first=0, every=1, _thinned=None, _once={},
            links=None if r.links is None else replace(r.links, motion=motion),
        ).inertia_and_bias(model)
        for r, b in zip(rec, base, strict=True)
    ]  # fmt: skip


def masses_along(rec: Records, model: Model, motion: Array) -> Array:
    """Mass matrices of the links at the poses of a motion, (m, joints, joints)."""
    still = motion.copy()
    still[:, 1:] = 0.0
    weight = rigid_along(rec, model, still)
    out = np.empty((motion.shape[2], len(rec), len(rec)))
    for i in range(len(rec)):
        pushed = still.copy()
        pushed[i, 2] = 1.0
        for j, (inertia, bias) in enumerate(rigid_along(rec, model, pushed)):
            out[:, j, i] = inertia if i == j else bias - weight[j][1]
    return 0.5 * (out + out.transpose(0, 2, 1))


def _torques(
    rec: Records, data: Data, model: Model, motion: Array
) -> tuple[Array, Array, Array]:
    """The torques of a ``Path`` at motors and links, and the variance of dry friction."""
    still = motion.copy()
    still[:, 2] = 0.0
    rigid = rigid_along(rec, model, still)
    at_links = -np.stack([bias for _, bias in rigid], axis=1)
    at_motors, unsure = np.empty_like(at_links), np.zeros_like(at_links)
    for j, record in enumerate(rec):
        states = within_samples(record.motion.states, record.sample_time)
        band = data.bandwidth[j]
        driven = run(record, model, band, inner=data.inner, states="seen").torque
        assert driven is not None
        at_motors[:, j] = driven
        terms = tuple(t for t in model.at(j + 1) if get_effect(t.effect).site in OF_MOTION)
        if not terms:
            continue
        slow = MAY_STAND * float(np.sqrt(np.median(record.motion.variances[1])))
        moving = replace(record, motion=replace(record.motion, states=states))
        at_motors[:, j] -= trace(moving, model, terms, 0.1 * slow)
        level = sum(t.value("level") for t in terms if get_effect(t.effect).site == "dry")
        around = round(AROUND_A_STOP / record.sample_time)
        unsure[:, j] = level**2 * widened(np.abs(states[1]) < slow, around)
    return at_motors, at_links, unsure


def _sensor_error(record: JointRecord, model: Model) -> Array:
    """The error that the position sensor adds to the measured motion, (n,)."""
    terms = tuple(t for t in model.at(record.joint) if get_effect(t.effect).at_sensor)
    return sensed(record, terms) if terms else np.zeros(record.n)
