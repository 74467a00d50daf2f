"""``zendsp params``: sets of parameters."""

from __future__ import annotations

from pathlib import Path

import click

from zendsp.cli.common import emit, open_target, target_options
from zendsp_protocol.texts import counted
from zendsp_protocol.views import short, text_table


@click.group("params")
def command() -> None:
    """Save, compare and restore sets of parameters.

    Example:  zendsp params save good.json
    """


@command.command("show")
@target_options
def show_(target: str, connect: str | None, as_json: bool) -> None:
    """Show all parameters beside their initial values.

    Example:  zendsp params show
    """
    with open_target(target, connect) as t:
        now, infos = t.parameters(), t.variables()
        rows = [
            [name, short(value), short(infos[name].initial), infos[name].unit]
            for name, value in now.values.items()
        ]
        emit(now.values, as_json, text_table(["PARAMETER", "VALUE", "INITIAL", "UNIT"], rows))


@command.command("save")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--note", default="", help="Kept in the file.")
@target_options
def save(file: Path, note: str, target: str, connect: str | None, as_json: bool) -> None:
    """Write all parameters to FILE (JSON).

    Example:  zendsp params save good.json --note 'after tuning'
    """
    from dataclasses import replace

    with open_target(target, connect) as t:
        found = replace(t.parameters(), note=note)
        found.save(file)
        emit(
            {"file": str(file), "count": len(found.values)},
            as_json,
            f"{counted(len(found.values), 'parameter')} saved to {file}",
        )


@command.command("diff")
@click.argument("file", type=click.Path(path_type=Path))
@click.argument("other", type=click.Path(path_type=Path), required=False)
@target_options
def diff(file: Path, other: Path | None, target: str, connect: str | None, as_json: bool) -> None:
    """Compare FILE with the target, or with OTHER. Exit status 1 where they differ.

    Example:  zendsp params diff good.json
    """
    from zendsp.link import ParameterSet

    mine = ParameterSet.load(file)
    if other is not None:
        theirs = ParameterSet.load(other)
    else:
        with open_target(target, connect) as t:
            theirs = t.parameters()
    pairs = mine.diff(theirs)
    rows = [
        [
            p.name,
            short(p.mine) if p.mine is not None else "–",
            short(p.other) if p.other is not None else "–",
        ]
        for p in pairs
    ]
    body = [{"name": p.name, "file": p.mine, "other": p.other} for p in pairs]
    header = ["PARAMETER", str(file), str(other or "target")]
    emit(body, as_json, text_table(header, rows) if pairs else "no difference")
    if pairs:
        raise click.exceptions.Exit(1)


@command.command("restore")
@click.argument("file", type=click.Path(path_type=Path))
@target_options
def restore(file: Path, target: str, connect: str | None, as_json: bool) -> None:
    """Put the parameters of FILE into the target, all in one sample.

    Example:  zendsp params restore good.json
    """
    with open_target(target, connect) as t:
        tick = t.restore(file)
        emit({"tick": tick}, as_json, f"restored at sample {tick}")


@command.command("reset")
@target_options
def reset(target: str, connect: str | None, as_json: bool) -> None:
    """Put every parameter back to its initial value, all in one sample.

    Example:  zendsp params reset
    """
    with open_target(target, connect) as t:
        tick = t.reset()
        emit({"tick": tick}, as_json, f"reset at sample {tick}")
