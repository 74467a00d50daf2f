"""What a diagnosis says while it works: sentences, each with the step that it belongs to."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum


class Step(IntEnum):
    """The steps of a diagnosis, in their order."""

    ANEW = 0  # all of them follow once more
    READING = 1
    CALIBRATING = 2
    SEARCHING = 3
    ASSEMBLING = 4
    LOOKING_ON = 5
    REPORTING = 6

    def says(self, words: str) -> Said:
        """The sentence of this step."""
        said = Said(words)
        said.step = self
        return said


class Said(str):
    """A sentence of a step."""

    step: Step


Progress = Callable[[Said], None]
