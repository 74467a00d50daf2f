"""Torque constant and resistance of motors."""

from __future__ import annotations

import numpy as np

from zendsp.errors import RecordingError
from zendsp.experiment.estimates import NORMAL, least_squares
from zendsp.experiment.figures import BLUE, RED, label, make_figure, save
from zendsp.experiment.lab import Lab
from zendsp.experiment.result import Estimate, Result
from zendsp.recording import Recording

MACHINE = "pendulum"


def electrical(
    lab: Lab,
    volts: tuple[float, ...] = (7.0, 8.5, 10.0, 12.0, 14.0, 16.0, -7.0, -9.0, -11.0, -13.0, -15.0),
) -> Result:
    """k_a and R_a: at steady speed v/i over qd/i is a straight line of slope k_a and intercept R_a.
    """
    result = Result("electrical", "Motor of the pendulum", MACHINE)
    points = []
    with lab.bench(result.name, drive="voltage", brake=0.0) as bench:
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
