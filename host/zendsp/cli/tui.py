"""``zendsp tui``: Console, Execute, Reference and Diagnose in the terminal, or in a browser."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import click

from zendsp.cli.common import parse_names
from zendsp.cli.completing import machines
from zendsp.errors import LinkError
from zendsp.here.ending import ENDING, SOFT, interrupt, let_go_of_terminal
from zendsp.here.registered import CONNECT
from zendsp.tui.early import has_begun
from zendsp_isr.parts import is_model, machine_source


@click.command("tui")
@click.argument("target", required=False, default="")
@click.option(
    "-t", "--target", "named", default="", envvar="ZENDSP_TARGET", metavar="NAME",
    help="The same as TARGET, as of the other commands (else $ZENDSP_TARGET).",
)
@click.option(
    "--local", "--machine", "machine", metavar="MACHINE", shell_complete=machines,
    help="Start a simulated machine here, for example imi_planar.",
)
@click.option(
    "--clock", type=click.Choice(["real", "fast"]), default="real", show_default=True,
    help="Clock of --local.",
)
@click.option(
    "--source", metavar="FILE", help="C file to work on: a path, or a shipped program such as pd.c."
)
@click.option(
    "--folder",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("."),
    help="Where references, runs and parameter sets are kept (default: here).",
)
@click.option(
    "--screen",
    type=click.Choice(["console", "execute", "reference", "diagnose"]),
    default="console",
    show_default=True,
    help="Screen to begin with.",
)
@click.option(
    "--theme", default="zendsp-night", show_default=True,
    help="zendsp-night, zendsp-day, zendsp-contrast, or any of Textual's.",
)
@click.option(
    "--channels", default="", metavar="A,B,…", help="Curves to begin with, for example q[0],tau[0]."
)
@click.option(
    "--frames",
    type=click.FloatRange(1.0, 60.0),
    default=30.0,
    show_default=True,
    help="Pictures a second; fewer over a slow line.",
)
@click.option("--web", is_flag=True, help="Serve the same screens in a browser on loopback.")
@click.option(
    "--port", type=click.IntRange(1, 65535), default=8000, show_default=True,
    help="Port of --web.",
)
@click.option(
    "--screenshots",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Write pictures of the screens (SVG) and end.",
)
def command(
    target: str,
    named: str,
    machine: str | None,
    clock: str,
    source: str | None,
    folder: Path,
    screen: str,
    theme: str,
    channels: str,
    frames: float,
    web: bool,
    port: int,
    screenshots: Path | None,
) -> None:
    """Tune, drive, watch and diagnose a machine: Console, Execute, Reference and Diagnose,
    diagnosis in the terminal.

    TARGET is the name of a running target; without it, Ctrl+O chooses one. F9 is STOP, everywhere.

    \b
    Examples:
      zendsp tui imi
      zendsp tui --local imi_planar --source pd.c
      zendsp tui --web --port 8000 imi
    """
    if screenshots is not None:
        from zendsp.tui.screenshots import take_screenshots

        for picture in take_screenshots(screenshots):
            click.echo(picture)
        return
    path = found(source) if source else None
    if machine and not is_model(machine):
        machine_source(machine)  # refuses one that is not there before the screen is taken
    if not machine:  # a machine that is started here is the target
        target = target or named
    if web:
        _serve(target, machine, clock, path, folder, screen, theme, channels, frames, port)
        return
    if "TEXTUAL_DRIVER" not in os.environ and not has_begun():
        _need_terminal()
    from zendsp.tui.memory import keep_one_heap

    keep_one_heap()  # before anything of the link starts a thread
    from zendsp.tui.stopper import Stopper

    # started with nohup, it would look for keys in a terminal that is gone, for ever
    for number in SOFT:
        signal.signal(number, interrupt)
    stopper = Stopper(target)  # first: it is ready for STOP when the screens are
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)  # what was held until now comes here
        from zendsp.reference import MACHINES
        from zendsp.tui.app import ZendspApp
        from zendsp.tui.link_port import find_targets, open_port, start_machine

        app = ZendspApp(
            open_port,
            find_targets=find_targets,
            start_machine=lambda name: start_machine(name, clock),
            machines=MACHINES,
            target=target,
            folder=folder.resolve(),
            source=path,
            first=screen,
            theme=theme,
            begin=machine or "",
            frames=frames,
            channels=parse_names(channels),
        )
        app.session.stops.guard_keys(stopper, target)
        with errors_kept():
            app.run()
    finally:
        if said := stopper.close():
            click.echo(said, err=True)
    status = app.return_code or 0
    if status > 128:
        click.echo(f"ended by {signal.Signals(status - 128).name}", err=True)
    click.get_current_context().exit(status)  # 1 where an error ended the screens


@contextlib.contextmanager
def errors_kept() -> Iterator[None]:
    """Hold back what libraries write on standard error until the screens are closed: on the same
    terminal it would garble them.
    """
    if not sys.stderr.isatty():
        yield
        return
    terminal = os.dup(2)
    with tempfile.TemporaryFile() as kept:
        os.dup2(kept.fileno(), 2)
        try:
            yield
        finally:
            sys.stderr.flush()
            os.dup2(terminal, 2)
            os.close(terminal)
            let_go_of_terminal()  # it may be gone by now
            kept.seek(0)
            shutil.copyfileobj(kept, sys.stderr.buffer)
            sys.stderr.flush()


def _need_terminal() -> None:
    """Refuse where input or output is no terminal."""
    for stream, what in ((sys.stdin, "keys come from"), (sys.stdout, "output goes")):
        if not stream.isatty():
            raise LinkError(
                f"the screens need a terminal, and the {what} elsewhere: leave out the pipe, or"
                " see them in a browser with --web"
            )


def found(source: str) -> Path:
    """The file that --source means, looked for as `zendsp run` does."""
    from zendsp_isr.sources import find_program

    return find_program(source).resolve()


def _serve(
    target: str,
    machine: str | None,
    clock: str,
    source: Path | None,
    folder: Path,
    screen: str,
    theme: str,
    channels: str,
    frames: float,
    port: int,
) -> None:
    try:
        from zendsp.tui.web import serve
    except ImportError as error:
        raise LinkError("--web needs textual-serve: pip install 'zendsp[web]'") from error
    from zendsp.link import local

    # one machine for all pages, not one for each
    with local(machine, clock=clock) if machine else contextlib.nullcontext() as started:
        if started is not None:
            os.environ.pop(CONNECT, None)  # the pages are to find it here
        name = started.name if started is not None else target
        words = ["tui", *([name] if name else [])]
        for option, value in (("--source", source), ("--folder", folder), ("--channels", channels)):
            words += [option, str(value)] if value else []
        words += ["--screen", screen, "--theme", theme, "--frames", str(frames)]
        serve(words, port)
