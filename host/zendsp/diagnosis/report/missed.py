"""What these recordings would not show even if it were large, without what the report itself
names.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.findings import Finding
from zendsp.diagnosis.decide.result import Detectable
from zendsp.physics.effects import get_effect, library


def missed(
    seen: Iterable[Detectable], told: Sequence[Finding], decisions: Sequence[Decision]
) -> tuple[Detectable, ...]:
    """The effects that may be missed even if they are large, without those that are not: a law that
    is found, or a refinement; one that cannot be told from a found one, or is the most like an
    unexplained torque; and those of a mechanism whose curve is drawn without a law, but for what
    changes with time. Of what a joint may have more than one, as waves of several orders, another
    is still missed.

    Parameters
    ----------
    seen : iterable of Detectable
    told : sequence of Finding
        Findings and refinements.
    decisions : sequence of Decision
    """
    near = {(e, d.joint) for d in decisions if d.near for e in (d.near.effect, *d.near.beside)}
    others = {(effect, f.joint) for f in told for effect in f.indistinguishable}
    drawn = {(f.mechanism, f.joint) for f in told if f.effect == "unknown"}

    def is_told(x: Detectable) -> bool:
        place = (x.effect, x.joint)
        found = [f for f in told if (f.effect, f.joint) == place]
        if x.effect in library() and get_effect(x.effect).repeatable:
            return any(_same(x.at, f) for f in found)
        curve = (x.mechanism, x.joint) in drawn and get_effect(x.effect).over != "time"
        return bool(found) or place in near | others or curve

    return tuple(x for x in seen if not (x.is_shown or is_told(x)))


def _same(at: Mapping[str, float], finding: Finding) -> bool:
    """Whether a found law has this shape, in the two digits that are told."""
    numbers = finding.parameters
    return all(n in numbers and f"{numbers[n].value:.2g}" == f"{v:.2g}" for n, v in at.items())
