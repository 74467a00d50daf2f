"""What the other joints feel of a link whose recorded position does not show it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from reality import RATE

from zendsp.diagnosis import joints
from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.signals import Parts, Signals
from zendsp.diagnosis.transmission.links import divided, with_links
from zendsp.physics.calibration.fit import residual
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Model
from zendsp.tree import Array

P1, P2, P3 = 0.42, 0.1, 0.1  # kg m²
VISCOUS = np.array([0.2, 0.1])  # N m s/rad
STIFFNESS, DAMPING, MOTOR = 300.0, 0.5, 0.12  # N m/rad, N m s/rad, kg m²
LATE = 0.01  # s
SPRING = {
    "kind": "elasticity", "joint": 1, "stiffness": STIFFNESS, "damping": DAMPING,
    "load_inertia": P1 - MOTOR,
}  # fmt: skip
FILTER = {"kind": "position_filter", "joint": 1, "time_constant": LATE}


def _model(side: str, *effects: dict[str, object]) -> Model:
    return parse_model(
        {
            "sample_time": 1.0 / RATE,
            "mechanism": {"kind": "planar2r", "parameters": {"p1": P1, "p2": P2, "p3": P3}},
            "sensor": {"side": side},
            "effect": [
                {"kind": "viscous", "joint": 1, "coefficient": float(VISCOUS[0])},
                {"kind": "viscous", "joint": 2, "coefficient": float(VISCOUS[1])},
                *effects,
            ],
        }
    )


def _arm(side: str, *effects: dict[str, object], steps: int = 40) -> tuple[Array, Array]:
    """Command and recorded positions of a planar arm, (n, 2) each."""
    motor, late = MOTOR if SPRING in effects else 0.0, LATE if FILTER in effects else 0.0
    h = 1.0 / RATE / steps
    t = np.arange(round(4.0 * RATE)) / RATE
    command = np.stack([2.0 * np.sin(7 * t) + np.sin(23 * t), 0.8 * np.sin(9 * t + 1)], 1)
    command *= np.minimum(1.0, t / 0.5)[:, None]
    x, v, turned, speed, seen, rows = np.zeros(2), np.zeros(2), 0.0, 0.0, 0.0, []
    for u in command:  # semi-implicit Euler of a motor, where it has one, and both links
        looked_at = turned if motor and side == "motor" else x[0]
        rows.append((seen if late else looked_at, x[1]))
        for _ in range(steps):
            c, s = P3 * np.cos(x[1]), P3 * np.sin(x[1])
            inertia = np.array([[P1 - motor + 2 * c, P2 + c], [P2 + c, P2]])
            bias = np.array([-s * v[1] * (2 * v[0] + v[1]), s * v[0] ** 2])
            drive = u - VISCOUS * v
            if motor:
                drive[0] = STIFFNESS * (turned - x[0]) + DAMPING * (speed - v[0])
                speed += h * (u[0] - drive[0] - VISCOUS[0] * speed) / motor
                turned += h * speed
            v = v + h * np.linalg.solve(inertia, drive - bias)
            x = x + h * v
            if late:
                seen += h * (x[0] - seen) / late
    return command, np.array(rows)


@pytest.mark.parametrize(
    ("side", "effects"),
    [("motor", [SPRING]), ("motor", [FILTER]), ("load", [SPRING, FILTER])],
    ids=["spring", "filter", "filter beyond a spring"],
)
def test_the_other_joint_feels_the_link_and_not_what_a_sensor_shows(
    side: str, effects: list[dict[str, object]]
) -> None:
    command, shown = _arm(side, *effects)
    model = _model(side, *effects)
    t = np.arange(len(command)) / RATE
    read = Signals("run", t, 1.0 / RATE, shown, command, None, np.full(2, 1e-6))
    data = prepare([read], model, 64.0)
    assert divided(model) == {1}
    links = with_links(Parts(data, data, data), model, divided(model)).fit
    off = [np.sqrt(np.mean(residual(d, model, [2]) ** 2)) for d in (data, links)]
    assert off[1] < 0.25 * off[0]
    assert np.allclose(residual(links, model, [1]), residual(data, model, [1]))


def test_only_what_is_claimed_of_a_link_that_nobody_sees_counts() -> None:
    def explained(*claims: tuple[int, str]) -> Any:
        decisions = [
            SimpleNamespace(joint=j, claims=[SimpleNamespace(mechanism=m)]) for j, m in claims
        ]
        return None, decisions, SimpleNamespace(improved=_model("motor", SPRING))

    claimed = joints._claimed
    assert claimed(explained((1, "transmission"), (2, "transmission")), "transmission") == {1}
    assert claimed(explained((1, "measurement")), "transmission") == frozenset()
    assert claimed(explained((1, "measurement")), "transmission", "measurement") == {1}
