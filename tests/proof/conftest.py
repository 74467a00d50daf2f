"""The search for rivals is most of a case's cost, and most tests need none."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from zendsp.proof import build_case


@pytest.fixture(autouse=True, scope="session")
def few_rivals() -> Iterator[None]:
    """Leave out the search for inseparable rivals, except where a test puts it back
    (``with_rivals``).
    """
    patch = pytest.MonkeyPatch()
    patch.setattr(build_case, "inseparable", lambda *_: {})
    yield
    patch.undo()


@pytest.fixture
def with_rivals(monkeypatch: pytest.MonkeyPatch) -> None:
    from zendsp.proof.rivals import inseparable

    monkeypatch.setattr(build_case, "inseparable", inseparable)
