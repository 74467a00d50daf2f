"""Parameter sets: all parameters of a program, to save, compare, and restore in one sample."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zendsp.errors import VariableError
from zendsp.link.requests import Part, Requests
from zendsp.link.variables import Reading, Variables, plain
from zendsp.whole_file import write_whole
from zendsp_protocol import messages as m
from zendsp_protocol import written
from zendsp_protocol.lazily import Lazily
from zendsp_protocol.spelling import unknown_keys
from zendsp_protocol.states import VariableKind
from zendsp_protocol.values import Assignable, from_wire

if TYPE_CHECKING:
    import numpy as np
else:
    np = Lazily("numpy")

FORM = 1
_KEYS = ("zendsp_parameters", "program", "target", "note", "values")
LARGEST = 1024  # elements; longer arrays are data, not parameters


@dataclass(frozen=True)
class Difference:
    """One parameter that differs; None where one side lacks it."""

    name: str
    mine: Any
    other: Any


@dataclass(frozen=True)
class ParameterSet:
    """Values of parameters by name, and the program that they belong to.

    Examples
    --------
    >>> a, b = ParameterSet({"Kp": 1.0, "Kd": 2.0}), ParameterSet({"Kp": 3.0})
    >>> a.diff(b)
    [Difference(name='Kp', mine=1.0, other=3.0), Difference(name='Kd', mine=2.0, other=None)]
    """

    values: Mapping[str, Assignable]  # bool, int, float, or a list of these
    program: str = ""
    target: str = ""
    note: str = field(default="")

    def __repr__(self) -> str:
        shown = [f"{n} = {v:.6g}" if isinstance(v, float) else f"{n} = {v}"
                 for n, v in self.values.items()]  # fmt: skip
        whose = f" of {self.target}" if self.target else ""
        return f"<ParameterSet{whose}: {', '.join(shown) or 'empty'}>"

    def diff(self, other: ParameterSet) -> list[Difference]:
        """The parameters that differ, in the order of this set."""
        names = [*self.values, *(name for name in other.values if name not in self.values)]
        pairs = [Difference(name, self.values.get(name), other.values.get(name)) for name in names]
        return [pair for pair in pairs if not _same(pair.mine, pair.other)]

    def save(self, path: str | Path) -> Path:
        """Write the set as JSON that a person can read and edit.

        Raises
        ------
        VariableError
            The name ends like another kind of file, or it cannot be written.
        """
        body = {
            "zendsp_parameters": FORM, "target": self.target, "program": self.program,
            "note": self.note,
        }
        path = Path(path).expanduser()
        if path.suffix not in ("", ".json"):
            raise VariableError(
                f"{path}: sets of parameters are JSON; name it {path.with_suffix('.json')}"
            )
        text = json.dumps(body | {"values": dict(self.values)}, indent=2) + "\n"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, text)
        except OSError as error:
            raise VariableError(f"{path}: cannot be written ({error.strerror})") from error
        return path

    @classmethod
    def load(cls, path: str | Path) -> ParameterSet:
        """Read a set.

        Raises
        ------
        VariableError
            The file is missing or not a set of parameters.
        """
        try:
            body = written.json(Path(path).expanduser().read_text(encoding="utf-8"))
            if body["zendsp_parameters"] != FORM:
                raise VariableError(
                    f"{path}: is of layout {body['zendsp_parameters']}, this zendsp reads {FORM}"
                )
            if said := unknown_keys(body, _KEYS, f"{path}: the file"):
                raise VariableError(said)
            return cls(
                dict(body["values"]),
                body.get("program", ""),
                body.get("target", ""),
                body.get("note", ""),
            )
        except OSError as error:
            why = "no such file" if isinstance(error, FileNotFoundError) else error.strerror
            raise VariableError(f"{path}: {why}; 'zendsp params save' writes one") from error
        except (ValueError, KeyError, TypeError) as error:
            if isinstance(error, VariableError):
                raise
            raise VariableError(
                f"{path}: is not a parameter set ({type(error).__name__}: {error})"
            ) from error


class ParameterSets(Part):
    """The parameters of a target's program, as sets.

    Parameters
    ----------
    requests : Requests
    variables : Variables
        Of the same target.
    """

    def __init__(self, requests: Requests, variables: Variables) -> None:
        super().__init__(requests)
        self.variables = variables

    def parameters(self) -> ParameterSet:
        """All parameters of the running code, from one sample."""
        names = self.parameter_names()
        read = self.variables.read(names).values if names else {}
        values = {name: np.asarray(value).tolist() for name, value in read.items()}
        return ParameterSet(values, self.request("status").program, self.link.target)

    def restore(self, parameters: ParameterSet | Mapping[str, Assignable] | str | Path) -> int:
        """Write a set back in one sample; return the sample at which it took effect.

        Parameters
        ----------
        parameters : ParameterSet, mapping, or path of a saved set

        Raises
        ------
        VariableError
            A name that the running code lacks, or a value outside its limits; nothing was applied.
        """
        if isinstance(parameters, str | Path):
            parameters = ParameterSet.load(parameters)
        values = parameters.values if isinstance(parameters, ParameterSet) else parameters
        return self.variables.update_alone(values)

    def reset(self) -> int:
        """Set every parameter to its initial value, in one sample."""
        infos = self.variables()
        return self.variables.update_alone(
            {name: plain(infos[name].initial) for name in self.parameter_names()}
        )

    def parameter_names(self) -> list[str]:
        """Names of all parameters of the running code; large arrays are data, not parameters."""
        return _names(self.variables().values())

    def insist_on_all(self, patience: float) -> Reading:
        """All parameters of the running code, from one sample; asked again after each outage of up
        to ``patience`` s.
        """
        names = _names(self.insist("variables", patience))
        if not names:
            return Reading(0, {})
        found: m.Reading = self.insist("read", patience, names=names)
        return Reading(found.tick, {name: from_wire(v) for name, v in found.values.items()})


def _names(infos: Iterable[m.VariableInfo]) -> list[str]:
    return [i.name for i in infos if i.kind == VariableKind.PARAMETER and i.length <= LARGEST]


def _same(a: Any, b: Any) -> bool:
    return a is not None and b is not None and np.array_equal(np.asarray(a), np.asarray(b))
