"""One joint of one recording, ready for the kernel, with a model's inertia and torques along it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.physics.effects import get_effect
from zendsp.physics.effects.base import Along, Facts, Scale
from zendsp.physics.effects.catalogue import at_site
from zendsp.physics.kernel.native import native, swung
from zendsp.physics.kernel.signals import Measurement, Motion, means, thin_measurement
from zendsp.physics.model import TREES, Model, Term, per_joint
from zendsp.physics.robots.bodies import Links, body_terms
from zendsp.physics.robots.rigid import Basis, bias_slope, tree_torques
from zendsp.physics.term_numbers import added_inertia

Array = npt.NDArray[np.float64]
RIGID = 16  # models whose rigid-body torques are kept
BEGIN = 2.0  # rad a row: as fast as the rows allow
FADE = 0.05  # s, or a 250th of the recording: decay of the squared bandwidth
ROUNDED = 1e-9  # N m: the gravity of an upright axis is no more than rounding


_numbers = itertools.count()


@dataclass
class JointRecord:
    """One joint along one recording. Arrays are (n,), C-contiguous; SI units, joint coordinates."""

    joint: int
    sample_time: float
    t0: float
    command: Array
    measurement: Measurement
    motion: Motion
    basis: dict[str, Basis]
    others: Array  # (joints, 3, n)
    scale: Scale
    base_offset: float
    position: Array  # as measured, quantised
    links: Links | None = None  # of the whole machine; None where its kind has none
    slides: bool = False  # a linear joint
    # optional ones by their role in [columns], (n,)
    columns: Mapping[str, Array] = field(default_factory=dict)
    recording: str = ""  # its name
    origin: float = 0.0  # s, of ``t0``'s clock: where the time of effects begins
    between: float = 0.0  # N m or N, RMS: torque of commands between rows
    # N m or N, (n,): one draw of the torque that errors of the others' accelerations make here
    beside: Array | None = None
    every: int = 1  # samples of the recording in one of these, see ``thinned``
    first: int = 0  # sample of the recording with which it begins, see ``liveliest``
    # What the kernel points to. Threads may make it at the same time: the first one stays, since
    # the kernel of another thread may read it already
    _gains: dict[float, tuple[Array, Array, Array]] = field(default_factory=dict)
    _once: dict[str, Array] = field(default_factory=dict)
    _facts: Facts | None = None
    _thinned: JointRecord | None = None
    # latest fits to it by their inputs, see ``fit``
    fits: dict[Any, Any] = field(default_factory=dict)
    # latest predictions of it by their inputs, see ``run``
    runs: dict[Any, Any] = field(default_factory=dict)
    # torques of single terms along it, see ``Screen``
    traces: dict[Any, Array] = field(default_factory=dict)
    _log_weights: dict[float, float] = field(default_factory=dict, init=False, repr=False)
    # kernel inputs by the bandwidth of the observer, see ``fill``
    filled: dict[float, Any] = field(default_factory=dict, init=False, repr=False, compare=False)
    # rigid-body inertia and torque of the latest models, see ``inertia_and_bias``
    rigid: dict[Any, tuple[Array, Array]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    # sines of its position, see ``Along.wave``
    waves: dict[float, tuple[Array, Array]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    # inertia and damping of the latest models by their id, see ``resisting``
    resists: dict[int, Any] = field(default_factory=dict, init=False, repr=False, compare=False)
    # shapes of torques along it, see ``drawn`` of diagnosis/measure/structure.py
    shapes: dict[Any, npt.NDArray[np.float32]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    # of springs by the latest models, see ``_begun`` of predict.py
    begun: dict[Any, tuple[float, float]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _liveliest: JointRecord | None = field(default=None, init=False, repr=False, compare=False)
    # tells it from others in the caches that copies of it share. (By its id they would have to keep
    # it alive, as a cycle: ten diagnoses in one process held 1.6 GB)
    number: int = field(default_factory=_numbers.__next__, init=False, repr=False, compare=False)

    @property
    def began(self) -> float:
        """Time of the first sample, s, as effects know it."""
        return self.t0 - self.origin

    @property
    def n(self) -> int:
        """Number of samples."""
        return len(self.command)

    @property
    def integral(self) -> Array:
        """Integral of the held command, (n + 1,)."""
        made = self._once.get("integral")
        if made is None:
            made = np.ascontiguousarray(np.r_[0.0, np.cumsum(self.command)] * self.sample_time)
        return self._once.setdefault("integral", made)

    @cached_property
    def informative(self) -> int:
        """Number of samples that count."""
        return int(np.sum(self.counted))

    @property
    def counted(self) -> npt.NDArray[np.bool_]:
        """Samples that count in a likelihood, (n,); on a plateau of the quantiser only the change
        of the count.
        """
        mask: npt.NDArray[np.bool_] = self.measurement.half == 0
        return mask

    def gains(self, bandwidth: float) -> tuple[Array, Array, Array]:
        """Observer gains k1, k2 and weights for a bandwidth in rad/s, which expresses the strength
        of white process noise.
        """
        key = round(bandwidth, 6)
        made = self._gains.get(key)
        if made is None:
            lib, n = native(), self.n
            white = self.measurement.resolution**2 / 12 + self.measurement.noise**2
            white /= self.every
            variance = self.measurement.variance
            reference = white if white > 0 else float(np.median(variance[variance > 0]))
            k1, k2, w = np.empty(n), np.empty(n), np.empty(n)
            p = lib.doubles
            lib.lib.zf_gains(
                n,
                self.sample_time,
                p(self._unrest(bandwidth) * np.sqrt(reference)),
                p(self.measurement.variance),
                p(k1),
                p(k2),
                p(w),
            )
            made = (k1, k2, w)
        return self._gains.setdefault(key, made)

    def log_weights(self, bandwidth: float) -> float:
        """Sum of log S over the samples that count."""
        key = round(bandwidth, 6)
        if key not in self._log_weights:
            w = self.gains(bandwidth)[2]
            self._log_weights[key] = float(-2 * np.sum(np.log(w[self.counted])))
        return self._log_weights[key]

    def _unrest(self, bandwidth: float) -> Array:
        """Squares of the bandwidth along the recording, (n,) (rad/s)².

        Effects from before a recording are unknown (a lagging drive, a bent spring, a ringing
        load). The observer follows them at first.
        """
        fade = min(FADE, 0.004 * self.n * self.sample_time)
        first = (BEGIN / self.sample_time) ** 2
        return np.asarray(
            bandwidth**2 + first * np.exp(-self.sample_time / fade * np.arange(self.n))
        )

    def thinned(self, every: int) -> JointRecord:
        """The record with one sample in place of several, for a first fit of a hypothesis.

        A measurement is the weighted mean of its samples, shifted to the time of the first along
        the smoothed motion, so that no information is lost. Commands and motion are means over the
        time for which they are held.
        """
        if every < 2:
            return self
        found = self._thinned  # another thread may put another one in its place
        if found is None or found.every != every:
            facts(self)  # those of the whole recording hold
            some = slice(0, self.n // every * every, every)
            states = means(self.motion.states, every)
            states[:, 0] = self.motion.states[:, 0]  # start of a prediction
            self._thinned = found = replace(
                self,
                sample_time=every * self.sample_time,
                command=means(self.command, every),
                measurement=thin_measurement(self.measurement, self.motion.states[0], every),
                motion=replace(
                    self.motion,
                    states=states,
                    variances=np.ascontiguousarray(self.motion.variances[:, some]),
                ),
                basis={
                    key: b.each(lambda series: means(series, every))
                    for key, b in self.basis.items()
                },
                others=means(self.others, every),
                beside=None if self.beside is None else means(self.beside, every),
                position=np.ascontiguousarray(self.position[some]),
                columns={key: means(column, every) for key, column in self.columns.items()},
                every=every,
                **_nothing_known(),
            )
        return found

    def liveliest(self, seconds: float) -> JointRecord:
        """The part of the record, of this length, in which the joint is accelerated most, for a
        first fit of a hypothesis; the whole record where it is not longer.
        """
        count = round(seconds / self.sample_time)
        if count >= self.n or self.every > 1:
            return self
        found = self._liveliest
        if found is None or found.n != count:
            facts(self)  # those of the whole recording hold
            energy = np.r_[0.0, np.cumsum(self.motion.states[2] ** 2)]
            begin = int(np.argmax(energy[count:] - energy[:-count]))

            def cut(series: Array) -> Array:
                return np.ascontiguousarray(series[..., begin : begin + count])

            seen = self.measurement
            self._liveliest = found = replace(
                self,
                t0=self.t0 + begin * self.sample_time,
                command=cut(self.command),
                measurement=replace(
                    seen, value=cut(seen.value), half=cut(seen.half), variance=cut(seen.variance)
                ),
                motion=replace(
                    self.motion,
                    states=cut(self.motion.states),
                    variances=cut(self.motion.variances),
                ),
                basis={k: b.each(cut) for k, b in self.basis.items()},
                others=cut(self.others),
                beside=None if self.beside is None else cut(self.beside),
                position=cut(self.position),
                columns={key: cut(column) for key, column in self.columns.items()},
                first=self.first + begin,
                **_nothing_known(),
            )
        return found

    def forget(self) -> None:
        """Let go of all that can be computed again: of one joint, 20 s at 1 kHz, 150 MB."""
        for known in (
            self._gains, self._once, self.fits, self.runs, self.traces, self.filled, self.rigid,
            self.waves, self.resists, self.shapes,
        ):  # fmt: skip
            known.clear()
        self._thinned = self._liveliest = None

    def __getstate__(self) -> dict[str, Any]:
        """Pickle only what the rest can be computed from."""
        made = ("filled", "rigid", "waves", "resists", "shapes")
        kept: dict[str, Any] = {key: {} for key in made}
        return {**self.__dict__, **_nothing_known(), **kept, "_liveliest": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over what was pickled, with a number of this process."""
        self.__dict__.update(state, number=next(_numbers))

    def inertia_and_bias(self, model: Model) -> tuple[Array, Array]:
        """Inertia and known torque along the record for the mechanism parameters of a model, each
        (n,), to be read only: those of the latest models are kept.
        """
        terms = body_terms(model) if self.links is not None else ()
        values = [
            1.0 if key == "fixed" else mechanism_value(model, key, self.joint)
            for key in self.basis
        ]
        bodies = [(t.effect, t.joint, *(q.value for q in t.parameters.values())) for t in terms]
        key = (*values, *bodies)
        found = self.rigid.get(key)
        if found is None:
            found = self._inertia_and_bias(values, terms)
            for series in found:
                series.setflags(write=False)
            self.rigid[key] = found
            while len(self.rigid) > RIGID:
                self.rigid.pop(list(self.rigid)[0], None)  # noqa: RUF015  in one step: threads
        return found

    def _inertia_and_bias(
        self, values: Sequence[float], terms: Sequence[Term]
    ) -> tuple[Array, Array]:
        """The result of ``inertia_and_bias``, computed."""
        inertias, biases = [], []
        for value, basis in zip(values, self.basis.values(), strict=True):
            if basis.acts[0]:
                inertias.append(value * basis.inertia)
            if basis.acts[1]:
                biases.append(value * basis.bias)
        if self.links is not None and terms:
            change = self.links.change(terms, self.joint - 1)
            some = slice(self.first, self.first + self.n * self.every)
            inertias.append(means(change.inertia[some], self.every))
            biases.append(means(change.bias[some], self.every))
        inertia, bias = _sum(inertias, self.n), _sum(biases, self.n)
        return np.maximum(inertia, 1e-9 * self.scale.inertia, out=inertia), bias

    def bias_slope(self, model: Model) -> Array:
        """Derivative of the known torque by the joint's own position, (n,) N m/rad or N/m, for a
        load whose position differs from its motor's.
        """
        made = self._once.get("slope")
        if made is None and "fixed" in self.basis:
            made = self.basis["fixed"].slope
        if made is None:
            values = {key: mechanism_value(model, key, self.joint) for key in self.basis}
            slope = bias_slope(model, list(self.others), self.joint, values)
            made = np.ascontiguousarray(slope)
        return self._once.setdefault("slope", made)

    def reference_inertia(self, model: Model, inertia: Array) -> float:
        """Inertia that motor and load share, kg m^2 or kg: the part common to all poses, or the
        mean for a URDF or a simulator.
        """
        if model.called is not None:
            return float(np.mean(inertia))
        constant = [key for key in self.basis if key not in ("fixed", "p3")]
        if not constant:
            return float(np.mean(inertia))
        return float(
            sum(
                mechanism_value(model, key, self.joint) * self.basis[key].inertia[0]
                for key in constant
            )
        )


def _nothing_known() -> dict[str, Any]:
    """Empty caches, for another record or a part of one."""
    empty: dict[str, Any] = {key: {} for key in ("_gains", "_once", "fits", "runs", "traces")}
    return {"_thinned": None, **empty}


def _sum(parts: list[Array], n: int) -> Array:
    """Sum of some series (n,), the first of which may be written to where there are more."""
    if not parts:
        return np.zeros(n)
    for part in parts[1:]:
        parts[0] += part
    return parts[0]


def off_counts(record: JointRecord, model: Model) -> bool:
    """Whether positions lie beside the counts that the model states: what came after the sensor
    coloured its noise.
    """
    stated = per_joint(model.sensor.resolution, record.joint, 0.0)
    return record.measurement.resolution <= 0.0 < stated


def facts(
    record: JointRecord, model: Model | None = None, replaced: Mapping[str, float] | None = None
) -> Facts:
    """The facts of a recording, shared with the others of its joint (``share_facts``), and of a
    model, for the effects of a joint.

    Parameters
    ----------
    model : Model, optional
        Gives inertia and friction level.
    replaced : mapping, optional
        Numbers of the term that an effect would replace.
    """
    if record._facts is None:
        q, qd = record.motion.states[:2]
        command = np.abs(record.command)
        # for a joint that mostly rests, the RMS is its speed
        fast, fastest = (
            max(float(x), record.scale.speed) for x in np.quantile(np.abs(qd), (0.95, 0.99))
        )
        record._facts = Facts(
            scale=record.scale,
            centre=0.5 * (float(q.max()) + float(q.min())),
            fast=fast,
            fastest=fastest,
            weak=float(np.quantile(command, 0.05)),
            strong=max(float(np.quantile(command, 0.999)), record.scale.command),
            strongest=float(command.max()),
            sample_time=record.sample_time,
            slides=record.slides,
            sensor=record.measurement.std,
            lines=record.between > 0.0,
            joint=record.joint,
            joints=len(record.others),
            gain=1.0,
            inertia=record.scale.inertia,
            links=float(np.mean(record.basis["fixed"].inertia)) if "fixed" in record.basis else 0.0,
            temperature=(
                float(record.columns["temperature"][0])
                if "temperature" in record.columns
                else float("nan")
            ),
        )
    if model is None:
        return record._facts
    dry = sum(
        t.value("level") for t in model.at(record.joint) if get_effect(t.effect).site == "dry"
    )
    return replace(
        record._facts,
        gain=per_joint(model.actuator.gain, record.joint, 1.0),
        friction=dry,
        inertia=float(np.mean(effective_inertia(record, model))),
        replaced=dict(replaced or {}),
    )


def share_facts(records: Sequence[Sequence[JointRecord]]) -> None:
    """Give all recordings of a joint common facts: the range, speed and command over all of them.
    ``records``: a sequence of joints for each recording.
    """
    for joint in zip(*records, strict=True):
        each = [facts(record) for record in joint]
        pairs = list(zip(each, joint, strict=True))
        longest = facts(max(joint, key=lambda r: r.n))
        low, high = (
            [f.centre + half * f.scale.position for f in each] for half in (-0.5, 0.5)
        )
        way = max(high) - min(low)
        most = {
            name: max(getattr(f.scale, name) for f in each)
            for name in ("torque", "speed", "command", "seconds")
        }
        turn = longest.scale.turn * (way / longest.scale.position if longest.slides else 1.0)
        shared = replace(
            longest,
            scale=replace(longest.scale, position=way, turn=turn, **most),
            centre=0.5 * (min(low) + max(high)),
            weak=min(f.weak for f in each),
            links=sum(f.links * r.n for f, r in pairs) / sum(r.n for r in joint),
            **{
                name: max(getattr(f, name) for f in each)
                for name in ("fast", "fastest", "strong", "strongest")
            },
        )
        for record in joint:
            record._facts = shared


def along(record: JointRecord, model: Model) -> Along:
    """The measured motion of a joint, for the column of an effect."""
    q, qd, qdd = record.motion.states
    return Along(
        q=q,
        qd=qd,
        qdd=qdd,
        t=record.began + record.sample_time * np.arange(record.n, dtype=np.float64),
        torque=per_joint(model.actuator.gain, record.joint, 1.0) * record.command,
        sample_time=record.sample_time,
        inertia=effective_inertia(record, model),
        gravity=mechanism_value(model, "gravity", record.joint) if model.kind == "rotary" else 0.0,
        swung=swung,
        waves=record.waves,
        spring=_spring_of(model, record.joint),
    )


def _spring_of(model: Model, joint: int) -> tuple[float, ...]:
    """Stiffness, damping and load inertia of a joint's transmission; empty where it is rigid, or
    acts as no spring within its gap.
    """
    names = ("stiffness", "damping", "load_inertia")
    for term in model.at(joint):
        effect = get_effect(term.effect)
        if effect.family == "transmission" and not effect.rough:
            return tuple(term.value(name) for name in names)
    return ()


def effective_inertia(record: JointRecord, model: Model) -> Array:
    """Inertia that a torque at the joint accelerates, with the terms of kind inertia (rotors,
    payloads), (n,).
    """
    inertia, _ = record.inertia_and_bias(model)
    out: Array = np.maximum(inertia + added_inertia(model, record.joint), 0.05 * inertia)
    return out


def mechanism_value(model: Model, key: str, joint: int) -> float:
    """Value of a mechanism parameter for joint 1, 2, …; 0 where the model has none."""
    items = model.mechanism.get(key)
    if not items:
        return 0.0
    return items[joint - 1].value if joint - 1 < len(items) else items[0].value


def own_weight(model: Model, joint: int) -> tuple[float, float] | None:
    """The gravity torque of a joint (1-based) that no other moves, N m, and the position at which
    it hangs, rad; None where it has none, or it is a body of a chain.
    """
    if model.called is not None:
        own: tuple[float, float] | None = model.called.weight
        return own
    if model.kind in TREES and model.joints == 1 and model.joint_kind(1) == "rotary":
        quarter, still = np.array([0.0, 0.5 * math.pi]), np.zeros(2)
        across, along = tree_torques(model, [np.stack([quarter, still, still])])[0]
        torque = math.hypot(along, across)
        return (torque, math.atan2(-across, along)) if torque > ROUNDED else None
    torque = mechanism_value(model, "gravity", joint)
    return (abs(torque), 0.0 if torque > 0.0 else math.pi) if torque else None


def own_terms(terms: tuple[Term, ...]) -> tuple[Term, ...]:
    """The terms that the kernel evaluates at a joint, without bodies, which are in its inertia and
    bias.
    """
    bodies = at_site("body")
    return tuple([term for term in terms if term.effect not in bodies])
