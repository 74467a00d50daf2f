"""What the commands share: the choice of a target, printing, progress."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
import msgspec
from click.core import ParameterSource

from zendsp.cli import completing
from zendsp.cli.lines import fitted
from zendsp.errors import ZendspError
from zendsp_protocol.texts import number_hint, shown
from zendsp_protocol.values import Assignable, Packed, from_wire

if TYPE_CHECKING:
    from zendsp.link import Target
    from zendsp_protocol import messages as m

_UNIT = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*[^\W\d_]")  # a number, a letter
F = TypeVar("F", bound=Callable[..., Any])


flag_option = click.option(
    "--flag", "flags", multiple=True, help="Further flag for the compiler; may be repeated."
)


json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")


def out_option(what: str, **more: Any) -> Callable[[F], F]:
    """The option ``--out``, a path; ``what`` is its help, ``more`` goes to click."""
    return click.option("-o", "--out", type=click.Path(path_type=Path), help=what, **more)


def target_options(function: F) -> F:
    """A command with the options ``--target``, ``--connect`` and ``--json`` added."""
    decorators = (
        json_option,
        click.option(
            "--connect", metavar="ENDPOINT",
            help="Where to reach it, e.g. tls/robot.lab:7447 (else $ZENDSP_CONNECT).",
        ),
        click.option(
            "-t", "--target", default="", envvar="ZENDSP_TARGET", metavar="NAME",
            shell_complete=completing.targets,
            help="Which target (else $ZENDSP_TARGET, or the only one on this machine).",
        ),
    )
    for decorate in decorators:
        function = decorate(function)
    return function


sample_option = click.option(
    "--sample", type=int, metavar="N",
    help="Acknowledge only what is latched since this sample, and nothing that came after it.",
)


def acknowledge(target: Target, sample: int | None) -> None:
    """Acknowledge the latched trip, or only the trip of one sample, and print what it was."""
    from zendsp.errors import Refused

    trip = target.status().trip
    if trip and sample not in (None, trip.tick):
        raise Refused(
            f"not acknowledged: another one is latched, since sample {trip.tick}. {trip.text}"
        )
    click.echo(target.acknowledge(trip), err=True)


class NotCompiled(click.exceptions.Exit):
    """Ends a command whose code does not compile; why not is told by then."""

    def __str__(self) -> str:
        return "not compiled"


@contextmanager
def open_target(name: str, endpoint: str | None, moves: bool = False) -> Iterator[Target]:
    """A connection to the target that the options name; in ``zendsp shell`` it is that of the
    shell.

    At the end a trip or crash of the target is reported on standard error; not an old one, where
    the command failed for another reason.

    Parameters
    ----------
    moves : bool
        The command moves the machine: after Ctrl-C, and where the target is lost, it is said how
        the machine is left, or that this is not known.
    """
    from zendsp.errors import LinkError

    held = held_target(name, endpoint)
    if held is not None:
        try:
            yield held
        except (KeyboardInterrupt, LinkError):
            if moves:
                _say_of(held, how_left(held))
            raise
        return
    from zendsp.link import connect

    with connect(name, endpoint) as target:
        target.requests.outlives = False  # a command says how it leaves the machine
        refused, cut_short, old = "", False, ""
        with suppress(ZendspError):
            old = trouble_of(target)[1]
        try:
            yield target
        except (KeyboardInterrupt, LinkError):
            cut_short = moves
            raise
        except (ZendspError, NotCompiled) as error:
            refused = str(error)
            raise
        finally:
            if cut_short:
                _say_of(target, how_left(target))
            elif target.alive:
                _say_trouble(target, refused, old)


def _say_trouble(target: Target, refused: str, old: str) -> None:
    """Say what is latched or crashed at the end of a command that was ``refused`` for this reason;
    not what is ``old`` then, unless that is the reason.
    """
    said, latched = "", False
    with suppress(ZendspError):  # it went away at this moment: the command itself is told so
        status, said = trouble_of(target)
        latched = status.trip is not None and f"{status.trip.text}: " in refused
    if said and (latched or not refused or said != old):
        _say_of(target, said)
    if said and latched:
        raise click.exceptions.Exit(2)  # it was refused for that: once is enough


def trouble_of(target: Target) -> tuple[m.Status, str]:
    """The status of a target; what is latched or crashed there, and what to do next."""
    from zendsp.link.programs import trouble

    status = target.status()
    return status, trouble(status, target.drive_status() if status.trip is not None else None)


def _say_of(target: Target, words: str) -> None:
    click.echo(fitted(f"zendsp: {target.name}: {words}", sys.stderr), err=True)


def how_left(target: Target) -> str:
    """The state in which an interrupted command leaves the machine."""
    from zendsp.link.programs import left

    with suppress(ZendspError, KeyboardInterrupt):  # of somebody who waits no longer
        status = target.status()
        return left(status, target.drive_status() if status.trip is not None else None)
    safe = target.link.farewell()
    if safe:
        return "the target has ended; as it said, its machine is in its safe state"
    if safe is not None:
        return (
            "the target has ended, and as it said its machine is NOT in its safe state: use the"
            " machine's emergency stop"
        )
    if target.link.over:
        return (
            "NOT KNOWN whether the machine still moves: its target has ended without a word. Use"
            " the machine's emergency stop; a simulated machine has ended with its target"
        )
    return (
        "NOT KNOWN whether the machine still moves: the target does not answer. Use 'zendsp stop',"
        " and the machine's emergency stop where that does not say that it stopped"
    )


def held_target(name: str, endpoint: str | None) -> Target | None:
    """The target of the shell in which the command was typed, if it is the one that is meant;
    ``$ZENDSP_TARGET`` no longer counts there.
    """
    context = click.get_current_context(silent=True)
    held: Target | None = context.find_root().obj if context is not None else None
    if context is None or held is None or endpoint:
        return None
    typed = context.get_parameter_source("target") == ParameterSource.COMMANDLINE
    return held if name in ("", held.name) or not typed else None


def check_writable(out: Path) -> None:
    """Refuse a folder that cannot be written to, before the work rather than after it."""
    place = out.resolve()  # of report/.. too, where there is no report yet
    missing = [folder for folder in (place, *place.parents) if not folder.exists()]
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ZendspError(
            f"--out {out}: cannot be made a folder ({error.strerror}): choose one that you may"
            " write to"
        ) from None
    writable = os.access(place, os.W_OK)
    for folder in missing:  # what is interrupted leaves none
        folder.rmdir()
    if not writable:
        raise ZendspError(f"--out {out}: you may not write there: choose another folder")


def emit(value: Any, as_json: bool, text: Callable[[], str] | str = "") -> None:
    """Print ``value`` as JSON, or else the text."""
    if as_json:
        click.echo(json.dumps(plain(value), allow_nan=False))
    else:
        words = text() if callable(text) else text
        if words:
            click.echo(fitted(shown(words), sys.stdout))


def plain(value: Any) -> Any:
    """Messages, arrays and infinities as types that JSON has (an infinite limit becomes null)."""
    if isinstance(value, Packed):
        value = from_wire(value)
    if isinstance(value, msgspec.Struct):
        value = msgspec.structs.asdict(value)
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not -1.8e308 < value < 1.8e308:
        return None
    return value


def wrapped(text: str, head: str) -> str:
    """``text`` after ``head``, wrapped to the width of the terminal (80 where there is none);
    further lines are indented below the first.
    """
    width = shutil.get_terminal_size((80, 24)).columns
    return textwrap.fill(
        text, max(width, len(head) + 20), initial_indent=head, subsequent_indent=" " * len(head),
        break_long_words=False, break_on_hyphens=False,
    )


def parse_value(text: str) -> Any:
    """The value that was typed: ``3``, ``0.5``, ``true``, ``[1, 2]``, or of a matrix ``[[1, 2], [3,
    4]]``.

    Raises
    ------
    click.BadParameter
        Anything else.
    """
    try:
        value = json.loads(text)
    except ValueError:
        value = None
        if unit := _UNIT.match(text):
            raise click.BadParameter(
                f"{text!r} is not a value: values are written without their unit ({unit[1]}), in"
                " the unit that 'zendsp info' shows"
            ) from None
        if point := number_hint(text):
            array = f", and an array is written [{text.replace(',', ', ')}]" if "," in text else ""
            raise click.BadParameter(f"{text!r} is not a value{point}{array}") from None
    if isinstance(value, bool | int | float) or _numbers(value):
        return value
    matrix = isinstance(value, list) and value and all(_numbers(row) for row in value)
    if matrix and len({len(row) for row in value}) == 1:
        return value
    raise click.BadParameter(
        f"{text!r} is not a value; write 3, 0.5, true, false, [1, 2] or [[1, 2], [3, 4]]"
    )


def _numbers(value: Any) -> bool:
    return (
        isinstance(value, list)
        and bool(value)
        and all(isinstance(item, bool | int | float) for item in value)
    )


def parse_names(text: str) -> list[str]:
    """Names separated by commas; a comma within ``K[1,2]`` belongs to the name."""
    return [name.strip() for name in re.split(r",(?![^\[]*\])", text) if name.strip()]


def parse_assignments(pairs: tuple[str, ...]) -> dict[str, Assignable]:
    """Values by name, from ``NAME=VALUE …``."""
    values: dict[str, Assignable] = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        name = name.strip()
        if not equals or not name:
            raise click.BadParameter(f"{pair!r}: expected NAME=VALUE")
        if name in values:
            raise click.BadParameter(f"{pair!r}: {name} has a value already")
        values[name] = parse_value(text)
    return values


def file_and_values(
    words: tuple[str, ...], assignments: tuple[str, ...]
) -> tuple[str | None, dict[str, Assignable]]:
    """FILE, and the values of one ``--set A=1 B=2``, whose second value is typed as an argument."""
    files = [word for word in words if "=" not in word or os.path.isfile(word)]
    if len(files) > 1:
        raise click.UsageError(
            f"one FILE, not {len(files)}: {', '.join(files)}; values are written --set NAME=VALUE"
        )
    more = tuple(word for word in words if word not in files)
    if more and not assignments:
        raise click.UsageError(f"{more[0]!r} is no file; a value is written --set {more[0]}")
    return (files[0] if files else None), parse_assignments(assignments + more)


@contextmanager
def progress(what: str, expected_s: float, as_json: bool) -> Iterator[Callable[[float], None]]:
    """Show a bar on a terminal for work of more than a second; yields a function that takes the
    fraction done.
    """
    if expected_s < 1.0 or as_json or not sys.stderr.isatty():
        yield lambda fraction: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda fraction: bar.update(task, completed=fraction)


def announcing(words: str, tell: Callable[[float], None]) -> Callable[[float], None]:
    """``tell``, which at its first call says on standard error what the command will do: by then
    all is checked that could refuse it.
    """
    left = [words]

    def told(fraction: float) -> None:
        if left:
            click.echo(left.pop(), err=True)
        tell(fraction)

    return told
