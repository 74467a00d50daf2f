"""The machines that cases are made of, drawn at random around published or typical figures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zendsp.proof.draft import Draft
from zendsp.proof.references import RICH
from zendsp.proof.wam import wam

Rng = np.random.Generator


def _log_uniform(rng: Rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def shapes(rng: Rng) -> tuple[str, str]:
    """Shapes of the training and the held-out reference; half of the time they differ."""
    train = str(rng.choice(["mixed", *RICH]))
    return train, train if rng.random() < 0.4 else str(rng.choice(["mixed", *RICH]))


def _sensor(rng: Rng, bits: int) -> dict[str, float]:
    return {"resolution": 2 * np.pi / 2**bits, "floor_counts": float(rng.random() < 0.3)}


def rotary(rng: Rng) -> Draft:
    """A small rotary bench: 1 kHz, PD loop, 12 to 16 bits, with or without gravity."""
    inertia = _log_uniform(rng, 0.004, 0.02)
    gravity = inertia / 0.01 * rng.uniform(0.1, 0.5) if rng.random() < 0.6 else 0.0
    bits = int(rng.choice([12, 14, 16], p=[0.4, 0.4, 0.2]))
    dt = float(rng.choice([1e-3, 5e-4, 2e-3], p=[0.8, 0.1, 0.1]))
    amplitude, speed = rng.uniform(1.2, 2.8), rng.uniform(4.0, 12.0)
    w, zeta = rng.uniform(12.0, 22.0), rng.uniform(0.3, 0.7)
    felt = inertia * speed * 4 + 0.5 * gravity  # typical torque
    shown = rng.random() < 0.5
    smooth = 0.0 if shown else float(rng.choice([0.002, 0.005]))
    kd = 2 * zeta * inertia * w
    # a count of the encoder must not shake the motor by more than a tenth of the typical torque
    kd = min(kd, 0.1 * felt * (smooth + dt) / (2 * np.pi / 2**bits))
    known = float(dt) if rng.random() < 0.3 else 0.0
    joint = {
        "coulomb_pos": felt * rng.uniform(0.08, 0.15),
        "viscous_pos": felt / speed * rng.uniform(0.05, 0.15),
        "delay": known,
        "limit": round(8 * felt, 2),
        **_sensor(rng, bits),
    }
    joint.update(coulomb_neg=joint["coulomb_pos"], viscous_neg=joint["viscous_pos"])
    train, held = shapes(rng)
    return Draft(
        "rotary",
        "rotary",
        {"inertia": inertia, "gravity": gravity},
        [joint],
        [{"viscous", "coulomb"}],
        dt,
        20.0,
        [amplitude],
        [speed],
        [inertia * w**2],
        [kd],
        velocity_filter=smooth,
        known_delay=known,
        show_controller=shown,
        feedforward=not shown and rng.random() < 0.5,
        noise=float(rng.choice([0.0, 0.3, 1.0])),
        train_shape=train,
        heldout_shape=held,
    )


def linear(rng: Rng) -> Draft:
    """A ball-screw axis in the manner of EMPS: voltage command, force = 35.15 N/V, PD of high gain.
    """
    mass = 95.11 * rng.uniform(0.6, 1.4)
    gain = 35.15 * rng.uniform(0.8, 1.2)
    speed = rng.uniform(0.15, 0.5)
    w, zeta = rng.uniform(60.0, 120.0), rng.uniform(0.4, 0.7)
    viscous, coulomb = rng.uniform(150, 300), rng.uniform(12, 30)
    joint = {
        "viscous_pos": viscous,
        "viscous_neg": viscous,
        "coulomb_pos": coulomb,
        "coulomb_neg": coulomb,
        "gain": gain,
        "limit": 10.0,
        "resolution": float(rng.choice([1e-6, 5e-7, 2e-7])),
    }
    train, held = shapes(rng)
    return Draft(
        "linear",
        "linear",
        {"mass": mass},
        [joint],
        [{"viscous", "coulomb"}],
        1e-3,
        20.0,
        [rng.uniform(0.08, 0.2)],
        [speed],
        [mass * w**2 / gain],
        [2 * zeta * mass * w / gain],
        velocity_filter=0.001,
        noise=float(rng.choice([0.0, 1.0])),
        train_shape=train,
        heldout_shape=held,
    )


def pendulum(rng: Rng) -> Draft:
    """The bar on a brushed motor of facts/pendulum.toml: open loop, or PD with kp = 1.2, kv =
    0.005.
    """
    inertia = 0.2 * 0.17**2 / 3 * rng.uniform(1.0, 1.25)
    gravity = 0.2 * 9.81 * 0.085 * rng.uniform(0.95, 1.05)
    coulomb, viscous = rng.uniform(0.005, 0.02), rng.uniform(2e-4, 8e-4)
    joint = {
        "coulomb_pos": coulomb, "coulomb_neg": coulomb, "viscous_pos": viscous,
        "viscous_neg": viscous, "limit": 0.8, **_sensor(rng, 12),
    }
    open_loop = bool(rng.random() < 0.5)
    return Draft(
        "pendulum",
        "rotary",
        {"inertia": inertia, "gravity": gravity},
        [joint],
        [{"viscous", "coulomb"}],
        1e-3,
        20.0,
        [rng.uniform(1.0, 2.2)],
        [rng.uniform(4.0, 9.0)],
        [1.2],
        [0.005],
        velocity_filter=0.0,
        show_controller=not open_loop and rng.random() < 0.5,
        open_loop=open_loop,
        train_shape="open" if open_loop else "multisine",
        heldout_shape="open" if open_loop else "sines",
    )


def planar2r(rng: Rng) -> Draft:
    """The IMI arm of facts/imi_planar.toml: PD with feedforward, one sample of known delay."""
    p1, p2, p3 = 3.473, 0.196, 0.242
    w, zeta = rng.uniform(10.0, 16.0), 0.7
    joints = []
    for viscous, coulomb, limit in ((5.3, 8.45, 245.0), (1.1, 2.35, 39.2)):
        b, c = viscous * rng.uniform(0.7, 1.3), coulomb * rng.uniform(0.7, 1.3)
        joints.append(
            {
                "viscous_pos": b,
                "viscous_neg": b,
                "coulomb_pos": c,
                "coulomb_neg": c,
                "limit": limit,
                "delay": 1e-3,
                "resolution": 2 * np.pi / 102400,
            }
        )
    train, held = shapes(rng)
    return Draft(
        "planar2r",
        "planar2r",
        {"p1": p1, "p2": p2, "p3": p3},
        joints,
        [{"viscous", "coulomb"}, {"viscous", "coulomb"}],
        1e-3,
        20.0,
        [rng.uniform(1.0, 2.0), rng.uniform(1.0, 2.0)],
        [rng.uniform(3.0, 6.0), rng.uniform(3.0, 6.0)],
        [p1 * w**2, 1.5 * p2 * w**2],
        [2 * zeta * p1 * w, 3 * zeta * p2 * w],
        velocity_filter=0.003,
        known_delay=1e-3,
        train_shape=train,
        heldout_shape=held,
    )


MACHINES: dict[str, Callable[[Rng], Draft]] = {
    "rotary": rotary, "linear": linear, "pendulum": pendulum, "planar2r": planar2r, "urdf": wam,
}
