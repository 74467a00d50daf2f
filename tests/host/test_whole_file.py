"""Text files that are written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from zendsp.whole_file import write_whole

ENDS_IN_BETWEEN = "x" * 100_000 + "\ud800"  # as a full disk does


def test_a_file_that_cannot_be_written_whole_leaves_the_older_one(tmp_path: Path) -> None:
    file = tmp_path / "gains.json"
    file.write_text("safe")
    with pytest.raises(UnicodeEncodeError):
        write_whole(file, ENDS_IN_BETWEEN)
    assert file.read_text() == "safe"
    with pytest.raises(UnicodeEncodeError):
        write_whole(tmp_path / "new.json", ENDS_IN_BETWEEN)
    assert [f.name for f in tmp_path.iterdir()] == ["gains.json"]


def test_what_a_link_points_to_is_written_with_its_permissions(tmp_path: Path) -> None:
    file, link = tmp_path / "shared.c", tmp_path / "mine.c"
    file.write_text("old")
    file.chmod(0o640)
    link.symlink_to(file)
    write_whole(link, "q̈")
    assert link.is_symlink() and file.read_text("utf-8") == "q̈"
    assert file.stat().st_mode & 0o777 == 0o640


def test_a_pipe_is_written_to(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_whole(pipe, "text")
    assert os.read(reader, 100) == b"text"
    os.close(reader)
