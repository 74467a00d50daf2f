"""Inertia, weight and friction of a shaft that turns freely, from the torque law of the pendulum's
paper, which spins it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from zendsp.experiment.estimates import NORMAL, half_width, smoothed
from zendsp.experiment.figures import BLUE, GREEN, RED, label, make_figure, save
from zendsp.experiment.lab import Lab
from zendsp.experiment.result import Estimate, FoundEffect, Result
from zendsp.physics import parse_model, simulate_loop
from zendsp.physics.calibration.covariance import robust_covariance
from zendsp.physics.model import Model
from zendsp.recording import Recording

Array = npt.NDArray[np.float64]

MACHINE = "pendulum"
PARAMETERS = ("theta1", "theta2", "theta3", "viscous")
UNITS = {"theta1": "kg m^2", "theta2": "kg m", "theta3": "N m", "viscous": "N m s/rad"}
G = 9.81
EARLY = 1.0  # s
SPINS, SMOOTHED = 3.0, 51  # rad/s, beyond which the shaft spins; samples that its speed is taken of
SENSED = 2  # samples after a command is computed, its current is measured
BLOCK = 0.1  # s
DRAWN = 60.0  # rad: a simulation that is further away has left the figure


def pendulum_model(theta: Array) -> Model:
    """theta1 qdd + theta2 g sin q + theta3 sign(qd) + viscous qd = tau, one sample late."""
    effects: list[dict[str, object]] = [{"kind": "coulomb", "joint": 1, "level": float(theta[2])}]
    if len(theta) > 3:
        effects.append({"kind": "viscous", "joint": 1, "coefficient": float(theta[3])})
    return parse_model(
        {
            "name": "pendulum",
            "sample_time": 0.001,
            "effect": effects,
            "actuator": {"delay": 0.001, "limit": 0.8},
            "mechanism": {
                "kind": "rotary",
                "parameters": {"inertia": float(theta[0]), "gravity": float(theta[1]) * G},
            },
        }
    )


def mechanical(lab: Lab, seconds: float = 6.0, brake: float = 0.08) -> Result:
    """theta1 … theta3 from the paper's open-loop torque, such that the simulated position matches
    the recorded one.
    """
    result = Result("mechanical", "Inertia, gravity and friction of the pendulum", MACHINE)
    with lab.bench(result.name, result, brake=brake) as bench:
        another: dict[str, Any] = {"level": 0.34, "a1": 0.08, "a2": -0.1, "w1": 19.0, "w2": 7.0}
        recs = [
            bench.record(
                name,
                "pendulum_torque.c",
                ["q", "tau", "adc"],
                seconds=seconds,
                go=1,
                duration=seconds,
                **law,
            )
            for name, law in (("law", {}), ("another_law", another))
        ]
        result.recordings, result.target = bench.recordings, bench.where
        train, test = (delivered(rec) for rec in recs)
        from_rest = fit_parameters(train, np.full(4, 1e-3))
        turning, speed = spinning(train)
        extended = fit_parameters(turning, from_rest[0], speed)
        # what the bristles take of them is their error
        off = np.hypot(from_rest[1], from_rest[0] - extended[0])
        paper = fit_parameters(_first(train, EARLY), extended[0][:3])
        for theta, std, names, tail in (
            (*paper[:2], PARAMETERS[:3], "_paper"),
            (from_rest[0], off, PARAMETERS, "_from_rest"),
            (*extended[:2], PARAMETERS, ""),
        ):
            for name, value, s in zip(names, theta, std, strict=True):
                result.values[f"{name}{tail}"] = Estimate(float(value), float(s), UNITS[name])
        for rec, where in ((train, "fitted"), (test, "held_out")):
            for word, theta, part, begin in (
                ("paper", paper[0], _first(rec, EARLY), 0.0),
                ("viscous", extended[0], *spinning(rec)),
            ):
                begin = begun(theta, part, begin)
                miss = float(np.sqrt(np.mean((simulated(theta, part, begin) - part["q"]) ** 2)))
                result.values[f"rms_{where}_{word}"] = Estimate(miss, 0.0, "rad")
        _say(result, seconds - float(turning.t[-1]))
        figure = _mechanical_figure(train, test, paper[0], extended[0])
        result.figure = save(figure, bench.folder / "mechanical.png")
    return result


def _say(result: Result, spins: float) -> None:
    """Add to the result what its numbers are good for and what not; ``spins``: time from which the
    pendulum spins, s.
    """
    result.warnings.append(
        "The paper's model has no viscous friction, and this machine has: under its torque the"
        " shaft spins, and three parameters can match the position for about the first second"
        f" only ({EARLY:g} s are fitted, from the four-parameter result). With the viscous term"
        f" the position is matched from {spins:.1f} s on, where the shaft"
        " no longer rocks: before, it turns back within the bristles of friction. The law has none;"
        " they would bend every number by 3 to 5 %."
    )
    t = result.values
    result.mechanism = {
        "inertia": t["theta1"],
        "gravity": Estimate(t["theta2"].value * G, t["theta2"].std * G, "N m"),
    }
    result.effects = [
        FoundEffect("coulomb", 1, {"level": t["theta3"]}),
        FoundEffect("viscous", 1, {"coefficient": t["viscous"]}),
    ]


def _mechanical_figure(train: Recording, test: Recording, paper: Array, extended: Array) -> Figure:
    """Draw both recordings and the prediction of both models."""
    figure, axes = make_figure(2, 2, height=2.6, sharex=True)
    for column, (rec, words) in enumerate(
        ((train, "the paper's torque: fitted"), (test, "another torque: held out"))
    ):
        top, bottom = axes[0, column], axes[1, column]
        top.plot(rec.t, rec["q"], color=BLUE, linewidth=2.0, label="machine")
        three = simulated(paper, rec)
        turning, speed = spinning(rec)
        speed = begun(extended, turning, speed)
        t, four = rec.t[-len(turning) :], simulated(extended, turning, speed)
        top.plot(
            rec.t,
            np.where(np.abs(three - rec["q"]) < DRAWN, three, np.nan),
            "--",
            color=RED,
            linewidth=1.0,
            label="three parameters, as the paper",
        )
        top.plot(t, four, "--", color=GREEN, linewidth=1.0, label="and viscous friction")
        bottom.plot(rec.t, rec["q"] - three, color=RED, linewidth=1.0)
        bottom.plot(t, turning["q"] - four, color=GREEN, linewidth=1.0)
        bottom.set_ylim(-1.5, 1.5)
        label(top, "", "position (rad)", words, legend=column == 0)
        label(bottom, "t (s)", "machine - model (rad)")
    return figure


def delivered(rec: Recording) -> Recording:
    """The position, and the torque that the drive delivers. Its current loop lags behind the
    command and the back-EMF, which would otherwise be taken for inertia.

    i = (tau - lag d tau/dt - J qdd) / k_a + offset, fitted by least squares to the current sensor,
    whose steps and noise thus do not enter the torque. The sensor is read at the end of a sample.
    During the sample the back-EMF reduces the current, i = (v - k_b qd) / R_a, so its mean is that
    of half a sample before.
    """
    qd = smoothed(rec["q"], SMOOTHED, rec.sample_time, 1)
    qdd = smoothed(rec["q"], SMOOTHED, rec.sample_time, 2, degree=3)
    rate = np.gradient(rec["tau"], rec.sample_time)
    A = np.stack([rec["tau"], rate, qdd, np.ones(len(rec))], axis=1)
    current, voltage = rec["adc"].T
    x = np.linalg.lstsq(A[:-SENSED], current[SENSED:], rcond=None)[0]
    ohm = np.stack([qd, voltage, np.ones(len(rec))], axis=1)
    x[2] -= 0.5 * rec.sample_time * np.linalg.lstsq(ohm, current, rcond=None)[0][0]
    columns = {"q": rec["q"], "tau": A[:, :3] @ x[:3] / x[0]}
    return Recording.from_columns(columns, sample_time=rec.sample_time)


def _first(rec: Recording, seconds: float) -> Recording:
    rows = round(seconds / rec.sample_time)
    return Recording.from_columns(
        {"q": rec["q"][:rows], "tau": rec["tau"][:rows]}, sample_time=rec.sample_time
    )


def spinning(rec: Recording) -> tuple[Recording, float]:
    """The rows of a recording after the shaft's last reversal, and its speed there, rad/s; where it
    never spins, all rows, from rest.
    """
    speed = smoothed(rec["q"], SMOOTHED, rec.sample_time, 1)
    rocking = np.flatnonzero(np.abs(speed) < SPINS)
    first = int(rocking[-1]) + 1 if len(rocking) else 0
    if not len(rocking) or (len(rec) - first) * rec.sample_time < EARLY:
        return rec, 0.0
    columns = {"q": rec["q"][first:], "tau": rec["tau"][first:]}
    return Recording.from_columns(columns, sample_time=rec.sample_time), float(speed[first])


def simulated(theta: Array, rec: Recording, speed: float = 0.0) -> Array:
    """The position under the recorded torque, from the first row and that speed on, rad."""
    out = np.full(len(rec), 1e3)
    q = simulate_loop(
        pendulum_model(theta),
        command=rec["tau"],
        controller={},
        position=rec["q"][0],
        velocity=speed,
        inner=2,
    )["plant_q"]
    out[: len(q)] = q
    return out


def begun(theta: Array, rec: Recording, speed: float) -> float:
    """The speed at the first row with which the position matches best, near a measured one."""
    from scipy import optimize

    if not speed:
        return 0.0

    def miss(v: Array) -> Array:
        return np.clip(simulated(theta, rec, float(v[0])) - rec["q"], -50.0, 50.0)

    found = optimize.least_squares(miss, [speed], loss="soft_l1", f_scale=0.5, diff_step=[1e-4])
    return float(found.x[0])


def fit_parameters(rec: Recording, start: Array, speed: float = 0.0) -> tuple[Array, Array, float]:
    """Parameters, standard deviations and rms error, by least squares on the position. A ``speed``
    at the first row is fitted too.

    From a start value far off, the whole recording would mislead the fit; so it begins with the
    first half second and lengthens it.
    """
    from scipy import optimize

    count = len(start)
    x = np.append(np.log(start), [speed] if speed else [])

    for part in (500, 1000, 2000, len(rec)):
        short = _first(rec, min(part, len(rec)) * rec.sample_time)

        def miss(x: Array, piece: Recording = short) -> Array:
            begin = float(x[count]) if speed else 0.0
            return np.clip(simulated(np.exp(x[:count]), piece, begin) - piece["q"], -50.0, 50.0)

        found = optimize.least_squares(
            miss,
            x,
            x_scale=np.append(np.full(count, 0.3), [3.0] if speed else []),
            loss="soft_l1",
            f_scale=0.5,
            diff_step=np.full(len(x), 1e-4),
            bounds=(
                np.append(np.full(count, np.log(1e-6)), [-np.inf] if speed else []),
                np.append(np.full(count, np.log(10.0)), [np.inf] if speed else []),
            ),
        )
        x = found.x
    r = miss(x, rec)
    # the residual is a smooth curve: it is independent between pieces, not between samples
    block = round(BLOCK / rec.sample_time)
    free = max(1, len(rec) // block - len(x))
    covariance = robust_covariance(np.asarray(found.jac), r, block)
    std = half_width(np.sqrt(np.diag(covariance)), free) / NORMAL
    theta = np.exp(x[:count])
    return theta, theta * std[:count], float(np.sqrt(np.mean(r**2)))
