"""The friction and the rotors inside a simulator that can only be called.

A simulator that sticks answers no push, and one that turns answers with two torques at once. So its
friction is known by the direction and the speed of slow motion, its torques are given without it,
and it is Coulomb and viscous friction of the model instead: it holds, slides and sits on the motor
as any other, its size is held or calibrated as the number of the simulator that sets it, and is
written back to that number. So is an inertia that only its own joint feels: it is that of a rotor,
as beside the bodies of a URDF.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, Term
from zendsp.physics.term_numbers import file_model, kernel_model

Array = npt.NDArray[np.float64]
Sizes = tuple[float, ...]  # of each joint

NO_CHANGE = 1e-6  # of a size: a smaller change is none
DRY, FLUID, ROTOR = "coulomb", "viscous", "inertia"


@dataclass(frozen=True)
class Inside:
    """What of a simulator's joints is a term of the model.

    Attributes
    ----------
    sizes : dict
        By effect: of each joint, N m or N, that by rad/s or m/s, and kg m² or kg; 0 where it has
        none.
    numbers : dict
        By effect: what a unit of each number that is nothing else adds to the joints' sizes.
    """

    sizes: Mapping[str, Sizes] = field(default_factory=dict)
    numbers: Mapping[str, Mapping[str, Sizes]] = field(default_factory=dict)

    @property
    def names(self) -> frozenset[str]:
        """The numbers of the simulator that are terms."""
        return frozenset(key for of_one in self.numbers.values() for key in of_one)

    def rotors(self, joints: int) -> Array:
        """The inertia of each joint's rotor, kg m² or kg."""
        return np.asarray(self.sizes.get(ROTOR, np.zeros(joints)))

    def friction(self, qd: Array) -> Array:
        """The torque of the friction at some speeds, (n, joints); at none, of the direction up."""
        none = np.zeros(qd.shape[1])
        way = np.where(qd < 0.0, -1.0, 1.0)
        return np.asarray(self.sizes.get(DRY, none) * way + self.sizes.get(FLUID, none) * qd)

    def added_to(self, model: Model) -> Model:
        """A model of the simulator with these terms, and their numbers held."""
        model = kernel_model(model)
        terms = list(model.terms)
        for effect, sizes in self.sizes.items():
            units = {k: u for k, u in self.numbers[effect].items() if model.mechanism[k][0].free}
            for i in map(int, np.flatnonzero(sizes)):
                own = _term(model, effect, i + 1)
                terms = [t for t in terms if t is not own]
                loose = any(unit[i] for unit in units.values())
                terms.append(_with(own, effect, i + 1, sizes[i], loose))
        held = {
            key: tuple(replace(q, free=q.free and key not in self.names) for q in items)
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
        model, given, stays = kernel_model(model), kernel_model(given), set[int]()
        for effect in self.sizes:
            model, more = self._without(model, given, effect)
            stays |= set(more)
        return file_model(model), sorted(stays)

    def _without(self, model: Model, given: Model, effect: str) -> tuple[Model, list[int]]:
        sizes = np.array(self.sizes[effect])
        rubs = [int(i) for i in np.flatnonzero(sizes)]
        here = {i: _term(model, effect, i + 1) for i in rubs}
        own = {i: _term(given, effect, i + 1) for i in rubs}
        change = np.zeros(len(sizes))
        for i in rubs:
            change[i] = _size(here[i]) - _size(own[i]) - sizes[i]
        change[np.abs(change) < NO_CHANGE * sizes] = 0.0
        numbers = self.numbers[effect]
        each = np.array(list(numbers.values())).reshape(-1, len(sizes))
        moved = np.linalg.lstsq(each.T, change, rcond=1e-9)[0]
        mechanism = dict(model.mechanism)
        for key, by, unit in zip(numbers, moved, each, strict=True):
            std = max((_std(here[i]) / abs(unit[i]) for i in rubs if unit[i]), default=0.0)
            (q,) = mechanism[key]
            mechanism[key] = (replace(q, value=q.value + float(by), std=std or q.std),)
        change -= each.T @ moved
        change[np.abs(change) < NO_CHANGE * sizes] = 0.0
        terms = [t for t in model.terms if all(t is not x for x in here.values())]
        stays = []
        for i in rubs:
            rest, term = _size(own[i]) + float(change[i]), own[i] or here[i]
            if rest < 0.0:
                stays.append(i + 1)
            elif rest > 0.0 and term is not None:
                terms.append(_set(term, rest))
        return replace(model, mechanism=mechanism, terms=tuple(terms)), stays


def _term(model: Model, effect: str, joint: int) -> Term | None:
    return next((t for t in model.at(joint) if t.effect == effect), None)


def _size(term: Term | None) -> float:
    return 0.0 if term is None else term.value(_key(term.effect))


def _std(term: Term | None) -> float:
    return 0.0 if term is None else term.parameters[_key(term.effect)].std


def _key(effect: str) -> str:
    """The parameter that is the size of an effect."""
    return get_effect(effect).linear[0]


def _with(own: Term | None, effect: str, joint: int, size: float, free: bool) -> Term:
    """The term of a joint: the model's own, if any, and what is inside."""
    if own is None:
        term = make_term(get_effect(effect), joint, {_key(effect): size})
        return term if free else term.held()
    q = own.parameters[_key(effect)]
    both = replace(q, value=q.value + size, free=free or q.free)
    return replace(own, parameters={_key(effect): both})


def _set(term: Term, size: float) -> Term:
    key = _key(term.effect)
    return replace(term, parameters={key: replace(term.parameters[key], value=size)})
