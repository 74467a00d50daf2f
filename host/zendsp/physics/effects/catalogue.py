"""Every known effect by name: those of this folder, one file each, and those of a user's file."""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
from collections.abc import Collection
from functools import cache
from pathlib import Path

from zendsp.errors import ModelError
from zendsp.physics.effects.base import Effect

# names of findings that no term of a model stands for
OUTSIDE = {"disturbance": "disturbance"}
# what else an effect may need, by the sites that give it
SUPPORT = {"dry": ("dry",), "friction": ("dry", "viscous")}

_extra: dict[str, Effect] = {}


@cache
def _shipped() -> dict[str, Effect]:
    found = {}
    for module in pkgutil.iter_modules([str(Path(__file__).parent)]):
        effect = getattr(importlib.import_module(f"{__package__}.{module.name}"), "EFFECT", None)
        if isinstance(effect, Effect):
            found[effect.name] = effect
    return dict(sorted(found.items()))


def library() -> dict[str, Effect]:
    """Every known effect by name: those shipped and those that the user added.

    Returns
    -------
    dict of str to Effect
        In alphabetical order; the order is the index that the compiled kernel uses.

    Examples
    --------
    >>> from zendsp.physics.effects import library
    >>> library()["coulomb"].equation
    'Fc sign(q̇)'
    """
    return {**_shipped(), **_extra} if _extra else _shipped()


def get_effect(name: str) -> Effect:
    """The effect of that name.

    Parameters
    ----------
    name : str

    Returns
    -------
    Effect

    Raises
    ------
    ModelError
        Where the library has none of that name.
    """
    try:
        return _shipped().get(name) or _extra[name]
    except KeyError:
        raise ModelError(
            f"no physical effect is called {name!r}; known: {', '.join(library())}"
        ) from None


@cache
def _shipped_at(site: str) -> frozenset[str]:
    return frozenset(e.name for e in _shipped().values() if e.site == site)


def at_site(site: str) -> frozenset[str]:
    """Names of the effects that act at a site."""
    own = {e.name for e in _extra.values() if e.site == site}
    return _shipped_at(site) | own if own else _shipped_at(site)


def mechanism_of(name: str) -> str:
    """The mechanism that an effect describes.

    Parameters
    ----------
    name : str
        As in model files and reports.

    Returns
    -------
    str
        One of ``MECHANISMS``; the name itself where none is stated: an effect of a user's own is a
        mechanism by itself.

    Examples
    --------
    >>> from zendsp.physics.effects import mechanism_of
    >>> mechanism_of("stribeck")
    'dry_friction'
    """
    effect = library().get(name)
    return (effect.mechanism if effect else OUTSIDE.get(name, "")) or name


def laws_of(mechanism: str) -> tuple[str, ...]:
    """The names of the effects that are laws of a mechanism.

    Parameters
    ----------
    mechanism : str
        One of ``MECHANISMS``.

    Returns
    -------
    tuple of str
        In alphabetical order, those first that a model file can hold.

    Examples
    --------
    >>> from zendsp.physics.effects import laws_of
    >>> laws_of("fluid_friction")
    ('quadratic_drag', 'viscous', 'viscous_asymmetry')
    """
    return tuple(name for name in (*library(), *OUTSIDE) if mechanism_of(name) == mechanism)


def is_supported(effect: Effect, present: Collection[str]) -> bool:
    """Whether a joint has what an effect needs, see ``stands_on``.

    Parameters
    ----------
    effect : Effect
    present : collection of str
        Names of the joint's effects.

    Returns
    -------
    bool
    """
    had = {had for name in present for had in (name, get_effect(name).symmetric)}
    sites = {get_effect(name).site for name in present}
    return all(
        need in had or bool(sites.intersection(SUPPORT.get(need, ()))) for need in effect.needs
    )


def stands_on(effect: Effect, other: str) -> bool:
    """Whether an effect needs another one by name, or the symmetric case of it.

    Parameters
    ----------
    effect : Effect
        The one that needs something.
    other : str
        Name of the other effect, or of none in the library.

    Returns
    -------
    bool

    Examples
    --------
    >>> stands_on(get_effect("stribeck"), "coulomb_asymmetry")
    True
    """
    had = library().get(other)
    return other in effect.needs or (had is not None and had.symmetric in effect.needs)


def load_effects(path: str | Path) -> list[Effect]:
    """Add the effects of a user's file: each is a module-level ``Effect``.

    Parameters
    ----------
    path : str or Path
        A Python file that defines one or more ``Effect`` objects, written like the files of this
        folder.

    Returns
    -------
    list of Effect
        What was added.

    Raises
    ------
    ModelError
        Where the file cannot be run or defines no effect.
    """
    spec = importlib.util.spec_from_file_location(f"zendsp_user_effect_{Path(path).stem}", path)
    if spec is None or spec.loader is None or not Path(path).exists():
        raise ModelError(f"{path}: no such Python file of effects")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise ModelError(f"{path}: cannot be run as a file of effects: {error}") from error
    found = [value for value in vars(module).values() if isinstance(value, Effect)]
    if not found:
        raise ModelError(f"{path}: defines no zendsp.physics.effects.Effect")
    _extra.update({effect.name: effect for effect in found})
    return found
