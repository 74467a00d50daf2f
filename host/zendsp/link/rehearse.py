"""Tries a run on a simulated twin of the target's machine, before the machine itself moves."""

from __future__ import annotations

import socket
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from zendsp.errors import LinkError
from zendsp.link.connect import local
from zendsp.link.outside import positions
from zendsp.link.target import Target
from zendsp_protocol import messages as m
from zendsp_protocol.lazily import Lazily
from zendsp_protocol.states import VariableKind
from zendsp_protocol.values import Assignable

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from zendsp.recording import Recording
else:
    np = Lazily("numpy")

LONGEST_S = 120.0  # of real time, for the twin's run
MOST_ROWS = 200_000  # of the twin's record, from which the peaks are read
SPEED_S = 0.01  # over which the runtime measures speed


@dataclass(frozen=True)
class Peak:
    """The largest value that one quantity of a joint reached on the twin, and its limit, in the
    joint's own units.
    """

    quantity: str  # "torque" | "force" | "speed"
    joint: int  # from 1
    value: float
    limit: float
    unit: str

    @property
    def share(self) -> float:
        """The value as a fraction of the limit that trips."""
        return abs(self.value / self.limit)

    def __str__(self) -> str:
        return (
            f"{self.quantity} {abs(self.value):.3g} of {self.limit:.3g} {self.unit} (joint"
            f" {self.joint}, {100 * self.share:.0f} %)"
        )


@dataclass(frozen=True)
class Rehearsal:
    """The outcome of a run on the simulated twin.

    Attributes
    ----------
    simulated : bool
        False: there is no simulation of this machine here, or it could not be finished; ``text``
        says why.
    trip : Trip or None
        The limit that would be passed.
    text : str
        One sentence for people: which limit, when, by how much, and what to do; or how far from the
        limits it stayed.
    peaks : tuple of Peak
        Of each quantity that has a limit, the joint that came nearest to it; empty where the run
        tripped.
    """

    simulated: bool
    trip: m.Trip | None
    text: str
    peaks: tuple[Peak, ...] = ()

    @property
    def good(self) -> bool:
        """Whether the run was simulated and stayed within all limits."""
        return self.simulated and self.trip is None


def rehearse(
    target: Target,
    tables: Mapping[str, npt.ArrayLike],
    values: Mapping[str, Assignable],
    seconds: float,
    on_progress: Callable[[float], None] | None = None,
    timeout: float = LONGEST_S,
) -> Rehearsal:
    """Run the loaded program on a simulated twin: the same C code, parameters, limits, position and
    runtime, faster than real time.

    The target itself is only read. The twin is the nominal simulation of the machine of that name,
    or, for a target on this computer, of the same MuJoCo model. It lacks what a real machine has
    beyond the model, and what a simulated machine conceals.

    Parameters
    ----------
    target : Target
        With a program loaded.
    tables : mapping of name to rows
        What the program will be sent, in this order.
    values : mapping of name to value
        Parameters that will be set; the others have their present values.
    seconds : float
        Of the run, s.
    on_progress : callable, optional
        Called with the share done, 0 … 1.
    timeout : float
        Of real time, s.

    Returns
    -------
    Rehearsal
    """
    info, status, program = target.machine(), target.status(), target.program()
    machine = _simulation_of(info, target.info.hostname)
    if not machine:
        return Rehearsal(False, None, f"there is no simulation of {info.name} here")
    rate, ticks = status.rate_hz, max(1, round(seconds * status.rate_hz))
    names = [v.name for v in target.variables().values() if v.kind == VariableKind.PARAMETER]
    present = dict(target.read(names).values) if names else {}
    limits = target.limits()
    options = _as_it_stands(info, status)

    def tell(now: m.Status) -> None:
        if on_progress is not None:
            on_progress(min(now.tick / ticks, 1.0))

    with local(machine, clock="fast", rate=rate, options=options) as twin:
        twin.download(dict(program.sources), program.flags)
        twin.set_limits(
            limits.position_min, limits.position_max, limits.speed_max, limits.torque_max,
            limits.command_max, limits.torque_clamp,
        )
        if present or values:
            twin.update(None, **{**present, **values})
        for name, rows in tables.items():
            twin.upload(name, rows)
        decimation = 1 + ticks // MOST_ROWS
        twin.acquire_configure(["cmd", "enc"], seconds, decimation)
        twin.acquire_start()
        twin.programs.begin(ticks)
        try:
            ended = twin.wait(timeout, tell)
        except LinkError:
            return Rehearsal(
                False, None,
                f"its simulation took longer than {timeout:g} s: try a shorter motion",
            )
        peaks = _peaks(twin.acquire_load(), info.joints, limits) if ended.trip is None else ()
    if ended.trip is None:
        most = f": {', '.join(map(str, peaks))}" if peaks else ""
        return Rehearsal(
            True, None, f"no limit is passed in the simulation of {seconds:.1f} s{most}", peaks
        )
    return Rehearsal(
        True, ended.trip,
        f"{passed(ended.trip, rate)}: plan it slower or smaller (headroom), begin nearer to its"
        " start, or lower the gains",
    )


def _simulation_of(info: m.MachineInfo, hostname: str) -> str:
    """Machine of the twin: the target's own MuJoCo model where its file is here, else the shipped
    simulation of that name; empty where there is none.
    """
    from importlib import resources
    from importlib.util import find_spec

    from zendsp_isr.parts import is_model

    if info.model:
        if not is_model(info.model):  # nothing that would be compiled and run
            return ""
        here = hostname == socket.gethostname() and Path(info.model).is_file()
        return info.model if here and find_spec("mujoco") is not None else ""
    shipped = resources.files("zendsp_isr").joinpath("machines", f"{info.name}.c")
    return info.name if shipped.is_file() else ""


def _as_it_stands(info: m.MachineInfo, status: m.Status) -> list[str]:
    """Options by which the twin begins at the machine's position."""
    options = ["--no-realtime"]
    for text in info.options:
        options += ["--machine-option", text]
    for number, at in enumerate(positions(status, info.joints), start=1):
        options += ["--machine-option", f"q{number}={at!r}"]
    if any(joint.command == "voltage" for joint in info.joints):
        options += ["--machine-option", "drive=voltage"]
    return options


def _peaks(record: Recording, joints: Sequence[m.JointInfo], limits: m.Limits) -> tuple[Peak, ...]:
    """The peaks as the runtime measures them: torque of the command, and speed from encoder counts
    over 10 ms.
    """
    cmd, enc = np.atleast_2d(record["cmd"].T).T, np.atleast_2d(record["enc"].T).T
    window = max(1, round(SPEED_S / record.sample_time))
    moved = (enc[window:] - enc[:-window]) / (window * record.sample_time)
    found: dict[str, list[Peak]] = {}
    for j, joint in enumerate(joints):
        for quantity, values, scale, limit in (
            (
                "force" if joint.unit == "m" else "torque",
                cmd[:, j],
                joint.mv_per_torque,
                limits.torque_max[j],
            ),
            ("speed", moved[:, j], joint.counts_per_unit, limits.speed_max[j]),
        ):
            if scale != 0.0 and np.isfinite(limit) and limit > 0.0 and len(values):
                unit = (
                    f"{joint.unit}/s"
                    if quantity == "speed"
                    else {"force": "N", "torque": "N m"}[quantity]
                )
                value = values[np.argmax(np.abs(values))] / scale
                found.setdefault(quantity, []).append(
                    Peak(quantity, j + 1, float(value), limit, unit)
                )
    return tuple(max(peaks, key=lambda peak: peak.share) for peaks in found.values())


def passed(trip: m.Trip, rate: float) -> str:
    """Which limit was passed on the twin, when and by how much."""
    beyond = f", {100 * (abs(trip.value / trip.limit) - 1):.0f} % beyond it" if trip.limit else ""
    return f"in the simulation {trip.cause or trip.reason} at {trip.tick / rate:.2f} s{beyond}"
