"""The progress of a diagnosis as steps that never go back, even where part of the work is repeated.
"""

from __future__ import annotations

from collections.abc import Callable

from zendsp.diagnosis.progress import Progress, Said, Step


def in_steps(tell: Callable[[Said], None]) -> Progress:
    """A function that takes the sentences of a diagnosis and passes them on with their step: ``3/6
    searching: joint 1: screening the library``.
    """
    reached = Step.READING

    def say(said: Said) -> None:
        nonlocal reached
        reached = Step.READING if said.step is Step.ANEW else max(reached, said.step)
        name = reached.name.lower().replace("_", " ")
        tell(reached.says(f"{reached}/{max(Step)} {name}: {said}"))

    return say
