"""What a machine shall conceal, read from a file or drawn by seed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from zendsp_protocol import toml
from zendsp_protocol.errors import Refused
from zendsp_target.concealed.draw import draw_from_text
from zendsp_target.concealed.sealed import LAWS, Concealed, ConcealedEffect


def load_concealed(
    spec: str | None, machine: str, config: Mapping[str, Any] | None = None
) -> Concealed:
    """What a machine shall conceal.

    Parameters
    ----------
    spec : str or None
        ``"none"`` or None; ``"seed:17"``;
        ``"seed:17,effect=ripple,joint=2,friction=plain,count=2"`` (each part optional;
        ``seed:random`` draws the seed too); or the path of a TOML or JSON file with ``[[effect]]``
        tables (``kind``, ``joint`` and the parameters), and optionally ``friction``.
    machine : str
        Name of the machine.
    config : mapping, optional
        Settings of the machine: a ``friction`` there overrules that of the spec.

    Returns
    -------
    Concealed
        Sealed.

    Raises
    ------
    Refused
        No such file, effect, joint or parameter.

    Examples
    --------
    >>> load_concealed("seed:17", "imi_planar").effects == load_concealed("seed:17", "imi_planar").effects
    True
    """  # noqa: E501
    if spec is None or spec in ("", "none"):
        loaded = Concealed(machine, (), "none")
    elif spec.startswith("seed:"):
        loaded = draw_from_text(spec, machine)
    else:
        loaded = _from_file(Path(spec), machine)
    friction = (config or {}).get("friction")
    return loaded if friction is None else replace(loaded, friction=str(friction))


def _from_file(path: Path, machine: str) -> Concealed:
    if not path.is_file():
        raise Refused(f"concealed: no file {path}; give a TOML or JSON file, or seed:17")
    try:
        text = path.read_text()
        data = json.loads(text) if path.suffix == ".json" else toml.loads(text)
    except (ValueError, OSError) as error:
        raise Refused(f"concealed: {path}: {error}") from error
    effects = []
    for number, table in enumerate(data.get("effect", []), start=1):
        if not isinstance(table, dict) or "kind" not in table:
            raise Refused(f"concealed: {path}: effect {number} has no kind")
        numbers = {
            k: _number(path, number, k, v) for k, v in table.items() if k not in ("kind", "joint")
        }
        effects.append(ConcealedEffect(str(table["kind"]), int(table.get("joint", 1)), numbers))
    return Concealed(machine, tuple(effects), path.name, str(data.get("friction", "full")))


def _number(path: Path, effect: int, key: str, value: Any) -> float:
    """A number, or a table { value = … } as in model files, or the name of a coupling's law."""
    if isinstance(value, dict) and "value" in value:
        value = value["value"]
    if key == "law" and value in LAWS:
        return float(LAWS.index(value))
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise Refused(f"concealed: {path}: effect {effect}: {key} is {value!r}; expected a number")
    return float(value)
