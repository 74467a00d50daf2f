"""What all messages have in common, and those of every verb."""

from __future__ import annotations

from typing import Any

import msgspec


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """Base of all messages."""


class Said(Message, frozen=True, kw_only=True):
    """It was done; a sentence for people."""

    text: str = ""  # what was done


class Empty(Message, frozen=True, kw_only=True):
    """Nothing but the fact that it was done."""


class ErrorBody(Message, frozen=True, kw_only=True):
    """Why a request was declined."""

    kind: str  # name of a class in zendsp_protocol.errors
    message: str  # what, the value, the limit, what to do next
    details: dict[str, Any] = {}  # more, for programs
