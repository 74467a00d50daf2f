"""A machine that shares no code with what is judged: plain Python, semi-implicit Euler at 10 kHz,
friction by tanh.

The equation is M q̈ + friction + gravity + … = torque; a PD loop with a quantised encoder computes
the command once a sample.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

RESOLUTION = 2 * math.pi / 16384
RATE = 500.0


@dataclass
class Machine:
    """True physics, SI. Zero: absent."""

    inertia: float = 0.010
    viscous: float = 0.004
    coulomb: float = 0.03
    creep: float = 1e-3  # rad/s, about which dry friction changes its sign
    drag: float = 0.0  # drag * |q̇|^power
    power: float = 2.0
    gravity: float = 0.0
    breakaway: float = 0.0
    stribeck: float = 0.1
    tail: float = 2.0  # exponent of Stribeck's curve
    uneven: float = 0.0  # dry friction varies: uneven * sin(7 q)
    ripple: float = 0.0
    order: int = 7
    spring: float = 0.0
    wave: float = 0.0  # a law that no library has: wave * tanh(sin(3 q)) * cos(2 q̇)
    wiggle: float = 0.0  # a user's own effect: wiggle * q̇ / (1 + q̇²)
    # a look-alike of friction that varies with position: sticky * tanh(2 sin(3 q)) * tanh(q̇ / 0.1)
    sticky: float = 0.0
    # two more that no library has: swirl * sin(2 q̇), and blend * q * q̇
    swirl: float = 0.0
    blend: float = 0.0
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
    fade: float = 0.0  # share by which the actuator's gain changes, with a time constant of 3 s
    oval: float = 0.0  # rad: an error of the sensor twice a turn
    smear: float = 0.0  # s: a low-pass filter between the sensor and the recording
    late: int = 0  # rows by which the command column is late; early where negative
    # torque at standstill that the supply allows, less `back` times the speed
    supply: float = math.inf
    back: float = 0.0
    # N m/rad: the spring before `load`, without a gap, with `hard` times the bend cubed
    soft: float = 0.0
    hard: float = 0.0
    wobble: float = 0.0  # rad by which a rigid transmission errs, five times a turn
    both_sides: bool = False  # a second encoder, of the load, and a torque sensor at the spring
    dry_load: float = 0.0  # N m: dry friction of the load, behind the spring
    thin: float = 0.0  # 1/K by which dry friction falls with the temperature, which rises by 15 K
    extra: dict[str, float] = field(default_factory=dict)


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


def simulate(
    m: Machine, reference: np.ndarray, rate: float, seed: int = 0
) -> dict[str, np.ndarray]:
    """Columns t, q, u, r of one run."""
    T = 1.0 / rate
    sub = max(4, round(1e4 / rate))
    h = T / sub
    q, v, last, queue = float(reference[0]), 0.0, float(reference[0]), []
    there, speed = q - 0.5 * m.gap, 0.0  # of the load
    late = round(m.delay / h)
    queue = [0.0] * (late + 1)
    ys, us, loads, twisting = [], [], [], []
    draw = np.random.default_rng(seed)
    slow = (
        [
            (2 * math.pi * a, b)
            for a, b in zip(draw.uniform(0.2, 2.0, 40), draw.uniform(0, 6.28, 40), strict=True)
        ]
        if m.unrest
        else []
    )
    seen, warm = q, []
    for k, r in enumerate(reference):
        warm.append(20.0 + 15.0 * (1.0 - math.exp(-k * T / 3.0)))
        unrest = m.unrest / math.sqrt(20) * sum(math.sin(a * k * T + b) for a, b in slow)
        at = q + m.oval * math.sin(2 * q + 0.3)
        y = m.resolution * round(at / m.resolution) if m.resolution else at
        u = m.kp * (r - y) - m.kd * (y - last) / T
        u = max(-m.limit, min(m.limit, u))
        last = y
        ys.append(m.resolution * round(seen / m.resolution) if m.smear else y)
        us.append(u)
        of_load = there if m.load else q
        loads.append(m.resolution * round(of_load / m.resolution) if m.resolution else of_load)
        twisting.append(m.soft * (q - there) + m.hard * (q - there) ** 3)
        drive = u * (1.0 + m.fade * (1.0 - math.exp(-k * T / 3.0)))
        for _ in range(sub):
            if late:
                queue.append(u)
                torque = queue[-1 - late]
            else:
                torque = drive
            torque = max(-m.supply - m.back * v, min(m.supply - m.back * v, torque))
            torque = max(-m.weak, min(m.weak, torque)) + unrest
            spans = zip(m.push[1::2], m.push[2::2], strict=True)
            torque += m.push[0] * any(a <= k * T < b for a, b in spans)
            level = m.coulomb + m.uneven * math.sin(7 * q) + (
                (m.breakaway - m.coulomb) * math.exp(-(abs(v / m.stribeck) ** m.tail))
                if m.breakaway
                else 0.0
            )
            f = (
                m.viscous * v
                + m.drag * math.copysign(abs(v) ** m.power, v)
                + m.gravity * math.sin(q)
                + m.ripple * math.sin(m.order * q + 0.4)
                + m.spring * q
            )
            f += m.wave * math.tanh(3 * math.sin(3 * q)) * math.cos(2 * v) + m.wiggle * v / (
                1 + v * v
            )
            level *= 1.0 - m.thin * (warm[-1] - 20.0)
            inertia = m.inertia
            if m.wobble:  # the load turns by `slope` for each turn of the motor
                slope = 1.0 + 5 * m.wobble * math.cos(5 * q + 0.6)
                bend = -25 * m.wobble * math.sin(5 * q + 0.6)
                inertia *= slope * slope
                f += m.inertia * slope * bend * v * v
                f += m.gravity * (
                    slope * math.sin(q + m.wobble * math.sin(5 * q + 0.6)) - math.sin(q)
                )
            f += m.sticky * math.tanh(2 * math.sin(3 * q)) * math.tanh(v / 0.1)
            f += m.swirl * math.sin(2 * v) + m.blend * q * v
            # dry friction implicitly in its slope: stable at any step
            s = math.tanh(v / m.creep)
            steep = level / m.creep * (1 - s * s)
            push = 0.0
            if m.soft:
                apart = q - there
                push = m.soft * apart + m.hard * apart**3 + 0.02 * (v - speed)
                held = math.tanh(speed / 1e-3)
                steep_there = m.dry_load / 1e-3 * (1 - held * held)
                speed += h * (push - m.dry_load * held) / (m.load + h * steep_there)
                there += h * speed
            elif m.load:
                apart = q - there
                deep = apart - math.copysign(0.5 * m.gap, apart)
                if abs(apart) > 0.5 * m.gap:
                    push = math.copysign(
                        max(0.0, math.copysign(1.0, apart) * (120.0 * deep + 0.2 * (v - speed))),
                        apart,
                    )
                speed += h * push / m.load
                there += h * speed
            v += h * (torque - f - push - level * s) / (inertia - m.load + h * steep)
            q += h * v
            seen += h * (q - seen) / m.smear if m.smear else 0.0
    n = len(reference)
    rows = np.clip(np.arange(n) - m.late, 0, n - 1)
    columns = {
        "t": np.arange(n) * T,
        "q": np.array(ys),
        "u": np.array(us)[rows],
        "r": np.asarray(reference, float),
    }
    if m.both_sides:
        columns |= {"ql": np.array(loads), "ts": np.array(twisting)}
    return {**columns, "warm": np.array(warm)} if m.thin else columns


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
