"""The one table of actions: keys, footer, help and command palette all read it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from textual.binding import Binding, BindingType

from zendsp.tui.snapshot import Snapshot

SCREENS = ("console", "execute", "reference", "diagnose")


@dataclass(frozen=True)
class Action:
    """One thing a user can do."""

    scope: str  # "app", or the screen it belongs to
    name: str  # method action_<name> of that screen or of the app
    keys: str  # comma-separated, the first is shown
    label: str  # one or two words for the footer
    help: str  # one sentence
    footer: bool = False
    priority: bool = False  # works under every dialog and inside every input field

    @property
    def shown_key(self) -> str:
        """The first key as a person reads it."""
        key = self.keys.split(",")[0]
        names = {
            "question_mark": "?",
            "slash": "/",
            "plus": "+",
            "minus": "-",
            "left_square_bracket": "[",
            "right_square_bracket": "]",
            "space": "space",
            "enter": "⏎",
            "delete": "del",
            "backslash": "\\",
        }
        if key.startswith("ctrl+"):
            return "^" + key[5:]
        if key.startswith("f") and key[1:].isdigit():
            return key.upper()
        return names.get(key, key)


# fmt: off
ACTIONS = (
    # -- everywhere
    Action("app", "stop", "f9,ctrl+@", "STOP",
           "Force the drives to velocity mode with zero reference, now (also Ctrl+Space, or a"
           " click on the red field).", footer=True, priority=True),
    Action("app", "show('console')", "f2", "Console",
           "Tune, watch and drive the machine.", priority=True),
    Action("app", "show('execute')", "f3", "Execute",
           "Play a planned reference and keep the run.", priority=True),
    Action("app", "show('reference')", "f4", "Reference",
           "Plan a motion; needs no target.", priority=True),
    Action("app", "show('diagnose')", "f5", "Diagnose",
           "Find the physics that the model leaves out of what was recorded.", priority=True),
    Action("app", "help", "f1,question_mark", "Help",
           "Show every key of this screen.", footer=True),
    Action("app", "connect", "ctrl+o", "Connect",
           "Choose a target, or start a simulated machine here."),
    Action("app", "command", "ctrl+r", "Command right",
           "Take the exclusive right to command, or give it back."),
    Action("app", "acknowledge", "ctrl+k", "Acknowledge",
           "Acknowledge a trip or a STOP, so that the drives can be enabled again.", priority=True),
    Action("app", "next_theme", "ctrl+t", "Theme",
           "Change the colours: night, day, contrast and Textual's own."),
    Action("app", "command_palette", "ctrl+p", "Palette", "Find any action by name.", footer=True),
    Action("app", "quit", "ctrl+q", "Quit",
           "Leave; where the machine moves, you are asked what is to become of it.", priority=True),
    Action("app", "suspend", "ctrl+z", "Suspend",
           "Nothing is suspended: a terminal that sleeps is a host that is lost."),
    # -- console: the drive sequence
    Action("console", "power", "o", "Power",
           "Switch the drives' power on (to ready) or off; from then on they are not switched by"
           " start and pause."),
    Action("console", "home", "h", "Home", "Find the machine's zero position.", footer=True),
    Action("console", "enable", "e", "Enable",
           "Enable the drives, or disable them if they are.", footer=True),
    Action("console", "start", "s", "Start", "Start the control program.", footer=True),
    Action("console", "pause", "p", "Pause",
           "Pause the control program: hardware goes to its safe state, a simulated machine stands"
           " still with its time.", footer=True),
    Action("console", "host_lost", "H", "Host lost",
           "Choose what the target does if this host disappears: stop, hold or finish."),
    # -- console: program and variables
    Action("console", "build", "b", "Build", "Compile the source and download it.", footer=True),
    Action("console", "open_source", "O", "Open file", "Choose the C file to build."),
    Action("console", "source", "g", "Source",
           "Show the source, at the first error if there is one."),
    Action("console", "filter", "slash", "Filter",
           "Show only variables whose name, unit or description contains some text."),
    Action("console", "edit", "enter", "Edit", "Write one variable at once (asynchronous)."),
    Action("console", "stage", "t", "Stage",
           "Put a new value aside for the next synchronous update."),
    Action("console", "update", "u", "Update",
           "Review the staged values and apply them all in one sample.", footer=True),
    Action("console", "undo", "z", "Undo",
           "Take back what was staged last; where nothing is staged, the last change of"
           " variables."),
    Action("console", "initial", "i", "Initial", "Stage the initial value of the marked variable."),
    Action("console", "initial_all", "I", "Reset all",
           "Stage the initial values of all parameters."),
    Action("console", "sets", "w", "Sets",
           "Save, compare and load parameter sets; several side by side."),
    Action("console", "sliders", "k", "Sliders",
           "Move parameters between their limits while the curves run: the marked one first."),
    # -- console: the scope
    Action("console", "plot", "space", "Plot",
           "Show the marked variable on the scope, or remove it."),
    Action("console", "channels", "c", "Channels", "Choose the curves of the scope."),
    Action("console", "mode", "m", "Roll/trig", "Roll, or wait for the trigger."),
    Action("console", "trigger", "T", "Trigger", "Set source, level, edge and pre-trigger."),
    Action("console", "single", "n", "Single", "Wait for one trigger, then freeze."),
    Action("console", "freeze", "f", "Freeze",
           "Freeze the picture, or let it go on; the history stays.", footer=True),
    Action("console", "autoscale", "a", "Autoscale",
           "Fit the axes now; then they follow what is seen, or stay as they are: each press"
           " changes that."),
    Action("console", "lanes", "l", "Lanes",
           "One lane for each unit, one for each curve, or all over one another."),
    Action("console", "view", "V", "View",
           "Curves over time, over the selected one (XY), or their spectrum (unit/√Hz) of what is"
           " seen."),
    Action("console", "formula", "F", "Formula",
           "A curve that is computed: e = r1 - q1, d(q1) per second, lp(u, 20) filtered at 20 Hz;"
           " an empty line takes it away."),
    Action("console", "scale", "L", "Scale",
           "Give the selected curve a lane, and ends of its axis (also: click on the axis)."),
    Action("console", "export", "X", "Export",
           "Write what is seen: CSV, MAT and other files of rows, or PNG, SVG, PDF."),
    Action("console", "layouts", "W", "Layouts",
           "Save or open an arrangement of the scope: curves, formulas, scales, trigger."),
    Action("console", "cursors", "x", "Cursors",
           "Show two cursors with Δt and Δy; ← → move, v changes cursor."),
    Action("console", "swap_cursor", "v", "Other cursor", "Let the arrows move the other cursor."),
    Action("console", "next_curve", "y", "Next curve", "Select the next curve: its axis, its Δy."),
    Action("console", "zoom(-1)", "plus,equals_sign", "Zoom in",
           "Half the time across the picture."),
    Action("console", "zoom(1)", "minus", "Zoom out", "Twice the time across the picture."),
    Action("console", "pan(0.25)", "left_square_bracket", "Back",
           "Look further into the past (freezes)."),
    Action("console", "pan(-0.25)", "right_square_bracket", "Forward", "Look towards the present."),
    Action("console", "events", "E", "Events",
           "Show the event log in the place of the variables, or back (on a small terminal)."),
    # -- console: what it opens
    Action("console", "record", "r", "Record",
           "Record the curves of the scope for some seconds and keep the run; again: end it."),
    Action("console", "simulate", "S", "Simulate",
           "Simulate the last run, its source and its reference, with the model of the machine."),
    Action("console", "diagnose", "D", "Diagnose", "Open the last run on Diagnose."),
    # -- execute
    Action("execute", "choose", "o", "Reference",
           "Choose the planned reference or references to play.", footer=True),
    Action("execute", "cyclic", "c", "Cyclic", "Ask how many times to play; again: once."),
    Action("execute", "settings", "a", "Acquire",
           "Set channels, decimation, trigger, pre-positioning and return.", footer=True),
    Action("execute", "note", "n", "Note",
           "Write the name of the run, and a note that is kept with it."),
    Action("execute", "start", "s", "Start",
           "Pre-position, play, acquire, return home, store; where the simulated twin passes no"
           " limit.", footer=True),
    Action("execute", "abort", "b", "Abort",
           "Stop this run softly and keep what was acquired.", footer=True),
    Action("execute", "respond", "f", "Bode",
           "Swing a joint by many sines at once and show its frequency response."),
    Action("execute", "sweep", "p", "Sweep",
           "Try values of parameters on the running program; a table shows what each did."),
    Action("execute", "overlay", "space", "Overlay",
           "Lay the marked run over the others, or take it away.", footer=True),
    Action("execute", "compare", "d", "Compare",
           "Differences of the overlaid runs: errors, parameters, source."),
    Action("execute", "rename", "r", "Rename", "Give the marked run another name."),
    Action("execute", "export", "x", "Export",
           "Write the marked run as MAT, CSV, NPZ or Parquet.", footer=True),
    Action("execute", "delete", "delete", "Delete", "Move the marked run to the trash folder."),
    Action("execute", "simulate", "S", "Simulate",
           "Simulate this run with the model of the machine."),
    Action("execute", "diagnose", "D", "Diagnose", "Open this run on Diagnose."),
    # -- reference
    Action("reference", "machine", "m", "Machine", "Choose the machine whose limits count."),
    Action("reference", "kind", "k", "Kind", "Choose the kind of motion.", footer=True),
    Action("reference", "view", "v", "View",
           "Curves over time, or the path in the plane.", footer=True),
    Action("reference", "save", "ctrl+s", "Save",
           "Write the MAT file that Execute plays.", footer=True),
    Action("reference", "load", "l", "Load",
           "Open a saved reference, with its parameters where they are known."),
    Action("reference", "execute", "x", "Execute",
           "Open it on Execute; save it first, where it is not yet.", footer=True),
    # -- diagnose
    Action("diagnose", "start", "s", "Start",
           "Compare the marked recordings with the model and name what it lacks.", footer=True),
    Action("diagnose", "cancel", "ctrl+c,escape", "Cancel",
           "End the diagnosis with what it has found so far; twice: at once, with nothing."),
    Action("diagnose", "model", "m", "Model", "Choose the model file.", footer=True),
    Action("diagnose", "use", "space", "Use",
           "Use the marked recording for the fit, hold it out to judge on, or leave it out.",
           footer=True),
    Action("diagnose", "add", "a", "Add", "Add the recording of a file."),
    Action("diagnose", "report", "v", "Report", "Open the report in a browser."),
    Action("diagnose", "compensate", "c", "Compensate",
           "Fade the compensation of what was found in or out of the running program, or prepare"
           " the program for it.", footer=True),
    Action("diagnose", "next", "n", "Next motion",
           "Open the proposed motion on Execute; its run is diagnosed together with the others.",
           footer=True),
    Action("diagnose", "save", "w", "Save model", "Save the improved model as a file."),
    Action("diagnose", "earlier", "o", "Open", "Open an earlier diagnosis.", footer=True),
    Action("diagnose", "compare", "d", "Compare", "Differences of this diagnosis and another."),
)
# fmt: on


def actions(scope: str) -> Iterator[Action]:
    """Yield the actions of one screen, or of ``"app"``."""
    return (action for action in ACTIONS if action.scope == scope)


def bindings(scope: str) -> list[BindingType]:
    """Return the key bindings of one screen, or of ``"app"``, for Textual."""
    return [
        Binding(
            a.keys,
            a.name,
            a.label,
            show=a.footer,
            priority=a.priority,
            key_display=a.shown_key,
            tooltip=a.help,
        )
        for a in actions(scope)
    ]


def called_now(snapshot: Snapshot) -> dict[str, str]:
    """What the keys that switch something on or off would do now, by the name of the action."""
    return {"enable": "Disable" if snapshot.enabled else "Enable"}


def keys_of(steps: Sequence[str], words: bool = False) -> str:
    """The steps of `zendsp.link.way_back` as keys, with what each does where `words`. A step
    without a key ends the list: the steps after it would be refused.
    """
    told = {
        a.name: f"{a.shown_key} {a.label.lower()}" if words else a.shown_key
        for a in ACTIONS
        if a.scope in ("console", "app")
    }
    keys = [told[step] for step in steps if step in told]
    return steps[0] if steps and steps[0] not in told else ", ".join(keys)


# what the target and the link say to do, and the action that does it here
DONE_BY = (
    (r"(Ctrl\+R in the terminal, else )?'zendsp drive take --force'", "command"),
    (r"'?zendsp drive acknowledge'?( or acknowledge\(\))?", "acknowledge"),
    (r"zendsp drive on", "power"),
    (r"zendsp drive home", "home"),
    (r"zendsp drive enable", "enable"),
    (r"zendsp run without a file", "start"),
    (r"'zendsp run FILE' or download\(\)|download a program", "build"),
    (r"'zendsp target[^']*'|'zendsp ls'", "connect"),
)


def in_keys(text: str) -> str:
    """A text of the target or the link, with keys in place of shell commands."""
    for words, name in DONE_BY:
        action = next(a for a in ACTIONS if a.name == name)
        key = action.keys.title() if "+" in action.keys else action.keys
        where = "" if action.scope == "app" else f" on {action.scope.title()}"
        text = re.sub(words, f"{key}{where}", text)
    return text
