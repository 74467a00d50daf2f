"""What a simulated machine conceals: sealed by hash, told only after a reveal.

The host never sees this module's data before it asks with the verb ``reveal``; the verb ``seal``
gives the SHA-256 of the record beforehand, so that everyone can check afterwards that the truth was
not chosen to fit the answer.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from zendsp_protocol.errors import Refused, did_you_mean

# Parameters of each effect in the order of concealed_spec.h, with the units of the truth that is
# told. "N m" stands for the command's unit where the command is a voltage.
EFFECTS: dict[str, dict[str, str]] = {
    "viscous": {"coefficient": "N m s/rad"},
    "viscous_asymmetry": {"coefficient_pos": "N m s/rad", "coefficient_neg": "N m s/rad"},
    "coulomb": {"level": "N m"},
    "coulomb_asymmetry": {"level_pos": "N m", "level_neg": "N m"},
    "stribeck": {"breakaway": "N m", "velocity": "rad/s"},
    "presliding": {"stiffness": "N m/rad"},
    "quadratic_drag": {"coefficient": "N m s^2/rad^2"},
    "load_friction": {"coefficient": ""},
    "position_friction": {"amplitude": "N m", "period": "rad", "phase": "rad"},
    "friction_drift": {"ratio": "", "time_constant": "s"},
    "gravity": {"torque": "N m", "angle": "rad"},
    "stiffness": {"coefficient": "N m/rad", "neutral": "rad"},
    "cubic_stiffness": {"coefficient": "N m/rad^3", "neutral": "rad"},
    "inertia": {"amount": "kg m^2"},
    "coupling": {"from_joint": "", "law": "", "coefficient": "N m"},
    "elasticity": {"stiffness": "N m/rad", "damping": "N m s/rad", "load_inertia": "kg m^2"},
    "backlash": {"gap": "rad", "stiffness": "N m/rad", "load_inertia": "kg m^2"},
    "hysteresis": {"force": "N m", "stiffness": "N m/rad", "exponent": ""},
    "ripple": {"order": "1/rad", "amplitude": "N m", "phase": "rad"},
    "torque_gain": {"ratio": ""},
    "torque_offset": {"level": "N m"},
    "dead_zone": {"width": "N m"},
    "saturation": {"level": "N m"},
    "lag": {"time_constant": "s"},
    "delay": {"time": "s"},
    "encoder_eccentricity": {"amplitude": "rad", "phase": "rad"},
    "disturbance": {"level": "N m", "begin": "s", "duration": "s"},
    "foreign": {"law": "", "amplitude": "N m"},
    "payload": {"mass": "kg", "x": "m", "y": "m", "z": "m"},
}
LAWS = ("inertia", "coriolis", "viscous", "coulomb")  # of coupling, by number
MOST = 16  # effects that a machine can carry


@dataclass(frozen=True)
class ConcealedEffect:
    """One effect: its name in the contract, its joint (1-based), its parameters in SI units."""

    effect: str
    joint: int
    parameters: Mapping[str, float]

    def __post_init__(self) -> None:
        if self.effect not in EFFECTS:
            raise Refused(
                f"concealed: no effect {self.effect!r}; {did_you_mean(self.effect, EFFECTS)}"
            )
        wanted, given = set(EFFECTS[self.effect]), set(self.parameters)
        if wanted != given:
            raise Refused(
                f"concealed: {self.effect} takes {', '.join(EFFECTS[self.effect])}; missing:"
                f" {', '.join(sorted(wanted - given)) or 'none'}, unknown:"
                f" {', '.join(sorted(given - wanted)) or 'none'}"
            )

    def line(self) -> str:
        """The effect as one line of the machine's configuration."""
        return " ".join(
            [
                self.effect,
                f"joint={self.joint}",
                *(f"{k}={v!r}" for k, v in self.parameters.items()),
            ]
        )

    def told(self) -> dict[str, Any]:
        """The effect as the reveal tells it: parameters with units, in the form of a report's
        finding.
        """
        units = EFFECTS[self.effect]
        parameters: dict[str, Any] = {
            k: {"value": v, "unit": units[k]} for k, v in self.parameters.items()
        }
        if self.effect == "coupling":
            parameters["law"] = {"value": LAWS[int(self.parameters["law"])], "unit": ""}
        return {"effect": self.effect, "joint": self.joint, "parameters": parameters}


@dataclass(frozen=True)
class Concealed:
    """All that one machine conceals, and the seal on it.

    Parameters
    ----------
    machine : str
        Name of the machine.
    effects : tuple of ConcealedEffect
        May be empty: a complete machine is a case as well.
    source : str
        Where it came from: "seed:17" or the name of a file.
    friction : str
        "full": the machine's own friction with breakaway, bristles and asymmetry; "plain": viscous
        and Coulomb only.
    nonce : str
        Random: without it the hash could be found by trying all effects.

    Examples
    --------
    >>> hidden = Concealed("imi_planar", (ConcealedEffect("coulomb", 1, {"level": 2.0}),), "example")
    >>> hidden.config()
    {'friction': 'full', 'effect1': 'coulomb joint=1 level=2.0'}
    >>> hidden.seal() == hashlib.sha256(hidden.record_text().encode()).hexdigest()
    True
    """  # noqa: E501

    machine: str
    effects: tuple[ConcealedEffect, ...]
    source: str
    friction: str = "full"
    nonce: str = field(default_factory=lambda: secrets.token_hex(16))

    def __post_init__(self) -> None:
        if len(self.effects) > MOST:
            raise Refused(
                f"concealed: {len(self.effects)} effects; a machine carries at most {MOST}"
            )
        if self.friction not in ("full", "plain"):
            raise Refused(f"concealed: friction is {self.friction!r}; expected 'full' or 'plain'")

    def config(self) -> dict[str, str]:
        """Settings for the machine; they stay in the target's process."""
        lines = {f"effect{i}": effect.line() for i, effect in enumerate(self.effects, start=1)}
        return {"friction": self.friction, **lines}

    def record_text(self) -> str:
        """The record that is sealed, as canonical JSON: sorted keys, no spaces."""
        record = {
            "machine": self.machine,
            "source": self.source,
            "friction": self.friction,
            "nonce": self.nonce,
            "effects": [effect.told() for effect in self.effects],
        }
        return json.dumps(record, sort_keys=True, separators=(",", ":"))

    def seal(self) -> str:
        """SHA-256 of the record, hexadecimal. It may be told at any time, since the effects cannot
        be found from it.
        """
        return hashlib.sha256(self.record_text().encode()).hexdigest()
