"""The commands one types all day do not wait for what they do not use."""

from __future__ import annotations

import json

from journey import Installed

HEAVY = (
    "numpy", "scipy", "matplotlib", "rich", "textual", "h5py", "zendsp_isr.build", "subprocess",
    "ctypes",
)


def test_the_commands_of_all_day_load_nothing_heavy(installed: Installed) -> None:
    target = installed.target("imi")
    assert installed.run("run", "pd.c", "-t", "imi").returncode == 0
    commands = (
        ["ls"], ["get", "-t", "imi"], ["set", "-t", "imi", "Kp1=450"], ["info", "-t", "imi"],
        ["stop", "-t", "imi"],
    )
    for command in commands:
        code = (
            "import sys, json\n"
            f"sys.argv = ['zendsp', *{command!r}]\n"
            "from zendsp.cli import main\n"
            "try:\n"
            "    main()\n"
            "except SystemExit as end:\n"
            "    assert not end.code, end.code\n"
            f"print(json.dumps([m for m in {HEAVY!r} if m in sys.modules]), file=sys.stderr)\n"
        )
        done = installed.script(code)
        assert done.returncode == 0, (command, done.stdout, done.stderr)
        loaded = json.loads(done.stderr.strip().splitlines()[-1])
        assert loaded == [], command
    assert target.poll() is None
