"""The drives in the safe sequence, the conditions of the next step, and the signals of the machine.
"""

from __future__ import annotations

from rich.style import Style
from rich.text import Text
from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.widgets import Button

from zendsp.link.joints import percent, share_of_range
from zendsp.tui.actions import called_now, in_keys, keys_of
from zendsp.tui.panels.lines import Lines
from zendsp.tui.scope.ticks import number
from zendsp.tui.snapshot import LinkState, Snapshot
from zendsp_protocol.states import LATCHED, DriveState, ProgramState

A_LINE = 4  # positions, with their unit, that have room beside the scope on 120 columns
NEAR = 0.9  # share of its range from which a joint is near a limit
LADDER = ("off", "ready", "homed", "enabled", "running")
STEPS = {
    "power": "Power o",
    "home": "Home h",
    "enable": "Enable e",
    "start": "Start s",
    "pause": "Pause p",
}


class DrivePanel(Vertical):
    """The steps of the safe sequence, five buttons, and flags."""

    DEFAULT_CSS = """
    DrivePanel #drive-buttons { height: 1; }
    DrivePanel #drive-buttons Button { min-width: 8; margin-right: 1; }
    """

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.border_title = "Drives"
        self._ladder = Lines(id="ladder")
        self._flags = Lines(id="drive-flags")

    def compose(self) -> ComposeResult:
        yield self._ladder
        with Horizontal(id="drive-buttons"):
            for name, text in STEPS.items():
                yield Button(text, id=f"step-{name}", compact=True)
        yield self._flags

    @on(Button.Pressed)
    def _step(self, event: Button.Pressed) -> None:
        event.stop()
        name = str(event.button.id).removeprefix("step-")
        self.app.call_later(self.app.run_action, name, self.screen)

    def show(self, s: Snapshot) -> None:
        """Paint a snapshot."""
        for name, word in called_now(s).items():
            button = self.query_one(f"#step-{name}", Button)
            label = f"{word} {STEPS[name].split()[-1]}"
            if str(button.label) != label:
                button.label = label
        self._ladder.update(self.ladder(s))
        self._flags.update(self.flags(s))

    def ladder(self, s: Snapshot) -> Text:
        """Return the safe sequence with the present step marked."""
        c = self.app.theme_variables
        text = Text(no_wrap=True, overflow="ellipsis")
        if s.link in (LinkState.LOST, LinkState.ENDED):
            text.append(f"no word from the target; heard last: {s.drive}", Style(color=c["error"]))
            return text
        if s.drive in LATCHED:  # nothing of the ladder is reached
            colour = c["error"] if s.drive == DriveState.TRIPPED else c["warning"]
            text.append(f" {s.drive} ", Style(bold=True, reverse=True, color=colour))
            return text.append(f"  next: {keys_of(s.steps, True)}", Style(color=c["warning"]))
        if "go_on" in s.steps:
            text.append(f" {s.drive} ", Style(bold=True, reverse=True, color=c["warning"]))
            return text.append("  it holds: hold = false lets it go on", Style(color=c["warning"]))
        reached = LADDER.index(s.drive) if s.drive in LADDER else -1
        for k, name in enumerate(LADDER):
            if k:
                text.append(" ─ ", Style(dim=True))
            if k == reached:
                text.append(
                    f" {name} ",
                    Style(bold=True, reverse=True, color=c["success" if k > 2 else "primary"]),
                )
            else:
                text.append(name, Style(color=c["success"]) if k < reached else Style(dim=True))
        if s.steps and s.state != ProgramState.RUNNING:
            text.append(f"  next {keys_of(s.steps[:1])}", Style(color=c["warning"]))
        return text

    def flags(self, s: Snapshot) -> Text:
        """The conditions that are not met, the host-lost setting, and the inputs and outputs of
        each joint.
        """
        c = self.app.theme_variables
        text = Text(no_wrap=True, overflow="ellipsis")
        if s.link in (LinkState.LOST, LinkState.ENDED):
            return text
        for joint in s.outside:
            text.append("! ", Style(color=c["error"], bold=True))
            # which and how far, and below it what is to be done: one line has no room for both
            text.append(f"{joint.what}:\n  {in_keys(joint.remedy)}", Style(color=c["error"]))
            text.append("\n")
        unmet = [(name, advice) for name, met, advice in s.conditions if not met]
        if s.conditions and not unmet:
            text.append("✔ ", Style(color=c["success"]))
            text.append("every condition of enabling is met\n", Style(dim=True))
        for name, advice in unmet:
            text.append("✖ ", Style(color=c["error"], bold=True))
            text.append(f"{name}: {in_keys(advice)}\n", Style(color=c["warning"]))
        if s.host_lost:
            text.append("if the host is lost: ", Style(dim=True))
            text.append(f"{s.host_lost}\n")
        if s.position and s.described is not None:
            # by the encoders: a signal of the program is as old as its last sample
            units = [joint.unit for joint in s.described.joints]
            for k in range(0, len(s.position), A_LINE):
                text.append(f"{'' if k else 'pos':<5}", Style(dim=True))
                text.append(" ".join(f"{q:>z9.4f}" for q in s.position[k : k + A_LINE]))
                some = list(dict.fromkeys(units[k : k + A_LINE]))
                each = some if len(some) == 1 else units[k : k + A_LINE]
                text.append(f" {', '.join(each)}\n", Style(dim=True))
            self._used(text, s)
        for name, unit in (
            ("enc", "counts"),
            ("aout", "mV"),
            ("adc", ""),
            ("din", ""),
            ("dout", ""),
        ):
            values = s.io.get(name)
            if values is None or len(values) == 0:
                continue
            # nothing acts while paused: hardware gets none, and a simulated machine's time stands
            held = name == "aout" and s.state == ProgramState.PAUSED and any(values)
            text.append(f"{'held' if held else name:<5}", Style(dim=True))
            text.append(
                " ".join(f"{number(float(v)):>9}" for v in list(values)[: max(s.joints, 1)])
            )
            text.append(f" {unit}{', none acts' if held else ''}\n", Style(dim=True))
        if s.scheduling:
            text.append(s.scheduling, Style(dim=True))
        text.rstrip()
        return text

    def _used(self, text: Text, s: Snapshot) -> None:
        """How much of its range each joint uses: 0 % in the middle, 100 % at a limit that trips."""
        if s.limits is None:
            return
        c = self.app.theme_variables
        ranges = zip(s.position, s.limits.position_min, s.limits.position_max, strict=False)
        shares = [share_of_range(*each) for each in ranges]
        for k in range(0, len(shares), A_LINE):
            text.append(f"{'' if k else 'range':<5}", Style(dim=True))
            for n, share in enumerate(shares[k : k + A_LINE]):
                near = share > NEAR
                text.append(" " if n else "")
                text.append(f"{percent(share):>9}", Style(color=c["warning"]) if near else Style())
            text.append("\n")
