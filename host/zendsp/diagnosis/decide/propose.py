"""The next recording: the reference that best separates the open hypotheses.

Candidate motions within the reach of the recordings at hand are simulated in closed loop under the
best hypothesis; the rival is refitted to what was simulated, and the motion that leaves it most in
error is proposed (T-optimality: Hunter and Reiner 1965; Atkinson and Fedorov 1975).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.signals import Signals
from zendsp.diagnosis.decide.across import PLACE
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.contract import Verdict, dark, listed
from zendsp.diagnosis.decide.findings import Finding
from zendsp.diagnosis.decide.result import Next
from zendsp.diagnosis.decide.rivals import sums
from zendsp.diagnosis.measure.likelihood import deviance
from zendsp.diagnosis.search.hypothesis import JointSearch, Rival
from zendsp.physics.calibration.fit import Data, fit, joint_handles
from zendsp.physics.calibration.joint import JointRecord, facts
from zendsp.physics.calibration.loop import ROOM, mean_inertia, simulate_joint_loop
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, per_joint, position_limits

Array = npt.NDArray[np.float64]

SECONDS = 10.0
ROUND_S = 0.1
WEAK = 0.8  # confidence below which a finding is to be confirmed
COUNTS = 8  # of the sensor: least range of a proposed motion
OTHER = "a multisine over the recorded range"  # where no rival is known
FARTHER = " Where the machine may go farther or faster than it did, that tells more."
LINES = (24, 16, 10, 6, 4, 2)  # of the multisine, 0.1 Hz apart
BOTH_SIDES = 1.6  # times the reach to one
SEPARATES = 20.0  # least deviance by which a motion separates two hypotheses


def motions(
    record: JointRecord, limits: tuple[float, float], rng: np.random.Generator, ahead: float = 0.0
) -> dict[str, Array]:
    """Candidate references of 10 s within position limits and the speeds already seen, rad or m.
    ``ahead``: the multisine begins this much later in its period, s.
    """
    period = record.sample_time
    t = np.arange(round(SECONDS / period)) * period
    known = facts(record)  # of all recordings
    half = 0.5 * known.scale.position
    low, high = max(limits[0], known.centre - half), min(limits[1], known.centre + half)
    centre, reach = 0.5 * (low + high), 0.45 * (high - low)
    top = known.fastest
    fade = np.clip(t / 0.5, 0, 1) * np.clip((SECONDS - t) / 0.5, 0, 1)

    def limited(shape: Array, span: float, speed: float) -> Array:
        shape = fade * (shape - 0.5 * (shape.max() + shape.min()))
        shape = shape / max(float(np.max(np.abs(shape))), 1e-12)
        fastest = float(np.max(np.abs(np.gradient(shape, period))))
        moved = min(span, speed / max(fastest, 1e-12)) * shape
        # Corners of triangles, of fades and between parts are steps of the speed, which no machine
        # follows: they are rounded over ROUND_S.
        window = np.hanning(max(3, round(ROUND_S / period) | 1))
        rounded = np.convolve(
            np.pad(moved, len(window) // 2, mode="edge"), window / window.sum(), "valid"
        )
        out: Array = centre + rounded
        return out

    phases = rng.uniform(0, 0.5, LINES[0])

    def lines(count: int) -> Array:
        k = np.arange(1, count + 1)
        phase = phases[:count] - np.pi * k * (k - 1) / count
        wave: Array = (np.cos(2 * np.pi * 0.1 * np.outer(t + ahead, k) + phase) / k).sum(axis=1)
        return wave

    # as many lines as the speed allows over the whole reach
    multisine = next(
        (
            wave
            for wave in map(lines, LINES)
            if np.ptp(limited(wave, reach, 1.2 * top)) > BOTH_SIDES * reach
        ),
        lines(LINES[-1]),
    )
    slow = sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) for f in (0.07, 0.13, 0.23))
    triangle = 2 * np.abs(2 * ((0.2 * t) % 1) - 1) - 1
    chirp = np.sin(2 * np.pi * (0.1 * t + 0.5 * (4.0 - 0.1) / SECONDS * t**2))
    two_speeds = np.where(
        t < SECONDS / 2, np.sin(2 * np.pi * 0.2 * t), np.sin(2 * np.pi * 0.8 * (t - SECONDS / 2))
    )
    return {
        OTHER: limited(multisine, reach, 1.2 * top),
        "a slow multisine with many reversals": limited(np.asarray(slow), 0.6 * reach, 0.25 * top),
        "slow triangles over the recorded range": limited(triangle, reach, 0.3 * top),
        "small slow reversals": limited(np.sin(2 * np.pi * 0.5 * t), 0.05 * reach, 0.05 * top),
        "a chirp from 0.1 to 4 Hz": limited(chirp, 0.5 * reach, 1.2 * top),
        "slow and fast sines over the recorded range": limited(two_speeds, reach, 1.2 * top),
    }


def propose(
    train: Sequence[Signals],
    given: Model,
    searches: Sequence[JointSearch],
    findings: Sequence[Finding],
    decisions: Sequence[Decision],
    seed: int,
    undriven: Collection[int] = (),
) -> Next | None:
    """The next recording, where something is still open; None otherwise.

    Parameters
    ----------
    seed : int
        Seed of the random phases.
    undriven : collection of int
        Joints that nothing drives: they follow no reference.
    """
    finals = {d.joint: d.final.model for d in decisions}
    findings = [_separable(f, finals[f.joint]) for f in findings]
    open_ones = [f for f in findings if f.indistinguishable]
    if not open_ones:
        other = _without_rival(train, given, searches, findings, decisions, seed, undriven)
        return other or _one_torque(findings, finals)
    finding = open_ones[0]
    search = searches[finding.joint - 1]
    rival = _rival(search, finding)
    experiment = "the same motion again: what it follows from repeats, a push does not."
    if finding.effect not in ("disturbance", "unknown"):
        experiment = get_effect(finding.effect).experiment
    names = ", ".join(finding.indistinguishable)
    if finding.effect != "disturbance" and finding.joint in undriven:
        return Next(
            f"To tell {finding.effect} from {names} at joint {finding.joint}, which nothing drives,"
            f" {_again(given, undriven)}.",
            free=finding.joint,
        )
    if rival is None:
        return Next(
            f"To tell {finding.effect} from {names} at joint {finding.joint}: {experiment}",
        )
    best = _best_motion(train[0], given, search, rival, finding.joint, seed)
    if best is None:
        return Next(
            f"No motion within the reach of these recordings separates {finding.effect} from"
            f" {names}: there they are the same torque.",
            tells=False,
        )
    name, motion, gain = best
    return _played(
        train[0], given, {finding.joint: motion},
        f"To tell {finding.effect} from {names} at joint {finding.joint}, record {name} ({{}}): if"
        f" {finding.effect} is true, {rival.effect} will be {gain / 2:.0f} units of log-likelihood"
        " less likely.",
    )  # fmt: skip


def _separable(finding: Finding, final: Model) -> Finding:
    """The finding without the rivals that are the same torque by algebra: no motion, and no other
    experiment, tells these from it.
    """
    same = sums(finding.effect, finding.joint, final)
    left = tuple(name for name in finding.indistinguishable if name not in same)
    return replace(finding, indistinguishable=left)


def _one_torque(findings: Sequence[Finding], finals: Mapping[int, Model]) -> Next | None:
    """Why nothing is to be recorded for laws that are the same torque by algebra."""
    for f in findings:
        for name in sums(f.effect, f.joint, finals[f.joint]):
            return Next(
                f"No recording tells {' and '.join(get_effect(name).sums)} at joint"
                f" {f.joint} from {name}. Together they are the same torque.",
                tells=False,
            )
    return None


def _played(signals: Signals, given: Model, motions: Mapping[int, Array], text: str) -> Next:
    """The proposal of a motion of some joints while the others stand. It has a reference that a
    program can play, unless the recording had no command.
    """
    q = np.tile(signals.position.mean(axis=0), (len(next(iter(motions.values()))), 1))
    spans = []
    for joint, motion in motions.items():
        q[:, joint - 1] = motion
        unit = "m" if given.joint_kind(joint) == "linear" else "rad"
        spans.append(f"{motion.min():.3g} … {motion.max():.3g} {unit}")
    span = f"{SECONDS:.0f} s, {', '.join(spans)}"
    reference = (q, signals.sample_time) if np.any(signals.command) else None
    return Next(text.format(span), reference)


def _again(given: Model, undriven: Collection[int]) -> str:
    """What to do with a joint that nothing drives."""
    beside = len(undriven) < given.joints
    others = ", and with other motions of what is driven beside it" if beside else ""
    return f"record it again from other first positions and speeds{others}"


def _without_rival(
    train: Sequence[Signals],
    given: Model,
    searches: Sequence[JointSearch],
    findings: Sequence[Finding],
    decisions: Sequence[Decision],
    seed: int,
    undriven: Collection[int] = (),
) -> Next | None:
    strap = next((d.strap for d in decisions if d.strap), ())
    if strap:
        return Next(
            f"Take off what is stretched between the links at {listed(strap)} (a hose, cables, a"
            " strap) and record the same motion again: the torque goes with it."
        )
    again = [d.joint for d in decisions if d.kind == Verdict.UNEXPLAINED]
    unseen = dark(
        (d.joint, (d.after.low, d.after.high)) for d in decisions if d.kind == Verdict.COMPLETE
    )
    lawless = [f for f in findings if f.effect == "unknown"]
    joints = [f.joint for f in lawless] if findings else [*again, *unseen]
    driven = [j for j in joints if j not in undriven]
    if joints and not driven:
        return Next(
            f"Nothing drives {listed(joints[:1])}: {_again(given, undriven)}. What repeats"
            " with the state is physics.",
            free=joints[0],
        )
    if joints := driven:
        # what pulls at several joints may depend on where each of them is
        pulled = {f.joint for f in lawless if f.mechanism == PLACE} & set(joints)
        moved = sorted(pulled) if joints[0] in pulled else joints[:1]
        motion = {
            j: motions(
                searches[j - 1].final.data.records[0][j - 1],
                position_limits(given, j),
                np.random.default_rng(seed),
                0.5 * SECONDS * k / len(moved),
            )[OTHER]
            for k, j in enumerate(moved)
        }
        at_once = " at the same time" if len(moved) > 1 else ""
        why = (
            f"again through the same states in another order and at other speeds{at_once}, as"
            f" {OTHER} does ({{}}): what repeats with the state is physics."
            if lawless or again
            else f"for longer, there and back, as {OTHER} does ({{}}): all of its torque could be"
            " unexplained, and these recordings would not show it."
        )
        what = "Of the torque without a law, record" if lawless else "Record"
        return _played(train[0], given, motion, f"{what} {listed(moved)} {why}{FARTHER}")
    weak = [
        f for f in findings if f.confidence < WEAK and f.effect not in ("disturbance", "unknown")
    ]
    if weak and weak[0].joint in undriven:
        return Next(
            f"To confirm {weak[0].effect} at joint {weak[0].joint}, which nothing drives,"
            f" {_again(given, undriven)}.",
            free=weak[0].joint,
        )
    if weak:
        return Next(
            f"To confirm {weak[0].effect} at joint {weak[0].joint}:"
            f" {get_effect(weak[0].effect).experiment}",
        )
    return None


def _rival(search: JointSearch, finding: Finding) -> Rival | None:
    for step in search.steps:
        for rival in step.rivals:
            if rival.effect in finding.indistinguishable and step.chosen.effect == finding.effect:
                return rival
    return None


def _best_motion(
    signals: Signals, given: Model, search: JointSearch, rival: Rival, joint: int, seed: int
) -> tuple[str, Array, float] | None:
    record = search.final.data.records[0][joint - 1]
    inertia = mean_inertia(record, search.final.model)
    gain = abs(per_joint(given.actuator.gain, joint, 1.0)) or 1.0
    speed = 2 * np.pi * 4.0
    best: tuple[str, Array, float] | None = None
    truth = next(step.chosen.scored.model for step in search.steps if rival in step.rivals)
    for name, motion in motions(
        record, position_limits(given, joint), np.random.default_rng(seed)
    ).items():
        resolution = record.measurement.resolution
        loop = simulate_joint_loop(
            truth,
            joint,
            motion,
            record.sample_time,
            kp=inertia * speed**2 / gain,
            kd=1.4 * inertia * speed / gain,
            inertia=inertia,
            resolution=resolution,
            temperature=(
                float(record.columns["temperature"][-1])
                if "temperature" in record.columns
                else ROOM
            ),
        )
        if not np.isfinite(loop.position).all() or np.ptp(loop.position) <= COUNTS * resolution:
            continue
        value = _separation(signals, given, truth, rival, joint, loop.position, loop.command)
        if best is None or value > best[2]:
            best = (name, motion, value)
    return best if best is not None and best[2] > SEPARATES else None


def _separation(
    signals: Signals,
    given: Model,
    truth: Model,
    rival: Rival,
    joint: int,
    position: Array,
    command: Array,
) -> float:
    """The deviance by which a refitted rival makes a recording less likely that the best hypothesis
    simulated.
    """
    n = len(position)
    still = np.tile(signals.position.mean(axis=0), (n, 1))
    still[:, joint - 1] = position
    effort = np.zeros((n, still.shape[1]))
    effort[:, joint - 1] = command
    made = replace(
        signals,
        time=np.arange(n, dtype=np.float64) * signals.sample_time,
        position=still,
        command=effort,
        reference=None,
        extra={role: np.tile(values[-1:], (n, 1)) for role, values in signals.extra.items()},
        notes=(),
    )
    data: Data = prepare([made], given, 8.0)

    def unlikely(
        model: Model,
    ) -> float:  # both refitted: a difference of fit length does not count
        handles = joint_handles(data, model, joint)
        return deviance(
            data,
            fit(data, model, handles, joints=(joint,), iterations=10, tolerance=1e-4).model,
            (joint,),
        )

    return unlikely(rival.scored.model) - unlikely(truth)


def experiment_of(findings: Sequence[Finding]) -> Next | None:
    """The recording that would separate the first finding with rivals from them; None where no
    finding has any.
    """
    open_ones = [f for f in findings if f.indistinguishable]
    if not open_ones:
        return None
    f = open_ones[0]
    return Next(
        f"To separate {f.effect} from {', '.join(f.indistinguishable)} on joint {f.joint}:"
        f" {get_effect(f.effect).experiment}",
    )
