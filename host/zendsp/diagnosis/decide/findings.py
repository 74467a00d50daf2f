"""A finding, and what it is made of: the new terms of a fitted model, their numbers with units and
uncertainty, and the sentence that explains them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from zendsp.diagnosis.decide.contract import EstimateReport, FindingReport, Further
from zendsp.diagnosis.decide.headline import word_of
from zendsp.diagnosis.decide.thresholds import STEEP
from zendsp.diagnosis.measure.curve import DRY
from zendsp.diagnosis.measure.significance import INTEGRATION_ERROR, counterpart, whole
from zendsp.physics.calibration.fit import Fit
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.effects import get_effect, unit_of
from zendsp.physics.model import Model, Term
from zendsp.physics.term_numbers import chosen
from zendsp_protocol.views import with_std

# Uncertainty that does not shrink with longer recordings, added to the statistical one. Chosen,
# with INTEGRATION_ERROR, on 183 parameters of realities by others, of whose 90 % intervals two
# thirds had held the truth (docs/diagnosis.md, uncertainty):
# of the unexplained torque over the state: the part that may be along a law. Random torque is in
# the statistical uncertainty already; counted here too, it made the intervals of 54 numbers of
# another maker's machines 2.3 times too wide
ALONG = 0.3
# of a law's torque: other unexplained torque that counts as such, since the equations of machine
# and model differ (a friction that turns round otherwise). Without it 86 % of the 90 % intervals of
# 76 numbers of C machines held the truth, with it 89 %, and 94 % of those 54
UNLIKE = 0.01
CLOCK = 0.1  # of the sample time: how well the instants of reading and of the command are known


@dataclass(frozen=True)
class Estimate:
    """A parameter: value, standard deviation, unit (SI)."""

    value: float
    std: float
    unit: str


def number(estimate: Estimate) -> str:
    """Value ± standard deviation with unit, in significant digits."""
    return with_std(estimate.value, estimate.std, estimate.unit)


@dataclass(frozen=True)
class Finding:
    """One missing effect: where, how large, how sure, and what the recording cannot tell from it.

    Attributes
    ----------
    effect : str
        Name of the law (docs/effects.md); ``"unknown"`` where a mechanism acts without one.
    joint : int
        From 1.
    parameters : dict of str to Estimate
    confidence : float
        0 … 1: probability that this is the right effect.
    share : float
        0 … 1: the torque that is missing without the law after all else is fitted again, as a part
        of the torque that the calibrated model lacks; both as mean squares.
    indistinguishable : tuple of str
        Effects that explain the recording as well.
    replaces : tuple of str
        Terms of the given model that it replaces.
    sentence : str
    numbers : Further
        Further keys of the finding in report.json.
    mechanism : str
    laws : mapping of str to float
        Probabilities of the mechanism's laws.
    """

    effect: str
    joint: int
    parameters: dict[str, Estimate]
    confidence: float
    share: float
    indistinguishable: tuple[str, ...]
    replaces: tuple[str, ...]
    sentence: str
    numbers: Further = field(default_factory=Further)
    mechanism: str = ""
    # of the mechanism's laws: probabilities, given that it acts
    laws: Mapping[str, float] = field(default_factory=dict)

    @property
    def word(self) -> str:
        """The mechanism in plain words: both frictions where it is not surely one of them."""
        unsure = self.effect == "unknown" and self.confidence <= STEEP
        mechanism = "friction" if unsure and self.mechanism == DRY else self.mechanism
        return word_of(mechanism, (self.effect, *self.indistinguishable))

    @property
    def is_elsewhere(self) -> bool:
        """Whether it is a load of recordings that no model of the diagnosis describes."""
        return "recordings" in self.numbers and "body" in self.numbers

    def __repr__(self) -> str:
        return (
            f"<Finding {self.effect}, joint {self.joint} ({100 * self.confidence:.0f} %):"
            f" {self.sentence}>"
        )

    def as_dict(self) -> FindingReport:
        """For the report."""
        numbers: dict[str, EstimateReport] = {
            n: {"value": e.value, "std": e.std, "unit": e.unit} for n, e in self.parameters.items()
        }
        return {
            "effect": self.effect,
            "joint": self.joint,
            "parameters": numbers,
            "confidence": round(self.confidence, 4),
            "share": round(self.share, 4),
            "indistinguishable": list(self.indistinguishable),
            "replaces": list(self.replaces),
            "mechanism": self.mechanism,
            "laws": {n: round(p, 4) for n, p in self.laws.items()},
            "sentence": self.sentence,
            **self.numbers,
        }


def new_terms(given: Model, final: Model, joint: int) -> list[Term]:
    """The terms of the final model at a joint that the given model lacks, or holds fixed at another
    number.
    """
    had = list(given.at(joint))
    out = []
    for term in final.at(joint):
        old = next((t for t in had if t.effect == term.effect and _held(t, term)), None)
        if old is None:
            out.append(term)
        else:
            had.remove(old)
    return out


def _held(old: Term, new: Term) -> bool:
    """Whether another term has the same values for the numbers that one holds fixed."""
    return all(q.free or q.value == new.value(key, q.value) for key, q in old.parameters.items())


def estimates(
    fit: Fit,
    term: Term,
    kind: str,
    command_unit: str,
    torque_unit: str = "",
    *,
    left: float = 0.0,
    record: JointRecord | None = None,
) -> dict[str, Estimate]:
    """The parameters of a term with standard deviations and units; the Stribeck breakaway includes
    the Coulomb level. ``left``: RMS of the torque that the model leaves unexplained and that may be
    along the term's, as a part of it. ``record``: a recording of the joint, to include uncertainty
    that is not statistical.
    """
    effect = get_effect(term.effect)
    clock = CLOCK * record.sample_time if record and effect.family == "timing" else 0.0
    relative = math.hypot(INTEGRATION_ERROR, ALONG * min(left, 1.0))
    term = counterpart(fit.model.terms, term)
    row = next(i for i, t in enumerate(fit.model.terms) if t is term)
    out = {}
    for p in effect.parameters:
        if p.choices or (not p.fitted and effect.coupled):
            continue
        value = term.value(p.name, p.default or 0.0)
        if not p.fitted and not value:  # physics that is absent
            continue
        at = [
            i
            for i, h in enumerate(fit.handles)
            if h.place == "term" and h.index == row and h.key == p.name
        ]
        variance = float(fit.covariance[at[0], at[0]]) if at else 0.0
        if p.above:
            value, variance = _with_level(fit, term, p.above, value, variance, at)
        if p.name in ("phase", "angle"):
            value = math.remainder(value, 2 * math.pi)
        statistical = math.sqrt(max(variance, 0.0))
        of = whole(p.name, value, record.scale.position if record else math.inf)
        stays = math.hypot(relative * of, clock) if statistical > 0 else 0.0
        size = p.sizes[int(term.value("law"))] if p.sizes else p.size
        out[p.name] = Estimate(
            value, math.hypot(statistical, stays), unit_of(size, kind, command_unit, torque_unit)
        )
    return out


def _with_level(
    fit: Fit, term: Term, above: str, excess: float, variance: float, at: list[int]
) -> tuple[float, float]:
    """Value and variance of the sum of an excess and of the effect's size that it stands on."""
    size = get_effect(above).linear[0]
    for i, t in enumerate(fit.model.terms):
        if t.effect == above and t.joint == term.joint:
            where = [
                k
                for k, h in enumerate(fit.handles)
                if h.place == "term" and h.index == i and h.key == size
            ]
            if where and at:
                both = fit.covariance[np.ix_([at[0], where[0]], [at[0], where[0]])]
                variance = float(both.sum())
            return excess + t.value(size), variance
    return excess, variance


def percent(share: float) -> str:
    """A share in per cent with two digits, and all digits before the point.

    Examples
    --------
    >>> percent(0.0351), percent(0.994), percent(0.997), percent(1.25)
    ('3.5', '99', '100', '125')
    """
    return f"{100 * share:.2g}" if abs(share) < 0.995 else f"{100 * share:.0f}"


def sentence(term: Term, values: dict[str, Estimate]) -> str:
    """The effect's sentence with its numbers; a torque is called a force where the joint slides."""
    words: dict[str, str] = {n: number(e) for n, e in values.items()}
    words["joint"] = str(term.joint)
    if "order" in values:
        words["repeats"] = repeats(values["order"])
    if {"stiffness", "load_inertia"} <= set(values):
        words["rings"] = number(rings(values["stiffness"], values["load_inertia"]))
    if "amount" in values:
        amount = values["amount"]
        words["compared"] = (
            f"{number(replace(amount, value=abs(amount.value)))}"
            f" {'larger' if amount.value > 0 else 'smaller'}"
        )
    if "ratio" in values:
        ratio = values["ratio"]
        part = number(Estimate(100.0 * abs(ratio.value), 100.0 * ratio.std, "%"))
        words["relative"] = f"{part} {'more' if ratio.value > 0 else 'less'}"
    words |= {name: str(what) for name, what in chosen(term).items()}
    text = get_effect(term.effect).sentence.format(**words)
    slides = any(e.unit.split("/")[0] == "N" for e in values.values())
    return text.replace("torque", "force") if slides else text


def torque_word(unit: str) -> str:
    """The word for a torque: "force" where it is in N."""
    return "force" if unit == "N" else "torque"


def repeats(order: Estimate) -> str:
    """How often a wave repeats, in words: per turn, or over the travel.

    Examples
    --------
    >>> repeats(Estimate(13.9986, 0.0078, "1")), repeats(Estimate(100.0, 1.0, "rad/m"))
    ('13.9986 ± 0.0078 times a turn', 'every 62.83 ± 0.63 mm')
    """
    if not order.unit.endswith("/m"):
        return f"{number(order)} times a turn"
    period = 2e3 * math.pi / order.value
    return f"every {number(Estimate(period, period * order.std / order.value, 'mm'))}"


def rings(stiffness: Estimate, inertia: Estimate) -> Estimate:
    """The frequency, Hz, with which a load rings on a spring whose other side is held.

    Examples
    --------
    >>> number(rings(Estimate(1510.0, 3.0, "N m/rad"), Estimate(0.0382, 2e-4, "kg m²")))
    '31.643 ± 0.089 Hz'
    """
    hertz = math.sqrt(stiffness.value / inertia.value) / (2.0 * math.pi)
    off = math.hypot(stiffness.std / stiffness.value, inertia.std / inertia.value)
    return Estimate(hertz, 0.5 * hertz * off, "Hz")


def waves(each: Sequence[dict[str, Estimate]]) -> str:
    """Several waves in words, by how often they repeat; the first with its amplitude."""
    first, *others = each
    one = f"a wave of {number(first['amplitude'])}, {repeats(first['order'])}"
    more = " and ".join(repeats(values["order"]) for values in others)
    return one + (f", and {'others' if len(others) > 1 else 'another'} {more}" if more else "")
