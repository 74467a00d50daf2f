"""The ``zendsp`` command: one lazily loaded module per subcommand, so that ``--help`` imports nothing heavy."""

from __future__ import annotations

import importlib
import sys
from typing import Any

import click

from zendsp.errors import ZendspError

# name -> (module:attribute, one-line help shown by `zendsp --help`)
COMMANDS: dict[str, tuple[str, str]] = {
    "reference": ("zendsp.cli.reference:command", "Plan a motion within a machine's limits and save it."),
    "diagnose": ("zendsp.cli.diagnose:command", "Find the physics that a model left out of real recordings."),
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

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="zendsp")
def cli() -> None:
    """Run C control code in real time, tune it live, record it, and find what the model left out.

    Example:  zendsp demo
    """


def main() -> None:
    """Entry point: expected errors end with one sentence and exit status 2, Ctrl-C with 130."""
    try:
        cli(standalone_mode=False)
    except click.exceptions.Exit as stop:
        sys.exit(stop.exit_code)
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        sys.exit(130)
    except ZendspError as error:
        click.echo(f"zendsp: {error}", err=True)
        sys.exit(2)
