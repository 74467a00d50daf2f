"""The commands of ``zendsp`` by name. Each module is imported only when needed, so that ``--help``
imports nothing heavy.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

try:
    import click
except ModuleNotFoundError:
    # a bare target has no click; the entry point of the command is there all the same
    raise SystemExit(
        "zendsp: this is a bare target, without the packages of the host. It runs with 'python -m"
        " zendsp_target --help'; 'pip install zendsp' installs the rest"
    ) from None

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

UNREAD = 128 + 13  # the status of a command that SIGPIPE ends, as `head` ends what it reads
# name -> (module:attribute, one-line help shown by `zendsp --help`)
COMMANDS: dict[str, tuple[str, str]] = {
    "demo": (
        "zendsp.cli.demo:command",
        "A machine conceals physics: find it live, and switch its compensation on.",
    ),
    "target": ("zendsp.cli.target:command", "Run a target here."),
    "ls": ("zendsp.cli.ls:command", "List the targets that answer."),
    "info": ("zendsp.cli.info:command", "Show a target and its variables."),
    "compile": ("zendsp.cli.compile:command", "Compile C code on a target."),
    "load": ("zendsp.cli.load:command", "Compile and load a program without starting it."),
    "run": ("zendsp.cli.run:command", "Compile, download and start a program."),
    "pause": ("zendsp.cli.pause:command", "Pause the program."),
    "stop": ("zendsp.cli.stop:command", "STOP: safe outputs at once."),
    "drive": ("zendsp.cli.drive:command", "Power, home and enable the drives; acknowledge a trip."),
    "get": ("zendsp.cli.get:command", "Read variables."),
    "set": ("zendsp.cli.set:command", "Change variables, all in one sample."),
    "watch": ("zendsp.cli.watch:command", "Follow channels live."),
    "params": ("zendsp.cli.params:command", "Save, compare and restore parameters."),
    "acquire": ("zendsp.cli.acquire:command", "Record channels into a file."),
    "salvage": (
        "zendsp.cli.salvage:command", "Save what a target had recorded before it was killed.",
    ),
    "cut": ("zendsp.cli.cut:command", "Cut a recording in time, or at its gaps."),
    "sweep": ("zendsp.cli.sweep:command", "Try values of parameters and measure each."),
    "bode": ("zendsp.cli.bode:command", "Measure a frequency response of the machine."),
    "stats": ("zendsp.cli.stats:command", "Show the timing of the loop."),
    "reveal": (
        "zendsp.cli.reveal:command", "Tell what a simulated machine conceals, after the fact.",
    ),
    "reference": (
        "zendsp.cli.reference:command", "Plan a motion within a machine's limits and save it.",
    ),
    "tui": (
        "zendsp.cli.tui:command",
        "Console, Execute, Reference and Diagnose in the terminal, or a browser.",
    ),
    "rehearse": (
        "zendsp.cli.rehearse:command", "Try a planned motion on a simulated twin; nothing moves.",
    ),
    "simulate": (
        "zendsp.cli.simulate:command",
        "Run a control program against a model of the machine, here.",
    ),
    "model": ("zendsp.cli.model:command", "Begin a model file from a recording; check one."),
    "model2c": ("zendsp.cli.codegen:command", "Turn a model into C for control programs."),
    "experiment": (
        "zendsp.cli.experiment:command",
        "Measure a machine: friction, motor, tracking; all results in one report.",
    ),
    "diagnose": (
        "zendsp.cli.diagnose:command",
        "Find the physics that a model left out of real recordings.",
    ),
    "bridge": ("zendsp.cli.bridge:command", "Show a target in Foxglove, PlotJuggler or Rerun."),
    "shell": ("zendsp.cli.shell:command", "Type commands over one link; Tab completes."),
    "completion": ("zendsp.cli.completion:command", "Let bash, zsh or fish complete commands."),
    "keys": ("zendsp.cli.keys:command", "Make a lab's certificates, and say who may do what."),
    "prove": (
        "zendsp.cli.prove:command", "Judge the diagnosis on concealed cases and real machines.",
    ),
}


class LazyGroup(click.Group):
    """Lists every command of the table above, and imports a command only when it is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        from zendsp.cli.given_once import given_once

        module, attribute = COMMANDS[cmd_name][0].split(":")
        command: Any = getattr(importlib.import_module(module), attribute)
        return given_once(command) if isinstance(command, click.Command) else None

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; where nobody reads its output on, click itself would end it with 1."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError as error:
            raise click.exceptions.Exit(UNREAD) from error

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """The commands of the table above that fit; click itself would import each one for its
        help.
        """
        names = [name for name in COMMANDS if name.startswith(incomplete)]
        if names:
            from click.shell_completion import CompletionItem

            return [CompletionItem(name, help=COMMANDS[name][1]) for name in names]
        return click.Command.shell_complete(self, ctx, incomplete)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="To begin:  zendsp demo, then zendsp tui",
)
@click.version_option(package_name="zendsp")
def cli() -> None:
    """Run C control code in real time, tune it live, record it, and find what the model left out.
    """
