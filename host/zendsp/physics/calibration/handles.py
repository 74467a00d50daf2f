"""The free numbers of a model as a vector, which a fit moves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, Quantity, Term

Array = npt.NDArray[np.float64]


LEADER = "load_inertia"  # to which tied numbers of a spring are ratios
TIED = 2.0  # standard deviations


@dataclass(frozen=True)
class Tie:
    """A number of a spring that recordings tell for each unit of its ``LEADER``, better than both:
    ``key`` is ``ratio``, with its standard deviation, times that. ``gap``: of a contact beyond one.
    """

    key: str
    ratio: float
    std: float
    gap: bool = False

    @property
    def within(self) -> tuple[float, float]:
        """Lowest and highest ratio of a fit. A model that lacks physics would move it further; a
        complete one finds the ratio itself, which held at a value 0.2 % off cost a complete model
        up to 70 % of its error.
        """
        return max(0.0, self.ratio - TIED * self.std), self.ratio + TIED * self.std


@dataclass(frozen=True)
class Handle:
    """Names one free number of a model: ``place`` is "mechanism", "term", "gain" or "offset";
    ``index`` is 0-based. With a ``tie`` its number is the ratio to the term's ``LEADER``.
    """

    place: str
    index: int
    key: str = ""
    tie: Tie | None = None


def free_handles(
    model: Model, *, joints: Sequence[int] = (), offsets: bool = True
) -> tuple[Handle, ...]:
    """The numbers of a model that may be calibrated.

    A mechanism parameter of value 0 is absent physics and is not calibrated. Numbers of bodies are
    free only where all joints decide.

    Parameters
    ----------
    joints : sequence of int
        Only terms of these joints (1-based); all where empty.
    offsets : bool
        Also the sensor's zero within one count, where a torque depends on position.
    """
    wanted = set(joints or range(1, model.joints + 1))
    handles: list[Handle] = []
    for key, items in model.mechanism.items():
        for i, item in enumerate(items):
            if item.free and item.value != 0 and (len(items) == 1 or i + 1 in wanted):
                handles.append(Handle("mechanism", i, key))
    for i, term in enumerate(model.terms):
        if term.joint in wanted:
            effect = get_effect(term.effect)
            if effect.site == "body" and len(wanted) < model.joints:
                continue
            handles += [
                Handle("term", i, p.name)
                for p in effect.parameters
                if term.parameters[p.name].free
            ]
    if model.actuator.gain_free:
        handles += [Handle("gain", j - 1) for j in sorted(wanted)]
    if (
        offsets
        and model.kind == "rotary"
        and any(q.value for q in model.mechanism.get("gravity", ()))
    ):
        handles += [Handle("offset", j - 1) for j in sorted(wanted)]
    return tuple(handles)


def tied(
    model: Model, handles: Sequence[Handle], ties: Mapping[int, tuple[Tie, ...]]
) -> tuple[Handle, ...]:
    """The handles, those of tied numbers (by joint) as ratios where their ``LEADER`` is free."""
    out = []
    for h in handles:
        term = model.terms[h.index] if h.place == "term" else None
        if term is not None and LEADER in term.parameters and term.parameters[LEADER].free:
            same = (t for t in ties.get(term.joint, ()) if t.gap == ("gap" in term.parameters))
            h = replace(h, tie=next((t for t in same if t.key == h.key), None))
        out.append(h)
    return tuple(out)


def _pick(values: tuple[float, ...], index: int, default: float) -> float:
    return values[index] if index < len(values) else (values[0] if values else default)


def get_values(model: Model, handles: Sequence[Handle]) -> Array:
    """The numbers behind the handles, (p,)."""
    out = []
    for h in handles:
        if h.place == "mechanism":
            out.append(model.mechanism[h.key][h.index].value)
        elif h.place == "term":
            value = model.terms[h.index].parameters[h.key].value
            out.append(value / model.terms[h.index].value(LEADER) if h.tie else value)
        elif h.place == "gain":
            out.append(_pick(model.actuator.gain, h.index, 1.0))
        else:
            out.append(_pick(model.sensor.offset, h.index, 0.0))
    return np.array(out, float)


def set_values(model: Model, handles: Sequence[Handle], x: Array) -> Model:
    """A copy of the model with the numbers behind the handles replaced, without standard
    deviations.
    """
    used = {h.place for h in handles}
    mechanism = {key: list(items) for key, items in model.mechanism.items()}
    terms = list(model.terms)
    joints = range(model.joints) if used & {"gain", "offset"} else ()
    gain = [_pick(model.actuator.gain, j, 1.0) for j in joints]
    offset = [_pick(model.sensor.offset, j, 0.0) for j in joints]
    # ratios last, when what they are ratios to is set
    for i, h in sorted(enumerate(handles), key=lambda item: item[1].tie is not None):
        value = float(x[i])
        if h.place == "mechanism":
            number = mechanism[h.key][h.index]
            mechanism[h.key][h.index] = Quantity(value, number.free, number.unit)
        elif h.place == "term":
            term = terms[h.index]
            number = term.parameters[h.key]
            value *= term.value(LEADER) if h.tie else 1.0
            numbers = {**term.parameters, h.key: Quantity(value, number.free, number.unit)}
            terms[h.index] = Term(term.effect, term.joint, numbers)
        elif h.place == "gain":
            gain[h.index] = value
        else:
            offset[h.index] = value
    actuator = replace(model.actuator, gain=tuple(gain)) if "gain" in used else model.actuator
    sensor = replace(model.sensor, offset=tuple(offset)) if "offset" in used else model.sensor
    return replace(
        model,
        mechanism={key: tuple(items) for key, items in mechanism.items()},
        terms=tuple(terms),
        actuator=actuator,
        sensor=sensor,
    )


def pairs_of(model: Model, handles: Sequence[Handle]) -> list[tuple[int, int, str]]:
    """The pairs of numbers of a term that act together, by their places among the handles: a size
    with a "phase" or a "neutral" position.
    """
    place = {(h.index, h.key): i for i, h in enumerate(handles) if h.place == "term"}
    found = []
    for i, term in enumerate(model.terms):
        effect = get_effect(term.effect)
        size = effect.linear[0] if effect.linear else ""
        for name, kind in (("phase", "phase"), ("angle", "phase"), ("neutral", "neutral")):
            if (i, size) in place and (i, name) in place:
                found.append((place[i, size], place[i, name], kind))
    return found


def straight(x: Array, step: Array, pairs: Sequence[tuple[int, int, str]]) -> Array:
    """The end of a step taken in numbers in which a torque is linear: sine and cosine of a wave,
    stiffness and torque of a spring.

    In amplitude and phase, or stiffness and neutral position, the same path is curved, and a long
    step departs from it.
    """
    moved = x + step
    for size, other, kind in pairs:
        if kind == "phase":
            along, across = moved[size], x[size] * step[other]
            moved[size] = np.hypot(along, across)
            moved[other] = x[other] + np.arctan2(across, along)
            if abs(moved[other]) > 2.0 * math.pi:
                moved[other] = math.remainder(moved[other], 2.0 * math.pi)
        elif moved[size] > 0.0:
            moved[other] = x[other] + x[size] * step[other] / moved[size]
    return moved
