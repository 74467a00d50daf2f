"""State-dependent torques that no effect of the contract's table, and no refit of the given model, expresses."""

from __future__ import annotations

import numpy as np

from zendsp.proof.draft import Array, Concealed, Draft, Scale

FORMS = {
    1: "viscosity that grows with the square of position",
    2: "damping and driving by turns along the travel",
    3: "a hump of resistance at one speed",
    4: "soft stops at both ends of the travel",
    5: "a torque that follows the sign of position times velocity",
    6: "one sticky place in the travel",
    7: "a resistance that is a sine of speed",
}


def parameters_of(form: int, s: Scale, rng: np.random.Generator) -> tuple[float, float]:
    """Shape parameters b, c of a form, placed where this joint moves."""
    middle, half = 0.5 * float(s.q.max() + s.q.min()), 0.5 * s.reach
    if form == 1:
        return half, 1.0
    if form == 2:
        return 2 * np.pi / (half * rng.uniform(0.8, 1.5)), 1.0
    if form == 3:
        return s.v_rms * rng.uniform(0.7, 1.2), s.v_rms * rng.uniform(0.2, 0.35)
    if form == 4:
        return half * rng.uniform(0.4, 0.6), 1.0
    if form == 5:
        return 0.2 * half * s.v_rms, 1.0
    if form == 6:
        return middle + half * rng.uniform(-0.5, 0.5), half * rng.uniform(0.15, 0.3)
    return s.v_rms / rng.uniform(2.0, 3.0), 1.0


def value(form: int, b: float, c: float, s: Scale) -> Array:
    """The torque with a = 1 along the run `s`; the same forms as in ``joint.c``."""
    q, v = s.q, s.v
    if form == 1:
        return q**2 * v / b**2
    if form == 2:
        return np.sin(b * q) * v
    if form == 3:
        return np.asarray(np.exp(-(((np.abs(v) - b) / c) ** 2)) * np.sign(v))
    if form == 4:
        return np.where(q > b, q - b, np.where(q < -b, q + b, 0.0))
    if form == 5:
        return np.tanh(q * v / b)
    if form == 6:
        return np.asarray(np.exp(-(((q - b) / c) ** 2)) * v)
    return np.sin(v / b)


def add_foreign(d: Draft, joint: int, s: Scale, size: float, rng: np.random.Generator) -> Concealed:
    """Put one foreign torque into the truth; `size` 1 is 35 % of the torque's RMS."""
    form = int(rng.integers(1, 8))
    b, c = parameters_of(form, s, rng)
    rms = float(np.sqrt(np.mean(value(form, b, c, s) ** 2)))
    a = 0.35 * size * s.torque * rng.uniform(0.8, 1.3) / rms
    if form in (2, 6):
        a *= either_way(form, rng)
    d.joints[joint].update(foreign_kind=float(form), foreign_a=a, foreign_b=b, foreign_c=c)
    spots = {3: ("velocity", (b, -b)), 4: ("position", (1.3 * b, -1.3 * b)), 6: ("position", (b,))}
    variable, values = spots.get(form, ("", ()))
    where = [{"variable": variable, "joint": joint + 1, "value": x} for x in values]
    return Concealed("foreign", joint + 1, {}, size, note=FORMS[form], where=where)


def either_way(form: int, rng: np.random.Generator) -> float:
    """Form 2 may start with driving or damping; form 6 only resists."""
    return float(rng.choice([-1.0, 1.0])) if form == 2 else 1.0
