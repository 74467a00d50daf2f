"""The supply limits the torque, the more the faster the motor turns.

The limit is (U − k_e q̇) / R times the torque constant.
"""

from __future__ import annotations

from collections.abc import Sequence

from zendsp.physics.effects.base import Effect, Facts, Parameter


def _levels(facts: Facts) -> Sequence[float]:
    return [share * facts.gain * facts.strong for share in (0.7, 0.9, 1.1, 1.5, 2.2, 3.5)]


def _slopes(facts: Facts) -> Sequence[float]:
    return [
        share * facts.gain * facts.strong / facts.fastest
        for share in (0.3, 0.6, 1.0, 1.6, 2.5, 4.0)
    ]


EFFECT = Effect(
    name="voltage_limit",
    site="drive",
    mechanism="actuator",
    parameters=(
        Parameter("level", "torque", lower=1e-9, meaning="at standstill, U k / R"),
        Parameter("slope", "torque/speed", lower=0, meaning="what the back-EMF takes, k k_e / R"),
    ),
    c=(
        "double up = p[0] - p[1] * s->qd, down = -p[0] - p[1] * s->qd; "
        "return tau > up ? up : tau < down ? down : tau;"
    ),
    sentence=(
        "The supply of joint {joint} limits its torque to {level} at standstill, less {slope} "
        "with speed."
    ),
    experiment="Accelerations at full command up to the highest speed, both ways.",
    equation="clip(τ, ±level − slope q̇)",
    grid={"level": _levels, "slope": _slopes},
    essence=("slope",),
    loosens_inertia=True,
    rivals=("saturation", "viscous"),
    shown_by=("current",),
    why_not="no command passes the limit: plan below it",
)
