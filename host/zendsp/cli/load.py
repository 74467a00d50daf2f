"""``zendsp load``: compile and load a program without starting it."""

from __future__ import annotations

import click

from zendsp.cli.common import emit, flag_option, open_target, target_options
from zendsp.cli.compile import compiled
from zendsp.cli.completing import programs
from zendsp_protocol.texts import counted


@click.command("load")
@click.argument("file", shell_complete=programs)
@flag_option
@target_options
def command(
    file: str, flags: tuple[str, ...], target: str, connect: str | None, as_json: bool
) -> None:
    """Compile FILE on the target and load it; nothing moves before 'zendsp run'.

    What ran before ends. Exit status 1 where it does not compile; then what was loaded stays.

    Drives that were switched by hand are disabled; "zendsp drive enable" enables them.

    Example:  zendsp load pd.c && zendsp set Kp1=400 && zendsp run
    """
    with open_target(target, connect, moves=True) as t:
        compiled(lambda: t.download(file, flags), as_json, t)
        status = t.status()
        count = len(t.variables())
        emit(
            status,
            as_json,
            f"{status.state}: {counted(count, 'variable')}; 'zendsp info' lists them, 'zendsp"
            " run' starts it",
        )
