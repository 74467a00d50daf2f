"""Files that are written whole or not at all."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from zendsp.errors import RecordingError
from zendsp.experiment import Result
from zendsp.experiment.figures import make_figure
from zendsp.experiment.figures import save as save_figure
from zendsp.whole_file import write_whole, writing

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


def test_the_error_of_a_full_disk_names_the_file_and_leaves_no_half_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was "No space left on device"."""

    def full(path: Path | str) -> None:
        Path(path).write_bytes(b"half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    file = tmp_path / "x.npz"
    said = r"x\.npz: cannot be written \(No space left"
    with pytest.raises(RecordingError, match=said), writing(file):
        full(file)
    figure, _ = make_figure(1, 1)
    monkeypatch.setattr(type(figure), "savefig", lambda self, path, dpi: full(path))
    with pytest.raises(RecordingError, match=r"friction\.png: cannot be written"):
        save_figure(figure, tmp_path / "friction.png")
    monkeypatch.setattr(Path, "write_text", lambda self, text, encoding: full(self))
    with pytest.raises(RecordingError, match=r"result\.toml: cannot be written"):
        Result("friction", "x", "arm").save(tmp_path / "result.toml")
    assert list(tmp_path.iterdir()) == []
