"""Frequency responses: the estimator on known systems, and on a real target."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from waiting import PATIENCE_S

import zendsp
from zendsp.errors import AcquisitionError, RecordingError, Refused
from zendsp.experiment.frequency import (
    choose_lines,
    distortion,
    estimate,
    make_period,
    usual_amplitude,
)
from zendsp.experiment.response import FrequencyResponse
from zendsp.link import Target, local
from zendsp_protocol.messages import JointInfo, Limits, MachineInfo

RATE = 1000.0


def test_the_estimator_finds_a_known_filter_with_its_uncertainty() -> None:
    rng = np.random.default_rng(3)
    samples, periods, noise = 2000, 8, 0.02
    lines = choose_lines(samples, 60.0, 25, RATE)
    t = np.arange(samples * (periods + 1)) / RATE
    u = make_period(lines, 1.0, 0, RATE / samples, t)
    pole = np.exp(-2 * np.pi * 8.0 / RATE)
    y = np.zeros_like(u)
    for k in range(1, len(u)):
        y[k] = pole * y[k - 1] + (1.0 - pole) * u[k - 1]
    y += rng.normal(0.0, noise, len(y))
    gain, std, coherence = estimate(u[samples:], y[samples:], periods, lines)
    z = np.exp(2j * np.pi * lines / samples)
    off = np.abs(gain - (1.0 - pole) / (z - pole)) / std
    assert np.mean(off < 1.5) > 0.7 and off.max() < 6.0, "its standard deviation is what it is off"
    assert (coherence > 0.8).all() and coherence[0] > 0.99


def test_in_a_closed_loop_noise_does_not_bend_the_response() -> None:
    """The ratio of cross spectra would tend to −1/controller where the noise is large."""
    rng = np.random.default_rng(5)
    samples, periods, plant, control = 1000, 40, 0.3, 2.0
    lines = choose_lines(samples, 40.0, 10, RATE)
    r = make_period(lines, 1.0, 0, 1.0, np.arange(samples * periods) / RATE)
    v = rng.normal(0.0, 0.5, len(r))
    y = np.zeros_like(r)
    u = np.zeros_like(r)
    for k in range(1, len(r)):
        u[k] = control * (r[k] - y[k - 1])
        y[k] = 0.5 * y[k - 1] + plant * u[k] + v[k]
    gain, std, _ = estimate(u, y, periods, lines)
    z = np.exp(2j * np.pi * lines / samples)
    assert (np.abs(gain - plant / (1.0 - 0.5 / z)) < 5.0 * std).all()


def test_the_uncertainty_of_a_nonlinear_machine_is_how_far_other_phases_move_the_response() -> None:
    """A motor held by a spring, with dry friction: without noise every period is the same."""
    rng = np.random.default_rng(7)
    samples, periods = 1000, 2
    lines = choose_lines(samples, 30.0, 20, RATE)
    turns = 2 * np.pi * np.outer(np.arange(samples * (periods + 1)) / samples, lines)

    def measured(friction: float) -> tuple[list[complex], list[float]]:
        u = 5.0 / len(lines) ** 0.5 * np.cos(turns + rng.uniform(0, 2 * np.pi, len(lines))).sum(1)
        q, qd, y = 0.0, 0.0, np.zeros_like(u)
        for k in range(1, len(u)):
            force = u[k - 1] - 800.0 * q - 20.0 * qd - friction * np.tanh(qd / 1e-3)
            qd += force / RATE
            q += qd / RATE
            y[k] = q
        u, y = u[samples:], y[samples:]
        gain, _, _ = estimate(u, y, periods, lines)
        return gain, distortion(u, y, periods, lines, gain)

    gains, told = (np.array(x) for x in zip(*(measured(2.0) for _ in range(12)), strict=True))
    apart = np.std(gains, axis=0)
    ratio = np.sqrt((told**2).mean(axis=0)) / apart
    assert 0.6 < np.median(ratio) < 1.6 and ratio.min() > 0.3 and ratio.max() < 3.5
    gain, none = measured(0.0)
    assert (none < 0.01 * np.abs(gain)).all(), "what is left of the first period"


def test_the_lines_of_a_band_are_even_in_log_f_and_a_band_that_cannot_be_is_refused() -> None:
    lines = choose_lines(2000, 60.0, 25, RATE)
    assert lines[0] == 1 and lines[-1] == 60 and len(set(lines)) == len(lines) <= 25
    assert lines[:4].tolist() == [1, 2, 4, 5], "distortion shows at the third"
    assert choose_lines(2000, 3.0, 9, RATE).tolist() == [1, 2, 3], "the band's end is measured"
    with pytest.raises(AcquisitionError, match="at most 400 Hz"):
        choose_lines(1000, 450.0, 30, RATE)
    with pytest.raises(AcquisitionError, match="f_min below f_max"):
        choose_lines(1000, 0.5, 30, RATE)


@pytest.mark.parametrize(
    ("unit", "counts", "travel", "speed", "torque", "peaks"),
    [
        ("rad", 651.9, 2000.0, 100.0, 0.8, (0.15, 0.04)),  # pendulum: 13 counts are 0.02 rad
        ("rad", 24446.0, 4.3, 6.28, 245.0, (0.02, 12.0)),  # imi_planar
        ("rad", 24446.0, 4.3, 1.0, 245.0, (0.007, 12.0)),  # slower than 28 times 0.02 rad a second
        ("m", 1e5, 0.01, 1.0, 60.0, (0.001, 3.0)),  # a short slide
    ],
)
def test_the_usual_peak_shows_over_the_encoder_and_stays_far_below_the_limits(
    unit: str, counts: float, travel: float, speed: float, torque: float,
    peaks: tuple[float, float],
) -> None:  # fmt: skip
    machine = MachineInfo("m", joints=(JointInfo("1", unit=unit, counts_per_unit=counts),))
    limits = Limits((-travel / 2,), (travel / 2,), (speed,), (torque,), (1e4,))
    found = usual_amplitude(machine, limits, 1), usual_amplitude(machine, limits, 1, "torque")
    assert tuple(peak for peak, _ in found) == peaks
    assert tuple(u for _, u in found) == (("rad", "N m") if unit == "rad" else ("m", "N"))
    lines = choose_lines(2000, 60.0, 30, 1e3)  # the default band, 0.5 to 30 Hz
    period = make_period(lines, peaks[0], 1, 0.5, np.arange(2000) * 1e-3)
    assert np.abs(np.gradient(period, 1e-3)).max() < 0.25 * speed


def test_where_no_torque_limit_is_known_the_peak_is_asked_for() -> None:
    machine, inf = MachineInfo("m", joints=(JointInfo("1"),)), (float("inf"),)
    limits = Limits((-float("inf"),), inf, inf, inf, inf)
    with pytest.raises(AcquisitionError, match="give amplitude"):
        usual_amplitude(machine, limits, 1, "torque")
    with pytest.raises(Refused, match="has 1"):
        usual_amplitude(machine, limits, 2)


@pytest.fixture(scope="module")
def fast() -> Iterator[Target]:
    with local("imi_planar", clock="fast", options=["--ideal", "--speed", "100"]) as target:
        yield target


def test_the_closed_loop_is_one_at_low_and_falls_at_high_frequencies(
    fast: Target, tmp_path: Path
) -> None:
    fast.download("pd.c")
    found = zendsp.frequency_response(
        fast, f_min=1.0, f_max=60.0, lines=20, amplitude=0.04, periods=3
    )
    assert (found.input, found.output, found.unit) == ("r1", "q[0]", "")
    assert abs(found.magnitude_db[0]) < 0.5 and abs(found.phase_deg[0]) < 10.0
    assert 5.0 < found.bandwidth() < 60.0 and found.phase_deg[-1] < -45.0
    assert (found.coherence > 0.99).all()
    # the machine itself, by two ways: closed loop T and controller C say what it must be
    machine = zendsp.frequency_response(
        fast, f_min=1.0, f_max=60.0, lines=20, amplitude=0.04, periods=3, input="tau[0]"
    )
    again = zendsp.frequency_response(
        fast, f_min=1.0, f_max=60.0, lines=20, amplitude=0.04, periods=3, input="r1",
        output="tau1",
    )  # fmt: skip
    assert np.allclose(machine.gain, found.gain / again.gain, rtol=0.02), "G = (q/r) / (tau/r)"
    assert machine.unit == "rad / (N m)" and machine.phase_deg[3] < -150.0, "two integrators"
    assert found.save(tmp_path / "b.csv").read_text().startswith("f,magnitude_db,phase_deg")
    bars = found.plot().axes[0].containers[0].lines[2][0].get_segments()
    half = [0.5 * float(bar[1, 1] - bar[0, 1]) for bar in bars]
    assert half == pytest.approx([row["std_db"] for row in found.rows()]), "those of the table"
    assert found.plot(tmp_path / "b.png") and (tmp_path / "b.png").stat().st_size > 5000
    page = found._repr_html_()
    assert "−3 dB at" in repr(found) and f"Hz, from the value at {found.f[0]:.3g} Hz" in repr(found)
    assert "<svg" in page
    assert all(f">{row['std_db']:.2g}<" in page for row in found.rows())  # no digits of chance
    with pytest.raises(RecordingError, match=r"\.csv"):
        found.save(tmp_path / "b.txt")


def test_a_second_amplitude_follows_the_first_also_where_the_program_is_paused(
    fast: Target,
) -> None:
    fast.download("joint_pd.c")
    for amplitude in (0.02, 0.01):  # the first leaves the program paused before its table's end
        found = zendsp.frequency_response(
            fast, f_min=2.0, f_max=20.0, lines=6, amplitude=amplitude, periods=2
        )
        assert len(found.f) > 3 and fast.status().state == "paused"


def test_where_friction_bends_the_response_the_interval_holds_how_neighbours_scatter(
    fast: Target,
) -> None:
    fast.download("pd.c")
    found = zendsp.frequency_response(fast, f_min=1.0, f_max=30.0, amplitude=0.02, periods=3)
    std = np.array([row["std_db"] for row in found.rows()])
    line = found.magnitude_db[1:-1] - np.interp(
        np.log(found.f[1:-1]), np.log(found.f[::2]), found.magnitude_db[::2]
    )
    apart = np.abs(line[::2])  # every second line from between its neighbours
    assert apart.max() > 0.5, "a linear loop has no such steps"
    assert (apart < 3.0 * std[1:-1:2]).mean() > 0.8
    assert "not linear" in found.summary() and "measure with two" in found.summary()


@pytest.mark.parametrize("amplitude", [0.0, -0.01, float("nan"), float("inf")])
def test_a_frequency_response_of_a_joint_that_does_not_move_is_refused(
    amplitude: float, fast: Target
) -> None:
    fast.download("pd.c")
    with pytest.raises(AcquisitionError, match="expected more than 0 rad"):
        zendsp.frequency_response(fast, amplitude=amplitude)


def test_a_program_without_tables_is_refused_with_what_to_do(fast: Target) -> None:
    fast.download({"p.c": '#include "isr.h"\nvoid UserInit(void){}\nvoid UserISR_INT2(void){}\n'
                          "void UserBackground(void){}\n"})  # fmt: skip
    with pytest.raises((AcquisitionError, Refused), match=r"no signal|plays tables"):
        zendsp.frequency_response(fast)
    fast.download("pd.c")
    with pytest.raises(Refused, match="ref_tau"):
        zendsp.frequency_response(fast, quantity="torque", input="tau[0]")
    with pytest.raises(Refused, match="joint 3: the machine has 2"):
        zendsp.frequency_response(fast, joint=3, input="r1", output="q1")


def test_a_torque_beside_a_held_position_shows_the_machine(fast: Target) -> None:
    fast.download("joint_pd.c")
    found = zendsp.frequency_response(
        fast, joint=2, quantity="torque", amplitude=5.0, f_min=2.0, f_max=40.0, lines=10, periods=3
    )
    assert (found.input, found.output) == ("tau[1]", "q[1]")
    slope = np.polyfit(np.log10(found.f[-3:]), found.magnitude_db[-3:], 1)[0]
    # friction holds the joint at low frequencies; the other joint, softly held, moves with it
    assert -50.0 < slope < -35.0, "above, an inertia: 40 dB a decade"


def test_while_the_loop_keeps_real_time_the_program_goes_on() -> None:
    with local("imi_planar", options=["--ideal"]) as target:
        target.download("pd.c")
        target.start()
        found = zendsp.frequency_response(
            target, f_min=4.0, f_max=40.0, lines=8, periods=2, amplitude=0.004, rehearsed=False
        )
        assert target.status().state == "running" and found.coherence[0] > 0.95
        assert target["use_table"] is False, "the circle, as before"
        led = target.acquire(["r1"], 0.3)["r1"]
        assert 0.0 < np.abs(np.diff(led)).max() < 1e-3, "it is led there: nothing jumps"
        assert abs(found.magnitude_db[0]) < 6.0, "friction takes its part of so small a motion"


def test_an_interrupted_frequency_response_holds_the_machine_where_it_is() -> None:
    def interrupt(share: float) -> None:
        if share > 0.3:
            raise KeyboardInterrupt

    told: list[float] = []

    def at_once(share: float) -> None:
        told.append(share)
        if len(told) % 2 == 0:  # the first only says that all is checked
            raise KeyboardInterrupt

    with local("imi_planar", options=["--ideal"]) as target:
        target.download("pd.c")
        target.start()
        with pytest.raises(KeyboardInterrupt):
            zendsp.frequency_response(target, f_min=1.0, lines=4, periods=9, progress=at_once)
        assert target["use_table"] is False, "while it was tried on the twin, nothing has moved"
        # at once: before the tables have switched over
        for running, end in ((True, at_once), (True, interrupt), (False, interrupt)):
            if not running:
                target.pause()
            with pytest.raises(KeyboardInterrupt):
                zendsp.frequency_response(
                    target, f_min=1.0, lines=4, periods=9, amplitude=0.02, rehearsed=False,
                    progress=end,
                )  # fmt: skip
            assert target.status().state == "paused", "its circle would go on"
            assert target["use_table"] is False
            target.start()
            assert np.ptp(target.acquire(["r1"], 0.5)["r1"]) > 0.0, "the circle, as before"


def test_a_trip_during_a_frequency_response_is_reported(fast: Target) -> None:
    fast.download("pd.c")
    try:
        with pytest.raises(Refused, match=r"exceeds the limit.*take less amplitude"):
            zendsp.frequency_response(fast, f_min=2.0, lines=20, periods=2, amplitude=0.3)
    finally:
        fast.acknowledge()


def test_a_stop_during_a_frequency_response_is_called_a_stop(fast: Target) -> None:
    fast.download("pd.c")
    swings = threading.Event()

    def stop() -> None:
        assert swings.wait(PATIENCE_S)
        fast.stop()

    stopper = threading.Thread(target=stop)
    stopper.start()
    try:
        with pytest.raises(Refused, match=r"^STOP was requested .* acknowledged$"):
            zendsp.frequency_response(
                fast, f_min=0.01, f_max=1.0, lines=5, periods=9, progress=lambda _: swings.set()
            )
    finally:
        stopper.join()
        fast.acknowledge()


def test_a_frequency_response_is_stored_in_its_recording(fast: Target, tmp_path: Path) -> None:
    fast.download("pd.c")
    found = zendsp.frequency_response(
        fast, f_min=2.0, f_max=20.0, lines=5, periods=2, channels=["q", "tau"]
    )
    assert found.recording.columns == ("q[0]", "q[1]", "tau[0]", "tau[1]", "r1")
    again = FrequencyResponse.of(zendsp.Recording.load(found.recording.save(tmp_path / "r.mat")))
    assert again is not None and again.rows() == found.rows()
    assert again.summary() == found.summary() and again.unit == found.unit
    assert (again.distortion == found.distortion).all() and found.distortion.all()
    kept = {**found.recording.extra["frequency_response"], "unit": "1"}
    del kept["distortion"]
    old = FrequencyResponse.of(replace(found.recording, extra={"frequency_response": kept}))
    assert old is not None and old.unit == "" and not old.distortion.any(), "of an older zendsp"
    assert FrequencyResponse.of(fast.acquire(["q"], 0.1, start=True)) is None
