"""The numbers with which a law is stated, and whether they show that it is no law."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from statistics import NormalDist

from zendsp.diagnosis.decide.assemble import Assembled
from zendsp.diagnosis.decide.claims import Claim, Decision
from zendsp.diagnosis.decide.findings import UNLIKE, Estimate, estimates
from zendsp.diagnosis.decide.patchwork import both_needed
from zendsp.diagnosis.decide.thresholds import (
    CLAIMED,
    LEFT_BY_A_LAW,
    PLAIN,
    SIMULATORS_DIFFER,
    SURE,
    UNLIKELY,
)
from zendsp.diagnosis.measure.likelihood import fit_scored
from zendsp.diagnosis.measure.significance import (
    counterpart,
    deviation,
    essence_of,
    essential_deviation,
)
from zendsp.physics.calibration.bounds import parameter_bounds
from zendsp.physics.calibration.fit import NEAR, Fit, joint_handles
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model


def numbers_of(
    given: Model, decision: Decision, whole: Assembled, claim: Claim, alone: bool = False
) -> dict[str, Estimate]:
    """The numbers of a law; ``alone``: from the recordings of the fit only."""
    joint = decision.joint
    other = min(decision.after.value, UNLIKE * claim.size)
    left = 0.0 if alone else math.hypot(decision.state.size, other) / max(claim.size, 1e-300)
    record = None if alone else whole.data.records[0][joint - 1]

    def of(fit: Fit) -> dict[str, Estimate]:
        return estimates(
            fit,
            claim.term,
            given.joint_kind(joint),
            given.actuator.command_unit,
            given.torque_unit(joint),
            left=left,
            record=record,
        )

    fit = (whole.fits if alone else whole.agreed)[joint]
    values = of(fit)
    if alone and get_effect(claim.effect).shape:
        for key in essence_of(claim.effect):
            spread = essential_deviation(fit, claim.term, key)
            values[key] = replace(values[key], std=min(spread, values[key].std))
    if (bare := _unrefined(decision, claim)) is not None:
        # at a drift's beginning, and over all of the recordings, are two numbers
        drifted = _drifts(whole.fits[joint].model, joint) and not _drifts(bare.model, joint)
        values = of(bare) if drifted else between(values, of(bare))
    if alone:
        return values
    # that a claimed law is not zero is shown by its evidence on held-out recordings
    shown = essence_of(claim.effect)
    return {
        key: replace(v, std=min(v.std, abs(v.value) / CLAIMED)) if key in shown else v
        for key, v in values.items()
    }


def agreed_on(
    whole: Assembled, claim: Claim, joint: int, values: Mapping[str, Estimate]
) -> float:
    """The probability of ``one_number``, with the shape of the law held. A weight whose angle is
    open shares its size with the model's own weight; the recordings may agree on it even so.
    """
    if get_effect(claim.effect).shape == "angle":
        fit, own = whole.agreed[joint], dict(values)
        for key in essence_of(claim.effect):
            spread = essential_deviation(fit, claim.term, key)
            of_shape = deviation(fit, claim.term, key) ** 2 - spread**2
            least = math.sqrt(max(own[key].std ** 2 - of_shape, spread**2))
            own[key] = replace(own[key], std=min(least, own[key].std))
        values = own
    return one_number(claim.effect, values)


def one_number(effect: str, values: Mapping[str, Estimate]) -> float:
    """The probability that the recordings agree on the characteristic number of a law. Where the
    number is known only to a third, they follow another curve.
    """
    size = next((values[key] for key in essence_of(effect) if key in values), None)
    if size is None:
        return 1.0
    return NormalDist().cdf(abs(size.value) / max(size.std, 1e-300) - SURE)


def may_be_nothing(effect: str, values: Mapping[str, Estimate]) -> bool:
    """Whether a characteristic number of a law lies within two standard deviations of zero; for a
    law with a number for each direction, their difference.
    """
    if get_effect(effect).symmetric and len(values) == 2:
        up, down = values.values()
        return abs(up.value - down.value) < PLAIN * math.hypot(up.std, down.std)
    return any(
        abs(values[key].value) < PLAIN * values[key].std
        for key in essence_of(effect)
        if key in values
    )


def runs_out(effect: str, values: Mapping[str, Estimate]) -> bool:
    """Whether a characteristic number of a law lies within two standard deviations of the end of
    its meaning. A drifting friction exists before and after; one that falls by 95 % is gone.
    """
    parameters = {p.name: p for p in get_effect(effect).parameters if p.limits is None}
    return any(
        bound != 0.0 and abs(values[key].value - bound) < PLAIN * values[key].std
        for key in essence_of(effect)
        if key in values and key in parameters
        for bound in (parameters[key].lower, parameters[key].upper)
    )


def at_ends(effect: str, values: Mapping[str, Estimate], record: JointRecord) -> str:
    """A sentence on the numbers of a law that stand where its search ends in such recordings, at
    limits that are not those of their meaning; empty where there are none.
    """
    said = []
    for p in get_effect(effect).parameters:
        if p.limits is None or p.name not in values:
            continue
        value = values[p.name].value
        for end, own, way in zip(
            parameter_bounds(effect, p.name, record),
            (p.lower, p.upper),
            ("smaller", "larger"),
            strict=True,
        ):
            if end not in (0.0, own) and math.isclose(value, end, rel_tol=NEAR):
                said.append(
                    f" Its {p.name.replace('_', ' ')} stands where its search ends in these"
                    f" recordings: the true one may be {way}, and the ± does not count that."
                )
    return "".join(said)


def is_no_law(effect: str, values: Mapping[str, Estimate], sure: float) -> bool:
    """Whether a claimed law only refines the fit, by its numbers. ``sure``: the probability that
    the recordings agree on them (``one_number``); no law less sure than a third is stated.
    """
    doubted = sure < UNLIKELY and not get_effect(effect).common
    return doubted or may_be_nothing(effect, values) or runs_out(effect, values)


def _unrefined(decision: Decision, claim: Claim) -> Fit | None:
    """The law fitted without the refinements of its own mechanism, which may have absorbed a part
    of its numbers; laws that every machine has stay. None where there are no refinements, where the
    law needs them, or where they are couplings from the same joint. A refinement stays if the law
    would leave too much without it. All stay where together they leave nothing and the claims alone
    surely something; except a lag that is not needed beside a delay, since the two stand in for one
    another.
    """
    final, joint = decision.final, decision.joint
    all_needed = decision.after.value < SIMULATORS_DIFFER <= decision.bare.low
    effect = get_effect(claim.effect)
    if effect.needs or effect.coupled or not any(claim is c for c in decision.claims):
        return None
    beside = [
        counterpart(final.model.terms, r.term)
        for r in decision.refinements
        if _takes_part(claim, r)
        and r.size < LEFT_BY_A_LAW * claim.size
        and not both_needed(final, claim, r)
        and not (all_needed and get_effect(r.effect).family != "timing")
    ]
    if not beside:
        return None
    model = final.model.with_terms(
        tuple(t for t in final.model.terms if not any(t is b for b in beside))
    )
    return fit_scored(
        final.data, model, joint_handles(final.data, model, joint), (joint,), jobs=1, rounds=1
    ).fit


def _takes_part(claim: Claim, refinement: Claim) -> bool:
    """Whether a refinement may have a part of a law's numbers: one of the same mechanism that
    stands by itself, or a factor on all friction of the joint.
    """
    effect = get_effect(refinement.effect)
    if effect.site == "scale":
        return claim.mechanism in ("dry_friction", "fluid_friction")
    return refinement.mechanism == claim.mechanism and not (effect.needs or effect.common)


def _drifts(model: Model, joint: int) -> bool:
    """Whether a factor that changes in time is on all friction of a joint."""
    return any(get_effect(t.effect).site == "scale" for t in model.at(joint))


def between(refined: dict[str, Estimate], alone: dict[str, Estimate]) -> dict[str, Estimate]:
    """The numbers of the law alone, where refinements changed them beyond their uncertainty. Half
    of the change is added to the uncertainty.
    """
    out = dict(refined)
    for name, other in alone.items():
        change = abs(other.value - refined[name].value)
        if change > PLAIN * refined[name].std:
            std = max(refined[name].std, math.hypot(other.std, 0.5 * change))
            out[name] = replace(other, std=std)
    return out
