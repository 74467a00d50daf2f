"""Shows a reference on the scope: its curves, its path in the plane, and its peaks against the
limits.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.reference import Machine, Reference, forward_kinematics
from zendsp.tui.scope import Channel, History, Scope
from zendsp.tui.scope.path import Axes, Curve

Floats = npt.NDArray[np.float64]
Columns = dict[str, tuple[str, str, Floats]]  # of a quantity: name, unit, and values of each joint


def columns_of(machine: Machine | None, reference: Reference, tau: Floats | None) -> Columns:
    """What a reference can be shown as: its motion; the torque ``tau`` where it is known, and the
    motor's current where the machine's torque constant is.
    """
    u = reference.unit
    columns = {
        "position": ("q", u, reference.q),
        "velocity": ("qd", f"{u}/s", reference.qd),
        "acceleration": ("qdd", f"{u}/s²", reference.qdd),
    }
    if tau is not None:
        columns["torque"] = ("tau", _effort(u), tau)
        current = machine.current(tau) if machine is not None else None
        if current is not None:
            columns["current"] = ("i", "A", current)
    return columns


def views_of(columns: Columns, tall: bool = True) -> list[str]:
    """The views of a reference: all quantities at once for one or two joints where there is room,
    else one quantity each; and the path.
    """
    joints = columns["position"][2].shape[1]
    every = ["all"] if joints <= 2 and tall else []
    return [*every, *columns, "path"]


def _effort(unit: str) -> str:
    return {"rad": "N m", "m": "N"}.get(unit, "N m or N")


def curves_of(scope: Scope, columns: Columns, reference: Reference, view: str) -> None:
    """Put a reference, as these columns, on a scope that is not live."""
    chosen = columns if view == "all" else {view: columns[view]}
    channels, shown = [], []
    for name, unit, values in chosen.values():
        for joint in range(reference.joints):
            channels.append(Channel(f"{name}{joint + 1}", unit))
            shown.append(values[:, joint])
    data = np.stack(shown, axis=1)
    history = History(data.shape[1], rows=len(data) + 1)
    history.append(np.arange(len(data)), data, reference.sample_time)
    scope.settings = replace(
        scope.settings, mode="roll", window=max(reference.duration, 1e-3) * 1.0001, selected=0
    )
    scope.show_channels(channels, history)


def limits_of(machine: Machine) -> dict[str, list[float]]:
    """The limits of a machine by unit, to be drawn on the scope."""
    lim = machine.limits

    def known(*values: Floats) -> list[float]:
        return sorted({float(v) for v in np.concatenate(values) if np.isfinite(v)})

    u, most = machine.unit, machine.current(lim.torque)
    return {
        u: known(lim.position_min, lim.position_max),
        f"{u}/s": known(lim.speed, -lim.speed),
        f"{u}/s²": known(lim.acceleration, -lim.acceleration),
        _effort(u): known(lim.torque, -lim.torque),
        "A": [] if most is None else known(most, -most),
    }


MANY = 5  # joints, from which on a narrow screen has no room for a number of each


def peaks_of(
    machine: Machine, reference: Reference, tau: Floats | None, brief: bool = False
) -> list[list[tuple[float, str]]]:
    """The peaks of the joints for each quantity, as (share of the limit, words), – where it is not
    known.

    For positions the share is that of the way from the middle of the range to its end. With
    ``brief`` the values are left out, and of many joints only the one nearest to its limit is
    named.
    """
    lim = machine.limits
    low, high = lim.position_min, lim.position_max
    half = 0.5 * (high - low)
    lines = []
    for name, (_, unit, values) in columns_of(machine, reference, tau).items():
        if reference.jumps and name in ("velocity", "acceleration"):
            continue
        limit = {
            "position": half, "velocity": lim.speed, "acceleration": lim.acceleration,
            "torque": lim.torque, "current": machine.current(lim.torque),
        }[name]
        assert limit is not None  # a current is shown where its limit is known, too
        parts: list[tuple[float, str]] = [(0.0, f"{name:<13}")]
        for joint in range(min(reference.joints, len(limit))):
            peak = float(np.abs(values[:, joint]).max())
            known = bool(np.isfinite(limit[joint]) and limit[joint] > 0)
            most = peak
            if name == "position" and known:
                most = float(np.abs(values[:, joint] - (low[joint] + half[joint])).max())
            share = most / limit[joint] if known else 0.0
            words = f"{100 * share:4.0f} %" if known else "   – %"
            if reference.joints <= 2 and not brief:
                words = f"{peak:9.4g} {unit:<7}{words}   "
            parts.append((share, words))
        if brief and len(parts) - 1 >= MANY:
            joint = max(range(1, len(parts)), key=lambda k: parts[k][0])
            share, words = parts[joint]
            parts = [parts[0], (share, f"{words} at most, joint {joint}")]
        lines.append(parts)
    return lines


def path_of(machine: Machine, reference: Reference) -> tuple[list[Curve], Axes]:
    """The path of the tip, else the phase plane, as curves with their axes."""
    if machine.kind == "planar2r":
        l1, l2 = float(machine.parameters["l1"]), float(machine.parameters["l2"])
        angle = np.linspace(0.0, 2.0 * np.pi, 181)
        circle = np.stack((np.cos(angle), np.sin(angle)), axis=1)
        tip = forward_kinematics(machine, reference.q)[:: max(reference.samples // 2000, 1)]
        q = reference.q[0]
        arm = np.array([[0.0, 0.0], [l1 * np.cos(q[0]), l1 * np.sin(q[0])], tip[0]])
        curves = [
            Curve("reach", (l1 + l2) * circle, -1),
            Curve("arm at start", arm, 7),
            Curve("path of the tip", tip, 1),
        ]
        return curves, Axes()
    if machine.kind == "dh":
        return _spatial_path(machine, reference)
    step = max(reference.samples // 2000, 1)
    curves = [
        Curve(
            f"joint {j + 1}", np.stack((reference.q[::step, j], reference.qd[::step, j]), axis=1), j
        )
        for j in range(min(reference.joints, 8))
    ]
    return curves, Axes((f"q [{reference.unit}]", f"qd [{reference.unit}/s]"), equal=False)


def joint_positions(machine: Machine, q: Floats) -> Floats:
    """The positions of the frames of a serial arm (standard Denavit–Hartenberg), the base first.

    Parameters
    ----------
    machine : Machine
        Of kind "dh".
    q : ndarray, shape (N, joints)
        rad.

    Returns
    -------
    ndarray, shape (N, joints + 1, 3)
        m; the last one is the tip.
    """
    n = len(q)
    frame = np.broadcast_to(np.eye(4), (n, 4, 4))
    places = [np.zeros((n, 3))]
    for k, link in enumerate(machine.parameters["link"]):
        c, s = np.cos(q[:, k]), np.sin(q[:, k])
        ca, sa = np.cos(np.deg2rad(link["alpha_deg"])), np.sin(np.deg2rad(link["alpha_deg"]))
        a, d = float(link["a"]), float(link["d"])
        zero, one = np.zeros(n), np.ones(n)
        rows = [
            [c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s],
            [zero, sa * one, ca * one, d * one], [zero, zero, zero, one],
        ]
        frame = frame @ np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
        places.append(frame[:, :3, 3])
    return np.stack(places, axis=1)


def _spatial_path(machine: Machine, reference: Reference) -> tuple[list[Curve], Axes]:
    """The path of the tip, seen along the axis in which it moves least."""
    places = joint_positions(machine, np.asarray(reference.q)[:: max(reference.samples // 2000, 1)])
    tip = places[:, -1]
    extent = tip.max(axis=0) - tip.min(axis=0)
    extent[2] += 1e-9  # seen from the side where it makes no difference
    across, up = sorted(np.argsort(extent)[1:])
    curves = [
        Curve("arm at start", places[0][:, [across, up]], 7),
        Curve("path of the tip", tip[:, [across, up]], 1),
    ]
    return curves, Axes((f"{'xyz'[across]} [m]", f"{'xyz'[up]} [m]"))
