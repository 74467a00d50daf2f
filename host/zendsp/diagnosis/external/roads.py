"""The two roads of a simulator that can only be called: as the rigid body that it is, or by its
output.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from zendsp.diagnosis.data.split import read_divided
from zendsp.diagnosis.decide.result import Diagnosis
from zendsp.diagnosis.external.blackbox import diagnose_simulator
from zendsp.diagnosis.external.rigid import BENT, Called, as_given, rigid
from zendsp.diagnosis.external.simulator import simulator_of
from zendsp.diagnosis.progress import Progress, Step
from zendsp.physics.model import Model
from zendsp.physics.term_numbers import kernel_model

Sources = tuple[Sequence[Any], Sequence[Any]]


def diagnose_called(
    sources: Sources,
    given: Model,
    jobs: int,
    tell: Progress,
    diagnose: Callable[[Sources, Model], Diagnosis],
) -> Diagnosis:
    """Find the physics that a user's own simulator leaves out.

    Parameters
    ----------
    sources : two sequences of path, Recording or Table
        To calibrate on, and to judge on (where none: the last third of each).
    given : Model
        Of ``kind = "python"`` or ``"fmu"``.
    jobs : int
        Processes of an FMU; a Python function is called in one thread.
    diagnose : callable
        The diagnosis of machines whose rigid body is known.
    """
    simulator = simulator_of(given, jobs)
    try:
        tell(Step.READING.says("asking the simulator whether it answers a torque at once"))
        called = rigid(read_divided(*sources, given)[0], given, simulator, tell)
        if called is None:
            return diagnose_simulator(
                sources[0], kernel_model(given), sources[1], simulator, progress=tell
            )
        found = diagnose(sources, replace(called.model, called=called))
        values = {k: q[0].value for k, q in found.improved.mechanism.items()}
        if not found.stopped and called.free and called.bent(values) > BENT:
            tell(Step.ANEW.says("once more, about the numbers that were found"))
            called.move_to({k: values[k] for k in called.free})
            found = diagnose(sources, replace(called.model, called=called))
        return _without_simulator(found, called)
    finally:
        simulator.close()


def _without_simulator(d: Diagnosis, called: Called) -> Diagnosis:
    note = f"black box: {called.calls} short simulations; bodies cannot be tried"
    return replace(
        d, given=as_given(d.given), calibrated=as_given(d.calibrated),
        improved=as_given(d.improved), notes=(*d.notes, note),
    )  # fmt: skip
