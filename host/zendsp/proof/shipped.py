"""Cases on the machines that ship with zendsp as C: their own integrator, friction, drives and
encoders.

A machine is opened through ``machine.h`` and stepped sample by sample, with friction set to plain,
so that what it conceals is all that the given model lacks.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import cffi
import numpy as np

from zendsp.proof.case import Case, Request, Unusable
from zendsp.proof.draft import Array, Scale
from zendsp.proof.files import NAMES, columns_of
from zendsp.proof.measure import apply_faults, format_of, jittered
from zendsp.proof.model_table import Columns, EffectTable, ModelTable, one_or_each, parameter
from zendsp.proof.reality import Run
from zendsp.proof.references import make_reference
from zendsp.proof.shipped_laws import (
    ACCEPTED,
    ALSO_TRUE,
    EFFECTS,
    FAULTS,
    FIXING,
    FOREIGN,
    FOREIGN_MECHANISMS,
    LAWS,
    LEFT_OUT,
    PERIOD,
    RIGS,
    TORQUE,
    TRUTH,
    Rig,
    Values,
    foreign_shape,
    left_by_refit,
)
from zendsp.proof.truth import Truth
from zendsp_isr.build import source_root
from zendsp_isr.parts import build_machine

Rng = np.random.Generator


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
        self.sensors = self.ffi.new("machine_sensors *")
        self.actuators = self.ffi.new("machine_actuators *")

    def write(self, torque: Array) -> None:
        """Give the drives a torque, (joints,), N m or N."""
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
def _opened(name: str, config: str) -> Iterator[Machine]:
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
    with _opened(r.name, f"{plain}{start}{lines}") as machine:
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
    truth: Truth = {
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


def given(r: Rig, columns: Columns, rng: Rng, name: str) -> ModelTable:
    """The model file: figures off by 3 %, friction by 5 %; exact where inertial figures are fixed.
    """

    def near(value: float, spread: float) -> float:
        return value if r.fixed else value * (1 + spread * float(rng.standard_normal()))

    parameters = {k: parameter(near(v, 0.03), r.fixed) for k, v in r.figures.items()}
    parameters |= {k: parameter(v, fixed=True) for k, v in r.lengths.items()}
    terms: list[EffectTable] = []
    for j in range(r.n):
        for kind, key, value in (
            ("viscous", "coefficient", r.viscous[j]),
            ("coulomb", "level", r.coulomb[j]),
        ):
            if (kind, j) not in r.hidden:
                terms.append({"kind": kind, "joint": j + 1, key: parameter(near(value, 0.05))})
    return {
        "name": name,
        "sample_time": PERIOD,
        "mechanism": {"kind": r.kind, "parameters": parameters},
        "effect": terms,
        "actuator": {
            "gain": parameter(one_or_each([1.0] * r.n), fixed=True),
            "limit": one_or_each(r.limit),
            "hold": PERIOD,
            "delay": PERIOD + r.loop,
        },
        "sensor": {"position_resolution": one_or_each([r.resolution] * r.n)},
        "columns": columns,
    }


def requests(first_seed: int, quick: bool = False) -> list[Request]:
    """Every case of this reality; with `quick`, four."""
    if quick:
        few = (("c_planar", "single", "stiffness", 0.1), ("c_pendulum", "foreign", "strap", 0.1),
               ("c_pendulum", "complete", "plain", 1.0), ("c_pendulum", "single", "ripple", 0.2))
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
