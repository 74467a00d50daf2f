"""Hypotheses about the whole robot: a payload, a wrong link, a tilted base, and their rivals.

At a single joint a wrong body looks like a gain, a coupling or a gravity. Here all joints decide
together. To first order, the torque that a body adds along the measured motion appears in the
observers' innovations (``response`` of ``physics/calibration/observed.py``). That torque is linear
in ten numbers of each link (``physics/robots/bodies.py``). Beside them, every joint has nuisance
columns of its own: offset, rotor inertia, and what is odd in its own speed, whatever law its
friction has. So missing friction is not mistaken for a body, nor a body for friction. A hypothesis
needs only the blocks' Gram matrices, so that estimates, evidence on other recordings and rivals
cost almost nothing. The winner is estimated again around its own numbers, so that its effect on the
inertia is exact.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
    hypotheses,
)
from zendsp.diagnosis.search.body_numbers import (
    own_mass,
    refined,
    stated,
    unsure,
    weight_of,
    weightless,
)
from zendsp.diagnosis.search.body_solver import Solver
from zendsp.diagnosis.search.joint_zeros import check_zero
from zendsp.diagnosis.search.straps import Strap, strap_in_place_of
from zendsp.physics.calibration.fit import Data
from zendsp.physics.model import Model, Term

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
class SetAside:
    """A joint (1-based) that is set aside for a fault of its own, with all explanations at that
    moment, the best first: those beside the joints ``before`` it, which were aside already. Empty
    where no body was seen.
    """

    joint: int
    before: frozenset[int]
    tried: Sequence[Explained]

    def body(self, limits: BodyLimits) -> Explained | None:
        """The body that explains as much as the fault."""
        return next((e for e in self.tried if _is_body(e, self.tried[0], limits)), None)


@dataclass(frozen=True)
class BodySearch:
    """The proposed bodies of a machine.

    ``model``: the given one with them. ``tried``: all explanations of the last round. ``aside``:
    joints set aside for a fault of their own. ``instead``: bodies that explain as much as such a
    fault, each with that joint, in the order in which they were set aside. ``small``: the best body
    that is not proposed, being too small a part of the torque or of what the joints leave, or as
    uncertain as the gains of all drives. ``beside``: whether a body was seen at several joints
    before the first joint was set aside. ``strap``: a force between links, which predicts better
    than the body that came next.
    """

    model: Model
    found: tuple[FoundBody, ...] = ()
    tried: tuple[Explained, ...] = ()
    aside: frozenset[int] = frozenset()
    instead: tuple[tuple[FoundBody, int], ...] = ()
    small: FoundBody | None = None
    beside: bool = False
    strap: Strap | None = None

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

    Raises
    ------
    OtherZero
        A joint counts from another zero.
    """
    links = fit.records[0][0].links
    # at a single joint a payload is an inertia and a gravity, where it may have those of its own
    if links is None or (limits.own and all(b.parent < 0 for b in links.bodies)):
        return BodySearch(model)
    layout = Layout(model, links)

    def searched(limits: BodyLimits) -> BodySearch:
        return _searched(fit, choose, model, jobs, tell, limits, beside)

    search = _by_any_observer(searched, choose, layout, limits)
    if search.found or search.strap:
        return search
    # dry friction that grows with the known load imitates much of a heavy payload: beside it,
    # nothing was found of 150 kg that an arm carried for 10 s
    other = _by_any_observer(searched, choose, layout, replace(limits, by_load=False))
    return other if other.found or other.strap else search


def _by_any_observer(
    searched: Callable[[BodyLimits], BodySearch], choose: Data, layout: Layout, limits: BodyLimits
) -> BodySearch:
    """The proposals of fast observers; of slower ones where a fast observer sees more of another
    fault than of a body.
    """
    first = search = searched(limits)
    # behind coarse counts a drive's gain also explains the command's noise, a body only the motion
    while not (search.found or search.strap) and (
        search.beside or _drowned(choose, layout, search.tried, limits)
    ):
        limits = replace(limits, bandwidth=0.5 * limits.bandwidth)
        if limits.bandwidth < limits.slowest:
            return first
        search = searched(limits)
    return search if search.found or search.strap else first


def _drowned(
    choose: Data, layout: Layout, tried: Sequence[Explained], limits: BodyLimits
) -> bool:
    """Whether a sizeable body surely predicts better than none, but is a small part of what fast
    observers leave unexplained (a controller that reacts to encoder counts, stick-slip friction).
    Slower observers see less of such faults and as much of the body.
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
    """The proposals of ``find_bodies``, under observers of one bandwidth."""
    links = fit.records[0][0].links
    assert links is not None
    begun, model = model, model.with_terms((*model.terms, *beside))
    found: list[FoundBody] = []
    tried: list[Explained] = []
    aside: frozenset[int] = frozenset()
    instead: tuple[tuple[FoundBody, int], ...] = ()
    small: FoundBody | None = None
    strap: Strap | None = None
    seen_first = False
    while len(found) < limits.bodies:
        layout = Layout(model, links)
        tried, aside, turns = _explained(fit, choose, layout, limits, jobs, tell)
        best = tried[0]
        check_zero(choose, model, best, limits)
        seen_first = seen_first or any(_at_several(e, limits) for t in turns[:1] for e in t.tried)
        like = [] if found else [t for t in turns if t.body(limits) is not None]
        proposed = seen(best, limits) or clear(best, limits)
        one, around = (like[0].body(limits), like[0].before) if like else (best, aside)
        assert one is not None
        if one.hypothesis.of_bodies and (like or proposed or _carried(best, limits)):
            strap = strap_in_place_of([one.hypothesis], (fit, choose), layout, limits, jobs, around)
            if strap is not None:
                break
        if not found:
            instead = _in_place_of(like, fit, choose, layout, limits, jobs)
        if not found and not proposed and _carried(best, limits):
            own = refined(fit, choose, layout, own_mass(best, tried, links, limits), limits, jobs)
            small = None if unsure(own, limits) else _stated(layout, own, tried, limits, aside)
        if not (best.hypothesis.of_bodies and proposed) or _is_error_of(found, tried, limits):
            break
        tell(Step.CALIBRATING.says(f"bodies: {best.hypothesis.name}, its numbers"))
        best = _with_numbers(fit, choose, layout, tried, limits, jobs, aside)
        # one that is small or on which recordings disagree hides real ones: joints may ask for it
        if weight_of(choose, layout, best) < limits.least or unsure(best, limits):
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
    return BodySearch(wrong, tuple(found), tuple(tried), aside, instead, small, seen_first, strap)


def _explained(
    fit: Data, choose: Data, layout: Layout, limits: BodyLimits, jobs: int, tell: Progress
) -> tuple[list[Explained], frozenset[int], list[SetAside]]:
    """The explanations of the recordings, as ``_round`` gives them."""
    model = layout.model
    tell(
        Step.CALIBRATING.says(
            "bodies: a payload, a wrong link, a tilted base, and what looks like them"
        )
    )
    to_fit = Sums(fit, model, limits, jobs)
    tell(Step.CALIBRATING.says("bodies: what the recordings to choose by say"))
    to_choose = Sums(choose, model, limits, jobs)
    tell(Step.CALIBRATING.says("bodies: every hypothesis"))
    tried, aside, turned = _round(to_fit, to_choose, layout, limits)
    if turns := {e.hypothesis.joint: float(e.values[0]) for e in tried if _is_zero(e, limits)}:
        # at their estimated size, as the torque of another zero is not linear in its angle
        to_fit, to_choose = (Sums(x, model, limits, jobs, turns) for x in (fit, choose))
        return _round(to_fit, to_choose, layout, limits)
    return tried, aside, turned


def _in_place_of(
    like: Sequence[SetAside],
    fit: Data,
    choose: Data,
    layout: Layout,
    limits: BodyLimits,
    jobs: int,
) -> tuple[tuple[FoundBody, int], ...]:
    """Bodies that explain as much as faults of joints, each with that joint."""
    out = []
    for turn in like:
        own = turn.body(limits)
        assert own is not None
        own = own_mass(own, turn.tried, layout.links, limits)
        own = refined(fit, choose, layout, own, limits, jobs, turn.before)
        if not weightless(own, limits):
            out.append((_stated(layout, own, turn.tried, limits, turn.before), turn.joint))
    return tuple(out)


def _with_numbers(
    fit: Data,
    choose: Data,
    layout: Layout,
    tried: Sequence[Explained],
    limits: BodyLimits,
    jobs: int,
    aside: frozenset[int],
) -> Explained:
    """The best explanation with its numbers. Where the recordings determine none of them, fewer
    numbers of the same link that explain as much: of a light payload only the first moment acts.
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
    """Whether a body that is already found, with other numbers, explains the rest as well as a
    further body does.
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


def _is_zero(one: Explained, limits: BodyLimits) -> bool:
    """Whether another zero of one joint explains something."""
    return one.hypothesis.effect == "zero" and one.hypothesis.joint > 0 and seen(one, limits)


def _at_several(one: Explained, limits: BodyLimits) -> bool:
    """Whether an explanation is a body that explains what several joints leave."""
    joints = int(np.sum(one.share > limits.part))
    return one.hypothesis.of_bodies and seen(one, limits) and joints > 1


def _carried(one: Explained, limits: BodyLimits) -> bool:
    """Whether an explanation is a body that predicts better than none, however small."""
    return one.hypothesis.effect in ("body", "payload") and one.z > limits.sure


def _round(
    fit: Sums, choose: Sums, layout: Layout, limits: BodyLimits
) -> tuple[list[Explained], frozenset[int], list[SetAside]]:
    """All explanations, the best first, with joints set aside that have a larger fault of their
    own, each with what was said when it was.
    """
    everything = hypotheses(layout.model, layout.links)
    aside: set[int] = set()
    turns: list[SetAside] = []
    while True:
        solver = Solver(fit, choose, layout, limits, aside=aside)
        rigid = Solver(fit, choose, layout, limits, aside=aside, rotors=False)
        left = [h for h in everything if h.of_bodies or h.joint not in aside]
        tried = explain(solver, left, rigid)
        best = tried[0]
        own = best.hypothesis.joint and best.hypothesis.effect != "zero"
        if best.hypothesis.of_bodies or not own or not seen(best, limits):
            return tried, frozenset(aside), turns
        bodies = [e for e in tried if e.hypothesis.of_bodies and seen(e, limits)]
        if best.hypothesis.effect == "inertia":
            bodies = [e for e in bodies if not _on_its_axis(e, limits)]
        joint = best.hypothesis.joint
        turns.append(SetAside(joint, frozenset(aside), tried if bodies else []))
        aside.add(joint)


def _on_its_axis(one: Explained, limits: BodyLimits) -> bool:
    """Whether a body lies so near to its joint's axis, to which only chance would have put it, that
    it is no more than an inertia of the joint before.
    """
    centre = [key in COM for key in one.hypothesis.free]
    away, unsure = one.values[centre], limits.shown * one.std[centre]
    return float(np.linalg.norm(away)) < limits.same or bool(np.all(np.abs(away) < unsure))
