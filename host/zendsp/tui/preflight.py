"""What must be true before a run may start; each line says what to do about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from zendsp.errors import ReferenceError_
from zendsp.reference import MACHINES, Machine, Reference, load_machine
from zendsp.tui.playing import Player, Setup, find_player, make_playlist, present_position
from zendsp.tui.snapshot import Snapshot


@dataclass(frozen=True)
class Condition:
    """One line of the list."""

    text: str
    met: bool
    advice: str = ""


def machine_of(snapshot: Snapshot) -> Machine | None:
    """Return the description of the target's machine, or None if it is none of those known here."""
    return load_machine(snapshot.machine) if snapshot.machine in MACHINES else None


def preflight(
    snapshot: Snapshot, references: Sequence[Reference], files: Sequence[Path], setup: Setup, busy: bool
) -> list[Condition]:
    """Return every condition of Start, in the order in which one would see to them."""
    s = snapshot
    found = [Condition("link to a target", s.link == "up", "Ctrl+O connects")]
    machine = machine_of(s)
    found.append(
        Condition(
            f"machine known{f': {s.machine}' if machine else ''}",
            machine is not None,
            "its limits are not known here",
        )
    )
    loaded = s.state not in ("", "empty", "crashed")
    found.append(Condition("program loaded", loaded, "build one on Console (F2, b)"))
    player = find_player(s.variables)
    found.append(
        Condition(
            f"program plays tables{f': {player.table}' if player else ''}",
            player is not None,
            "it must declare TABLE(ref, rows, joints, …), as pd.c does",
        )
    )
    found.append(Condition(f"reference chosen{_names(files)}", bool(references), "o chooses; F4 plans one"))
    if references and machine is not None:
        found.append(_fits(references, machine))
        if player is not None:
            found.append(_playable(s, references, machine, setup, player))
            found.append(Condition("Start tries the run on a simulated twin first", True))
    found.append(
        Condition(
            "no trip, no STOP",
            s.trip is None and s.drive not in ("stopped", "tripped"),
            "acknowledge with Ctrl+K",
        )
    )
    found.append(
        Condition("drives enabled", s.drive in ("enabled", "running"), f"on Console (F2): {_steps(s)}")
    )
    found.append(
        Condition("you may command", s.mine or not s.commander, f"{s.commander} commands; Ctrl+R takes over")
    )
    known = {v.name for v in s.variables}
    missing = [c for c in setup.channels if c.split("[")[0] not in known]
    found.append(
        Condition("channels exist", not missing, f"the program has no {', '.join(missing)}: choose again (a)")
    )
    found.append(Condition("no run in progress", not busy, "abort it with b"))
    return found


def _steps(s: Snapshot) -> str:
    """Return the keys that are still to be pressed until the drives are enabled; o would switch off what is on."""
    steps = ["power (o)", "home (h)", "enable (e)"]
    done = {"ready": 1, "homed": 2}.get(s.drive, 0) if s.explicit else 0
    return ", ".join(steps[done:])


def _names(files: Sequence[Path]) -> str:
    return f": {', '.join(f.stem for f in files)}" if files else ""


def _fits(references: Sequence[Reference], machine: Machine) -> Condition:
    for reference in references:
        if reference.joints != machine.joints:
            return Condition(
                "within the limits",
                False,
                f"planned for {reference.joints} joints, the machine has {machine.joints}",
            )
        broken = machine.find_violations(reference)
        if broken:
            return Condition("within the limits", False, str(broken[0]))
    return Condition("within the limits of the machine", True)


def _playable(
    s: Snapshot, references: Sequence[Reference], machine: Machine, setup: Setup, player: Player
) -> Condition:
    here = present_position(s, machine.joints)
    if here is None:
        return Condition("position known", False, "no encoder readings come from the target")
    try:
        playlist = make_playlist(references, machine, here, setup, player)
    except ReferenceError_ as error:
        return Condition("can be played from here", False, str(error))
    return Condition(f"can be played from here: {playlist.duration:.1f} s in all", True)
