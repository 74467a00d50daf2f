"""A co-simulation FMU as the given model: foreign machine code in processes of its own.

The FMUs are compiled here, from a small source of our own against the headers of the standard.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Callable
from math import sin, tanh
from pathlib import Path

import numpy as np
import pytest

import zendsp
from zendsp.diagnosis import Diagnosis
from zendsp.diagnosis.external.fmu import Fmu
from zendsp.diagnosis.report.figures import charts
from zendsp.diagnosis.report.files import write_report
from zendsp.errors import ModelError
from zendsp.physics.files.model_file import load_model, parse_model

fmpy = pytest.importorskip("fmpy")
pytestmark = [
    pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc"),
    pytest.mark.timeout(600),  # seconds of work, minutes on a machine that has other work
]

INERTIA, DAMPING, WEIGHT, RATE = 0.02, 0.03, 0.5, 250
DRY = 0.06  # N m, what the recording has and the FMU has not

# J q'' = u - b q' - G sin(q), two Runge-Kutta steps a communication step; ``bad``: 1 dies, 2 never
# ends, 3 refuses the step, 4 talks, 5 answers with no number
PHYSICS = r"""
#include <math.h>    /* sin, NAN */
#include <stdio.h>   /* printf */
#include <stdlib.h>  /* calloc, free, abort */
#include <unistd.h>  /* pause */
typedef struct { double v[7]; } pendulum; /* u, q, qd, inertia, damping, weight, bad */
static const double START[7] = {0, 0, 0, 0.02, 0.03, 0.5, 0};
static void derive(const double *p, const double *x, double *d) {
    d[0] = x[1];
    d[1] = (p[0] - p[4] * x[1] - p[5] * sin(x[0])) / p[3];
}
static int advance(double *p, double h) {
    if (p[6] == 1) abort();
    while (p[6] == 2) pause();
    if (p[6] == 3) return 3;
    if (p[6] == 5) p[1] = NAN;
    if (p[6] == 4) printf("{\"not\": \"json\"}\n"), fflush(stdout);
    for (int n = 0; n < 2; n++) {
        double k1[2], k2[2], x[2], dt = h / 2;
        derive(p, p + 1, k1);
        for (int i = 0; i < 2; i++) x[i] = p[1 + i] + dt / 2 * k1[i];
        derive(p, x, k2);
        for (int i = 0; i < 2; i++) p[1 + i] += dt * k2[i];
    }
    return 0;
}
"""
TWO = (
    PHYSICS
    + r"""
#include "fmi2Functions.h"
#define API __attribute__((visibility("default")))
API fmi2Component fmi2Instantiate(fmi2String n, fmi2Type t, fmi2String g, fmi2String r,
        const fmi2CallbackFunctions *f, fmi2Boolean v, fmi2Boolean l) {
    pendulum *p = calloc(1, sizeof *p);
    for (int i = 0; i < 7; i++) p->v[i] = START[i];
    return p;
}
API void fmi2FreeInstance(fmi2Component c) { free(c); }
API fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real d,
        fmi2Boolean e, fmi2Real f) { return fmi2OK; }
API fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
API fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
API fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
API fmi2Status fmi2Reset(fmi2Component c) {
    for (int i = 0; i < 7; i++) ((pendulum *)c)->v[i] = START[i];
    return fmi2OK;
}
API fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n,
        const fmi2Real x[]) {
    for (size_t i = 0; i < n; i++) ((pendulum *)c)->v[r[i]] = x[i];
    return fmi2OK;
}
API fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real x[]) {
    for (size_t i = 0; i < n; i++) x[i] = ((pendulum *)c)->v[r[i]];
    return fmi2OK;
}
API fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean b) {
    return advance(((pendulum *)c)->v, h);
}
"""
)
THREE = (
    PHYSICS
    + r"""
#include "fmi3Functions.h"
#define API __attribute__((visibility("default")))
API fmi3Instance fmi3InstantiateCoSimulation(fmi3String n, fmi3String t, fmi3String r,
        fmi3Boolean v, fmi3Boolean l, fmi3Boolean e, fmi3Boolean er, const fmi3ValueReference q[],
        size_t nq,
        fmi3InstanceEnvironment i, fmi3LogMessageCallback m, fmi3IntermediateUpdateCallback u) {
    pendulum *p = calloc(1, sizeof *p);
    for (int k = 0; k < 7; k++) p->v[k] = START[k];
    return p;
}
API void fmi3FreeInstance(fmi3Instance c) { free(c); }
API fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean a, fmi3Float64 b,
        fmi3Float64 d, fmi3Boolean e, fmi3Float64 f) { return fmi3OK; }
API fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return fmi3OK; }
API fmi3Status fmi3Terminate(fmi3Instance c) { return fmi3OK; }
API fmi3Status fmi3Reset(fmi3Instance c) { return fmi3Error; } /* many cannot */
API fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n,
        const fmi3Float64 x[], size_t m) {
    for (size_t i = 0; i < n; i++) ((pendulum *)c)->v[r[i]] = x[i];
    return fmi3OK;
}
API fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n,
        fmi3Float64 x[], size_t m) {
    for (size_t i = 0; i < n; i++) x[i] = ((pendulum *)c)->v[r[i]];
    return fmi3OK;
}
API fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean b,
        fmi3Boolean *event, fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last) {
    *event = *end = *early = 0, *last = t + h;
    return advance(((pendulum *)c)->v, h);
}
"""
)
VARIABLES = ("torque", "angle", "speed", "J", "b", "G", "bad")
CAUSALITY = ("input", "output", "local", "parameter", "parameter", "parameter", "parameter")


def description(version: str) -> str:
    rows = []
    for k, (name, kind) in enumerate(zip(VARIABLES, CAUSALITY, strict=True)):
        varies = "continuous" if k < 3 else "tunable"
        first = f' initial="{"exact"}"' if k > 0 and kind != "output" else ""
        start = "" if kind == "output" else ' start="0"'
        if kind == "output":
            first = ' initial="calculated"'
        common = f'name="{name}" valueReference="{k}" causality="{kind}" variability="{varies}"'
        rows.append(
            f"<ScalarVariable {common}{first}><Real{start}/></ScalarVariable>"
            if version == "2.0"
            else f"<Float64 {common}{first}{start}/>"
        )
    key = "guid" if version == "2.0" else "instantiationToken"
    out = "<Outputs><Unknown index=\"2\"/></Outputs>" if version == "2.0" else (
        '<Output valueReference="1"/>'
    )
    return (
        f'<?xml version="1.0"?><fmiModelDescription fmiVersion="{version}" modelName="p" {key}="1">'
        f'<CoSimulation modelIdentifier="p" canHandleVariableCommunicationStepSize="true"/>'
        f"<ModelVariables>{''.join(rows)}</ModelVariables><ModelStructure>{out}</ModelStructure>"
        "</fmiModelDescription>"
    )


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with both FMUs and two recordings of a pendulum with dry friction."""
    folder = tmp_path_factory.mktemp("fmus")
    headers = Path(fmpy.__file__).parent / "c-code"
    for version, source in (("2.0", TWO), ("3.0", THREE)):
        name = f"p{version[0]}"
        (folder / f"{name}.c").write_text(source)
        library = folder / f"{name}.so"
        header = (headers / f"fmi{version[0]}Functions.h").read_text()
        every = re.findall(rf"\b(fmi{version[0]}\w+);", header)  # fmpy asks for all of them
        rest = [f for f in dict.fromkeys(every) if f"{f}(" not in source]
        (folder / "rest.c").write_text("".join(f"int {f}(void) {{ return 3; }}\n" for f in rest))
        subprocess.run(
            ["gcc", "-shared", "-fPIC", "-O1", "-w", f"-I{headers}", "-o", str(library),
             str(folder / f"{name}.c"), str(folder / "rest.c"), "-lm"], check=True,
        )  # fmt: skip
        where = fmpy.platform if version == "2.0" else fmpy.platform_tuple
        with zipfile.ZipFile(folder / f"{name}.fmu", "w") as archive:
            archive.writestr("modelDescription.xml", description(version))
            archive.write(library, f"binaries/{where}/p.so")
    for seed in (1, 2):
        np.savez(folder / f"run{seed}.npz", **pendulum(seed))
        np.savez(folder / f"smooth{seed}.npz", **pendulum(seed, dry=0.0))
    return folder


def pendulum(seed: int, dry: float = DRY, seconds: float = 5.0) -> dict[str, np.ndarray]:
    """The machine: what the FMU says, and dry friction of 1 mrad/s width, at 50 kHz."""
    rng = np.random.default_rng(seed)
    f, phase = rng.uniform(0.2, 1.5, 5), rng.uniform(0, 6.28, 5)
    q, v, sub = 0.0, 0.0, 200
    rows = []
    for k in range(int(seconds * RATE)):
        goal = 0.5 * float((np.sin(2 * np.pi * f * k / RATE + phase) - np.sin(phase)).sum())
        y = 1e-4 * round((q + float(rng.normal(0, 3e-5))) / 1e-4)
        u = 4.0 * (goal - y) - 0.1 * v
        rows.append((k / RATE, y, u))
        for _ in range(sub):
            a = (u - DAMPING * v - WEIGHT * sin(q) - dry * tanh(v / 1e-3)) / INERTIA
            v += a / RATE / sub
            q += v / RATE / sub
    t, q_, u_ = np.array(rows).T
    return {"t": t, "angle": q_, "torque": u_}


def write_model(folder: Path, file: Path, extra: str = "", parameters: str = "") -> Path:
    path = folder / "model.toml"
    path.write_text(
        f"""name = "pendulum"
sample_time = {1 / RATE}
[mechanism]
kind = "fmu"
file = "{file}"
start_position = "angle"
start_velocity = "speed"
{extra}
[mechanism.parameters]
J = {{ value = 0.0205 }}
b = {{ value = {DAMPING} }}
G = {{ value = {WEIGHT}, free = false }}
{parameters}
[columns]
time = "t"
position = "angle"
command = "torque"
"""
    )
    return path


def test_an_fmu_that_starts_from_one_state_only_is_not_called_complete_where_it_errs(
    shop: Path, tmp_path: Path
) -> None:
    """Compared over whole recordings there are few independent errors, too few to name dry
    friction.
    """
    model = write_model(tmp_path, shop / "p2.fmu")
    text = model.read_text().replace('start_position = "angle"\nstart_velocity = "speed"\n', "")
    model.write_text(text)
    for seed in (1, 2):
        np.savez(tmp_path / f"little{seed}.npz", **pendulum(seed, 0.02, 4.0))
    d = zendsp.diagnose(tmp_path / "little1.npz", model, tmp_path / "little2.npz", jobs=2)
    assert d.verdict == "unexplained" and "times the sensor's noise" in d.unexplained, d


def diagnosed(shop: Path, folder: Path, fmu: str, run: str, jobs: int = 1) -> Diagnosis:
    model = write_model(folder, shop / fmu)
    return zendsp.diagnose(shop / f"{run}1.npz", model, shop / f"{run}2.npz", jobs=jobs)


@pytest.mark.long("one that errs is below, a Python simulator's is named alike; lost: an FMU's")
def test_coulomb_friction_that_an_fmu_lacks_is_named(shop: Path, tmp_path: Path) -> None:
    """With FMI 3; a test below shows that FMI 2 gives the same numbers."""
    left = set(os.listdir(tempfile.gettempdir()))
    d = diagnosed(shop, tmp_path, "p3.fmu", "run")
    assert [(f.effect, f.joint) for f in d.findings] == [("coulomb", 1)], d
    assert d.findings[0].parameters["level"].value == pytest.approx(DRY, rel=0.05)
    assert d.improved.mechanism["J"][0].value == pytest.approx(INERTIA, rel=0.02)
    assert d.improved.mechanism["G"][0].value == WEIGHT
    assert any("elasticity" in n and "cannot be tried" in n for n in d.notes), d.notes
    new = set(os.listdir(tempfile.gettempdir())) - left
    assert not [n for n in new if n.startswith("zendsp-fmu-")], "unpacked folders are removed"
    assert charts(d), "figures need no simulator: its processes are gone"
    write_report(d, tmp_path / "out", pictures=False)
    back = load_model(tmp_path / "out" / "model.toml")
    assert [t.effect for t in back.terms] == ["coulomb"]
    assert back.fmu.start_position == ("angle",)


def test_a_check_of_a_model_opens_its_fmu(
    shop: Path, tmp_path: Path, typed: Callable[..., tuple[object, str, str]]
) -> None:
    assert typed("model", "check", write_model(tmp_path, shop / "p3.fmu"))[0] == 0
    junk = tmp_path / "junk.fmu"
    junk.write_text("no archive")
    status, _, said = typed("model", "check", write_model(tmp_path, junk))
    assert status == 2 and "is not an FMU that can be read" in said


def test_an_fmu_that_is_complete_raises_no_alarm(shop: Path, tmp_path: Path) -> None:
    d = diagnosed(shop, tmp_path, "p2.fmu", "smooth", jobs=2)
    assert (d.verdict, d.findings) == ("complete", ()), d


def simulate(model: Path, jobs: int = 1, rows: int = 50, pieces: int = 3) -> list[np.ndarray]:
    fmu = Fmu(load_model(model), jobs)
    try:
        t = np.arange(rows) / RATE
        recordings = [
            {"time": t, "sample_time": 1 / RATE, "position": np.full(rows, 0.1 * k),
             "velocity": np.full(rows, 0.5), "command": np.full(rows, 0.2)}
            for k in range(pieces)
        ]  # fmt: skip
        values = {k: q[0].value for k, q in fmu_parameters(model).items()}
        return fmu.run(recordings, values)
    finally:
        fmu.close()


def fmu_parameters(model: Path) -> dict:  # type: ignore[type-arg]
    return dict(load_model(model).mechanism)


def test_versions_and_numbers_of_processes_agree(shop: Path, tmp_path: Path) -> None:
    a = simulate(write_model(tmp_path, shop / "p2.fmu"))
    b = simulate(write_model(tmp_path, shop / "p3.fmu"), jobs=2)
    assert len(a) == 3 and all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))
    assert [x[0, 0] for x in a] == pytest.approx([0.0, 0.1, 0.2])
    assert a[0][1, 0] == pytest.approx(0.5 / RATE, rel=0.05)


def test_units_that_an_fmu_states_are_converted(shop: Path, tmp_path: Path) -> None:
    """It answered in degrees, which were taken as rad: a dead zone was named, as sure as 90 %."""
    degree, milli = np.pi / 180.0, 1e-3
    said = description("2.0").replace("<ModelVariables>", (
        f'<UnitDefinitions><Unit name="o"><BaseUnit rad="1" factor="{degree}"/></Unit>'
        f'<Unit name="o/s"><BaseUnit rad="1" s="-1" factor="{degree}"/></Unit></UnitDefinitions>'
        "<ModelVariables>"
    ))  # fmt: skip
    for name, unit in (("torque", "mN.m"), ("angle", "o"), ("speed", "o/s")):  # one by its name
        said = re.sub(rf'(name="{name}".*?<Real)', rf'\1 unit="{unit}"', said)
    with zipfile.ZipFile(shop / "p2.fmu") as plain, zipfile.ZipFile(
        tmp_path / "units.fmu", "w"
    ) as archive:  # fmt: skip
        archive.writestr("modelDescription.xml", said)
        library = next(name for name in plain.namelist() if name.endswith(".so"))
        archive.writestr(library, plain.read(library))
    answers = []
    for file, ratio in ((shop / "p2.fmu", 1.0), (tmp_path / "units.fmu", degree / milli)):
        model = write_model(tmp_path, file)
        # without weight it is linear: in degrees it turns as one of another inertia and damping
        text = model.read_text().replace(f"G = {{ value = {WEIGHT}", "G = { value = 0.0")
        for value in (0.0205, DAMPING):
            text = text.replace(f"value = {value}", f"value = {value * ratio}")
        model.write_text(text)
        answers.append(simulate(model))
    for one, other in zip(*answers, strict=True):
        assert other == pytest.approx(one, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (1, "ended its process by SIGABRT"),
        (2, "did not answer within 0.3 s"),
        (3, "doStep answered"),
        (5, "positions that are no finite numbers"),
    ],
)
def test_an_fmu_that_dies_hangs_or_refuses_is_one_sentence(
    shop: Path, tmp_path: Path, bad: int, words: str
) -> None:
    limit = 0.3 if bad == 2 else 20.0  # s: what answers may take long on a loaded machine
    model = write_model(
        tmp_path, shop / "p2.fmu", f"time_limit = {limit}",
        f"bad = {{ value = {bad}, free = false }}",
    )  # fmt: skip
    with pytest.raises(ModelError, match=words) as said:
        zendsp.diagnose(shop / "run1.npz", model)
    assert "p2.fmu" in str(said.value) and "\n" not in str(said.value)


def test_what_an_fmu_prints_stays_out_of_the_answer(
    shop: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    simulate(write_model(tmp_path, shop / "p2.fmu", "", "bad = 4"))
    assert capfd.readouterr().out == ""


def test_hostile_files_and_names_are_refused(shop: Path, tmp_path: Path) -> None:
    (tmp_path / "text.fmu").write_text("no zip")
    with zipfile.ZipFile(tmp_path / "foreign.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", description("2.0"))
        archive.writestr("binaries/win64/p.dll", "")
    zipfile.ZipFile(tmp_path / "empty.fmu", "w").close()
    cases = (
        (write_model, tmp_path / "gone.fmu", "", "no such file"),
        (write_model, tmp_path / "text.fmu", "", "is not an FMU that can be read"),
        (write_model, tmp_path / "empty.fmu", "", "modelDescription.xml is missing, or is none of"),
        (write_model, tmp_path / "foreign.fmu", "", r"no binary for .*it has win64"),
        (write_model, shop / "p2.fmu", 'inputs = "torqe"', "no variable 'torqe'; did you mean"),
        (write_model, shop / "p2.fmu", 'inputs = "angle"', "expected a real input"),
    )
    for make, file, extra, words in cases:
        with pytest.raises(ModelError, match=words):
            zendsp.diagnose(shop / "run1.npz", make(tmp_path, file, extra))
    with pytest.raises(ModelError, match="no variable 'K'"):
        zendsp.diagnose(shop / "run1.npz", write_model(tmp_path, shop / "p2.fmu", "", "K = 1.0"))


def test_an_fmu_has_a_joint_for_each_output_where_the_column_is_one_array() -> None:
    mechanism = {"kind": "fmu", "file": "arm.fmu", "outputs": ["q1", "q2"]}
    model = parse_model({"mechanism": mechanism, "columns": {"position": "q", "command": "u"}})
    assert model.joints == 2
