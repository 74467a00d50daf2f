"""The MatDSP verbs, without a target."""

from __future__ import annotations

import pytest

from zendsp.errors import CompileFailed
from zendsp.link import Target
from zendsp.matdsp import MatDSPcompile, MatDSPdownload


@pytest.mark.parametrize("verb", [MatDSPcompile, MatDSPdownload])
def test_a_target_in_the_place_of_the_file_is_refused_with_what_to_write(verb: object) -> None:
    target = object.__new__(Target)  # no link: what is refused asks for none
    with pytest.raises(CompileFailed, match=r"MatDSPconnect\(target\)"):
        verb(target, "pd.c")  # type: ignore[operator]
