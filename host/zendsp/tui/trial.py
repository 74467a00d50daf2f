"""Tries the next run on a simulated twin as soon as its plan is known; the result is shown before
Start.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zendsp.errors import Refused, ZendspError
from zendsp.link import Rehearsal
from zendsp.link.background import background
from zendsp.reference import Machine, Reference
from zendsp.tui.playing import (
    Floats,
    Player,
    Playlist,
    Setup,
    find_player,
    lead_time,
    make_playlist,
    player_values,
    present_position,
)
from zendsp.tui.port import Port
from zendsp.tui.snapshot import Snapshot
from zendsp_protocol.states import VariableKind
from zendsp_protocol.values import Assignable

STILL_S = 0.5  # that a plan must stay the same before it is tried
AGAIN_S = 10.0  # after one that failed
CLOSE = 0.01  # rad: of an arm that stands where it stood
REST_S = 0.1  # after the last row


@dataclass(frozen=True)
class Plan:
    """All that decides how a run goes."""

    program: str
    parameters: Mapping[str, Assignable]
    player: Player
    playlist: Playlist
    values: Mapping[str, Assignable]
    lead: float

    @property
    def seconds(self) -> float:
        """The duration of the whole run, s."""
        return self.lead + self.playlist.duration + REST_S

    @property
    def tables(self) -> dict[str, Floats]:
        """The tables that the program is sent, in this order: the motion begins when `ref` switches
        over.
        """
        torque = (
            {self.player.torque_table: self.playlist.torque} if self.player.torque_table else {}
        )
        return {**torque, self.player.table: self.playlist.rows}

    def same(self, other: Plan) -> bool:
        """Whether the other plan gives the same run."""
        if (self.program, self.parameters, self.values, self.lead) != (
            other.program, other.parameters, other.values, other.lead,
        ):
            return False
        mine, theirs = self.playlist, other.playlist
        if mine.rows.shape != theirs.rows.shape or mine.rate != theirs.rate:
            return False
        return bool(
            np.allclose(mine.rows, theirs.rows, 0.0, CLOSE)
            and np.allclose(mine.torque, theirs.torque)
        )


def make_plan(
    snapshot: Snapshot, references: Sequence[Reference], machine: Machine, setup: Setup
) -> Plan:
    """The plan of a run from the present position.

    Raises
    ------
    Refused
        The program cannot play tables, or nobody knows where the arm stands.
    ReferenceError_
        The motions cannot be joined.
    """
    player = find_player(snapshot.variables)
    here = present_position(snapshot, machine.joints)
    if player is None or here is None:
        raise Refused("the loaded program cannot play a table: see the preflight list")
    playlist = make_playlist(references, machine, here, setup, player)
    values = player_values(player, playlist)
    now = {
        v.name: np.asarray(snapshot.values[v.name]).tolist()
        for v in snapshot.variables
        if v.kind == VariableKind.PARAMETER and v.name in snapshot.values
    }
    return Plan(
        snapshot.program,
        {name: value for name, value in now.items() if name not in values},
        player,
        playlist,
        values,
        lead_time(player),
    )


class Cancelled(Exception):
    """Raised where the plan has changed during the trial."""


class Trial:
    """Tries the newest plan on a twin, one at a time, on a thread of its own."""

    def __init__(self) -> None:
        self.share = 0.0
        self._plan: Plan | None = None
        self._since = 0.0  # that the plan is the same
        self._done: tuple[Plan, Rehearsal | None, str, float] | None = None
        self._running = False
        self._lock = threading.Lock()

    def look(self, plan: Plan | None, port: Port | None) -> None:
        """Note the present plan; never waits."""
        now = time.monotonic()
        with self._lock:
            before = self._plan
            if plan is None or before is None or not plan.same(before):
                self._plan, self._since = plan, now
            plan = self._plan
            still = plan is not None and port is not None and now - self._since >= STILL_S
            if still and not self._running and not self._known(plan):
                self._running, self.share = True, 0.0
                background("tui-trial", self._try, plan, port)

    def found(self, plan: Plan) -> Rehearsal | None:
        """The result of this plan's trial, None where it was not tried yet."""
        done = self._done
        return done[1] if done is not None and done[0].same(plan) else None

    def problem(self, plan: Plan) -> str:
        """Why this plan could not be tried; empty where it could, or was not tried yet."""
        done = self._done
        return done[2] if done is not None and done[0].same(plan) else ""

    def _known(self, plan: Plan | None) -> bool:
        done = self._done
        if done is None or plan is None or not done[0].same(plan):
            return False
        return done[1] is not None or time.monotonic() - done[3] < AGAIN_S

    def _try(self, plan: Plan, port: Port) -> None:
        def tell(share: float) -> None:
            if self._plan is not plan:
                raise Cancelled
            self.share = share

        found, why = None, ""
        try:
            found = port.rehearse(plan.tables, plan.values, plan.seconds, tell)
        except Cancelled:
            pass
        except ZendspError as error:
            why = str(error)
        except Exception as error:  # a screen that stays alive beats a thread that died unseen
            why = f"{type(error).__name__}: {error}"
        with self._lock:
            if found is not None or why:
                self._done = plan, found, why, time.monotonic()
            self._running = False
