"""Effects along one joint's measured motion by the kernel: their torques, what they add to the
sensor, and what an observer makes of either to first order.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.physics.calibration.joint import JointRecord, own_terms
from zendsp.physics.calibration.predict import felt, fill_rigid, pack
from zendsp.physics.effects import get_effect
from zendsp.physics.kernel.native import native
from zendsp.physics.model import Model, Term, per_joint
from zendsp.physics.term_numbers import added_inertia

Array = npt.NDArray[np.float64]


def trace(record: JointRecord, model: Model, terms: tuple[Term, ...], speed_floor: float) -> Array:
    """Resisting torque of some effects along the measured motion, (n,); dry friction smoothed over
    ``speed_floor`` rad/s.
    """
    torque: Array = traces(record, model, [terms], speed_floor)[0]
    return torque


def traces(
    record: JointRecord, model: Model, several: Sequence[tuple[Term, ...]], speed_floor: float
) -> Array:
    """The traces of several sets of effects, (sets, n)."""
    lib, n = native(), record.n
    p, ffi = lib.doubles, lib.ffi
    m = ffi.new("zk_model *")
    m.n, m.T, m.t0 = n, record.sample_time, record.began
    m.gain, m.limit = per_joint(model.actuator.gain, record.joint, 1.0), 0.0
    m.other = p(record.others)
    inertia, bias = record.inertia_and_bias(model)
    inertia = inertia + added_inertia(model, record.joint)
    fill_rigid(m, record, model, inertia, bias)
    motion, command = p(np.ascontiguousarray(record.motion.states)), p(record.command)
    out = np.empty((len(several), n))
    for row, terms in zip(out, several, strict=True):
        kinds, table = pack(terms)
        m.nfx, m.temperature = len(own_terms(terms)), p(felt(record, terms))
        m.kind, m.p = ffi.cast("int *", ffi.from_buffer(kinds)), p(table)
        lib.lib.zk_trace(m, motion, command, speed_floor, p(row))
    return out


def damping_along(record: JointRecord, model: Model) -> Array:
    """Viscous torque per unit of speed along the measured motion, (n,) N m s/rad or N s/m, for each
    sample's direction.
    """
    viscous = tuple(
        t
        for t in model.at(record.joint)
        if (e := get_effect(t.effect)).site == "viscous" and e.mechanism == "fluid_friction"
    )
    if not viscous:
        return np.zeros(record.n)
    speed = record.motion.states[1]
    moves = speed != 0.0
    slope = trace(record, model, viscous, 0.0)[moves] / speed[moves]
    out = np.full(record.n, np.mean(slope) if moves.any() else 0.0)
    out[moves] = slope
    return out


def sensed(record: JointRecord, terms: tuple[Term, ...], position: Array | None = None) -> Array:
    """The error that the position sensor adds to a motion, (n,) rad or m; to the measured motion
    where no ``position`` is given.
    """
    lib = native()
    p, ffi = lib.doubles, lib.ffi
    q = np.ascontiguousarray(record.motion.states[0] if position is None else position)
    kinds, table = pack(terms)
    m, out = ffi.new("zk_model *"), np.empty(len(q))
    m.n = len(q)
    m.nfx = len(terms)
    m.kind = ffi.cast("int *", ffi.from_buffer(kinds))
    m.p = p(table)
    lib.lib.zk_sense(m, p(q), p(out))
    return out


def response(
    record: JointRecord,
    bandwidth: float,
    inertia: Array,
    damping: Array,
    columns: npt.NDArray[np.floating[Any]],
    *,
    on_sensor: bool = False,
    unseen: bool = False,
    then: tuple[Array, int] | None = None,
    rows: npt.NDArray[np.int32] | None = None,
) -> Array:
    """The first-order response of the weighted innovations to torque columns (m, n), doubles or
    floats. ``on_sensor``: position columns instead; ``unseen``: where the prediction begins, the
    sensor says with them what it said. ``then``: a factor for each sample, (n,), and the samples by
    which the result is shifted earlier, with zeros at its end. ``rows``: the wanted samples,
    ascending, before that end; all by default.
    """
    lib, n = native(), record.n
    p, ffi = lib.doubles, lib.ffi
    k1, k2, w = record.gains(bandwidth)
    columns = np.ascontiguousarray(np.atleast_2d(columns))
    active = np.ones(n)
    out = np.empty((len(columns), n if rows is None else len(rows)))
    lib.lib.zk_filter(
        n,
        record.sample_time,
        p(k1),
        p(k2),
        p(w),
        p(active),
        p(np.ascontiguousarray(inertia)),
        p(np.ascontiguousarray(damping)),
        len(columns),
        ffi.cast("void *", ffi.from_buffer(columns)),
        int(columns.dtype == np.float32),
        2 if on_sensor and unseen else int(on_sensor),
        ffi.NULL if then is None else p(then[0]),
        0 if then is None else then[1],
        ffi.NULL if rows is None else ffi.cast("int *", ffi.from_buffer(rows)),
        0 if rows is None else len(rows),
        p(out),
    )
    return out


def matched(
    record: JointRecord, bandwidth: float, inertia: Array, damping: Array, innovations: Array
) -> Array:
    """The series whose product with any torque along the recording is that of the torque's
    ``response`` with weighted innovations, (n,): one pass in place of a response for each torque.
    """
    lib, n = native(), record.n
    p = lib.doubles
    k1, k2, w = record.gains(bandwidth)
    out = np.empty(n)
    lib.lib.zk_filter_back(
        n,
        record.sample_time,
        p(k1),
        p(k2),
        p(w),
        p(np.ascontiguousarray(inertia)),
        p(np.ascontiguousarray(damping)),
        p(np.ascontiguousarray(innovations)),
        p(out),
    )
    return out
