"""The control program of the story, made from the model and from the library of effects, and the
update that switches effects on.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

import numpy as np

from zendsp.diagnosis import Finding
from zendsp.physics.calibration.joint import own_terms
from zendsp.physics.codegen.compensation import compensation
from zendsp.physics.codegen.model_code import model_code
from zendsp.physics.codegen.model_torque import inverse_dynamics
from zendsp.physics.codegen.terms import compensable, why_not
from zendsp.physics.effects import library
from zendsp.physics.model import TREES, Model, Quantity, Term
from zendsp.physics.robots.bodies import body_terms
from zendsp.physics.simulation.plant import tree_of, with_bodies
from zendsp.physics.term_numbers import kernel_model
from zendsp.reference import Reference

BEARS = 0.2  # of the largest error that a body makes
# Numbers that give an effect its shape, not its size: 1 is harmless for all of them, while 0 would
# divide by zero.
SHAPES = ("speed", "position", "order", "number", "time")
SIZES = ("level", "level_pos", "level_neg", "coefficient", "coefficient_pos", "coefficient_neg")
# a whole friction law in place of another, not an effect of the contract
BLOCKS = ("friction_block",)


def slots(joints: int) -> tuple[Term, ...]:
    """Every effect that a torque can cancel, on every joint, with size zero; couplings only where
    there are two joints (between more, the mechanism makes them).

    Examples
    --------
    >>> [t.effect for t in slots(1)][:2]
    ['coulomb', 'coulomb_asymmetry']
    """
    made: list[Term] = []
    for joint in range(1, joints + 1):
        for effect in library().values():
            zero = {p.name: Quantity(1.0 if p.size in SHAPES else 0.0) for p in effect.parameters}
            if effect.coupled:
                others = [other for other in (1, 2) if joints == 2 and other != joint]
                made += [
                    Term(
                        effect.name,
                        joint,
                        {**zero, "from_joint": Quantity(float(other)), "law": Quantity(float(law))},
                    )
                    for other in others
                    for law in range(len(effect.across))
                ]
            elif effect.name not in BLOCKS and compensable(Term(effect.name, joint, zero)):
                made.append(Term(effect.name, joint, zero))
    return tuple(made)


def sources(model: Model) -> dict[str, str]:
    """track.c with what it includes, for :meth:`zendsp.link.Target.compile`.

    Parameters
    ----------
    model : Model
        Whose torque is fed forward.

    Returns
    -------
    dict of file name to text
    """
    track = (
        resources.files("zendsp.demo").joinpath("programs", "track.c").read_text(encoding="utf-8")
    )
    motion = (
        resources.files("zendsp_isr").joinpath("programs", "motion.h").read_text(encoding="utf-8")
    )
    room = compensation(
        slots(model.joints), title=f"{model.name}, all sizes zero until something is found"
    )
    return {
        "track.c": track, "motion.h": motion, "model.h": model_code(model), "compensation.h": room,
    }


def flags(joints: int) -> tuple[str, ...]:
    """Flags of the compiler for a machine of so many joints."""
    return (f"-DN={joints}",)


@dataclass(frozen=True)
class Update:
    """The values that one synchronous update writes, and the terms that no torque can cancel."""

    values: Mapping[str, float | list[float]]
    left_out: tuple[Term, ...]
    # whose torque is compensated by terms that the given model had not (1-based)
    joints: tuple[int, ...]


def plan_update(given: Model, improved: Model, variables: Collection[str]) -> Update:
    """The values of the program's parameters that turn the given model into the improved one.

    Terms of both models, and the rigid body with what it carries, get the fitted numbers; terms
    that the fit replaced get size zero; each finding goes into its place of the compensation.

    Parameters
    ----------
    given, improved : Model
        In file form.
    variables : collection of str
        Names that the running program declares.
    """
    values: dict[str, float | list[float]] = {}
    left_out: list[Term] = []
    joints: set[int] = set()
    improved = with_bodies(improved)
    if given.kind in TREES:
        values |= _bodies(improved)
    had = _labelled(given.terms, "model")
    room = _labelled(slots(given.joints), "comp")
    for label in had:
        values |= {f"{label}_{name}": 0.0 for name in SIZES if f"{label}_{name}" in variables}
    for label, term in _labelled(own_terms(kernel_model(improved).terms), "model").items():
        place = label if label in had else _slot(room, term)
        if place is None:
            left_out.append(term)
            continue
        if room.pop(place, None) is not None:
            joints.add(term.joint)
        wanted = {f"{place}_{name}": quantity.value for name, quantity in term.parameters.items()}
        values |= {name: value for name, value in wanted.items() if name in variables}
    for key, items in improved.mechanism.items():
        for j, quantity in enumerate(items, start=1):
            for name in (f"model_{key}", f"model_{key}{j}"):
                if name in variables:
                    values[name] = quantity.value
    return Update(values, tuple(left_out), tuple(sorted(joints)))


def not_cancelled(update: Update, findings: Collection[Finding]) -> tuple[str, ...]:
    """A sentence for each finding that the update leaves out. What only refines the model, as the
    shift of a column by a part of a row does, is no finding.
    """
    named = {(f.effect, f.joint) for f in findings}
    return tuple(
        f"{t.effect.replace('_', ' ')} of joint {t.joint}: {why_not(t.effect)}"
        for t in update.left_out
        if (t.effect, t.joint) in named
    )


def bearing(
    given: Model, improved: Model, motion: Reference, stiffness: Sequence[float]
) -> tuple[int, ...]:
    """Joints (1-based) whose tracking error is caused by a body that was found: those where its
    torque over the feedback gain is at least a fifth of the largest.

    Parameters
    ----------
    given, improved : Model
    motion : Reference
        That the joints follow.
    stiffness : sequence of float
        Gain of each joint's position, N m/rad.

    Returns
    -------
    tuple of int
        Empty where both have the same bodies.
    """
    if not body_terms(improved):
        return ()
    rows = slice(None, None, 10)
    q, qd, qdd = motion.q[rows], motion.qd[rows], motion.qdd[rows]
    carried = with_bodies(improved.with_terms(body_terms(improved)))
    bare = given.with_terms(body_terms(given))
    torque = inverse_dynamics(carried, q, qd, qdd) - inverse_dynamics(bare, q, qd, qdd)
    error = np.sqrt(np.mean(torque**2, axis=0)) / np.asarray(stiffness)
    return tuple((np.flatnonzero(error >= BEARS * error.max()) + 1).tolist())


def _bodies(model: Model) -> dict[str, float | list[float]]:
    """The links with what they carry, by the names that the generated C gives their numbers."""
    rows, gravity = tree_of(model)
    return {
        "model_mass": rows[:, 17].tolist(),
        "model_com": rows[:, 18:21].ravel().tolist(),
        "model_inertia": rows[:, 21:27].ravel().tolist(),
        "model_rotor": rows[:, 27].tolist(),
        "model_g": gravity.tolist(),
    }


def _labelled(terms: Sequence[Term], prefix: str) -> dict[str, Term]:
    """Terms by the names that the generated C gives them."""
    out: dict[str, Term] = {}
    for term in terms:
        label, count = f"{prefix}_{term.effect}{term.joint}", 2
        while label in out:
            label, count = f"{prefix}_{term.effect}{term.joint}_{count}", count + 1
        out[label] = term
    return out


def _slot(room: Mapping[str, Term], term: Term) -> str | None:
    """The place in the compensation for a term of this effect, joint and structure."""
    for label, slot in room.items():
        same = slot.effect == term.effect and slot.joint == term.joint
        if same and all(slot.value(n) == term.value(n) for n in ("from_joint", "law")):
            return label
    return None
