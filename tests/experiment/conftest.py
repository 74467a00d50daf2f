"""Experiments run on real targets of their own, in the fast clock."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _alone(own_registry: None) -> None:
    """Tests neither see nor disturb targets that really run here."""
