"""Torque constant and resistance of every motor that takes a voltage and tells its current."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from zendsp.errors import RecordingError, Unmeasured
from zendsp.experiment.estimates import NORMAL, bump_means, least_squares, widest
from zendsp.experiment.figures import BLUE, RED, label, make_figure, save
from zendsp.experiment.knowing import refuse_none
from zendsp.experiment.lab import Bench, Lab, own_program
from zendsp.experiment.needs import inputs_of
from zendsp.experiment.result import Estimate, Result
from zendsp.experiment.watch import left_out
from zendsp.recording import Recording
from zendsp_protocol.messages import JointInfo
from zendsp_protocol.views import with_std

Array = npt.NDArray[np.float64]

MACHINE = "pendulum"
VOLTS = (7.0, 8.5, 10.0, 12.0, 14.0, 16.0, -7.0, -9.0, -11.0, -13.0, -15.0)  # of the paper
FREE = 12.0  # rad: a joint with a wider range is let turn
SHARE = 0.4  # of the range, in its middle, that the voltage is turned back in
CHANNELS = ("q", "adc", "command", "sign")
FIRST, LARGEST = 0.02, 0.8  # of the largest command: the first one tried, and the last
MORE = 1.5  # one command over the one before
SPEED = 0.4  # of the largest speed
MOVED = 50.0  # counts of the encoder in a record: it turns
SECONDS, FLIP = 3.0, 1.5  # s, of a record; of one direction
SETTLED = 0.3  # of each direction, until the current's transient is over
SHORTEST = 80  # samples of a direction
PIECE = 41  # samples, at least, of a mean
FULL_SCALE = 10000.0  # mV, of an analog output
GIVES = 0.2  # of its range: by so much a held joint is displaced at the largest command
FEWEST = 3  # commands at which it turned


def electrical(lab: Lab) -> Result:
    """Torque constant and resistance of each motor: v = R i + k qd.

    The pendulum's shaft turns at the paper's voltages. Any other joint is driven there and back
    in the middle of its range, at voltages that grow until it is as fast as it may be.
    """
    name = lab.machine_of("electrical")
    if lab.shipped("electrical") == MACHINE:
        return of_the_pendulum(lab)
    result = Result("electrical", "Motors of the machine", name)
    runs: dict[int, Runs] = {}
    with lab.bench(result.name, result) as bench:
        for k, own in enumerate([j for j in bench.machine.joints if j.command != "none"]):
            joint = bench.machine.joints.index(own) + 1
            sensors = tuple(inputs_of(bench.machine, unit)[k] for unit in ("A", "V"))
            with left_out(result, bench.target, joint):
                runs[joint] = _driven(bench, joint, own, sensors)
                _report(result, joint, own.unit, runs[joint])
        refuse_none(result, runs)
        result.recordings, result.target = bench.recordings, bench.where
        result.figure = save(_draw(runs, result, bench), bench.folder / "electrical.png")
    return result


@dataclass(frozen=True)
class Runs:
    """Means over pieces of runs of one sign of the voltage: which run, current, speed, voltage; and
    the steps of both sensors, A and V.
    """

    run: npt.NDArray[np.int64]
    current: Array
    speed: Array
    voltage: Array
    steps: tuple[float, float]


def _driven(bench: Bench, joint: int, own: JointInfo, sensors: tuple[int, ...]) -> Runs:
    """Drive a joint at growing voltages, while neither its speed nor the way that it overshoots
    where the voltage turns would be more than it may at the next one.
    """
    values = _settings(bench, joint, own)
    free, most = "aside" not in values, values["largest"]
    rec = bench.record(
        f"joint{joint}_held", own_program("volts.c"), CHANNELS, seconds=1.0, **values
    )
    values["weight"] = 0.0 if free else float(rec["command"][len(rec) // 2 :].mean())
    pieces: list[tuple[float, ...]] = []
    seen: list[Array] = []
    level, turned = FIRST * most, 0
    while level + abs(values["weight"]) <= LARGEST * most:
        rec = bench.record(
            f"joint{joint}_{level / most:.3f}", own_program("volts.c"), CHANNELS,
            seconds=SECONDS, **values, level=level,
        )
        q = np.atleast_2d(rec["q"].T).T[:, joint - 1]
        seen.append(rec["adc"][:, sensors])
        if np.ptp(q) * abs(own.counts_per_unit) > MOVED:
            found = run_pieces(rec, joint, sensors)
            pieces += [(turned * 1000 + run, *row) for run, *row in found]
            turned += bool(found)
            pace = max((abs(row[2]) for row in found), default=0.0)
            over = 0.0 if free else max(q.max() - values["upper"], values["lower"] - q.min())
            if MORE * pace > SPEED * own.speed_max or MORE**2 * over > values.get("aside", np.inf):
                break
        level *= MORE
    if turned < FEWEST:
        raise Unmeasured(
            f"{own.name}: turns at {turned} of the voltages that it may be driven at within its"
            f" range and speed; {FEWEST} are needed"
        )
    run, current, speed, voltage = np.array(pieces).T
    steps = [sensor_step(x) for x in np.concatenate(seen).T]
    return Runs(run.astype(np.int64), current, speed, voltage, (steps[0], steps[1]))


def _settings(bench: Bench, joint: int, own: JointInfo) -> dict[str, Any]:
    """Parameters of the program: where the voltage turns, and how stiffly joints are held that
    would fall otherwise.
    """
    values: dict[str, Any] = {"joint": joint, "flip": FLIP}
    values["largest"] = min(own.command_max, FULL_SCALE)
    values["stiff"] = [
        0.0 if j.position_max - j.position_min > FREE
        else min(j.command_max, FULL_SCALE) / (GIVES * (j.position_max - j.position_min))
        for j in bench.machine.joints
    ]
    low, high = own.position_min, own.position_max
    if high - low <= FREE:
        way = SHARE * (high - low)
        middle = 0.5 * (low + high)
        values["lower"], values["upper"] = middle - way / 2, middle + way / 2
        values["aside"] = 0.25 * (high - low - way)
    return values


def run_pieces(
    rec: Recording, joint: int, sensors: tuple[int, ...]
) -> list[tuple[int, float, float, float]]:
    """For each run of one sign of the command: its number, and means of current, speed and voltage
    over pieces of it, without its beginning.
    """
    q, adc = np.atleast_2d(rec["q"].T).T[:, joint - 1], np.atleast_2d(rec["adc"].T).T
    edges = np.flatnonzero(np.diff(rec["sign"])) + 1
    out = []
    for number, (a, b) in enumerate(zip([0, *edges], [*edges, len(q)], strict=True)):
        a += round(SETTLED * (b - a))
        for part in np.array_split(np.arange(a, b), max(1, (b - a) // SHORTEST)):
            if len(part) < PIECE:
                continue
            (i, _, _), (v, _, _) = (bump_means(adc[part, s], rec.sample_time) for s in sensors)
            out.append((number, i, bump_means(q[part], rec.sample_time)[1], v))
    return out


def sensor_step(x: Array) -> float:
    """Resolution of a sensor: the largest step of which all its readings differ by multiples, to a
    thousandth; 0 where they are continuous, or always the same.
    """
    gaps = np.diff(np.unique(x))
    step = float(gaps.min(initial=np.inf))
    while np.isfinite(step) and step > 0.0:
        rest = gaps % step
        rest = np.minimum(rest, step - rest)
        rest = rest[rest > 1e-3 * step]
        if not len(rest):
            return step
        step = float(rest.min())
    return 0.0


def _report(result: Result, joint: int, unit: str, runs: Runs) -> None:
    A = np.stack([runs.current, runs.speed], axis=1)
    x, _, inverse = least_squares(A, runs.voltage)
    groups = len(np.unique(runs.run))
    half = widest(A, runs.voltage - A @ x, inverse, np.eye(2), [(runs.run, groups - 2)])
    # a steady current or voltage lies anywhere within a step of its sensor, alike in all of a run
    unseen = float(np.hypot(runs.steps[1], x[0] * runs.steps[0])) / 12**0.5
    sums = np.stack([A[runs.run == k].sum(axis=0) for k in np.unique(runs.run)])
    half = np.hypot(half, NORMAL * unseen * np.sqrt(np.sum((sums @ inverse) ** 2, axis=0)))
    force = "N m/A" if unit == "rad" else "N/A"
    result.values[f"k_a{joint}"] = Estimate(float(x[1]), float(half[1]) / NORMAL, force)
    result.values[f"R_a{joint}"] = Estimate(float(x[0]), float(half[0]) / NORMAL, "ohm")
    result.tables.setdefault("motors", []).append(
        {
            "joint": joint,
            "k_a": with_std(float(x[1]), float(half[1]), force),
            "R_a": with_std(float(x[0]), float(half[0]), "ohm"),
            f"fastest {unit}/s": round(float(np.abs(runs.speed).max()), 4),
            "largest V": round(float(np.abs(runs.voltage).max()), 3),
        }
    )


def _draw(runs: dict[int, Runs], result: Result, bench: Bench) -> Figure:
    """For each motor what is left of the voltage beside resistance, over speed."""
    figure, axes = make_figure(len(runs), 1, width=6.0, height=2.8)
    for axis, (joint, found) in zip(axes.flat, runs.items(), strict=True):
        k, R = (result.values[f"{name}{joint}"] for name in ("k_a", "R_a"))
        axis.plot(found.speed, found.voltage - R.value * found.current, ".", color=BLUE)
        ends = np.array([found.speed.min(), found.speed.max()])
        axis.plot(ends, k.value * ends, color=RED, linewidth=1.0)
        unit = bench.machine.joints[joint - 1].unit
        label(axis, f"speed ({unit}/s)", "voltage - R i (V)", f"joint {joint}: {k}, {R}")
    return figure


def of_the_pendulum(lab: Lab, volts: tuple[float, ...] = VOLTS) -> Result:
    """k_a and R_a: at steady speed v/i over qd/i is a straight line of slope k_a and intercept R_a.
    """
    result = Result("electrical", "Motor of the pendulum", MACHINE)
    points = []
    with lab.bench(result.name, result, drive="voltage", brake=0.0) as bench:
        for v in volts:
            rec = bench.record(
                f"{v:+.1f}V",
                "pendulum_current.c",
                ["q", "adc"],
                seconds=4.0,
                voltage_mode=True,
                volts=v,
            )
            points.append(steady_means(rec))
        result.recordings, result.target = bench.recordings, bench.where
        speed, current, voltage = np.array(points).T
        # the same line times the current: measured errors then weigh alike at all voltages
        (intercept, slope), half, _ = least_squares(np.stack([current, speed], axis=1), voltage)
        result.values["k_a"] = Estimate(float(slope), float(half[1] / NORMAL), "N m/A")
        result.values["R_a"] = Estimate(float(intercept), float(half[0] / NORMAL), "ohm")
        result.tables["points"] = [
            {
                "voltage V": round(float(v), 2),
                "current A": round(float(i), 4),
                "speed rad/s": round(float(w), 3),
            }
            for w, i, v in points
        ]
        result.warnings.append(
            "The bar stays on the shaft (the paper takes the load off): its weight makes the"
            " current swing over many steps of the 10-bit sensor, and means over whole turns are"
            " used."
        )
        figure, axes = make_figure(1, 1, width=6.0, height=3.6)
        x = speed / current
        axes[0, 0].plot(x, voltage / current, "o", color=BLUE, markersize=5, label="measured")
        ends = np.array([0.0, x.max() * 1.05])
        axes[0, 0].plot(
            ends,
            intercept + slope * ends,
            color=RED,
            linewidth=1.0,
            label=f"k_a = {slope:.4f} N m/A, R_a = {intercept:.2f} ohm",
        )
        label(axes[0, 0], "speed / current (rad/(s A))", "voltage / current (ohm)", legend=True)
        result.figure = save(figure, bench.folder / "electrical.png")
    return result


def steady_means(rec: Recording) -> tuple[float, float, float]:
    """Mean speed, measured current and voltage over the last whole turns of a recording.

    Raises
    ------
    RecordingError
        It does not make a turn in its second half.
    """
    q, half = rec["q"], len(rec) // 2
    turns = int(abs(q[-1] - q[half]) / (2 * np.pi))
    if turns == 0:
        raise RecordingError(
            "the shaft does not turn at this voltage: raise it, or loosen the brake"
        )
    start = len(q) - 1 - int(np.argmax(np.abs(q[::-1] - q[-1]) >= 2 * np.pi * turns))
    rows = slice(start, len(q) - 1)
    seconds = (len(q) - 1 - start) * rec.sample_time
    return (
        float((q[-1] - q[start]) / seconds),
        float(rec["adc"][rows, 0].mean()),
        float(rec["adc"][rows, 1].mean()),
    )
