"""Whether a reference is one for the machine that is to play it."""

from __future__ import annotations

from collections.abc import Sequence

from zendsp.errors import ReferenceError_
from zendsp.reference.core import Reference
from zendsp_protocol.texts import counted


def check_fits(reference: Reference, machine: str, units: Sequence[str]) -> str:
    """A sentence to be told where a reference was planned for another machine or in another unit;
    empty where it was planned for this one.

    Parameters
    ----------
    reference : Reference
    machine : str
        Name of the machine that is to play it.
    units : sequence of str
        Of the position of each joint: "rad" or "m".

    Raises
    ------
    ReferenceError_
        It cannot be meant: another number of joints, or another machine's in another unit.

    Examples
    --------
    >>> import numpy as np
    >>> check_fits(Reference(np.zeros(3), 0.001, machine="pendulum"), "pendulum", ["rad"])
    ''
    >>> check_fits(Reference(np.zeros(3), 0.001, machine="pendulum"), "mine", ["rad"])
    'the reference was planned for pendulum, not for mine: its limits were those of pendulum'
    """
    another = reference.machine not in ("", machine)
    planned = f" was planned for {reference.machine} and" if another else ""
    if reference.joints != len(units):
        raise ReferenceError_(
            f"the reference{planned} has {counted(reference.joints, 'joint')}, {machine} has"
            f" {len(units)}: choose one that was planned for {machine}"
        )
    own = " or ".join(u for u in ("rad", "m") if u in units)
    if reference.unit != own and another:
        raise ReferenceError_(
            f"the reference{planned} is in {reference.unit}, {machine} is in {own}: choose one"
            f" that was planned for {machine}"
        )
    if reference.unit != own:
        return (
            f"the reference says {reference.unit}, {machine} is in {own}: its numbers are taken as"
            f' they are (unit="{own}" in the reference says that they are meant so)'
        )
    if another:
        return (
            f"the reference was planned for {reference.machine}, not for {machine}: its limits"
            f" were those of {reference.machine}"
        )
    return ""
