"""A machine that is taken over where it stands: a loop bears the weight of every joint before
anything moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import e, pi
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import Refused, ZendspError
from zendsp.experiment.coarse import widest_bandwidth
from zendsp.experiment.gentle import CHANNELS, PEAK, PROGRAM, stride_of
from zendsp.experiment.lab import Bench
from zendsp.experiment.watch import BEARS
from zendsp.link.outside import positions
from zendsp.reference import Reference
from zendsp_protocol.messages import JointInfo
from zendsp_protocol.states import TripReason

Array = npt.NDArray[np.float64]

USUAL = 3.0  # Hz, bandwidth of joint_pd.c
WEIGHS = 0.5  # of its torque_max, the most that a joint is taken to weigh
ROOM = 0.5  # of the largest speed, and of the way to a limit: the most that is sunk by then
ASIDE = 0.02  # of its range, that a joint is to stand off its limits
SLOW, CALM = 0.1, 2.0  # of the largest speed; s: a move off a limit


def standing(bench: Bench, weight: Array | None = None, takes_model: bool = False) -> Array:
    """Hold every joint where it stands, for 0.2 s; then move those off their limits that stand
    beside one. From then on each recording begins with the torque that holds them.

    Parameters
    ----------
    bench : Bench
    weight : ndarray, optional
        What a model says that the joints weigh there, N m (N): the loop begins with it. Without it
        the loop is as stiff as a joint asks for that might weigh half of its torque_max and may not
        sink far or fast, and as sampling and encoders bear.
    takes_model : bool
        Whether the experiment takes a model.

    Returns
    -------
    ndarray
        Where they stand, rad or m.

    Raises
    ------
    Refused
        A joint sinks beyond a limit; the message says what to do.
    """
    infos = bench.machine.joints
    values = {"carried": weight.tolist()} if weight is not None else _stiffer(bench)
    bench.takes_over = None
    try:
        rec = bench.record("where_it_stands", PROGRAM, CHANNELS, seconds=0.2, **values)
    except ZendspError as error:
        trip = bench.target.status().trip if bench.target.alive else None
        if trip is None or trip.reason not in (TripReason.SPEED, TripReason.POSITION):
            raise
        model = ""
        if takes_model and weight is None:
            model = " Give a model of the machine (--model): the loop then begins with the weight."
        raise Refused(
            f"{infos[trip.joint - 1].name} sinks while the loop takes its weight over, which"
            f" nothing tells before: {trip.text}.{model} Put it where it weighs less and stands off"
            " its limits, or let the machine declare what it bears (speed_max, the inertia of the"
            " joint)"
        ) from error
    bench.takes_over = lambda: _again(bench)
    bench.remember(rec)
    return _off_limits(bench, np.atleast_1d(rec["q"][-1]), infos)


def _again(bench: Bench) -> None:
    """Hold the machine where it has come to stand while no loop held it, and remember by what."""
    again, bench.takes_over = bench.takes_over, None
    try:
        values: dict[str, Any] = dict(_stiffer(bench))
        rec = bench.record("where_it_stands_now", PROGRAM, CHANNELS, seconds=0.2, **values)
        bench.remember(rec)
    finally:
        bench.takes_over = again


def _stiffer(bench: Bench) -> dict[str, float]:
    """The bandwidth that a joint asks for of which no weight is known, where the usual one is not
    enough.

    A weight W that a loop takes over at once sinks by W / (J w^2), and at W / (e J w).
    """
    target, infos = bench.target, bench.machine.joints
    target.download(PROGRAM)
    J = np.atleast_1d(np.asarray(target["J"], dtype=np.float64))
    here = np.atleast_1d(np.asarray(positions(target.status(), infos), dtype=np.float64))
    w, wanted = 2.0 * pi * USUAL, USUAL
    for own, inertia, q in zip(infos, J, here, strict=False):
        # an inertia that is not declared is a guess, and its loop may not bear more
        if own.command == "none" or inertia == own.torque_max / 100.0:
            continue
        pull = WEIGHS * own.torque_max / inertia
        room = max(min(q - own.position_min, own.position_max - q), 1e-6)
        wanted = max(wanted, USUAL * pull / (e * w) / (ROOM * own.speed_max))
        wanted = max(wanted, USUAL * (pull / w**2 / (ROOM * room)) ** 0.5)
    most = min(BEARS * target.status().rate_hz / (4.0 * pi), widest_bandwidth(infos, J))
    return {"bandwidth": min(wanted, most)} if min(wanted, most) > USUAL else {}


def _off_limits(bench: Bench, place: Array, infos: Sequence[JointInfo]) -> Array:
    """Move joints slowly off the limits that they stand beside; where they then stand."""
    low, high = np.array([(j.position_min, j.position_max) for j in infos]).T
    finite = np.isfinite(high - low)
    aside = np.where(finite, ASIDE * np.where(finite, high - low, 0.0), 0.0)
    driven = np.array([j.command != "none" for j in infos])
    goal = np.where(driven, np.clip(place, low + aside, high - aside), place)
    way = goal - place
    if not way.any():
        return place
    pace = np.array([SLOW * j.speed_max for j in infos])
    seconds = max(CALM, float((PEAK * np.abs(way) / pace).max()))
    period = 1.0 / bench.target.status().rate_hz
    step = stride_of(seconds, period) * period
    s = np.linspace(0.0, 1.0, round(seconds / step))[:, None]
    share = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    motion = Reference(place + share * way, step, kind="point_to_point", machine="")
    rec = bench.record("off_the_limits", PROGRAM, CHANNELS, reference=motion)
    return np.atleast_1d(rec["q"][-1])
