"""Brings the published recordings of real machines into the form of the contract."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# below the data folder; its SHA256SUMS lists them
FILES = {
    "emps": ("emps/DATA_EMPS.mat", "emps/DATA_EMPS_PULSES.mat"),
    "single_pendulum": ("single_pendulum/SinglePendulumDataForParameterEstimation.mat",),
    "tx40": ("tx40/pos_read_data.csv.gz", "tx40/curr_data.csv.gz", "tx40/tx40.urdf"),
}
SOURCES = {
    "emps": "Janot, Gautier, Brunot 2019, nonlinearbenchmark.org (EMPS)",
    "single_pendulum": "github.com/dynamicslab/MultiArm-Pendulum (MIT)",
    "tx40": "github.com/thanhndv212/figaroh-examples, staubli_TX40 (Apache-2.0)",
}


@dataclass(frozen=True)
class Recordings:
    """Files of one machine in the contract's form."""

    train: tuple[Path, ...]
    heldout: tuple[Path, ...]  # empty: the last third is held out


def missing(machine: str, data: Path) -> list[str]:
    """Files of a machine that are not below `data`."""
    return [name for name in FILES[machine] if not (data / name).exists()]


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
        return Recordings((data / FILES["emps"][0],), (data / FILES["emps"][1],))
    return pendulum(data, out) if machine == "single_pendulum" else tx40(data, out)


def pendulum(data: Path, out: Path) -> Recordings:
    """Each segment as one file; upright zero becomes hanging zero."""
    from scipy.io import loadmat

    table = loadmat(data / FILES["single_pendulum"][0], squeeze_me=True)
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

    columns = [np.loadtxt(data / name, delimiter=",", skiprows=1) for name in FILES["tx40"][:2]]
    sos = butter(8, 400.0, fs=5000.0, output="sos")
    q, tau = (sosfiltfilt(sos, c, axis=0)[::5] for c in columns)
    path = out / "tx40_1khz.npz"
    np.savez_compressed(path, t=np.arange(len(q)) * 1e-3, q_motor=q, tau_motor=tau)
    shutil.copyfile(data / FILES["tx40"][2], out / "tx40.urdf")
    return Recordings((path,), ())
