"""Jittering clocks, missing or repeated rows and wrapped angles are accepted and reported."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import reality
from acceptance import accepted
from reality import FAST, KNOWN, RATE

from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.reading import read_signals
from zendsp.diagnosis.data.sampling import between_rows, resample_held
from zendsp.diagnosis.data.signals import Signals
from zendsp.errors import RecordingError
from zendsp.physics.files.model_file import load_model
from zendsp.physics.term_numbers import kernel_model

Columns = dict[str, np.ndarray]


def test_a_jittered_clock_is_resampled_and_the_report_says_so(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    r = np.random.default_rng(5)
    t = good["t"] + r.uniform(-0.2, 0.2, len(good["t"])) / FAST
    columns = {"t": t, **{k: np.interp(t, good["t"], good[k]) for k in ("q", "r")}, "u": good["u"]}
    notes = accepted(reality.save(tmp_path / "run.csv", columns), model)
    assert any("jitter" in n and "no row is missing" in n for n in notes), notes
    assert any("resampled" in n for n in notes), notes


def test_the_late_rows_of_a_loop_that_waits_unevenly_are_not_missing(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    """Each wait is a fifth longer or shorter: "7 rows missing (largest step 1.7 samples)"."""
    n = len(good["t"])
    waits = 1.0 + 0.2 * np.clip(np.random.default_rng(0).standard_normal(n), -3.0, 3.0)
    t = np.cumsum(waits) / FAST
    some = {k: np.interp(t, good["t"], good[k]) for k in ("q", "r", "u")}
    notes = accepted(reality.save(tmp_path / "run.csv", {"t": t, **some}), model)
    assert any("jitter" in n and "no row is missing" in n for n in notes), notes


def test_rows_missing_from_an_even_clock_are_not_called_jitter(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    columns = {name: np.delete(x, [700, 900, 901]) for name, x in good.items()}
    notes = accepted(reality.save(tmp_path / "run.csv", columns), model)
    said = [n for n in notes if "3 rows missing" in n]
    assert len(said) == 1 and "run.csv: 3 rows missing, all others evenly spaced" in said[0]


def test_jittering_time_stamps_of_evenly_sampled_rows_are_not_used(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    """Jitter of a tenth of a sample had looked like 2.5 % missing torque and seven missing rows."""
    r = np.random.default_rng(7)
    t = good["t"] + 0.1 * r.standard_normal(len(good["t"])) / FAST
    file = reality.save(tmp_path / "run.csv", {**good, "t": t})
    notes = accepted(file, model)
    assert any("no row is missing" in n for n in notes) and any("evenly spaced" in n for n in notes)
    read = read_signals(file, kernel_model(load_model(model)))
    assert np.allclose(read.position[:, 0], good["q"], rtol=0.0, atol=1e-9)


def test_a_missing_row_is_not_taken_for_a_late_time_stamp(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    r = np.random.default_rng(8)
    t = good["t"] + 0.1 * r.standard_normal(len(good["t"])) / FAST
    lacks = np.delete(np.arange(len(t)), [400, 900, 901])
    columns = {**good, "t": t}
    file = reality.save(tmp_path / "run.csv", {key: x[lacks] for key, x in columns.items()})
    assert any("and 3 rows missing" in n for n in accepted(file, model))


def test_resampling_a_jittered_clock_does_not_lower_the_stated_sensor_noise(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    r = np.random.default_rng(6)
    t = good["t"] + r.uniform(-0.25, 0.25, len(good["t"])) / FAST
    noise = 0.002  # rad
    q = np.interp(t, good["t"], good["q"]) + noise * r.standard_normal(len(t))
    file = reality.save(tmp_path / "run.csv", {**good, "t": t, "q": q})
    given = kernel_model(load_model(model))
    (record,) = prepare([read_signals(file, given)], given, 64.0).records[0]
    assert record.measurement.noise == pytest.approx(noise, rel=0.05)


@pytest.mark.parametrize("hertz", [0.3, 1.0, 2.5])  # 0.8 to 7 counts a row
@pytest.mark.parametrize("noise", [0.0, 0.3])  # counts
def test_resampling_a_jittered_clock_does_not_lower_the_stated_quantisation_noise(
    hertz: float, noise: float, tmp_path: Path
) -> None:
    """Interpolation between rounded positions hides that the count flickers."""
    step = 2 * np.pi / 1024
    model = reality.model_file(tmp_path / "m.toml", RATE, *KNOWN, resolution=step)
    rng = np.random.default_rng(2)
    time = (np.arange(16000) + 0.13 * rng.uniform(-1.7, 1.7, 16000)) / RATE

    def motion(t: np.ndarray) -> np.ndarray:
        return np.asarray(2.0 * np.sin(2 * np.pi * hertz * t))

    codes = np.round(motion(time) / step + noise * rng.standard_normal(16000))
    file = reality.save(tmp_path / "run.csv", {"t": time, "q": step * codes, "u": 0.0 * time})
    read = read_signals(file, kernel_model(load_model(model)))
    slow = (read.position[:15984, 0] - motion(read.time[:15984])).reshape(-1, 16).mean(axis=1)
    assert read.least_noise is not None
    stated = step**2 / 12 + float(read.least_noise[0]) ** 2
    assert 0.7 < stated / (16 * np.var(slow)) < 1.6


def test_a_missing_row_adds_no_noise_to_the_rows_that_are_there(tmp_path: Path) -> None:
    """Only values between two rows are rounded anew. With that noise in every row the unexplained
    torque of a whole recording of a lossy logger was below zero, its upper limit 0.
    """
    step = 2 * np.pi / 1024
    model = reality.model_file(tmp_path / "m.toml", RATE, *KNOWN, resolution=step)
    time = np.arange(8000) / RATE  # moves by up to 0.8 counts a row
    codes = np.round(2.0 * np.sin(0.6 * np.pi * time) / step)
    rows = np.delete(np.arange(8000), 3001)
    columns = {"t": time[rows], "q": step * codes[rows], "u": 0.0 * time[rows]}
    read = read_signals(
        reality.save(tmp_path / "run.csv", columns), kernel_model(load_model(model))
    )
    assert any("1 row missing" in n for n in read.notes)
    assert read.least_noise is not None
    # of one row of 8000 √(step² / 12 / 8000) = 0.003 of a step; of all that move it was 0.27
    assert float(read.least_noise[0]) < 0.01 * step


def test_a_held_command_is_not_late_after_a_jittered_clock_was_resampled() -> None:
    r = np.random.default_rng(1)
    steps = np.arange(4000) / RATE
    time = steps + r.uniform(-0.25, 0.25, len(steps)) / RATE
    fine = np.arange(0.0, 7.9, 0.02 / RATE)
    held = np.sin(2 * np.pi * time)[np.searchsorted(time, fine, side="right") - 1]
    grid = np.arange(time[0], time[-1], 1.0 / RATE)
    again = resample_held(grid, time, np.sin(2 * np.pi * time)[:, None])[:, 0]
    after = again[np.clip(np.searchsorted(grid, fine, side="right") - 1, 0, None)]
    slope = 2 * np.pi * np.cos(2 * np.pi * fine)
    late = float((held - after) @ slope / (slope @ slope))  # s, to first order
    assert abs(late) < 0.02 / RATE


def test_rows_that_repeat_the_row_before_are_left_out_and_reported(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    rows = np.sort(np.r_[np.arange(len(good["t"])), [100, 101, 900]])
    again = reality.save(tmp_path / "again.csv", {k: v[rows] for k, v in good.items()})
    given = kernel_model(load_model(model))
    signals = read_signals(again, given)
    assert len(signals.time) == len(good["t"])
    assert any("3 rows repeat the row before" in n for n in signals.notes)


def test_an_angle_that_wraps_at_a_full_turn_is_unwrapped_and_reported(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    given = kernel_model(load_model(model))
    true = read_signals(reality.save(tmp_path / "good.csv", good), given)
    turn = 2 * np.pi
    on = turn - 3 * reality.RESOLUTION - good["q"].max()  # rad, and so the sensor begins anew
    again = {**good, "q": (good["q"] + on + 0.5) % turn, "r": good["r"] + on + 0.5}
    wrapped = read_signals(reality.save(tmp_path / "wrapped.csv", again), given)
    assert np.ptp(again["q"]) > np.ptp(good["q"]) + 1.0
    moved = wrapped.position[:, 0] - true.position[:, 0]
    assert np.ptp(moved) < 1.01 * reality.RESOLUTION
    assert wrapped.reference is not None and true.reference is not None
    away = wrapped.reference[:, 0] - wrapped.position[:, 0]
    np.testing.assert_allclose(
        away, true.reference[:, 0] - true.position[:, 0], atol=1.01 * reality.RESOLUTION
    )
    assert any("begins anew at a full turn" in n for n in wrapped.notes), wrapped.notes


def test_a_position_that_was_not_read_anew_is_no_motion_and_said(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    given = kernel_model(load_model(model))
    true = read_signals(reality.save(tmp_path / "good.csv", good), given).position[:, 0]
    step = np.abs(np.diff(true))
    parts = np.array_split(np.arange(2, len(step) - 2), 5)
    *fast, k = (int(part[np.argmax(step[part])]) for part in parts)  # steps of many counts
    stale = {k: v.copy() for k, v in good.items()}
    slow = np.flatnonzero(np.abs(step / reality.RESOLUTION - 8) < 2)  # of few counts
    fast += [int(slow[len(slow) // 2]), fast[0] + 2]  # a slow one, and another soon after the first
    for row in fast:
        stale["q"][row + 1] = stale["q"][row]
    stale["q"][k + 1 : k + 3] = good["q"][k : k + 2]  # where the next one came as late
    fast += [k, k + 1]
    signals = read_signals(reality.save(tmp_path / "stale.csv", stale), given)
    assert any(f"{len(fast)} positions repeated in the midst" in n for n in signals.notes)
    assert np.abs(signals.position[:, 0] - true).max() < 0.2 * step[fast].min()


@pytest.mark.parametrize("steps", [2, 5, 10])
def test_slow_motion_feels_all_of_the_command_that_nobody_saw_between_rows(steps: int) -> None:
    """A row ends one line and begins the next, and so their errors add up. Taken for independent, a
    complete arm at 100 Hz of a loop at 500 Hz lacked 0.36 % of the torque of its wrist.
    """
    rows, together = 60_000, 60
    loop = np.random.default_rng(3).standard_normal((rows * steps, 1))
    zero = np.zeros((rows, 1))
    every = Signals(
        "run", np.arange(rows) * 0.01, 0.01, zero, loop[::steps], None, np.zeros(1)
    )  # fmt: skip
    read = between_rows(every, 0.01 / steps)
    missed = loop.reshape(rows, steps).mean(axis=1) - read.command[:, 0]
    slow = missed.reshape(-1, together).mean(axis=1) * np.sqrt(together)
    assert read.between is not None
    # the deviation of 1000 means is known to 2 %; sums of 60 rows still lack 0.4 % at their ends
    assert float(read.between[0]) == pytest.approx(float(np.std(slow)), rel=0.08)


def coarse(rate: float, quantum: float) -> tuple[np.ndarray, np.ndarray]:
    """The times of 4000 rows, and their stamps, written with few digits."""
    time = (np.arange(4000) + 0.3127) / rate
    return time, np.around(np.round(time / quantum) * quantum, 9)


def read_of(tmp_path: Path, at: np.ndarray, stamps: np.ndarray, said: float | None) -> Signals:
    """The signals of a joint that swings, read at times, by its stamps and a stated sample time."""
    text = reality.model_file(tmp_path / "m.toml", 400.0, *KNOWN).read_text().splitlines()
    clock = [] if said is None else [f"sample_time = {said}"]
    kept = [line for line in text if not line.startswith(("sample_time", "hold"))]
    (tmp_path / "m.toml").write_text("\n".join([*clock, *kept]))
    columns = {"t": stamps, "q": np.sin(6.0 * at), "u": np.cos(6.0 * at)}
    file = reality.save(tmp_path / "run.csv", columns)
    return read_signals(file, kernel_model(load_model(tmp_path / "m.toml")))


@pytest.mark.parametrize("said", ["right", "wrong", None])
@pytest.mark.parametrize(
    ("rate", "quantum"), [(400.0, 0.001), (800.0, 0.001), (300.0, 0.001), (80.0, 0.01)]
)
def test_rounded_stamps_of_an_even_clock_are_not_resampled(
    rate: float, quantum: float, said: str | None, tmp_path: Path
) -> None:
    """By the median step rows at 400 Hz were 3 ms apart, and a complete machine lacked 12 %."""
    time, stamps = coarse(rate, quantum)
    stated = {"right": 1.0 / rate, "wrong": 1.1 / rate}.get(said or "")
    read = read_of(tmp_path, time, stamps, stated)
    assert read.sample_time == pytest.approx(1.0 / rate, rel=2e-4)
    assert said != "right" or read.sample_time == 1.0 / rate
    np.testing.assert_allclose(read.position[:, 0], np.sin(6.0 * time), atol=1e-9)
    first, second = (note for note in read.notes if f"{read.name}: its " in note)
    assert f"even clock, {1.0 / rate:.3g}"[:-1] in first and "evenly spaced" in second
    assert ("the model says" in first) is (said == "wrong")


@pytest.mark.parametrize(("rate", "quantum"), [(400.0, 0.001), (800.0, 0.001)])
def test_a_missing_row_is_seen_beside_rounded_stamps(
    rate: float, quantum: float, tmp_path: Path
) -> None:
    time, stamps = (np.delete(x, [700, 900, 901]) for x in coarse(rate, quantum))
    read = read_of(tmp_path, time, stamps, None)
    assert any("3 rows missing, all others evenly spaced" in note for note in read.notes)
    assert read.sample_time == pytest.approx(1.0 / rate, rel=2e-4) and len(read.time) == 4000
    whole = np.sin(6.0 * coarse(rate, quantum)[0])
    away = np.abs(read.position[:, 0] - whole)
    assert np.count_nonzero(away > 1e-9) <= 3 and away.max() < 1e-3


def test_a_recording_of_another_rate_may_keep_the_hold_of_the_loop(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    """Without it, the command of every fourth row of a loop seemed to be late."""
    fewer = reality.save(tmp_path / "slow.csv", {name: x[::4] for name, x in good.items()})
    given = kernel_model(load_model(model))
    for hold, said in ((0.001, "Keep [actuator] hold = 0.001"), (None, "State [actuator] hold")):
        other = replace(given, actuator=replace(given.actuator, hold=hold))
        with pytest.raises(RecordingError) as refused:
            read_signals(fewer, other)
        assert f"leave sample_time out of the model file. {said} if one" in str(refused.value)


def test_rows_read_at_their_rounded_times_are_resampled(tmp_path: Path) -> None:
    """A loop of 1 kHz logged at 400 Hz reads after 2 and 3 ms in turn: the motion tells it."""
    _, stamps = coarse(400.0, 0.001)
    read = read_of(tmp_path, stamps, stamps, None)
    assert any("resampled uniformly" in note for note in read.notes)
    inner = slice(2, -2)
    np.testing.assert_allclose(
        read.position[inner, 0], np.sin(6.0 * read.time[inner]), rtol=0.0, atol=1e-4
    )


def test_rows_read_at_their_rounded_times_are_resampled_as_finely_as_most_stand(
    tmp_path: Path,
) -> None:
    """Of a KUKA at 250 Hz, read every 8 or 12 ms, rows of 10 ms hid the load."""
    _, stamps = coarse(300.0, 0.001)
    read = read_of(tmp_path, stamps, stamps, None)
    assert read.sample_time == pytest.approx(0.003)
