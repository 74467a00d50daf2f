"""The numbers of a body: the fewest that tell it; estimated again around the last estimate until
they converge; how well they are known; and how much of the torque they explain.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.search.body_columns import Layout, Sums
from zendsp.diagnosis.search.body_explain import Explained, seen, tied
from zendsp.diagnosis.search.body_hypotheses import COM, LIMITS, BodyLimits, Hypothesis
from zendsp.diagnosis.search.body_solver import Solver
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.model import Model, Term
from zendsp.physics.robots.bodies import Links

Array = npt.NDArray[np.float64]


def own_mass(
    best: Explained, tried: Sequence[Explained], links: Links, limits: BodyLimits
) -> Explained:
    """The explanation in the fewest numbers of the link: a wrong mass, where the body lies at the
    link's centre of mass within its uncertainty; a wrong centre of mass, where the mass may be
    right; a payload, where the link would be too heavy for an error of the file.
    """
    h = best.hypothesis
    if h.effect == "body" and "mass" in h.free:
        most = limits.own_mass * links.bodies[h.joint - 1].mass
        alike = (e for e in tried if tied(e, tried[0], limits) and e.hypothesis.joint == h.joint)
        if best.values[0] > most:
            return next((e for e in alike if e.hypothesis.effect == "payload"), best)
    if "mass" not in h.free or h.free == ("mass",):
        return best
    if h.effect == "body" and abs(best.values[0]) < limits.shown * best.std[0]:
        centre = replace(h, free=h.free[1:], cost=h.cost - 1.0)
        return next((e for e in tried if e.hypothesis == centre and seen(e, limits)), best)
    body = links.bodies[h.joint - 1]
    known = dict(zip(h.free, best.values.tolist(), strict=True))
    mass, com = known["mass"], np.array([known.get(key, 0.0) for key in COM])
    moment = (body.mass + mass) / (mass or 1e-12)
    away = com - body.com if h.effect == "payload" else com * moment
    spread = dict(zip(h.free, best.std.tolist(), strict=True))
    blur = np.array([spread.get(key, np.inf) for key in COM])
    blur *= 1.0 if h.effect == "payload" else abs(moment)
    there = float(np.linalg.norm(away)) <= limits.same or np.all(np.abs(away) < limits.shown * blur)
    if abs(mass) > limits.own_mass * body.mass or not there:
        return best
    plain = [
        e
        for e in tried
        if (e.hypothesis.effect, e.hypothesis.joint, e.hypothesis.free)
        == ("body", h.joint, ("mass",))
    ]
    return plain[0] if plain else best


def refined(
    fit: Data,
    choose: Data,
    layout: Layout,
    first: Explained,
    limits: BodyLimits = LIMITS,
    jobs: int = 1,
    aside: Collection[int] = (),
) -> Explained:
    """An explanation estimated again around its own numbers until they converge; a mass gets an
    inertia of its own where that shows.

    Unexplained torque recurs with the poses and so biases the numbers by more than the blocks of
    one recording show. Another recording has other poses; the standard deviations grow by how far
    it moves the numbers beyond their uncertainty. They include a common gain error of all
    actuators, which resembles a mass.
    """
    return _refined(fit, choose, layout, first, limits, jobs, aside)[0]


def agreed(
    fit: Data,
    choose: Data,
    layout: Layout,
    first: Explained,
    limits: BodyLimits = LIMITS,
    jobs: int = 1,
    aside: Collection[int] = (),
) -> Explained:
    """The same explanation, estimated on the recordings of the fit and those to choose by. The
    choice is made by now, and the poses of both separate mass from friction and rotors.
    """
    return _refined(fit, choose, layout, first, limits, jobs, aside)[1]


def _refined(
    fit: Data,
    choose: Data,
    layout: Layout,
    first: Explained,
    limits: BodyLimits,
    jobs: int,
    aside: Collection[int],
) -> tuple[Explained, Explained]:
    """An explanation estimated on the recordings of the fit and on those to choose by."""
    h, values = _standing(fit, layout, first, limits, jobs, aside)
    here = layout.model.with_terms((*layout.model.terms, layout.term(h, values)))
    sums = [Sums(data, here, limits, jobs, about=[h]) for data in (fit, choose)]
    origin = layout.place(h, values)
    one, both = (
        Solver(x, x, layout, limits, origin, aside) for x in (sums[0], sums[0].with_more(sums[1]))
    )
    return known_by(one, both, replace(first, hypothesis=h), values)


def known_by(
    one: Solver, both: Solver, first: Explained, values: Array
) -> tuple[Explained, Explained]:
    """An explanation estimated by some recordings (``values``) and by more of them, with how well
    its numbers are known.
    """
    together = both.estimate(first.hypothesis, values)
    if not both.plausible(first.hypothesis, together):
        together = values
    std = one.std(first.hypothesis, values)
    # further recordings reduce the variance by their share of all samples
    more = 1.0 - one.counts.sum() / both.counts.sum()
    may = np.maximum(more * std**2, 1e-300)
    apart = max(1.0, float(np.sqrt(np.mean((together - values) ** 2 / may))))
    return _known_to(one, first, values, apart), _known_to(both, first, together, apart)


def _known_to(solver: Solver, first: Explained, values: Array, apart: float) -> Explained:
    """An explanation with numbers and how well they are known."""
    by_gain = _by_gain(solver, first.hypothesis, values, apart)
    by_inertia = _by_inertia(solver, first.hypothesis, values, apart)
    by_given = _by_given(solver, first.hypothesis, values)
    beside = np.hypot(np.hypot(by_gain, by_inertia), by_given)
    std = np.hypot(apart * solver.std(first.hypothesis, values), beside)
    return replace(
        first, values=values, std=std, of_gain=np.abs(by_gain), of_inertia=np.abs(by_inertia)
    )


def _standing(
    fit: Data,
    layout: Layout,
    first: Explained,
    limits: BodyLimits,
    jobs: int,
    aside: Collection[int],
) -> tuple[Hypothesis, Array]:
    """Numbers estimated again around the last estimate until they converge, with an inertia where
    that shows.
    """
    h, values = first.hypothesis, first.values
    # beside p1, p2 and p3 of a planar arm, known to their tolerance, an inertia of its own leaves
    # nothing of its mass
    own = layout.rotors and "mass" in h.free and "inertia" not in h.free
    wider = replace(h, free=(*h.free, "inertia")) if own else h
    for _ in range(limits.rounds):
        here = layout.model.with_terms((*layout.model.terms, layout.term(h, values)))
        sums = Sums(fit, here, limits, jobs, about=[h])
        solver = Solver(sums, sums, layout, limits, layout.place(h, values), aside)
        new = solver.estimate(h, values)
        if not solver.plausible(h, new):  # a link would have no mass left
            break
        std = solver.std(h, new)
        if len(wider.free) > len(h.free):
            more = solver.estimate(wider, np.append(new, 0.0))
            spread = solver.std(wider, more)
            told_apart = spread[0] < max(limits.blurred * std[0], limits.of_mass * abs(more[0]))
            shown = abs(more[-1]) > limits.shown * spread[-1]
            alone = solver.own_share(wider, more) > limits.no_rotor
            if shown and told_apart and alone and solver.plausible(wider, more):
                h, new, std = wider, more, spread
        known = len(values)
        stands = (
            len(new) == known
            and float(np.max(np.abs(new - values) / np.maximum(std, 1e-300))) < limits.moves
        )
        values = new
        if stands:
            break
    return h, values


def _by_gain(solver: Solver, h: Hypothesis, values: Array, apart: float) -> Array:
    """The change of the numbers when all actuators give one standard deviation more or less than
    stated. That deviation is the model's for its gains, or else that of makers' torque constants,
    combined with what the recordings show.
    """
    limits = solver.limits
    constant = gain_known(solver.layout.model, limits)
    both, stated = replace(h, free=(*h.free, "gain")), np.append(values, 0.0)
    off, spread = solver.step(both, stated)[-1], solver.std(both, stated)[-1]
    # in a loop the command balances all unknown torques, which biases a regression for the gain;
    # the gain is known no better than that bias
    seen = max(abs(float(off)), apart * float(spread))
    by = float(np.copysign(seen * constant / np.hypot(seen, constant), off))
    shift = solver.beside_gain(by).estimate(h, values) - values
    for _ in range(limits.halvings):  # the gain must not make a body's inertia negative
        if solver.plausible(h, values + shift):
            break
        shift /= 2.0
    return np.asarray(shift)


def _by_inertia(solver: Solver, h: Hypothesis, values: Array, apart: float) -> Array:
    """The change of a payload's numbers where it is no point, as is assumed while nothing shows its
    inertia: with that of a ball of its mass, or as much as the recordings allow. Without gravity a
    mass is known by its inertia alone, and a part of that may be its own.
    """
    if h.effect != "payload" or "inertia" in h.free or not values[0] > 0.0:
        return np.zeros(len(values))
    radius = (0.75 * values[0] / (np.pi * solver.limits.density)) ** (1.0 / 3.0)
    ball = 0.4 * float(values[0]) * float(radius) ** 2
    both, point = replace(h, free=(*h.free, "inertia")), np.append(values, 0.0)
    seen = apart * float(solver.std(both, point)[-1])
    by = seen * ball / max(float(np.hypot(seen, ball)), 1e-300)
    shift = solver.beside(both, np.append(values, by), point).estimate(h, values) - values
    return np.asarray(shift) if solver.plausible(h, values + shift) else np.zeros(len(values))


def _by_given(solver: Solver, h: Hypothesis, values: Array) -> Array:
    """The standard deviation of the numbers because the mechanism's own are known no better than
    the model states, or than such numbers usually are. They are held while bodies are looked for.
    """
    layout = solver.layout
    own = Hypothesis("calibration", free=tuple(layout.keys))
    usual = solver.limits.stated * np.abs(layout.given)
    off = np.diag(np.where(layout.given_std > 0.0, layout.given_std, usual))
    shifts = [solver.beside(own, by, np.zeros(len(by))).estimate(h, values) - values for by in off]
    return np.sqrt(np.sum(np.square(shifts), axis=0)) if shifts else np.zeros(len(values))


def gain_known(model: Model, limits: BodyLimits = LIMITS) -> float:
    """Relative standard deviation of the drives' gains: the model's, or that of makers' torque
    constants.
    """
    return model.actuator.gain_known or limits.constant


def unsure(explained: Explained, limits: BodyLimits = LIMITS) -> bool:
    """Whether every free number of a body lies within two standard deviations of zero; beside a
    mass, its centre within three.
    """
    least = many(explained.hypothesis, limits) * explained.std
    return bool(np.all(np.abs(explained.values) < least))


def weightless(explained: Explained, limits: BodyLimits = LIMITS) -> bool:
    """Whether a body may as well have no mass. Its moment may be sure even so, but a law of the
    joint states that in fewer numbers: a spring of a UR10 had been called 50 ± 130 kg.
    """
    e = explained
    return "mass" in e.hypothesis.free and bool(abs(e.values[0]) < limits.shown * e.std[0])


def many(h: Hypothesis, limits: BodyLimits = LIMITS) -> Array:
    """Standard deviations beyond which a single number shows that there is a body, (p,)."""
    out = np.full(len(h.free), limits.shown)
    if "mass" in h.free:
        out[1:] = limits.sure
    return out


def stated(layout: Layout, e: Explained) -> Term:
    """The term of an explanation with its standard deviations, held in fits of single joints."""
    term = layout.term(e.hypothesis, e.values)
    spread = dict(zip(e.hypothesis.free, e.std.tolist(), strict=True))
    numbers = {
        key: replace(q, free=False, std=spread.get(key, 0.0)) for key, q in term.parameters.items()
    }
    return Term(term.effect, term.joint, numbers)


def weight_of(data: Data, layout: Layout, e: Explained) -> float:
    """RMS torque of an explanation at the joint where it is the largest part of the joint's RMS
    torque, as that part.
    """
    return float(np.max(weights_of(data, layout, e.hypothesis, e.values)))


def weights_of(data: Data, layout: Layout, h: Hypothesis, values: Array) -> Array:
    """RMS torque of a body at each joint, as a part of the joint's RMS torque, (joints,)."""
    term = layout.term(h, values)

    def torque(links: Links, record: JointRecord) -> Array:
        change = links.change([term], record.joint - 1)
        return np.asarray(change.bias + change.inertia * record.others[record.joint - 1, 2])

    return weights_by(data, torque)


def weights_by(data: Data, torque: Callable[[Links, JointRecord], Array]) -> Array:
    """RMS of a torque (n,) at each joint, as a part of the joint's RMS torque, (joints,)."""
    total, scale = np.zeros((2, len(data.records[0])))
    for rec in data.records:
        for j, record in enumerate(rec):
            assert record.links is not None
            total[j] += float(np.sum(torque(record.links, record) ** 2))
            scale[j] += record.scale.torque**2 * record.n
    return np.asarray(np.sqrt(total / np.maximum(scale, 1e-300)))
