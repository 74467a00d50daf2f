"""Motions of one joint integrated elsewhere (Runge-Kutta of fourth order), and the kernel's."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.signals import Signals
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.calibration.predict import run
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Model

J, T, N = 0.01, 0.002, 1000


STIFF = 40  # Runge-Kutta steps a sample where friction has a steep step


TANH = 2e-4  # rad/s: width of the reference's friction step


Torque = Callable[[float, float, float, float], float]
State = Sequence[float]  # plain floats: arrays of two numbers are ten times as slow


def command() -> np.ndarray:
    """Torque that starts at rest and reverses, N m."""
    t = np.arange(N) * T
    ramp = 1 - np.exp(-((t / 0.3) ** 2))
    u: np.ndarray = (
        0.15 * ramp * (np.sin(2 * np.pi * 1.1 * t) + 0.7 * np.sin(2 * np.pi * 2.7 * t + 1))
    )
    return u


def warmth(t: float) -> float:
    """Of the machine while it is recorded, °C."""
    return 20 + 8 * t


def integrate(
    derivative: Callable[[State, float, float], State],
    states: int,
    sub: int = 10,
    start: float = 0.0,
) -> np.ndarray:
    """Trajectory (N, states) from rest under the held command; ``start``: of the first state."""
    h, out = T / sub, []
    x = [start, *[0.0] * (states - 1)]
    for k, u in enumerate(command().tolist()):
        out.append(x)
        for i in range(sub):
            t = k * T + i * h
            a = derivative(x, t, u)
            b = derivative(_ahead(x, 0.5 * h, a), t + 0.5 * h, u)
            c = derivative(_ahead(x, 0.5 * h, b), t + 0.5 * h, u)
            d = derivative(_ahead(x, h, c), t + h, u)
            mean = [p + 2 * q + 2 * r + s for p, q, r, s in zip(a, b, c, d, strict=True)]
            x = _ahead(x, h / 6, mean)
    return np.array(out)


def _ahead(x: State, h: float, rate: State) -> list[float]:
    return [at + h * v for at, v in zip(x, rate, strict=True)]


def rigid(
    resist: Torque, drive: Callable[[float], float] = lambda u: u, inertia: float = J, sub: int = 10
) -> np.ndarray:
    """Position of one inertia against a resisting torque."""

    def derivative(x: State, t: float, u: float) -> State:
        return x[1], (drive(u) - resist(x[0], x[1], t, u)) / inertia

    return integrate(derivative, 2, sub)[:, 0]


def recorded(
    position: np.ndarray,
    terms: list[dict[str, Any]],
    inertia: float = J,
    gravity: float = 0.0,
    **tables: Any,
) -> tuple[Model, JointRecord]:
    """A model with these terms, and the recording of a position under the command."""
    mechanism = {"kind": "rotary", "parameters": {"inertia": inertia, "gravity": gravity}}
    model = parse_model({"mechanism": mechanism, "effect": terms, "sample_time": T, **tables})
    one = np.ascontiguousarray(position)[:, None]
    extra = {"temperature": np.array([[warmth(k * T)] for k in range(N)])}
    signals = Signals(
        "reference", np.arange(N) * T, T, one, command()[:, None], None, np.zeros(1), extra=extra
    )
    return model, prepare([signals], model).records[0][0]


def kernel(
    position: np.ndarray, terms: list[dict[str, Any]], inner: int, inertia: float = J, **more: Any
) -> np.ndarray:
    """The kernel's free simulation of the whole recording from its first sample."""
    model, record = recorded(position, terms, inertia, **more)
    # the reference rests at first; the smoother's guess of that is not what is tested here
    record.motion.states[:, 0] = position[0], 0.0, 0.0
    r = run(record, model, 16.0, inner=inner, free_every=N).innovations
    return record.position - r


def dry(level: float) -> Callable[[float], float]:
    return lambda v: level * math.tanh(v / TANH)
