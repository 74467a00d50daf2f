"""How far a diagnosis is, by the sentences that it says: steps that only go forward, whatever is
done again within one.
"""

from __future__ import annotations

import re
from collections.abc import Callable

# a step by what is said in it; of two that match, the later one here
STEPS = (
    ("reading", r"^(reading the|smoothing) "),
    ("calibrating", r"^(bodies: |calibrating |looking at what|pushing each)|calibrating the given"),
    ("searching", r"^joint \d+: (?!calibrating)|: fitting "),
    (
        "assembling",
        r"^(fitting the improved|fitting all|fitting \d+ effects|the links that|looking for what"
        r"|once more)|upon what passes fast",
    ),
    ("looking on", r"^(asking |proposing )"),
    ("reporting", r"^(writing the report|drawing the )"),
)
ANEW = r"^running the separating experiment"  # all of it follows once more


def step_of(sentence: str) -> int:
    """Return the number of the step in which this is said, from 1; 0 where any may say it."""
    return max((k for k, (_, said) in enumerate(STEPS, 1) if re.search(said, sentence)), default=0)


def in_steps(tell: Callable[[str], None]) -> Callable[[str], None]:
    """Return what takes the sentences of a diagnosis and tells them with their step: ``3/6
    searching: joint 1: screening the library``.
    """
    reached = 1

    def say(sentence: str) -> None:
        nonlocal reached
        reached = 1 if re.search(ANEW, sentence) else max(reached, step_of(sentence))
        tell(f"{reached}/{len(STEPS)} {STEPS[reached - 1][0]}: {sentence}")

    return say
