"""The truth about one machine as Python data, and one run of it."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
import numpy.typing as npt

from zendsp.proof.reality.build import library

Array = npt.NDArray[np.float64]
LAWS = ("inertia", "coriolis", "viscous", "coulomb")
KINDS = {"rotary": 0, "linear": 0, "planar2r": 1, "urdf": 2}


@dataclass(frozen=True)
class ForeignTable:
    """A torque over position and speed that opposes, like every effect; between its points it is
    bilinear.
    """

    torque: Array  # (positions, speeds), N m or N
    position: tuple[float, float]  # of the first row and the last, rad or m
    speed: tuple[float, float]  # of the first column and the last


@dataclass(frozen=True)
class JointTruth:
    """Everything that acts on one joint; names, units and signs are those of ``Joint`` in
    ``reality.h``.
    """

    coulomb_pos: float = 0.0
    coulomb_neg: float = 0.0
    stribeck_extra: float = 0.0
    stribeck_velocity: float = 1.0
    stribeck_exponent: float = 2.0
    bristle_stiffness: float = 0.0
    bristle_damping: float = 0.0
    load_mu: float = 0.0
    level_amplitude: float = 0.0
    level_period: float = 1.0
    level_phase: float = 0.0
    drift_ratio: float = 0.0
    drift_time: float = 1.0
    viscous_pos: float = 0.0
    viscous_neg: float = 0.0
    drag: float = 0.0
    gravity: float = 0.0
    gravity_angle: float = 0.0
    stiffness: float = 0.0
    neutral: float = 0.0
    cubic: float = 0.0
    cubic_neutral: float = 0.0
    ripple_order: tuple[float, float] = (0.0, 0.0)
    ripple_amplitude: tuple[float, float] = (0.0, 0.0)
    ripple_phase: tuple[float, float] = (0.0, 0.0)
    bw_force: float = 0.0
    bw_stiffness: float = 0.0
    bw_exponent: float = 1.0
    limit: float = 0.0
    delay: float = 0.0
    dead_zone: float = 0.0
    saturation: float = 0.0
    gain: float = 1.0
    lag: float = 0.0
    torque_offset: float = 0.0
    trans_stiffness: float = 0.0
    trans_damping: float = 0.0
    trans_gap: float = 0.0
    motor_inertia: float = 0.0
    sensor_on_load: float = 0.0
    resolution: float = 0.0
    floor_counts: float = 0.0
    eccentricity: float = 0.0
    eccentricity_phase: float = 0.0
    foreign: ForeignTable | None = None
    extra_inertia: float = 0.0


@dataclass(frozen=True)
class LinkTruth:
    """One link of a chain: its joint's frame in the parent's frame, and its body."""

    rotation: tuple[float, ...]  # 9, row-major
    place: tuple[float, float, float]  # m
    mass: float  # kg
    com: tuple[float, float, float]  # m, in the link's frame
    inertia: tuple[float, ...]  # 9, kg m^2, about the centre of mass


@dataclass(frozen=True)
class CouplingTruth:
    """Torque on joint `to` from the motion of joint `from_` (0-based)."""

    to: int
    from_: int
    law: str
    coefficient: float


@dataclass(frozen=True)
class MachineTruth:
    """A machine, its joints and its loop; see ``Machine`` in ``reality.h``."""

    kind: str
    joints: tuple[JointTruth, ...]
    parameters: tuple[float, ...] = ()
    couplings: tuple[CouplingTruth, ...] = ()
    links: tuple[LinkTruth, ...] = ()
    down: tuple[float, float, float] = (0.0, 0.0, -9.81)
    sample_time: float = 1e-3
    substeps: int = 50
    kp: tuple[float, ...] = (0.0,)
    kd: tuple[float, ...] = (0.0,)
    ki: tuple[float, ...] = (0.0,)
    velocity_filter: float = 0.0
    q0: tuple[float, ...] = (0.0,)
    v0: tuple[float, ...] = (0.0,)


@dataclass(frozen=True)
class Run:
    """What a recording shows (measured, command) and what only the simulator knows (q, v, energy).
    """

    time: Array  # s, (rows,)
    measured: Array  # rad or m, (rows, n)
    command: Array  # command units, (rows, n)
    reference: Array  # rad or m, (rows, n)
    q: Array = field(repr=False)  # true position on the sensor's side, (rows, n)
    v: Array = field(repr=False)
    energy: Array = field(repr=False)  # kinetic + potential, J, (rows,)


def run(
    truth: MachineTruth,
    reference: Array,
    *,
    feedforward: Array | None = None,
    torque: Array | None = None,
    noise: Array | None = None,
) -> Run:
    """Simulate one recording.

    Parameters
    ----------
    reference : array, (rows, n), rad or m
    feedforward : array, (rows, n), command units, optional
        Added to the controller's command; with zero gains it is an open-loop command.
    torque : array, (rows, n), N m or N, optional
        What no state explains; it opposes, like every effect, and is linear between rows.
    noise : array, (rows, n), rad or m, optional
        Added before the sensor's quantiser.

    Raises
    ------
    RuntimeError
        The machine ran away (an unstable loop): the row is named.
    """
    ffi, lib = library()
    rows, n = reference.shape
    zero = np.zeros((rows, n))
    given = [
        np.ascontiguousarray(zero if a is None else a, float)
        for a in (reference, feedforward, torque, noise)
    ]
    if any(a.shape != (rows, n) for a in given) or n != len(truth.joints):
        raise ValueError(
            f"arrays of shape {[a.shape for a in given]} for {len(truth.joints)} joints; expected"
            f" ({rows}, n)"
        )
    made = [np.empty((rows, n)) for _ in range(4)] + [np.empty(rows)]
    pointers = [ffi.cast("double *", ffi.from_buffer(a)) for a in given + made]
    stopped = lib.simulate(to_c(ffi, truth), rows, *pointers)
    if stopped:
        raise RuntimeError(
            f"the simulated machine ran away at row {stopped - 1} of {rows}: its loop is unstable"
        )
    measured, command, q, v, energy = made
    return Run(
        np.arange(rows, dtype=np.float64) * truth.sample_time,
        measured,
        command,
        given[0],
        q,
        v,
        energy,
    )


def inverse_dynamics(truth: MachineTruth, q: Array, v: Array, a: Array) -> Array:
    """M(q) a + Coriolis, centrifugal and gravity torque of the mechanism alone, (rows, n), N m or
    N.
    """
    ffi, lib = library()
    rows, n = q.shape
    given = [np.ascontiguousarray(x, float) for x in (q, v, a)]
    out = np.empty((rows, n))
    lib.inverse(
        to_c(ffi, truth), rows, *[ffi.cast("double *", ffi.from_buffer(x)) for x in (*given, out)]
    )
    return out


def to_c(ffi: object, truth: MachineTruth) -> object:
    """The struct ``Machine`` filled from `truth`."""
    m = ffi.new("Machine *")  # type: ignore[attr-defined]
    m.kind, m.n = KINDS[truth.kind], len(truth.joints)
    for k, value in enumerate(truth.parameters[:3]):
        m.p[k] = value
    for i, joint in enumerate(truth.joints):
        for item in fields(joint):
            value = getattr(joint, item.name)
            if item.name == "foreign":
                if value is not None:
                    set_foreign(ffi, m.joint[i], value)
            elif isinstance(value, tuple):
                for k, element in enumerate(value):
                    getattr(m.joint[i], item.name)[k] = element
            else:
                setattr(m.joint[i], item.name, float(value))
        m.kp[i], m.kd[i], m.ki[i] = truth.kp[i], truth.kd[i], truth.ki[i]
        m.q0[i], m.v0[i] = truth.q0[i], truth.v0[i]
    m.couplings = len(truth.couplings)
    for k, c in enumerate(truth.couplings):
        m.coupling[k].to, m.coupling[k].law = c.to, LAWS.index(c.law)
        setattr(m.coupling[k], "from", c.from_)
        m.coupling[k].coefficient = c.coefficient
    for i, link in enumerate(truth.links):
        m.link[i].rotation, m.link[i].place = link.rotation, link.place
        m.link[i].mass, m.link[i].com, m.link[i].inertia = link.mass, link.com, link.inertia
    m.down = truth.down
    m.sample_time = truth.sample_time
    m.substeps = truth.substeps
    m.velocity_filter = truth.velocity_filter
    return m


def set_foreign(ffi: object, joint: object, table: ForeignTable) -> None:
    """The table of one joint; `table` must outlive the struct, which only points at it."""
    rows, columns = table.torque.shape
    if not (table.torque.flags.c_contiguous and table.torque.dtype == np.float64):
        raise ValueError("a foreign table is an array of float64, row by row")
    (q0, q1), (v0, v1) = table.position, table.speed
    joint.foreign = ffi.cast("double *", ffi.from_buffer(table.torque))  # type: ignore[attr-defined]
    joint.foreign_rows, joint.foreign_columns = rows, columns  # type: ignore[attr-defined]
    joint.foreign_q, joint.foreign_dq = q0, (q1 - q0) / (rows - 1)  # type: ignore[attr-defined]
    joint.foreign_v, joint.foreign_dv = v0, (v1 - v0) / (columns - 1)  # type: ignore[attr-defined]
