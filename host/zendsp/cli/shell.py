"""``zendsp shell``: a prompt for the commands, over one link."""

from __future__ import annotations

import shlex
import signal

import click
from click.shell_completion import ShellComplete

from zendsp.cli.common import open_target, target_options
from zendsp.here.ending import ended_by

LEAVE = ("exit", "quit")


@click.command("shell")
@target_options
def command(target: str, connect: str | None, as_json: bool) -> None:
    """Type commands without their 'zendsp', all over one link and to that one target, "stop" too;
    Tab completes, help lists them, Ctrl-D leaves.

    \b
    Example:  zendsp shell -t imi
      imi> set Kp1=450
      imi> get q e
    """
    from zendsp.cli.commands import cli

    with open_target(target, connect) as t:
        complete = ShellComplete(cli, {"obj": t}, "zendsp", "_ZENDSP_COMPLETE")
        _complete_with(complete)
        while True:
            try:
                words = shlex.split(input(f"{t.name}> "))
            except EOFError:
                click.echo()
                return
            except KeyboardInterrupt:
                click.echo()
                if ended_by() != signal.SIGINT:  # Ctrl-C does not leave the prompt
                    raise
                continue
            except ValueError as error:  # a quote that does not end
                click.echo(f"zendsp: {error}", err=True)
                continue
            if words and words[0] in LEAVE:
                return
            if words:
                run_line(words, t, as_json)


def run_line(words: list[str], target: object, as_json: bool) -> None:
    """Run one command; an error is printed, and the prompt returns."""
    from zendsp.cli.commands import cli
    from zendsp.cli.complaints import say
    from zendsp.errors import ZendspError

    if words[0] == "help":
        words = [*words[1:], "--help"]
    try:
        cli.main(
            [*words, *(["--json"] if as_json else [])], prog_name="zendsp", standalone_mode=False,
            obj=target,
        )
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
    except (click.ClickException, ZendspError, OSError) as error:
        say(error)
    except (click.Abort, KeyboardInterrupt):
        if ended_by() != signal.SIGINT:
            raise
        click.echo("interrupted", err=True)
    except click.exceptions.Exit:
        return


def offers(complete: ShellComplete, line: str) -> list[str]:
    """The words that may complete the line.

    Examples
    --------
    >>> from zendsp.cli import cli
    >>> offers(ShellComplete(cli, {}, "zendsp", "_ZENDSP_COMPLETE"), "sal")
    ['salvage']
    """
    words = line.split()
    begun = words.pop() if words and not line[-1].isspace() else ""
    return [item.value for item in complete.get_completions(words, begun)]


def _complete_with(complete: ShellComplete) -> None:
    try:
        import readline
    except ImportError:  # not on every system; typing works all the same
        return
    found: list[str] = []

    def offer(_text: str, number: int) -> str | None:
        if number == 0:
            found[:] = offers(complete, readline.get_line_buffer()[: readline.get_endidx()])
        if number >= len(found):
            return None
        return found[number] + ("" if found[number].endswith("=") else " ")

    readline.set_completer_delims(" ")
    readline.set_completer(offer)
    readline.parse_and_bind("tab: complete")
