"""Makes one case of a MuJoCo reality from a seed, in the form of the own generator's cases."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zendsp.proof.case import Case, Request, Unusable
from zendsp.proof.draft import Array, Concealed, Scale
from zendsp.proof.files import NAMES, columns_of
from zendsp.proof.forms import FORMS, foreign
from zendsp.proof.measure import DRESSINGS, apply_faults, format_of
from zendsp.proof.model_table import (
    Columns,
    EffectTable,
    Mechanism,
    ModelTable,
    Parameter,
    one_or_each,
    parameter,
)
from zendsp.proof.mujoco.chain import Joint, World, mjcf, urdf
from zendsp.proof.mujoco.foreign import PARTS, TOGETHER, add_form
from zendsp.proof.mujoco.friction import mujoco_dry
from zendsp.proof.mujoco.machines import MACHINES, Bench, harden
from zendsp.proof.mujoco.mechanics import TWO_SIDED
from zendsp.proof.mujoco.simulate import Nominal, Record, Unstable, nominal_gravity, simulate
from zendsp.proof.mujoco.truths import MAKERS
from zendsp.proof.oracle import DETECTABLE, PROCESS, steady_observer
from zendsp.proof.truth import Effect, Number, Oracle, Truth

Rng = np.random.Generator
Near = Callable[[float, float], float]  # a value, off by a share of itself
FAULTS = ("plain", "jitter", "repeat", "stale", "float32", "filtered", "slow", "origin", "unit")


def attempt_case(request: Request, rng: Rng) -> Case:
    """One draw of a request's case.

    Raises
    ------
    Unusable
        The motion of this draw is none that a laboratory would keep.
    """
    b = MACHINES[request.machine](rng)
    dress(b, request, rng)
    try:
        base = simulate(b, b.train_shape, _fork(rng))
        scales = scales_of(b, base)
        conceal(b, request, scales, rng)
        size = [s.torque for s in scales]
        records = []
        for shape in (
            b.train_shape, b.heldout_shape, b.heldout_shape,
        ):  # the last is never diagnosed
            records.append(simulate(b, shape, _fork(rng), size))
            check(b, records[-1], base)
    except Unstable as error:
        raise Unusable(str(error)) from error
    names = dict(NAMES[rng.integers(len(NAMES))])
    form, divided = format_of(rng)
    model = given(b, columns_of(names, b.n, divided), rng, f"{b.machine}_{request.seed}")
    truth = truth_of(b, request, records[0])
    runs = [apply_faults(record.run, b.faults, b.sample_time, _fork(rng)) for record in records]
    files = {"arm.urdf": urdf(b.nominal, b.limit, b.machine)} if b.kind == "urdf" else {}
    if files and request.given == "mjcf":
        model, files = as_mjcf(b, model)
    return Case(runs[0], runs[1], model, truth, form, "heldout", runs[2], files)


def _fork(rng: Rng) -> Rng:
    return np.random.default_rng(rng.integers(2**63))


def dress(b: Bench, request: Request, rng: Rng) -> None:
    """How it is measured: a fault that the request names, or now and then a harmless one."""
    if request.kind not in ("single", "pair", "all"):
        harden(b)
    if request.kind == "complete":
        fault = request.effect or "plain"
        if fault == "slow":
            b.train_shape = b.heldout_shape = "slow"
        elif fault != "plain":
            b.faults.append(fault)
        if fault == "filtered":
            b.also_true.add("position_filter")
    elif rng.random() < 0.3:
        b.faults.append(str(rng.choice(DRESSINGS)))
    if request.kind == "nuisance":
        b.nuisance = float(np.exp(rng.uniform(np.log(0.005), np.log(0.02))))
        b.also_true.add("unexplained")


def conceal(b: Bench, request: Request, scales: list[Scale], rng: Rng) -> None:
    """Hide what the request says."""
    joint = int(rng.integers(b.n))
    names = request.effect.split("+")
    if request.kind == "foreign":
        b.concealed.append(foreign_of(b, names[0], joint, scales, request.size, rng))
    elif request.kind == "all":
        soft = names[0] == "dry_soft"
        for k in range(b.n):
            b.concealed.append(mujoco_dry(soft)(b, k, scales[k], request.size, rng))
        for name in names[1:]:
            joint = joint % min(3, b.n) if name in TWO_SIDED else joint
            b.concealed.append(MAKERS[name](b, joint, scales[joint], request.size, rng))
    elif request.kind in ("single", "pair"):
        for name in names:
            if name in TWO_SIDED:  # behind the gear of a wrist joint hangs next to nothing
                joint = joint % min(3, b.n)
            b.concealed.append(MAKERS[name](b, joint, scales[joint], request.size, rng))
            joint = int(rng.integers(b.n))


def foreign_of(
    b: Bench, name: str, joint: int, scales: list[Scale], size: float, rng: Rng
) -> Concealed:
    """A foreign torque of `size` of the joint's RMS torque."""
    if name in FORMS:
        return add_form(b, name, joint, scales[joint], size, rng)
    if name in TOGETHER:
        return TOGETHER[name](b, joint, scales[joint], size, rng)
    words, mechanisms, build = PARTS[name]
    scaled = build(b, joint, scales[joint], rng)
    factor, seed = 1.0, int(rng.integers(2**63))
    best, near, seen = factor, np.inf, 0.0
    for _ in range(5):  # its size follows from its stiffness only through the motion
        scaled(factor)
        record = simulate(b, b.train_shape, np.random.default_rng(seed))
        look = max(visible(b, record, k)["torque_share"] for k in range(b.n))
        off = float(np.log(size / max(look, 1e-6)))
        if abs(off) < near:
            best, near, seen = factor, abs(off), look
        if near < 0.2:
            break
        factor *= float(np.exp(np.clip(off, -3.0, 3.0)))
    if near > 1.0:
        raise Unusable(f"{name} cannot be made {size:.0%} of the torque")
    scaled(best)
    out = foreign(joint, seen, words, mechanisms)
    out.accepted_joints = list(range(1, b.n + 1))
    return out


def _middle(x: Array) -> Array:
    return np.asarray(0.5 * (x[1:] + x[:-1]))


def scales_of(b: Bench, record: Record) -> list[Scale]:
    """Sizes of the motion at the middle of each sample, and the stated actuator's torque less the
    nuisance.
    """
    r = record.run
    q, v = _middle(r.q), _middle(r.v)
    a = np.diff(r.v, axis=0) / np.diff(r.time)[:, None]
    for i, order, size, phase in b.sensor:  # in the sensor's coordinates, as data have them
        angle, e = order * q[:, i] + phase, size * order
        slope = 1 + e * np.cos(angle)
        a[:, i] = a[:, i] * slope - e * order * np.sin(angle) * v[:, i] ** 2
        q[:, i], v[:, i] = q[:, i] + size * np.sin(angle), v[:, i] * slope
    out = []
    for i in range(b.n):
        u = r.command[:-1, i]
        drive = b.stated_gain[i] * u + record.nuisance[:-1, i]
        turns = r.v[1:, i] * r.v[:-1, i] <= 0
        turns |= np.abs(v[:, i]) < 1e-2 * np.std(v[:, i])
        slides = ~np.convolve(
            turns, [True, True, True], "same"
        )  # friction acts within a sample beside a turn
        rms = float(np.sqrt(np.mean(drive**2)))
        peak = float(np.max(np.abs(drive)))
        out.append(Scale(rms, peak, u, drive, q[:, i], v[:, i], a[:, i], slides))
    return out


def check(b: Bench, record: Record, base: Record) -> None:
    """Refuse motions that no laboratory would keep, and those that what is concealed has blown up.
    """
    r = record.run
    for i in range(b.n):
        if np.mean(np.abs(r.command[:, i]) >= 0.999 * b.limit[i]) > 0.02:
            raise Unusable("the command sits at its limit")
        if np.max(np.abs(r.v[:, i])) > 5 * b.speed[i] or np.ptp(r.q[:, i]) > 8 * b.amplitude[i]:
            raise Unusable("the motion left its range")
        if np.std(r.v[:, i]) < 1e-3 * b.speed[i]:
            raise Unusable("it hardly moves")
        rough = np.std(np.diff(r.command[:, i])) / np.std(r.command[:, i])
        before = np.std(np.diff(base.run.command[:, i])) / np.std(base.run.command[:, i])
        louder = np.std(r.command[:, i]) / np.std(base.run.command[:, i])
        if rough > 1.5 * before + 0.1 or louder > 3:
            raise Unusable("the loop is nearly unstable")


def visible(b: Bench, record: Record, joint: int) -> Oracle:
    """What a refit of the given model leaves of the torque along the true motion, and how plainly
    it shows.
    """
    scales = scales_of(b, record)
    s = scales[joint]
    nominal = Nominal(b)
    q, v, a = (np.stack([getattr(x, name) for x in scales], 1) for name in "qva")
    rest = s.drive - nominal.along(q, v, a)[:, joint]
    columns = [s.a] if not b.fixed else []
    if b.kind == "rotary" and b.gravity and not b.fixed:
        columns.append(np.sin(s.q))
    if "viscous" not in b.hidden[joint]:
        columns.append(s.v)
    if "coulomb" not in b.hidden[joint] and b.nominal_dry[joint] > 0:
        columns.append(np.sign(s.v))
    keep = s.slides
    rest = np.where(keep, rest, 0.0)
    if columns:
        free = np.stack(columns, 1) / [np.sqrt(np.mean(c**2)) + 1e-300 for c in columns]
        rest = rest - np.where(
            keep, free @ np.linalg.lstsq(free[keep], rest[keep], rcond=None)[0], 0.0
        )
    from scipy.signal import lfilter

    inertia = float(nominal.inertia(np.array(b.centre))[joint])
    noise = b.resolution[joint] ** 2 * (1 / 12 + b.noise**2)
    sigma = s.torque * float(np.hypot(PROCESS, b.nuisance))
    top, bottom, variance = steady_observer(b.sample_time, inertia, noise, sigma)
    ratio = 1.0 + float(np.mean(lfilter(top, bottom, rest) ** 2)) / variance
    likelihood = 0.5 * rest.size * float(np.log(ratio))
    return {
        "torque_share": round(float(np.sqrt(np.mean(rest**2))) / s.torque, 6),
        "innovation_ratio": round(ratio, 6),
        "log_likelihood": round(likelihood, 2),
        "detectable": likelihood >= DETECTABLE,
        "inseparable": {},
    }


def look_of(b: Bench, record: Record, c: Concealed) -> Oracle:
    """The plainest joint of those where it may be named; what hides in the columns always shows."""
    looks = [visible(b, record, k - 1) for k in c.accepted_joints or [c.joint]]
    best = max(looks, key=lambda x: x["log_likelihood"])
    if c.effect in ("column_shift", "position_filter"):
        return {**best, "detectable": True}
    return best


def truth_of(b: Bench, request: Request, train: Record) -> Truth:
    """What is sealed."""
    thousand = 1000.0 if "unit" in b.faults else 1.0
    entries: list[Effect] = []
    for c in b.concealed:
        values: dict[str, Number] = {
            k: {"value": v * (thousand if u == "command" else 1.0), "unit": u}
            for k, (v, u) in c.parameters.items()
        }
        entries.append(
            {
                "effect": c.effect, "joint": c.joint, "parameters": values, "size": c.size,
                "accepted": c.accepted, "accepted_joints": c.accepted_joints or [c.joint],
                "mechanisms": c.mechanisms, "body": c.body, "unscored": c.unscored, "note": c.note,
                "oracle": look_of(b, train, c),
            }
        )  # fmt: skip
    strange = any(c.effect == "foreign" for c in b.concealed)
    return {
        "kind": request.kind, "machine": request.machine, "flavour": request.effect,
        "verdict": "complete" if not b.concealed else "unexplained" if strange else "missing",
        "size": request.size, "effects": entries, "also_true": sorted(b.also_true), "replaces": [],
        "where": [place for c in b.concealed for place in c.where], "train": b.train_shape,
        "heldout": b.heldout_shape, "seconds": b.seconds, "layout": "heldout",
        "notes": [*b.notes, f"{b.integrator}, {b.controller}", *b.faults],
    }  # fmt: skip


def given(b: Bench, columns: Columns, rng: Rng, name: str) -> ModelTable:
    """The model file: inertial figures off by 3 %, known friction by 5 %; exact where they are
    fixed.
    """

    def near(value: float, spread: float) -> float:
        return value * (1 + (0.0 if b.fixed else spread * float(rng.standard_normal())))

    thousand = 1000.0 if "unit" in b.faults else 1.0
    mechanism: Mechanism = {"kind": b.kind}
    if b.kind == "urdf":
        mechanism["file"] = "arm.urdf"
    else:
        mechanism["parameters"] = given_figures(b, near)
    effects = known_effects(b, near)
    table: ModelTable = {
        "name": name,
        "sample_time": b.sample_time,
        "mechanism": mechanism,
        "effect": effects,
        "actuator": {
            "gain": parameter(one_or_each([g / thousand for g in b.stated_gain]), fixed=True),
            "limit": one_or_each([x * thousand for x in b.limit]),
            "hold": b.sample_time,
        },
        "sensor": {"position_resolution": one_or_each(b.resolution)},
        "columns": columns,
    }
    if not effects:
        del table["effect"]
    return table


def given_figures(b: Bench, near: Near) -> dict[str, Parameter]:
    """``[mechanism.parameters]``: off by 3 %, or exact where they are fixed."""
    figures = {k: parameter(near(v, 0.03), b.fixed) for k, v in inertial_figures(b).items()}
    if b.kind == "rotary" and b.gravity == 0.0:
        figures["gravity"] = parameter(0.0, fixed=True)
    if b.kind == "planar2r":
        figures["l1"] = parameter(b.nominal[1].place[0], fixed=True)
        figures["l2"] = parameter(2 * b.nominal[1].com[0], fixed=True)
    return figures


def known_effects(b: Bench, near: Near) -> list[EffectTable]:
    """Friction off by 5 % but for what is hidden, and the other effects that the model has."""
    out: list[EffectTable] = []
    for i in range(b.n):
        if "viscous" not in b.hidden[i]:
            value = parameter(near(b.nominal_damping[i], 0.05))
            out.append({"kind": "viscous", "joint": i + 1, "coefficient": value})
        if "coulomb" not in b.hidden[i] and b.nominal_dry[i] > 0:
            value = parameter(near(b.nominal_dry[i], 0.05))
            out.append({"kind": "coulomb", "joint": i + 1, "level": value})
    for term in b.known:
        values = {k: parameter(near(v, 0.02), b.fixed) for k, v in term.values.items()}
        out.append({"kind": term.kind, "joint": term.joint, **values})
    return out


def as_mjcf(b: Bench, table: ModelTable) -> tuple[ModelTable, dict[str, str]]:
    """The same given model with an MJCF, which states what the table and the URDF stated before."""
    joints = [Joint() for _ in range(b.n)]
    words = {"viscous": "damping", "coulomb": "dry", "inertia": "armature"}
    for entry in table.get("effect", []):
        value = next(v["value"] for v in entry.values() if isinstance(v, dict))
        setattr(joints[entry["joint"] - 1], words[entry["kind"]], value)
    actuator = table["actuator"]
    gains, limits = (np.atleast_1d(x) for x in (actuator["gain"]["value"], actuator["limit"]))
    for joint, gain, limit in zip(joints, gains.tolist(), limits.tolist(), strict=True):
        joint.gain, joint.force_limit = gain, gain * limit
    rest: ModelTable = {
        **table,
        "mechanism": {"kind": "mjcf", "file": "arm.xml"},
        "actuator": {"hold": actuator["hold"]},
    }
    rest.pop("effect", None)
    world = World(gravity=nominal_gravity(b))
    return rest, {"arm.xml": mjcf(b.nominal, joints, world, b.substep, b.integrator)}


def inertial_figures(b: Bench) -> dict[str, float]:
    """True figures of the mechanism that the given model has, by hand from the bodies."""
    if b.kind == "linear":
        return {"mass": b.nominal[0].mass + b.nominal_armature[0]}
    if b.kind == "rotary":
        link = b.nominal[0]
        inertia = link.inertia[1] + link.mass * link.com[2] ** 2 + b.nominal_armature[0]
        return {"inertia": inertia, **({"gravity": b.gravity} if b.gravity else {})}
    one, two = b.nominal
    reach, c1, c2 = two.place[0], one.com[0], two.com[0]
    p2 = two.inertia[2] + two.mass * c2**2
    p1 = one.inertia[2] + one.mass * c1**2 + two.mass * reach**2 + p2
    return {"p1": p1, "p2": p2, "p3": two.mass * reach * c2}
