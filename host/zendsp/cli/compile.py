"""``zendsp compile``: compile C code on a target without running it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from zendsp.cli.common import NotCompiled, emit, flag_option, open_target, target_options
from zendsp.cli.completing import programs
from zendsp.cli.progress import stages
from zendsp_protocol.states import ProgramState

if TYPE_CHECKING:
    from zendsp.link import Target


@click.command("compile")
@click.argument("file", shell_complete=programs)
@flag_option
@target_options
def command(
    file: str, flags: tuple[str, ...], target: str, connect: str | None, as_json: bool
) -> None:
    """Compile FILE (with the headers beside it) on the target; the running program is not touched.

    Warnings and errors name file, line and column. Exit status 1 where it does not compile.

    Example:  zendsp compile pd.c
    """
    with open_target(target, connect) as t:
        report(compiled(lambda: t.compile(file, flags), as_json), as_json)


def compiled(work: Callable[[], Any], as_json: bool, target: Target | None = None) -> Any:
    """The result of compiling, or of compiling and loading on a ``target``. Code that does not
    compile is reported, with what goes on running, and ends the command with status 1.
    """
    from zendsp.errors import CompileFailed

    try:
        with stages(quiet=as_json) as tell:  # a UserInit without end takes 10 s
            tell("compiling" if target is None else "compiling and loading")
            return work()
    except CompileFailed as error:
        result = getattr(error, "result", None)
        if result is None:  # the file itself is missing
            raise
        report(result, as_json)
        if target is not None and target.status().state == ProgramState.RUNNING:
            click.echo(f"zendsp: {target.name}: what was loaded before goes on running", err=True)
        raise NotCompiled(1) from None


def report(result: Any, as_json: bool) -> None:
    """Print the compiler's messages to standard error, and the outcome to standard output."""

    if not as_json:
        for message in result.diagnostics:
            click.echo(str(message), err=True)
    how = "from the cache" if result.cached else f"in {result.seconds:.2f} s"
    emit(result, as_json, f"compiled {how}: {result.key[:12]}" if result.ok else "not compiled")
