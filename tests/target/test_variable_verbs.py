"""How the verbs of variables turn the runtime's outcome into answers."""

from __future__ import annotations

import pytest

from zendsp_protocol import verbs
from zendsp_protocol.errors import NotYet, Refused, ZendspError
from zendsp_target.serving.deferred import Later
from zendsp_target.serving.variable_verbs import VariableVerbs


class Waiting:
    """A runtime that accepts each update, and says this when it is asked for the sample."""

    def __init__(self, says: ZendspError) -> None:
        self.says = says

    def write(self, values: object, author: str, at_tick: int | None) -> int:
        return 1

    def wait_applied(self, sequence: int, timeout: float) -> int:
        raise self.says


def update(says: ZendspError) -> None:
    VariableVerbs(Waiting(says)).do_update(verbs.Write(values={"a": 1.0}), "me")  # type: ignore[arg-type]


def test_an_update_whose_sample_has_not_come_is_waited_for_by_another_thread() -> None:
    with pytest.raises(Later) as later:
        update(NotYet("update 1"))
    with pytest.raises(NotYet):
        later.value.rest()


def test_an_update_that_is_refused_is_refused_at_once() -> None:
    with pytest.raises(Refused, match="unknown"):
        update(Refused("update 1: unknown"))
