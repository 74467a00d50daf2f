"""Brings the published recordings of real machines into the form of the contract."""

from __future__ import annotations

import gzip
import hashlib
import io
import shutil
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit
from xml.etree import ElementTree

import numpy as np

from zendsp.physics.files.shipped import model_folder

# below the data folder: file -> SHA-256 of what this project was measured on; of what is in it
# where it is compressed
FILES = {
    "emps": {
        "emps/DATA_EMPS.mat": "6cf6814ae14618795da0101aae2bb97ff0c6351b0501b5492751b02b07facf7e",
        "emps/DATA_EMPS_PULSES.mat": (
            "0eab75bb1f6b16228ee78791343a88bf9bfd9a51036ac9807d7b5fc11c0e1704"
        ),
    },
    "single_pendulum": {
        "single_pendulum/SinglePendulumDataForParameterEstimation.mat": (
            "f3b8cdda4a6e86405ec37ff32b98be76fd37806a609cba7870628c1e40377a98"
        ),
    },
    "tx40": {
        "tx40/pos_read_data.csv.gz": (
            "5cc1cecc1024ef0e331d0caba06f689456ab789ec3f1e904599c0a8be5c27bc8"
        ),
        "tx40/curr_data.csv.gz": "f4592f4ba4db42f5d7625688986be25b575ca34d0504b27979ca6b0276bd3af9",
        "tx40/tx40.urdf": "8d678db7e0ff23f5004050cefe2bbda6ca7e00c1b0e707b05f792e7522900453",
    },
    "kuka_kr300": {
        "kuka_kr300/A.npz": ("6245d546c58879c52dca4f90ed6fcfd0966acd7ef2dabb10dd91618f6c8112d9"),
        "kuka_kr300/B.npz": ("4ba8900d061fb59a01a19ab5438fa9dba6130bca391d9dc2693a9845675fe77f"),
        "kuka_kr300/kr300.urdf": (
            "df69b0751fd89dbe9cf5e5df82f16814934ea231cc7f90f0c69fc1c358a3d839"
        ),
    },
}
SOURCES = {
    "emps": "Janot, Gautier, Brunot 2019, nonlinearbenchmark.org (EMPS)",
    "single_pendulum": (
        "github.com/dynamicslab/MultiArm-Pendulum (MIT), ParameterEstimation/SinglePendulum"
    ),
    "tx40": (
        "github.com/thanhndv212/figaroh-examples, staubli_tx40 (Apache-2.0); compress the tables"
        " with gzip, take the visual and collision elements out of the URDF"
    ),
    "kuka_kr300": (
        "github.com/JonasWeigand/Robot_Identification (MIT) at 9e403c07: per axis q_motor, q_link,"
        " torque_joint and q_ref of the two recordings as arrays, the table of bodies as a URDF"
    ),
}
# machines of the recordings of another
OF = {"kuka_unloaded": "kuka_kr300", "kuka_frictionless": "kuka_kr300"}
_EMPS = "https://drive.google.com/uc?export=download&id=1zwoXYa9-3f8NQ0ohzmjpF7UxbNgRTHkS"
_TX40 = "https://raw.githubusercontent.com/thanhndv212/figaroh-examples/541a2ec01529eef2dfbdd65bb768d2cfe5af1962/examples/staubli_tx40/data/"
# what is published as a file, or as a member of a zip archive
ADDRESSES = {
    "emps/DATA_EMPS.mat": _EMPS,
    "emps/DATA_EMPS_PULSES.mat": _EMPS,
    "single_pendulum/SinglePendulumDataForParameterEstimation.mat": (
        "https://raw.githubusercontent.com/dynamicslab/MultiArm-Pendulum/78ed9353702f1f9e92c74d3bb671a7804fb41fb0/"
        "ParameterEstimation/SinglePendulum/SinglePendulumDataForParameterEstimation.mat"
    ),
    "tx40/pos_read_data.csv.gz": _TX40 + "pos_read_data.csv",
    "tx40/curr_data.csv.gz": _TX40 + "curr_data.csv",
}


@dataclass(frozen=True)
class Recordings:
    """Files of one machine in the contract's form."""

    train: tuple[Path, ...]
    heldout: tuple[Path, ...]  # empty: the last third is held out


def missing(machine: str, data: Path) -> list[str]:
    """Files of a machine that are not below `data`."""
    return [name for name in FILES[OF.get(machine, machine)] if not (data / name).exists()]


def altered(machine: str, data: Path) -> list[str]:
    """Files of a machine whose content is not what this project's figures were measured on."""
    return [
        name
        for name, known in FILES[OF.get(machine, machine)].items()
        if (data / name).exists() and content_hash(data / name) != known
    ]


def content_hash(path: Path) -> str:
    """SHA-256 of a file, or of what a .gz file holds; empty where it cannot be read."""
    try:
        raw = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    except (OSError, EOFError):
        return ""
    return hashlib.sha256(raw).hexdigest()


def fetch(machine: str, data: Path, tell: Callable[[str], None] = lambda _line: None) -> list[str]:
    """Download what is absent and has an address; returns what could not be had, and why.

    Nothing gets into the data folder unless its hash is the known one. Needs a network and pooch
    (``pip install 'zendsp[data]'``).
    """
    trouble = []
    with tempfile.TemporaryDirectory() as folder:  # an archive of two files is loaded once
        for name in missing(machine, data):
            if name not in ADDRESSES:
                trouble.append(f"{name}: no address of its own; get it from {SOURCES[machine]}")
                continue
            tell(f"{machine}: fetching {name}")
            try:
                _fetch_one(name, FILES[machine][name], data / name, Path(folder))
            except (ImportError, OSError, ValueError) as error:
                trouble.append(f"{name}: {error}; get it from {SOURCES[machine]}")
    return trouble


def _fetch_one(name: str, known: str, target: Path, folder: Path) -> None:
    import pooch
    import requests  # what pooch fetches with

    pooch.get_logger().setLevel("WARNING")
    address = ADDRESSES[name]
    cached = hashlib.sha256(address.encode()).hexdigest()[:16]
    try:
        raw = Path(pooch.retrieve(address, None, fname=cached, path=folder)).read_bytes()
    except requests.ConnectionError as error:
        raise ConnectionError(f"{urlsplit(address).hostname} cannot be reached") from error
    if zipfile.is_zipfile(io.BytesIO(raw)):
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            inside = [member for member in archive.namelist() if Path(member).name == target.name]
            if not inside:
                raise ValueError(f"the archive at {address} does not hold {target.name}")
            raw = archive.read(inside[0])
    found = hashlib.sha256(raw).hexdigest()
    if found != known:
        raise ValueError(f"SHA-256 of what is at {address} is {found}, expected {known}: not kept")
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_suffix(target.suffix + ".part")
    part.write_bytes(gzip.compress(raw, mtime=0) if target.suffix == ".gz" else raw)
    part.replace(target)


def convert(machine: str, data: Path, out: Path) -> Recordings:
    """Write the recordings of `machine` into `out`.

    Raises
    ------
    FileNotFoundError
        The data are absent; the message says what to get and where from.
    """
    absent = missing(machine, data)
    if absent:
        raise FileNotFoundError(
            f"{machine}: {', '.join(absent)} absent below {data}; get it from"
            f" {SOURCES[OF.get(machine, machine)]}"
        )
    out.mkdir(parents=True, exist_ok=True)
    if machine == "emps":  # its files are recordings already
        train, held = (data / name for name in FILES["emps"])
        return Recordings((train,), (held,))
    if machine == "kuka_kr300":
        return kuka(data, out)
    if machine == "kuka_unloaded":
        return unloaded(data, out)
    if machine == "kuka_frictionless":
        return frictionless(data, out)
    return pendulum(data, out) if machine == "single_pendulum" else tx40(data, out)


def pendulum(data: Path, out: Path) -> Recordings:
    """Each segment as one file; upright zero becomes hanging zero."""
    from scipy.io import loadmat

    table = loadmat(data / next(iter(FILES["single_pendulum"])), squeeze_me=True)
    made: dict[str, list[Path]] = {"id": [], "vad": []}
    for group, paths in made.items():
        for k, (t, y) in enumerate(
            zip(table[f"Time_{group}"], table[f"Y_{group}"], strict=True), 1
        ):
            path = out / f"{'id' if group == 'id' else 'val'}_{k}.npz"
            np.savez_compressed(path, t=t - t[0], q=y[0] - np.pi, qd=y[1])
            paths.append(path)
    return Recordings(tuple(made["id"]), tuple(made["vad"]))


def tx40(data: Path, out: Path) -> Recordings:
    """Motor positions and torques from 5 kHz to 1 kHz: low-pass run both ways, then every fifth
    sample.

    The filter's ends are padded with the data's own continuation: `scipy.signal.decimate` pads with
    zeros, which tears the first and last rows away from a joint that does not stand at zero.
    """
    from scipy.signal import butter, sosfiltfilt

    positions, torques, urdf = (data / name for name in FILES["tx40"])
    columns = [np.loadtxt(path, delimiter=",", skiprows=1) for path in (positions, torques)]
    sos = butter(8, 400.0, fs=5000.0, output="sos")
    q, tau = (sosfiltfilt(sos, c, axis=0)[::5] for c in columns)
    path = out / "tx40_1khz.npz"
    np.savez_compressed(path, t=np.arange(len(q)) * 1e-3, q_motor=q, tau_motor=tau)
    shutil.copyfile(urdf, out / "tx40.urdf")
    return Recordings((path,), ())


def kuka(data: Path, out: Path) -> Recordings:
    """Both recordings as they are, beside the URDF; the second encoders of axes 1 to 3 only."""
    made = []
    for name in ("A", "B"):
        table = np.load(data / "kuka_kr300" / f"{name}.npz")
        path = out / f"kuka_{name}.npz"
        kept = {key: table[key] for key in ("t", "q_motor", "q_ref", "torque_joint")}
        link = np.where(np.arange(6) < 3, table["q_link"], np.nan)
        np.savez_compressed(path, **kept, q_link=link)
        made.append(path)
    shutil.copyfile(data / "kuka_kr300" / "kr300.urdf", out / "kr300.urdf")
    return Recordings((made[0],), (made[1],))


LOAD = 150.0  # kg, 0.1 m before the flange, which is 0.24 m from the last link's origin
RATE, JITTER = 100.0, 0.2  # Hz, and of the sample time: a logger beside the drives


def unloaded(data: Path, out: Path) -> Recordings:
    """The motors' side as a slow logger has it, a URDF of the robot without what it carries, and a
    model of both.
    """
    made = _logged(data, out)
    text = (data / "kuka_kr300" / "kr300.urdf").read_text(encoding="utf-8")
    tree = ElementTree.fromstring(text)
    last = tree.find("link[@name='link6']/inertial")
    assert last is not None
    mass, origin = last.find("mass"), last.find("origin")
    assert mass is not None and origin is not None
    x, y, z = map(float, origin.attrib["xyz"].split())
    whole = float(mass.attrib["value"])
    own = whole - LOAD
    origin.attrib["xyz"] = f"{x * whole / own} {y * whole / own} {(z * whole + 0.34 * LOAD) / own}"
    mass.attrib["value"] = str(own)
    (out / "kr300.urdf").write_text(ElementTree.tostring(tree, encoding="unicode"))
    (out / "kuka_unloaded.toml").write_text(_model_of_log(), encoding="utf-8")
    return made


def frictionless(data: Path, out: Path) -> Recordings:
    """The same log, the URDF as it is, and a model without any dry friction."""
    made = _logged(data, out)
    shutil.copyfile(data / "kuka_kr300" / "kr300.urdf", out / "kr300.urdf")
    head, *effects = _model_of_log().split("[[effect]]")
    *effects, last = effects
    last, mark, rest = last.partition("[actuator]")
    kept = "".join(f"[[effect]]{e}" for e in (*effects, last) if 'kind = "coulomb"' not in e)
    (out / "kuka_frictionless.toml").write_text(head + kept + mark + rest, encoding="utf-8")
    return made


def _logged(data: Path, out: Path) -> Recordings:
    """The motors' side as a slow logger has it."""
    rng, made = np.random.default_rng(0), []
    for name in ("A", "B"):
        table = np.load(data / "kuka_kr300" / f"{name}.npz")
        t = table["t"]
        wanted = np.arange(t[0] + 1.0 / RATE, t[-1] - 1.0 / RATE, 1.0 / RATE)
        wanted += rng.uniform(-JITTER, JITTER, len(wanted)) / RATE
        rows = np.searchsorted(t, wanted)
        path = out / f"kuka_{name}.npz"
        kept = {key: table[key][rows] for key in ("t", "q_motor", "q_ref", "torque_joint")}
        np.savez_compressed(path, **kept)
        made.append(path)
    return Recordings((made[0],), (made[1],))


def _model_of_log() -> str:
    """The model file of that log."""
    model = (model_folder() / "kuka_kr300.toml").read_text(encoding="utf-8")
    for key in ("sample_time", "hold"):
        model = model.replace(f"{key} = 0.004", f"{key} = {1.0 / RATE}")
    return model.replace('position_load = "q_link"\n', "")
