"""Static friction: the breakaway torque, and the stiffness of the bristles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from zendsp.errors import Unmeasured
from zendsp.experiment.estimates import NORMAL, half_width, mean_of
from zendsp.experiment.figures import BLUE, RED, label, make_figure, save
from zendsp.experiment.joints import USED, Array, Axis
from zendsp.experiment.knowing import as_found, refuse_none, shipped, with_values
from zendsp.experiment.lab import Bench, Lab
from zendsp.experiment.low_speed import low_speed
from zendsp.experiment.push import BRAKING, PUSHING, Pusher
from zendsp.experiment.result import Estimate, Result
from zendsp.experiment.staircase import (
    HOLD,
    Steps,
    began_at,
    breakaway_torque,
    bristle_stiffness,
    one_way,
    pushed_way,
    refuse_held_up,
    staircase,
)
from zendsp.experiment.watch import left_out
from zendsp.recording import Recording

# the same for the stiffness of bristles: fast against what the drive's noise lets them creep
FAST_HOLD = 0.001
CREEP = 0.006  # of the stiffness: what they still creep, as pushes of other speeds show
FAST_WINDOW = 0.031  # s that a fast push is smoothed over
# of the friction: a push that ends so early (a fast one in 0.3 s, of which 0.2 s are smoothed over)
# is made again, with so much taken off what holds the joint
EARLY, EASED = 0.15, 0.5
# of the encoder, that bristles must bend by for their stiffness to be told: at 16 counts it is 3 %
# off, at 12 6 %, at 8 47 % (docs/measurements/experiments.md)
COUNTS = 12.0


def breakaway(lab: Lab, count: int = 6, joints: tuple[int, ...] = ()) -> Result:
    """Static friction: torque steps both ways from several positions; the result is the mean of the
    breakaway torques.

    The positions are drawn at random, because friction varies with place: only then does the spread
    of a few torques tell how far their mean may be from that of all places. A joint that carries a
    weight that no model states is pushed both ways from the same places: half the difference of the
    two torques is friction, half the sum weight.

    Parameters
    ----------
    lab : Lab
    count : int
        Places of a joint and direction.
    joints : tuple of int
        Which; default: all that have a drive.
    """
    arm = shipped(lab)
    low = None
    if arm is None:
        own = [(f"peak{j}",) for j in joints]
        low = with_values(lab, "low-speed", lambda lab: low_speed(lab, joints=joints), own)
    of = " of the planar arm" if arm is not None else ""
    result = Result("breakaway", f"Static friction{of}", lab.machine_of("breakaway"))
    found: dict[int, Pushes] = {}
    with lab.bench(result.name, result) as bench:
        known = as_found(bench, lab, low)
        pusher = Pusher(bench, known)
        for joint in joints or known.axes:
            with left_out(result, bench.target, joint):
                found[joint] = pushes = _pushes(pusher, lab, joint, count)
                (_report if pushes.apart else _report_weighing)(result, pushes)
                _report_stiffness(result, pushes)
        result.recordings, result.target = bench.recordings, bench.where
        refuse_none(result, found)
        result.figure = _draw(found, bench)
    return result


class Push(NamedTuple):
    """The result of two pushes at a place: friction that a slow and a fast staircase found held (N
    m); stiffness from the fast one (N m/rad), the difference between two ways of reading it, and
    the counts by which the bristles bent; the noise that the largest value may be of, N m.
    """

    place: float
    torque: float
    fast_torque: float
    stiffness: float
    apart: float
    bent: float
    noise: float


@dataclass
class Pushes:
    """All pushes of one joint by direction.

    Attributes
    ----------
    axis : Axis
    apart : bool
        Whether what the directions differ by is friction's.
    by : dict of int to list of Push
    early : Estimate
        By how much the joint breaks away too early.
    """

    axis: Axis
    apart: bool
    by: dict[int, list[Push]] = field(default_factory=dict)
    early: Estimate = field(default_factory=lambda: Estimate(0.0))


def _pushes(pusher: Pusher, lab: Lab, joint: int, count: int) -> Pushes:
    known, axis = pusher.known, pusher.known.axes[joint]
    pushes = Pushes(axis, known.apart or weight_told(axis))
    places = lab.random.uniform(*axis.places, count)
    for direction in (1, -1):
        if direction < 0 and pushes.apart:
            places = lab.random.uniform(*axis.places, count)
        pushes.by[direction] = [_break_away(pusher, joint, direction, float(x)) for x in places]
    differ = [push.torque - push.fast_torque for way in pushes.by.values() for push in way]
    pushes.early = too_early(axis, differ)
    return pushes


def weight_told(axis: Axis) -> bool:
    """Whether a joint's motion tells its weight from a friction that differs by direction: it turns
    and carries none, or both were found.
    """
    return axis.load.uneven != 0.0 or (axis.unit == "rad" and not axis.load.weighs)


def too_early(axis: Axis, apart: Sequence[float]) -> Estimate:
    """By how much a joint breaks away too early because the torque still grows meanwhile, N m.

    A joint breaks away where friction can hold no more torque. This is a fold, which under a torque
    that grows at a rate r is passed at a speed of r^(1/3). Friction falls as the square of a small
    speed, so the missing torque goes as r^(2/3), and two rates determine it. An exponent of 1/2
    would give half as much again, and 1 half as much; its standard deviation is therefore a third.

    Parameters
    ----------
    axis : Axis
    apart : sequence of float
        Breakaway torque of each slow push less that of the fast push at its place, N m.
    """
    share = 1.0 / ((axis.fast / axis.slow) ** (2 / 3) - 1.0)
    lost = mean_of([share * x for x in apart], axis.force)
    return Estimate(lost.value, float(np.hypot(lost.std, lost.value / 3)), axis.force)


def _report(result: Result, pushes: Pushes) -> None:
    """Add the breakaway torques to the result.

    Friction of both directions varies along the same path, so they share their spread. Its
    distribution over places is not normal: four places alone look too even once in ten times.
    """
    axis, early, both = pushes.axis, pushes.early, []
    torques = {d: [push.torque for push in pushes.by[d]] for d in (1, -1)}
    shared = _shared(pushes)
    for direction in (1, -1):
        word = axis.word(direction)
        each = mean_of(torques[direction], axis.force, shared, beside=torques[-direction])
        each = Estimate(each.value + early.value, each.std, axis.force)
        result.values[f"breakaway{axis.number}_{word}"] = each
        both.append(each)
        result.tables.setdefault("breakaway", []).append(
            {
                "joint": axis.number,
                "direction": word,
                f"torque {axis.force}": _short(each.value),
                f"± {axis.force}": _short(each.std),
                f"each {axis.force}": ", ".join(f"{x:.3g}" for x in torques[direction]),
            }
        )
    result.values[f"breakaway{axis.number}"] = Estimate(
        float(np.mean([e.value for e in both])),
        float(np.hypot(both[0].std, both[1].std) / 2),
        axis.force,
    )


def _shared(pushes: Pushes) -> float:
    """Standard deviation of what all pushes share: the height of a step, what is lost to the rate
    of the torque, what noise adds to a largest value, and a weight that was taken off.
    """
    noise = float(np.mean([push.noise for way in pushes.by.values() for push in way]))
    step, load = pushes.axis.slow * HOLD / np.sqrt(12), pushes.axis.load
    weight = load.weight_std if load.uneven else 0.0
    return float(np.linalg.norm([step, pushes.early.std, noise, weight]))


def _report_weighing(result: Result, pushes: Pushes) -> None:
    """Add breakaway torque and weight of a joint that was pushed both ways from each place."""
    axis, early = pushes.axis, pushes.early
    up, down = ([push.torque for push in pushes.by[d]] for d in (1, -1))
    places = np.array([push.place for push in pushes.by[1]])
    level = 0.5 * (np.array(up) + np.array(down))
    weight = axis.load.weight(places) + 0.5 * (np.array(up) - np.array(down))
    mean = mean_of(level.tolist(), axis.force, _shared(pushes))
    mean = Estimate(mean.value + early.value, mean.std, axis.force)
    result.values[f"breakaway{axis.number}"] = mean
    if axis.unit == "rad":
        for name, part in zip(("cos", "sin"), _turning(places, weight, pushes), strict=True):
            result.values[f"weight{axis.number}_{name}"] = part
    else:
        result.values[f"weight{axis.number}"] = mean_of(weight.tolist(), axis.force)
    unit, force = axis.unit, axis.force
    result.tables.setdefault("at each place", []).extend(
        {
            "joint": axis.number,
            f"place {unit}": _short(float(x)),
            f"breakaway {force}": _short(float(f + early.value)),
            f"weight {force}": _short(float(w)),
        }
        for x, f, w in zip(places, level, weight, strict=True)
    )  # fmt: skip
    result.warnings.append(
        f"Joint {axis.number} carries a weight: of the torques at a place half the difference is"
        " friction, half the sum weight. By how much friction itself differs in both directions"
        " is in the weight; a model (--model) tells them apart."
    )
    if np.abs(weight).max() > mean.value:
        result.warnings.append(
            f"Joint {axis.number} falls without its drive where the weight, up to"
            f" {np.abs(weight).max():.3g} {force}, is more than breaks it away: it was held, and"
            " the torque stepped up and down from what holds it."
        )


def _turning(places: Array, weight: Array, pushes: Pushes) -> list[Estimate]:
    """The weight at some places as a cos q + b sin q. One push is off by the height of its step and
    by noise, also where two places fit any weight.
    """
    A = np.stack([np.cos(places), np.sin(places)], axis=1)
    inverse = np.linalg.pinv(A.T @ A)
    x = inverse @ A.T @ weight
    free = len(places) - 2
    scatter = float(np.sum((weight - A @ x) ** 2)) / max(free, 1)
    half = half_width(np.sqrt(scatter * np.diag(inverse)), free) if free > 0 else np.zeros(2)
    one = np.sqrt(0.5 * np.diag(inverse)) * _shared(pushes)
    std = np.hypot(half / NORMAL, one)
    return [Estimate(float(v), float(s), pushes.axis.force) for v, s in zip(x, std, strict=True)]


def _report_stiffness(result: Result, pushes: Pushes) -> None:
    axis = pushes.axis
    each = [push for way in pushes.by.values() for push in way]
    stiffness, apart, bent = (
        np.array([getattr(push, name) for push in each]) for name in ("stiffness", "apart", "bent")
    )
    if axis.load.weighs:
        result.warnings.append(
            f"Joint {axis.number}: the stiffness of its bristles is not told. It carries a weight,"
            " and they are bent before the push begins."
        )
        return
    counts = float(np.median(bent))
    if counts < COUNTS:
        result.warnings.append(
            f"Joint {axis.number}: the stiffness of its bristles is not told. They bend by"
            f" {counts:.2g} counts of the encoder before it breaks away; {COUNTS:.0f} are needed."
        )
        return
    slack = np.hypot(np.mean(apart), CREEP * np.mean(stiffness))
    result.values[f"stiffness{axis.number}"] = mean_of(
        stiffness.tolist(), f"{axis.force}/{axis.unit}", float(slack)
    )


def _short(value: float) -> float:
    return float(f"{value:.4g}")


def _break_away(pusher: Pusher, joint: int, direction: int, position: float) -> Push:
    known, axis = pusher.known, pusher.known.axes[joint]
    word = f"joint{joint}_{axis.word(direction)}_{position:+.3f}"
    slow = _push(pusher, word, joint, direction, position, axis.slow, HOLD)
    torque, noise = breakaway_torque(slow, known, joint, direction)
    fast = _push(pusher, f"{word}_fast", joint, direction, position, axis.fast, FAST_HOLD)
    pushed = pushed_way(fast, known, joint, direction, FAST_WINDOW)
    bent = float(pushed[0][int(np.argmax(pushed[2] > 0.7 * torque))]) / axis.count
    wide = narrow = 0.0
    if bent >= COUNTS and not axis.load.weighs:
        wide, narrow = (bristle_stiffness(pushed, axis, torque, part) for part in (0.7, 0.3))
    quick, _ = breakaway_torque(fast, known, joint, direction)
    return Push(position, torque, quick, wide, 0.5 * (wide - narrow), bent, noise)


def _push(
    pusher: Pusher, name: str, joint: int, direction: int, position: float, rate: float, hold: float
) -> Recording:
    """A staircase that goes on until the joint breaks away, within what the drive can do, and what
    friction and weight can need.

    A joint that carries a weight is pushed from the torque that holds it, which friction may have
    all but broken away already: then it begins once more, with half of the friction taken off.
    """
    axis = pusher.known.axes[joint]
    most = USED * axis.torque - axis.load.most
    if most <= 0.0:
        raise Unmeasured(
            f"joint {joint} carries up to {axis.load.most:.3g} {axis.force}, and {USED:.0%} of its"
            f" limit of {axis.torque:.3g} {axis.force} is {USED * axis.torque:.3g}: nothing is left"
            " to push it with. Let the machine declare a larger torque_max, or measure it where it"
            " carries less"
        )
    # what holds a joint may lie a friction off its weight, to the other side
    enough = min(axis.enough + (axis.level if axis.load.weighs else 0.0), most)
    word, eased = name, 0.0
    while True:
        steps = Steps(joint, direction, position, rate, hold, enough)
        rec = staircase(pusher, word, steps, eased)
        if (rec["phase"] >= BRAKING).any():
            grown = rate * rec.sample_time * int((rec["phase"] == PUSHING).sum())
            if axis.load.weighs and not eased and grown < EARLY * axis.level:
                eased, word = EASED * axis.level, f"{word}_eased"
                continue
            return rec
        refuse_held_up(rec, axis, direction)
        # where friction held it up, more is left to push it with than beside its whole weight
        most = max(most, USED * axis.torque - direction * began_at(rec, axis))
        if enough >= most:
            return rec
        may = one_way(pusher, f"{word}_back", steps, rec)
        enough, word = min(2.0 * enough, most, may), f"{word}_more"


def _draw(found: Mapping[int, Pushes], bench: Bench) -> str:
    """Draw each push at its place, corrected as the mean is."""
    columns = min(3, len(found))
    figure, axes = make_figure(-(-len(found) // columns), columns, width=max(4.5 * columns, 6.0))
    for panel, (joint, pushes) in zip(axes.flat, found.items(), strict=False):
        axis = pushes.axis
        turning = axis.unit == "rad"
        for direction, colour, word in (
            (1, BLUE, "counterclockwise" if turning else "positive"),
            (-1, RED, "clockwise" if turning else "negative"),
        ):
            positions = [push.place for push in pushes.by[direction]]
            torques = np.array([push.torque for push in pushes.by[direction]]) + pushes.early.value
            panel.plot(positions, torques, "o", color=colour, label=word, markersize=6)
            panel.axhline(float(np.mean(torques)), color=colour, linewidth=0.8, linestyle="--")
        low, high = panel.get_ylim()
        panel.set_ylim(low - 0.25 * (high - low), high + 0.5 * (high - low))
        what = "torque" if turning else "force"
        label(
            panel, f"start position ({axis.unit})", f"breakaway {what} ({axis.force})",
            f"joint {joint}" + ("" if pushes.apart else ", less its weight"), legend=True,
        )  # fmt: skip
    for panel in axes.flat[len(found) :]:
        panel.set_visible(False)
    return save(figure, bench.folder / "static.png")
