"""Two links in a plane along a known motion, by equations of their own, and a model of them."""

from __future__ import annotations

import numpy as np

from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Model


def two_links(
    start: float = 0.0, load: tuple[float, float, float] = (0.0, 0.0, 0.0), rotor: float = 0.0
) -> dict[str, np.ndarray]:
    """An arm with p1, p2, p3 = 0.4, 0.09, 0.075 kg m² along a multisine, with dry friction; from a
    time on, s. Its second link carries a ``load``, kg, at x and y, m, from joint 2; motor 1 has a
    further ``rotor``, kg m².
    """
    mass, x, y = load
    p2, p3, aside = 0.09 + mass * (x**2 + y**2), 0.075 + mass * 0.3 * x, mass * 0.3 * y
    p1 = 0.4 + rotor + mass * (0.3**2 + x**2 + y**2)
    t = np.arange(0.0, 8.0, 0.002)
    f, phase = np.array([[0.3, 0.7, 1.1], [0.4, 0.9, 1.3]]), np.array([[0, 1, 2], [2, 0, 1]])
    w = 2 * np.pi * f[:, :, None]
    turn = w * (t + start) + phase[:, :, None]
    q, v = 0.3 * np.sin(turn).sum(1), 0.3 * (w * np.cos(turn)).sum(1)
    a = -0.3 * (w**2 * np.sin(turn)).sum(1)
    c = p3 * np.cos(q[1]) - aside * np.sin(q[1])
    s = p3 * np.sin(q[1]) + aside * np.cos(q[1])
    u1 = (p1 + 2 * c) * a[0] + (p2 + c) * a[1] - s * (2 * v[0] + v[1]) * v[1]
    u2 = (p2 + c) * a[0] + p2 * a[1] + s * v[0] ** 2
    u = np.stack([u1, u2]) + np.array([[0.25], [0.12]]) * np.tanh(v / 0.01)
    return {"t": t, "q": q.T, "u": u.T}


def plane_model() -> Model:
    """A model of it, with numbers that are off by 5 %."""
    numbers = {"p1": 0.42, "p2": 0.085, "p3": 0.07, "l1": 0.3, "l2": 0.3}
    return parse_model({
        "name": "arm", "sample_time": 0.002,
        "mechanism": {
            "kind": "planar2r",
            "parameters": {k: {"value": v, "free": k[0] == "p"} for k, v in numbers.items()},
        },
        "sensor": {"position_resolution": 1e-4},
        "columns": {"time": "t", "position": "q", "command": "u"},
    })  # fmt: skip
