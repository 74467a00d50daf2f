"""Simulates one joint in a closed loop, with every effect of the library: the recording to expect
if a hypothesis is true.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.physics.calibration.joint import (
    JointRecord,
    effective_inertia,
    mechanism_value,
    own_terms,
)
from zendsp.physics.calibration.predict import pack
from zendsp.physics.effects import get_effect
from zendsp.physics.kernel.native import native
from zendsp.physics.model import Model, per_joint

Array = npt.NDArray[np.float64]
ROOM = 20.0  # °C


@dataclass(frozen=True)
class Looped:
    """Measured position and command of the simulated loop, (n,) each."""

    position: Array
    command: Array


def simulate_joint_loop(
    model: Model,
    joint: int,
    reference: Array,
    sample_time: float,
    *,
    kp: float,
    kd: float,
    inertia: float,
    resolution: float = 0.0,
    inner: int = 4,
    temperature: float = ROOM,
) -> Looped:
    """The simulated loop command = kp (reference − position) − kd velocity on one joint.

    Parameters
    ----------
    model : Model
        Terms in kernel form.
    joint : int
        1-based; the other joints rest.
    reference : ndarray, shape (n,)
        rad or m.
    sample_time : float
        s.
    kp, kd : float
        Command units per rad (m) and per rad/s (m/s).
    inertia : float
        Of the joint where the mechanism has none of its own (planar2r, urdf), kg m².
    resolution : float
        Of the sensor, rad or m.
    inner : int
        Integration steps per sample.
    temperature : float
        °C.
    """
    lib, n = native(), len(reference)
    p, ffi = lib.doubles, lib.ffi
    kinds, table = pack(model.at(joint))
    reference = np.ascontiguousarray(reference, float)
    zeros, inertias, warm = np.zeros(n), np.full(n, inertia), np.full(n, temperature)
    cumulative, out = np.zeros(n + 1), np.empty(n)
    others = np.zeros((model.joints, 3, n))
    m = ffi.new("zk_model *")
    m.n = n
    m.sub = inner
    m.T = sample_time
    m.ucum = m.uloop = p(cumulative)
    m.delay = model.actuator.delay
    m.gain = per_joint(model.actuator.gain, joint, 1.0)
    m.limit = per_joint(model.actuator.limit, joint, 0.0)
    m.m, m.half, m.k1, m.k2, m.w = (p(zeros) for _ in range(5))
    m.inertia, m.bias, m.reference, m.temperature = p(inertias), p(zeros), inertia, p(warm)
    m.gravity = mechanism_value(model, "gravity", joint) if model.kind == "rotary" else 0.0
    m.other = p(others)
    m.nfx = len(own_terms(model.at(joint)))
    m.kind = ffi.cast("int *", ffi.from_buffer(kinds))
    m.p = p(table)
    m.q0 = float(reference[0])
    m.qd0 = 0.0
    m.load_sensor = int(model.sensor.side == "load")
    m.rq = m.rqd = p(zeros)
    m.kp, m.kd, m.ref, m.resolution = kp, kd, p(reference), resolution
    lib.lib.zk_run(m, p(out), ffi.NULL, ffi.NULL, ffi.NULL)
    command = np.diff(cumulative) / sample_time
    for term in model.at(joint):
        effect = get_effect(term.effect)
        # the recorded part of what acted
        if effect.mechanism == "measurement" and effect.retime is not None:
            command = effect.retime(
                command, sample_time, {name: -q.value for name, q in term.parameters.items()}
            )
    return Looped(out, command)


def mean_inertia(record: JointRecord, model: Model) -> float:
    """Mean inertia of a joint along a recording, kg m² or kg."""
    return float(np.mean(effective_inertia(record, model)))
