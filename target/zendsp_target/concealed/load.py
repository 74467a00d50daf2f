"""What a machine shall conceal, read from a file or drawn by seed."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from zendsp_protocol import written
from zendsp_protocol.errors import Refused
from zendsp_protocol.spelling import unknown_keys
from zendsp_target.concealed.draw import draw_from_text
from zendsp_target.concealed.sealed import EFFECTS, LAWS, Concealed, ConcealedEffect


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
        data = written.json(text) if path.suffix == ".json" else written.toml(text)
    except (ValueError, OSError) as error:
        raise Refused(f"concealed: {path}: {error}") from error
    _only(data, ("effect", "friction"), f"concealed: {path}: the file")
    effects = []
    for number, table in enumerate(data.get("effect", []), start=1):
        if not isinstance(table, dict) or "kind" not in table:
            raise Refused(f"concealed: {path}: effect {number} has no kind")
        kind, where = str(table["kind"]), f"concealed: {path}: effect {number}"
        if kind in EFFECTS:
            _only(table, ("kind", "joint", *EFFECTS[kind]), where)
        numbers = {
            k: _number(where, k, v) for k, v in table.items() if k not in ("kind", "joint")
        }
        effects.append(ConcealedEffect(kind, int(table.get("joint", 1)), numbers))
    return Concealed(machine, tuple(effects), path.name, str(data.get("friction", "full")))


def _only(table: Mapping[str, Any], allowed: Collection[str], where: str) -> None:
    """Refuse keys that would not be read."""
    if said := unknown_keys(table, allowed, where):
        raise Refused(said)


def _number(where: str, key: str, value: Any) -> float:
    """The value of a key: a number, a table { value = … } as in model files, or the name of a
    coupling's law.
    """
    if isinstance(value, dict) and "value" in value:
        _only(value, ("value", "free", "unit", "std"), f"{where}: {key}")
        value = value["value"]
    if key == "law" and value in LAWS:
        return float(LAWS.index(value))
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise Refused(f"{where}: {key} is {value!r}; expected a number")
    return float(value)
