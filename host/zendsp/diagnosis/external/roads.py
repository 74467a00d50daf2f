"""The two roads of a simulator that can only be called: as the rigid body that it is, or by its
output.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from zendsp.diagnosis.data.split import read_divided
from zendsp.diagnosis.decide.contract import listed
from zendsp.diagnosis.decide.result import Diagnosis
from zendsp.diagnosis.external.blackbox import diagnose_simulator
from zendsp.diagnosis.external.inner_body import of_what_was_asked, without_parts
from zendsp.diagnosis.external.numbers import as_given
from zendsp.diagnosis.external.rigid import BENT, Called
from zendsp.diagnosis.external.rigid_check import rigid
from zendsp.diagnosis.external.simulator import simulator_of
from zendsp.diagnosis.progress import Progress, Step
from zendsp.physics.model import Model
from zendsp.physics.term_numbers import kernel_model

ENDED_ANEW = (
    "The diagnosis was interrupted when it had begun once more; a wrong body inside the simulator"
    " was not asked for"
)

BY_OUTPUT = (
    "compared by its positions, and not asked for its torques, with which more can be told: the"
    " simulator {}"
)
STAYS = (
    "the simulator has friction of its own at {} that is more than what was found there, and no"
    " number of [mechanism.parameters] sets it: model.toml cannot take it away"
)

Sources = tuple[Sequence[Any], Sequence[Any]]


def diagnose_called(
    sources: Sources,
    given: Model,
    jobs: int,
    tell: Progress,
    so_far: bool,
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
    so_far : bool
        After Ctrl-C, return what was found until then, if anything.
    diagnose : callable
        The diagnosis of machines whose rigid body is known.
    """
    begin = time.perf_counter()
    simulator = simulator_of(given, jobs)
    try:
        tell(Step.READING.says("asking the simulator whether it answers a torque at once"))
        called = rigid(read_divided(*sources, given)[0], given, simulator, tell)
        if isinstance(called, str):
            d = diagnose_simulator(
                sources[0], kernel_model(given), sources[1], simulator, progress=tell
            )
            return replace(d, notes=(BY_OUTPUT.format(called), *d.notes))
        found = _found(called, so_far, lambda m: diagnose(sources, replace(m, called=called)))
        found = replace(found, seconds=time.perf_counter() - begin)  # of all that was asked
        return _without_simulator(found, called, given)
    finally:
        simulator.close()


def _found(
    called: Called, so_far: bool, diagnose: Callable[[Model], Diagnosis]
) -> Diagnosis:
    """The diagnosis: made once more about the numbers that were found, where torques are not
    linear, and with all numbers free, where laws of joints may be parts of a body.
    """

    def straight(model: Model) -> Diagnosis:
        called.begin(model)
        found = diagnose(model)
        values = {k: q[0].value for k, q in found.improved.mechanism.items()}
        if found.stopped or not called.free or called.bent(values) < BENT:
            return found
        called.tell(Step.ANEW.says("once more, about the numbers that were found"))
        called.move_to({k: values[k] for k in called.free})
        return diagnose(model)

    given = called.model
    first = straight(given)
    if first.stopped:
        return of_what_was_asked(first)
    try:
        return without_parts(first, given, straight, called.inside.names)
    except KeyboardInterrupt:
        if not so_far:
            raise
        first = of_what_was_asked(first)
        return replace(first, stopped=True, notes=(ENDED_ANEW, *first.notes))


def _without_simulator(d: Diagnosis, called: Called, given: Model) -> Diagnosis:
    """The diagnosis with models as files give them."""
    notes = [
        f"black box: {called.calls} simulations of a few rows, from the states of the motion;"
        " payloads and other bodies inside it cannot be tried"
    ]
    free = {k: [q.free for q in items] for k, items in given.mechanism.items()}

    def named(model: Model) -> Model:
        plain = as_given(called.inside.taken_from(model, given)[0])
        mechanism = {
            key: tuple(replace(q, free=f) for q, f in zip(items, free[key], strict=True))
            for key, items in plain.mechanism.items()
        }
        return replace(plain, mechanism=mechanism)

    if stays := called.inside.taken_from(d.improved, given)[1]:
        notes.append(STAYS.format(listed(stays)))
    return replace(
        d, given=named(d.given), calibrated=named(d.calibrated), improved=named(d.improved),
        notes=(*d.notes, *notes),
    )  # fmt: skip
