"""The dry friction inside a simulator that can only be called.

A simulator that sticks answers no push, and one that turns answers with two torques at once. So its
dry friction is known by the direction of slow motion, its torques are given without it, and it is a
Coulomb friction of the model instead: it holds and slides as any other, its level is held or
calibrated as the number of the simulator that sets it, and is written back to that number.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, Quantity, Term
from zendsp.physics.term_numbers import file_model, kernel_model

SAME = 1e-6  # of a level: a smaller change is none
COULOMB = "coulomb"


@dataclass(frozen=True)
class DryInside:
    """The dry friction of a simulator's joints.

    Attributes
    ----------
    levels : tuple of float
        Of each joint, N m or N; 0 where it has none.
    numbers : dict
        What a unit of each number that is nothing else adds to the joints' levels.
    """

    levels: tuple[float, ...] = ()
    numbers: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    def added_to(self, model: Model) -> Model:
        """A model of the simulator with this friction as terms, and its numbers held."""
        model = kernel_model(model)
        free = {k for k in self.numbers if model.mechanism[k][0].free}
        terms = list(model.terms)
        for i, level in enumerate(self.levels):
            if level > 0.0:
                own = _coulomb(model, i + 1)
                terms = [t for t in terms if t is not own]
                loose = any(self.numbers[k][i] for k in free)
                terms.append(_with(own, i + 1, level, loose))
        held = {
            key: tuple(replace(q, free=q.free and key not in self.numbers) for q in items)
            for key, items in model.mechanism.items()
        }
        return file_model(replace(model, mechanism=held, terms=tuple(terms)))

    def taken_from(self, model: Model, given: Model) -> tuple[Model, list[int]]:
        """A model with such terms as one of the simulator; and the joints (from 1) at which the
        simulator has more than the model, without a number that could say so.

        Parameters
        ----------
        given : Model
            Before the terms were added.
        """
        model, given = kernel_model(model), kernel_model(given)
        rubs = [i for i, level in enumerate(self.levels) if level > 0.0]
        here = {i: _coulomb(model, i + 1) for i in rubs}
        own = {i: _coulomb(given, i + 1) for i in rubs}
        change = np.zeros(len(self.levels))
        for i in rubs:
            change[i] = _level(here[i]) - _level(own[i]) - self.levels[i]
        change[np.abs(change) < SAME * np.array(self.levels)] = 0.0
        mechanism = dict(model.mechanism)
        each = np.array(list(self.numbers.values())).reshape(-1, len(self.levels))
        moved = np.linalg.lstsq(each.T, change, rcond=1e-9)[0]
        for key, by, unit in zip(self.numbers, moved, each, strict=True):
            std = max((_std(here[i]) / abs(unit[i]) for i in rubs if unit[i]), default=0.0)
            (q,) = mechanism[key]
            mechanism[key] = (replace(q, value=q.value + float(by), std=std or q.std),)
        change -= each.T @ moved
        change[np.abs(change) < SAME * np.array(self.levels)] = 0.0
        terms = [t for t in model.terms if all(t is not x for x in here.values())]
        stays = []
        for i in rubs:
            rest, term = _level(own[i]) + float(change[i]), own[i] or here[i]
            if rest < 0.0:
                stays.append(i + 1)
            elif rest > 0.0 and term is not None:
                terms.append(_set(term, rest))
        return file_model(replace(model, mechanism=mechanism, terms=tuple(terms))), stays


def _coulomb(model: Model, joint: int) -> Term | None:
    return next((t for t in model.at(joint) if t.effect == COULOMB), None)


def _level(term: Term | None) -> float:
    return 0.0 if term is None else term.value("level")


def _std(term: Term | None) -> float:
    return 0.0 if term is None else term.parameters["level"].std


def _with(own: Term | None, joint: int, level: float, free: bool) -> Term:
    """The Coulomb friction of a joint: the model's own, if any, and that inside."""
    if own is None:
        term = make_term(get_effect(COULOMB), joint, {"level": level})
        return term if free else term.held()
    q = own.parameters["level"]
    both = replace(q, value=q.value + level, free=free or q.free)
    return replace(own, parameters={"level": both})


def _set(term: Term, level: float) -> Term:
    q: Quantity = term.parameters["level"]
    return replace(term, parameters={"level": replace(q, value=level)})
