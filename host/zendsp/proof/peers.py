"""What others' methods answer on the same cases: sparse regression of the torque residual.

Each peer gets the best that its kind can have. Positions are filtered without phase at 20 Hz and
differentiated. The hold's half sample and the stated delay are taken out of the command. Columns
and torque go through one more filter together, as in robot identification. The given model's free
parameters are projected out before the search (calibrate, then test). The library has the
contract's effects, without the measured command. Sizes are chosen on the held-out recording, and
"nothing" is one of the choices.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from zendsp.proof.answer import Answer, Finding
from zendsp.proof.draft import Array
from zendsp.proof.model_table import EffectTable, ModelTable
from zendsp.proof.rivals import bouc_wen, bristle, stack
from zendsp.proof.tables import Table, read_case

CUTOFF_HZ = 20.0
ROWS_HZ = 100.0
# a term must lower the held-out residual by this share, else it is taken for noise
WORTH = 0.02
TERMS = 6  # at most, of one answer
ORDERS = (1, 2, 3, 4, 6, 7, 8, 11, 12, 14, 18, 24)


@dataclass(frozen=True)
class Motion:
    """Filtered motion of all joints and torque, (rows, n)."""

    t: Array
    q: Array
    v: Array
    a: Array
    tau: Array
    tau_rate: Array


def motion(table: Table, model: ModelTable) -> Motion:
    """Zero-phase motion and torque at the full rate."""
    dt = float(model["sample_time"])
    sos = butter(4, CUTOFF_HZ, fs=1 / dt, output="sos")
    actuator = model.get("actuator", {})
    gain = np.atleast_1d(np.asarray(plain(actuator.get("gain", 1.0)), float))
    shift = 0.5 * float(actuator.get("hold", dt)) + float(actuator.get("delay", 0.0))
    q = sosfiltfilt(sos, table.position, axis=0)
    t = np.arange(len(q), dtype=np.float64) * dt
    # the command only at the end, with the columns: |torque| and its sign need it sharp
    tau = np.stack([np.interp(t - shift, t, column) for column in (table.command * gain).T], 1)
    v, rate = np.gradient(q, dt, axis=0), np.gradient(tau, dt, axis=0)
    a = np.gradient(v, dt, axis=0)
    return Motion(t, q, v, a, tau, rate)


def together(x: Array, t: Array) -> Array:
    """Columns through the parallel filter, then at 100 Hz without the ends."""
    dt = float(t[1] - t[0])
    sos = butter(2, CUTOFF_HZ, fs=1 / dt, output="sos")
    keep = slice(round(0.3 / dt), -round(0.3 / dt), max(1, round(1 / (ROWS_HZ * dt))))
    return np.asarray(sosfiltfilt(sos, x, axis=0)[keep]) if x.shape[1] else x[keep]


def plain(entry: Any) -> Any:
    """The value of a parameter, given as a number or a table."""
    return entry["value"] if isinstance(entry, dict) else entry


def _is_free(entry: Any) -> bool:
    return bool(entry.get("free", True)) if isinstance(entry, dict) else True


def mechanism_columns(model: ModelTable, m: Motion, joint: int) -> dict[str, Array]:
    """Torque per unit of each mechanism parameter on one joint."""
    kind = model["mechanism"]["kind"]
    if kind == "linear":
        return {"mass": m.a[:, 0]}
    if kind == "rotary":
        return {"inertia": m.a[:, 0], "gravity": np.sin(m.q[:, 0])}
    if kind != "planar2r":
        raise ValueError(f"the peers know rotary, linear and planar2r mechanisms, not {kind}")
    c, s = np.cos(m.q[:, 1]), np.sin(m.q[:, 1])
    (v1, v2), (a1, a2) = m.v.T, m.a.T
    if joint == 0:
        return {"p1": a1, "p2": a2, "p3": c * (2 * a1 + a2) - s * v2 * (2 * v1 + v2)}
    return {"p1": 0 * a1, "p2": a1 + a2, "p3": c * a1 + s * v1**2}


def effect_columns(entry: EffectTable, m: Motion, joint: int) -> tuple[Array, Array]:
    """(free columns, fixed torque) of one ``[[effect]]`` of the given model."""
    q, v = m.q[:, joint], m.v[:, joint]
    kind = entry["kind"]
    laws: dict[str, Callable[[], list[Array]]] = {
        "viscous": lambda: [v],
        "coulomb": lambda: [np.sign(v)],
        "quadratic_drag": lambda: [v * np.abs(v)],
        "torque_offset": lambda: [np.ones_like(v)],
        "stiffness": lambda: [q, np.ones_like(q)],
        "ripple": lambda: [f(plain(entry["order"]) * q) for f in (np.sin, np.cos)],
        "inertia": lambda: [m.a[:, joint]],
    }
    columns = np.stack(laws[kind](), 1)
    values = [e for k, e in entry.items() if k not in ("kind", "joint")]
    if all(_is_free(e) for e in values):
        return columns, np.zeros(len(v))
    return columns[:, :0], columns[:, 0] * float(plain(values[0]))


def split_model(model: ModelTable, m: Motion, joint: int) -> tuple[Array, Array]:
    """Columns of the free parameters and torque of the fixed ones on one joint."""
    entries = model["mechanism"].get("parameters", {})
    free, fixed = [], np.zeros(len(m.t))
    for name, column in mechanism_columns(model, m, joint).items():
        if _is_free(entries[name]):
            free.append(column)
        else:
            fixed = fixed + float(plain(entries[name])) * column
    for entry in model.get("effect", []):
        if entry["joint"] == joint + 1:
            columns, torque = effect_columns(entry, m, joint)
            free += list(columns.T)
            fixed = fixed + torque
    return (np.stack(free, 1) if free else np.zeros((len(m.t), 0))), fixed


def library(m: Motion, joint: int, reach: float, fast: float) -> list[tuple[str, Array]]:
    """(effect, column) of every effect that a regression can carry; sizes of shape parameters are
    typical ones.
    """
    q, v, a, tau, rate = (x[:, joint] for x in (m.q, m.v, m.a, m.tau, m.tau_rate))
    sign, one = np.sign(v), np.ones_like(q)
    out = [
        ("viscous", v),
        ("coulomb", sign),
        ("viscous_asymmetry", np.abs(v)),
        ("torque_offset", one),
        ("quadratic_drag", v * np.abs(v)),
        ("load_friction", np.abs(tau) * sign),
        ("stiffness", q),
        ("cubic_stiffness", q**3),
        ("gravity", np.sin(q)),
        ("gravity", np.cos(q)),
        ("inertia", a),
        ("delay", rate),
        ("dead_zone", np.sign(tau)),
        ("elasticity", np.gradient(np.gradient(a, m.t), m.t)),
        ("friction_drift", sign * (1 - np.exp(-m.t / (0.25 * m.t[-1])))),
        ("encoder_eccentricity", np.cos(q) * a - np.sin(q) * v**2),
        ("encoder_eccentricity", np.sin(q) * a + np.cos(q) * v**2),
    ]
    out += [("stribeck", sign * np.exp(-((v / (x * fast)) ** 2))) for x in (0.1, 0.2)]
    out += [("presliding", bristle(q, x * reach)) for x in (0.002, 0.01)]
    out += [("hysteresis", bouc_wen(q, x * reach)) for x in (0.03, 0.1)]
    scale = 1.0 if reach > 0.7 else 2 * np.pi / reach
    for n in ORDERS:
        out += [("ripple", np.sin(n * scale * q)), ("ripple", np.cos(n * scale * q))]
        out += [
            ("position_friction", sign * np.sin(n * scale * q)),
            ("position_friction", sign * np.cos(n * scale * q)),
        ]
    for other in range(m.q.shape[1]):
        if other != joint:
            ov, oa = m.v[:, other], m.a[:, other]
            out += [("coupling", x) for x in (oa, ov**2, ov, np.sign(ov + v))]
    return out


@dataclass(frozen=True)
class Problem:
    """Regression of one joint, the given model's free columns projected out; columns of unit RMS.
    """

    joint: int
    names: tuple[str, ...]
    x: Array
    y: Array
    x_test: Array
    y_test: Array


def without(basis: Array, x: Array) -> Array:
    """`x` less its least-squares part in `basis`."""
    if basis.shape[1] == 0:
        return x
    q, _ = np.linalg.qr(basis / (np.sqrt(np.mean(basis**2, 0)) + 1e-300))
    return np.asarray(x - q @ (q.T @ x))


def problems(folder: Path) -> list[Problem]:
    """One regression per joint of a case."""
    model, train, held = read_case(folder)
    a, b = motion(train[0], model), motion((held or train[1:] or train)[0], model)
    out = []
    for joint in range(a.q.shape[1]):
        reach, fast = float(np.ptp(a.q[:, joint])), float(np.sqrt(np.mean(a.v[:, joint] ** 2)))
        pairs = [(m, split_model(model, m, joint), library(m, joint, reach, fast)) for m in (a, b)]
        names = tuple(name for name, _ in pairs[0][2])
        sides: list[tuple[Array, Array]] = []
        raw = np.zeros(len(names))
        for m, (free, fixed), columns in pairs:
            slow = together(free, m.t)
            x = together(stack(*(c for _, c in columns)), m.t)
            y = together((m.tau[:, joint] - fixed)[:, None], m.t)
            sides.append((without(slow, x), without(slow, y)[:, 0]))
            raw = np.sqrt(np.mean(x**2, 0)) if m is a else raw
        size = np.sqrt(np.mean(sides[0][0] ** 2, 0))
        alive = size > 1e-3 * raw  # what the given model already spans is no candidate
        x, xt = sides[0][0][:, alive] / size[alive], sides[1][0][:, alive] / size[alive]
        names = tuple(n for n, ok in zip(names, alive, strict=True) if ok)
        out.append(Problem(joint, names, x, sides[0][1], xt, sides[1][1]))
    return out


Path_ = list[tuple[Array, list[int]]]  # growing models: (coefficients, order in which terms matter)


def stlsq(p: Problem) -> Path_:
    """PySINDy's sequentially thresholded least squares over a range of thresholds."""
    import pysindy

    size = float(np.sqrt(np.mean(p.y**2))) + 1e-300
    out: Path_ = []
    for threshold in np.geomspace(0.02, 1.0, 18):
        fit = pysindy.STLSQ(threshold=threshold, alpha=1e-4, max_iter=30)
        try:
            with warnings.catch_warnings():  # it warns of every threshold that leaves nothing
                warnings.simplefilter("ignore")
                fit.fit(p.x, p.y[:, None] / size)
        except (ValueError, np.linalg.LinAlgError):
            continue
        coef = np.asarray(fit.coef_, float).ravel() * size
        if np.any(coef):
            out.append((coef, [int(i) for i in np.argsort(-np.abs(coef))]))
    return out


def frols(p: Problem) -> Path_:
    """Forward regression by orthogonal least squares and error reduction ratio (Chen, Billings, Luo
    1989).
    """
    basis: list[Array] = []
    chosen: list[int] = []
    rest = p.x.copy()
    out: Path_ = []
    for _ in range(min(TERMS, p.x.shape[1])):
        energy = np.sum(rest**2, 0)
        ratio = np.where(energy > 1e-6 * len(p.y), (rest.T @ p.y) ** 2 / (energy + 1e-300), 0.0)
        ratio[chosen] = 0.0
        best = int(np.argmax(ratio))
        direction = rest[:, best] / np.sqrt(energy[best])
        basis.append(direction)
        chosen.append(best)
        rest = rest - np.outer(direction, direction @ rest)
        coef = np.zeros(p.x.shape[1])
        coef[chosen] = np.linalg.lstsq(p.x[:, chosen], p.y, rcond=None)[0]
        out.append((coef, list(chosen)))
    return out


METHODS: dict[str, Callable[[Problem], Path_]] = {"PySINDy STLSQ": stlsq, "FROLS": frols}


def choose(p: Problem, path: Path_) -> tuple[float, list[str]]:
    """Best model of a path on the held-out recording: (share of it explained, effects by weight);
    none is a choice.
    """
    base = float(np.mean(p.y_test**2)) + 1e-300
    best: tuple[float, list[str]] = (0.0, [])
    for coef, order in sorted(path, key=lambda entry: int(np.count_nonzero(entry[0]))):
        left = float(np.mean((p.y_test - p.x_test @ coef) ** 2)) / base
        if 1 - left > best[0] + WORTH:
            names = list(dict.fromkeys(p.names[i] for i in order if coef[i] != 0.0))
            best = (1 - left, names)
    return best


def ask_peer(method: str, folder: Path) -> Answer:
    """The answer of one peer to one case."""
    from threadpoolctl import threadpool_limits

    begin = time.perf_counter()
    try:
        # its matrices are small: threads would only wait for one another, ten times as long
        with threadpool_limits(1):
            solved = [(p, choose(p, METHODS[method](p))) for p in problems(folder)]
    except ValueError as error:
        return Answer("", trouble=str(error))
    seconds = time.perf_counter() - begin
    findings: list[Finding] = []
    for p, (share, names) in sorted(solved, key=lambda s: -s[1][0]):
        if share > 0:
            findings += [Finding(name, p.joint + 1) for name in names[:3]]
    return Answer("missing" if findings else "complete", tuple(findings), seconds=seconds)


def available() -> dict[str, str]:
    """Method -> "" or why it cannot run here."""
    out = {"FROLS": ""}
    try:
        import pysindy  # noqa: F401

        out["PySINDy STLSQ"] = ""
    except ImportError as error:
        out["PySINDy STLSQ"] = f"not installed ({error}); pip install 'zendsp[peers]'"
    return out


def sysidentpy_trouble() -> str:
    """Why SysIdentPy's own FROLS cannot be used with the NumPy that is installed; empty where it
    can.
    """
    try:
        from sysidentpy.basis_function import Polynomial
        from sysidentpy.model_structure_selection import FROLS

        rng = np.random.default_rng(0)
        x = rng.normal(size=(60, 2))
        FROLS(
            order_selection=True, n_info_values=2, ylag=1, xlag=[[1], [1]],
            basis_function=Polynomial(degree=1), model_type="NFIR", estimator="least_squares",
        ).fit(X=x, y=x[:, :1])
    except Exception as error:  # whatever it raises is the finding
        return f"{type(error).__name__}: {str(error).splitlines()[0]}"
    return ""
