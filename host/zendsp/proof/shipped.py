"""Cases on the machines that ship with zendsp as C: their own integrator, friction, drives and
encoders.

A machine is opened through ``machine.h`` and stepped sample by sample, with friction set to plain,
so that what it conceals is all that the given model lacks.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import cffi
import numpy as np

from zendsp.proof.case import Case, Request, Unusable
from zendsp.proof.draft import Array, Scale
from zendsp.proof.files import NAMES, columns_of
from zendsp.proof.measure import apply_faults, format_of, jittered
from zendsp.proof.reality import Run
from zendsp.proof.references import make_reference
from zendsp_isr.build import source_root
from zendsp_isr.parts import build_machine

Rng = np.random.Generator
# first members of every simulated machine (plant.h): the truth that only the proof reads
TRUTH = "typedef struct { int joints; double substep, t, q[8], qd[8], z[8]; } truth;"
TORQUE = 1  # mode of the drives
PERIOD = 1e-3  # s


@dataclass
class Rig:
    """A machine as its model describes it, its controller, and what is concealed."""

    name: str  # of the machine's C file
    kind: str  # of [mechanism]
    figures: dict[str, float]
    lengths: dict[str, float]
    viscous: tuple[float, ...]  # N m s/rad, of the machine's plain friction
    coulomb: tuple[float, ...]  # N m
    limit: tuple[float, ...]  # N m
    counts: float  # a turn
    kp: tuple[float, ...]
    kd: tuple[float, ...]
    cutoff: float  # Hz, of the controller's speed
    amplitude: tuple[float, ...]  # rad
    speed: tuple[float, ...]  # rad/s
    also_true: tuple[str, ...] = ()
    loop: float = 0.0  # s, current loop of the drives: the given model knows of it as delay
    ideal: bool = False  # without noise, steps and current loop of the drives
    seconds: float = 20.0
    lines: list[str] = field(default_factory=list)  # of what is concealed, in the machine's words
    hidden: set[tuple[str, int]] = field(default_factory=set)  # friction that the given model lacks
    fixed: bool = False
    faults: list[str] = field(default_factory=list)
    truths: list[dict[str, Any]] = field(default_factory=list)

    @property
    def n(self) -> int:
        return len(self.kp)

    @property
    def resolution(self) -> float:
        return 2 * np.pi / self.counts

    def inertia(self, joint: int) -> float:
        """What a motor feels of its joint, kg m²."""
        # the first figure of each model is its first joint's
        return list(self.figures.values())[joint]


def planar() -> Rig:
    """Two links in a plane."""
    return Rig(
        "imi_planar", "planar2r", {"p1": 3.473, "p2": 0.196, "p3": 0.242}, {"l1": 0.36, "l2": 0.34},
        (5.3, 1.1), (8.45, 2.35), (245.0, 39.2), 153600.0, (2000.0, 300.0), (120.0, 12.0), 80.0,
        (0.9, 0.9), (1.8, 2.4), loop=1.6e-4,
    )  # fmt: skip


def pendulum() -> Rig:
    """A bar on a motor whose current loop takes two samples, which its model does not have."""
    return Rig(
        "pendulum",
        "rotary",
        {"inertia": 2.07e-3, "gravity": 0.16677},
        {},
        (0.005,),
        (0.1,),
        (0.8,),
        4096.0,
        (1.2,),
        (0.02,),
        30.0,
        (2.0,),
        (7.0,),
        ("lag", "delay"),
    )


RIGS: dict[str, Callable[[], Rig]] = {"c_planar": planar, "c_pendulum": pendulum}
Values = dict[str, float]
Law = Callable[[Rig, int, Scale, float, Rng], Values]


def share_of_speed(power: int) -> Law:
    return lambda r, j, s, x, rng: {
        "coefficient": x * s.torque / float(np.sqrt(np.mean(s.v ** (2 * power))))
    }


def middle(s: Scale) -> float:
    return float(np.mean(s.q))


def elastic(r: Rig, j: int, s: Scale, x: float, rng: Rng) -> Values:
    load = 0.4 * r.inertia(j)
    stiffness = load * (2 * np.pi * rng.uniform(4.0, 8.0)) ** 2
    return {
        "stiffness": stiffness,
        "damping": 0.06 * float(np.sqrt(stiffness * load)),
        "load_inertia": load,
    }


def gap(r: Rig, j: int, s: Scale, x: float, rng: Rng) -> Values:
    load = 0.4 * r.inertia(j)
    return {
        "gap": 0.1 * x * s.reach,
        "stiffness": load * (2 * np.pi * 25.0) ** 2,
        "load_inertia": load,
    }


# parameters in the machine's order, by effect; sizes are shares of the RMS torque
LAWS: dict[str, Law] = {
    "quadratic_drag": share_of_speed(2),
    "load_friction": lambda r, j, s, x, rng: {"coefficient": x},
    "position_friction": lambda r, j, s, x, rng: {
        "amplitude": 1.4 * x * s.torque,
        "period": s.reach * rng.uniform(0.3, 0.7),
        "phase": rng.uniform(-3, 3),
    },
    "stribeck": lambda r, j, s, x, rng: {
        "breakaway": r.coulomb[j] + 2 * x * s.torque,
        "velocity": rng.uniform(0.1, 0.3) * s.v_rms,
    },
    "friction_drift": lambda r, j, s, x, rng: {
        "ratio": rng.uniform(0.5, 1.0),
        "time_constant": rng.uniform(3.0, 8.0),
    },
    "stiffness": lambda r, j, s, x, rng: {
        "coefficient": x * s.torque / float(np.std(s.q)),
        "neutral": middle(s) + rng.uniform(-0.3, 0.3) * s.reach,
    },
    "cubic_stiffness": lambda r, j, s, x, rng: {
        "coefficient": x * s.torque / float(np.sqrt(np.mean((s.q - middle(s)) ** 6))),
        "neutral": middle(s),
    },
    "hysteresis": lambda r, j, s, x, rng: {
        "force": 1.4 * x * s.torque,
        "stiffness": 1.4 * x * s.torque / (rng.uniform(0.05, 0.12) * s.reach),
        "exponent": 1.0,
    },
    "ripple": lambda r, j, s, x, rng: {
        "order": float(rng.integers(5, 25)),
        "amplitude": 1.4 * x * s.torque,
        "phase": rng.uniform(-3, 3),
    },
    "inertia": lambda r, j, s, x, rng: {"amount": x * s.torque / float(np.std(s.a))},
    "torque_gain": lambda r, j, s, x, rng: {"ratio": -0.07},
    "torque_offset": lambda r, j, s, x, rng: {
        "level": x * s.torque * float(rng.choice([-1.0, 1.0]))
    },
    "dead_zone": lambda r, j, s, x, rng: {"width": x * s.torque},
    "saturation": lambda r, j, s, x, rng: {
        "level": float(np.quantile(np.abs(s.command), 1 - 0.2 * x))
    },
    "lag": lambda r, j, s, x, rng: {"time_constant": rng.uniform(0.005, 0.012)},
    "delay": lambda r, j, s, x, rng: {"time": float(rng.integers(3, 8)) * PERIOD},
    "elasticity": elastic,
    "backlash": gap,
    "disturbance": lambda r, j, s, x, rng: {
        "level": 2 * x * s.torque,
        "begin": rng.uniform(5.0, 10.0),
        "duration": rng.uniform(1.5, 3.0),
    },
}
# a friction term of the machine that the given model is not told of
LEFT_OUT = ("viscous", "coulomb")
EFFECTS = (*LEFT_OUT, *LAWS)
# the pendulum's 24 V give 0.76 N m at rest and less at speed; its given model says 0.8
ALSO_TRUE = {"c_pendulum": ("saturation", "voltage_limit")}
FOREIGN = ("strap", "parametric", "breathing")  # the machine's laws 0, 1, 2
FOREIGN_MECHANISMS = (
    ["dry_friction", "fluid_friction"], ["position_torque", "fluid_friction"],
    ["dry_friction", "disturbance"],
)
ACCEPTED = {
    "torque_offset": ["coulomb_asymmetry"],
    "elasticity": ["stiffening"],
    "saturation": ["voltage_limit"],
    "hysteresis": ["presliding"],
}
FAULTS = ("plain", "jitter", "repeat", "stale", "float32", "filtered", "origin")
FIXING = ("inertia", "torque_gain")  # refitted inertial figures would absorb them


def foreign_shape(law: int, s: Scale) -> Array:
    """The machine's foreign law with amplitude 1 along a motion that begins at t = 0."""
    t = np.arange(s.q.size) * PERIOD
    if law == 0:
        return np.where(s.q > 0, s.v * np.cos(7 * s.q), 0.0)
    if law == 1:
        return np.asarray(np.tanh(3 * s.v**2 * s.q) * np.cos(3 * s.q))
    return np.asarray(np.tanh(s.v / 0.05) * np.sin(2 * s.q) * np.sin(1.7 * t))


def left_by_refit(torque: Array, s: Scale) -> float:
    """What a refit of inertia, friction and gravity leaves of a torque along the motion, as a share
    of the RMS torque.
    """
    columns = np.stack([s.a, s.v, np.sign(s.v), np.sin(s.q)], 1)
    rest = torque - columns @ np.linalg.lstsq(columns, torque, rcond=None)[0]
    return float(np.sqrt(np.mean(rest**2))) / s.torque


class Machine:
    """One open machine; its outputs are written, then its encoders read, then time passes."""

    def __init__(self, name: str, config: str) -> None:
        self.ffi = cffi.FFI()
        text = (source_root() / "include" / "machine.h").read_text(encoding="utf-8")
        words = re.sub(r"^#.*$", "", text, flags=re.MULTILINE)
        self.ffi.cdef(words + "extern machine_ops zendsp_machine;" + TRUTH)
        self.ops: Any = self.ffi.dlopen(str(build_machine(name))).zendsp_machine
        self.info = self.ffi.new("machine_info *")
        handle, error = self.ffi.new("void **"), self.ffi.new("char[256]")
        if self.ops.open(handle, config.encode(), PERIOD, self.info, error, 256) != 0:
            raise Unusable(str(self.ffi.string(error).decode()))
        self.handle = handle[0]
        self.truth = self.ffi.cast("truth *", self.handle)
        self.sensors, self.actuators = self.ffi.new("machine_sensors *"), self.ffi.new(
            "machine_actuators *"
        )

    def write(self, torque: Array) -> None:
        self.actuators.mode = TORQUE
        for j, value in enumerate(torque):
            self.actuators.aout[j] = float(value) * self.info.joint[j].mv_per_torque
        self.ops.write(self.handle, self.actuators)

    def read(self, n: int) -> tuple[Array, Array, Array]:
        """Encoders, true positions and true speeds, each (n,)."""
        self.ops.read(self.handle, self.sensors)
        seen = [self.sensors.enc[j] / self.info.joint[j].counts_per_unit for j in range(n)]
        q = [float(self.truth.q[j]) for j in range(n)]
        v = [float(self.truth.qd[j]) for j in range(n)]
        return np.array(seen, np.float64), np.array(q), np.array(v)


@contextmanager
def opened(name: str, config: str) -> Iterator[Machine]:
    machine = Machine(name, config)
    try:
        yield machine
    finally:
        machine.ops.close(machine.handle)


def record(r: Rig, shape: str, rng: Rng) -> Run:
    """One recording under PD; a command is written a sample after the position that it answers."""
    rows = round(r.seconds / PERIOD)
    t = np.arange(rows, dtype=np.float64) * PERIOD
    reference = np.stack(
        [make_reference(shape, t, a, v, rng) for a, v in zip(r.amplitude, r.speed, strict=True)], 1
    )
    rate = np.gradient(reference, PERIOD, axis=0)
    start = "".join(f"q{j + 1} = {reference[0, j]!r}\n" for j in range(r.n))
    lines = "".join(f"effect{k} = {line}\n" for k, line in enumerate(r.lines, 1))
    y, u, q, v = (np.zeros((rows, r.n)) for _ in range(4))
    kp, kd, limit = (np.array(x) for x in (r.kp, r.kd, r.limit))
    keep = 1 / (1 + 2 * np.pi * r.cutoff * PERIOD)
    command, speed = np.zeros(r.n), np.zeros(r.n)
    seed = int(rng.integers(2**31))  # of the machine's noise
    plain = f"friction = plain\nseed = {seed}\nideal = {int(r.ideal)}\n"
    with opened(r.name, f"{plain}{start}{lines}") as machine:
        for k in range(rows):
            machine.write(command)
            y[k], q[k], v[k] = machine.read(r.n)
            speed = keep * speed + (1 - keep) * (y[k] - y[max(k - 1, 0)]) / PERIOD
            command = np.clip(kp * (reference[k] - y[k]) + kd * (rate[k] - speed), -limit, limit)
            u[k] = command
            machine.ops.step(machine.handle, PERIOD)
    run = Run(t, y, u, reference, q, v, np.zeros(rows))
    if not np.all(np.isfinite(q)) or np.max(np.abs(v)) > 4 * max(r.speed):
        raise Unusable("the motion left its range")
    return run


def scale_of(r: Rig, run: Run, joint: int) -> Scale:
    """Sizes of one joint's motion."""
    u, q, v = run.command[:-1, joint], run.q[:, joint], run.v[:, joint]
    a = np.diff(v) / PERIOD
    rms = float(np.sqrt(np.mean(u**2)))
    return Scale(rms, float(np.max(np.abs(u))), u, u, q[1:], v[1:], a, v[1:] * v[:-1] > 0)


def attempt_case(request: Request, rng: Rng) -> Case:
    """One draw of a request's case.

    Raises
    ------
    Unusable
        The machine refuses what is concealed, or runs away with it.
    """
    r = RIGS[request.machine]()
    joint = int(rng.integers(r.n))
    shapes = [str(rng.choice(("multisine", "sines", "mixed", "moves"))) for _ in range(2)]
    base = record(replace(r, seconds=6.0), shapes[0], np.random.default_rng(rng.integers(2**63)))
    conceal(r, request, joint, scale_of(r, base, joint), rng)
    runs = [
        record(r, shape, np.random.default_rng(rng.integers(2**63)))
        for shape in (shapes[0], shapes[1], shapes[1])
    ]
    form, divided = format_of(rng)
    columns = columns_of(dict(NAMES[rng.integers(len(NAMES))]), r.n, divided)
    model = given(r, columns, rng, f"{request.machine}_{request.seed}")
    logged = []
    for run in runs:
        own = np.random.default_rng(rng.integers(2**63))
        if "jitter" in r.faults:
            run = jittered(run, np.full(r.n, r.resolution), PERIOD, own)
        logged.append(apply_faults(run, r.faults, PERIOD, own))
    truth = {
        "kind": request.kind,
        "machine": request.machine,
        "flavour": request.effect,
        "verdict": {"complete": "complete", "foreign": "unexplained"}.get(request.kind, "missing"),
        "size": request.size,
        "effects": r.truths,
        "also_true": sorted({*r.also_true, *ALSO_TRUE.get(request.machine, ())}),
        "replaces": [],
        "where": [],
        "train": shapes[0],
        "heldout": shapes[1],
        "seconds": r.seconds,
        "layout": "heldout",
        "notes": ["friction plain", *r.faults],
    }
    return Case(logged[0], logged[1], model, truth, form, "heldout", logged[2])


def conceal(r: Rig, request: Request, joint: int, s: Scale, rng: Rng) -> None:
    """Hide what the request says; a logger's fault where nothing is hidden."""
    name = request.effect
    if request.kind == "complete":
        if name != "plain":
            r.faults.append(name)
        if name == "filtered":
            r.also_true = (*r.also_true, "position_filter")
        return
    values: Values = {}
    mechanisms: list[str] = []
    left = 1.0  # known of foreign torques only
    if request.kind == "foreign":
        law = FOREIGN.index(name)
        mechanisms = list(FOREIGN_MECHANISMS[law])
        shape = foreign_shape(law, s)
        amplitude = request.size * s.torque / float(np.sqrt(np.mean(shape**2)))
        values = {"law": float(law), "amplitude": amplitude}
        left = left_by_refit(amplitude * shape, s)
    elif name in LEFT_OUT:
        r.hidden.add((name, joint))
        values = (
            {"level": r.coulomb[joint]} if name == "coulomb" else {"coefficient": r.viscous[joint]}
        )
    else:
        values = LAWS[name](r, joint, s, request.size, rng)
        r.fixed = name in FIXING
    if name not in LEFT_OUT:
        word = "foreign" if request.kind == "foreign" else name
        r.lines.append(
            " ".join(
                [word, f"joint={joint + 1}", *(f"{k}={float(v)!r}" for k, v in values.items())]
            )
        )
    foreign = request.kind == "foreign"
    r.truths.append(
        {
            "effect": "foreign" if foreign else name,
            "joint": joint + 1,
            "size": request.size,
            "note": name,
            "parameters": (
                {} if foreign else {k: {"value": float(v), "unit": ""} for k, v in values.items()}
            ),
            "accepted": ACCEPTED.get(name, []),
            "accepted_joints": [joint + 1],
            "mechanisms": mechanisms,
            "body": "",
            "unscored": (
                ["exponent", "velocity", "begin", "duration", "level"]
                if name in ("hysteresis", "stribeck", "disturbance")
                else []
            ),
            "oracle": {"detectable": True, "inseparable": {}, "torque_share": round(left, 6)},
        }
    )


def given(r: Rig, columns: dict[str, Any], rng: Rng, name: str) -> dict[str, Any]:
    """The model file: figures off by 3 %, friction by 5 %; exact where inertial figures are fixed.
    """

    def near(value: float, spread: float) -> dict[str, Any]:
        if r.fixed:
            return {"value": value}
        return {"value": value * (1 + spread * float(rng.standard_normal()))}

    free = {"free": False} if r.fixed else {}
    parameters: dict[str, Any] = {k: {**near(v, 0.03), **free} for k, v in r.figures.items()}
    parameters |= {k: {"value": v, "free": False} for k, v in r.lengths.items()}
    terms = []
    for j in range(r.n):
        for kind, key, value in (
            ("viscous", "coefficient", r.viscous[j]),
            ("coulomb", "level", r.coulomb[j]),
        ):
            if (kind, j) not in r.hidden:
                terms.append({"kind": kind, "joint": j + 1, key: near(value, 0.05)})
    one = r.n == 1
    return {
        "name": name,
        "sample_time": PERIOD,
        "mechanism": {"kind": r.kind, "parameters": parameters},
        "effect": terms,
        "actuator": {
            "gain": {"value": 1.0 if one else [1.0] * r.n, "free": False},
            "limit": r.limit[0] if one else list(r.limit),
            "hold": PERIOD,
            "delay": PERIOD + r.loop,
        },
        "sensor": {"position_resolution": r.resolution if one else [r.resolution] * r.n},
        "columns": columns,
    }


def requests(first_seed: int, quick: bool = False) -> list[Request]:
    """Every case of this reality; with `quick`, four."""
    if quick:
        few = (("c_planar", "single", "stiffness", 0.1), ("c_planar", "foreign", "strap", 0.1),
               ("c_planar", "complete", "plain", 1.0), ("c_pendulum", "single", "ripple", 0.2))
        return [
            Request(first_seed + k, kind, m, e, x, "machines")
            for k, (m, kind, e, x) in enumerate(few)
        ]
    rows: list[tuple[str, str, str, float]] = []
    for machine in RIGS:
        rows += [(machine, "single", effect, size) for size in (0.2, 0.07) for effect in EFFECTS]
        rows += [(machine, "complete", FAULTS[k % len(FAULTS)], 1.0) for k in range(21)]
        rows += [(machine, "foreign", law, size) for size in (0.3, 0.1, 0.05) for law in FOREIGN]
    return [
        Request(first_seed + k, kind, m, e, x, "machines") for k, (m, kind, e, x) in enumerate(rows)
    ]
