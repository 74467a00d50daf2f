"""Mechanisms of a machine and the laws that write them down (the contract's table)."""

from __future__ import annotations

LAWS_OF: dict[str, tuple[str, ...]] = {
    "dry_friction": (
        "coulomb", "coulomb_asymmetry", "stribeck", "presliding", "hysteresis", "load_friction",
        "position_friction", "friction_drift", "friction_temperature",
    ),
    "fluid_friction": ("viscous", "viscous_asymmetry", "quadratic_drag"),
    "transmission": ("elasticity", "stiffening", "backlash", "transmission_error"),
    "position_torque": ("gravity", "stiffness", "cubic_stiffness", "ripple"),
    "inertia": ("inertia", "payload", "body", "base_tilt", "coupling"),
    "actuator": (
        "torque_gain", "gain_drift", "torque_offset", "dead_zone", "saturation", "voltage_limit", "lag", "delay",
    ),
    "measurement": ("encoder_eccentricity", "sensor_harmonic", "position_filter", "column_shift"),
    "disturbance": ("disturbance",),
}  # fmt: skip


def mechanism_of(effect: str) -> str:
    """Mechanism that an effect is a law of; an effect of a user's own is one by itself."""
    return next((m for m, laws in LAWS_OF.items() if effect in laws), effect)
