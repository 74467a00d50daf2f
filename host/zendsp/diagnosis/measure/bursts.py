"""Missing torque that comes and goes with time, or is periodic in time, whatever the joint does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.series import stretches
from zendsp.diagnosis.measure.acting import (
    LACKING_BAND,
    Acting,
    acting_of,
    lacks_of,
    largest,
    peak_of,
    quiet_energy,
)
from zendsp.diagnosis.measure.curve import DRY
from zendsp.diagnosis.measure.discrepancy import (
    BANDS,
    FASTEST,
    TURNING,
    band_of,
    kept,
    lacking,
    mean_square,
    reversals,
)
from zendsp.diagnosis.measure.neighbours import TURNS_ROUND
from zendsp.diagnosis.measure.structure import unit
from zendsp.physics.calibration.fit import Data
from zendsp.physics.effects import get_effect, mechanism_of
from zendsp.physics.kernel.smooth import moving_median
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

SINE_BAND = 64.0  # rad/s, of the observer in which a sine is looked for
BRIEF = 0.4  # of the time at most: a torque that acts longer is no disturbance
# of the energy that a normally distributed random torque would have outside that time: less is left
BURST_SHARE = 0.4
# least part of that time in states that the joint visits without it too, and the time that is
# enough: ten memories of the observer. A push of 2 s had 0.23, so 0.46 s
REVISITED, REVISITED_S = 0.3, 0.3
# RMS torque within that time against that outside: if it stands out as much, it may hold less of
# the energy. Pushes of 5 % of the torque beside a coarse encoder had 12
STANDS_FAR = 10.0
CHANCE = 1e-3  # probability that the largest spectral line of noise stands out as far
NEIGHBOUR_LINES = 20  # neighbours on either side, whose median is the noise level
# of the joint's way: a torque that acts while the joint covers more belongs to its motion. A push
# of 1 s in 9 s has 0.05 to 0.3; chosen on two arms whose joints moved one after the other
OF_THE_WAY = 0.5
# Part of the energy at reversals, and part of the reversals: above both, it is the joint's friction
# at reversals. Soft friction came at 11 of 16 reversals and more, two pushes at 1 of 16 and 5 of
# 32.
MOSTLY, OFTEN = 0.5, 0.3
# mean torque in the one direction of motion over that in the other: above, it is no friction, which
# resists. Two pushes of 5 % of the torque had 0.89 and 0.91
ONE_WAY = 0.5
# probability that a joint starts to move within each of the pushes by chance: three starts against
# a friction that grows with rest had 0.0003; chosen on this one case
MOVED_OFF = 0.01
# Times a model's dry friction, which holds a joint by no more than itself. A model in which
# friction has the wrong sign lacks twice as much.
STICKS = 3.0
# Part of the mean energy at reversals, and part of the time: a torque with this much energy in this
# much of its time elsewhere does not come from reversals.
LASTING, ELSEWHERE = 0.25, 0.1
# Most intervals over which its energy is spread: in recordings that no model was fitted to (or
# where those lack nothing), and in all others and in each on average. There five pushes had at most
# 1.4, a strap at the ends of the travel 2.6; over all of three recordings 2.3, and a strap, a gap
# and two frictions 6.0 to 12.3.
MANY, FEW = 12, 2
# least slow part of a push's energy: the ringing of a joint's own spring had 0.46 to 0.75, pushes
# 0.94 and more
STEADY = 0.85
# of the energy of the largest interval: half of its torque for as long; chosen on two cases
A_LARGE = 0.25


@dataclass(frozen=True)
class Bursts:
    """Times (s) in which nearly all of a missing torque acts, though the joint visits the same
    states at other times, and the ``recordings`` of these times.

    ``share``: their part of its energy. ``peak``: the largest torque (N m or N). ``rms``: its RMS
    within them. ``beside``: the missing torque outside. ``least``: the squared torque above which
    it acts. ``spread``: the number of intervals that would hold its energy evenly. ``steady``: the
    part of its energy that is slower than the observer's memory. ``driven``: the command is larger
    within them than anywhere else.
    """

    intervals: tuple[tuple[float, float], ...]
    recordings: tuple[str, ...]
    share: float
    peak: float
    rms: float
    beside: float
    least: float
    spread: float
    energies: tuple[float, ...]
    steady: float
    driven: bool = False

    def largest(self) -> Bursts:
        """The bursts without intervals that hold less than ``A_LARGE`` of the energy of the
        largest.
        """
        use = [e >= A_LARGE * max(self.energies) for e in self.energies]
        return replace(
            self,
            intervals=tuple(compress(self.intervals, use)),
            recordings=tuple(compress(self.recordings, use)),
            energies=tuple(compress(self.energies, use)),
        )


def _states(parts: Sequence[Acting], joint: int) -> list[Array]:
    """Cells of a joint's state, recordings one after the other, (n,) each: place with direction and
    speed; travel since the last reversal; the place of each neighbour with the direction.
    """

    def places(x: Array, count: int) -> Array:
        return np.floor((count - 0.01) * unit(x, (float(x.min()), float(x.max()))))

    rows: list[list[Array]] = []
    for acting in parts:
        for rec, use in zip(acting.of.data.records, acting.of.used, strict=True):
            q, v = (x[use] for x in rec[joint - 1].motion.states[:2])
            turns = np.flatnonzero(np.diff(v > 0)) + 1
            since = np.zeros(len(q), int)
            since[turns] = turns
            way = np.abs(q - q[np.maximum.accumulate(since)])
            beside = [k for k in (joint - 1, joint + 1) if 1 <= k <= len(rec)]
            rows.append([q, v, way, *[rec[k - 1].motion.states[0][use] for k in beside]])
    q, v, way, *others = (np.concatenate(column) for column in zip(*rows, strict=True))
    fast = np.minimum(2, np.floor(np.abs(v) / max(float(np.std(v)), 1e-300)))
    forward = (v > 0).astype(float)
    cells = [6 * places(q, 20) + 3 * forward + fast, 2 * places(way, 20) + forward]
    return [*cells, *[2 * places(other, 20) + forward for other in others]]


def bursts(
    data: Data,
    model: Model,
    joint: int,
    beside: Data,
    many: int = MANY,
    dry: float = 0.0,
    often: float = OFTEN,
) -> Bursts | None:
    """The times outside of which a model lacks hardly any torque; None where there are none.

    Parameters
    ----------
    joint : int
        1-based.
    beside : Data
        Other recordings, which show how little acts at other times; for a machine of one joint also
        in which states (torque from other joints depends on more than the cells hold).
    many : int
        Most intervals; a torque with more follows something else than time.
    dry : float
        RMS of the model's dry friction, N m or N; 0: none. A torque at many reversals that is no
        larger than ``STICKS`` times that may be friction.
    often : float
        Part of the reversals that counts as "many".
    """
    if data.bandwidth[joint - 1] > BANDS[0]:
        return None  # what a slower observer shows, which does not hold the model, is no push
    here, there = lacks_of(data, model, joint), lacks_of(beside, model, joint)
    quiet = quiet_energy((here, there))
    acting = acting_of(here, joint, quiet)
    peak = peak_of(acting)
    out = _summed([acting], joint)
    if len(out.intervals) > 1 and peak < _fall(model, joint):
        return None  # this much is missing wherever the model sticks and the joint slides
    as_friction = dry > 0.0 and peak < STICKS * dry and not _either_way(acting, joint)
    if as_friction and (_turns(acting, joint, often) or _holds(acting, joint)):
        return None
    others = acting_of(there, joint, quiet, acting.least)
    if _of_the_way((acting, others), joint) > OF_THE_WAY:
        return None  # it acts when the joint moves, as in recordings of one joint after the other
    covered = sum(int(high.sum()) for high in acting.masks)
    count = sum(len(high) for high in acting.masks)
    rest = sum(len(high) for high in others.masks)
    if not covered or covered > BRIEF * (count + rest):
        return None
    every = [acting, others] if data.joints == 1 else [acting]
    high = np.concatenate([mask for a in every for mask in a.masks])
    seen = [np.isin(c, np.unique(c[~high])) for c in _states(every, joint)]
    enough = min(REVISITED * covered, REVISITED_S / data.records[0][joint - 1].sample_time)
    if int(np.all(seen, axis=0)[:count][high[:count]].sum()) < enough:
        return None
    whole = _summed([acting, others], joint)
    all_covered = covered + sum(int(high.sum()) for high in others.masks)
    # a push may fill most of these recordings, and bend the missing torque of the others
    scattered = _scattered(out.share, covered / count) and _scattered(
        whole.share, all_covered / (count + rest)
    )
    return None if scattered or out.spread > many else out


def _fall(model: Model, joint: int) -> float:
    """The excess of a model's dry friction at rest over that when sliding, N m or N; 0 where it
    does not fall with the speed.
    """
    terms = [t for t in model.at(joint) if mechanism_of(t.effect) == DRY]
    return sum(t.value(p.name) for t in terms for p in get_effect(t.effect).parameters if p.above)


def _of_the_way(parts: Sequence[Acting], joint: int) -> float:
    """The part of a joint's way that it covers while a torque acts."""
    within = whole = 0.0
    for acting in parts:
        of = acting.of
        for high, use, rec in zip(acting.masks, of.used, of.data.records, strict=True):
            speed = np.abs(rec[joint - 1].motion.states[1][use]) * rec[joint - 1].sample_time
            within += float(speed[high].sum())
            whole += float(speed.sum())
    return within / max(whole, 1e-300)


def _scattered(share: float, part: float) -> bool:
    """Whether too much of the energy lies outside a ``part`` of the time, which holds the
    ``share``.
    """
    normal = NormalDist()
    z = -normal.inv_cdf(0.5 * part)
    # of a random torque's energy, in its largest values over that part of the time
    by_chance = 2.0 * (z * normal.pdf(z) + normal.cdf(-z))
    if share * (1.0 - part) > STANDS_FAR**2 * (1.0 - share) * part:
        return False
    return 1.0 - share > BURST_SHARE * (1.0 - by_chance)


def _turns(acting: Acting, joint: int, often: float) -> bool:
    """Whether a torque acts only at reversals, and not just at a few of them."""
    there = total = 0.0
    turning = moving = met = count = 0
    for high, lack, use, rec in zip(
        acting.masks, acting.of.lacks, acting.of.used, acting.of.data.records, strict=True
    ):
        record = rec[joint - 1]
        turns = reversals(record, band_of(record, LACKING_BAND))[use]
        energy = lack**2 * high
        there += float(energy[turns].sum())
        total += float(energy.sum())
        turning += int((high & turns).sum())
        moving += int((high & ~turns).sum())
        each = stretches(turns)
        count += len(each)
        met += sum(bool(high[a:b].any()) for a, b in each)
    if moving > ELSEWHERE * (turning + moving) and (
        (total - there) * turning > LASTING * there * moving
    ):
        return False
    return there > MOSTLY * total and met > often * count


def _either_way(acting: Acting, joint: int) -> bool:
    """Whether most of a torque acts one way while the joint moves both ways, as no friction does.
    A torque while the joint stands tells nothing.
    """
    alike = total = 0.0
    for high, lack, use, rec in zip(
        acting.masks, acting.of.lacks, acting.of.used, acting.of.data.records, strict=True
    ):
        v = rec[joint - 1].motion.states[1][use]
        slow = TURNING * float(np.quantile(np.abs(v), FASTEST))
        for a, b in stretches(high):
            total += float(np.sum(lack[a:b] ** 2))
            ways = [lack[a:b][side] for side in (v[a:b] > slow, v[a:b] < -slow)]
            if min(map(len, ways)) >= ELSEWHERE * (b - a):
                up, down = (float(np.mean(way)) for way in ways)
                if up * down > ONE_WAY * max(up**2, down**2):
                    alike += sum(float(np.sum(way**2)) for way in ways)
    return alike > MOSTLY * total


def _holds(acting: Acting, joint: int) -> bool:
    """Whether the joint starts to move in each interval in which a torque acts, and the torque
    resists: a friction that rest raises. Not where this may be chance.
    """
    chance, against = 1.0, 0.0
    for high, lack, use, rec in zip(
        acting.masks, acting.of.lacks, acting.of.used, acting.of.data.records, strict=True
    ):
        speed = np.abs(rec[joint - 1].motion.states[1][use])
        slow = speed < TURNS_ROUND * float(np.quantile(speed, FASTEST))
        begins = np.cumsum(np.r_[0, slow[:-1] & ~slow[1:], 0])  # starts of motion up to each sample
        for a, b in stretches(high):
            if begins[b] == begins[a]:
                return False
            length = min(b - a, len(high) - 1)  # part of intervals as long with a start
            chance *= float(np.mean(begins[length:] > begins[:-length]))
        against += float((lack * rec[joint - 1].motion.states[1][use]) @ high)
    return against > 0.0 and chance < MOVED_OFF


def everywhere(found: Bursts, parts: Sequence[Data], model: Model, joint: int) -> Bursts:
    """The bursts in all recordings of a torque found in some of them."""
    each = [lacks_of(data, model, joint) for data in parts]
    quiet = quiet_energy(each)
    out = _summed([acting_of(part, joint, quiet, found.least) for part in each], joint)
    return replace(out, driven=_driven(out, parts, joint))


def _driven(push: Bursts, each: Sequence[Data], joint: int) -> bool:
    """Whether half of the commands at the times of a push are larger than any other: the drive may
    have been at its limit, or the loop resisted what pushed it.
    """
    within, beside = [], []
    near = 2.0 / LACKING_BAND  # s, an observer's memory
    for record in (rec[joint - 1] for data in each for rec in data.records):
        t: Array = record.t0 + record.sample_time * np.arange(record.n, dtype=np.float64)
        u = np.abs(record.command)
        within.append(u[~_away(push, record.recording, t)])
        beside.append(u[_away(push, record.recording, t, near)])
    inside, most = np.concatenate(within), max(np.max(u, initial=0.0) for u in beside)
    return bool(inside.size) and float(np.median(inside)) > float(most)


def part_of_the_time(found: Bursts, data: Data, joint: int) -> float:
    """The part of the time of some recordings in which a torque acts."""
    acts = []
    for record in (rec[joint - 1] for rec in data.records):
        t: Array = record.t0 + record.sample_time * np.arange(record.n, dtype=np.float64)
        acts.append(~_away(found, record.recording, t))
    return float(np.mean(np.concatenate(acts)))


def _away(
    found: Bursts, recording: str, t: Array, near: float = 0.0
) -> npt.NDArray[np.bool_]:
    """The mask of those times of a recording, s, that are more than ``near`` s away from the found
    ones.
    """
    out = np.ones(len(t), bool)
    for (a, b), name in zip(found.intervals, found.recordings, strict=True):
        out &= (name != recording) | (t < a - near) | (t > b + near)
    return out


def apart(
    found: Bursts, parts: Sequence[Data], model: Model, joint: int
) -> tuple[float, float]:
    """RMS of the missing torque within the found times and outside, N m or N."""
    energy, count = [0.0, 0.0], [0, 0]
    for part in parts:
        of = lacks_of(part, model, joint)
        for smooth, use, rec in zip(of.smooth, of.used, part.records, strict=True):
            record = rec[joint - 1]
            t = record.t0 + record.sample_time * (use.start + np.arange(len(smooth)))
            out = _away(found, record.recording, t)
            for k, times in enumerate((~out, out)):
                energy[k] += float(np.sum(smooth[times] ** 2))
                count[k] += int(times.sum())
    inside, beside = (float(np.sqrt(e / max(n, 1))) for e, n in zip(energy, count, strict=True))
    return inside, beside


def _summed(parts: Sequence[Acting], joint: int) -> Bursts:
    """The intervals and sizes of an acting torque."""
    spans: list[tuple[float, float]] = []
    names: list[str] = []
    inside: list[Array] = []
    outside: list[Array] = []
    energy = [0.0, 0.0]
    seen = 0.0
    each: list[float] = []
    peaks: list[float] = []
    for acting in parts:
        of = acting.of
        for high, lack, counted, smooth, use, rec in zip(
            acting.masks, of.lacks, of.counted, of.smooth, of.used, of.data.records, strict=True
        ):
            step, start = rec[joint - 1].sample_time, rec[joint - 1].t0
            ends = stretches(high)
            spans += [
                (start + (use.start + a) * step, start + (use.start + b - 1) * step)
                for a, b in ends
            ]
            names += [rec[joint - 1].recording] * len(ends)
            each += [float(np.sum(lack[a:b] ** 2)) for a, b in ends]
            # the observer spikes at reversals of friction: intervals as short as its memory are
            # dropped
            if ends:
                calm = moving_median(lack, max(1, round(1.0 / LACKING_BAND / step)))
                peaks += [largest(calm[a:b]) for a, b in ends]
            inside.append(smooth[high])
            outside.append(smooth[~high])
            energy[0] += float(np.sum(lack[high] ** 2))
            energy[1] += float(np.sum(lack[~high] ** 2))
            seen += float(np.sum(counted[high] ** 2))
    within, beside = np.concatenate(inside), np.concatenate(outside)
    steady = float(np.sum(within**2)) / max(seen, 1e-300)
    peak = max(peaks, default=0.0)
    within = np.minimum(np.abs(within), peak)
    return Bursts(
        tuple(spans),
        tuple(names),
        energy[0] / max(sum(energy), 1e-300),
        peak,
        float(np.sqrt(np.sum(within**2) / max(len(within), 1))),
        float(np.sqrt(np.sum(beside**2) / max(len(beside), 1))),
        max(acting.least for acting in parts),
        sum(each) ** 2 / max(sum(e * e for e in each), 1e-300),
        tuple(each),
        steady,
    )


def periodic(data: Data, model: Model, joint: int) -> float:
    """RMS of the one sine that stands out of the missing torque, as a part of the RMS torque; 0
    where none does in every recording (Fisher 1929, with the noise of the neighbouring lines).
    """
    sizes, places = [], []
    scale = np.sqrt(mean_square(data, joint))
    for lack, rec in zip(lacking(data, model, joint, SINE_BAND), data.records, strict=True):
        record = rec[joint - 1]
        here = lack[kept(record, SINE_BAND)]
        window, seconds = np.hanning(len(here)), len(here) * record.sample_time
        power = np.abs(np.fft.rfft((here - here.mean()) * window)) ** 2
        level = moving_median(power, 2 * NEIGHBOUR_LINES + 1) / np.log(2)
        out = power[2:] / np.maximum(level[2:], 1e-300)
        peak = int(np.argmax(out))
        if len(out) * np.exp(-float(out[peak])) > CHANCE:
            return 0.0
        lines = power[peak : peak + 5].sum()
        sizes.append(float(np.sqrt(2 * lines / len(here) / (window**2).sum())) / scale)
        places.append(((peak + 2) / seconds, 2 / seconds))
    if max(f for f, _ in places) - min(f for f, _ in places) > max(d for _, d in places):
        return 0.0
    return float(np.median(sizes))
