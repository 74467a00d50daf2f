"""The examples in docstrings run and give what they say."""

from __future__ import annotations

import doctest
import importlib
import importlib.util
import pkgutil
from pathlib import Path

import pytest

PACKAGES = ("zendsp", "zendsp_target", "zendsp_protocol", "zendsp_isr")


def has_examples(name: str) -> bool:
    """Whether a module may have any, its own or of what it calls its own: to look for them in all
    objects of one that has none takes 20 ms, and there are 600.
    """
    found = importlib.util.find_spec(name)
    assert found is not None and found.origin is not None
    source = Path(found.origin).read_text()
    return ">>>" in source or "__module__" in source


def modules() -> list[str]:
    """Every module of the four packages that can be imported without side effects."""
    found = []
    for package in PACKAGES:
        root = importlib.import_module(package)
        found += [
            m.name
            for m in pkgutil.walk_packages(root.__path__, f"{package}.")
            if not m.name.endswith("__main__")
        ]
    return sorted(found)


MODULES = modules()


def test_the_walk_over_the_modules_finds_every_package() -> None:
    assert len(MODULES) > 200
    assert {name.partition(".")[0] for name in MODULES} == set(PACKAGES)


@pytest.mark.parametrize("package", PACKAGES)
def test_examples_of_docstrings_are_true(
    package: str, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path_factory.mktemp("examples"))
    tried, wrong = 0, []
    for name in MODULES:
        if name.partition(".")[0] == package and has_examples(name):
            result = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
            tried += result.attempted
            wrong += [name] * bool(result.failed)
    assert wrong == []
    assert tried > 0
