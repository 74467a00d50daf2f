"""Every command and every Python block of the pages is run as it stands, page by page, in an empty
folder.

What a page takes for granted (a recording, a model, a target) is prepared by its `Plan`. What
cannot run here stands in `not_run.py` with its reason. Every other block has to be a file that the
page's commands use.
"""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import sin, tanh
from pathlib import Path

import numpy as np
import pytest
from journey import PATIENCE_S, Installed
from not_run import HOURS, NOT_RUN
from pages import PAGES, ROOT, Block, blocks

FOREVER = {"watch": 3, "bridge": 1}  # subcommands that run until Ctrl-C: lines that they say first


SERVERS = ("zendsp target", "-m zendsp_target")


LIMIT_S = 250.0  # of one command, beside all else that CI computes


def nothing(_: Installed) -> None:
    """A page that takes nothing for granted."""


@dataclass(frozen=True)
class Plan:
    """What a page takes for granted.

    Attributes
    ----------
    prepare : callable
        Makes what its commands need, in the user's folder.
    files : mapping of str to str
        First line of a block to the name of the file that the page means by it.
    stands_for : mapping of str to str
        What is written on the page in place of the reader's own, to what it is here; ``PORT`` is a
        free one.
    prelude : str
        Before the page's Python, which is one script.
    arguments : callable
        Of that script.
    """

    prepare: Callable[[Installed], None] = nothing
    files: Mapping[str, str] = field(default_factory=dict)
    stands_for: Mapping[str, str] = field(default_factory=dict)
    prelude: str = ""
    arguments: Callable[[Installed], list[str]] = lambda _: []


def bench(user: Installed) -> None:
    """The model file of docs/models.md, and recordings of that machine with a dry friction that the
    model lacks. They are short: what is told here is that what is typed works.
    """
    (model,) = (
        b
        for b in blocks(ROOT / "docs" / "models.md")
        if b.kind == "toml" and b.first == 'name = "bench"'
    )
    user.write("bench.toml", model.text)
    for seed, name in enumerate(("run", "run1", "run2", "test")):
        rng, dt, n = np.random.default_rng(seed), 0.001, 2500
        t = dt * np.arange(n)
        phases = rng.uniform(0.0, 2.0 * np.pi, 4)
        tones = zip((0.3, 0.7, 1.3, 2.1), phases, strict=True)
        wanted = sum(0.5 * np.sin(2.0 * np.pi * f * t + p) for f, p in tones).tolist()
        q = qd = command = 0.0
        rows = []
        for k in range(n):
            counted = round(q / 0.00153398) * 0.00153398
            rows.append(f"{t[k]:.6f},{counted:.8f},{command:.8f},{wanted[k]:.8f}")
            for _ in range(10):  # the command acts from this row to the next
                torque = command - 0.30 * sin(q) - 0.002 * qd - 0.05 * tanh(qd / 0.01)
                qd += 0.1 * dt * torque / 0.010
                q += 0.1 * dt * qd
            command = max(-1.5, min(1.5, 2.0 * (wanted[k] - counted) - 0.05 * qd))
        user.write(f"{name}.csv", "t,q,u,q_ref\n" + "\n".join(rows) + "\n")


def recorded(user: Installed) -> None:
    """A recording of the bench, and no model file yet."""
    bench(user)
    (user.folder / "bench.toml").unlink()


LINK = """<link name="{0}"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/>
<origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="9" velocity="9"/></joint>"""


def described(user: Installed) -> None:
    """A recording of the bench, and the model file of docs/models.md of an arm with a URDF."""
    recorded(user)
    (block,) = (b for b in blocks(ROOT / "docs" / "models.md") if 'kind = "urdf"' in b.text)
    user.write("arm.toml", f'name = "arm"\n{block.text}')
    links = "".join(LINK.format(name) for name in ("base", "upper", "lower"))
    joints = JOINT.format("one", "base", "upper") + JOINT.format("two", "upper", "lower")
    user.write("arm.urdf", f'<robot name="arm">{links}{joints}</robot>')


def arm(user: Installed) -> None:
    """An arm in a MuJoCo file."""
    user.write("arm.xml", (ROOT / "tests" / "machines" / "models" / "bench_arm.xml").read_text())


def running(user: Installed) -> None:
    """A target `imi` that runs pd.c."""
    user.target("imi")
    said = user.run("run", "pd.c", "-t", "imi")
    assert said.returncode == 0, said.stderr


def loaded(user: Installed) -> None:
    """A target `imi` with pd.c, which does not run yet."""
    user.target("imi")
    said = user.run("load", "pd.c", "-t", "imi")
    assert said.returncode == 0, said.stderr


def saved_parameters(user: Installed) -> None:
    """A target that runs, and a set of its parameters."""
    running(user)
    assert user.run("params", "save", "kept.json").returncode == 0


def lab(user: Installed) -> None:
    """Certificates under the names of the page, made by `zendsp keys`."""
    for line in ("init", "target imi --host localhost", "user anna --role tune"):
        said = user.run("keys", *line.split())
        assert said.returncode == 0, said.stderr
    made = user.folder / "lab"
    names = {
        "imi.pem": "targets/imi.pem",
        "imi.key": "targets/imi.key",
        "anna.pem": "users/anna.pem",
        "anna.key": "users/anna.key",
        "me.pem": "users/anna.pem",
        "me.key": "users/anna.key",
        "lab.pem": "ca.pem",
        "ca.pem": "ca.pem",
        "roles.toml": "roles.toml",
    }
    for name, source in names.items():
        (user.folder / name).write_bytes((made / source).read_bytes())
    for path in user.folder.glob("*.key"):
        path.chmod(0o600)


def lab_of_the_page(user: Installed) -> None:
    """For docs/security.md, whose commands make the lab: its files are taken from a lab made
    before, which is then gone.
    """
    lab(user)
    for path in sorted((user.folder / "lab").rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    (user.folder / "lab").rmdir()


def first_target(user: Installed) -> list[str]:
    """Endpoint and name of the one target that runs."""
    (found,) = json.loads(user.run("ls", "--json").stdout)
    return [found["endpoints"][0], found["name"]]


ROBOT = {"robot.lab:7447": "localhost:PORT", "0.0.0.0:7447": "127.0.0.1:PORT"}


ONE = '("run1.csv", "bench.toml")'  # the command on the page has diagnosed all of them


PLANS: dict[str, Plan] = {
    "README.md": Plan(arm),
    "docs/diagnosis.md": Plan(
        bench,
        stands_for={'(["run1.csv", "run2.csv"], "bench.toml", "test.csv")': ONE},
        files={
            "def simulate(recording, parameters):": "pendulum_sim.py",
            "[mechanism]": "pendulum.toml",
        },
    ),
    "docs/effects.md": Plan(
        bench, files={"from zendsp.physics.effects import Effect, Parameter": "film.py"}
    ),
    # shorter measurements of the same kind
    "docs/experiments.md": Plan(
        running,
        stands_for={
            "-s 2 --settle 0.2": "-s 0.3 --settle 0.1 --fade 0.1",
            "--lines 10 --periods 3": "--lines 6 --periods 2",
            "seconds=2.0, settle=0.2": "seconds=0.3, settle=0.1",
        },
    ),
    "docs/isr.md": Plan(running, files={'#include "isr.h"': "control.c"}),
    "docs/machines.md": Plan(files={"#include <math.h>": "my_axis.c"}),
    "docs/machines_simulated.md": Plan(files={'friction = "plain"': "hidden.toml"}),
    "docs/machines_mujoco.md": Plan(
        arm, files={'name = "arm"': "arm.toml"}, stands_for={"--seconds 20": "--seconds 2"}
    ),
    "docs/models.md": Plan(described, files={'name = "bench"': "as_on_the_page.toml"}),
    "docs/protocol.md": Plan(running, arguments=first_target),
    "docs/references.md": Plan(running, prelude="import zendsp\ntarget = zendsp.connect()\n"),
    "docs/security.md": Plan(
        lab_of_the_page,
        files={"[roles]": "roles.toml"},
        stands_for={**ROBOT, "--host robot.lab": "--host localhost"},
    ),
    "docs/tour.md": Plan(bench),
    "docs/troubleshooting/diagnosis.md": Plan(bench),
    "docs/troubleshooting/loop.md": Plan(saved_parameters, stands_for={"FILE": "kept.json"}),
    "docs/tui.md": Plan(loaded),
    # six seconds of the motion, of which the page plays twenty; docs/diagnosis.md has the figures
    "docs/tutorial.md": Plan(
        stands_for={
            "--f-max 0.6": "--f-max 0.6 --f-min 0.2 --period 5 --periods 1",
            "--model arm.toml --out report": "--model arm.toml --out report --no-figures",
        },
        files={
            "import zendsp": "play.py",
            'name = "arm"': "arm.toml",
            "import numpy as np": "compensate.py",
        },
    ),
}


def kept(page: Path) -> list[Block]:
    """The blocks of a page that are run, or used as files; ``output`` is what a command said."""
    return [
        b
        for b in blocks(page)
        if (b.page, b.first) not in NOT_RUN
        and b.kind != "output"
        and not b.text.startswith(HOURS)
    ]


PAGES_TO_RUN = [page for page in PAGES if kept(page)]
# tests/whole/test_readme.py knows every command and option of every page, at once
OTHERS = pytest.mark.long("others make what it types, its options are known; lost: its own order")
LATER = {
    "docs/effects.md",  # its effect needs a kernel of its own; tests/physics adds one
    "docs/experiments.md",  # tests/experiment makes them
    "docs/machines_mujoco.md",  # test_any_robot.py
    "docs/machines_simulated.md",  # tests/machines, and the demo conceals
    "docs/references.md",  # tests/reference runs the example of each kind
    "docs/troubleshooting/loop.md",  # tests/e2e/test_cli.py
    "docs/tour.md",  # tests/e2e/test_cli.py types its commands
    "docs/tui.md",  # tests/tui
    "docs/tutorial.md",  # the README's demo tells its story, docs/diagnosis.md its end
}


class Reader:
    """Somebody who types what a page says, in order."""

    def __init__(self, user: Installed, plan: Plan) -> None:
        self._user, self._plan = user, plan
        self._server: subprocess.Popen[str] | None = None
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self._port = str(probe.getsockname()[1])
        (user.folder / ".venv").symlink_to(user.python.parents[1])

    def _meant(self, command: str) -> str:
        for written, here in self._plan.stands_for.items():
            command = command.replace(written, here.replace("PORT", self._port))
        command = re.sub(r"\[[^]]*\]$|\[[^]]*\] ?", "", command)  # what may be left out, is
        return re.sub(r"^((?:[A-Z_]+=\S+ )*)python ", rf"\1{self._user.python} ", command)

    def type(self, command: str) -> str:
        """Run a command to its end, or until it serves; returns what is wrong with it."""
        meant = self._meant(command)
        if any(word in meant for word in SERVERS) and "--help" not in meant:
            return self._serve(meant)
        if meant.split()[1] in FOREVER:
            return self._watch(meant)
        done = subprocess.run(
            ["bash", "-c", meant], cwd=self._user.folder, env=self._user.env, capture_output=True,
            text=True, timeout=LIMIT_S, check=False, stdin=subprocess.DEVNULL,
        )
        return (
            ""
            if done.returncode == 0
            else f"exit status {done.returncode}: {(done.stdout + done.stderr)[-800:]}"
        )

    def _serve(self, meant: str) -> str:
        if self._server is not None:  # the page goes on with another
            self._server.terminate()
            self._server.wait(PATIENCE_S)
        # as journey.py starts its own: its loop sleeps until each sample
        self._server = process = self._user.start("bash", "-c", f"exec {meant} --spin 0")
        assert process.stdout is not None
        line = process.stdout.readline()
        while line and "listens on" not in line:
            line = process.stdout.readline()
        return "" if line else f"the target ended with {process.wait(PATIENCE_S)}"

    def _watch(self, meant: str) -> str:
        process = self._user.start("bash", "-c", f"exec {meant}")
        assert process.stdout is not None
        seen = [process.stdout.readline() for _ in range(FOREVER[meant.split()[1]])]
        process.send_signal(signal.SIGINT)
        status = process.wait(PATIENCE_S)
        good = all(seen) and status == -signal.SIGINT
        return "" if good else f"exit status {status} after {seen}"

    def python(self, text: str) -> str:
        """Run the page's Python as one script."""
        for written, here in self._plan.stands_for.items():
            text = text.replace(written, here)
        done = self._user.script(
            self._plan.prelude + text, *self._plan.arguments(self._user), timeout=LIMIT_S
        )
        return "" if done.returncode == 0 else (done.stdout + done.stderr)[-1500:]


@pytest.mark.timeout(300)  # a page is many commands
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=name, marks=[OTHERS] if name in LATER else [])
        for page in PAGES_TO_RUN
        for name in [str(page.relative_to(ROOT))]
    ],
)
def test_what_a_page_says_to_type_works(installed: Installed, page: Path) -> None:
    name = str(page.relative_to(ROOT))
    plan = PLANS.get(name, Plan())
    found = kept(page)
    files = {b.first: b for b in found if b.first in plan.files}
    unknown = [
        f"{name}:{b.line}: {b.first}"
        for b in found
        if b.kind not in ("command", "python") and b.first not in files
    ]
    assert (
        unknown == []
    ), "neither run, nor a file that the page's commands use, nor listed in NOT_RUN with a reason"
    assert set(files) == set(plan.files), "the page has no such blocks any more"
    plan.prepare(installed)
    for first, block in files.items():
        installed.write(plan.files[first], block.text + "\n")
    reader = Reader(installed, plan)
    wrong = []
    scripts = [b for b in found if b.kind == "python" and b.first not in files]
    for block in found:
        if block.kind == "command" and (said := reader.type(block.text)):
            wrong.append(f"{name}:{block.line}: {block.text}\n    {said}")
    if scripts and (said := reader.python("\n".join(b.text for b in scripts))):
        wrong.append(f"{name}: its Python: {said}")
    assert not wrong, "\n".join(wrong)


def test_every_listed_exception_is_still_on_its_page() -> None:
    there = {(b.page, b.first) for page in PAGES for b in blocks(page)}
    assert [key for key in NOT_RUN if key not in there] == []
    assert {str(page.relative_to(ROOT)) for page in PAGES_TO_RUN} >= LATER
    assert [
        name
        for name in PLANS
        if not any(b.page == name for page in PAGES_TO_RUN for b in kept(page))
    ] == []


def test_the_pages_are_read_as_they_stand(tmp_path: Path) -> None:
    """The extraction: a command in a block, in running text, in a chain, with a comment, with
    variables.
    """
    page = ROOT / "docs" / "tour.md"
    assert any(b.text == "zendsp ls" or b.text.startswith("zendsp run pd.c") for b in blocks(page))
    readme = [b.text for b in blocks(ROOT / "README.md") if b.kind == "command"]
    secured = [b.text for b in blocks(ROOT / "docs" / "security.md")]
    assert ".venv/bin/zendsp demo" in readme
    assert any(text.startswith("ZENDSP_CONNECT=") for text in secured)
    assert not any("#" in c or "&&" in c for c in readme)
    assert sum(len(blocks(page)) for page in PAGES) > 80
