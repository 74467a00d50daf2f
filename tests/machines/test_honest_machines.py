"""The shipped machines have the electronics and the imperfections that they state; `ideal = 1`
takes them away.
"""

from __future__ import annotations

import numpy as np
import pytest
from plants import OFF, VELOCITY, Plant, follow

from zendsp.reference import load_machine

Array = np.ndarray  # type: ignore[type-arg]
MACHINES = ("imi_planar", "pendulum", "wam7")
# a pose of the WAM in the middle of its range, rad
UP = np.array([0.0, 0.5, 0.0, 1.5, -1.5, 0.0, 0.0])


def torques(name: str, config: str, joint: int, tau: float, samples: int = 400) -> Array:
    """What the drive of a joint really gives for one torque, sample by sample, N m."""
    with Plant(name, config) as plant:
        rows = []
        command = np.zeros(plant.joints)
        command[joint] = tau
        for _ in range(samples):
            plant.torque(command)
            rows.append(plant.truth_current(joint))
        return np.array(rows)


def test_ideal_machines_give_exactly_the_commanded_torque() -> None:
    for name, joint, tau in (("imi_planar", 0, 3.21), ("wam7", 1, 1.234)):
        assert torques(name, "ideal = 1\n", joint, tau) == pytest.approx(tau, abs=1e-9)


@pytest.mark.parametrize(("name", "joint", "bits"), [("imi_planar", 1, 16), ("wam7", 3, 12)])
def test_the_analog_output_has_as_many_steps_as_the_machine_says(
    name: str, joint: int, bits: int
) -> None:
    """With noise and current loop off, torque comes in steps of 20 V / 2^bits."""
    limit = load_machine(name).limits.torque[joint]
    step = 2.0 * limit / 2**bits
    quiet = "dac_noise = 0\ncurrent_loop = 0\n"
    wanted = limit * np.linspace(0, 0.01, 40)
    given = np.array([torques(name, quiet, joint, tau, 1)[0] for tau in wanted])
    assert np.abs(given / step - np.round(given / step)).max() < 1e-6
    assert len(set(np.round(given / step))) > 10


def test_torque_reaches_its_value_through_a_current_loop_of_one_kilohertz() -> None:
    one = torques("imi_planar", "dac_noise = 0\n", 0, 5.0, 3)
    # the first sample ends after 6.25 time constants
    assert 1.0 - one[0] / one[2] == pytest.approx(np.exp(-1e-3 / 1.6e-4), rel=0.05)


@pytest.mark.parametrize(("name", "joint", "mv"), [("imi_planar", 0, 1.0), ("wam7", 1, 2.44)])
def test_torque_noise_has_the_stated_size_and_repeats_with_the_seed(
    name: str, joint: int, mv: float
) -> None:
    limit = load_machine(name).limits.torque[joint]
    first, again, other = (torques(name, f"seed = {s}\n", joint, 0.5, 4000) for s in (5, 5, 6))
    # 4000 samples: the spread is known to 1.1 %; the loop passes 99.8 % of it
    assert np.std(first) == pytest.approx(mv * limit / 10000.0, rel=0.05)
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_the_resolver_of_the_arm_has_noise_and_optical_encoders_have_none() -> None:
    for name, noisy in (("imi_planar", True), ("wam7", False), ("pendulum", False)):
        place = UP if name == "wam7" else np.array([8e-4, 0.0])  # not where two counts meet
        start = "".join(f"q{j + 1} = {x}\n" for j, x in enumerate(place))
        with Plant(name, f"dac_noise = 0\n{start}") as plant:
            zero = np.zeros(plant.joints)
            for _ in range(3000):  # held still by its drives
                plant.sample(zero, VELOCITY)
            seen = {float(plant.sample(zero, VELOCITY)[0]) for _ in range(500)}
        assert (len(seen) > 1) == noisy, name


def test_friction_of_the_planar_arm_varies_with_place_by_five_per_cent() -> None:
    levels = []
    for ideal in (0, 1):
        with Plant("imi_planar", f"q1 = -1.3\nideal = {ideal}\n") as plant:
            rows = follow(
                plant, lambda t: np.array([1.0 * t - 1.3, 0.0]), [4000.0, 300.0], [300.0, 12.0], 2.6
            )
        q, tau = rows[600:, 1], rows[600:, 5]
        waves = np.stack([np.ones_like(q), np.sin(14 * q), np.cos(14 * q)], axis=1)
        mean, a, b = np.linalg.lstsq(waves, tau, rcond=None)[0]
        levels.append((mean, np.hypot(a, b)))
    level = 8.45 * 1.05
    assert levels[0][0] == pytest.approx(levels[1][0], rel=0.01)
    # of the level, not of the viscous part; the controller's own way adds its lag
    assert levels[0][1] == pytest.approx(0.05 * level, rel=0.15)
    assert levels[1][1] < 0.005 * level


def test_the_phase_of_uneven_friction_depends_on_the_seed_of_the_arm() -> None:
    def run(seed: int) -> Array:
        quiet = "dac_noise = 0\nencoder_noise = 0\n"
        with Plant("imi_planar", f"{quiet}seed = {seed}\n") as plant:
            for _ in range(800):
                plant.torque([20.0, 0.0])
            return plant.q

    assert abs(run(1)[0] - run(2)[0]) > 1e-4 and np.array_equal(run(3), run(3))


def lacking(config: str) -> Array:
    """Torque to hold the WAM in the pose UP, beyond that of its data sheet, N m."""
    text = config + "".join(f"q{j + 1} = {x}\n" for j, x in enumerate(UP))
    sheet = load_machine("wam7").dynamics
    kp = [900.0, 1200.0, 300.0, 200.0, 25.0, 25.0, 6.0]
    kd = [40.0, 50.0, 8.0, 6.0, 0.3, 0.3, 0.02]

    def weight(q: Array) -> Array:
        return np.asarray(sheet.inverse(q, 0 * q, 0 * q))

    near = weight(UP[None])[0]
    means = []
    for way in (1.0, -1.0):  # creeping up and down: the mean of both has no friction
        with Plant("wam7", text) as plant:
            rows = follow(
                plant, lambda t, way=way: UP + way * (0.1 * t - 0.1), kp, kd, 1.5,
                feed=lambda _: near,
            )  # fmt: skip
        middle = rows[700:1300]
        means.append(np.mean(middle[:, 15:22] - weight(middle[:, 1:8]), axis=0))
    return np.asarray(0.5 * (means[0] + means[1]))


def test_gravity_of_the_wam_differs_from_its_data_sheet_by_some_percent() -> None:
    # half the difference of its friction in the two directions, at 0.1 rad/s
    uneven = np.array([0.08, -0.43, -0.35, 0.41, 0.02, 0.05, -0.03])
    sheet = load_machine("wam7").dynamics.inverse(UP[None], 0 * UP[None], 0 * UP[None])[0]
    real, ideal = lacking("friction = full\n"), lacking("ideal = 1\n")
    assert ideal - uneven == pytest.approx(0.0, abs=0.02)
    heavy = [1, 3]  # joints that carry in this pose
    off = np.abs(real - ideal)[heavy] / np.abs(sheet[heavy])
    assert np.all(off > 0.005) and np.all(off < 0.1)
    plain = lacking("friction = plain\n")
    assert plain == pytest.approx(0.0, abs=0.05), "plain friction: the arm of the sheet"


def test_the_wam_carries_its_hand_when_asked() -> None:
    more = lacking("hand = 1\n") - lacking("hand = 0\n")
    assert abs(more[1]) > 3.0  # 1.2 kg behind upper arm and forearm


@pytest.mark.parametrize("joint", range(7))
def test_rotors_of_the_wam_are_felt_and_the_ideal_arm_has_none(joint: int) -> None:
    """Initial acceleration for a torque far above friction: less with the rotor."""
    rotor = [0.201, 0.182, 0.067, 0.034, 0.0033224, 0.0033224, 0.000466939][joint]
    rates = []
    for ideal in (0, 1):
        start = "".join(f"q{j + 1} = {x}\n" for j, x in enumerate(UP))
        with Plant("wam7", f"ideal = {ideal}\ndac_noise = 0\ncurrent_loop = 0\n{start}") as plant:
            tau = np.zeros(7)
            tau[joint] = 0.95 * load_machine("wam7").limits.torque[joint]
            for _ in range(2):
                plant.torque(tau)
            rates.append(plant.qd[joint])
    assert rates[0] < rates[1]
    if rotor > 1e-3:
        assert rates[0] < 0.9 * rates[1]


@pytest.mark.parametrize("name", MACHINES)
def test_the_same_seed_gives_the_same_machine_to_the_last_bit(name: str) -> None:
    ends = []
    for _ in range(2):
        with Plant(name, "seed = 9\n") as plant:
            for k in range(300):
                plant.torque(0.3 * plant.scale * 0 + 0.1 * np.sin(0.05 * k))
            ends.append(plant.q)
    assert np.array_equal(*ends)


@pytest.mark.parametrize("name", MACHINES)
def test_power_off_gives_no_torque(name: str) -> None:
    with Plant(name) as plant:
        for _ in range(20):
            plant.sample(np.full(plant.joints, 2000.0), OFF)
        if name == "pendulum":
            assert plant.sensors.adc[1] == 0.0
        else:
            assert abs(plant.truth_current(0)) < 1e-3
