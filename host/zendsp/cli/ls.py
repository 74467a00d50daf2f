"""``zendsp ls``: the targets that answer."""

from __future__ import annotations

import click

from zendsp.cli.common import emit, table


@click.command("ls")
@click.argument("pattern", default="*")
@click.option("--connect", metavar="ENDPOINT", help="Also look there (else $ZENDSP_CONNECT).")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def command(pattern: str, connect: str | None, as_json: bool) -> None:
    """List the targets that answer; PATTERN may hold wildcards. Exit status 1 where there are none.

    Example:  zendsp ls 'imi*'
    """
    from zendsp.link import discover

    found = discover(pattern, connect)
    rows = []
    for one in found:
        info = one.info
        about = (
            [info.machine, f"{info.rate_hz:g}", info.clock, str(info.pid)]
            if info
            else [one.problem, "", "", ""]
        )
        rows.append([one.name, *about, ", ".join(one.endpoints)])
    body = [
        {"name": f.name, "endpoints": f.endpoints, "problem": f.problem, "info": f.info}
        for f in found
    ]
    text = (
        table(rows, ["NAME", "MACHINE", "HZ", "CLOCK", "PID", "ENDPOINT"])
        if found
        else "no target answers: 'zendsp target' starts one here; --connect or $ZENDSP_CONNECT"
        " finds one elsewhere"
    )
    emit(body, as_json, text)
    if not found:
        raise click.exceptions.Exit(1)
