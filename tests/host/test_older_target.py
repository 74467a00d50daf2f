"""What a host says of a target of the same protocol that does not know all that it asks."""

from __future__ import annotations

import types
from typing import Any

import pytest

from zendsp.errors import LinkError, VersionMismatch
from zendsp.link import Target
from zendsp_protocol import codec
from zendsp_target.serving import lanes

pytestmark = pytest.mark.usefixtures("older")
UNKNOWN = "malformed arguments of 'acquire_start': Object contains unknown field `begun`"


@pytest.fixture
def older(monkeypatch: pytest.MonkeyPatch) -> None:
    """The lanes of the target take no ``begun``."""

    def decode_request(data: bytes, lane: str) -> Any:
        verb, args, by = codec.decode_request(data, lane)
        if getattr(args, "begun", None) is not None:
            raise LinkError(UNKNOWN)
        return verb, args, by

    old = {**vars(codec), "decode_request": decode_request}
    monkeypatch.setattr(lanes, "codec", types.SimpleNamespace(**old))


def test_a_target_that_does_not_know_an_argument_is_said_to_be_older_and_what_to_do(
    running: Target,
) -> None:
    with pytest.raises(VersionMismatch, match="older version of zendsp than") as error:
        running.acquire(["q"], 0.01)
    assert "nothing was done" in str(error.value) and UNKNOWN in str(error.value)
    assert "start it again" in str(error.value)
    running.acquire_configure(["q"], 0.01)
    with pytest.raises(VersionMismatch):  # asked patiently: it is not asked for ever
        running.acquire_load()


def test_what_is_wrong_on_both_sides_is_no_matter_of_versions(running: Target) -> None:
    with pytest.raises(LinkError, match="Expected `array`") as error:
        running.request("read", names=3)
    assert not isinstance(error.value, VersionMismatch)


def test_an_answer_that_cannot_be_read_is_said_to_be_of_another_version(
    running: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        running.link._repeats, "decode", lambda *_: (_ for _ in ()).throw(LinkError("malformed"))
    )
    with pytest.raises(VersionMismatch, match="of another version of zendsp"):
        running.status()
