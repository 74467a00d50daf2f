"""Makes one case from a seed: machine, concealment, two recordings, the given model, the truth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zendsp.proof.case import Case as Case
from zendsp.proof.case import NoUsableCase as NoUsableCase
from zendsp.proof.case import Request as Request
from zendsp.proof.case import Unusable as Unusable
from zendsp.proof.conceal import KINDS
from zendsp.proof.draft import Array, Concealed, Draft, Scale
from zendsp.proof.effect_kit import inertia_of
from zendsp.proof.files import NAMES, columns_of, format_for
from zendsp.proof.given import model_file
from zendsp.proof.machines import MACHINES
from zendsp.proof.measure import apply_faults, jittered
from zendsp.proof.oracle import Judge
from zendsp.proof.reality import Run, inverse_dynamics, run
from zendsp.proof.references import make_reference
from zendsp.proof.rivals import inseparable
from zendsp.proof.truth import Oracle, Truth
from zendsp.proof.wam import urdf

Rng = np.random.Generator


def make_case(request: Request) -> Case:
    """The case of a request; the same request gives the same case, bit for bit.

    Raises
    ------
    NoUsableCase
        Twelve draws in a row gave no stable, well-behaved loop.
    """
    words = [
        request.seed,
        sum(map(ord, request.kind + request.machine + request.effect)),
        round(1000 * request.size),
    ]
    trouble = ""
    for attempt in range(12):
        try:
            return attempting(request)(request, np.random.default_rng([*words, attempt]))
        except Unusable as error:
            trouble = str(error)
    raise NoUsableCase(f"no usable case for {request} in twelve draws; the last said: {trouble}")


def attempting(request: Request) -> Callable[[Request, Rng], Case]:
    """The maker of one draw, by who simulates it."""
    if request.reality == "mujoco":
        from zendsp.proof.mujoco import make

        return make.attempt_case
    if request.reality == "machines":
        from zendsp.proof import shipped

        return shipped.attempt_case
    return _attempt_case


def _attempt_case(request: Request, rng: Rng) -> Case:
    d = MACHINES[request.machine](rng)
    d.stated_gain = [float(j.get("gain", 1.0)) for j in d.joints]
    d.notes.append(f"kind {request.kind}")
    KINDS[request.kind].prepare(d, request.effect, rng)
    base = record(d, d.train_shape, np.random.default_rng(rng.integers(2**63)), quiet=True)
    KINDS[request.kind].conceal(d, request.effect, request.size, scales_of(d, base), rng)
    train = record(d, d.train_shape, np.random.default_rng(rng.integers(2**63)))
    held = record(d, d.heldout_shape, np.random.default_rng(rng.integers(2**63)), heldout=True)
    check(d, train)
    check(d, held)
    scales = scales_of(d, train)
    form, split = format_for(rng)
    names = dict(NAMES[rng.integers(len(NAMES))])
    if d.open_loop:
        names.pop("reference")
    model = model_file(d, scales, columns_of(names, d.n, split), rng, f"{d.machine}_{request.seed}")
    files = {"arm.urdf": urdf()} if d.kind == "urdf" else {}
    truth = truth_of(d, request, scales)
    untouched = record(d, d.heldout_shape, np.random.default_rng(rng.integers(2**63)), heldout=True)
    check(d, untouched)
    resolution = np.array([float(j["resolution"]) for j in d.joints])
    train, held, untouched = (
        logged(d, r, resolution, np.random.default_rng(rng.integers(2**63)))
        for r in (train, held, untouched)
    )
    return Case(train, held, model, truth, form, d.layout, untouched, files)


def logged(d: Draft, r: Run, resolution: Array, rng: Rng) -> Run:
    """The recording as the draft's logger writes it."""
    if "jitter" in d.faults:
        r = jittered(r, resolution, d.sample_time, rng)
    return apply_faults(r, d.faults, d.sample_time, rng)


def record(d: Draft, shape: str, rng: Rng, *, quiet: bool = False, heldout: bool = False) -> Run:
    """One recording of the draft's machine; `quiet` leaves out what no state explains."""
    rows = round(d.seconds / d.sample_time)
    t = np.arange(rows, dtype=np.float64) * d.sample_time
    reference, feed = np.zeros((rows, d.n)), np.zeros((rows, d.n))
    if d.open_loop:
        feed[:, 0] = open_loop_command(t, d, rng)
    else:
        for i in range(d.n):
            reference[:, i] = d.centre[i] + make_reference(
                shape, t, d.amplitude[i], d.speed[i], rng
            )
        if d.kind == "urdf":
            feed = gravity_torque(d, reference)
        if d.feedforward:
            feed = feedforward(d, reference)
    torque, noise = np.zeros((rows, d.n)), np.zeros((rows, d.n))
    if not quiet:
        for joint, curve in d.disturbance:
            if not heldout:
                torque[:, joint] += np.interp(t / d.seconds, np.linspace(0, 1, curve.size), curve)
        for i in range(d.n):
            push = d.nuisance * wander(t, rng) * float(d.joints[i].get("nuisance_scale", 0.0))
            torque[:, i] += push
            if not heldout:
                d.nuisance_torque[i] = push
            noise[:, i] = d.noise * d.joints[i]["resolution"] * rng.standard_normal(rows)
    try:
        return run(clean(d).truth(), reference, feedforward=feed, torque=torque, noise=noise)
    except RuntimeError as error:
        raise Unusable(str(error)) from error


def clean(d: Draft) -> Draft:
    """The draft without the keys that are not the simulator's."""
    from dataclasses import replace

    return replace(
        d, joints=[{k: v for k, v in j.items() if k != "nuisance_scale"} for j in d.joints]
    )


def open_loop_command(t: Array, d: Draft, rng: Rng) -> Array:
    """In the manner of facts/pendulum.toml: a slow rise and two sines, below what would turn it
    over.
    """
    g = d.parameters.get("gravity", 0.2)
    w = np.array([rng.uniform(0.6, 2.0), rng.uniform(9, 15), rng.uniform(20, 30)])
    size = g * np.array([rng.uniform(0.3, 0.5), rng.uniform(0.1, 0.35), rng.uniform(0.2, 0.6)])
    phase = rng.uniform(0, 2 * np.pi, 3)
    rise = g * rng.uniform(-0.3, 0.3) * (1 - np.exp(-1.8 * t))
    return np.asarray(
        (size * np.sin(np.outer(t, w) + phase)).sum(1) * np.minimum(1.0, t / 0.5) + rise
    )


def gravity_torque(d: Draft, reference: Array) -> Array:
    """Gravity compensation along the reference, as arms have it."""
    still = np.zeros_like(reference)
    return inverse_dynamics(d.mechanism_alone(), reference, still, still)


def feedforward(d: Draft, reference: Array) -> Array:
    """Inverse dynamics of the reference with the true inertial figures, as a good engineer would
    add.
    """
    acc = np.gradient(np.gradient(reference, d.sample_time, axis=0), d.sample_time, axis=0)
    inertia, gravity = d.parameters["inertia"], d.parameters["gravity"]
    return np.asarray((inertia * acc + gravity * np.sin(reference)) / d.stated_gain[0])


def wander(t: Array, rng: Rng) -> Array:
    """Slow random torque of unit RMS: eight sines below 0.8 Hz."""
    f = rng.uniform(0.02, 0.8, 8)
    x = np.sin(2 * np.pi * np.outer(t, f) + rng.uniform(0, 2 * np.pi, 8)).sum(1)
    return np.asarray(x / np.sqrt(np.mean(x**2)))


def scales_of(d: Draft, r: Run) -> list[Scale]:
    """Motion that a perfect sensor would show at the middle of each hold interval, and the stated
    actuator's torque.
    """
    lag = round(d.known_delay / d.sample_time)
    v = 0.5 * (r.v[1:] + r.v[:-1])
    q = 0.5 * (r.q[1:] + r.q[:-1])
    a = np.diff(r.v, axis=0) / d.sample_time
    u = np.concatenate([np.zeros((lag, d.n)), r.command])[: len(r.command) - 1]
    e, angle = (
        np.array([j.get(k, 0.0) for j in d.joints]) for k in ("eccentricity", "eccentricity_phase")
    )
    a = (
        a * (1 + e * np.cos(q + angle)) - e * np.sin(q + angle) * v**2
    )  # in the sensor's coordinates, as data have them
    q, v = q + e * np.sin(q + angle), v * (1 + e * np.cos(q + angle))
    keep = slice(round(0.1 / d.sample_time), None)
    out = []
    for i in range(d.n):
        drive = d.stated_gain[i] * u[keep, i]
        push = d.nuisance_torque.get(i)
        if push is not None and push.size == len(r.q):  # what no state explains is nobody's to find
            drive = drive - (0.5 * (push[1:] + push[:-1]))[keep]
        rms = float(np.sqrt(np.mean(drive**2)))
        slides = (r.v[1:, i] * r.v[:-1, i] > 0)[keep]
        peak = float(np.max(np.abs(drive)))
        out.append(Scale(rms, peak, u[keep, i], drive, q[keep, i], v[keep, i], a[keep, i], slides))
        d.joints[i].setdefault("nuisance_scale", rms)
    return out


def check(d: Draft, r: Run) -> None:
    """Refuse runs that no laboratory would keep."""
    for i in range(d.n):
        limit = d.joints[i]["limit"]
        # a loop that is short of torque winds up
        often = 0.2 if d.joints[i].get("saturation") else 0.01
        if np.mean(np.abs(r.command[:, i]) >= 0.999 * limit) > often:
            raise Unusable("the command sits at its limit")
        if np.max(np.abs(r.v[:, i])) > 4 * d.speed[i] or np.ptp(r.q[:, i]) > 8 * d.amplitude[i]:
            raise Unusable("the motion left its range")
        if np.std(r.v[:, i]) < 0.001 * d.speed[i]:
            raise Unusable("it hardly moves")


def oracle_of(d: Draft, c: Concealed, scales: list[Scale]) -> Oracle:
    """Visibility of what is concealed on one joint, and what this recording cannot tell from it."""
    joint, inertia = c.joint - 1, inertia_of(d, c.joint - 1)
    judge = Judge(d, joint, scales, inertia)
    look = judge.measure(judge.rest(judge.scale.drive))
    alone = sum(other.joint == c.joint for other in d.concealed) == 1
    return {
        "torque_share": round(look.torque_share, 6),
        "innovation_ratio": round(look.innovation_ratio, 6),
        "log_likelihood": round(look.log_likelihood, 2),
        "detectable": look.detectable,
        "inseparable": (
            inseparable(d, joint, scales, judge, c.effect) if alone and look.detectable else {}
        ),
    }


def truth_of(d: Draft, request: Request, scales: list[Scale]) -> Truth:
    """What is sealed."""
    seen = [oracle_of(d, c, scales) for c in d.concealed]
    verdict = (
        "complete"
        if not d.concealed
        else "unexplained" if d.concealed[0].effect == "foreign" else "missing"
    )
    return {
        "kind": request.kind,
        "machine": request.machine,
        "verdict": verdict,
        "size": request.size,
        "effects": [
            {
                "effect": c.effect,
                "joint": c.joint,
                "parameters": {k: {"value": v, "unit": u} for k, (v, u) in c.parameters.items()},
                "size": c.size,
                "accepted": c.accepted,
                "accepted_joints": c.accepted_joints or [c.joint],
                "mechanisms": c.mechanisms,
                "unscored": c.unscored,
                "note": c.note,
                "oracle": look,
            }
            for c, look in zip(d.concealed, seen, strict=True)
        ],
        "also_true": sorted(d.also_true),
        "replaces": d.replaces,
        "where": [place for c in d.concealed for place in c.where],
        "train": d.train_shape,
        "heldout": d.heldout_shape,
        "seconds": d.seconds,
        "layout": d.layout,
        "notes": d.notes,
    }
