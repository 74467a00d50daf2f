"""The examples in docstrings run and give what they say."""

from __future__ import annotations

import doctest
import importlib
import pkgutil

import pytest

PACKAGES = ("zendsp", "zendsp_target", "zendsp_protocol", "zendsp_isr")


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
        if name.partition(".")[0] == package:
            result = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
            tried += result.attempted
            wrong += [name] * bool(result.failed)
    assert wrong == []
    assert tried > 0
