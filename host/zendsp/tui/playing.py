"""Plays a planned reference: one table of rows from the present position, through the motion, and
home.

A program can play references if it follows the convention of docs/references.md: a table ``ref``
with one column for each joint, and optionally ``ref_tau`` (torque that goes with the rows),
``use_table`` (set to 1), ``row_rate`` (rows a second), ``approach_time`` (kept short, since the
table begins at the present position) and ``hold`` (set where a run is aborted).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.errors import ReferenceError_
from zendsp.reference import Machine, Reference
from zendsp.tui.snapshot import Snapshot, Variable
from zendsp_protocol.states import VariableKind
from zendsp_protocol.texts import counted
from zendsp_protocol.values import Assignable

Floats = npt.NDArray[np.float64]
TABLES = ("ref", "reference", "q_ref", "qref")
# name, kind and type of what brings the reference to rest
HOLD = ("hold", VariableKind.PARAMETER, "bool")
APPROACH_S = 0.2  # of a program that blends into the table by itself
SETTLE_S = 0.5  # at rest before and after the motion
SAME = 1e-9  # of rounding: positions, rad, and sample times, relative, that are the same
AT_START = 1e-3  # rad: nearer, no move to the start is needed


@dataclass(frozen=True)
class Setup:
    """What the user has chosen for the next run."""

    cycles: int = 1
    preposition: bool = True
    go_home: bool = True
    share: float = 0.25  # of the speed limits, on the way there and back
    acquire: bool = True
    channels: tuple[str, ...] = ()  # empty: the usual ones of the program
    decimation: int = 1
    trigger: str = ""  # "" acquires the motion itself
    level: float = 0.0
    edge: str = "rising"
    pre_s: float = 0.0
    name: str = ""
    note: str = ""


@dataclass(frozen=True)
class Player:
    """How the loaded program takes references."""

    table: str
    columns: int
    capacity: int  # rows it holds
    torque_table: str  # "" where it takes no torque
    parameters: tuple[str, ...]  # those of use_table, row_rate, approach_time, hold that it has


@dataclass(frozen=True)
class Playlist:
    """The rows of the table, and the times of the phases."""

    rows: Floats  # (N, joints), rad
    torque: Floats  # (N, joints), N m; zero where the reference says nothing
    rate: float  # rows a second
    phases: tuple[tuple[str, float, float], ...]  # name, begin, end in s from the first row

    @property
    def duration(self) -> float:
        """From the first row to the last, s."""
        return (len(self.rows) - 1) / self.rate

    def phase(self, t: float) -> str:
        """The name of the phase at a time."""
        return next((name for name, begin, end in self.phases if begin <= t < end), "holding")

    @property
    def play(self) -> tuple[float, float]:
        """Begin and end of the motion itself, s from the first row."""
        begins = [b for name, b, _ in self.phases if name.startswith("play")]
        ends = [e for name, _, e in self.phases if name.startswith("play")]
        return min(begins), max(ends)


def find_player(variables: Sequence[Variable]) -> Player | None:
    """Return how the program takes references, or None if it cannot."""
    tables = [v for v in variables if v.kind == VariableKind.TABLE]
    chosen = next((v for name in TABLES for v in tables if v.name == name), None)
    if chosen is None:
        return None
    names = {v.name for v in variables if v.kind == VariableKind.PARAMETER}
    known: tuple[str, ...] = tuple(
        n for n in ("use_table", "row_rate", "approach_time") if n in names
    )
    known += tuple(v.name for v in variables if (v.name, v.kind, v.type) == HOLD)
    torque = next(
        (v.name for v in tables if v.name == f"{chosen.name}_tau" and v.columns == chosen.columns),
        "",
    )
    return Player(chosen.name, chosen.columns, chosen.length // chosen.columns, torque, known)


def present_position(snapshot: Snapshot, joints: int) -> Floats | None:
    """The position of the arm by its encoders, None where it is unknown.

    The program's own signals are not used: they are not computed before its first sample, nor while
    it is paused.
    """
    return np.array(snapshot.position) if len(snapshot.position) == joints else None


def smooth_move(
    start: Floats, goal: Floats, machine: Machine, share: float, period: float
) -> Floats:
    """Return rows from one position to another at rest at both ends, by the fifth-order polynomial.

    Its peak speed is 15/8 · distance/T and its peak acceleration 10/√3 · distance/T²; T is the time
    at which the slowest joint reaches the given share of its limits.
    """
    way = np.abs(goal - start)
    if not np.any(way > SAME):
        return start[None, :].copy()
    pace = machine.with_headroom(share).pace
    speed, acceleration = pace.speed, pace.acceleration
    time = float(
        max((1.875 * way / speed).max(), np.sqrt(5.7735 * way / acceleration).max(), 20.0 * period)
    )
    s = np.linspace(0.0, 1.0, round(time / period) + 1)[:, None]
    return np.asarray(start + (goal - start) * s**3 * (10.0 + s * (6.0 * s - 15.0)))


def make_playlist(
    references: Sequence[Reference], machine: Machine, start: Floats, setup: Setup, player: Player
) -> Playlist:
    """One table of all motions and the moves between them.

    Parameters
    ----------
    references : sequence of Reference
        Played one after the other; each is joined to the one before by a smooth move.
    machine : Machine
        Gives home and the limits of the moves between.
    start : ndarray, shape (joints,)
        Where the arm stands, rad.
    player : Player
        Where the rows do not fit into its table, every second, third … row is left out, since
        programs interpolate.

    Raises
    ------
    ReferenceError_
        No reference, wrong number of joints, a torque that the program cannot take, or the arm is
        not at its start and pre-positioning is off.
    """
    if not references:
        raise ReferenceError_("choose a reference first (o)")
    period = references[0].sample_time
    still = round(SETTLE_S / period)
    plan = _Rows(np.asarray(start, dtype=np.float64), period)
    for k, reference in enumerate(references):
        _require_playable(reference, player, period)
        first = reference.q[0]
        if plan.away(first) > AT_START and not setup.preposition:
            raise ReferenceError_(
                f"the arm is {plan.away(first):.3g} rad away from the start: switch"
                " pre-positioning on (a)"
            )
        move = smooth_move(plan.here, first, machine, setup.share, period)
        plan.add("pre-position", np.vstack((move, np.repeat(move[-1:], still, axis=0))))
        for cycle in range(setup.cycles):
            if plan.away(first) > AT_START:
                back = smooth_move(plan.here, first, machine, setup.share, period)
                plan.add("return to start", back)
            name = f"play {cycle + 1}/{setup.cycles}" if setup.cycles > 1 else "play"
            if len(references) > 1:
                name += f" of {k + 1}"
            plan.add(name, np.asarray(reference.q), reference.tau)
    if setup.go_home:
        rest = np.repeat(plan.here[None, :], still, axis=0)
        home = smooth_move(plan.here, machine.home, machine, setup.share, period)
        plan.add("go home", np.vstack((rest, home)))
    return plan.playlist(player.capacity)


def _require_playable(reference: Reference, player: Player, period: float) -> None:
    """Refuse a reference that the program cannot take, or that cannot be played together with the
    first.
    """
    if reference.joints != player.columns:
        raise ReferenceError_(
            f"the reference has {counted(reference.joints, 'joint')}, the program's table"
            f" {player.columns} columns"
        )
    if reference.mode == "torque" and not player.torque_table:
        raise ReferenceError_(
            "this reference is a torque law and the program has no table ref_tau: build one that"
            " has"
        )
    if abs(reference.sample_time - period) > SAME * period:
        raise ReferenceError_(
            "the chosen references have different sample times: play them one by one"
        )


class _Rows:
    """Collects the rows that are played one after the other, with their phases."""

    def __init__(self, start: Floats, period: float) -> None:
        self.here = start  # where the rows end
        self._period = period
        self._motion: list[Floats] = []
        self._torque: list[Floats] = []
        self._phases: list[tuple[str, float, float]] = []
        self._end_s = 0.0

    def away(self, place: Floats) -> float:
        """The distance of a position from the last row, rad."""
        return float(np.abs(place - self.here).max())

    def add(self, name: str, rows: Floats, torque: Floats | None = None) -> None:
        """Append rows as a phase of this name."""
        self._motion.append(rows)
        self._torque.append(np.zeros_like(rows) if torque is None else torque)
        begin, self._end_s = self._end_s, self._end_s + len(rows) * self._period
        self._phases.append((name, begin, self._end_s))
        self.here = rows[-1]

    def playlist(self, capacity: int) -> Playlist:
        """All rows, thinned where the table is too small; the last one is always among them."""
        rows, torque = np.vstack(self._motion), np.vstack(self._torque)
        thin = _thinning(len(rows), capacity, round(1.0 / self._period))
        if thin > 1:
            kept = np.r_[0 : len(rows) : thin, len(rows) - 1]
            rows, torque = rows[kept], torque[kept]
        return Playlist(rows, torque, 1.0 / (self._period * thin), tuple(self._phases))


def _thinning(rows: int, capacity: int, rate: int) -> int:
    """Of how many rows one is kept, so that they fit and the rows a second are a whole number."""
    thin = 1
    while rows // thin + 2 > capacity or rate % thin:
        thin += 1
        if thin > rate:
            raise ReferenceError_(
                f"{rows} rows do not fit into the program's table of {capacity}: play fewer cycles"
            )
    return thin


def player_values(player: Player, playlist: Playlist) -> dict[str, Assignable]:
    """Return the parameters to set before the table is played."""
    wanted: Mapping[str, Assignable] = {
        "use_table": True, "row_rate": round(playlist.rate), "approach_time": APPROACH_S,
        "hold": False,
    }
    return {name: wanted[name] for name in player.parameters}


def lead_time(player: Player) -> float:
    """The time from the start of the program to the first row, s."""
    return APPROACH_S if "approach_time" in player.parameters else 0.0
