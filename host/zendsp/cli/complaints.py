"""Prints expected errors and warnings, each in one line on standard error."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import click

from zendsp.cli.lines import fitted
from zendsp.errors import ZendspError
from zendsp_protocol.errors import nearest
from zendsp_protocol.texts import number_hint, shown


def say(error: Exception) -> None:
    """Print an expected error as one line."""
    if isinstance(error, click.ClickException):
        words = _wrong_use(error)
    elif isinstance(error, OSError) and not isinstance(error, ZendspError):
        where = f"{error.filename}: " if error.filename else ""
        words = f"{where}{error.strerror or error}"
    elif isinstance(error, MemoryError):
        why = str(error) or "none is left"
        words = f"too little memory ({why}); 'ulimit -v' and 'free' show it"
    else:
        words = str(error)
    click.echo(fitted(f"zendsp: {shown(words)}", sys.stderr), err=True)


def say_open(model: Path) -> None:
    """Warn of questions that are open in a model file, in one line on standard error."""
    from zendsp.physics.files.questions import still_open

    if words := still_open(model):
        click.echo(fitted(f"zendsp: {words}", sys.stderr), err=True)


def _wrong_use(error: click.ClickException) -> str:
    """One line on a command that was typed wrongly."""
    context = error.ctx if isinstance(error, click.UsageError) else None
    if context is not None and isinstance(error, click.exceptions.NoSuchCommand):
        group = context.command
        known = group.list_commands(context) if isinstance(group, click.Group) else []
        close = nearest(error.command_name, known)
        near = f"did you mean {close[0]}? " if close else ""
        return (
            f"no command {error.command_name!r}; {near}'{context.command_path} --help' lists them"
        )
    if context is not None and isinstance(error, click.exceptions.NoSuchOption):
        options = [name for p in context.command.params for name in p.opts]
        name = error.option_name  # without dashes, in which all are alike
        close = nearest(name.lstrip("-"), [o.lstrip("-") for o in options])
        error = click.exceptions.NoSuchOption(name, possibilities=[f"--{o}" for o in close])
    words = error.format_message()
    if type(error) is click.BadParameter:  # it is its own sentence
        words = _of_option(error.message, error.param)
    words = re.sub(r"\s+", " ", words).rstrip(".")
    words = (words[:1].lower() + words[1:]).replace(". Did you mean", "; did you mean")
    if context is None:
        return words
    return f"{words}{'' if words.endswith('?') else ';'} '{context.command_path} --help' says more"


def _of_option(message: str, parameter: click.Parameter | None) -> str:
    """What click says of a value, with the option that it is of; of a number with the numbers that
    are taken, and their unit.
    """
    typed = re.match(r"(?P<value>.*) is not (?:in the range|a valid (?:float|integer))", message)
    name = max(parameter.opts, key=len) if isinstance(parameter, click.Option) else ""
    if parameter is None or typed is None:
        return message if not name or name in message else f"{name}: {message}"
    value = typed["value"].strip("'")
    said = f"{name or parameter.human_readable_name} {value.removesuffix('.0')}"
    return f"{said}: expected {_numbers(parameter)}{number_hint(value)}"


def _numbers(parameter: click.Parameter) -> str:
    """The numbers that an option takes, in words."""
    kind = parameter.type
    whole = isinstance(kind, click.types.IntParamType)
    words = "a whole number" if whole else "a number"
    if isinstance(kind, click.IntRange | click.FloatRange):
        low, high = kind.min, kind.max
        if low is not None and high is not None:
            words += f" from {low:g} to {high:g}"
        elif low is not None:
            words += f" of more than {low:g}" if kind.min_open else f" of {low:g} or more"
    about = getattr(parameter, "help", None) or ""
    if parameter.metavar == "S" or "--seconds" in parameter.opts or about.startswith("Seconds"):
        words += ", in s"
    return words
