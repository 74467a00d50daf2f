"""Where the mismatch lives: in time, and in the space of velocity, position, acceleration and
command.

The missing torque is the correction of an observer that keeps the model on the motion
(discrepancy.py). A single correction says little: on a plateau of the encoder there is none, at the
next change of the count a large one. So the torque of a sample is the one that fits the corrections
around it best. The less a torque changes these, the less certain it is. Its energy above that of
the sensor's noise is the mismatch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.series import stretches
from zendsp.diagnosis.measure.discrepancy import (
    BANDS,
    ENERGY_BLOCK,
    NOISE_DRAWS,
    band_of,
    deviation,
    kept,
)
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord, effective_inertia
from zendsp.physics.calibration.observed import damping_along, response
from zendsp.physics.calibration.predict import run
from zendsp.physics.kernel.smooth import moving_mean
from zendsp.physics.model import Model, per_joint

Array = npt.NDArray[np.float64]

VARIABLES = ("velocity", "speed", "position", "acceleration", "command")  # speed: |velocity|
SAMPLES = 20  # least number for intervals
EDGES = 5  # least different edges of bins: a variable with fewer is nearly constant
CONCENTRATED = 3.0  # times the mean energy: the mismatch is concentrated there
# least share of an interval over its part of the time, to be reported; chosen for readers (91 % of
# a mismatch in 85 % of the time had been reported), and decides no finding
MORE = 1.2
STANDS_OUT = 3.0  # standard deviations by which an interval holds more than its part of the time
AROUND = 2.0  # times an observer's memory: span in which a torque is taken as constant
PROBE = 1e-3  # of a joint's torque: a small torque whose trace shows what would be seen
UNSHOWN = 1e-6  # of the mean trace of a torque: less is rounding


@dataclass(frozen=True)
class Region:
    """An interval of one variable at one joint, with ``share`` of the mismatch in ``time_share`` of
    the time.
    """

    joint: int
    variable: str
    interval: tuple[float, float]
    share: float
    time_share: float
    unit: str = ""  # of the interval

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.variable} {low:.3g} … {high:.3g} {self.unit}".rstrip()


@dataclass(frozen=True)
class Missing:
    """The missing torque along a recording, (n,), N m or N, and its standard deviation, infinite
    where the recording shows nothing of it.
    """

    time: Array
    torque: Array
    std: Array
    variables: dict[str, Array]
    units: dict[str, str] = field(default_factory=dict)
    others: Array | None = None  # (joints, 3, n): position, velocity, acceleration of all joints
    recording: str = ""

    def along(self, variable: str) -> Array:
        """The values of one of `VARIABLES`, (n,)."""
        of_velocity = variable == "speed"
        return np.abs(self.variables["velocity"]) if of_velocity else self.variables[variable]

    @property
    def weight(self) -> Array:
        """Inverse variance of each sample, (n,); equal where there are no variances."""
        if not self.std.any():
            return np.ones(len(self.std))
        value: Array = 1.0 / np.maximum(self.std, 1e-150) ** 2
        return value


def mismatch(data: Data, model: Model, joint: int, band: float = BANDS[0]) -> list[Missing]:
    """The missing torque of one joint along each recording, from the corrections of an observer.

    Parameters
    ----------
    band : float
        Of the observer, rad/s.
    """
    out = []
    for rec in data.records:
        record = rec[joint - 1]
        q, qd, qdd = record.motion.states
        use = kept(record, band)
        torque, std = _seen(record, model, band_of(record, band), data.inner)
        time = record.t0 + np.arange(record.n, dtype=np.float64) * record.sample_time
        variables = {"velocity": qd, "position": q, "acceleration": qdd, "command": record.command}
        within = {n: v[use] for n, v in variables.items()}
        named = units(model, joint)
        all_joints = record.others[:, :, use]
        out.append(
            Missing(
                time[use], torque[use], std[use], within, named, all_joints, record.recording
            )
        )
    return out


def _seen(record: JointRecord, model: Model, band: float, inner: int) -> tuple[Array, Array]:
    """The missing torque and its standard deviation, (n,) each, by least squares over the
    innovations around each sample, from their response to a torque of ``PROBE``. There is no
    response where dry friction holds the joint, or on a plateau of the encoder. Where the torque
    found makes the innovations larger (it breaks a stuck joint loose), it is taken as uncertain by
    its own size.
    """
    probe = PROBE * max(record.scale.torque, 1e-300)
    plain = np.clip(run(record, model, band, inner=inner).innovations, -1e6, 1e6)
    pushed = run(record, model, band, inner=inner, extra=np.full(record.n, probe)).innovations
    shown = (np.clip(pushed, -1e6, 1e6) - plain) / probe
    width = max(1, round(AROUND / band / record.sample_time))
    lag = min(record.n, round(np.sqrt(2) / band / record.sample_time))

    def around(product: Array) -> Array:
        """The sum of a series around each sample, without the observer's delay."""
        value: Array = np.r_[moving_mean(product, width)[lag:], np.zeros(lag)] * width
        return value

    seen = around(shown**2)
    clear = seen > UNSHOWN * float(np.mean(seen))
    per = np.divide(1.0, seen, out=np.zeros(record.n), where=clear)
    torque = -around(plain * shown) * per
    # innovations from sensor noise are not white: the factor on the variance of the torque
    draws = np.random.default_rng(0).standard_normal((2, NOISE_DRAWS, record.n))
    inertia, damping = effective_inertia(record, model), damping_along(record, model)
    noise = draws[0] * np.sqrt(np.maximum(record.measurement.variance, 0.0))
    noise = response(record, band, inertia, damping, noise, on_sensor=True)
    if record.between > 0.0:
        noise += response(record, band, inertia, damping, record.between * draws[1])
    of_noise = [around(row * shown)[clear] ** 2 * per[clear] for row in noise]
    std = np.sqrt(np.mean(of_noise) * per) if clear.any() else per
    tried = run(record, model, band, inner=inner, extra=torque).innovations
    left = around(np.clip(tried, -1e6, 1e6) ** 2) / np.maximum(around(plain**2), 1e-300)
    wrong = np.sqrt(np.maximum(left, 0.0)) * np.maximum(std, np.abs(torque))
    return torque, np.where(clear, np.where(left > 1.0, wrong, std), np.inf)


def units(model: Model, joint: int) -> dict[str, str]:
    """The unit of each variable at one joint."""
    length = "m" if model.joint_kind(joint) == "linear" else "rad"
    plain = abs(per_joint(model.actuator.gain, joint, 1.0)) == 1.0 and not model.actuator.matrix
    command = model.actuator.command_unit or (model.torque_unit(joint) if plain else "")
    return {
        "position": length,
        "velocity": f"{length}/s",
        "acceleration": f"{length}/s²",
        "command": command,
    }


def energy(missing: Missing) -> tuple[Array, Array]:
    """Square of the missing torque less the variance of its estimate, on average 0 where nothing is
    missing; and the weight of each sample, at most 1, lower where it is less certain than usual.
    Shapes (n,).
    """
    weight = missing.weight
    usual = float(np.median(weight))  # 0 where most of a recording shows nothing
    counts = np.minimum(1.0, weight / usual) if usual > 0.0 else (weight > 0.0).astype(float)
    variance = np.where(counts > 0, missing.std, 0.0) ** 2
    return np.where(counts > 0, missing.torque**2 - variance, 0.0), counts


def shares(e: Array, counts: Array, bins: npt.NDArray[np.int_], count: int) -> Array:
    """The part of the mismatch in each bin, (count,): the mean energy seen there times the time
    spent; zeros where there is none.

    Parameters
    ----------
    e, counts : ndarray, shape (n,)
        As ``energy`` returns them.
    """
    seen = np.maximum(np.bincount(bins, counts, count), 1e-300)
    mean = np.maximum(np.bincount(bins, counts * e, count) / seen, 0.0)
    held = mean * np.bincount(bins, minlength=count)
    total = float(held.sum())
    value: Array = held / max(total, 1e-300)
    return value


def regions(missing: Sequence[Missing], joint: int) -> list[Region]:
    """The interval of each variable in which the mismatch of all recordings is most concentrated,
    the most concentrated first; none where it may be chance.
    """
    found = []
    if not missing:
        return []
    each = [energy(m) for m in missing]
    e, counts = (np.concatenate(x) for x in zip(*each, strict=True))
    for name in VARIABLES:
        v = np.concatenate([m.along(name) for m in missing])
        if float(np.ptp(v)) <= 0:
            continue
        edges = np.unique(np.quantile(v, np.linspace(0, 1, 41)))
        if len(edges) < EDGES:
            continue
        bins = np.clip(np.searchsorted(edges, v, side="right") - 1, 0, len(edges) - 2)
        share = shares(e, counts, bins, len(edges) - 1)
        time = np.bincount(bins, minlength=len(edges) - 1) / len(v)
        gain = share - time  # the interval whose share exceeds its time most (maximum subarray)
        best, start, run_, at = 0.0, 0, 0.0, (0, 0)
        for i, g in enumerate(gain):
            if run_ <= 0:
                run_, start = 0.0, i
            run_ += g
            if run_ > best:
                best, at = run_, (start, i)
        a, b = at
        of_time = float(time[a : b + 1].sum())
        if float(share[a : b + 1].sum()) < MORE * of_time:
            continue
        if name == "speed" and a == 0:  # slow motion is an interval of the velocity
            continue
        within = (bins >= a) & (bins <= b)
        if not _stands_out(missing, (within - of_time) * counts * e):
            continue
        found.append(
            Region(
                joint,
                name,
                (float(edges[a]), float(edges[b + 1])),
                float(share[a : b + 1].sum()),
                of_time,
                missing[0].units.get("velocity" if name == "speed" else name, ""),
            )
        )
    found.sort(key=lambda r: r.time_share - r.share)
    either = [r for r in found if r.variable in ("velocity", "speed")]
    return [r for r in found if r not in either[1:]]  # the same motion, told once


def _stands_out(missing: Sequence[Missing], excess: Array) -> bool:
    """Whether an interval holds more of the mismatch than its part of the time, beyond chance.
    ``excess``: that of each sample of all recordings.
    """
    sums: list[float] = []
    parts = np.split(excess, np.cumsum([len(m.time) for m in missing])[:-1])
    for m, part in zip(missing, parts, strict=True):
        period = float(m.time[1] - m.time[0]) if len(part) > 1 else 1.0
        blocks = np.array_split(part, max(1, round(len(part) * period / ENERGY_BLOCK)))
        sums += [float(block.sum()) for block in blocks]
    return bool(sum(sums) > STANDS_OUT * deviation(np.array(sums)))


Times = tuple[tuple[float, float], ...]
MOST = 6  # reported regions and times
MOST_TIMES = 5  # times of one recording


def located(
    missing: Mapping[int, Sequence[Missing]],
) -> tuple[tuple[Region, ...], Times, tuple[str, ...]]:
    """Where the missing torque of each joint lies: regions of its state, times (s), and the
    recordings of these times; those with most of it.
    """
    places = [r for joint, parts in missing.items() for r in regions(parts, joint)[:2]]
    spans = sorted(
        (m.recording, *span) for parts in missing.values() for m in parts for span in intervals(m)
    )
    apart: list[tuple[str, float, float, float]] = []
    for name, begin, end, share in spans:
        if apart and apart[-1][0] == name and begin <= apart[-1][2]:  # of another joint too
            _, first, last, most = apart.pop()
            apart.append((name, first, max(last, end), max(most, share)))
        else:
            apart.append((name, begin, end, share))
    largest = sorted(apart, key=lambda s: -s[3])[:MOST]
    return (
        tuple(sorted(places, key=lambda r: r.time_share - r.share)[:MOST]),
        tuple((begin, end) for _, begin, end, _ in largest),
        tuple(name for name, *_ in largest),
    )


def lies_in(missing: Missing, begin: float, end: float) -> bool:
    """Whether more of the mismatch lies between two times, s, than in as much time elsewhere."""
    e, counts = energy(missing)
    e, inside = counts * e, (begin <= missing.time) & (missing.time <= end)
    return bool(inside.any() and np.mean(e[inside]) > np.mean(e))


def intervals(missing: Missing) -> list[tuple[float, float, float]]:
    """Time intervals in which the mismatch is concentrated: (start s, end s, share), largest share
    first.
    """
    e, counts = energy(missing)
    e = counts * e
    total = float(e.sum())
    if total <= 0 or len(e) < SAMPLES:
        return []
    period = float(missing.time[1] - missing.time[0])
    width = max(3, round(0.1 / period))
    level = moving_mean(e, width)
    of_noise = float(np.median(missing.std) ** 2)
    high = level > CONCENTRATED * max(float(np.mean(e)), of_noise)
    spans: list[tuple[int, int]] = []
    for a, b in stretches(high):
        if spans and a - spans[-1][1] < 2 * width:
            spans[-1] = (spans[-1][0], b)
        else:
            spans.append((a, b))
    out = [
        (
            float(missing.time[a]),
            float(missing.time[min(b, len(e)) - 1]),
            float(e[a:b].sum()) / total,
        )
        for a, b in spans
    ]
    return sorted(out, key=lambda s: -s[2])[:MOST_TIMES]
