"""A run tried on a simulated twin of the target's machine, before the machine itself moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from zendsp.errors import LinkError
from zendsp.link.connect import local
from zendsp.link.target import Target
from zendsp.link.variables import plain
from zendsp_protocol import messages as m
from zendsp_protocol.lazily import Lazily

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
else:
    np = Lazily("numpy")

LONGEST_S = 120.0  # of real time, for the twin's run


@dataclass(frozen=True)
class Rehearsal:
    """What became of a run on the twin.

    Attributes
    ----------
    simulated : bool
        False: there is no simulation of this machine here, or it could not be finished; ``text`` says why.
    trip : Trip or None
        The limit that would be passed.
    text : str
        One sentence for people: which limit, when, by how much, and what to do.
    """

    simulated: bool
    trip: m.Trip | None
    text: str

    @property
    def good(self) -> bool:
        """Whether it was simulated, and no limit was passed."""
        return self.simulated and self.trip is None


def rehearse(
    target: Target,
    tables: Mapping[str, npt.ArrayLike],
    values: Mapping[str, Any],
    seconds: float,
    on_progress: Callable[[float], None] | None = None,
    timeout: float = LONGEST_S,
) -> Rehearsal:
    """Run the loaded program on a simulated twin: the same C code, parameters, limits, position and runtime, in fast time.

    The target itself is only read. The twin is the nominal simulation of the machine of that name; what a real machine has
    beyond it (and what a simulated one conceals) is not in it.

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
    from importlib import resources

    if not resources.files("zendsp_isr").joinpath("machines", f"{info.name}.c").is_file():
        return Rehearsal(False, None, f"it could not be simulated: there is no simulation of {info.name} here")
    rate, ticks = status.rate_hz, max(1, round(seconds * status.rate_hz))
    names = [v.name for v in target.variables().values() if v.kind == "parameter"]
    present = dict(target.read(names).values) if names else {}
    limits = target.limits()
    options = ["--no-realtime"]
    counts = np.ravel(np.asarray(plain(status.io.get("enc", ()))))
    for number, (joint, count) in enumerate(zip(info.joints, counts, strict=False), start=1):
        at = (float(count) - joint.zero_counts) / joint.counts_per_unit
        options += ["--machine-option", f"q{number}={at!r}"]
    if any(joint.command == "voltage" for joint in info.joints):
        options += ["--machine-option", "drive=voltage"]

    def tell(now: m.Status) -> None:
        if on_progress is not None:
            on_progress(min(now.tick / ticks, 1.0))

    with local(info.name, clock="fast", rate=rate, options=options) as twin:
        twin.download(dict(program.sources), program.flags)
        twin.set_limits(
            limits.position_min, limits.position_max, limits.speed_max, limits.torque_max, limits.command_max,
            limits.torque_clamp,
        )  # fmt: skip
        if present or values:
            twin.update(**{**present, **values})
        for name, rows in tables.items():
            twin.upload(name, rows)
        twin.start(ticks)
        try:
            ended = twin.wait(timeout, tell)
        except LinkError:
            return Rehearsal(False, None, f"its simulation took longer than {timeout:g} s: simulate a shorter motion")
    if ended.trip is None:
        return Rehearsal(True, None, f"simulated for {seconds:.1f} s: no limit is passed")
    return Rehearsal(True, ended.trip, _words(ended.trip, rate))


def _words(trip: m.Trip, rate: float) -> str:
    what = (trip.text or trip.reason).split(" (sample")[0]
    beyond = f", {100 * (abs(trip.value / trip.limit) - 1):.0f} % beyond it" if trip.limit else ""
    return (
        f"in the simulation {what} at {trip.tick / rate:.2f} s{beyond}: plan it slower or smaller (headroom), begin nearer "
        "to its start, or lower the gains"
    )
