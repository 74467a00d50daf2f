"""``zendsp ls``: the targets that answer."""

from __future__ import annotations

from collections.abc import Sequence

import click

from zendsp.cli.common import emit, json_option
from zendsp_protocol.views import text_table


@click.command("ls")
@click.argument("pattern", default="*")
@click.option("--connect", metavar="ENDPOINT", help="Also look there (else $ZENDSP_CONNECT).")
@json_option
def command(pattern: str, connect: str | None, as_json: bool) -> None:
    """List the targets that answer; PATTERN may hold wildcards. Exit status 1 where there are
    none, or where none answers at an ENDPOINT.

    Example:  zendsp ls 'imi*'
    """
    from zendsp.link.find import look

    found, dead = look(pattern, connect)
    rows = []
    for one in found:
        info = one.info
        status = one.status
        state = str(status.drive if status.trip else status.doing) if status else ""
        about = (
            [info.machine, state, f"{info.rate_hz:g}", info.clock, str(info.pid)]
            if info
            else ["", "unusable, see below", "", "", ""]
        )
        rows.append([one.name, *about, ", ".join(one.endpoints)])
    body = [
        {
            "name": f.name, "endpoints": f.endpoints, "problem": f.problem, "info": f.info,
            "status": f.status,
        }
        for f in found
    ]
    columns = ["NAME", "MACHINE", "STATE", "HZ", "CLOCK", "PID", "ENDPOINT"]
    problems = [one.problem for one in found if not one.info]
    table = "\n\n".join([text_table(columns, rows), *problems])
    emit(body, as_json, table if found else _none(pattern, connect))
    if found and dead:
        click.echo(f"zendsp: no target answers at {', '.join(dead)}{_why(dead)}", err=True)
    if dead or not found:
        raise click.exceptions.Exit(1)


def _why(endpoints: Sequence[str]) -> str:
    """What may be wrong at endpoints where none answers, as the end of a sentence."""
    from zendsp.link.settings import Credentials, doubts

    why = doubts(Credentials.from_environment(), endpoints)
    return f"; {why or 'or the one there refuses the certificate or password given'}"


def _none(pattern: str, connect: str | None) -> str:
    from zendsp.here.registered import remote_endpoints

    which = "no target" if pattern == "*" else f"no target named {pattern!r}"
    if endpoints := remote_endpoints(connect):
        return f"{which} answers here or at {', '.join(endpoints)}{_why(endpoints)}"
    return (
        f"{which} answers: 'zendsp target' starts one here; --connect or $ZENDSP_CONNECT"
        " finds one elsewhere"
    )
