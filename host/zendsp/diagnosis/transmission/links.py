"""Links whose recorded position differs from their own, by a transmission or a sensor error: other
joints feel the link.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Literal

import numpy as np

from zendsp.diagnosis.data.prepare import within_samples
from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.transmission.arm_motion import arm_motion, is_chain, with_springs_at
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.calibration.predict import run
from zendsp.physics.effects import get_effect
from zendsp.physics.kernel.signals import (
    Array,
    find_resolution,
    measure,
    noise_beside_quantisation,
    smooth,
)
from zendsp.physics.model import Model
from zendsp.physics.robots.rigid import bases

Records = tuple[JointRecord, ...]


def divided(model: Model) -> frozenset[int]:
    """The joints (1-based) whose recorded positions do not show their links: behind a transmission
    or a sensor error.
    """
    if model.joints == 1:
        return frozenset()
    effects = [(t.joint, get_effect(t.effect)) for t in model.terms]
    unseen = model.sensor.side != "load"
    return frozenset(
        j for j, e in effects if e.at_sensor or (unseen and e.family == "transmission")
    )


def with_links(
    parts: Parts, model: Model, joints: Collection[int], *, together: bool = True
) -> Parts:
    """The recordings, in which every joint feels the links of some others instead of their recorded
    positions.

    A link moves as its own sensor says; or, behind springs, as ``model`` and the encoders of the
    whole arm say together (``arm_motion``); or else, and without ``together``, as the observer of
    its joint estimates.

    Parameters
    ----------
    parts : Parts
        The recordings as read, in which all joints feel the recorded positions.
    model : Model
        In kernel form.
    joints : collection of int
        1-based; those of ``divided(model)`` or some of them.
    """
    if not joints:
        return parts
    done = {id(data): _with_links(data, model, joints, together) for data in parts.each}
    return Parts(*(done[id(data)] for data in (parts.fit, parts.choose, parts.test)))


def _with_links(data: Data, model: Model, joints: Collection[int], together: bool) -> Data:
    records = (_felt(rec, data, model, joints, together) for rec in data.records)
    return replace(data, records=tuple(records))


def _felt(
    rec: Records, data: Data, model: Model, joints: Collection[int], together: bool
) -> Records:
    """One recording with such links; a joint's own motor stays as recorded."""
    if together and is_chain(data, model, joints):
        model = with_springs_at(model, joints)
        arm = arm_motion(rec, data, model)
        if arm is not None:
            return _moved(rec, model, arm.links, arm.chain.felt_errors(arm.strength))
    links = rec[0].others.copy()
    side: Literal["seen", "beyond"] = "seen" if model.sensor.side == "load" else "beyond"
    for joint in joints:
        record = rec[joint - 1]
        if model.sensor.side != "load" and "position_load" in record.columns:
            states = _measured(record.columns["position_load"], record.sample_time)
            links[joint - 1] = within_samples(states, record.sample_time)
            continue
        link = run(
            record, model, data.bandwidth[joint - 1], inner=data.inner, states=side, begun=True
        )
        if link.diverged:
            continue
        assert link.q is not None and link.qd is not None
        rate = np.gradient(link.qd, record.sample_time)
        links[joint - 1] = within_samples(np.stack([link.q, link.qd, rate]), record.sample_time)
    felt = _moved(rec, model, links)
    return tuple(
        record if set(joints) <= {record.joint} else new
        for record, new in zip(rec, felt, strict=True)
    )


def _moved(rec: Records, model: Model, links: Array, beside: Array | None = None) -> Records:
    """One recording whose links move otherwise than recorded, (joints, 3, n). ``beside``: one draw
    of the torques that errors of that motion make, (joints, n).
    """
    out = []
    for j, record in enumerate(rec):
        others = links.copy()
        others[j] = record.others[j]
        out.append(
            replace(
                record,
                others=np.ascontiguousarray(others),
                basis=bases(model, list(others))[j],
                links=None if record.links is None else replace(record.links, motion=others),
                beside=record.beside if beside is None else np.ascontiguousarray(beside[j]),
                _thinned=None,
                _once={},
            )
        )
    return tuple(out)


def _measured(load: Array, sample_time: float) -> Array:
    """The motion of a link by its own sensor, (3, n)."""
    step = find_resolution(load)
    seen = measure(load, sample_time, step, noise_beside_quantisation(load, step))
    return smooth(seen, sample_time).states
