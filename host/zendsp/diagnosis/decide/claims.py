"""The data of the decision: pieces of the proposed model, claims, and the decision of a joint."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from zendsp.diagnosis.decide.contract import NOT_SURELY, Reason, Rejected, Verdict
from zendsp.diagnosis.decide.thresholds import FALSE_DISCOVERIES
from zendsp.diagnosis.measure.bursts import Bursts
from zendsp.diagnosis.measure.discrepancy import Size
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.measure.likelihood import Scored
from zendsp.diagnosis.measure.structure import Structure
from zendsp.physics.effects import MECHANISMS, get_effect, laws_of
from zendsp.physics.model import Term

# the laws that write a mechanism down, as the effect files say
LAWS_OF: dict[str, tuple[str, ...]] = {mechanism: laws_of(mechanism) for mechanism in MECHANISMS}


def needed(joints: int) -> float:
    """The least logarithm of an e-value for a claim at one of ``joints`` joints. All mechanisms
    were tested at each joint, which the threshold accounts for.
    """
    return math.log(joints * len(LAWS_OF) / FALSE_DISCOVERIES)

RIGID = (0.0, 1.0)  # laws of a coupling that rigid bodies have: inertia and coriolis


@dataclass(frozen=True)
class Piece:
    """A mechanism at one joint of the proposed model, and the cost of removing it on untouched
    recordings.
    """

    mechanism: str
    terms: tuple[Term, ...]
    without: Scored
    size: float  # RMS torque that no other term can replace, as a part of the RMS torque
    evidence: Evidence
    log_e: float  # logarithm of the e-value
    lacks: bool = True  # its torque is missing without it
    # dry or fluid friction where the given model has none: every machine has both, so the
    # hypothesis was there before the data, and competes with no other for the false alarms
    expected: bool = False
    slowly: float = 0.0  # z of the evidence by slower observers, where the fit's are unsure
    why: str = field(default="", compare=False)  # reason that it is not claimed

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of its laws."""
        return tuple(t.effect for t in self.terms)


@dataclass(frozen=True)
class Claim:
    """One law of one mechanism: claimed, or a refinement. ``effect`` is "unknown" where no law
    describes the mechanism.
    """

    effect: str
    mechanism: str
    term: Term
    size: float
    evidence: Evidence
    log_e: float
    laws: dict[str, float]
    same: tuple[str, ...]
    replaces: tuple[str, ...]
    lost: tuple[Rejected, ...]  # rivals
    left: Structure | None = None  # torque left by the law over its own variables
    instead: Scored | None = None  # with a law of the same mechanism that is likelier
    # by which it predicts better than its neighbours, in standard deviations; infinite where it has
    # none, or was not compared
    ahead: float = math.inf
    # of its confidence, where doubted laws beside it may absorb what it leaves
    most: float = 1.0
    why: str = ""  # why its law is not named, where it is not

    @property
    def is_rigid_coupling(self) -> bool:
        """Whether it is a coupling that rigid bodies have too: by acceleration or speeds."""
        return self.effect == "coupling" and self.term.value("law") in RIGID

    @property
    def is_transmission(self) -> bool:
        """Whether it is a law of the transmission between motor and link."""
        return self.effect != "unknown" and get_effect(self.effect).family == "transmission"

    @property
    def is_constant(self) -> bool:
        """Whether its torque is constant, and so trivially a function of any variable."""
        return self.term.effect != "unknown" and get_effect(self.term.effect).constant


@dataclass(frozen=True)
class Known:
    """Torque that an earlier diagnosis of this machine left unexplained, as a part of the RMS
    torque: the whole, and the part that depends on the state.
    """

    all: float = 0.0
    of_state: float = 0.0


@dataclass(frozen=True)
class Near:
    """The likeliest law where none is claimed: the missing torque without it and with it, as parts
    of the RMS torque, the reason that it is not claimed, and the laws ``beside`` it.
    """

    effect: str
    before: float
    after: float
    why: str
    beside: tuple[str, ...] = ()


@dataclass(frozen=True)
class Decision:
    """The decision about one joint."""

    joint: int
    kind: Verdict
    claims: tuple[Claim, ...]
    refinements: tuple[Claim, ...]
    base: Scored
    final: Scored
    before: Size
    after: Size
    state: Structure  # the part of the remaining torque that any function of the state predicts
    # torque that the claims alone leave, without the refinements of the final model
    bare: Size
    alone: Scored  # the claims by themselves
    scale: float  # RMS torque of the recordings to test on, N m or N
    bursts: Bursts | None = None
    # times in the recordings of the fit at which the torque acts that the claims leave; where
    # nothing is claimed, times in all recordings of a push too small for a finding
    beside: Bursts | None = None
    known: Known = Known()  # discrepancy that the given model states for this machine
    # recordings explained by their own numbers but not by those of the others
    loads: tuple[str, ...] = ()
    # sentences: which numbers, or which zero, one recording has by itself
    differs: tuple[str, ...] = ()
    # hypotheses that were tried where nothing is claimed
    lost: tuple[Rejected, ...] = ()
    near: Near | None = None
    # effects and joint that recordings of the fit surely show and untouched ones do not
    doubted: tuple[tuple[str, int], ...] = ()
    # joints at which one force between links pulls, where it pulls at this one
    strap: tuple[int, ...] = ()
    searched: bool = True  # not where the search was ended before this joint
    given_up: Decision | None = None  # what was claimed before the whole machine spoke against it

    def drawn_by(self, claim: Claim) -> tuple[Term, ...]:
        """The laws that draw a claim in the improved model: its own, where it has one, and the
        refinements of its mechanism.
        """
        more = (c.term for c in self.refinements if c.mechanism == claim.mechanism)
        return tuple(t for t in (claim.term, *more) if t.effect != "unknown")


WORSE = "with it the whole machine predicts untouched recordings worse"


def unclaimed(decision: Decision, why: str = WORSE) -> Decision:
    """The decision without its claims, for this reason. The torque that they explained stays
    unexplained.
    """
    gained = 0.5 * (decision.base.deviance - decision.final.deviance)
    laws = [c.effect for c in decision.claims if c.effect != "unknown"]
    lost = (
        Rejected(effect, decision.joint, f"{NOT_SURELY}: {why}", gained, Reason.NEAR)
        for effect in laws
    )
    near = Near(laws[0], decision.before.value, decision.after.value, why) if laws else None
    return replace(
        decision,
        kind=Verdict.UNEXPLAINED,
        claims=(),
        refinements=(),
        final=decision.base,
        after=decision.before,
        bare=decision.before,
        alone=decision.base,
        lost=(*decision.lost, *lost),
        near=near,
        given_up=decision,
    )


def not_likelier(gain: float, least: float) -> str:
    """The reason that an effect is not claimed whose gain is below ``least``; both are
    log-likelihoods less its price.

    Examples
    --------
    >>> not_likelier(-3.0, 20.0)
    'no more likely than the calibrated model'
    >>> not_likelier(7.2, 20.0)
    'hardly more likely than the calibrated model: log-likelihood +7, and +20 at least is asked for'
    """
    if gain <= 0.0:
        return "no more likely than the calibrated model"
    return (
        f"hardly more likely than the calibrated model: log-likelihood {gain:+.0f}, and"
        f" {least:+.0f} at least is asked for"
    )


def shared(others: int) -> float:
    """The highest confidence of a claim beside so many ``others`` that explain as well."""
    return 0.5 + 0.5 / (1 + others)
