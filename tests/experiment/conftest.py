"""Experiments run on real targets of their own, in the fast clock."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _own_registry(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tests neither see nor disturb targets that really run here."""
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(tmp_path_factory.mktemp("registry")))
    for name in ("ZENDSP_CONNECT", "ZENDSP_TARGET"):
        monkeypatch.delenv(name, raising=False)
