"""The numbers of a model's terms: as a file and as the kernel has them, which are chosen and not
estimated, and sums over the terms of a joint.
"""

from __future__ import annotations

from dataclasses import replace

from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, Term


def file_model(model: Model) -> Model:
    """The model as files give it: a Stribeck term with its breakaway level, not the excess over
    Coulomb.
    """
    return _shifted(model, +1.0)


def kernel_model(model: Model) -> Model:
    """The model as the effects' C functions take it (the inverse of ``file_model``)."""
    return _shifted(model, -1.0)


def _shifted(model: Model, sign: float) -> Model:
    """Parameters that a file states ``above`` another effect's size, by that size."""
    terms = []
    for term in model.terms:
        for p in get_effect(term.effect).parameters:
            if p.above:
                old = term.parameters[p.name]
                value = old.value + sign * summed(model, term.joint, p.above)
                values = {**term.parameters, p.name: replace(old, value=value)}
                term = Term(term.effect, term.joint, values)
        terms.append(term)
    return model.with_terms(tuple(terms))


def summed(model: Model, joint: int, effect: str) -> float:
    """Size of all terms of an effect at a joint (1-based): of the first parameter in which its
    torque is linear.
    """
    size = get_effect(effect).linear[0]
    return sum(t.value(size) for t in model.at(joint) if t.effect == effect)


def added_inertia(model: Model, joint: int) -> float:
    """Inertia of a joint's terms (rotors, payloads), kg m² or kg; the mechanism's own is not in
    it.
    """
    return summed(model, joint, "inertia")


def chosen(term: Term) -> dict[str, int | str]:
    """What of a term is chosen in words or by a joint's number, not estimated."""
    out: dict[str, int | str] = {}
    for p in get_effect(term.effect).parameters:
        if p.size == "joint":
            out[p.name] = int(term.value(p.name))
        elif p.choices:
            out[p.name] = p.choices[int(term.value(p.name))]
    return out
