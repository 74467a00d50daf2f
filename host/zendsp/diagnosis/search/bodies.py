"""Hypotheses about the whole robot: a payload, a wrong link, a tilted base, and their rivals.

At a single joint a wrong body looks like a gain, a coupling or a gravity. Here all joints decide
together. To first order, the torque that a body adds along the measured motion appears in the
observers' innovations (``response`` of ``physics/calibration/predict.py``). That torque is linear
in ten numbers of each link (``physics/robots/bodies.py``). Beside them, every joint has nuisance
columns of its own: offset, rotor inertia, and what is odd in its own speed, whatever law its
friction has. So missing friction is not mistaken for a body, nor a body for friction. A hypothesis
needs only the blocks' Gram matrices, so that estimates, evidence on other recordings and rivals
cost almost nothing. The winner is estimated again around its own numbers, so that its effect on the
inertia is exact.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.progress import Progress, Step
from zendsp.diagnosis.search.body_columns import Layout, Sums
from zendsp.diagnosis.search.body_explain import Explained, clear, explain, seen, tied
from zendsp.diagnosis.search.body_hypotheses import (
    COM,
    LIMITS,
    BodyLimits,
    Hypothesis,
    hypotheses,
)
from zendsp.diagnosis.search.body_solver import Solver
from zendsp.physics.calibration.fit import Data
from zendsp.physics.model import Model, Term
from zendsp.physics.robots.bodies import Links

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FoundBody:
    """A body, or an error of gravity, found by all joints together.

    Attributes
    ----------
    term : Term
        To be added to a model; its numbers have standard deviations and are held in fits of single
        joints.
    body : str
        Name of the link; empty for gravity.
    explained : Explained
        Values, evidence on the recordings that choose, and what each joint gains.
    indistinguishable : tuple of str
        Explanations that predict as well.
    rejected : tuple of Explained
        Those that predict worse, the best first.
    aside : frozenset of int
        Joints (1-based) with a fault of their own that is larger.
    bandwidth : float
        rad/s, of the observers that see it.
    """

    term: Term
    body: str
    explained: Explained
    indistinguishable: tuple[str, ...]
    rejected: tuple[Explained, ...]
    aside: frozenset[int] = frozenset()
    bandwidth: float = LIMITS.bandwidth


@dataclass(frozen=True)
class BodySearch:
    """The proposed bodies of a machine.

    ``model``: the given one with them. ``tried``: all explanations of the last round. ``aside``:
    joints set aside for a fault of their own. ``instead``: the body that explains as much as the
    first of these faults, and that joint. ``small``: the best body, where it is too small a part of
    what the joints leave to be proposed, or as uncertain as the gains of all drives. ``beside``:
    whether a body was seen at several joints before the first joint was set aside.
    """

    model: Model
    found: tuple[FoundBody, ...] = ()
    tried: tuple[Explained, ...] = ()
    aside: frozenset[int] = frozenset()
    instead: tuple[FoundBody, int] | None = None
    small: FoundBody | None = None
    beside: bool = False

    def taken(self, body: FoundBody) -> BodySearch:
        """The search with a body added that had not been proposed."""
        model = self.model.with_terms((*self.model.terms, body.term))
        return replace(self, model=model, found=(body,))


def find_bodies(
    fit: Data,
    choose: Data,
    model: Model,
    jobs: int,
    tell: Progress,
    limits: BodyLimits = LIMITS,
    beside: Sequence[Term] = (),
) -> BodySearch:
    """The wrong bodies of a machine: payloads, links, gravity.

    Parameters
    ----------
    fit, choose : Data
        Recordings to fit to, and to choose by.
    model : Model
        The given one, in kernel form.
    jobs : int
        Threads.
    tell : callable
        Receives a sentence at each stage.
    beside : sequence of Term
        Terms of the joints to include during the search.

    Returns
    -------
    BodySearch
        Proposals. Whether they are claimed is decided on recordings not used here.
    """
    links = fit.records[0][0].links
    # at a single joint a payload is an inertia and a gravity
    if links is None or all(b.parent < 0 for b in links.bodies):
        return BodySearch(model)
    layout = Layout(model, links)

    def searched(limits: BodyLimits) -> BodySearch:
        return _searched(fit, choose, model, jobs, tell, limits, beside)

    search = _by_any_observer(searched, choose, layout, limits)
    if search.found:
        return search
    # dry friction by the load that the model knows stands in for much of a heavy payload: of 150 kg
    # that an arm carried for 10 s nothing was found beside it
    other = _by_any_observer(searched, choose, layout, replace(limits, by_load=False))
    return other if other.found else search


def _by_any_observer(
    searched: Callable[[BodyLimits], BodySearch], choose: Data, layout: Layout, limits: BodyLimits
) -> BodySearch:
    """The search under fast observers, or under slower ones where fast ones see more of something
    else.
    """
    first = search = searched(limits)
    # behind coarse counts a drive's gain follows the command's noise too, a body only the motion
    while not search.found and (search.beside or _drowned(choose, layout, search.tried, limits)):
        limits = replace(limits, bandwidth=0.5 * limits.bandwidth)
        if limits.bandwidth < limits.slowest:
            return first
        search = searched(limits)
    return search if search.found else first


def _drowned(
    choose: Data, layout: Layout, tried: Sequence[Explained], limits: BodyLimits
) -> bool:
    """Whether a sizeable body surely predicts better than none, but is a small part of what fast
    observers leave (a controller that reacts to encoder counts, stick-slip friction). Slower
    observers see less of these and as much of the body.
    """
    by_chance = 2.0 * float(np.log(len(tried) / limits.chance))
    return any(
        e.hypothesis.of_bodies
        and e.z > limits.sure
        and e.gain > by_chance
        and not (seen(e, limits) or clear(e, limits) or unsure(e, limits))
        and weight_of(choose, layout, e) > limits.least
        for e in tried
    )


def _searched(
    fit: Data,
    choose: Data,
    model: Model,
    jobs: int,
    tell: Progress,
    limits: BodyLimits,
    beside: Sequence[Term],
) -> BodySearch:
    """``find_bodies`` under observers of one bandwidth."""
    links = fit.records[0][0].links
    assert links is not None
    begun, model = model, model.with_terms((*model.terms, *beside))
    found: list[FoundBody] = []
    tried: list[Explained] = []
    aside: frozenset[int] = frozenset()
    instead: tuple[FoundBody, int] | None = None
    small: FoundBody | None = None
    seen_first = False
    while len(found) < limits.bodies:
        tell(
            Step.CALIBRATING.says(
                "bodies: a payload, a wrong link, a tilted base, and what looks like them"
            )
        )
        layout = Layout(model, links)
        to_fit = Sums(fit, model, limits, jobs)
        tell(Step.CALIBRATING.says("bodies: what the recordings to choose by say"))
        to_choose = Sums(choose, model, limits, jobs)
        tell(Step.CALIBRATING.says("bodies: every hypothesis"))
        tried, aside, first = _round(to_fit, to_choose, layout, limits)
        best = tried[0]
        seen_first = seen_first or any(_at_several(e, limits) for e in first)
        own = next((e for e in first if _is_body(e, first[0], limits)), None)
        if not found and own is not None:
            own = refined(fit, choose, layout, own_mass(own, first, links, limits), limits, jobs)
            instead = _stated(layout, own, first, limits, frozenset()), first[0].hypothesis.joint
        proposed = seen(best, limits) or clear(best, limits)
        if not found and not proposed and _carried(best, limits):
            own = refined(fit, choose, layout, own_mass(best, tried, links, limits), limits, jobs)
            small = None if unsure(own, limits) else _stated(layout, own, tried, limits, aside)
        if not (best.hypothesis.of_bodies and proposed) or _is_error_of(found, tried, limits):
            break
        tell(Step.CALIBRATING.says(f"bodies: {best.hypothesis.name}, its numbers"))
        best = _with_numbers(fit, choose, layout, tried, limits, jobs, aside)
        # a body on which recordings disagree is none, and hides real ones
        if weight_of(choose, layout, best) < limits.least:
            break
        if unsure(best, limits):
            small = small if found else _stated(layout, best, tried, limits, aside)
            break
        tell(Step.CALIBRATING.says(f"bodies: {best.hypothesis.name}"))
        found.append(_stated(layout, best, tried, limits, aside))
        if "calibration" in found[-1].indistinguishable:  # so that calibration cannot absorb it
            held = {
                key: tuple(replace(q, free=False) for q in items)
                for key, items in begun.mechanism.items()
            }
            begun = replace(begun, mechanism=held)
        model = begun.with_terms((*begun.terms, *(f.term for f in found), *beside))
    wrong = begun.with_terms((*begun.terms, *(f.term for f in found)))
    return BodySearch(wrong, tuple(found), tuple(tried), aside, instead, small, seen_first)


def _with_numbers(
    fit: Data,
    choose: Data,
    layout: Layout,
    tried: Sequence[Explained],
    limits: BodyLimits,
    jobs: int,
    aside: frozenset[int],
) -> Explained:
    """The best explanation with its numbers. Where none of them is known, as those of a light
    payload of which only the first moment acts, fewer numbers of the link that explain as much.
    """
    alike = [e for e in tried if tied(e, tried[0], limits)]

    def again(e: Explained) -> Explained:
        return refined(fit, choose, layout, e, limits, jobs, aside)

    best = again(own_mass(tried[0], tried, layout.links, limits))
    own = own_mass(best, alike, layout.links, limits)
    if own is not best:  # its place is as well known as it can be
        best = again(own)
    if not unsure(best, limits):
        return best
    h = best.hypothesis
    of_link = (e for e in alike if e.hypothesis.of_bodies and e.hypothesis.joint == h.joint)
    fewer = (again(e) for e in of_link if len(e.hypothesis.free) < len(h.free))
    return next((e for e in fewer if not unsure(e, limits)), best)


def _is_error_of(
    found: Sequence[FoundBody], tried: Sequence[Explained], limits: BodyLimits
) -> bool:
    """Whether other numbers of a body that is found already explain what is left as well as a
    further one does.
    """
    have = {f.explained.hypothesis.joint for f in found}
    return any(
        e.hypothesis.of_bodies
        and e.hypothesis.joint in have
        and e.z > limits.sure
        and tied(e, tried[0], limits)
        for e in tried
    )


def _stated(
    layout: Layout,
    best: Explained,
    tried: Sequence[Explained],
    limits: BodyLimits,
    aside: frozenset[int],
) -> FoundBody:
    """A body with its numbers, and the tried explanations that predict as well as the first."""
    h = best.hypothesis
    alike = [
        e.hypothesis
        for e in tried
        if tied(e, tried[0], limits) and e.hypothesis.effect != "unknown"
    ]
    same = dict.fromkeys(o.name for o in alike if (o.effect, o.joint) != (h.effect, h.joint))
    others = tuple(e for e in tried[1:] if e.hypothesis not in alike and e.gain > 0)
    term, bandwidth = stated(layout, best), limits.bandwidth
    return FoundBody(term, h.body, best, tuple(same), others, aside, bandwidth)


def _is_body(one: Explained, best: Explained, limits: BodyLimits) -> bool:
    """Whether an explanation is a body that is clearly seen and predicts as well as the best."""
    h = one.hypothesis
    return h.effect in ("body", "payload") and seen(one, limits) and tied(one, best, limits)


def _at_several(one: Explained, limits: BodyLimits) -> bool:
    """Whether an explanation is a body that explains what several joints leave."""
    joints = int(np.sum(one.share > limits.part))
    return one.hypothesis.of_bodies and seen(one, limits) and joints > 1


def _carried(one: Explained, limits: BodyLimits) -> bool:
    """Whether an explanation is a body that predicts better than none, however small."""
    return one.hypothesis.effect in ("body", "payload") and one.z > limits.sure


def _round(
    fit: Sums, choose: Sums, layout: Layout, limits: BodyLimits
) -> tuple[list[Explained], frozenset[int], list[Explained]]:
    """All explanations, the best first, with joints set aside that have a larger fault of their
    own; and the explanations before the first joint was set aside, where a body was seen.
    """
    everything = hypotheses(layout.model, layout.links)
    aside: set[int] = set()
    first: list[Explained] = []
    while True:
        solver = Solver(fit, choose, layout, limits, aside=aside)
        rigid = Solver(fit, choose, layout, limits, aside=aside, rotors=False)
        left = [h for h in everything if h.of_bodies or h.joint not in aside]
        tried = explain(solver, left, rigid)
        best = tried[0]
        if best.hypothesis.of_bodies or not best.hypothesis.joint or not seen(best, limits):
            return tried, frozenset(aside), first
        if not aside and any(e.hypothesis.of_bodies and seen(e, limits) for e in tried):
            first = tried
        aside.add(best.hypothesis.joint)


def own_mass(
    best: Explained, tried: Sequence[Explained], links: Links, limits: BodyLimits
) -> Explained:
    """A wrong mass of the link in place of a body at its centre of mass, within the uncertainty of
    the place; a wrong centre of mass in place of both, where the mass may be right; a payload in
    place of a link that is too heavy for an error of the file.
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
    sums = [Sums(data, here, limits, jobs) for data in (fit, choose)]
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
    std = one.std(first.hypothesis, values)
    # further recordings reduce the variance by their share of all samples
    more = 1.0 - one.counts.sum() / both.counts.sum()
    may = np.maximum(more * std**2, 1e-300)
    apart = max(1.0, float(np.sqrt(np.mean((together - values) ** 2 / may))))
    return _known_to(one, first, values, apart), _known_to(both, first, together, apart)


def _known_to(solver: Solver, first: Explained, values: Array, apart: float) -> Explained:
    """An explanation with numbers and how well they are known."""
    by_gain = _by_gain(solver, first.hypothesis, values, apart)
    std = np.hypot(apart * solver.std(first.hypothesis, values), by_gain)
    return replace(first, values=values, std=std, of_gain=np.abs(by_gain))


def _standing(
    fit: Data,
    layout: Layout,
    first: Explained,
    limits: BodyLimits,
    jobs: int,
    aside: Collection[int],
) -> tuple[Hypothesis, Array]:
    """Numbers estimated again around themselves until they converge, with an inertia where that
    shows.
    """
    h, values = first.hypothesis, first.values
    wider = (
        replace(h, free=(*h.free, "inertia")) if "mass" in h.free and "inertia" not in h.free else h
    )
    for _ in range(limits.rounds):
        here = layout.model.with_terms((*layout.model.terms, layout.term(h, values)))
        sums = Sums(fit, here, limits, jobs)
        solver = Solver(sums, sums, layout, limits, layout.place(h, values), aside)
        new = solver.estimate(h, values)
        std = solver.std(h, new)
        if len(wider.free) > len(h.free):
            more = solver.estimate(wider, np.append(new, 0.0))
            spread = solver.std(wider, more)
            told_apart = spread[0] < max(limits.blurred * std[0], limits.of_mass * abs(more[0]))
            shown = abs(more[-1]) > limits.shown * spread[-1]
            if shown and told_apart and solver.plausible(wider, more):
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


def many(h: Hypothesis, limits: BodyLimits = LIMITS) -> Array:
    """Standard deviations from which on one number of a body shows that there is one, (p,)."""
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
    total, scale = np.zeros(layout.joints), np.zeros(layout.joints)
    for rec in data.records:
        for j, record in enumerate(rec):
            assert record.links is not None
            change = record.links.change([term], j)
            torque = change.bias + change.inertia * record.others[j, 2]
            total[j] += float(torque @ torque)
            scale[j] += record.scale.torque**2 * record.n
    return np.asarray(np.sqrt(total / np.maximum(scale, 1e-300)))
