"""The ways in which physics is concealed: each kind of case prepares a draft and then hides
something in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from zendsp.proof.draft import Draft, Scale, Term
from zendsp.proof.effect_kit import set_friction, share
from zendsp.proof.effects import EFFECTS
from zendsp.proof.foreign import add_foreign

Rng = np.random.Generator
# reference shapes in which an effect shows itself; the others draw from the machine's own choice


class _Hide(Protocol):

    def __call__(
        self, d: Draft, effect: str, size: float, scales: list[Scale], rng: Rng
    ) -> None: ...


class _Prepare(Protocol):
    def __call__(self, d: Draft, effect: str, rng: Rng) -> None: ...


@dataclass(frozen=True)
class Kind:
    """How a kind of case is made."""

    prepare: _Prepare
    conceal: _Hide


def no_preparation(d: Draft, effect: str, rng: Rng) -> None:
    """Take the machine as it was drawn, with what the effect needs of it."""
    if effect == "encoder_eccentricity" and not d.open_loop:  # once per turn needs most of a turn
        d.amplitude = [max(a, float(rng.uniform(2.5, 4.0))) for a in d.amplitude]
    if effect == "gravity" and d.machine == "rotary" and rng.random() < 0.7:
        d.parameters["gravity"] = 0.0
    if effect == "torque_gain" and d.machine == "rotary" and d.parameters["gravity"] == 0.0:
        d.parameters["gravity"] = 0.3 * d.parameters["inertia"] / 0.01


def _pick_joint(d: Draft, rng: Rng) -> int:
    return int(rng.integers(d.n))


def _hide_single(d: Draft, effect: str, size: float, scales: list[Scale], rng: Rng) -> None:
    joint = 0 if effect in ("elasticity", "backlash") and d.n > 1 else _pick_joint(d, rng)
    d.concealed.append(EFFECTS[effect](d, joint, scales[joint], size, rng))


PAIRS = (
    ("coulomb", "quadratic_drag"),
    ("coulomb", "torque_offset"),
    ("stribeck", "ripple"),
    ("stiffness", "coulomb"),
    ("ripple", "quadratic_drag"),
    ("coulomb", "delay"),
    ("viscous_asymmetry", "ripple"),
    ("torque_offset", "quadratic_drag"),
    ("cubic_stiffness", "ripple"),
    ("dead_zone", "ripple"),
    ("backlash", "quadratic_drag"),
    ("presliding", "stiffness"),
    ("position_friction", "torque_offset"),
    ("coulomb", "ripple"),
    ("lag", "quadratic_drag"),
    ("friction_drift", "ripple"),
    ("load_friction", "torque_offset"),
    ("encoder_eccentricity", "coulomb"),
)


def _prepare_pair(d: Draft, effect: str, rng: Rng) -> None:
    for name in effect.split("+"):
        no_preparation(d, name, rng)


def hide_pair(d: Draft, effect: str, size: float, scales: list[Scale], rng: Rng) -> None:
    """Two effects on one joint, or on two joints where there are two."""
    first, second = effect.split("+")
    joint = _pick_joint(d, rng)
    other = _pick_joint(d, rng)
    d.concealed.append(EFFECTS[first](d, joint, scales[joint], size, rng))
    kept = set(d.terms[other])
    d.concealed.append(
        EFFECTS[second](d, other, scales[other], size * 0.7 if size == 1.0 else size, rng)
    )
    d.terms[other] &= kept


def prepare_complete(d: Draft, effect: str, rng: Rng) -> None:
    """Only the logger has a fault, which the request names."""
    if effect not in ("", "plain"):
        d.faults.append(effect)
    if effect == "filtered":
        d.also_true.add("position_filter")


def hide_nothing(d: Draft, effect: str, size: float, scales: list[Scale], rng: Rng) -> None:
    """Complete: only figures are wrong."""


def prepare_slow(d: Draft, effect: str, rng: Rng) -> None:
    """Creeping motion, a coarse encoder, stick and slip."""
    d.train_shape = d.heldout_shape = "slow"


def prepare_nuisance(d: Draft, effect: str, rng: Rng) -> None:
    """Slow random torque of 0.1 to 0.6 % of the torque's RMS, which is nobody's physics."""
    d.nuisance = float(np.exp(rng.uniform(np.log(0.001), np.log(0.006))))
    no_preparation(d, effect, rng)


def prepare_hard(d: Draft, effect: str, rng: Rng) -> None:
    """A poorer laboratory: short or long runs, slow sampling, a coarse noisy sensor, nuisances,
    fewer recordings.
    """
    no_preparation(d, effect, rng)
    d.nuisance = float(np.exp(rng.uniform(np.log(0.001), np.log(0.004))))
    d.seconds = float(rng.choice([8.0, 12.0, 30.0]))
    d.layout = str(rng.choice(["heldout", "none", "joint"]))
    if d.kind != "rotary" or d.open_loop:
        return
    d.sample_time = float(rng.choice([1e-3, 2e-3, 4e-3]))
    if d.known_delay > 0:
        d.known_delay = d.joints[0]["delay"] = d.sample_time
    bits = int(rng.choice([11, 12, 13]))
    d.joints[0]["resolution"] = 2 * np.pi / 2**bits
    d.noise = float(rng.choice([0.0, 0.5, 1.0]))
    d.show_controller, d.velocity_filter = False, 0.006
    # half a count must not shake the motor by more than a twentieth of its limit
    d.kd = [
        min(k, 0.05 * j["limit"] * 0.006 / j["resolution"])
        for k, j in zip(d.kd, d.joints, strict=True)
    ]


def _hide_foreign(d: Draft, effect: str, size: float, scales: list[Scale], rng: Rng) -> None:
    joint = _pick_joint(d, rng)
    d.concealed.append(add_foreign(d, effect, joint, scales[joint], size, rng))


def hide_behind(d: Draft, effect: str, size: float, scales: list[Scale], rng: Rng) -> None:
    """The effect stands behind a larger one that the given model has."""
    joint = _pick_joint(d, rng)
    s = scales[joint]
    # a big one that is not of the concealed one's own family
    choice = (
        "quadratic_drag"
        if effect in ("stiffness", "cubic_stiffness", "gravity", "ripple")
        else "stiffness"
    )
    if choice == "stiffness":
        k = 3 * share(s, 1.0, rng) / float(np.sqrt(np.mean(s.q**2)))
        d.joints[joint].update(stiffness=k, neutral=0.0)
        d.known.append(Term("stiffness", joint + 1, {"coefficient": k, "neutral": 0.0}))
    else:
        c = 2.5 * share(s, 1.0, rng) / float(np.sqrt(np.mean(s.v**4)))
        d.joints[joint]["drag"] = c
        d.known.append(Term("quadratic_drag", joint + 1, {"coefficient": c}))
    d.concealed.append(EFFECTS[effect](d, joint, s, size, rng))


def prepare_part(d: Draft, effect: str, rng: Rng) -> None:
    """Fast motion nearly all the time; what is concealed acts at low speed."""
    no_preparation(d, effect, rng)
    d.train_shape = d.heldout_shape = "mostly_fast"


REPLACEMENTS = (
    "viscous_for_coulomb", "viscous_for_coulomb_drag", "coulomb_for_viscous", "drag_for_viscous",
)


def hide_replacement(d: Draft, effect: str, size: float, scales: list[Scale], rng: Rng) -> None:
    """The given model has friction by the wrong law."""
    joint = _pick_joint(d, rng)
    s = scales[joint]
    if effect == "viscous_for_coulomb":
        set_friction(d, joint, coulomb=0.0, viscous=0.0)
        d.concealed.append(EFFECTS["coulomb"](d, joint, s, size, rng))
        d.terms[joint], d.replaces = {"viscous"}, ["viscous"]
    elif effect == "viscous_for_coulomb_drag":
        set_friction(d, joint, coulomb=0.0, viscous=0.0)
        d.concealed.append(EFFECTS["coulomb"](d, joint, s, size, rng))
        d.concealed.append(EFFECTS["quadratic_drag"](d, joint, s, size, rng))
        d.terms[joint], d.replaces = {"viscous"}, ["viscous"]
    elif effect == "coulomb_for_viscous":
        set_friction(d, joint, coulomb=0.0, viscous=0.0)
        d.concealed.append(EFFECTS["viscous"](d, joint, s, size, rng))
        d.terms[joint], d.replaces = {"coulomb"}, ["coulomb"]
    else:
        set_friction(d, joint, coulomb=0.0, viscous=0.0)
        d.concealed.append(EFFECTS["viscous"](d, joint, s, size, rng))
        d.terms[joint], d.replaces = {"quadratic_drag"}, ["quadratic_drag"]


KINDS: dict[str, Kind] = {
    "single": Kind(no_preparation, _hide_single),
    "pair": Kind(_prepare_pair, hide_pair),
    "behind": Kind(no_preparation, hide_behind),
    "part": Kind(prepare_part, _hide_single),
    "replace": Kind(no_preparation, hide_replacement),
    "complete": Kind(prepare_complete, hide_nothing),
    "complete_slow": Kind(prepare_slow, hide_nothing),
    "nuisance": Kind(prepare_nuisance, hide_nothing),
    "nuisance_single": Kind(prepare_nuisance, _hide_single),
    "foreign": Kind(no_preparation, _hide_foreign),
    "hard": Kind(prepare_hard, _hide_single),
    "hard_complete": Kind(prepare_hard, hide_nothing),
}
