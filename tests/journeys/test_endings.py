"""However a host ends, its process is gone within 2 s and the target's host-lost policy acts."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from pathlib import Path

import pytest
from journey import PATIENCE_S, Installed, until

ENDINGS = {
    "end": "",
    "exception": "raise RuntimeError('by the user')",
    "sys.exit": "import sys; sys.exit(3)",
    "os._exit": "import os; os._exit(0)",
    "ctrl-c": "time.sleep(9999)",
    "terminate": "time.sleep(9999)",
    "kill": "time.sleep(9999)",
    "a forked child first": "import os; os.fork() or sys.exit(0); os.wait()",
    "workers": (
        "import multiprocessing; multiprocessing.get_context('fork').Pool(2).map(abs, [1, -2])"
    ),
}
SIGNALS = {"ctrl-c": signal.SIGINT, "terminate": signal.SIGTERM, "kill": signal.SIGKILL}
OPENINGS = {
    "local": "t = zendsp.local('imi_planar')",
    "matdsp, and two views": (
        "from zendsp.matdsp import MatDSPconnect, MatDSPvariable; MatDSPconnect('imi');"
        " MatDSPvariable('Kp1'); t = zendsp.connect('imi');"
        " v = t.live(['tick'], callback=lambda block: None); w = t.live(['tick'])"
    ),
}
COMMANDING = """
import sys, time, zendsp
t = zendsp.connect('imi')
t.take_command(); t.acknowledge(); t.start()
view = t.live(['q'], callback=lambda block: None)
while not view.received: time.sleep(0.01)
print('moves', flush=True)
"""
PREPARE = """
import zendsp
with zendsp.connect('imi') as t:
    t.download('pd.c')
"""
LOOK = """
import sys, time, zendsp
with zendsp.connect('imi') as t:
    for line in sys.stdin:  # a process for every look would take most of the time
        end = time.monotonic() + 100
        while True:
            s = t.status()
            seen = [s.state, s.trip.reason if s.trip else '']
            if seen == ['stopped', 'host lost'] or time.monotonic() > end:
                break
            time.sleep(0.02)
        print(*seen, flush=True)
"""


def registered(user: Installed) -> list[Path]:
    """The registry entries of targets that scripts started, read directly since the command is
    slow.
    """
    return list(Path(user.env["ZENDSP_RUNTIME_DIR"]).glob("imi_planar-*.json"))


class Looker:
    """Somebody who looks at the target from elsewhere."""

    def __init__(self, user: Installed) -> None:
        self._process = user.start("python", user.write("look.py", LOOK), stdin=subprocess.PIPE)

    def sees(self) -> str:
        """State and reason, once the host is lost, or after a long time."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return self._process.stdout.readline().strip()


def _finish(process: subprocess.Popen[str], ending: str) -> None:
    """Wait for the end of a script after its last line; one that holds a resource would never end.
    """
    if ending in SIGNALS:
        os.kill(process.pid, SIGNALS[ending])
    until(lambda: process.poll() is not None, f"{ending}: the end of the process")


SAME = pytest.mark.long("local ends alike, what commands has a view below; lost: matdsp's link")


@pytest.mark.parametrize(
    "opening", [pytest.param(name, marks=[] if name == "local" else [SAME]) for name in OPENINGS]
)
def test_a_script_ends_however_it_ends(installed: Installed, opening: str) -> None:
    installed.target("imi")
    assert installed.script(PREPARE).returncode == 0
    running = {}
    for number, (name, ending) in enumerate(ENDINGS.items()):
        text = (
            f"import sys, time, zendsp\n{OPENINGS[opening]}\nprint('ready', flush=True)\n{ending}\n"
        )
        running[name] = installed.start("python", installed.write(f"s{number}.py", text))
    for name, process in running.items():
        assert process.stdout is not None
        assert "ready" in process.stdout.readline(), name
    for name, process in running.items():
        _finish(process, name)
    if opening == "local":
        until(lambda: not registered(installed), "all that were started here have ended")
        assert "imi_planar-" not in installed.run("ls").stdout


def test_the_policy_acts_however_the_commanding_script_ends(installed: Installed) -> None:
    installed.target("imi")
    assert installed.script(PREPARE).returncode == 0
    looker = Looker(installed)
    for number, (name, ending) in enumerate(ENDINGS.items()):
        process = installed.start(
            "python", installed.write(f"c{number}.py", COMMANDING + ending + "\n")
        )
        assert process.stdout is not None
        assert "moves" in process.stdout.readline(), name
        _finish(process, name)
        assert looker.sees() == "stopped host lost", name


def test_pytest_ends_after_its_last_line(installed: Installed) -> None:
    text = (
        "import zendsp\n"
        "def test_one():\n"
        "    t = zendsp.local('imi_planar')\n"
        "    t.download('pd.c')\n"
        "    t.live(['tick'])\n"
    )
    installed.write(
        "test_mine.py", text + "def test_two():\n    zendsp.local('imi_planar'); assert False\n"
    )
    process = installed.start(
        "python", "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_mine.py"
    )
    said, _ = process.communicate(timeout=PATIENCE_S)
    assert "1 failed, 1 passed" in said


@pytest.mark.long("a kernel that commands ends below, scripts above; lost: its own target")
def test_a_notebook_kernel_ends_and_its_target_with_it(kernels: Installed) -> None:
    text = """
import nbformat
from nbclient import NotebookClient
cells = ["import zendsp; t = zendsp.local('imi_planar'); t.download('pd.c'); v = t.live(['tick'])", "t.status().state"]
notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(c) for c in cells])
client = NotebookClient(notebook, timeout=150, kernel_name="python3")
with client.setup_kernel():
    for number, cell in enumerate(notebook.cells):
        client.execute_cell(cell, number)
print(notebook.cells[1].outputs[0]["data"]["text/plain"])
"""  # noqa: E501
    done = kernels.script(text)
    assert "'loaded'" in done.stdout, done.stdout + done.stderr
    until(lambda: not registered(kernels), "the kernel's target has ended")
    assert "imi_planar-" not in kernels.run("ls").stdout


NOTEBOOK = """
import json, queue, sys, time
from jupyter_client.manager import start_new_kernel
LOOK = "print('seen', t.status().state, t.drive_status().commander != '')"

def said(client, code):
    words = []
    client.execute_interactive(code, timeout=150, output_hook=lambda m: words.append(m["content"].get("text", m["content"].get("evalue", ""))))
    return "".join(words)

manager, client = start_new_kernel(kernel_name="python3")
print(said(client, COMMANDING.replace("import sys, time, zendsp", "import time, zendsp")).strip(), flush=True)
ending = sys.argv[1]
if ending == "shutdown":  # a cell that is stopped is no end: the kernel goes on to command
    asked = client.execute("print('asleep', flush=True); time.sleep(9999)", stop_on_error=False)
    while "asleep" not in client.get_iopub_msg(timeout=150)["content"].get("text", ""):
        pass
    for _ in range(30):  # what prints "asleep" may still be at work, and take the first for itself
        manager.interrupt_kernel()
        try:
            if client.get_shell_msg(timeout=5)["parent_header"]["msg_id"] == asked:
                break
        except queue.Empty:
            pass
    print(said(client, LOOK).strip(), flush=True)
    manager.shutdown_kernel()
elif ending == "restart":
    manager.restart_kernel(now=False)
elif ending == "kill":
    manager.restart_kernel(now=True)
print("done", flush=True)
sys.stdin.readline()
manager.shutdown_kernel(now=True)
"""  # noqa: E501


@pytest.mark.parametrize(
    "ending",
    [
        "shutdown",
        pytest.param("restart", marks=pytest.mark.long("a kernel ends as at a shutdown")),
        pytest.param("kill", marks=pytest.mark.long("a kernel that is killed is a script's end")),
    ],
)
def test_the_policy_acts_however_the_commanding_kernel_ends(
    kernels: Installed, ending: str
) -> None:
    kernels.target("imi")
    assert kernels.script(PREPARE).returncode == 0
    path = kernels.write("notebook.py", f"COMMANDING = {COMMANDING!r}\n{NOTEBOOK}")
    process = subprocess.Popen(
        [str(kernels.python), str(path), ending], cwd=kernels.folder, env=kernels.env,
        text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stdout.readline().strip() == "moves"
    if ending == "shutdown":
        assert process.stdout.readline().strip() == "seen running True"
    assert process.stdout.readline().strip() == "done"
    assert Looker(kernels).sees() == "stopped host lost"
    process.communicate("over\n", timeout=PATIENCE_S)


QUIET_END = """
import sys, threading, zendsp
threading.Thread(target=lambda: [None for _ in iter(int, 1)], daemon=True).start()  # wants the GIL all the time
with zendsp.connect('imi') as t:
    view = t.live(['tick'])
"""  # noqa: E501


def test_the_end_of_a_host_is_quiet(installed: Installed) -> None:
    """Threads in Zenoh that come back while the interpreter goes down would abort the process."""
    installed.target("imi")
    assert installed.script(PREPARE).returncode == 0
    path = installed.write("quiet.py", QUIET_END)
    for process in [installed.start("python", path) for _ in range(2)]:
        said = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0, said


INTERRUPTED = """
import sys, time, zendsp
t = zendsp.local('imi_planar', clock='fast')
print('ready', flush=True)
try:
    time.sleep(9999)
except KeyboardInterrupt:
    print('interrupted', flush=True)
sys.stdin.readline()
print(t.status().state, t.alive, flush=True)
"""


def test_ctrl_c_interrupts_what_is_typed_and_leaves_the_local_target_alone(
    installed: Installed,
) -> None:
    """A terminal, and a notebook's button too, send Ctrl-C to all processes of the group."""
    path = installed.write("interrupted.py", INTERRUPTED)
    process = installed.start("python", path, stdin=subprocess.PIPE)
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    (found,) = json.loads(installed.run("ls", "--json").stdout)
    os.killpg(process.pid, signal.SIGINT)
    assert process.stdout.readline() == "interrupted\n"
    told = installed.run("info", "-t", found["name"])  # a moment later, and from elsewhere
    assert told.returncode == 0, told.stderr
    said, _ = process.communicate("\n", timeout=PATIENCE_S)
    assert said == "empty True\n", said
