"""What plays tables waits for the table before, and for nothing else."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from zendsp.errors import Refused, TooSoon
from zendsp.experiment.player import Player
from zendsp.link import Target


class Declines:
    """A target that answers uploads with the given errors, one after another, then takes them."""

    def __init__(self, *errors: Exception) -> None:
        self.errors, self.asked = list(errors), 0

    def variables(self) -> dict[str, Any]:
        return {"ref": object()}

    def upload(self, name: str, rows: object) -> None:
        self.asked += 1
        if self.errors:
            raise self.errors.pop(0)


def player_of(target: Declines) -> tuple[Player, np.ndarray]:
    rows = np.zeros((2, 1))
    return Player(cast(Target, target), {"ref": rows}, {}, ["q"], 1.0), rows


def test_a_table_is_sent_again_until_the_one_before_is_in_effect() -> None:
    target = Declines(TooSoon("not yet"), TooSoon("not yet"))
    player, rows = player_of(target)
    player._replace("ref", rows)
    assert target.asked == 3


def test_a_refusal_of_a_table_is_told_at_once() -> None:
    target = Declines(Refused("somebody else commands"))
    player, rows = player_of(target)
    with pytest.raises(Refused, match="somebody else commands"):
        player._replace("ref", rows)
    assert target.asked == 1
