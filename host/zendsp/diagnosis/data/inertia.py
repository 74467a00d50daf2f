"""A first estimate of each joint's inertia by inverse dynamics: bounds for the calibration of an
incomplete model.

While much physics is missing, a fast observer favours a huge inertia, which ignores wrong torques.
Low-pass filtered inverse dynamics with rich friction, gravity and coupling columns as nuisance
gives the inertia within a few percent whatever is missing (Gautier 1997), and the calibration may
move only around it. Where a joint hardly accelerates, noise of its acceleration makes the estimate
too small, so a stronger low-pass is tried too. Where joints accelerate together, the coupling
columns absorb a part, so it is also estimated without them. The range holds all estimates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.physics.calibration.fit import TOO_FAR
from zendsp.physics.calibration.joint import JointRecord, mechanism_value
from zendsp.physics.kernel.smooth import moving_mean
from zendsp.physics.model import Model, per_joint
from zendsp.physics.robots.bodies import body_terms
from zendsp.physics.term_numbers import added_inertia

Array = npt.NDArray[np.float64]

WINDOWS = 0.02, 0.06  # s, applied twice: about 20 Hz, and 7 Hz
INERTIA_RANGE = 1.12  # the calibration may move by this factor around the estimate
SLIDING = 0.15  # of the RMS speed
LEAST_ROWS = 60  # rows, of two windows each
T_VALUE = 5.0  # t value from which the estimate is used

OWN = {"rotary": ("inertia",), "linear": ("mass",), "planar2r": ("p1", "p2")}


def own_key(model: Model, joint: int) -> str:
    """Name of the number that is the joint's own inertia: a mechanism parameter, or "inertia J" for
    a rotor term of joint J.
    """
    keys = OWN.get(model.kind)
    return f"inertia {joint}" if keys is None else keys[min(joint, len(keys)) - 1]


def with_its_scale(model: Model, undriven: Sequence[int]) -> tuple[Model, list[str]]:
    """The model of a single joint with its inertia held where nothing drives it, and a note: no
    motion tells it then, and all torques are ratios to it.
    """
    keys = OWN.get(model.kind, ())
    items = model.mechanism.get(keys[0], ()) if keys else ()
    if model.joints > 1 or not undriven or not any(item.free for item in items):
        return model, []
    held = tuple(replace(item, free=False) for item in items)
    note = (
        f"nothing drives it, so that only ratios to its {keys[0]} show: that is held at"
        f" {items[0].value:.4g}, and every other number is off by as much as it is"
    )
    return replace(model, mechanism={**model.mechanism, keys[0]: held}), [note]


def inertia_ranges(
    records: Sequence[Sequence[JointRecord]], model: Model
) -> dict[tuple[str, int], tuple[float, float]]:
    """The range of each joint's own inertia, kg m² or kg, by ``own_key`` and the 0-based place of
    its number. It covers the recordings' estimates and the given number, widened by
    ``INERTIA_RANGE``; for a given rotor it lies about the given number. A shared number has a range
    that holds those of all joints.
    """
    ranges: dict[tuple[str, int], tuple[float, float]] = {}
    for joint in range(1, model.joints + 1):
        own = [rec[joint - 1] for rec in records]
        key = own_key(model, joint)
        own_mechanism = key in model.mechanism
        place = key, min(joint, len(model.mechanism.get(key, ()))) - 1 if own_mechanism else 0
        given = (
            mechanism_value(model, key, joint) if own_mechanism else added_inertia(model, joint)
        )
        around = [_around(*found) for window in WINDOWS for found in _estimates(own, model, window)]
        # for bodies without a rotor any estimate is better than none
        if around[0] or (not own_mechanism and not given and any(around)):
            lows, highs = zip(*filter(None, around), strict=True)
            # missing physics may bend it away from the given number, which may be wrong too
            low = min(*lows, given / INERTIA_RANGE or lows[0])
            high = max(*highs, given * INERTIA_RANGE)
            others = ranges.get(place, (low, high))
            ranges[place] = min(low, others[0]), max(high, others[1])
        elif not own_mechanism and given > 0:
            # an unbounded rotor would grow until it ignores whatever is missing
            ranges[place] = given / TOO_FAR, given * TOO_FAR
    return ranges


def _around(value: float, t: float) -> tuple[float, float] | None:
    """The range for the calibration; None where the recordings do not determine it."""
    if t <= T_VALUE or value <= 0:
        return None
    spread = INERTIA_RANGE * (1.0 + 1.0 / t)
    return value / spread, value * spread


def _estimates(
    records: list[JointRecord], model: Model, window: float
) -> list[tuple[float, float]]:
    """Estimates of the inertia with their ratios to the standard deviation, with and without the
    columns of other joints.
    """
    systems = [_system(record, model, window) for record in records]
    a, y = (np.concatenate(parts) for parts in zip(*systems, strict=True))
    others = len(records[0].others) - 1 if model.of_bodies else 0
    return [_estimate(a[:, :count], y) for count in (a.shape[1], a.shape[1] - 3 * others)]


def _estimate(a: Array, y: Array) -> tuple[float, float]:
    """The first number of a regression, and its ratio to its standard deviation."""
    if len(y) < LEAST_ROWS:
        return 0.0, 0.0
    scale = np.linalg.norm(a, axis=0)
    scale[scale == 0] = 1.0
    theta, *_ = np.linalg.lstsq(a / scale, y, rcond=1e-9)
    left = y - a / scale @ theta
    spread = (
        np.linalg.pinv((a / scale).T @ (a / scale), rcond=1e-9)[0, 0]
        * float(left @ left)
        / max(1, len(y) - a.shape[1])
    )
    return float(theta[0] / scale[0]), float(theta[0] / max(np.sqrt(max(spread, 0.0)), 1e-300))


def _system(rec: JointRecord, model: Model, window: float) -> tuple[Array, Array]:
    """Columns, those of the other joints last, and the torque that they explain."""
    width = max(3, round(window / rec.sample_time))

    def low(v: Array) -> Array:
        return moving_mean(moving_mean(v, width), width)[2 * width : -2 * width : width]

    q, qd, qdd = rec.motion.states
    key = own_key(model, rec.joint)
    torque = per_joint(model.actuator.gain, rec.joint, 1.0) * rec.command
    known, shape = np.zeros(rec.n), np.zeros(rec.n)
    for name, basis in rec.basis.items():
        if name == key:
            shape += basis.inertia
            known += mechanism_value(model, name, rec.joint) * basis.bias
        else:
            value = 1.0 if name == "fixed" else mechanism_value(model, name, rec.joint)
            known += value * (basis.inertia * qdd + basis.bias)
    if key.startswith("inertia "):
        shape += 1.0
    if rec.links is not None and (bodies := body_terms(model)):
        change = rec.links.change(bodies, rec.joint - 1)
        known += change.inertia * qdd + change.bias
    slow = 0.05 * rec.scale.speed
    columns = [
        shape * qdd,
        qd,
        np.tanh(qd / slow),
        np.tanh(qd / slow / 8),
        qd * np.abs(qd),
        np.ones(rec.n),
        q,
    ]
    if model.kind == "rotary":
        columns += [np.sin(q), np.cos(q)]
    for other in range(rec.others.shape[0]):
        if other + 1 != rec.joint and model.of_bodies:
            _, vd, vdd = rec.others[other]
            columns += [vd, vdd, np.tanh((qd + vd) / slow)]
    # a sticking joint balances any torque up to its friction: only sliding shows the inertia
    still = max(3.0 * float(np.sqrt(np.median(rec.motion.variances[1]))), SLIDING * rec.scale.speed)
    sliding = low((np.abs(qd) > still).astype(np.float64)) > 1.0 - 1e-9
    return np.stack([low(c) for c in columns], axis=1)[sliding], low(torque - known)[sliding]
