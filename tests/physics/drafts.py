"""A recording with a known joint, and the model that is begun from a recording."""

from __future__ import annotations

import re
import tomllib

import numpy as np

from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Model

N, STEP = 8000, 0.002
T = np.arange(N) * STEP
INERTIA, GRAVITY, COUNTS = 0.031, 0.42, 4096


def recording() -> dict[str, np.ndarray]:
    """A pendulum that follows a sum of sines: tau = J qdd + 0.05 qd + 0.1 sign(qd) + g sin(q),
    counted by an encoder.
    """
    waves = [(1.1, 3.1, 0.2), (0.5, 7.3, 1.0), (0.2, 13.0, 2.0)]
    q = sum(a * np.sin(w * T + p) for a, w, p in waves)
    qd = sum(a * w * np.cos(w * T + p) for a, w, p in waves)
    qdd = sum(-a * w * w * np.sin(w * T + p) for a, w, p in waves)
    tau = INERTIA * qdd + 0.05 * qd + 0.1 * np.sign(qd) + GRAVITY * np.sin(q)
    step = 2 * np.pi / COUNTS
    return {"t": T, "q": np.round(q / step) * step, "tau": tau, "r": q}


def model_of(text: str) -> Model:
    chosen = re.sub("(?m)^#(?! )", "", text)  # every line that is a choice
    assert "\n[controller]\n" in chosen
    parse_model(tomllib.loads(chosen), "chosen.toml")
    return parse_model(tomllib.loads(text), "draft.toml")
