"""The progress of a diagnosis: sentences, each with its step."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum


class Step(IntEnum):
    """The steps of a diagnosis, in their order."""

    ANEW = 0  # all steps begin again
    READING = 1
    CALIBRATING = 2
    SEARCHING = 3
    ASSEMBLING = 4
    LOOKING_ON = 5
    REPORTING = 6

    def says(self, words: str) -> Said:
        """A sentence of this step."""
        said = Said(words)
        said.step = self
        return said


class Said(str):
    """A sentence of a step."""

    step: Step


Progress = Callable[[Said], None]
