"""A joint with friction, as a model, and recordings of it as the search sees them."""

from __future__ import annotations

import numpy as np
import reality
from reality import RATE

from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.signals import Signals
from zendsp.physics.calibration.fit import Data
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Model


def signals_of(columns: dict[str, np.ndarray], rate: float = RATE) -> Signals:
    return Signals(
        "run",
        columns["t"],
        1.0 / rate,
        columns["q"][:, None],
        columns["u"][:, None],
        None,
        np.array([reality.RESOLUTION]),
    )


def data_of(columns: dict[str, np.ndarray], model: Model, rate: float = RATE) -> Data:
    return prepare([signals_of(columns, rate)], model, 64.0)


def model_of(
    *terms: dict[str, object], inertia: float = 0.010, rate: float = RATE
) -> Model:
    return parse_model(
        {
            "sample_time": 1.0 / rate,
            "mechanism": {"kind": "rotary", "parameters": {"inertia": {"value": inertia}}},
            "effect": list(terms),
        }
    )


VISCOUS = {"kind": "viscous", "joint": 1, "coefficient": 0.004}
COULOMB = {"kind": "coulomb", "joint": 1, "level": 0.03}
