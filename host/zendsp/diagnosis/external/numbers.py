"""The numbers of a simulator: one name each, where a file has a list."""

from __future__ import annotations

from dataclasses import replace

from zendsp.diagnosis.external.columns import Parameters
from zendsp.physics.model import Model, Quantity


def expanded(model: Model) -> Model:
    """The model with a name for every number of a simulator: those of a list are ``key[1]``, …"""
    named: dict[str, tuple[Quantity, ...]] = {}
    for key, items in model.mechanism.items():
        if len(items) == 1:
            named[key] = items
        else:
            named |= {f"{key}[{i}]": (q,) for i, q in enumerate(items, 1)}
    return replace(model, mechanism=named)


def folded(values: dict[str, float]) -> Parameters:
    """The numbers as the simulator takes them: lists for ``key[1]``, …"""
    out: dict[str, float | list[float]] = {}
    for key, value in values.items():
        name, found, _ = key.partition("[")
        if not found:
            out[key] = value
        else:
            listed = out.setdefault(name, [])
            assert isinstance(listed, list)
            listed.append(value)
    return out


def as_given(model: Model) -> Model:
    """A model as files give it, without a simulator: the inverse of ``expanded``."""
    lists: dict[str, list[Quantity]] = {}
    for key, items in model.mechanism.items():
        lists.setdefault(key.partition("[")[0], []).extend(items)
    mechanism = {key: tuple(items) for key, items in lists.items()}
    return replace(model, mechanism=mechanism, called=None)
