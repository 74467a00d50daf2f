"""Springs of several joints of an arm, told from one another by all encoders together: each hides
the other from the search of a joint by itself, since each takes up a part of the other's motion.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.transmission.arm_chain import chain_of, springs_of, strongest
from zendsp.diagnosis.transmission.arm_motion import ArmMotion, arm_motion, with_springs_at
from zendsp.diagnosis.transmission.arm_path import Path, Records, path_along
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import facts
from zendsp.physics.effects.elasticity import RESONANCES
from zendsp.physics.kernel.signals import Array
from zendsp.physics.model import Model, Quantity, Term
from zendsp.physics.term_numbers import added_inertia

# Deviance that a spring has to gain along the motion without it, and once it is fitted. Beside
# calibrated numbers true ones gained 297 to 994, the best ones of rigid joints lost 377 to 9574.
LEAST_GAIN = 50.0
# The same before, where a miss costs time only and a find the search of all joints: springs that
# were found in the end had gained 3400 and more, a true one of 75 was claimed by no joint
WORTH_A_SEARCH = 500.0
WEAKER = (1.0, 0.3, 0.1, 0.03, 0.01)  # without the spring, unknown torques had to do its work
STIFFER = (1.0, 2.0, 4.0)  # the known springs: one that took up another is softer than without it
LEAST_ROTOR = 0.03  # of the load: where a file has no rotor
DAMPING_RATIO = 0.15  # damping ratio of both masses on a spring that is tried
PER_ROW = 0.15  # oscillations: more are no states of a recording
OF_SPRING = ("stiffness", "damping")
BY = np.array([0.15, 0.7])  # logarithms by which they are changed, one after the other
# Passes go on by Newton's steps once one gains less, and end once such a step gains less than
# ``NOTHING``; unknown torques and springs take turns. The springs' numbers make up for one another:
# changed one by one, by 2.4 % at last, two of 220 and 110 N m/rad ended 1.2 % off, in opposite
# directions, and by Newton's steps within 0.1 %
LITTLE_GAIN, NOTHING, PASSES = 10.0, 1.0, 12
# s: as much of the liveliest motion shows where a spring is, and nearly how stiff. In 3 s true ones
# gained 400 to 31 000
SHOWS_SPRINGS = 4.0
BETWEEN = 0.02  # logarithms of the numbers whose values give the second derivatives
FARTHEST, SHORTER = 0.5, (1.0, 0.5, 0.2)  # a Newton step: logarithms; parts of it that are tried
# A fit that is of use only below some deviance ends where so many passes that gain as much as the
# last one would not get there
PASSES_LIKE_IT = 10.0


def with_other_spring(
    data: Data,
    model: Model,
    joints: Collection[int],
    among: Collection[int],
    held: Data | None = None,
    least: float = 0.0,
) -> Model | None:
    """The model with the likeliest spring of one more joint, and with the stiffness and damping of
    all springs as all encoders together have them; None where no further spring pays.

    Parameters
    ----------
    model : Model
        Its springs at ``joints`` (1-based) are known.
    among : collection of int
        The joints that may have another one.
    held : Data, optional
        Recordings to which nothing is fitted; None where the joints were searched already.
    least : float
        The logarithm of the e-value that the spring has to have there, as tried and as fitted.
    """
    rec, rest = data.records[0], sorted(set(among) - set(joints))
    known = with_springs_at(model, joints)
    arm = arm_motion(rec, data, known) if rest else None
    if arm is None:
        return None
    path = path_along(rec, data, known, arm.links).liveliest(SHOWS_SPRINGS)
    tried = [
        (_value(path, other, arm, WEAKER), by, other)
        for by in (STIFFER if springs_of(known) else (1.0,))
        for joint in rest
        for term in _springs(rec, known, joint)
        if (other := _stiffer(known, by).with_terms((*_stiffer(known, by).terms, term)))
    ]
    best = min(tried, key=lambda t: t[0], default=None)
    if best is None or not best[0] < _value(path, known, arm) - LEAST_GAIN:
        return None
    if _is_soft(rec, known, best[2]):
        return None
    if held is not None and not _log_e_as_tried(held, known, best[2]) > least:
        return None
    goal = arm.deviance - (LEAST_GAIN if held is None else WORTH_A_SEARCH)
    found, value = _likeliest(rec, data, best[2], arm, goal)
    if not value < goal or _is_soft(rec, known, found):
        return None
    return found if held is None or _log_e(held, known, found) > least else None


def first_springs(data: Data, held: Data, model: Model, least: float) -> Model | None:
    """The model with the springs that all encoders together need and that it has not, before any
    joint was searched by itself; None where they need none.

    Parameters
    ----------
    held : Data
        Recordings to which nothing is fitted.
    least : float
        The logarithm of the e-value that each spring has to have there.
    """
    found, joints = model, frozenset[int]()
    every = range(1, model.joints + 1)
    while (other := with_other_spring(data, found, joints, every, held, least)) is not None:
        found, joints = other, frozenset(springs_of(other))
    return found if joints else None


def _log_e_as_tried(held: Data, known: Model, model: Model) -> float:
    """The logarithm of the e-value of a model that is not fitted yet over a ``known`` one, along
    the liveliest motion with that: of a false spring it costs a tenth of the fit.
    """
    rec = held.records[0]
    arm = arm_motion(rec, held, known)
    if arm is None:
        return -math.inf
    path = path_along(rec, held, known, arm.links).liveliest(SHOWS_SPRINGS)
    return 0.5 * (_value(path, known, arm) - _value(path, model, arm, WEAKER))


def _log_e(held: Data, without: Model, model: Model) -> float:
    """The logarithm of the e-value of a model over one ``without`` some of its springs, on
    recordings to which neither is fitted: half of what the deviance falls by.
    """
    gain = 0.0
    for rec in held.records:
        before, after = (arm_motion(rec, held, m) for m in (without, model))
        if before is None or after is None:
            return -math.inf
        gain += before.deviance - after.deviance
    return 0.5 * gain


def needed_springs(data: Data, model: Model, joints: Collection[int]) -> Model | None:
    """The model with those of its springs at some joints (1-based) that all encoders together need,
    and with their likeliest stiffness and damping; None where its numbers are those of no body.

    What a joint by itself takes for its load leaves the joint behind it none. So all of a joint's
    links hang on its spring.
    """
    rec = data.records[0]
    model = with_springs_at(model, joints)
    for joint in joints:
        spring = springs_of(model)[joint]
        number, links = spring.parameters["load_inertia"], spring.value("links_inertia")
        whole = replace(number, value=links or number.value)
        model = _with_numbers(model, joint, {"load_inertia": whole})
    asked = _Asked(rec, data, model)
    some = frozenset(joints)
    while len(some) > 1:
        less = asked.likeliest([some - {joint} for joint in some])
        value, found = asked.of(some, asked.of(less)[0] - LEAST_GAIN)
        if value < asked.of(less)[0] - LEAST_GAIN:
            return found
        some = less
    value, found = asked.of(some)
    return found if math.isfinite(value) else None


class _Asked:
    """A model with some of its springs, each fitted once."""

    def __init__(self, rec: Records, data: Data, model: Model) -> None:
        self.rec, self.data, self.model = rec, data, model
        self._begun: dict[frozenset[int], ArmMotion | None] = {}
        self._done: dict[frozenset[int], tuple[float, Model]] = {}

    def of(self, some: frozenset[int], goal: float = math.inf) -> tuple[float, Model]:
        """-2 log-likelihood of the model with its likeliest springs at some joints, and that model;
        as far as it was fitted, where no more would have brought it below the ``goal``.
        """
        if some not in self._done:
            model, arm = with_springs_at(self.model, some), self._motion(some)
            done = (math.inf, model)
            if arm is not None:
                done = _likeliest(self.rec, self.data, model, arm, goal)[::-1]
            self._done[some] = done
        return self._done[some]

    def likeliest(self, sets: Sequence[frozenset[int]]) -> frozenset[int]:
        """The likeliest of some sets of joints with springs; what begins likely is fitted first."""
        best = math.inf
        for some in sorted(sets, key=self._begin):
            best = min(best, self.of(some, best)[0])
        return min(sets, key=lambda some: self.of(some)[0])

    def _motion(self, some: frozenset[int]) -> ArmMotion | None:
        if some not in self._begun:
            model = with_springs_at(self.model, some)
            self._begun[some] = arm_motion(self.rec, self.data, model)
        return self._begun[some]

    def _begin(self, some: frozenset[int]) -> float:
        arm = self._motion(some)
        return math.inf if arm is None else arm.deviance


def likeliest_springs(data: Data, model: Model, joints: Collection[int]) -> Model:
    """The model with its springs at some joints as all encoders together have them."""
    rec, model = data.records[0], with_springs_at(model, joints)
    arm = arm_motion(rec, data, model)
    return model if arm is None else _likeliest(rec, data, model, arm, near=True)[0]


def _springs(rec: Records, model: Model, joint: int) -> list[Term]:
    """Springs between a joint's rotor and its link, from soft to stiff."""
    record = rec[joint - 1]
    inertia = record.inertia_and_bias(model)[0]
    load = facts(record).links or record.reference_inertia(model, inertia)
    rotor = max(added_inertia(model, joint), LEAST_ROTOR * load)
    both = 1.0 / (1.0 / rotor + 1.0 / load)
    out = []
    for hertz in RESONANCES[::2]:
        if hertz * record.sample_time > PER_ROW:
            break
        stiffness = (2 * math.pi * hertz) ** 2 * both
        numbers = {
            "stiffness": Quantity(stiffness),
            "damping": Quantity(2.0 * DAMPING_RATIO * math.sqrt(stiffness * both)),
            "load_inertia": Quantity(load),
            "load_dry": Quantity(0.0, False),
            "links_inertia": Quantity(load, False),
        }
        out.append(Term("elasticity", joint, numbers))
    return out


def _is_soft(rec: Records, known: Model, model: Model) -> bool:
    """Whether a spring that a known model has not is as soft as the softest one that is tried: the
    likelihood has no maximum among springs, and the softer one is, the less a link has to move as
    its model says. A base that was tilted made such a one, which gained on held-out recordings too.
    """
    had, now = springs_of(known), springs_of(model)
    new = {j: s.value("stiffness") for j, s in now.items() if j not in had}
    return any(k <= _springs(rec, known, j)[0].value("stiffness") for j, k in new.items())


def _strength(model: Model, arm: ArmMotion) -> Array:
    """The strengths of unknown torques for a model with springs that an arm's motion has not: at a
    new link as at its motor.
    """
    had = arm.chain.links
    places = [int(had[joint - 1]) for joint in springs_of(model)]
    return arm.strength[[*range(len(had)), *places]]


def _value(
    path: Path, model: Model, arm: ArmMotion, weaker: Sequence[float] = (1.0,)
) -> float:
    """-2 log-likelihood of a model along a path, the least with unknown torques ``weaker`` by some
    factors, as long as the next one pays; infinite where it is no body's.
    """
    chain, best = chain_of(path, model), math.inf
    if chain is None:
        return best
    strength = _strength(model, arm)
    for by in weaker:
        value = chain.deviance(by * strength)
        if not value < best:
            break
        best = value
    return best


def _likeliest(
    rec: Records,
    data: Data,
    model: Model,
    arm: ArmMotion,
    goal: float = math.inf,
    *,
    near: bool = False,
) -> tuple[Model, float]:
    """The model with the likeliest numbers of its springs, and its -2 log-likelihood; not fitted to
    the end where that would not bring it below a ``goal``. ``near``: it begins close to them.

    The liveliest part leads there, and the whole only has the last word: of six joints and 30 s
    with one spring that took 4 in place of 10 s, and of two it found the right ones.
    """
    whole, last = False, math.inf
    path = path_along(rec, data, model, arm.links)
    for turn in range(PASSES):
        weaker, steps = ((1.0,), (3.0,)) if turn else (WEAKER, (10.0, 3.0))
        arm = _moved_by(path, model, np.outer(weaker, _strength(model, arm)), steps)
        path = path_along(rec, data, model, arm.links)
        asked = path if whole else path.liveliest(SHOWS_SPRINGS)
        model, best = (_by_newton if near else _climbed)(asked, model, arm)
        gain = last - best
        if whole and (gain < NOTHING or best - PASSES_LIKE_IT * abs(gain) > goal):
            break
        last = best
        if not whole and gain < LITTLE_GAIN:
            near, whole, last = True, near, math.inf
    return model, best


def _moved_by(
    path: Path, model: Model, begin: npt.NDArray[np.floating[Any]], steps: Sequence[float]
) -> ArmMotion:
    """The motion of an arm along a path, with the likeliest unknown torques of its liveliest part,
    see ``strongest``.
    """
    chain, lively = (chain_of(p, model) for p in (path, path.liveliest(SHOWS_SPRINGS)))
    assert chain is not None
    assert lively is not None
    strength = strongest(lively, begin, steps)
    value, states = chain.smoothed(strength)
    return ArmMotion(chain.link_motion(states), chain, strength, value)


def _climbed(path: Path, model: Model, arm: ArmMotion) -> tuple[Model, float]:
    """A likelier model along a path and its -2 log-likelihood: each number of its springs by steps,
    logarithms, as long as that pays.
    """
    best = _value(path, model, arm)
    for joint in springs_of(model):
        for name, factor in zip(OF_SPRING, BY, strict=True):
            for by in (math.exp(factor), math.exp(-factor)):
                other = _scaled(model, joint, name, by)
                while (value := _value(path, other, arm)) < best - 0.5:
                    model, best = other, value
                    other = _scaled(model, joint, name, by)
    return model, best


def _by_newton(path: Path, model: Model, arm: ArmMotion) -> tuple[Model, float]:
    """The same by a step of Newton in the logarithms of all numbers of the springs."""
    keys = [(joint, name) for joint in springs_of(model) for name in OF_SPRING]

    def moved(by: Array) -> Model:
        out = model
        for (joint, name), log in zip(keys, by, strict=True):
            out = _scaled(out, joint, name, math.exp(log))
        return out

    def value(by: Array) -> float:
        return _value(path, moved(by), arm)

    e, here = BETWEEN * np.eye(len(keys)), _value(path, model, arm)
    ahead, back = (np.array([value(way) for way in sign * e]) for sign in (1.0, -1.0))
    slope, curved = (ahead - back) / 2.0, np.diag(ahead + back - 2.0 * here)
    for i, j in zip(*np.triu_indices(len(keys), 1), strict=True):
        curved[i, j] = curved[j, i] = value(e[i] + e[j]) - ahead[i] - ahead[j] + here
    if not np.all(np.isfinite(curved)):
        return model, here
    bent, ways = np.linalg.eigh(curved)  # downhill also where it is bent the other way
    step = -BETWEEN * ways @ ((ways.T @ slope) / np.maximum(np.abs(bent), BETWEEN**2))
    step *= min(1.0, FARTHEST / max(float(np.abs(step).max()), 1e-12))
    tried = [(value(part * step), part) for part in SHORTER]
    best, part = min(tried)
    return (moved(part * step), best) if best < here else (model, here)


def _stiffer(model: Model, by: float) -> Model:
    """The model with stiffer springs."""
    for joint in springs_of(model):
        model = _scaled(model, joint, "stiffness", by)
    return model


def _scaled(model: Model, joint: int, name: str, by: float) -> Model:
    """The model with a number of a joint's spring larger by a factor."""
    number = springs_of(model)[joint].parameters[name]
    return _with_numbers(
        model, joint, {name: replace(number, value=max(by * number.value, 1e-9))}
    )


def _with_numbers(model: Model, joint: int, numbers: Mapping[str, Quantity]) -> Model:
    """The model with other numbers of a joint's spring."""
    spring = springs_of(model)[joint]
    changed = replace(spring, parameters={**spring.parameters, **numbers})
    return model.with_terms(tuple(changed if t is spring else t for t in model.terms))
