"""Files: a model is begun from a recording, and recordings of other tools go the same way."""

from __future__ import annotations

import shlex

from journey import Installed

RECORDED = """
import numpy as np
from zendsp.recording import Recording
t = np.arange(4000) * 0.001
q = np.round(np.sin(5 * t) * 651.9) / 651.9
u = -0.02 * 25 * np.sin(5 * t) + 0.1 * np.sign(np.cos(5 * t))
Recording.from_columns({"q": np.degrees(q), "u": 1e3 * u}, t=t, units={"q": "deg", "u": "mN m"}).save("run 1.mcap")
"""  # noqa: E501


def test_a_model_is_begun_from_a_recording_and_checked_against_it(installed: Installed) -> None:
    made = installed.script(RECORDED)
    assert made.returncode == 0, made.stderr
    new = installed.run("model", "new", "run 1.mcap", "-o", "bench.toml")
    assert new.returncode == 0, new.stderr
    assert "1 joint" in new.stdout and "?" in new.stdout
    text = (installed.folder / "bench.toml").read_text()
    assert 'position = "q"' in text and "q: deg converted to rad" in text
    told = shlex.split(new.stdout.splitlines()[-1])
    assert told[:2] == ["then:", "zendsp"]
    check = installed.run(*told[2:])
    assert check.returncode == 0, check.stderr
    assert "4000 rows, 1 ms" in check.stdout

    again = installed.run("model", "new", "run 1.mcap", "-o", "bench.toml")
    assert again.returncode == 2 and "is there already" in again.stderr
    (installed.folder / "bench.toml").write_text(text.replace("delay = 0.0", "dealy = 0.004"))
    wrong = installed.run("model", "check", "bench.toml")
    assert wrong.returncode == 2 and "did you mean delay?" in wrong.stderr
