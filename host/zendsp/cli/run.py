"""``zendsp run``: compile, download and start a program."""

from __future__ import annotations

import click

from zendsp.cli.common import emit, open_target, parse_assignments, progress, target_options
from zendsp.cli.compile import report


@click.command("run")
@click.argument("file", required=False)
@click.option(
    "--set", "assignments", multiple=True, metavar="NAME=VALUE", help="Before it starts; may be repeated."
)
@click.option("--seconds", type=float, help="Pause after this time of the target and wait for it.")
@click.option("--flag", "flags", multiple=True, help="Further flag for the compiler.")
@target_options
def command(
    file: str | None,
    assignments: tuple[str, ...],
    seconds: float | None,
    flags: tuple[str, ...],
    target: str,
    connect: str | None,
    as_json: bool,
) -> None:
    """Compile FILE on the target, load it and start it; without FILE, start what is loaded.

    Exit status 1 where it does not compile.

    Example:  zendsp run pd.c --set Kp1=400 --seconds 10
    """
    from zendsp.errors import CompileFailed

    values = parse_assignments(assignments)
    with open_target(target, connect) as t:
        if file is not None:
            try:
                t.download(file, flags)
            except CompileFailed as error:
                result = getattr(error, "result", None)
                if result is None:
                    raise
                report(result, as_json)
                raise click.exceptions.Exit(1) from None
        if values:
            t.write(**values)
        if seconds is None:
            t.start()
            emit(t.status(), as_json, "running")
            return
        with progress("running", seconds, as_json) as set_fraction:
            first = t.status()
            t.start(max(1, round(seconds * first.rate_hz)))
            status = t.wait(2.0 * seconds + 10.0, on_status=lambda s: set_fraction((s.t - first.t) / seconds))
        emit(status, as_json, f"{status.state} at sample {status.tick}")
