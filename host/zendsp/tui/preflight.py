"""The conditions of starting a run; each line says what to do where it is not met."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from zendsp.errors import ReferenceError_
from zendsp.reference import (
    JUMPS,
    MACHINES,
    UNPREDICTED,
    Machine,
    Reference,
    check_fits,
    load_machine,
)
from zendsp.reference.told import machine_told, shipped
from zendsp.tui.actions import in_keys
from zendsp.tui.playing import Setup, find_player, present_position
from zendsp.tui.port import Port
from zendsp.tui.snapshot import LinkState, Snapshot
from zendsp.tui.trial import Plan, Trial, make_plan
from zendsp_protocol.states import LATCHED, DriveState, ProgramState


@dataclass(frozen=True)
class Condition:
    """One line of the list."""

    text: str
    met: bool
    advice: str = ""
    warning: bool = False  # met, but what it says should be seen


def machine_of(snapshot: Snapshot) -> Machine | None:
    """The shipped description of the target's machine, else one made of the limits that the target
    tells; None while neither is known.
    """
    said, limits = snapshot.described, snapshot.limits
    if said is None:
        return load_machine(snapshot.machine) if snapshot.machine in MACHINES else None
    return shipped(said) if limits is None else machine_told(said, limits, snapshot.period_s)


def preflight(
    snapshot: Snapshot,
    references: Sequence[Reference],
    files: Sequence[Path],
    setup: Setup,
    busy: bool,
    trial: Trial,
    port: Port | None,
) -> list[Condition]:
    """The conditions of Start, in the order in which one would meet them. Has the run tried on a
    twin where that is possible.
    """
    s = snapshot
    plan = None
    chosen = Condition(
        f"reference chosen{_names(files)}", bool(references), "o chooses; F4 plans one"
    )
    if s.link != LinkState.UP:  # nobody knows of anything else whether it is so
        trial.look(None, port)
        return [_no_link(s), chosen]
    machine, player = machine_of(s), find_player(s.variables)
    found = [
        Condition("link to a target", True),
        Condition(
            f"machine known{f': {machine.name}' if machine else ''}",
            machine is not None,
            "its limits come with a program: build one on Console (F2, b)",
        ),
        Condition(
            "program loaded",
            s.state not in ("", ProgramState.EMPTY, ProgramState.CRASHED),
            "build one on Console (F2, b)",
        ),
        Condition(
            f"program plays tables{f': {player.table}' if player else ''}",
            player is not None,
            "it must declare TABLE(ref, rows, joints, …), as joint_pd.c does",
        ),
        chosen,
    ]
    if references and machine is not None:
        misfit, differs = _misfit(references, machine)
        if misfit:
            found.append(Condition("planned for this machine", False, misfit))
        elif player is None or busy:  # while a run goes on, the arm is on its way
            found.append(_within(references, machine, differs))
        else:
            plan, playable = _playable(s, references, machine, setup)
            found += [_within(references, machine, differs, plan, trial), playable]
            if plan is not None:
                found.append(_tried(plan, trial, s.state == ProgramState.RUNNING))
    known = {v.name for v in s.variables}
    missing = [c for c in setup.channels if c.split("[")[0] not in known]
    found += [
        *_drives(s),
        Condition(
            "channels exist",
            not missing,
            f"the program has no {', '.join(missing)}: choose again (a)",
        ),
        Condition(
            "a run is in progress" if busy else "no run in progress", not busy, "b aborts it"
        ),
    ]
    trial.look(None if busy or s.state == ProgramState.RUNNING else plan, port)
    return found


def _drives(s: Snapshot) -> list[Condition]:
    return [
        Condition(
            "no trip, no STOP",
            s.trip is None and s.drive not in LATCHED,
            "acknowledge with Ctrl+K",
        ),
        *(Condition(in_keys(str(joint)), True, warning=True) for joint in s.outside),
        Condition(
            "drives enabled",
            s.explicit and s.enabled,
            f"on Console (F2): {_steps(s)}",
        ),
        Condition(
            "you may command",
            s.mine or not s.commander,
            f"{s.commander} commands; Ctrl+R takes over",
        ),
    ]


def _no_link(s: Snapshot) -> Condition:
    again = "it comes back by itself; Ctrl+O: another"
    lost = s.link == LinkState.LOST
    return Condition("link to a target", False, again if lost else "Ctrl+O connects")


def _steps(s: Snapshot) -> str:
    """The keys still to press until the drives are enabled. On automatic drives home and enable
    switch the power on, and a running program has to be paused first.
    """
    needs = {name for name, met, _ in s.conditions if not met}
    steps = {
        "pause (p)": s.drive == DriveState.RUNNING,
        "power (o)": "power" in needs,
        "home (h)": "homed" in needs and "program" not in needs,
        "enable (e)": True,
    }
    return ", ".join(key for key, needed in steps.items() if needed)


def _names(files: Sequence[Path]) -> str:
    return f": {', '.join(f.stem for f in files)}" if files else ""


def _misfit(references: Sequence[Reference], machine: Machine) -> tuple[str, str]:
    """Why this machine cannot play one of the references, and what else to say about them."""
    told = ""
    for reference in references:
        try:
            told = told or check_fits(reference, machine.name, machine.units)
        except ReferenceError_ as error:
            return str(error), ""
    return "", told


def _within(
    references: Sequence[Reference],
    machine: Machine,
    told: str,
    plan: Plan | None = None,
    trial: Trial | None = None,
) -> Condition:
    for reference in references:
        broken = machine.find_violations(reference)
        if broken:
            return Condition("within the limits", False, str(broken[0]))
    if told:
        return Condition(f"within the limits of {machine.name}, but {told}", True, warning=True)
    if any(reference.jumps for reference in references):
        return Condition(f"within the limits of position; {JUMPS}", True, warning=True)
    twin = trial.found(plan) if trial is not None and plan is not None else None
    if not machine.modelled and twin is not None and twin.simulated:  # which told the torque too
        return Condition("within the limits of position and speed", True)
    if not machine.modelled:
        return Condition(
            f"within the limits of position and speed; {UNPREDICTED}", True, warning=True
        )
    return Condition("within the limits of the machine", True)


def _playable(
    s: Snapshot, references: Sequence[Reference], machine: Machine, setup: Setup
) -> tuple[Plan | None, Condition]:
    if present_position(s, machine.joints) is None:
        return None, Condition("position known", False, "no encoder readings come from the target")
    try:
        plan = make_plan(s, references, machine, setup)
    except ReferenceError_ as error:
        return None, Condition("can be played from here", False, str(error))
    return plan, Condition(f"can be played from here: {plan.seconds:.1f} s in all", True)


def _tried(plan: Plan, trial: Trial, moving: bool) -> Condition:
    """The condition that the run stays within limits on the simulated twin."""
    found, problem = trial.found(plan), trial.problem(plan)
    if found is not None and not found.simulated:
        return Condition(f"not tried: {found.text}", True, warning=True)
    if found is not None:
        return (
            Condition(found.text, True)
            if found.trip is None
            else Condition("no limit is passed", False, found.text)
        )
    if moving:
        return Condition(
            "a program runs: Start pauses it, and tries the run first on a twin, if there is one",
            True,
        )
    if problem:
        return Condition("tried on a simulated twin", False, problem)
    return Condition("tried on a simulated twin", False, f"in progress, {100 * trial.share:.0f} %")
