"""Every kind of reference by name, and the one call that the terminal, the forms and scripts make.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from zendsp.errors import ReferenceError_
from zendsp.reference.core import Reference
from zendsp.reference.kind import Kind, Parameter
from zendsp.reference.kinds import (
    chirp,
    circle,
    from_file,
    line,
    lspb,
    multisine,
    point_to_point,
    prbs,
    step,
    swing,
    torque_law,
    trapezoid,
    triangle,
)
from zendsp.reference.machine import Machine, load_machine

KINDS: dict[str, Kind] = {
    module.KIND.name: module.KIND
    for module in (
        point_to_point, line, circle, lspb, trapezoid, triangle, step, chirp, multisine, prbs,
        torque_law, swing, from_file,
    )
}

HEADROOM = Parameter(
    "headroom",
    "float",
    "",
    0.7,
    "Share of the speed, acceleration and torque limits that the motion may use; the rest is the"
    " controller's.",
    0.05,
    1.0,
)


def make_reference(
    kind: str,
    machine: Machine | str,
    sample_time: float | None = None,
    headroom: float | str = 0.7,
    **parameters: Any,
) -> Reference:
    """Plan a reference of any kind; parameters left out take the kind's defaults for the machine.

    Parameters
    ----------
    kind : str
        A key of ``KINDS``.
    machine : Machine or str
        The machine, or its name.
    sample_time : float, optional
        s; the machine's where not given.
    headroom : float
        Share of the machine's speed, acceleration and torque limits that the motion is planned
        within, and checked against; what is left is for the controller. It goes into the
        reference's parameters.
    **parameters
        Numbers, lists, or the text of a form ("0.1, 0.2"); checked against type, bounds and
        choices.

    Returns
    -------
    Reference
        Not yet checked against the machine's limits: `Machine.check` or
        `save_reference` does that.

    Raises
    ------
    ReferenceError_
        Unknown kind or parameter, a value outside its bounds, or a motion that cannot be.

    Examples
    --------
    >>> make_reference("circle", "imi_planar", radius="0.1").duration
    4.5
    """
    if isinstance(machine, str):
        machine = load_machine(machine)
    if kind not in KINDS:
        raise ReferenceError_(f'no reference of kind "{kind}"; expected one of {", ".join(KINDS)}')
    chosen = KINDS[kind]
    if not chosen.fits(machine):
        raise ReferenceError_(
            f"{kind} is planned for machines of kind {', '.join(chosen.machine_kinds)};"
            f" {machine.name} is of kind {machine.kind}, for which there are"
            f" {', '.join(name for name, other in KINDS.items() if other.fits(machine))}"
        )
    unknown = set(parameters) - {p.name for p in chosen.parameters}
    if unknown:
        expected = ", ".join(p.name for p in chosen.parameters)
        raise ReferenceError_(
            f"{kind} has no parameter {', '.join(sorted(unknown))}; expected {expected}"
        )
    values = {
        p.name: None if value is None else p.parse(value, machine)
        for p in chosen.parameters
        for value in (parameters.get(p.name, p.default_for(machine)),)
    }
    share = float(HEADROOM.parse(headroom, machine))
    planned = chosen.make(machine.with_headroom(share), sample_time=sample_time, **values)
    unit = planned.unit if machine.unit == "rad" else machine.unit
    return replace(planned, parameters={**planned.parameters, "headroom": share}, unit=unit)
