"""The law by which a claimed mechanism is named, or none; and what only refines the fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.believed import by_themselves, surely_more, without_its_parts
from zendsp.diagnosis.decide.claims import Claim, Decision, Piece
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.law_torque import (
    kept_laws,
    kind_of,
    known_discrepancy,
    may_leave,
    rms_torque,
)
from zendsp.diagnosis.decide.near import LEAVES_MORE, why_curve
from zendsp.diagnosis.decide.patchwork import (
    bends,
    is_curve,
    makes_another_grow,
    part_of_a_wave,
    stand_on_nothing,
)
from zendsp.diagnosis.decide.pieces import only_at_turns, piece_of, sure, turns_round
from zendsp.diagnosis.decide.rivals import law_of
from zendsp.diagnosis.decide.thresholds import (
    CURVE,
    LAW_ERROR,
    LEFT_BY_A_LAW,
    OWN_SHARE,
    PLAIN,
    SIMULATORS_DIFFER,
    SURE,
)
from zendsp.diagnosis.measure.curve import DRY, FLUID, FRICTION
from zendsp.diagnosis.measure.discrepancy import Size, discrepancy
from zendsp.diagnosis.measure.likelihood import Scored
from zendsp.diagnosis.measure.own_variable import drawn_by_its_variable
from zendsp.diagnosis.measure.significance import deviation
from zendsp.diagnosis.measure.structure import STRUCTURED, Structure, structure
from zendsp.diagnosis.measure.wandering import wanders
from zendsp.diagnosis.progress import Progress
from zendsp.diagnosis.search.hypothesis import JointSearch
from zendsp.diagnosis.search.rounds import Rounds
from zendsp.physics.calibration.fit import Data
from zendsp.physics.effects import get_effect, mechanism_of, stands_on
from zendsp.physics.model import Model, Term


def named(
    parts: Parts,
    given: Model,
    search: JointSearch,
    final: Scored,
    claimed: Sequence[Piece],
    rest: Sequence[Piece],
    before: Size,
    jobs: int,
    tell: Progress,
) -> Decision:
    """The claims and refinements of a joint: each mechanism by its law, or by none where no law
    describes it.

    Parameters
    ----------
    final : Scored
        The model of the search with its claims, against which every law is compared.
    claimed, rest : sequence of Piece
        Mechanisms that the untouched recordings show, and those that only improve the fit.
    before : Size
        The missing torque without them.
    """
    joint = search.joint
    rounds = Rounds(parts.fit, joint, jobs, tell, given)
    after = discrepancy(parts.test, final.model, joint)
    state = structure(parts.each, final.model, joint, STRUCTURED)
    known = known_discrepancy(given, parts.test, joint)
    scale = rms_torque(parts.test, joint)
    bent = stand_on_nothing(final, joint, scale)
    judge = _Judge(parts, given, final, claimed, joint, after, known.of_state, bent)
    claims: list[Claim] = []
    refinements: list[Claim] = []
    for piece in claimed:
        only_bends = all(any(t is x for x in bent) for t in piece.terms)
        turns = _turns_a_known_one(parts, given, final, piece, before)
        if only_bends or turns or only_at_turns(parts, given, final, piece):
            rest = [*rest, piece]
            continue
        ranked = _ranked(parts.test, given, final, piece, search.base, jobs)
        ranked = _upon(ranked, after.value)
        first = ranked[0]
        law = law_of(parts, given, search, rounds, final, piece, first, tell)
        own, beside = judge.findings_among(ranked, piece)
        refinements += [c for p in beside for c in _plain(p)]
        left = judge.left_by(piece)
        why = judge.why_no_law(piece, ranked, own, left)
        if why:
            refinements += [c for p in own[1:] for c in _plain(p)]
            claims.append(replace(law, effect="unknown", left=left, why=why))
            continue
        claims.append(replace(law, left=left, size=first.size if len(own) > 1 else piece.size))
        claims += [law_of(parts, given, search, rounds, final, p, p, tell) for p in own[1:]]
    refinements += [c for p in rest for c in _plain(p)]
    claims.sort(key=lambda c: -c.evidence.gain)
    claims, more = without_its_parts(claims, after.value)
    refinements += more
    best = claims[0].size if claims else 0.0
    # more torque over the state is left than any claim explains
    if state.size > best and state.z > SURE:
        claims = []
    alone = by_themselves(given, final, joint, claims, refinements, jobs)
    return Decision(
        joint,
        Verdict.MISSING,
        tuple(claims),
        tuple(refinements),
        search.base,
        final,
        before,
        after,
        state,
        after if alone is final else discrepancy(parts.test, alone.model, joint),
        alone,
        scale,
        known=known,
    )


@dataclass(frozen=True)
class _Judge:
    """Judges whether a law describes its mechanism at a joint.

    ``after``: torque left with all that is ``claimed``. ``known``: the part over the state that
    this machine is known to leave. ``bent``: terms whose base law has vanished.
    """

    parts: Parts
    given: Model
    final: Scored
    claimed: Sequence[Piece]
    joint: int
    after: Size
    known: float
    bent: Sequence[Term]

    def findings_among(
        self, ranked: Sequence[Piece], piece: Piece
    ) -> tuple[list[Piece], list[Piece]]:
        """The laws of a mechanism that are findings of their own, the first always among them; and
        the others, which only refine.
        """
        own: list[Piece] = [ranked[0]]
        beside: list[Piece] = []
        for other in ranked[1:]:
            large = other.size**2 >= OWN_SHARE * piece.size**2 or _beside_constant(ranked[0], other)
            counts = _counts(other, ranked[0], self.after.value)
            apart = large and not _one_with(ranked[0], other) and counts
            (own if apart else beside).append(other)
        return own, beside

    def left_by(self, piece: Piece) -> Structure | None:
        """The remaining torque that the mechanism's variables predict; None where it has no
        variables.
        """
        if piece.mechanism not in STRUCTURED:
            return None
        # how dry friction acts at reversals (bristles, a soft simulator) refines its law
        turning = piece.mechanism != DRY
        return structure(self.parts.each, self.final.model, self.joint, [piece.mechanism], turning)

    def why_no_law(
        self, piece: Piece, ranked: Sequence[Piece], own: Sequence[Piece], left: Structure | None
    ) -> str:
        """The reason that no law describes a mechanism; empty where its first one does."""
        first, of_position = ranked[0], piece.mechanism == "position_torque"
        travel = max(rec[self.joint - 1].scale.position for rec in self.parts.fit.records)
        # a constant beside several laws over the position is a part of the curve that they form
        level = sum(all(get_effect(t.effect).constant for t in p.terms) for p in self.claimed)
        pieces = len(own) + (level if of_position and len(own) > 1 else 0)
        return why_curve(
            {
                LEAVES_MORE: self._leaves_more(piece, ranked, own, left),
                "laws that are no harmonics of one, or not told apart, draw a curve": (
                    of_position and is_curve(ranked, travel)
                ),
                "the level of its friction changes with time otherwise than it says": (
                    self._wanders(first)
                ),
                "the travel shows no whole period of it": (
                    part_of_a_wave(
                        first.terms[0], level + len(own) - 1, travel, self._of_a_turn(first)
                    )
                ),
                "it stands upon what it bends": self._bends_what_it_stands_on(first),
                f"{pieces} laws of one mechanism draw any curve": pieces >= CURVE,
            }
        )

    def _leaves_more(
        self,
        piece: Piece,
        ranked: Sequence[Piece],
        own: Sequence[Piece],
        left: Structure | None,
    ) -> bool:
        kind = [p for p in self.claimed if p.mechanism in kind_of(piece.mechanism)]
        # neither a larger law's error nor the known discrepancy speaks against this law
        allowed = math.hypot(max(may_leave(p) for p in kind), self.known)
        least = max(allowed, SIMULATORS_DIFFER)  # untouched recordings have to show this much
        # torque over its own variables that the law leaves when it is alone
        law = _plain(ranked[0])[0]
        beside = [
            p
            for p in ranked[1:]
            if not _beside_constant(ranked[0], p)
            and bends(self.final, _plain(p)[0], law, any(p is o for o in own))
            and sure(self.parts.test, p)
        ]
        bent = math.hypot(*(self._may_bend(law, p) for p in beside))
        z = max((p.evidence.z for p in beside), default=0.0)
        return surely_more(Structure(bent, 1.0, z), least) or (
            left is not None and self.after.high > least and surely_more(left, least)
        )

    def _may_bend(self, law: Claim, other: Piece) -> float:
        """The torque of another law of the mechanism that a function of this law's own variable may
        draw: a friction that varies a little with the place is not what a Stribeck curve leaves.
        """
        final = self.final
        part = drawn_by_its_variable(final.data, final.model, law.term, other.terms[0])
        return other.size * math.sqrt(part)

    def _of_a_turn(self, first: Piece) -> float:
        """The standard deviation of a law's period (rad) or order; infinite where the joint slides.
        """
        law = first.terms[0]
        key = "order" if "order" in get_effect(law.effect).names else "period"
        turns = self.given.joint_kind(self.joint) != "linear"
        return deviation(self.final.fit, law, key) if turns else math.inf

    def _wanders(self, first: Piece) -> bool:
        """Whether a law over time leaves a friction that changes with time in each recording by
        itself. (Its other variables do not show that: the friction's sum over time is right.)
        """
        law = get_effect(first.terms[0].effect)
        if law.over != "time" or first.mechanism not in FRICTION:
            return False
        left = wanders(self.parts.test, self.final.model, self.joint)
        # however many its numbers: the same in all recordings, they imitate nothing that differs
        return surely_more(left, max(LEFT_BY_A_LAW * first.size, SIMULATORS_DIFFER))

    def _bends_what_it_stands_on(self, first: Piece) -> bool:
        return (bool(self.bent) and first.mechanism in FRICTION) or (
            first.mechanism == FLUID and makes_another_grow(self.given, self.final, first.terms[0])
        )


def _beside_constant(first: Piece, other: Piece) -> bool:
    """Whether one of two laws of a mechanism is a constant, and the other is not: neither bends the
    other, or is a part of it.
    """
    one, two = (all(get_effect(e).constant for e in p.effects) for p in (first, other))
    return one != two


def _turns_a_known_one(
    parts: Parts, given: Model, final: Scored, piece: Piece, before: Size
) -> bool:
    """Whether a mechanism only changes a known dry friction at reversals and explains little of the
    missing torque. It is then a second law of that friction. Softness, as of bristles, makes
    friction smaller at reversals; a mechanism that makes it larger does not count.
    """
    joint = piece.terms[0].joint
    return (
        piece.size**2 < OWN_SHARE * before.value**2
        and bool(kept_laws(given, final.model, joint, DRY))
        and turns_round(parts, given, final, piece)
    )


def _ranked(
    test: Data, given: Model, final: Scored, piece: Piece, base: Scored, jobs: int
) -> list[Piece]:
    """The laws of a mechanism as single pieces, the one whose removal costs most first. Where they
    replace one another, so that no removal costs much, the one found first.
    """
    laws = [t for t in piece.terms if mechanism_of(t.effect) == piece.mechanism]
    if len(laws) == 1:
        return [replace(piece, terms=tuple(laws))]
    each = [piece_of(test, given, final, piece.mechanism, (t,), (base,), jobs) for t in laws]
    ranked = sorted(each, key=lambda p: -p.size)
    if ranked[0].size ** 2 < OWN_SHARE * piece.size**2:
        ranked.sort(key=lambda p: p is not each[0])
    return ranked


def _upon(ranked: Sequence[Piece], after: float) -> list[Piece]:
    """The laws in order, first the one that stands upon the largest, as a Stribeck curve does upon
    Coulomb friction: the two are one law. Bristles and other laws with a state of their own do not
    count.
    """
    largest = ranked[0]
    for other in ranked[1:]:
        effect = get_effect(other.terms[0].effect)
        if (
            any(stands_on(effect, name) for name in largest.effects)
            and not effect.hidden
            and _counts(other, largest, after)
        ):
            whole = replace(other, size=largest.size, evidence=largest.evidence)
            return [whole, *[p for p in ranked if p is not other]]
    return list(ranked)


def _one_with(first: Piece, other: Piece) -> bool:
    """Whether a second law belongs to the first: the first stands upon it, or both are couplings
    from the same other joint.
    """
    effect = get_effect(first.terms[0].effect)
    return effect.coupled or any(stands_on(effect, name) for name in other.effects)


def _counts(other: Piece, first: Piece, after: float) -> bool:
    """Whether a second law of a mechanism exceeds what is left and the error of the first."""
    more = other.size > math.hypot(after, LAW_ERROR * first.size)
    return more and other.log_e > 0 and other.evidence.z > PLAIN


def _plain(piece: Piece) -> list[Claim]:
    """The refinements of a piece, one for each law, with the size and evidence of the whole piece.
    """
    at = (piece.size, piece.evidence, piece.log_e)
    return [Claim(t.effect, piece.mechanism, t, *at, {}, (), (), ()) for t in piece.terms]
