"""Brings the published recordings of real machines into the form of the contract."""

from __future__ import annotations

import hashlib
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# below the data folder: file -> SHA-256 of what the published results of this project were measured on
FILES = {
    "emps": {
        "emps/DATA_EMPS.mat": "6cf6814ae14618795da0101aae2bb97ff0c6351b0501b5492751b02b07facf7e",
        "emps/DATA_EMPS_PULSES.mat": "0eab75bb1f6b16228ee78791343a88bf9bfd9a51036ac9807d7b5fc11c0e1704",
    },
    "single_pendulum": {
        "single_pendulum/SinglePendulumDataForParameterEstimation.mat": (
            "f3b8cdda4a6e86405ec37ff32b98be76fd37806a609cba7870628c1e40377a98"
        ),
    },
    "tx40": {
        "tx40/pos_read_data.csv.gz": "b107ec63aa3609d087cab74d7564c8a2a0c0aa6045a9b89bbd7f5be2caa6d7c7",
        "tx40/curr_data.csv.gz": "a99cc2ae662511b58ab3983fb2cdb9ce734eeaf3e604da36c51d29265e91ab87",
        "tx40/tx40.urdf": "8d678db7e0ff23f5004050cefe2bbda6ca7e00c1b0e707b05f792e7522900453",
    },
}
SOURCES = {
    "emps": "Janot, Gautier, Brunot 2019, nonlinearbenchmark.org (EMPS)",
    "single_pendulum": "github.com/dynamicslab/MultiArm-Pendulum (MIT), ParameterEstimation/SinglePendulum",
    "tx40": "github.com/thanhndv212/figaroh-examples, staubli_TX40 (Apache-2.0); compress the tables with gzip",
}
# the one file that is published at an address of its own
ADDRESSES = {
    "single_pendulum/SinglePendulumDataForParameterEstimation.mat": (
        "https://raw.githubusercontent.com/dynamicslab/MultiArm-Pendulum/78ed9353702f1f9e92c74d3bb671a7804fb41fb0/"
        "ParameterEstimation/SinglePendulum/SinglePendulumDataForParameterEstimation.mat"
    )
}


@dataclass(frozen=True)
class Recordings:
    """Files of one machine in the contract's form."""

    train: tuple[Path, ...]
    heldout: tuple[Path, ...]  # empty: the last third is held out


def missing(machine: str, data: Path) -> list[str]:
    """Files of a machine that are not below `data`."""
    return [name for name in FILES[machine] if not (data / name).exists()]


def altered(machine: str, data: Path) -> list[str]:
    """Files of a machine whose content is not what this project's figures were measured on."""
    return [
        name
        for name, known in FILES[machine].items()
        if (data / name).exists() and hashlib.sha256((data / name).read_bytes()).hexdigest() != known
    ]


def fetch(machine: str, data: Path) -> list[str]:
    """Download what is absent and has an address, checked by hash; returns what could not be had, and why.

    Needs a network and pooch (``pip install 'zendsp[data]'``).
    """
    trouble = []
    for name in missing(machine, data):
        if name not in ADDRESSES:
            trouble.append(f"{name}: no address of its own; get it from {SOURCES[machine]}")
            continue
        try:
            import pooch

            target = data / name
            pooch.retrieve(ADDRESSES[name], FILES[machine][name], fname=target.name, path=target.parent)
        except (ImportError, OSError, ValueError) as error:
            trouble.append(f"{name}: {error}")
    return trouble


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
            f"{machine}: {', '.join(absent)} absent below {data}; get it from {SOURCES[machine]}"
        )
    out.mkdir(parents=True, exist_ok=True)
    if machine == "emps":  # its files are recordings already
        train, held = (data / name for name in FILES["emps"])
        return Recordings((train,), (held,))
    return pendulum(data, out) if machine == "single_pendulum" else tx40(data, out)


def pendulum(data: Path, out: Path) -> Recordings:
    """Each segment as one file; upright zero becomes hanging zero."""
    from scipy.io import loadmat

    table = loadmat(data / next(iter(FILES["single_pendulum"])), squeeze_me=True)
    made: dict[str, list[Path]] = {"id": [], "vad": []}
    for group, paths in made.items():
        for k, (t, y) in enumerate(zip(table[f"Time_{group}"], table[f"Y_{group}"], strict=True), 1):
            path = out / f"{'id' if group == 'id' else 'val'}_{k}.npz"
            np.savez_compressed(path, t=t - t[0], q=y[0] - np.pi, qd=y[1])
            paths.append(path)
    return Recordings(tuple(made["id"]), tuple(made["vad"]))


def tx40(data: Path, out: Path) -> Recordings:
    """Motor positions and torques from 5 kHz to 1 kHz: low-pass run both ways, then every fifth sample.

    The filter's ends are padded with the data's own continuation: `scipy.signal.decimate` pads with zeros, which tears the
    first and last rows away from a joint that does not stand at zero.
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
