"""The next recording."""

from __future__ import annotations

from typing import Any

from zendsp.diagnosis.result import Next


def propose(*_args: Any) -> Next | None:
    return None
