"""The contract's table of mechanisms and their laws, written down for the judge apart from the diagnosis."""

from __future__ import annotations

LAWS: dict[str, tuple[str, ...]] = {
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
MECHANISM = {law: mechanism for mechanism, laws in LAWS.items() for law in laws}
# findings about the robot as a whole: a body is named, and any joint that it loads may be
BODILY = ("payload", "body", "base_tilt")


def mechanism_of(effect: str, stated: str = "") -> str:
    """The mechanism of a finding: as it says itself, else by the name of its law.

    Parameters
    ----------
    effect : str
        Name of the law; "unknown" has no mechanism but the stated one.
    stated : str
        Key ``mechanism`` of the report.

    Returns
    -------
    str
        Empty where neither tells.

    Examples
    --------
    >>> mechanism_of("coulomb")
    'dry_friction'
    """
    return stated or MECHANISM.get(effect, "")
