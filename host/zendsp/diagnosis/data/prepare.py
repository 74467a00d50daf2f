"""Makes joint records from signals: measurement model, smoothed motion, coefficients of the
mechanism, scales.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.inertia import inertia_ranges
from zendsp.diagnosis.data.signals import Signals, joint_columns
from zendsp.errors import ModelError
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord, facts, mechanism_value, share_facts
from zendsp.physics.effects import get_effect
from zendsp.physics.effects.axes import LINKS
from zendsp.physics.effects.base import Scale
from zendsp.physics.kernel.signals import (
    Measurement,
    Motion,
    blurred,
    measure,
    noise_beside_quantisation,
    smooth,
)
from zendsp.physics.model import TREES, Model, Quantity, per_joint
from zendsp.physics.robots.bodies import Links, body_terms, machine_tree
from zendsp.physics.robots.rigid import Basis, bases, recorded_tree
from zendsp.physics.term_numbers import added_inertia
from zendsp.tree import mass_matrices

Array = npt.NDArray[np.float64]
POSES = 0.02  # s: an arm's inertia changes little over it


def prepare(signals: Sequence[Signals], model: Model, bandwidth: float = 32.0) -> Data:
    """Recordings prepared for the kernel.

    Parameters
    ----------
    model : Model
        The given model (its values only scale the smoothing).
    bandwidth : float
        First guess of the observers, rad/s.
    """
    records = tuple(_records(s, model) for s in signals)
    share_facts(records)
    return Data(records, (bandwidth,) * model.joints, ranges=inertia_ranges(records, model))


def at_their_poses(model: Model, data: Data) -> Model:
    """The model, in which springs and gaps of an arm that do not say what their loads are a part of
    have the mean inertia of the links along the recordings.
    """
    terms = []
    for term in model.terms:
        links = facts(data.records[0][term.joint - 1]).links
        names = {p.name for p in get_effect(term.effect).parameters}
        if links and LINKS.name in names and not term.value(LINKS.name):
            term = replace(term, parameters={**term.parameters, LINKS.name: Quantity(links, False)})
        terms.append(term)
    return model.with_terms(tuple(terms))


def one_sensor(signals: Sequence[Signals]) -> list[Signals]:
    """The recordings, each with at least the median noise of all. They share a sensor, and a
    recording in which a joint hardly moves says little about its noise.
    """
    noises = {
        (len(s.time), *map(noise_beside_quantisation, s.position.T, map(float, s.resolution)))
        for s in signals
    }  # a recording given twice counts once
    usual = np.median(np.array(list(noises))[:, 1:], axis=0)
    return [
        replace(s, least_noise=usual if s.least_noise is None else np.maximum(s.least_noise, usual))
        for s in signals
    ]


def of_one_sensor(parts: Sequence[Sequence[Signals]]) -> list[list[Signals]]:
    """The recordings of all parts, as ``one_sensor`` gives them together."""
    each = iter(one_sensor([s for part in parts for s in part]))
    return [list(islice(each, len(part))) for part in parts]


def _records(s: Signals, model: Model) -> tuple[JointRecord, ...]:
    """One recording as its joints."""
    joints = s.position.shape[1]
    masses = _masses(s, model)
    known = _accelerations(s, model, masses)
    smoothed = [_motion(s, j, known) for j in range(joints)]
    within = [within_samples(motion.states, s.sample_time) for _, motion in smoothed]
    others = np.ascontiguousarray(np.stack(within))
    basis = bases(model, within)
    tree = machine_tree(model)
    links = Links(tuple(tree[0]), tree[1], others) if tree else None
    if links is None and (terms := body_terms(model)):
        raise ModelError(
            f"{model.name}: [[effect]] kind = {terms[0].effect!r} needs bodies: [mechanism] kind ="
            f" 'urdf', 'mjcf' or 'rotary', or 'planar2r' with its length l1; this is {model.kind!r}"
        )
    weights = _weights(model, within)
    beside = _beside(s, masses, smoothed)
    return tuple(
        JointRecord(
            joint=j + 1,
            sample_time=s.sample_time,
            t0=float(s.time[0]),
            origin=s.origin,
            command=np.ascontiguousarray(s.command[:, j]),
            measurement=measurement,
            motion=motion,
            basis=basis[j],
            others=others,
            scale=_scale(s, model, j, motion, basis[j], weights[j]),
            base_offset=per_joint(model.sensor.offset, j + 1, 0.0),
            position=np.ascontiguousarray(s.position[:, j]),
            links=links,
            slides=model.joint_kind(j + 1) == "linear",
            columns=joint_columns(s, j),
            recording=s.whole or s.name,
            between=_between(s, model, j),
            beside=None if beside is None else np.ascontiguousarray(beside[j]),
        )
        for j, (measurement, motion) in enumerate(smoothed)
    )


def _motion(s: Signals, j: int, known: Array) -> tuple[Measurement, Motion]:
    """The measurements of a joint's sensor (from 0), and the motion behind them. ``known``: the
    assumed parts of each joint's acceleration, (n, joints, parts).
    """
    y = np.ascontiguousarray(s.position[:, j])
    resolution = float(s.resolution[j])
    noise = max(
        noise_beside_quantisation(y, resolution),
        float(s.least_noise[j]) if s.least_noise is not None else 0.0,
    )
    measurement = measure(y, s.sample_time, resolution, noise)
    return measurement, smooth(measurement, s.sample_time, known[:, j])


def _masses(s: Signals, model: Model) -> Array | None:
    """Mass matrices of an arm's bodies, one every ``_every(s)`` rows, (poses, joints, joints);
    None where the joints are not coupled, or not known to be.
    """
    poses = s.position[:: _every(s)]
    if model.called is not None:
        return np.asarray(model.called.masses(poses))
    if model.kind not in TREES:
        return None
    return mass_matrices(recorded_tree(model, poses.shape[1])[0], poses)


def _every(s: Signals) -> int:
    """Rows from one of the poses to the next."""
    return max(1, round(POSES / s.sample_time))


def _accelerations(s: Signals, model: Model, masses: Array | None) -> Array:
    """Acceleration of the joints by the commands in the given model, without gravity and velocity
    terms, (n, joints, parts): by a joint's own command, and by the others'.

    In an arm each torque accelerates all joints. Changes of a command from row to row, such as
    feedback noise, are not visible in positions, but the other joints feel them.
    """
    joints = range(1, s.position.shape[1] + 1)
    torque = s.command * [per_joint(model.actuator.gain, j, 1.0) for j in joints]
    if masses is None:
        return (torque / [_inertia(model, j) for j in joints])[:, :, np.newaxis]
    rows = np.arange(len(torque))
    late = model.actuator.delay / s.sample_time
    torque = np.stack([np.interp(rows - late, rows, row) for row in torque.T], axis=1)
    moved = masses + np.diag([added_inertia(model, j) for j in joints])
    inverse = np.linalg.pinv(moved, hermitian=True)[rows // _every(s)]
    own = np.einsum("nii,ni->ni", inverse, torque)
    every_one = np.einsum("nij,nj->ni", inverse, torque)
    return np.stack([own, every_one - own], axis=2)


def _beside(
    s: Signals, masses: Array | None, smoothed: Sequence[tuple[Measurement, Motion]]
) -> Array | None:
    """Torques that errors of the other joints' accelerations make through the mass matrix, (joints,
    n): one draw. None where the joints are not coupled, or not known to be.
    """
    if len(smoothed) < 2 or masses is None:
        return None
    errors = np.stack([blurred(seen, s.sample_time, motion) for seen, motion in smoothed], axis=1)
    coupling = masses * (1.0 - np.eye(len(smoothed)))
    rows = np.arange(len(errors)) // _every(s)
    return np.asarray(np.einsum("nij,nj->in", coupling[rows], errors))


def _between(s: Signals, model: Model, j: int) -> float:
    """RMS torque (N m or N) of a joint (from 0) from commands between rows."""
    if s.between is None:
        return 0.0
    mean_of = s.sample_time / s.raw.sample_time if s.raw else 1.0
    return abs(per_joint(model.actuator.gain, j + 1, 1.0)) * float(s.between[j] / np.sqrt(mean_of))


def _scale(
    s: Signals, model: Model, j: int, motion: Motion, basis: Mapping[str, Basis], weight: Array
) -> Scale:
    """The typical sizes at a joint (from 0) of a recording."""
    q, qd, qdd = motion.states
    torque = per_joint(model.actuator.gain, j + 1, 1.0) * s.command[:, j]
    inertia_series = sum(
        (1.0 if key == "fixed" else mechanism_value(model, key, j + 1)) * b.inertia
        for key, b in basis.items()
    )
    bias_series = sum(
        (1.0 if key == "fixed" else mechanism_value(model, key, j + 1)) * b.bias
        for key, b in basis.items()
    )
    inertia = float(np.mean(inertia_series)) + added_inertia(model, j + 1)
    moving = inertia_series * qdd + added_inertia(model, j + 1) * qdd + bias_series - weight
    if model.kind == "rotary":
        weight = mechanism_value(model, "gravity", j + 1) * np.sin(q)
    # a hardly driven joint is moved by its weight, which is the torque then; but no more of it than
    # moves the joint and is held: with a weight given 1000 times too large all else was too small
    effort = min(_rms(weight), _rms(torque) + _rms(moving))
    effort = max(_rms(torque), effort) or inertia * _rms(qdd)
    way = max(float(np.ptp(q)), 1e-9)
    return Scale(
        torque=max(effort, 1e-12),
        speed=max(_rms(qd), 1e-9),
        position=way,
        inertia=max(inertia, 1e-12),
        command=max(_rms(s.command[:, j]), 1e-12),
        seconds=float(s.time[-1] - s.time[0]),
        turn=1.0 if model.joint_kind(j + 1) == "rotary" else way / 6.283,
    )


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.asarray(x) ** 2)))


def _weights(model: Model, states: Sequence[Array]) -> list[Array]:
    """Torque of gravity along a motion by the mechanism, one array (n,) for each joint."""
    if model.kind not in TREES:
        return [np.zeros(s.shape[1]) for s in states]
    at_rest = [np.stack([s[0], 0 * s[0], 0 * s[0]]) for s in states]
    return [
        sum((np.asarray(b.bias) for b in basis.values()), np.zeros(1))
        for basis in bases(model, at_rest)
    ]


def within_samples(states: Array, sample_time: float) -> Array:
    """Mean q, qd, qdd between each sample and the next, (3, n). The kernel holds the torques of
    other joints over that time.

    The acceleration is the difference of the velocities, so that its sum over any samples agrees
    with them.
    """
    q, qd, qdd = states
    mean = np.stack([0.5 * (q[1:] + q[:-1]), 0.5 * (qd[1:] + qd[:-1]), np.diff(qd) / sample_time])
    return np.concatenate([mean, np.stack([q[-1:], qd[-1:], qdd[-1:]])], axis=1)


def _inertia(model: Model, joint: int) -> float:
    """A joint's inertia (kg m²) or mass by the mechanism's parameters."""
    if model.kind in ("rotary", "linear"):
        return mechanism_value(model, "inertia" if model.kind == "rotary" else "mass", joint)
    return mechanism_value(model, "p1" if joint == 1 else "p2", joint)
