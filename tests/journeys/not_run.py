"""Commands and blocks of the pages that no test runs, with the reason."""

from __future__ import annotations

NETWORK = "fetches packages: tests/whole/test_wheel.py builds and installs the wheel"
TERMINAL = "is an application in a terminal: test_stop_banner.py and test_slim_install.py open it"
BROWSER = "serves a browser until Ctrl-C: tests/tui/test_web.py"
# `zendsp prove` takes minutes to hours, wherever it stands: `.ci/run` has
# `--quick --sample`, tests/journeys/test_prove.py the others in small, tests/proof/test_real.py
# the recordings.
HOURS = "zendsp prove"
DRAWING = "is a drawing"
CLONE = "is of a clone, or takes half an hour: tests/whole/test_mutations.py, test_endurance.py"
FORMULA = "is a formula"
SYNTAX = "shows how a file or a message looks"
EXPERIMENT = "takes up to a minute: tests/experiment/ makes each experiment"
DEMO = "test_slim_install.py has it, of the pendulum, and this one as a long one"
DIAGNOSIS = "docs/diagnosis.md types it, of CSV files"
# (page, first line of the block or the command) -> why it is not run
NOT_RUN: dict[tuple[str, str], str] = {
    ("README.md", "python3 -m venv .venv"): NETWORK,
    ("README.md", ".venv/bin/pip install ."): NETWORK,
    ("README.md", ".venv/bin/pip install '.[test]'"): NETWORK,
    ("README.md", ".venv/bin/pytest"): "is what runs this",
    (
        "README.md", ".venv/bin/pip install eclipse-zenoh numpy msgpack msgspec cffi pyelftools",
    ): NETWORK,
    ("README.md", ".venv/bin/pip install --no-deps ."): NETWORK,
    ("README.md", ".venv/bin/zendsp demo"): DEMO,
    ("README.md", "zendsp demo --effect ripple --seed 1"): DEMO,
    ("README.md", "pip install ."): NETWORK,
    (
        "docs/code_overview.md",
        (
            "protocol/zendsp_protocol/  the wire contract: keys, messages, verbs, codec, errors."
            " No I/O."
        ),
    ): DRAWING,
    (
        "docs/code_overview.md",
        (
            "host process                target: monitor process (Python)       "
            "runner process (native)"
        ),
    ): DRAWING,
    ("docs/code_overview.md", "python -m tests.mutations"): CLONE,
    ("docs/diagnosis.md", "pip install 'zendsp[fleet]'"): NETWORK,
    (
        "docs/diagnosis.md",
        (
            "tau = M(q) qdd + C(q, qd) qd + g(q) + sum of effects + delta"
            "        q measured = q + noise"
        ),
    ): FORMULA,
    ("docs/diagnosis.md", "size of the discrepancy = sqrt( (mean d² − mean n²) / mean tau² )"): (
        FORMULA
    ),
    ("docs/diagnosis.md", "size  s     = rms(d without − d with) / rms(tau)"): FORMULA,
    (
        "docs/diagnosis.md", "zendsp diagnose fleet/*.mat --model arm.toml --each --out reports",
    ): "tests/diagnosis/test_fleet.py types it",
    ("docs/tutorial.md", "zendsp tui arm"): TERMINAL,
    ("docs/diagnosis_rules.md", "python benchmarks/confidence.py CASES"): CLONE,
    ("docs/experiments.md", "zendsp experiment tracking -t arm --model arm.toml"): EXPERIMENT,
    (
        "docs/experiments.md", "zendsp experiment all -t arm --connect tls/robot.lab:7447",
    ): EXPERIMENT,
    ("docs/experiments.md", "zendsp experiment breakaway"): (
        "tests/experiment makes it; test_full_disk.py types it"
    ),
    ("docs/experiments.md", "zendsp experiment friction -t arm"): EXPERIMENT,
    ("docs/measurements/experiments.md", "zendsp experiment mechanical -t NAME"): EXPERIMENT,
    ("docs/measurements/experiments.md", "zendsp experiment NAME -t NAME"): EXPERIMENT,
    ("docs/experiments.md", "zendsp experiment friction-curve --into my_imi.toml"): EXPERIMENT,
    ("docs/experiments.md", "zendsp experiment all --report docs/results.md"): EXPERIMENT,
    ("docs/experiments.md", "from zendsp.experiment import Lab, run_experiment"): (
        "tests/experiment makes it in Python; test_slim_install.py types it"
    ),
    ("docs/experiments.md", "[[effect]]"): SYNTAX,
    (
        "docs/experiments.md",
        "ModelTorque(q, qd, a, tau);   /* the torque for accelerations a, friction and all */",
    ): "names the functions that model2c writes: tests/physics/test_codegen.py compiles them",
    (
        "docs/machines.md",
        "enum { TO_SWITCH, OFF_SWITCH, TO_INDEX, LONGEST = 20000 };   /* samples, in all */",
    ): "takes the place of parts of the page's machine: tests/target/test_docs.py homes it",
    ("docs/machines.md", "static void axis_keep_alive(void *h) {"): SYNTAX,
    ("docs/measurements/arms.md", "python benchmarks/forms.py FOLDER"): CLONE,
    (
        "docs/measurements/arms.md",
        "python benchmarks/forms.py FOLDER --group bodies --form urdf --seed 1",
    ): CLONE,
    ("docs/measurements/endurance.md", "python benchmarks/endurance.py --minutes 3"): CLONE,
    ("docs/measurements/loop.md", "python benchmarks/many.py 50"): CLONE,
    ("docs/measurements/mutations.md", "python -m tests.mutations"): CLONE,
    ("docs/measurements/structure.md", "python docs/measure_structure.py e89b9aa"): CLONE,
    (
        "docs/measurements/terminal.md",
        "python benchmarks/tui.py --only terminal --soak 3700 --trace soak.csv",
    ): "takes an hour, of a clone",
    ("docs/machines_simulated.md", "zendsp demo --machine wam7 --seed 1"): (
        "test_slim_install.py runs it, as a long one"
    ),
    ("docs/models.md", "[mechanism]"): SYNTAX,
    ("docs/models.md", "zendsp target --machine arm.xml"): "tests/journeys/test_any_robot.py",
    ("docs/machines_mujoco.md", "pip install 'zendsp[mujoco]'"): NETWORK,
    ("docs/prove.md", "pip install 'zendsp[mujoco]'"): NETWORK,
    (
        "docs/troubleshooting/recording.md", "zendsp salvage -t imi -o run.mat",
    ): "needs a killed target: test_salvage.py",
    ("docs/protocol.md", '{"v": 1, "ok": true,  "result": …}'): SYNTAX,
    ("docs/realtime.md", "target/zendsp_target/runtime/    monitor side, Python"): DRAWING,
    ("docs/security.md", "pip install 'zendsp[keys]'"): NETWORK,
    ("docs/tour.md", "pip install 'zendsp[foxglove]'"): NETWORK,
    ("docs/tour.md", "pip install 'zendsp[rerun]'"): NETWORK,
    (
        "docs/tour.md",
        "zendsp diagnose run1.mat run2.mat --model imi_planar.toml --heldout test.mat --out report",
    ): DIAGNOSIS,
    ("docs/tour.md", "zendsp bridge rerun"): "needs its viewer: tests/host/test_rerun.py",
    ("docs/tour.md", "zendsp tui --web"): BROWSER,
    (
        "docs/tour.md", "zendsp tui --screenshots docs/screens",
    ): "draws every screen for a minute: tests/tui/test_coverage.py",
    ("docs/troubleshooting/installing.md", "pip install 'zendsp[zig]'"): NETWORK,
    ("docs/troubleshooting/installing.md", "python3 -m venv"): "names what fails, not what to type",
    (
        "docs/troubleshooting/link.md", "zendsp info -t imi --connect tls/robot.lab:7447",
    ): "needs a target elsewhere: docs/security.md connects to one over TLS",
    ("docs/tui.md", "zendsp tui"): TERMINAL,
    ("docs/tui.md", "zendsp tui imi"): TERMINAL,
    ("docs/tui.md", "zendsp tui --local imi_planar --source pd.c"): TERMINAL,
    ("docs/tui.md", "zendsp tui --web --port 8000 imi"): BROWSER,
    ("docs/tui.md", "zendsp tui --frames 10 imi"): TERMINAL,
    (
        "docs/tui.md", "zendsp tui --screenshots docs/screens",
    ): "draws every screen for a minute: tests/tui/test_coverage.py",
    (
        "docs/tui.md", "zendsp acquire --last -o run.mat -t imi",
    ): "needs a host that is lost: tests/target/test_drives.py",
    ("docs/tui.md", "zendsp salvage -t imi -o run.mat"): "needs a killed target: test_salvage.py",
    ("docs/tui.md", "off → ready → homed → enabled → running → stopped | tripped"): DRAWING,
    **{
        ("docs/results.md", f"zendsp experiment {name}"): EXPERIMENT
        for name in (
            "all --report docs/results.md", "breakaway", "high-speed", "low-speed",
            "friction-curve", "circle", "electrical", "mechanical",
            "swing", "friction", "tracking",
        )
    },
}
