"""Compiles the parts of a target: the native runner, the monitor's helper, the machines."""

from __future__ import annotations

import contextlib
import importlib.util
import math
import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from zendsp_isr.build import Built, build, source_root
from zendsp_protocol.errors import CompileFailed
from zendsp_protocol.states import Severity

_MODELS = (".xml", ".mjcf", ".urdf")  # what MuJoCo reads
# a word of MuJoCo's sentence, which has no codes; what to do, and the compiler's option for it
_REMEDIES = (
    ("balanceinertia", "correct the inertia of that {}", 'balanceinertia="true"'),
    ("mjMINVAL", "give that {} a mass and an inertia", 'boundmass="0.001" boundinertia="1e-6"'),
    ("positive eigenvalues", "no {} has such an inertia, correct it: no principal moment is 0", ""),
)
_XACRO = re.compile(r"<xacro:|=\s*\"[^\"<>]*\$[({]")  # what xacro replaces


def _trusted(kind: str, built: Built) -> Path:
    if built.path is None:
        lines = [str(m) for m in built.messages if m.severity == Severity.ERROR]
        raise CompileFailed(
            f"the {kind} does not compile with {built.compiler}:\n" + "\n".join(lines)
        )
    return built.path


def _read(folder: Path, names: Sequence[str]) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in names}


RUNNER_SOURCES = (
    "main.c", "contain.c", "loop.c", "dictionary.c", "realtime.c", "service.c", "batch.c",
    "stream.c", "safety.c", "promises.c",
)
MONITOR_SOURCES = ("monitor.c", "lost_pages.c")


def build_runner() -> Path:
    """The native runner for this machine.

    Raises
    ------
    CompileFailed
        No compiler, or one that cannot compile it.
    """
    root = source_root()
    sources = _read(root / "runtime", RUNNER_SOURCES)
    built = build(
        "runner", sources, [root / "runtime", root / "include"], shared=False,
        libraries=("-lm", "-ldl", "-lpthread"),
    )
    return _trusted("runner", built)


def build_monitor() -> Path:
    """The shared-memory helper that the monitor loads through cffi.

    Raises
    ------
    CompileFailed
        No compiler, or one that cannot compile it.
    """
    root = source_root()
    built = build(
        "monitor", _read(root / "runtime", MONITOR_SOURCES), [root / "runtime", root / "include"]
    )
    return _trusted("monitor", built)


def machine_source(machine: str) -> Path:
    """The C file of a machine: a shipped one by its name, or a path.

    Raises
    ------
    CompileFailed
        No such machine.

    Examples
    --------
    >>> machine_source("imi_planar").name
    'imi_planar.c'
    """
    path = Path(machine)
    if path.suffix == ".xacro":
        raise CompileFailed(_expand(path))
    if not machine.endswith(".c"):
        path = source_root() / "machines" / f"{machine}.c"
    if not path.is_file():
        names = ", ".join(machine_names())
        raise CompileFailed(
            f"no machine {machine!r}: choose one of {names}, or give the path of a .c file or of a"
            " MuJoCo model (.xml, .urdf)"
        )
    return path


def build_machine(machine: str) -> Path:
    """A machine as a shared object: a shipped one by name, or a user's own by the path of its
    ``.c`` file.

    Parameters
    ----------
    machine : str
        For example ``"imi_planar"``, ``"/home/me/my_arm.c"``, or ``"arm.xml"``: a model that MuJoCo
        reads.

    Raises
    ------
    CompileFailed
        No such machine, or it does not compile, or it is none; or a model without MuJoCo.

    Examples
    --------
    >>> build_machine("imi_planar").suffix
    '.so'
    """
    root = source_root()
    if is_model(machine):
        return _build_mujoco(machine)
    path = machine_source(machine)
    include = [root / "include", root / "machines"]
    if path.parent.resolve() != (root / "machines").resolve():
        include.append(path.parent.resolve())
    built = _trusted(
        f"machine {path.name}", build("machine", {path.name: path.read_bytes()}, include)
    )
    if b"\0zendsp_machine\0" not in built.read_bytes():  # as its table of names has it
        raise CompileFailed(
            f"{machine}: is no machine: it defines no 'zendsp_machine' (docs/machines.md). A"
            " control program is loaded on a target that runs: zendsp run FILE"
        )
    return built


def is_model(machine: str) -> bool:
    """Whether a machine is given as a file that MuJoCo reads.

    Examples
    --------
    >>> is_model("arm.xml"), is_model("imi_planar")
    (True, False)
    """
    return Path(machine).suffix.lower() in _MODELS


def stated_speeds(model: str) -> str:
    """The speeds that a URDF limits its joints to, rad/s or m/s: names and numbers, parted by tabs;
    MuJoCo does not read them. Empty of another file, and of one that MuJoCo will refuse.
    """
    if Path(model).suffix.lower() != ".urdf":
        return ""
    stated = []
    try:
        for joint in ElementTree.parse(model).iter("joint"):
            limit, name = joint.find("limit"), joint.get("name", "")
            speed = _above_zero("" if limit is None else limit.get("velocity", ""))
            stated += [name, repr(speed)] if name and speed else []
    except (ElementTree.ParseError, OSError, ValueError):
        return ""
    return "\t".join(stated)


def _above_zero(text: str) -> float:
    """The number that a text holds; 0 where it holds none, or one that limits nothing."""
    with contextlib.suppress(ValueError):
        value = float(text)
        return value if 0.0 < value < math.inf else 0.0
    return 0.0


def with_remedy(said: str, model: str) -> str:
    """MuJoCo's message on a model that it does not compile, with what to do where the message does
    not say so.

    Examples
    --------
    >>> with_remedy("body 'a': mass and inertia must be larger than mjMINVAL", "arm.urdf")[-66:]
    '<mujoco><compiler boundmass="0.001" boundinertia="1e-6"/></mujoco>'
    """
    urdf = Path(model).suffix.lower() == ".urdf"
    part, where = ("link", "below <robot>") if urdf else ("body", "in the file")
    for word, what, option in _REMEDIES:
        if word in said:
            line = f"<compiler {option}/>"
            new = f", or write {where}: {f'<mujoco>{line}</mujoco>' if urdf else line}"
            return f"{said}: {what.format(part)}{new if option else ''}"
    return said


def machine_title(machine: str) -> str:
    """Name of a machine for people and for keys: a shipped one's own, else that of its file.

    Examples
    --------
    >>> machine_title("robots/my_arm.xml")
    'my_arm'
    """
    return Path(machine).stem if machine.endswith(".c") or is_model(machine) else machine


def _expand(path: Path) -> str:
    """What to do with a description from which xacro has yet to make a URDF."""
    urdf = Path(path.name.removesuffix(".xacro")).with_suffix(".urdf")
    urdf = urdf if urdf.name != path.name else urdf.with_stem(f"{urdf.stem}_expanded")
    return (
        f"{path}: xacro has to make a URDF of it first: 'pip install xacro', then"
        f" 'xacro {path} > {urdf}'; give that file"
    )


def _is_xacro(path: Path) -> bool:
    """Whether a URDF still contains parts that xacro replaces."""
    text = path.read_text(errors="replace") if path.suffix.lower() == ".urdf" else ""
    return _XACRO.search(re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)) is not None


def _build_mujoco(machine: str) -> Path:
    """The machine that runs any MuJoCo model, linked to the library of the installed package;
    Python itself loads nothing of it.
    """
    if not Path(machine).is_file():
        raise CompileFailed(f"{machine}: no such file: give the path of a MuJoCo model")
    if _is_xacro(Path(machine)):
        raise CompileFailed(_expand(Path(machine)))
    found = importlib.util.find_spec("mujoco")
    folders = found.submodule_search_locations if found is not None else None
    package = Path(next(iter(folders))) if folders else None
    libraries = sorted(package.glob("libmujoco.so*")) if package is not None else []
    if package is None or not libraries:
        raise CompileFailed(
            f"{machine}: a MuJoCo model needs mujoco on the target: pip install 'zendsp[mujoco]'"
        )
    root = source_root()
    source = root / "machines" / "mujoco" / "mujoco_machine.c"
    include = [root / "include", root / "machines", source.parent, package / "include", package]
    link = (f"-L{package}", f"-l:{libraries[-1].name}", f"-Wl,-rpath,{package}", "-lm")
    return _trusted(
        "machine for MuJoCo models",
        build("machine", {source.name: source.read_bytes()}, include, libraries=link),
    )


def machine_names() -> tuple[str, ...]:
    """Names of the machines that ship with zendsp.

    Examples
    --------
    >>> "imi_planar" in machine_names()
    True
    """
    folder = source_root() / "machines"
    return tuple(
        sorted(path.stem for path in folder.glob("*.c") if b"zendsp_machine" in path.read_bytes())
    )
