"""How large an implant is: its numbers, from the motion that it is put into."""

from __future__ import annotations

import math

import numpy as np

from zendsp.proof.draft import Array
from zendsp.proof.implant_wishes import Wish
from zendsp.proof.implanted import Columns, Motion
from zendsp.proof.mechanisms import SIZE

FRESH = 1e-3  # of the RMS torque: size at which a law is tried before it is scaled


def shape_of(effect: str, m: Motion, model: Columns, joint: int) -> dict[str, float]:
    """The parameters beside the leading one, from the motion of the training recording; none of
    them lies at a special point of the travel.
    """
    middle, travel = float(np.mean(m.q)), float(np.ptp(m.q))
    top, seconds = float(np.abs(m.v).max()), float(m.t[-1])
    waves = 5.0 if model.model["mechanism"]["kind"] != "linear" else 2 * math.pi / (0.064 * travel)

    def friction(*kinds: str) -> float:
        """The mean of the numbers of a friction, those of both directions."""
        terms = (e for e in model.model["effect"] if e["joint"] == joint and e["kind"] in kinds)
        values = [q["value"] for e in terms for q in e.values() if isinstance(q, dict)]
        return float(np.mean(values)) if values else 0.0

    return {
        # the breakaway that is found contains the friction upon which the curve stands
        "stribeck": {"velocity": 0.07 * top, "upon": friction("coulomb", "coulomb_asymmetry")},
        "position_friction": {"period": 0.29 * travel, "phase": 0.4},
        "friction_drift": {
            "time_constant": 0.3 * seconds,
            "dry": friction("coulomb", "coulomb_asymmetry"),
            "fluid": friction("viscous", "viscous_asymmetry"),
        },
        "gain_drift": {"time_constant": 0.3 * seconds},
        "gravity": {"angle": 0.8},
        "stiffness": {"neutral": middle},
        "cubic_stiffness": {"neutral": middle},
        "ripple": {"order": waves, "phase": 0.7},
        "encoder_eccentricity": {"phase": 0.7},
        "disturbance": {"middle": 0.41 * seconds, "length": 1.0},
    }.get(effect, {})


LEADING = {**SIZE, "stribeck": "breakaway", "friction_drift": "ratio", "gain_drift": "ratio",
           "hysteresis": "force", "disturbance": "peak"}  # fmt: skip


def sized(effect: str, size: float, shape: dict[str, float], m: Motion) -> dict[str, float]:
    """The parameters of a law with its leading number."""
    p = {LEADING[effect]: size, **shape}
    if effect == "delay":
        dt = float(np.median(np.diff(m.t)))
        p["rows"] = max(1.0, round(size / dt))
        p["time"] = p["rows"] * dt
    if effect == "hysteresis":
        p["stiffness"] = 15.0 * size / float(np.ptp(m.q))
    return p


def change(effect: str, p: dict[str, float], columns: Columns, joint: int) -> Array:
    """The change of the joint's torque by a law, row by row."""
    table = columns.with_law(effect, joint, p)
    after = Columns(table, columns.model).torques
    before = columns.torques[: len(after)]
    out: Array = (after - before).reshape(len(after), -1)[:, joint - 1]
    return out


def share_of(effect: str, p: dict[str, float], columns: Columns, joint: int) -> float:
    """RMS of a law's torque as a part of the RMS torque that moves the joint."""
    scale = float(np.sqrt(np.mean(columns.motion(joint).torque ** 2)))
    return float(np.sqrt(np.mean(change(effect, p, columns, joint) ** 2))) / scale


def size_of(wish: Wish, stated: float | None, train: Columns) -> tuple[float, float]:
    """The multiple of the stated size, nan where there is none, and the leading number."""
    if stated is not None:
        return wish.times, wish.times * stated
    m = train.motion(wish.joint)
    shape = shape_of(wish.effect, m, train, wish.joint)
    small = FRESH * float(np.sqrt(np.mean(m.torque**2)))
    if wish.effect in ("friction_drift", "gain_drift", "load_friction"):
        small = FRESH
    unit = share_of(wish.effect, sized(wish.effect, small, shape, m), train, wish.joint)
    return math.nan, small * wish.share / max(unit, 1e-300)
