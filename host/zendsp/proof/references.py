"""Reference motions of the concealed cases: what a laboratory would run, rich and poor."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def soft_start(t: Array) -> Array:
    """From 0 to 1 within 0.6 s with zero slope at both ends, so that a run starts at rest."""
    x = np.clip(t / 0.6, 0.0, 1.0)
    return np.asarray(x**3 * (10 - 15 * x + 6 * x**2))


def scaled(t: Array, shape: Array, amplitude: float, speed: float) -> Array:
    """`shape` scaled so that neither its peak exceeds `amplitude` nor its peak slope `speed`."""
    shape = shape - shape.mean()
    slope = np.max(np.abs(np.gradient(shape, t)))
    return np.asarray(shape * min(amplitude / np.max(np.abs(shape)), speed / slope))


def multisine(t: Array, amplitude: float, speed: float, rng: np.random.Generator) -> Array:
    """Eight to fourteen lines between 0.1 and 2.5 Hz, random phases, amplitudes falling with
    frequency.
    """
    f = np.exp(rng.uniform(np.log(0.1), np.log(2.5), rng.integers(8, 15)))
    weight = f ** rng.uniform(-1.3, -0.6)
    phase = rng.uniform(0, 2 * np.pi, f.size)
    return scaled(t, (weight * np.sin(2 * np.pi * np.outer(t, f) + phase)).sum(1), amplitude, speed)


def sines(t: Array, amplitude: float, speed: float, rng: np.random.Generator) -> Array:
    """Three sines without a common period."""
    f = np.array([0.17, 0.43, 1.1]) * rng.uniform(0.8, 1.25, 3)
    phase = rng.uniform(0, 2 * np.pi, 3)
    return scaled(
        t,
        (np.array([1.0, 0.6, 0.25]) * np.sin(2 * np.pi * np.outer(t, f) + phase)).sum(1),
        amplitude,
        speed,
    )


def circle(t: Array, amplitude: float, speed: float, rng: np.random.Generator) -> Array:
    """One joint's share of a circle: nearly a sine, with its second harmonic."""
    w = 2 * np.pi / rng.uniform(3.5, 6.0)
    phase = rng.uniform(0, 2 * np.pi)
    return scaled(t, np.sin(w * t + phase) + 0.2 * np.sin(2 * w * t + 2 * phase), amplitude, speed)


def chirp(t: Array, amplitude: float, speed: float, rng: np.random.Generator) -> Array:
    """From 0.1 to 2–3 Hz, its amplitude falling so that the speed stays."""
    f0, f1 = 0.1, rng.uniform(2.0, 3.0)
    f = f0 * (f1 / f0) ** (t / t[-1])
    angle = 2 * np.pi * np.cumsum(f) * (t[1] - t[0]) + rng.uniform(0, 2 * np.pi)
    return scaled(t, np.sin(angle) * np.minimum(1.0, 0.4 / f), amplitude, speed)


def moves(
    t: Array, amplitude: float, speed: float, rng: np.random.Generator, rest: float = 0.3
) -> Array:
    """Point to point with trapezoidal speed, random goals, a rest after each."""
    out = np.zeros_like(t)
    now, clock, dt = 0.0, 0.4, t[1] - t[0]
    while clock < t[-1]:
        goal = rng.uniform(-amplitude, amplitude)
        cruise = speed * rng.uniform(0.3, 1.0)
        blend = rng.uniform(0.15, 0.4)
        seconds = abs(goal - now) / cruise + blend
        x = np.clip((t - clock) / seconds, 0, 1)
        r = blend / seconds
        ramp = np.where(
            x < r, x**2 / (2 * r), np.where(x < 1 - r, x - r / 2, 1 - r - (1 - x) ** 2 / (2 * r))
        ) / (1 - r)
        out += (goal - now) * ramp
        now, clock = goal, clock + seconds + rest * rng.uniform(0.3, 1.5) + dt
    return out


def triangles(t: Array, amplitude: float, speed: float, rng: np.random.Generator) -> Array:
    """Constant speeds in both directions, another speed every swing, corners rounded over 60 ms.

    No swing lasts longer than 2.5 s, so that slow swings are short and every run has many
    reversals.
    """
    knots, places, side = [0.0, 0.4], [0.0, 0.0], 1.0
    while knots[-1] < t[-1]:
        goal = side * amplitude * rng.uniform(0.5, 1.0)
        cruise = speed * np.exp(rng.uniform(np.log(0.03), 0.0))
        way = np.clip(goal - places[-1], -2.5 * cruise, 2.5 * cruise)
        goal = places[-1] + way
        knots.append(knots[-1] + max(abs(way) / cruise, 0.15))
        places.append(goal)
        side = -side
    shape = np.interp(t, knots, places)
    width = max(1, round(0.06 / (t[1] - t[0])))
    padded = np.concatenate([np.full(width, shape[0]), shape, np.full(width, shape[-1])])
    kernel = np.hanning(2 * width + 1)
    return np.asarray(np.convolve(padded, kernel / kernel.sum(), "valid"))


def steps(t: Array, amplitude: float, speed: float, rng: np.random.Generator) -> Array:
    """Random levels, each held for about a second, through a second-order filter of the generator.
    """
    levels = rng.uniform(-amplitude, amplitude, 200)
    index = np.minimum((t / rng.uniform(0.8, 1.5)).astype(int), 199)
    raw = levels[index] * (t > 0.4)
    out, first, second, dt = np.zeros(t.size), 0.0, 0.0, float(t[1] - t[0])
    blend = 1 - np.exp(-dt * speed / amplitude * 1.5)
    for k, value in enumerate(raw):
        first += blend * (value - first)
        second += blend * (first - second)
        out[k] = second
    return out


def slow(t: Array, amplitude: float, speed: float, rng: np.random.Generator) -> Array:
    """A few encoder counts per hundred samples: creeping moves with rests."""
    return moves(t, 0.3 * amplitude, 0.03 * speed, rng, rest=0.8)


def mostly_fast(t: Array, amplitude: float, speed: float, rng: np.random.Generator) -> Array:
    """A multisine all the time but for 15 % of it, in one place, that creeps through reversals."""
    fast = multisine(t, amplitude, speed, rng)
    start = rng.uniform(0.2, 0.7) * t[-1]
    x = (t - start) / (0.15 * t[-1])
    gate = np.clip(12 * np.minimum(x, 1 - x), 0, 1)
    gate = gate**2 * (3 - 2 * gate)
    creep = 0.08 * amplitude * np.sin(2 * np.pi * (t - start) * rng.uniform(0.5, 1.0))
    return np.asarray((1 - gate) * fast + gate * creep)


Shape = Callable[[Array, float, float, np.random.Generator], Array]
SHAPES: dict[str, Shape] = {
    "multisine": multisine, "sines": sines, "circle": circle, "chirp": chirp, "moves": moves,
    "triangles": triangles, "steps": steps, "slow": slow, "mostly_fast": mostly_fast,
}
RICH = ("multisine", "multisine", "sines", "triangles", "chirp", "moves")


def make_reference(
    name: str, t: Array, amplitude: float, speed: float, rng: np.random.Generator
) -> Array:
    """One joint's reference by name, starting at rest.

    Parameters
    ----------
    name : str
        A key of ``SHAPES``, or ``"mixed"``: a multisine for half of the time, then triangles.
    t : array, (rows,), s
    amplitude, speed : float
        Largest excursion (rad or m) and speed (rad/s or m/s).

    Returns
    -------
    array, (rows,)
    """
    if name == "mixed":
        half = t.size // 2
        first = multisine(t, amplitude, speed, rng) * soft_start(t[half] - t)
        second = triangles(t, amplitude, speed, rng)
        out = first.copy()
        out[half:] += second[: t.size - half]
        return out * soft_start(t)
    return SHAPES[name](t, amplitude, speed, rng) * soft_start(t)
