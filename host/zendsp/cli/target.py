"""``zendsp target``: runs a target on this computer, in the foreground."""

from __future__ import annotations

import os
import signal
import sys

import click

from zendsp.cli.completing import machines


@click.command(
    "target", context_settings={"ignore_unknown_options": True, "allow_extra_args": True}
)
@click.option(
    "--machine", default="imi_planar", show_default=True, help="Machine to drive.",
    shell_complete=machines,
)
@click.option("--name", help="Name of the target (default: that of the machine).")
@click.option("--rate", type=float, default=1000.0, show_default=True, help="Sample rate, Hz.")
@click.option("--clock", type=click.Choice(["real", "fast"]), default="real", show_default=True)
@click.option(
    "--listen", multiple=True, metavar="ENDPOINT",
    help="Zenoh endpoint (default: here, a socket that only you can open); may be repeated.",
)
@click.pass_context
def command(
    context: click.Context,
    machine: str,
    name: str | None,
    rate: float,
    clock: str,
    listen: tuple[str, ...],
) -> None:
    """Run a target until Ctrl-C; on a bare machine, 'python -m zendsp_target' does the same.

    All options of that command are taken; 'python -m zendsp_target --help' lists them: TLS, users
    and roles, routers, CPU, memory, what a simulated machine conceals.

    Example:  zendsp target --machine imi_planar --name imi --rate 1000
    """
    arguments = ["--machine", machine, "--rate", str(rate), "--clock", clock]
    arguments += ["--name", name] if name else []
    for endpoint in listen:
        arguments += ["--listen", endpoint]
    sys.stdout.flush()
    # a Ctrl-C is kept until the new program can end by it
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    words = ("-P", "-m", "zendsp_target", *arguments, *context.args)
    os.execv(sys.executable, [sys.executable, *words])
