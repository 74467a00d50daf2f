"""What a simulated machine conceals: its seal before the diagnosis, and the truth after it."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import dataclass
from typing import TypedDict

from zendsp.errors import LinkError, Refused
from zendsp.link.requests import Part
from zendsp_protocol import messages as m
from zendsp_protocol.texts import of_sliding


class TrueValue(TypedDict):
    """A parameter of a concealed effect: a number with its unit, or the name of a coupling's law.
    """

    value: float | str
    unit: str


class TrueEffect(TypedDict):
    """What is concealed at one joint (1-based)."""

    effect: str
    joint: int
    parameters: dict[str, TrueValue]


@dataclass(frozen=True)
class Truth:
    """What a machine concealed, once it is revealed.

    Attributes
    ----------
    effects : tuple of TrueEffect
        In the form of a report's findings.
    source : str
        "seed:17", the name of a file, or "none".
    friction : str
        "full" or "plain", see docs/machines_simulated.md.
    sha256 : str
        Seal of the record.
    tick : int
        Sample at which it was told.
    """

    effects: tuple[TrueEffect, ...]
    source: str
    friction: str
    sha256: str
    tick: int


def _at_its_joint(effect: TrueEffect, slides: Collection[int]) -> TrueEffect:
    """The effect in the units of its joint: the record has those of a joint that turns. ``slides``:
    the joints (1-based) that do.
    """
    if effect["joint"] not in slides:
        return effect
    parameters: dict[str, TrueValue] = {
        name: {"value": p["value"], "unit": of_sliding(p["unit"])}
        for name, p in effect["parameters"].items()
    }
    return {**effect, "parameters": parameters}


class Concealment(Part):
    """What the target's simulated machine conceals: physics that no model has."""

    def seal(self) -> str:
        """SHA-256 of what the machine conceals, asked of the target and kept for the reveal."""
        answer: m.Seal = self.request("seal")
        return answer.sha256

    def reveal(self) -> Truth:
        """What the machine conceals, asked of the target after the diagnosis and checked against
        its seal.

        Returns
        -------
        Truth
            Effects with their parameters.

        Raises
        ------
        LinkError
            The record is not the one that was sealed.
        """
        answer: m.Revealed = self.request("reveal")
        import hashlib

        if hashlib.sha256(answer.record.encode()).hexdigest() != answer.sha256:
            raise LinkError(
                f"the target revealed a record that does not fit its seal {answer.sha256[:12]}…: do"
                " not trust it, start the target again"
            )
        record = json.loads(answer.record)
        slides = self._sliding()
        effects = tuple(_at_its_joint(effect, slides) for effect in record["effects"])
        return Truth(
            effects, record["source"], record["friction"], answer.sha256, answer.tick
        )

    def _sliding(self) -> set[int]:
        """The joints (1-based) that slide; none where no program tells the machine yet."""
        try:
            machine: m.MachineInfo = self.request("machine")
        except Refused:
            return set()
        return {k for k, joint in enumerate(machine.joints, 1) if joint.unit == "m"}
