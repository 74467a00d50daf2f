"""Reads TOML and JSON that people write, or somebody hostile does: anything wrong gives one error.
"""

from __future__ import annotations

import json as _json
import tomllib
from typing import Any

_DEEP = "it is nested too deeply to be read"


def toml(text: str) -> dict[str, Any]:
    """The contents of a TOML text.

    Raises
    ------
    tomllib.TOMLDecodeError
        It is not TOML, nested without end, or a number has thousands of digits.
    """
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise tomllib.TOMLDecodeError(_DEEP) from None
    except tomllib.TOMLDecodeError:
        raise
    except ValueError as error:
        raise tomllib.TOMLDecodeError(str(error).split(";")[0]) from None


def json(text: str) -> Any:
    """The contents of a JSON text.

    Raises
    ------
    ValueError
        It is not JSON, nested without end, or a number has thousands of digits.
    """
    try:
        return _json.loads(text)
    except RecursionError:
        raise ValueError(_DEEP) from None
