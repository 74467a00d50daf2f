"""What the shell offers for a word: targets, variables, programs, machines, experiments. It is
fast, and offers nothing where no target answers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click
from click.shell_completion import CompletionItem

from zendsp_protocol.states import VariableKind

if TYPE_CHECKING:
    from pathlib import Path

    from zendsp.link import Target


def targets(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Names of this user's targets on this computer; other computers are not asked."""
    from zendsp.here.registered import local_entries

    names = sorted({entry.name for entry in local_entries()})
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


@contextmanager
def _asked(ctx: click.Context) -> Iterator[Target]:
    """The target that the line so far names; in ``zendsp shell`` the open one."""
    from zendsp.link import connect

    held: Target | None = ctx.find_root().obj
    name = ctx.params.get("target") or ""
    if held is not None and name in ("", held.name):
        yield held
        return
    with connect(name, ctx.params.get("connect")) as target:
        yield target


def variables(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Variables of the running program and built-in signals; after a comma, those for the next
    name.
    """
    from zendsp.errors import ZendspError

    before, comma, begun = incomplete.rpartition(",")
    try:
        with _asked(ctx) as target:
            found = {**target.variables(), **target.builtins()}
    except ZendspError:
        return []
    return [
        CompletionItem(f"{before}{comma}{info.name}", help=_words(info.unit, info.description))
        for info in found.values()
        if info.name.startswith(begun) and info.kind != VariableKind.TABLE
    ]


def assignments(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Parameters that can be set, as ``NAME=``."""
    from zendsp.errors import ZendspError

    try:
        with _asked(ctx) as target:
            found = target.variables()
    except ZendspError:
        return []
    return [
        CompletionItem(f"{info.name}=", help=_words(info.unit, info.description))
        for info in found.values()
        if info.kind == VariableKind.PARAMETER and info.name.startswith(incomplete)
    ]


def programs(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """C files here and those that come with zendsp; else any file."""
    from zendsp_isr.sources import shipped_programs

    return _files("*.c", shipped_programs(), incomplete)


def models(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Model files here and those that come with zendsp; else any file."""
    from zendsp.physics.files.shipped import model_folder

    return _files("*.toml", sorted(model_folder().glob("*.toml")), incomplete)


def _files(pattern: str, shipped: Iterable[Path], incomplete: str) -> list[CompletionItem]:
    from pathlib import Path

    here = sorted(Path.cwd().glob(pattern))
    names = dict.fromkeys(path.name for path in (*here, *shipped))
    fitting = [name for name in names if name.startswith(incomplete)]
    # a shell that is told to look for files itself shows nothing else
    return [CompletionItem(n) for n in fitting] or [CompletionItem(incomplete, type="file")]


def machines(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Machines that come with zendsp; else any file."""
    from zendsp_isr.parts import machine_names

    fitting = [CompletionItem(n) for n in machine_names() if n.startswith(incomplete)]
    return fitting or [CompletionItem(incomplete, type="file")]


def experiments(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Experiments that ``zendsp experiment`` lists."""
    from zendsp.experiment.registry import EXPERIMENTS

    return [
        CompletionItem(name, help=e.title)
        for name, e in EXPERIMENTS.items()
        if name.startswith(incomplete)
    ]


def _words(unit: str, text: str) -> str:
    return f"[{unit}] {text}" if unit else text
