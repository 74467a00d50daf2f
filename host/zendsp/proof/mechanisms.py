"""The contract's table of mechanisms and their laws, written down for the judge apart from the
diagnosis.
"""

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
        "torque_gain", "gain_drift", "torque_offset", "dead_zone", "saturation", "voltage_limit",
        "lag", "delay",
    ),
    "measurement": ("encoder_eccentricity", "sensor_harmonic", "position_filter", "column_shift"),
    "disturbance": ("disturbance",),
}
MECHANISM = {law: mechanism for mechanism, laws in LAWS.items() for law in laws}
# findings about the robot as a whole: a body is named, and any joint that it loads may be
BODILY = ("payload", "body", "base_tilt")
# laws that contain a simpler one as a special case: the truth with needless parameters, and no
# other name for it
NEEDLESS: dict[str, tuple[str, ...]] = {
    "viscous": ("viscous_asymmetry", "friction_drift"),
    "coulomb": (
        "coulomb_asymmetry", "friction_drift", "position_friction", "presliding", "stribeck",
    ),
    "stiffness": ("cubic_stiffness",),
    "torque_offset": ("stiffness", "cubic_stiffness"),
    "coulomb_asymmetry": ("stiffness", "cubic_stiffness"),
}
# the parameter that is an effect's size, where it grows with the torque that the effect makes
SIZE: dict[str, str] = {
    "coulomb": "level",
    "viscous": "coefficient",
    "quadratic_drag": "coefficient",
    "load_friction": "coefficient",
    "position_friction": "amplitude",
    "gravity": "torque",
    "stiffness": "coefficient",
    "cubic_stiffness": "coefficient",
    "ripple": "amplitude",
    "inertia": "amount",
    "payload": "mass",
    "torque_gain": "ratio",
    "torque_offset": "level",
    "dead_zone": "width",
    "lag": "time_constant",
    "delay": "time",
    "encoder_eccentricity": "amplitude",
    "sensor_harmonic": "amplitude",
    "position_filter": "time_constant",
    "column_shift": "time",
    "backlash": "gap",
}


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
