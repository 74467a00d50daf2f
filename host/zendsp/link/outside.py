"""The positions of the joints, and those outside their limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from zendsp.link.variables import plain
from zendsp_protocol import messages as m

BACK = "home the machine (zendsp drive home) or start a program that moves it inward"


@dataclass(frozen=True)
class Outside:
    """A joint that stands outside its position limits; as text, one sentence."""

    what: str  # which joint, and by how much
    remedy: str  # what brings it back

    def __str__(self) -> str:
        return f"{self.what}: {self.remedy}"


def positions(status: m.Status, joints: Sequence[m.JointInfo]) -> tuple[float, ...]:
    """The position of each joint by its encoder, rad or m, whether or not a program runs."""
    counts = plain(status.io.get("enc", ()))
    counts = counts if isinstance(counts, list | tuple) else [counts]
    return tuple(
        (float(count) - joint.zero_counts) / joint.counts_per_unit
        for count, joint in zip(counts, joints, strict=False)
    )


def outside(
    status: m.Status, joints: Sequence[m.JointInfo], limits: m.Limits
) -> tuple[Outside, ...]:
    """The joints that stand outside their position limits. None for a machine that is not homed,
    whose positions are unknown.
    """
    if not status.homed:
        return ()
    first = "acknowledge (zendsp drive acknowledge), then " if status.trip else ""
    found = []
    for q, joint, least, most in zip(
        positions(status, joints), joints, limits.position_min, limits.position_max, strict=False
    ):
        if not least <= q <= most:
            limit = least if q < least else most
            what = (
                f"{joint.name} is {abs(q - limit):.2g} {joint.unit} outside its limit of"
                f" {limit:.4g} {joint.unit}"
            )
            found.append(Outside(what, f"{first}{BACK}; it may go no farther out"))
    return tuple(found)
