"""Files as other tools write them, by their own libraries."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

RNG = np.random.default_rng(7)
N = 400
T = np.arange(N) * 0.002
Q = np.cumsum(RNG.normal(size=(N, 2)), axis=0) * 0.01
U = RNG.normal(size=N)


def hdf5(path: Path) -> Path:
    import h5py

    with h5py.File(path, "w") as file:
        run = file.create_group("run")
        run["t"], run["q"], run["u"] = T * 1e3, np.degrees(Q), U
        run["t"].attrs["units"], run["q"].attrs["unit"] = "ms", "deg"
        run["who"], file["rate"] = "me", 500.0
    return path


def tdms(path: Path) -> Path:
    from nptdms import ChannelObject, TdmsWriter

    clock = {"wf_increment": 0.002, "wf_start_offset": 0.0}
    with TdmsWriter(path) as writer:
        writer.write_segment([
            ChannelObject("DAQ", "q1", np.degrees(Q[:, 0]), {**clock, "unit_string": "deg"}),
            ChannelObject("DAQ", "q2", np.degrees(Q[:, 1]), {**clock, "unit_string": "deg"}),
            ChannelObject("DAQ", "u", U, clock),
        ])  # fmt: skip
    return path


def tdms_with_a_time_channel(path: Path) -> Path:
    from nptdms import ChannelObject, TdmsWriter

    columns = {"Time (ms)": T * 1e3, "q1": Q[:, 0], "q2": Q[:, 1], "u": U}
    units = {"Time (ms)": "ms"}
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [
                ChannelObject("g", n, v, {"unit_string": units.get(n, "")})
                for n, v in columns.items()
            ]
        )
    return path


def mdf(path: Path) -> Path:
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.append(
            [Signal(np.degrees(Q[:, k]), T, unit="deg", name=f"q{k + 1}") for k in (0, 1)],
            comment="fast",
        )
        file.append([Signal(U[::2], T[::2], unit="V", name="u")], comment="slow")
        file.save(path)
    return path


def json_mcap(path: Path) -> Path:
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("Sample", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel("/motor", "json", schema)
        for k in range(N):
            body = {"position": list(Q[k]), "effort": U[k]}
            stamp = 1_700_000_000_000_000_000 + k * 2_000_000
            writer.add_message(channel, stamp, json.dumps(body).encode(), stamp)
        writer.finish()
    return path


def bag(path: Path, plugin: str, *, command_every: int = 1, command_from: int = 0) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    state, header = store.types["sensor_msgs/msg/JointState"], store.types["std_msgs/msg/Header"]
    stamp = store.types["builtin_interfaces/msg/Time"]
    array = store.types["std_msgs/msg/Float64MultiArray"]
    layout, words = store.types["std_msgs/msg/MultiArrayLayout"], store.types["std_msgs/msg/String"]
    with Writer(path, version=9, storage_plugin=StoragePlugin[plugin]) as writer:
        joints = writer.add_connection("/joint_states", state.__msgtype__, typestore=store)
        commands = writer.add_connection("/effort/commands", array.__msgtype__, typestore=store)
        log = writer.add_connection("/log", words.__msgtype__, typestore=store)
        for k in range(N):
            ns = 1_700_000_000_000_000_000 + k * 2_000_000
            head = header(stamp(ns // 10**9, ns % 10**9), "base")
            both = state(head, ["elbow", "wrist"], Q[k], np.zeros(2), np.array([]))
            late = ns + 300_000 + 200_000 * (k % 3)  # received later than measured, and with jitter
            writer.write(joints, late, store.serialize_cdr(both, state.__msgtype__))
            if k >= command_from and k % command_every == 0:
                writer.write(
                    commands,
                    ns - 1000,
                    store.serialize_cdr(array(layout([], 0), U[k : k + 1]), array.__msgtype__),
                )
        writer.write(
            log, 1_700_000_000_000_000_000, store.serialize_cdr(words("started"), words.__msgtype__)
        )
    return path
