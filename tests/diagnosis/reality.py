"""A machine that shares no code with the diagnosis: plain C (reality.c), semi-implicit Euler at 10
kHz, friction by tanh.

The equation is M q̈ + friction + gravity + … = torque; a PD loop with a quantised encoder computes
the command once a sample.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import cffi
import numpy as np

from zendsp_isr.build import build

RESOLUTION = 2 * math.pi / 16384
RATE = 250.0  # Hz, of a recording
FAST = 500.0  # Hz, where an effect needs a faster recording to be seen


@dataclass
class Machine:
    """True physics, SI. Zero: absent."""

    inertia: float = 0.010
    viscous: float = 0.004
    coulomb: float = 0.03
    creep: float = 1e-3  # rad/s, about which dry friction changes its sign
    lead: float = 0.0  # s by which it sees the speed ahead, in proportion to which it grows then
    # N m/rad, N m s/rad: the bristles through which dry friction acts, instead of ``creep``
    bristle: float = 0.0
    brush: float = 0.0
    drag: float = 0.0  # drag * |q̇|^power
    power: float = 2.0
    gravity: float = 0.0
    breakaway: float = 0.0
    stribeck: float = 0.1
    tail: float = 2.0  # exponent of Stribeck's curve
    uneven: float = 0.0  # dry friction varies: uneven * sin(7 q)
    ripple: float = 0.0
    order: float = 7
    spring: float = 0.0
    wave: float = 0.0  # a law that no library has: wave * tanh(sin(3 q)) * cos(2 q̇)
    wiggle: float = 0.0  # a user's own effect: wiggle * q̇ / (1 + q̇²)
    # a look-alike of friction that varies with position: sticky * tanh(2 sin(3 q)) * tanh(q̇ / 0.1)
    sticky: float = 0.0
    # two more that no library has: swirl * sin(2 q̇), and blend * q * q̇
    swirl: float = 0.0
    blend: float = 0.0
    # N m at 0.1 rad beyond `edge`, of something springy that the joint touches there
    touch: float = 0.0
    edge: float = 0.0
    push: tuple[float, ...] = (0.0,)  # N m, from s, to s, from s, to s, …
    gap: float = 0.0  # rad, behind which `load` of the inertia hangs on a contact of 120 N m/rad
    load: float = 0.0
    unrest: float = 0.0  # N m RMS: a random torque below 2 Hz, another one in every run
    delay: float = 0.0
    kp: float = 3.0
    kd: float = 0.12
    limit: float = 3.0
    weak: float = math.inf  # torque that the actuator gives at most, whatever it is told
    resolution: float = RESOLUTION
    fade: float = 0.0  # share by which the actuator's gain changes
    fading: float = 3.0  # s: time constant of that
    oval: float = 0.0  # rad: an error of the sensor twice a turn
    smear: float = 0.0  # s: a low-pass filter between the sensor and the recording
    late: int = 0  # rows by which the command column is late; early where negative
    # torque at standstill that the supply allows, less `back` times the speed
    supply: float = math.inf
    back: float = 0.0
    # N m/rad: the spring before `load`, without a gap, with `hard` times the bend cubed
    soft: float = 0.0
    hard: float = 0.0
    wobble: float = 0.0  # rad by which the transmission errs, rigid or soft, five times a turn
    both_sides: bool = False  # a second encoder, of the load, and a torque sensor at the spring
    dry_load: float = 0.0  # N m: dry friction of the load, behind the spring
    thin: float = 0.0  # 1/K by which dry friction falls with the temperature, which rises by 15 K


def multisine(
    seconds: float,
    rate: float,
    seed: int,
    *,
    size: float = 1.0,
    low: float = 0.2,
    high: float = 4.0,
) -> np.ndarray:
    """Reference of ten sines, `size` rad at most."""
    r = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    f = np.geomspace(low, high, 10)
    q = sum(
        np.sin(2 * np.pi * a * t + p) / (a + 0.5)
        for a, p in zip(f, r.uniform(0, 6.28, 10), strict=True)
    )
    ramp = np.minimum(1.0, t / 0.5)
    return np.asarray(size * ramp * q / np.max(np.abs(q)))


NUMBERS = [f.name for f in fields(Machine) if f.type in ("float", "int")]


@functools.cache
def _library() -> tuple[cffi.FFI, Any]:
    """reality.c, compiled once per content."""
    head = f"typedef struct {{ double {', '.join(NUMBERS)}; }} numbers;\n"
    source = head + Path(__file__).with_suffix(".c").read_text()
    built = build("reality", {"reality.c": source.encode()}, ())
    assert built.path is not None, built.messages
    ffi = cffi.FFI()
    ffi.cdef(
        head + "void run(const numbers *m, int n, int sub, double T, const double *reference,"
        " const double *warm, const double *outside, double *out);"
    )
    return ffi, ffi.dlopen(str(built.path))


def simulate(
    m: Machine, reference: np.ndarray, rate: float, seed: int = 0
) -> dict[str, np.ndarray]:
    """Columns t, q, u, r of one run."""
    ffi, library = _library()
    T, n = 1.0 / rate, len(reference)
    t, reference = np.arange(n) * T, np.ascontiguousarray(reference, float)
    warm, outside, out = 20.0 - 15.0 * np.expm1(-t / 3.0), np.zeros(n), np.empty((4, n))
    for begin, end in zip(m.push[1::2], m.push[2::2], strict=True):
        outside[(begin <= t) & (t < end)] = m.push[0]
    if m.unrest:
        draw = np.random.default_rng(seed)
        turns = np.outer(t, 2 * math.pi * draw.uniform(0.2, 2.0, 40)) + draw.uniform(0, 6.28, 40)
        outside += m.unrest / math.sqrt(20) * np.sin(turns).sum(1)
    numbers = ffi.new("numbers *", {name: getattr(m, name) for name in NUMBERS})
    series = [ffi.from_buffer("double[]", a) for a in (reference, warm, outside, out)]
    library.run(numbers, n, max(4, round(1e4 / rate)), T, *series)
    position, command, far, bent = out
    columns = {
        "t": t, "q": position, "u": command[np.clip(np.arange(n) - m.late, 0, n - 1)],
        "r": reference,
    }  # fmt: skip
    if m.both_sides:
        columns |= {"ql": far, "ts": bent}
    return {**columns, "warm": warm} if m.thin else columns


def save(path: Path, columns: dict[str, np.ndarray]) -> Path:
    """CSV with a header, twelve digits."""
    names = list(columns)
    np.savetxt(
        path,
        np.stack([columns[n] for n in names], axis=1),
        delimiter=",",
        header=",".join(names),
        comments="",
        fmt="%.12g",
    )
    return path


MODEL = """name = "bench"
sample_time = {period}

[mechanism]
kind = "rotary"

[mechanism.parameters]
inertia = {{ value = {inertia} }}
{gravity}

{effects}

[actuator]
gain = {{ value = 1.0, free = false }}
limit = 3.0
hold = {period}

[sensor]
position_resolution = {resolution}

[columns]
time = "t"
position = "q"
command = "u"
reference = "r"
"""


def effect(kind: str, **numbers: float) -> str:
    """One [[effect]] table."""
    rows = "\n".join(f"{k} = {{ value = {v} }}" for k, v in numbers.items())
    return f'[[effect]]\nkind = "{kind}"\njoint = 1\n{rows}\n'


# what a given model usually has of a Machine()
KNOWN = (effect("viscous", coefficient=0.004), effect("coulomb", level=0.03))


def model_file(
    path: Path,
    rate: float,
    *effects: str,
    inertia: float = 0.0102,
    gravity: float = 0.0,
    resolution: float = RESOLUTION,
    columns: str = "",
) -> Path:
    """The given model: what it has is what is written here."""
    text = MODEL.format(
        period=1.0 / rate,
        inertia=inertia,
        gravity=f"gravity = {{ value = {gravity} }}" if gravity else "",
        effects="\n".join(effects),
        resolution=repr(resolution),
    )
    path.write_text(text + columns)
    return path
