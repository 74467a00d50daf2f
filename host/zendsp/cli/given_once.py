"""Refuses an option that is given twice where it has one value: click would take the last."""

from __future__ import annotations

from functools import partial
from typing import Any

import click


def given_once(command: click.Command) -> click.Command:
    """The same command, and all commands below it, which now refuse it."""
    if not getattr(command, "given_once", False):
        # click has no other place through which the commands of all groups go
        setattr(command, "given_once", True)  # noqa: B010
        setattr(command, "parse_args", partial(_parse, command, command.parse_args))  # noqa: B010
        if isinstance(command, click.Group):
            setattr(command, "get_command", partial(_found, command.get_command))  # noqa: B010
    return command


def _found(find: Any, ctx: click.Context, name: str) -> click.Command | None:
    command = find(ctx, name)
    return None if command is None else given_once(command)


def _parse(command: click.Command, parse: Any, ctx: click.Context, args: list[str]) -> Any:
    if not ctx.resilient_parsing:
        _, _, order = command.make_parser(ctx).parse_args(list(args))
        for option in order:
            if _has_one_value(option) and order.count(option) > 1:
                raise click.UsageError(_words(option, args), ctx)
    return parse(ctx, args)


def _has_one_value(parameter: click.Parameter) -> bool:
    return isinstance(parameter, click.Option) and not (
        parameter.multiple or parameter.count or parameter.is_flag
    )


def _words(option: click.Parameter, args: list[str]) -> str:
    """What is wrong, and what was probably meant."""
    name = max(option.opts, key=len)
    given = []
    for word, after in zip(args, [*args[1:], ""], strict=True):
        head, joined, value = word.partition("=")
        if head in option.opts:
            given.append(value if joined else after)
    from zendsp.recording.formats.cells import is_number  # only where a command is refused

    listed = isinstance(option.type, click.types.StringParamType) and all(map(is_number, given))
    return f"{name} is given more than once and takes one value" + (
        f": several numbers are written {name} {','.join(given)}"
        if listed and given else ": give it once"
    )
