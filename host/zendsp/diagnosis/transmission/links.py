"""Where a transmission, or what a sensor does, stands between a link and its recorded position: the
other joints feel the link.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Literal

import numpy as np

from zendsp.diagnosis.data.prepare import within_samples
from zendsp.diagnosis.data.signals import Parts
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.calibration.predict import run
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model
from zendsp.physics.robots.rigid import bases

Records = tuple[JointRecord, ...]


def divided(model: Model) -> frozenset[int]:
    """Joints (1-based) of a model whose links the recorded positions do not show: behind a
    transmission, or behind what their sensor makes of them.
    """
    if model.joints == 1:
        return frozenset()
    effects = [(t.joint, get_effect(t.effect)) for t in model.terms]
    unseen = model.sensor.side != "load"
    return frozenset(
        j for j, e in effects if e.at_sensor or (unseen and e.family == "transmission")
    )


def with_links(parts: Parts, model: Model, joints: Collection[int]) -> Parts:
    """The same recordings, in which every joint feels the links of some others, not what their
    sensors say.

    A link moves as the observer of its joint says, by what ``model`` has there.

    Parameters
    ----------
    parts : Parts
        As they were read: all joints feel what was measured.
    model : Model
        In kernel form.
    joints : collection of int
        1-based; those of ``divided(model)`` or some of them.
    """
    if not joints:
        return parts
    done = {id(data): _with_links(data, model, joints) for data in parts.each}
    return Parts(*(done[id(data)] for data in (parts.fit, parts.choose, parts.test)))


def _with_links(data: Data, model: Model, joints: Collection[int]) -> Data:
    return replace(data, records=tuple(_felt(rec, data, model, joints) for rec in data.records))


def _felt(rec: Records, data: Data, model: Model, joints: Collection[int]) -> Records:
    """One recording; a joint's own motor stays what it was."""
    links = rec[0].others.copy()
    side: Literal["seen", "beyond"] = "seen" if model.sensor.side == "load" else "beyond"
    for joint in joints:
        record = rec[joint - 1]
        link = run(record, model, data.bandwidth[joint - 1], inner=data.inner, states=side)
        if link.diverged:
            continue
        assert link.q is not None and link.qd is not None
        rate = np.gradient(link.qd, record.sample_time)
        links[joint - 1] = within_samples(np.stack([link.q, link.qd, rate]), record.sample_time)
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
                _thinned=None,
                _slope=None,
            )
            if not set(joints) <= {j + 1}
            else record
        )
    return tuple(out)
