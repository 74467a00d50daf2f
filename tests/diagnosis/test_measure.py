"""The missing torque of a model, measured: where it acts, whether it repeats, and the evidence of
untouched recordings.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from reality import FAST, RATE
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.data.prepare import one_sensor, prepare
from zendsp.diagnosis.data.signals import Parts, Signals
from zendsp.diagnosis.decide import clocks, nothing_named
from zendsp.diagnosis.decide.assemble import (
    with_slower_observer,
)
from zendsp.diagnosis.decide.clocks import apart_in_time
from zendsp.diagnosis.decide.thresholds import BY_CHANCE, LAWFUL, OF_STATE, SURE
from zendsp.diagnosis.measure import acting, evidence
from zendsp.diagnosis.measure import bursts as measure_bursts
from zendsp.diagnosis.measure import discrepancy as measure_discrepancy
from zendsp.diagnosis.measure.bursts import bursts, periodic
from zendsp.diagnosis.measure.discrepancy import BANDS, at_reversals, deviation, discrepancy
from zendsp.diagnosis.measure.evidence import compare
from zendsp.diagnosis.measure.likelihood import Scored, calibrate_joint, fit_scored
from zendsp.diagnosis.measure.structure import MEMORY, STRUCTURED, Structure, structure
from zendsp.diagnosis.measure.where import mismatch
from zendsp.physics.calibration.fit import Data, fit, joint_handles
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.model import Model


def test_a_figure_shows_the_torque_that_lacks_in_full_beside_a_models_damping() -> None:
    """The model's damping had taken a ninth of it, so that the figure showed less than its
    sentence.
    """
    reference = reality.multisine(6.0, RATE, 3, size=1.2)
    columns = reality.simulate(reality.Machine(viscous=0.05), reference, RATE)
    model = model_of({**VISCOUS, "coefficient": 0.05})
    (lacks,) = mismatch(data_of(columns, model), model, 1)
    speed = lacks.variables["velocity"]
    fast = np.abs(speed) > np.quantile(np.abs(speed), 0.5)
    assert np.median(lacks.torque[fast] * np.sign(speed[fast])) == pytest.approx(0.03, rel=0.03)


def test_a_term_that_only_the_fit_wants_does_not_pass_an_untouched_recording() -> None:
    model = model_of(VISCOUS, COULOMB)
    data = data_of(
        reality.simulate(reality.Machine(), reality.multisine(6.0, RATE, 5), RATE), model
    )
    other = data_of(
        reality.simulate(reality.Machine(), reality.multisine(6.0, RATE, 6), RATE, 6), model
    )
    right = calibrate_joint(data, model, 1)
    without = model_of(VISCOUS)
    worse = fit_scored(right.data, without, joint_handles(data, without, 1), (1,))
    seen = compare(worse, right, other, 1)
    assert seen.gain > 100.0 and seen.z > 4.0
    spoiled = Scored(right.fit, right.data, right.deviance, (1,))
    spoiled = replace(
        spoiled, fit=replace(right.fit, model=model_of(VISCOUS, {**COULOMB, "level": 0.05}))
    )
    assert compare(right, spoiled, other, 1).gain < -100.0


def test_neighbouring_blocks_that_resemble_each_other_count_for_less() -> None:
    alone = np.random.default_rng(1).standard_normal(4000)
    in_fives = np.repeat(alone[:800], 5)
    assert deviation(alone) == pytest.approx(np.sqrt(4000), rel=0.1)
    assert deviation(in_fives) > 1.8 * np.sqrt(4000)  # that of 800 sums of five: 2.2 times


def test_what_acts_in_few_blocks_is_evidence_though_nothing_moves_in_most(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The recording mostly rests. One block in which the observer lost track does not decide."""
    starts = np.r_[np.full(12, 40.0), np.full(88, 1e-7)]
    lost = np.r_[4000.0, np.full(99, 1e-7)]
    for blocks, least, most in ((starts, 100.0, 1000.0), (lost, 0.0, 20.0)):
        scores = iter((blocks, np.zeros(100)))
        monkeypatch.setattr(evidence, "settling", lambda *_: 0.1)
        monkeypatch.setattr(evidence, "block_scores", lambda *_, of=scores: next(of))
        assert least < compare(None, None, None, 1).gain < most  # type: ignore[arg-type]


def test_periodic_torques_and_torques_with_memory_are_told_from_random_ones() -> None:
    reference = reality.multisine(10.0, RATE, 3)
    model = model_of(VISCOUS, COULOMB)
    quiet = reality.simulate(reality.Machine(), reference, RATE)
    restless = reality.simulate(reality.Machine(unrest=0.004), reference, RATE)
    rms = float(np.sqrt(np.mean(quiet["u"] ** 2)))
    swung, v, rate = np.zeros(len(reference)), 0.0, np.gradient(np.gradient(quiet["q"]))
    for k in range(1, len(reference)):  # a mass on a spring of 1.7 Hz, carried along
        v += rate[k] * RATE - (2 * np.pi * 1.7) ** 2 * swung[k - 1] / RATE - 1.5 * v / RATE
        swung[k] = swung[k - 1] + v / RATE
    with_sine = {**quiet, "u": quiet["u"] + 0.03 * rms * np.sin(2 * np.pi * 3.7 * quiet["t"])}
    with_swing = {**quiet, "u": quiet["u"] + 0.04 * rms * swung / np.std(swung)}

    def seen(columns: dict[str, np.ndarray]) -> tuple[float, float]:
        half = len(reference) // 2
        parts = [
            data_of({key: x[a : a + half] for key, x in columns.items()}, model) for a in (0, half)
        ]
        memory = structure(parts, model, 1, [MEMORY])
        return periodic(parts[1], model, 1), memory.size if memory.z > 3 else 0.0

    assert max(*seen(quiet), *seen(restless)) < LAWFUL
    assert seen(with_sine)[0] == pytest.approx(0.03 / np.sqrt(2), rel=0.2)
    assert seen(with_swing)[1] > 0.02


def test_a_torque_that_acts_seldom_is_told_from_chance() -> None:
    """It acts at four times within a minute, so that only four of many blocks gain."""
    reference = reality.multisine(40.0, RATE, 3)
    model = model_of(VISCOUS, COULOMB)
    quiet = reality.simulate(reality.Machine(), reference, RATE)
    restless = reality.simulate(reality.Machine(unrest=0.01), reference, RATE)
    rms, half = float(np.sqrt(np.mean(quiet["u"] ** 2))), len(reference) // 2
    place = min(quiet["q"][:half].max(), quiet["q"][half:].max())
    bump = np.exp(-(((quiet["q"] - place) / (0.03 * np.ptp(quiet["q"]))) ** 2))

    def seen(columns: dict[str, np.ndarray]) -> Structure:
        parts = [
            data_of({key: x[a : a + half] for key, x in columns.items()}, model) for a in (0, half)
        ]
        return structure(parts, model, 1, STRUCTURED)

    v = np.gradient(quiet["q"]) * RATE
    wave = v / np.std(v) * np.cos(20.0 * np.pi * quiet["q"] / np.ptp(quiet["q"]))
    fine = seen({**quiet, "u": quiet["u"] + 0.02 * rms * wave})
    assert fine.size > OF_STATE and fine.apart > BY_CHANCE, "damping with ten waves over the travel"
    seldom, never = seen({**quiet, "u": quiet["u"] + 0.05 * rms * bump}), seen(restless)
    assert seldom.size > OF_STATE and seldom.z < SURE and seldom.apart > BY_CHANCE
    assert never.size < OF_STATE or never.apart < BY_CHANCE


def test_a_constant_torque_is_not_said_to_act_at_reversals() -> None:
    """Not even in a slow motion, which spends most of its time near reversals."""
    t = 2 * np.pi * np.arange(6000) / RATE
    columns = reality.simulate(reality.Machine(), 0.2 * np.sin(0.3 * t), RATE)
    plain = model_of(VISCOUS, COULOMB)
    constant = model_of(VISCOUS, COULOMB, {"kind": "torque_offset", "joint": 1, "level": 0.002})
    bristles = model_of(VISCOUS, COULOMB, {"kind": "presliding", "joint": 1, "stiffness": 3.0})
    data = data_of(columns, plain)
    assert abs(at_reversals(data, plain, constant, 1)) < 0.2
    assert at_reversals(data, plain, bristles, 1) > 0.9


def test_torque_before_the_begin_of_a_recording_bends_no_number() -> None:
    lag, steps = 0.045, 10
    h = 1.0 / RATE / steps
    command = 0.1 * np.cos(np.cumsum(2 * np.pi * np.linspace(0.1, 0.7, 4000)) / RATE)
    q, v, acts, seen = 0.0, 0.0, 0.0, []
    for u in command:  # a drive that stood still before the first, largest, command
        seen.append(q)
        for _ in range(steps):
            acts += h * (u - acts) / lag
            v += h * (acts - 0.004 * v) / 0.01
            q += h * v
    model = model_of(VISCOUS, {"kind": "lag", "joint": 1, "time_constant": 0.02})
    columns = {"t": np.arange(len(seen)) / RATE, "q": np.array(seen), "u": command}
    data = data_of(columns, model)
    found = fit(data, model, joint_handles(data, model, 1), joints=(1,), iterations=20).model
    assert found.at(1)[-1].value("time_constant") == pytest.approx(lag, rel=0.02)


def test_a_recording_whose_rows_are_shifted_is_told_from_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reference = reality.multisine(8.0, RATE, 3)
    model = model_of(VISCOUS, COULOMB)

    def read(name: str, late: int, viscous: float = 0.004, ripple: float = 0.0) -> Data:
        machine = reality.Machine(late=late, viscous=viscous, ripple=ripple)
        data = data_of(reality.simulate(machine, reference, RATE), model)
        record = replace(data.records[0][0], recording=name)
        return replace(data, records=((record,),))

    same, other = read("a.csv", 0), read("c.csv", 0, viscous=0.005)
    assert apart_in_time(Parts(same, read("b.csv", 0, viscous=0.003), other), model) == []
    ((_, said),) = apart_in_time(Parts(same, read("b.csv", 2), other), model)
    assert said.startswith("joint 1: in b.csv the command column stands")
    assert "ms later against the position than in a.csv, c.csv" in said
    assert said.endswith("in all recordings alike, and diagnose again")
    same_again = Parts(same, read("b.csv", 2), other)
    assert apart_in_time(same_again, model, {(1, "b.csv")}) == []
    # of rows of other lengths the command may have been held for less than a row
    assert "state its sample time as [actuator] hold" in clocks._remedy({0.001, 0.004}, model)
    # most of what lacks in it is something else
    besides = Parts(same, read("b.csv", 2, ripple=0.05), other)
    assert apart_in_time(besides, model) == []
    monkeypatch.setattr(clocks, "_explains", lambda *_: True)
    assert apart_in_time(besides, model) != []
    # a slope tells of no shift that a search would not look for: "3e+02 ms earlier" was told
    assert apart_in_time(Parts(same, read("b.csv", 20), other), model) == []


def test_the_largest_missing_torque_is_no_less_where_the_stated_sensor_noise_is_larger(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the stated noise is too large, the fastest observer sees nothing at all."""
    made = reality.simulate(reality.Machine(ripple=0.004), reality.multisine(6.0, RATE, 3), RATE)
    data = data_of(made, model := model_of(VISCOUS, COULOMB))
    honest = discrepancy(data, model, 1)
    noise = measure_discrepancy.noise

    def noisier(record: JointRecord, model: Model, band: float, *, even: bool) -> float:
        return noise(record, model, band, even=even) + 9.0 * (band == BANDS[0])

    monkeypatch.setattr(measure_discrepancy, "noise", noisier)
    found = discrepancy(data, model, 1)
    assert found.value < found.high and honest.value < found.high


@pytest.mark.parametrize("rows", [30, 60])
def test_a_recording_shorter_than_an_observers_memory_proves_nothing(rows: int) -> None:
    columns = reality.simulate(reality.Machine(), reality.multisine(1.0, RATE, 3), RATE)
    model = model_of(VISCOUS, COULOMB)
    data = data_of({key: x[:rows] for key, x in columns.items()}, model)
    assert discrepancy(data, model, 1).low == 0.0
    assert structure([data, data], model, 1, ["position_torque"]).z < 3.0


def test_a_torque_at_most_reversals_is_friction_and_no_disturbance() -> None:
    t = 2 * np.pi * np.arange(12000) / FAST
    reference = 0.8 * np.sin(0.4 * t) + 0.4 * np.sin(0.271 * t)
    model = model_of(VISCOUS, COULOMB, rate=FAST)
    quiet = reality.simulate(reality.Machine(), reference, FAST)
    v = np.gradient(quiet["q"]) * FAST
    turns = np.flatnonzero(np.diff(np.sign(np.convolve(v, np.ones(15) / 15, "same"))))

    def found(
        at: np.ndarray, dry: float = 0.03, often: float = 0.3, after: int = 20, size: float = 0.02
    ) -> bool:
        torque = np.zeros(len(v))
        for k in at:
            torque[max(0, k - 20) : k + after] = size
        data = data_of({**quiet, "u": quiet["u"] + torque}, model, FAST)
        return bursts(data, model, 1, data, many=99, dry=dry, often=often) is not None

    some = turns[[len(turns) // 3, len(turns) // 2]]
    assert found(some), "a push happens to come when it turns"
    assert not found(some, often=0.0), "where no other recording shows one"
    assert found(some, often=0.0, size=0.2), "no friction of 0.03 N m holds with 0.2"
    assert found(some, often=0.0, after=600), "it lasts while the joint moves on"
    many = turns[np.random.default_rng(1).random(len(turns)) < 0.45]
    assert found(many, dry=0.0)
    assert not found(many)


@pytest.mark.parametrize(
    ("share", "part", "scattered"),
    [
        (0.9, 0.05, False),
        (0.5, 0.05, True),  # 4 times what is outside
        (0.53, 0.008, False),  # 12 times
    ],
)
def test_a_push_that_stands_far_out_may_hold_less_of_what_lacks(
    share: float, part: float, scattered: bool
) -> None:
    assert measure_bursts._scattered(share, part) is scattered


@pytest.mark.parametrize(("within", "pushed"), [(0.9, False), (0.1, True)])
def test_a_torque_that_acts_while_the_joint_covers_most_of_its_way_is_no_push(
    within: float, pushed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of recordings of one joint after the other the time of each joint was "a push"."""
    push = reality.Machine(push=(0.1, 2.0, 3.0))
    columns = reality.simulate(push, reality.multisine(9.0, RATE, 3), RATE)
    model = model_of(VISCOUS, COULOMB)
    data = data_of(columns, model)
    assert 0.05 < measure_bursts._of_the_way(acting_of(data, model), 1) < 0.3
    monkeypatch.setattr(measure_bursts, "_of_the_way", lambda *_: within)
    assert (bursts(data, model, 1, data) is not None) is pushed


def acting_of(data: Data, model: Model) -> list[Any]:
    """Where the missing torque of joint 1 is large."""
    lacks = acting.lacks_of(data, model, 1)
    return [acting.acting_of(lacks, 1, acting.quiet_energy([lacks]))]


def test_spikes_once_a_count_of_a_slow_joint_are_no_ringing() -> None:
    def by_count(samples_a_count: int, torque: np.ndarray) -> float:
        columns = reality.simulate(reality.Machine(), reality.multisine(2.0, RATE, 3), RATE)
        columns["q"] = np.floor(np.arange(len(columns["q"])) / samples_a_count) * 0.01
        record = data_of(columns, model_of(VISCOUS)).records[0][0]
        return float(np.sum(acting._by_count(torque[: record.n], record, 24) ** 2))

    spikes = np.zeros(600)
    spikes[::8] = 0.4
    steady = 500 * 0.05**2  # the joint's 500 samples
    assert by_count(8, spikes) == pytest.approx(steady, rel=0.05)
    assert by_count(1, spikes) == pytest.approx(8 * steady, rel=0.05)
    ringing = 0.05 * np.sin(np.arange(600))
    assert by_count(1, ringing) == pytest.approx(steady / 2, rel=0.05)


@pytest.mark.parametrize(
    ("breakaway", "times", "pushed"),
    [
        (0.04, (2.0, 3.0, 5.0, 6.0), True),
        (0.2, (2.0, 3.0, 5.0, 6.0), False),
        (0.2, (2.0, 3.0), True),  # it would stick more than once
    ],
)
def test_no_pushes_are_claimed_below_the_torque_of_a_sticking_stribeck_friction(
    breakaway: float, times: tuple[float, ...], pushed: bool
) -> None:
    machine = reality.Machine(push=(0.1, *times))
    columns = reality.simulate(machine, reality.multisine(9.0, RATE, 3), RATE)
    falling = {"kind": "stribeck", "joint": 1, "breakaway": breakaway, "velocity": 0.002}
    model = model_of(VISCOUS, COULOMB, falling)
    data = data_of(columns, model)
    assert (bursts(data, model, 1, data) is not None) is pushed


@pytest.mark.parametrize("soft", [False, True])
def test_numbers_that_differ_with_a_slower_observer_are_less_certain(soft: bool) -> None:
    """Without its spring in the model, a ringing load shifts the inertia, differently for each
    observer; blocks of one observer do not show that.
    """
    machine = reality.Machine(soft=20.0, load=0.005) if soft else reality.Machine()
    model = model_of(VISCOUS, COULOMB)
    columns = reality.simulate(machine, reality.multisine(8.0, RATE, 3), RATE, 1)
    data = data_of(columns, model).at_bandwidth(1, 32.0)
    fitted = fit(data, model, joint_handles(data, model, 1), joints=(1,))
    wider = with_slower_observer(data, fitted, 1, 1)
    assert (float(np.max(wider.std / fitted.std)) > 3.0) is soft


def test_a_recording_in_which_the_joint_hardly_moves_has_the_noise_of_the_sensor() -> None:
    count, t = reality.RESOLUTION, np.arange(4000) / RATE
    random = np.random.default_rng(0)

    def seen(motion: np.ndarray) -> Signals:
        q = np.round(motion / count + 0.5 * random.standard_normal(len(t))) * count
        u = np.zeros((len(t), 1))
        return Signals("run", t, 1.0 / RATE, q[:, None], u, None, np.array([count]))

    moves = [seen(np.sin(w * t)) for w in (2.0, 3.0)]
    rests = replace(moves[0], position=np.zeros((len(t), 1)))
    model = model_of(VISCOUS, COULOMB)
    alone = prepare([rests], model).records[0][0].measurement.noise
    beside = prepare(one_sensor([rests, *moves])[:1], model).records[0][0].measurement.noise
    twice = one_sensor([rests, moves[0], moves[0], moves[1]])[0].least_noise
    assert alone == 0.0 and beside == pytest.approx(0.5 * count, rel=0.15)
    assert twice is not None and twice[0] == beside


@pytest.mark.parametrize(("steps", "pushed", "numeric"), [(1, 0.0, True), (20, 0.001, False)])
def test_the_half_row_of_a_first_order_simulator_is_not_missing_physics(
    steps: int, pushed: float, numeric: bool
) -> None:
    t = np.arange(5000) / RATE
    command = 0.15 * (np.sin(7.0 * t) + np.sin(17.0 * t + 1.0) + np.sin(31.0 * t + 2.0))
    foreign = pushed * np.random.default_rng(5).standard_normal(50).repeat(100)
    h, q, v, seen = 1.0 / RATE / steps, 0.0, 0.0, []
    for u in command + foreign:
        seen.append(q)
        for _ in range(steps):
            v += h * (u - 0.004 * v) / 0.01
            q += h * v
    model = model_of(VISCOUS)
    data = data_of({"t": t, "q": np.array(seen), "u": command}, model)
    base = calibrate_joint(data, model, 1)
    out: Any = SimpleNamespace(joint=1, base=base, before=discrepancy(data, base.model, 1))
    parts: Any = SimpleNamespace(fit=data, test=data)
    assert out.before.value > OF_STATE
    assert nothing_named._half_a_row(out, parts, 1) is numeric


def test_a_number_is_not_bent_into_the_limits_of_shorter_recordings() -> None:
    """By the limits of such a recording alone 6 waves a turn had become 6 ± 19."""
    uneven = {"kind": "position_friction", "joint": 1, "period": 0.9, "amplitude": 0.02, "phase": 0}
    model, machine = model_of(VISCOUS, COULOMB, uneven), reality.Machine(uneven=0.02)
    far, near = (
        data_of(reality.simulate(machine, reality.multisine(8.0, RATE, 3, size=size), RATE), model)
        for size in (1.0, 0.05)
    )
    handles = joint_handles(far, model, 1)
    at = next(i for i, h in enumerate(handles) if h.key == "period")
    asked = near.within_limits_of(far)
    alone, within = (
        fit(d, model, handles, joints=(1,), iterations=0).x[at] for d in (near, asked)
    )
    assert within == pytest.approx(0.9) and alone < 0.3
    assert np.array_equal(asked.records[0][0].position, near.records[0][0].position)
