"""An arm as URDF, as MJCF and as FMU, each with a model file that says the same."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import fmpy
import numpy as np
import numpy.typing as npt

from arms.arm import GRAVITY, Arm

Array = npt.NDArray[np.float64]

FORMS = ("urdf", "mjcf", "fmu", "fmu3")  # fmu3: an FMU 3.0
INSIDE = ("none", "sticks", "smooth")  # the dry friction of an FMU
SOURCES = Path(__file__).parent


def write_forms(
    folder: Path, arm: Arm, inside: str, sample_time: float, count: float, stated: str = ""
) -> None:
    """Write ``arm.urdf``, ``arm.xml``, ``arm.fmu``, ``arm3.fmu`` and a model file for each.

    Parameters
    ----------
    arm : Arm
        As it is given; friction of 0 is friction that the model has not.
    inside : str
        Where an FMU has the dry friction, one of ``INSIDE``; ``none``: as ``[[effect]]``.
    stated : str
        A further ``[[effect]]``.
    """
    if not arm.coulomb.any():
        inside = "none"
    (folder / "arm.urdf").write_text(_urdf(arm))
    (folder / "arm.xml").write_text(_mjcf(arm))
    _fmu(arm, folder / "arm.fmu", inside, 2)
    _fmu(arm, folder / "arm3.fmu", inside, 3)
    heads = {
        "urdf": 'kind = "urdf"\nfile = "arm.urdf"\n',
        "mjcf": 'kind = "mjcf"\nfile = "arm.xml"\n',
        "fmu": _fmu_head(arm, inside, "arm.fmu"),
        "fmu3": _fmu_head(arm, inside, "arm3.fmu"),
    }
    friction = {"coulomb": ("level", arm.coulomb), "viscous": ("coefficient", arm.viscous)}
    outside = {"coulomb": friction["coulomb"]} if inside == "none" else {}
    effects = {
        "urdf": {"inertia": ("amount", arm.rotor), **friction},
        "mjcf": {},
        "fmu": outside,
        "fmu3": outside,
    }
    for form in FORMS:
        text = f'name = "arm"\nsample_time = {sample_time}\n\n[mechanism]\n{heads[form]}'
        for kind, (key, values) in effects[form].items():
            for j, value in enumerate(values, 1):
                if value:
                    text += f'\n[[effect]]\nkind = "{kind}"\njoint = {j}\n'
                    text += f"{key} = {float(value)!r}\n"
        text += stated
        text += f"\n[actuator]\ngain = {{ value = 1.0, free = false }}\nhold = {sample_time}\n"
        text += f"\n[sensor]\nposition_resolution = {count!r}\n"
        text += '\n[columns]\ntime = "t"\nposition = "q"\ncommand = "u"\nreference = "r"\n'
        (folder / f"{form}.toml").write_text(text)


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(x)) for x in values)


def _urdf(arm: Arm) -> str:
    out = ['<robot name="arm">\n<link name="base"/>']
    for k in range(arm.n):
        x, y, z = (repr(float(i)) for i in arm.inertia[k])
        before = f"link{k}" if k else "base"
        out.append(
            f'<link name="link{k + 1}"><inertial><origin xyz="{_numbers(arm.com[k])}"/>'
            f'<mass value="{float(arm.mass[k])!r}"/><inertia ixx="{x}" iyy="{y}" izz="{z}" ixy="0"'
            ' ixz="0" iyz="0"/></inertial></link>\n'
            f'<joint name="joint{k + 1}" type="revolute"><parent link="{before}"/>'
            f'<child link="link{k + 1}"/><origin xyz="{_numbers(arm.place[k])}"/>'
            f'<axis xyz="{_numbers(arm.axis[k])}"/>'
            '<limit lower="-9" upper="9" effort="999" velocity="99"/></joint>'
        )
    return "\n".join([*out, "</robot>\n"])


def _mjcf(arm: Arm) -> str:
    out = [
        f'<mujoco model="arm">\n<option timestep="2e-4" gravity="{_numbers(GRAVITY)}"'
        ' integrator="implicitfast"/>\n<worldbody>'
    ]
    for k in range(arm.n):
        out.append(
            f'<body name="link{k + 1}" pos="{_numbers(arm.place[k])}">'
            f'<inertial pos="{_numbers(arm.com[k])}" mass="{float(arm.mass[k])!r}"'
            f' diaginertia="{_numbers(arm.inertia[k])}"/>\n<joint name="joint{k + 1}" type="hinge"'
            f' axis="{_numbers(arm.axis[k])}" armature="{float(arm.rotor[k])!r}"'
            f' damping="{float(arm.viscous[k])!r}" frictionloss="{float(arm.coulomb[k])!r}"/>'
        )
    return "\n".join([*out, "</body>" * arm.n, "</worldbody>\n</mujoco>\n"])


def _parameters(arm: Arm, inside: str) -> Mapping[str, Array]:
    """The numbers of an FMU, by the beginnings of their names."""
    dry = arm.coulomb if inside != "none" else np.zeros(arm.n)
    return {"m": arm.mass, "J": arm.rotor, "b": arm.viscous, "Fc": dry}


def _fmu_head(arm: Arm, inside: str, file: str) -> str:
    def each(name: str) -> str:
        return "[" + ", ".join(f'"{name}{j + 1}"' for j in range(arm.n)) + "]"

    rows = [
        f'kind = "fmu"\nfile = "{file}"',
        f"inputs = {each('u')}\noutputs = {each('q')}",
        f"start_position = {each('q')}\nstart_velocity = {each('v')}",
        "[mechanism.parameters]",
    ]
    for name, values in _parameters(arm, inside).items():
        held = ", free = false" if name == "m" else ""
        rows += [
            f"{name}{j} = {{ value = {float(x)!r}{held} }}" for j, x in enumerate(values, 1) if x
        ]
    return "\n".join(rows) + "\n"


def _fmu(arm: Arm, path: Path, inside: str, version: int) -> None:
    folder = Path(tempfile.mkdtemp())
    library = folder / "arm.so"
    headers = Path(fmpy.__file__).parent / "c-code"
    source = (SOURCES / f"fmi{version}.c").read_text()
    every = (headers / f"fmi{version}Functions.h").read_text()
    named = re.findall(rf"\b(fmi{version}\w+);", every)
    rest = [name for name in dict.fromkeys(named) if f" {name}(" not in source]
    (folder / "rest.c").write_text("".join(f"int {name}(void) {{ return 3; }}\n" for name in rest))
    start = np.concatenate(list(_parameters(arm, inside).values()))
    (folder / "numbers.h").write_text(
        f"#define N {arm.n}\n#define FRICTION {inside.upper()}\n"
        f"static const double START[] = {{{_row(start)}}}, GRAVITY[3] = {{{_row(GRAVITY)}}};\n"
        + "".join(
            f"static const double {name}[N][3] = {{{', '.join('{' + _row(r) + '}' for r in x)}}};\n"
            for name, x in (
                ("AXIS", arm.axis), ("PLACE", arm.place), ("COM", arm.com), ("INERTIA", arm.inertia)
            )
        )
    )  # fmt: skip
    command = ["gcc", "-shared", "-fPIC", "-O2", "-w", f"-I{headers}", f"-I{folder}", "-o"]
    main = SOURCES / f"fmi{version}.c"
    subprocess.run([*command, library, main, folder / "rest.c", "-lm"], check=True)
    platform = fmpy.platform if version == 2 else fmpy.platform_tuple
    with zipfile.ZipFile(path, "w") as z:
        z.writestr("modelDescription.xml", _DESCRIPTIONS[version](_variables(arm, start)))
        z.write(library, f"binaries/{platform}/arm.so")
    shutil.rmtree(folder)


def _row(values: Iterable[float]) -> str:
    return ", ".join(repr(float(x)) for x in values)


@dataclass(frozen=True)
class _Variable:
    """A number of an FMU, as its description lists it."""

    name: str
    causality: str
    variability: str
    start: float

    @property
    def begins(self) -> str:
        """That its start value is exact, but of an input."""
        return "" if self.causality == "input" else ' initial="exact"'


def _variables(arm: Arm, start: Array) -> list[_Variable]:
    """The variables in the order of their value references."""
    roles = {"u": "input", "q": "output", "v": "local"} | dict.fromkeys(
        ("m", "J", "b", "Fc"), "parameter"
    )
    begins = np.r_[np.zeros(3 * arm.n), start].reshape(-1, arm.n)
    return [
        _Variable(
            f"{name}{j}", role, "tunable" if role == "parameter" else "continuous", float(value)
        )
        for (name, role), values in zip(roles.items(), begins, strict=True)
        for j, value in enumerate(values, 1)
    ]


def _fmi2(variables: Sequence[_Variable]) -> str:
    rows = "".join(
        f'<ScalarVariable name="{v.name}" valueReference="{k}" causality="{v.causality}"'
        f' variability="{v.variability}"{v.begins}><Real start="{v.start!r}"/></ScalarVariable>'
        for k, v in enumerate(variables)
    )
    outputs = "".join(
        f'<Unknown index="{k}"/>' for k, v in enumerate(variables, 1) if v.causality == "output"
    )
    return (
        '<?xml version="1.0"?>\n<fmiModelDescription fmiVersion="2.0" modelName="arm" guid="arm">'
        '<CoSimulation modelIdentifier="arm" canHandleVariableCommunicationStepSize="true"/>'
        f"<ModelVariables>{rows}</ModelVariables><ModelStructure><Outputs>{outputs}"
        "</Outputs></ModelStructure></fmiModelDescription>"
    )


def _fmi3(variables: Sequence[_Variable]) -> str:
    rows = "".join(
        f'<Float64 name="{v.name}" valueReference="{k}" causality="{v.causality}"'
        f' variability="{v.variability}"{v.begins} start="{v.start!r}"/>'
        for k, v in enumerate(variables)
    )
    outputs = "".join(
        f'<Output valueReference="{k}"/>'
        for k, v in enumerate(variables)
        if v.causality == "output"
    )
    return (
        '<?xml version="1.0"?>\n<fmiModelDescription fmiVersion="3.0" modelName="arm"'
        ' instantiationToken="arm"><CoSimulation modelIdentifier="arm"'
        ' canHandleVariableCommunicationStepSize="true"/>'
        f'<ModelVariables>{rows}<Float64 name="time" valueReference="{len(variables)}"'
        ' causality="independent" variability="continuous"/></ModelVariables>'
        f"<ModelStructure>{outputs}</ModelStructure>"
        "</fmiModelDescription>"
    )


_DESCRIPTIONS = {2: _fmi2, 3: _fmi3}
