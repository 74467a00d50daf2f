"""The ``zendsp`` command: one lazily loaded module per subcommand, so that ``--help`` imports
nothing heavy.
"""

from __future__ import annotations

import importlib
import os
import re
import resource
import sys
import warnings
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

from zendsp.cli.lines import fitted, write_anywhere
from zendsp.errors import ZendspError
from zendsp_protocol.errors import nearest
from zendsp_protocol.texts import shown, with_point

LEAST_MEMORY = 512 << 20  # bytes of addresses

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
    """Lists every command from the table above and imports one only when it is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module, attribute = COMMANDS[cmd_name][0].split(":")
        command: Any = getattr(importlib.import_module(module), attribute)
        return command if isinstance(command, click.Command) else None

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Commands by the table above; click would import each for its help."""
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


class _NoNumPy:
    """Refuses NumPy where little memory is allowed: its library would look for more without end."""

    @staticmethod
    def find_spec(name: str, *_: object) -> None:
        """Raise for NumPy; find nothing."""
        if name == "numpy":
            raise MemoryError(f"it needs {LEAST_MEMORY >> 20} MB of addresses")


def main() -> None:
    """Entry point: expected errors end with one sentence and exit status 2, Ctrl-C with 130."""
    write_anywhere(sys.stdout)
    warnings.formatwarning = lambda message, *_, **__: f"zendsp: {message}\n"
    if 0 <= resource.getrlimit(resource.RLIMIT_AS)[0] < LEAST_MEMORY:
        sys.meta_path.insert(0, _NoNumPy)
    try:
        # click returns the status of a command that ended by Exit, and raises everything else
        status = cli(prog_name="zendsp", standalone_mode=False)
        sys.exit(status if isinstance(status, int) else 0)
    except click.exceptions.Exit as stop:
        sys.exit(stop.exit_code)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        sys.exit(2)
    except (click.ClickException, ZendspError) as error:
        say(error)
        sys.exit(2)
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        sys.exit(130)
    except (MemoryError, ImportError) as error:
        lacking = _too_little_memory(error)
        if lacking is None:
            raise
        say(MemoryError(str(lacking)))
        sys.exit(2)
    except OSError as error:  # a full disk, a folder without the right to write, a full output
        say(error)
        _let_go_of_output()
        sys.exit(2)


def _too_little_memory(error: BaseException | None) -> BaseException | None:
    """What did not fit into memory: where it is limited (``ulimit -v``), a library that is there
    and cannot be loaded; NumPy raises an error of its own upon that one. None: another error.
    """
    while isinstance(error, ImportError) and error.path is None:
        error = error.__cause__
    limited = resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY
    return error if limited or isinstance(error, MemoryError) else None


def say(error: Exception) -> None:
    """Print an expected error as one line."""
    if isinstance(error, click.ClickException):
        words = _wrong_use(error)
    elif isinstance(error, OSError) and not isinstance(error, ZendspError):
        where = f"{error.filename}: " if error.filename else ""
        words = f"{where}{error.strerror or error}"
    elif isinstance(error, MemoryError):
        why = str(error) or "none is left"
        words = f"too little memory ({why}); 'ulimit -v' and 'free' show it"
    else:
        words = str(error)
    click.echo(fitted(f"zendsp: {shown(words)}", sys.stderr), err=True)


def _wrong_use(error: click.ClickException) -> str:
    """One line on a command that was typed wrongly, as of every other error."""
    context = error.ctx if isinstance(error, click.UsageError) else None
    if context is not None and isinstance(error, click.exceptions.NoSuchCommand):
        group = context.command
        known = group.list_commands(context) if isinstance(group, click.Group) else []
        close = nearest(error.command_name, known)
        near = f"did you mean {close[0]}? " if close else ""
        return (
            f"no command {error.command_name!r}; {near}'{context.command_path} --help' lists them"
        )
    if context is not None and isinstance(error, click.exceptions.NoSuchOption):
        options = [name for p in context.command.params for name in p.opts]
        name = error.option_name  # without dashes, in which all are alike
        close = nearest(name.lstrip("-"), [o.lstrip("-") for o in options])
        error = click.exceptions.NoSuchOption(name, possibilities=[f"--{o}" for o in close])
    words = error.format_message()
    if type(error) is click.BadParameter:  # it is its own sentence
        words = error.message
    words = re.sub(r"\s+", " ", words).rstrip(".")
    if number := re.search(r"'([^']*)' is not a valid (float|integer)", words):
        words += with_point(number[1])
    words = (words[:1].lower() + words[1:]).replace(". Did you mean", "; did you mean")
    if context is None:
        return words
    return f"{words}{'' if words.endswith('?') else ';'} '{context.command_path} --help' says more"


def _let_go_of_output() -> None:
    """Have what nobody takes go nowhere: the end of the interpreter would complain of it again."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
