"""The given model as the table that its TOML file holds; ``docs/models.md`` explains the keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NotRequired, TypedDict

Columns = Mapping[str, str | list[str]]  # of [columns]: one name, or one a joint
OneOrEach = float | list[float]  # one number, or one a joint


class Parameter(TypedDict):
    """A parameter."""

    value: OneOrEach
    free: NotRequired[bool]  # calibration may move it, unless this says that it may not


EffectTable = dict[str, Any]  # of [[effect]]: kind, joint, and each Parameter by its name


class Mechanism(TypedDict):
    """The rigid bodies: figures, or the file that has them."""

    kind: str
    file: NotRequired[str]
    parameters: NotRequired[dict[str, Parameter]]


class Actuator(TypedDict):
    """What becomes of a command."""

    gain: NotRequired[Parameter]  # N m or N per unit of the command
    limit: NotRequired[OneOrEach]
    hold: float  # s
    delay: NotRequired[float]  # s


class Sensor(TypedDict):
    """The encoders."""

    position_resolution: OneOrEach  # rad or m


class Controller(TypedDict):
    """The loop that made the recordings."""

    kind: str
    kp: OneOrEach
    kd: OneOrEach


class ModelTable(TypedDict):
    """All of a model file."""

    name: str
    sample_time: float  # s
    mechanism: Mechanism
    effect: NotRequired[list[EffectTable]]
    actuator: Actuator
    sensor: Sensor
    columns: Columns
    controller: NotRequired[Controller]


def parameter(value: OneOrEach, fixed: bool = False) -> Parameter:
    """A parameter as a model file states it."""
    return {"value": value, "free": False} if fixed else {"value": value}


def one_or_each(values: Sequence[float]) -> OneOrEach:
    """A number a joint, as a model file states it: plain where there is one joint."""
    return list(values) if len(values) > 1 else values[0]
