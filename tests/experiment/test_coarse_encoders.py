"""Encoders of few counts: noise that the loop answers with torque, and places known to a count."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from zendsp.experiment.any_friction import fit_line, with_coupling
from zendsp.experiment.coarse import cutoff_for, widest_bandwidth
from zendsp.experiment.gentle import Moves, smooth_moves, weak_pieces
from zendsp.experiment.sliding import Friction, Sliding, constant_speed_pieces
from zendsp.recording import Recording
from zendsp.reference import Reference
from zendsp_protocol.messages import JointInfo

INERTIA, LEVEL, VISCOUS, WEIGHT = 0.1, 0.5, 0.3, 3.0
PERIOD = 0.001
DURATIONS = [4.8, 3.35, 2.35, 1.64, 1.15, 0.8]


def moved(count: float, seed: int, uneven: float = 0.0) -> tuple[Recording, Moves]:
    """A joint that carries a weight, moved as `mechanical` moves one: joint_pd.c closes the loop
    over an encoder of this count, and a command acts a sample later. ``uneven``: share of the
    friction that varies with place.
    """
    moves = smooth_moves(np.zeros(1), 1, -0.4, 0.8, DURATIONS, PERIOD)
    noise = 0.5 * np.random.default_rng(seed).standard_normal(moves.reference.samples)
    plan = np.stack([moves.reference.q[:, 0], moves.reference.qd[:, 0]], axis=1).tolist()
    w, steps = 2.0 * math.pi * 3.0, 4
    q, v, acts, late = plan[0][0], 0.0, WEIGHT, WEIGHT
    total, seen, pace = WEIGHT, q, 0.0
    rows = []
    for (goal, speed), noisy in zip(plan, noise.tolist(), strict=True):
        before, seen = seen, (math.floor(q / count + noisy) + 0.5) * count
        pace += 0.4 * ((seen - before) / PERIOD - pace)
        stiff = INERTIA * w * w
        total += stiff * (goal - seen) * PERIOD / 0.3
        acts, late = late, stiff * (goal - seen) + 2.0 * INERTIA * w * (speed - pace) + total
        rows.append((seen, late))
        for _ in range(steps):
            free = acts - WEIGHT * math.cos(q) - VISCOUS * v
            step = v + free / INERTIA * PERIOD / steps
            lost = LEVEL * (1.0 + uneven * math.sin(25.0 * q)) / INERTIA * PERIOD / steps
            v = 0.0 if abs(step) <= lost else step - math.copysign(lost, step)
            q += v * PERIOD / steps
    columns = dict(zip(("q", "tau"), np.array(rows).T[:, :, None], strict=True))
    t = np.arange(len(rows)) * PERIOD
    return Recording.from_columns({"play_time": t, **columns}, sample_time=PERIOD), moves


def found(pieces: Sliding) -> Friction:
    return fit_line(with_coupling(pieces, True)[0], True)


def test_the_noise_of_a_coarse_encoder_is_no_share_of_an_inertia() -> None:
    """With counts of 1e-3 rad the torque's rate, which the loop makes of the same noise as the
    acceleration's, took up to 2.7 % of the inertia and of the friction; pieces of a tenth of a
    second, whose noise is a hundred times that of the longest, weighed as much as these.
    """
    each = [found(weak_pieces(*moved(1e-3, seed), 1)) for seed in range(6)]
    inertia = np.array([one.inertia for one in each])
    level = np.array([one.mean[0] for one in each])
    assert inertia[:, 0].mean() == pytest.approx(INERTIA, rel=0.01)
    assert level.mean() == pytest.approx(LEVEL, rel=0.003)
    assert (np.abs(inertia[:, 0] - INERTIA) < 1.5 * inertia[:, 1]).all()
    assert inertia[:, 1].max() < 0.06 * INERTIA, "what is stated is no more than the noise makes"


def test_pieces_weigh_alike_where_friction_that_varies_with_place_is_more_than_noise() -> None:
    pieces = weak_pieces(*moved(1e-5, 1, uneven=0.05), 1)
    assert pieces.weights().min() > 0.9
    assert found(pieces).inertia[0] == pytest.approx(INERTIA, rel=0.02)


def test_the_weight_of_a_piece_is_the_mean_along_it_not_that_of_its_middle() -> None:
    """Over the 0.1 rad of a piece they differ by 0.01 to 0.04 %, up to four of what is stated."""
    moves = smooth_moves(np.zeros(1), 1, 0.2, 0.8, DURATIONS, PERIOD)
    later = moves.reference.q + 1.5 * PERIOD * moves.reference.qd  # a command acts 1.5 samples on
    tau = 2.0 * np.sin(later) + LEVEL * np.sign(moves.reference.qd)
    t = np.arange(moves.reference.samples) * PERIOD
    columns = {"play_time": t, "q": moves.reference.q, "tau": tau}
    rec = Recording.from_columns(columns, sample_time=PERIOD)
    assert found(weak_pieces(rec, moves, 1)).sine[0] == pytest.approx(2.0, rel=2e-5)
    way = np.r_[np.arange(0, 0.8, 2e-4), np.arange(0.8, 0, -2e-4)][:, None]
    plan = Reference(way, PERIOD, kind="trapezoid", machine="")
    later = way + 1.5 * PERIOD * plan.qd
    columns = {"play_time": t[: len(way)], "q": way, "tau": 2.0 * np.sin(later)}
    rec = Recording.from_columns(columns, sample_time=PERIOD)
    steady = constant_speed_pieces(rec, plan, 1, gravity=False)
    assert np.abs(steady.torque - 2.0 * steady.turning()[1]).max() < 2e-5


def test_a_weight_is_no_surer_than_the_zero_of_its_encoder() -> None:
    """A count of 1e-3 rad turns 3 N m by cos q into 1.5e-3 N m by sin q: an encoder tells no place
    between two counts.
    """
    pieces = weak_pieces(*moved(1e-3, 3), 1)
    plain, counted = (found(replace(pieces, count=c)).sine[1] / 1.96 for c in (0.0, 1e-3))
    assert counted**2 - plain**2 == pytest.approx((WEIGHT * 1e-3) ** 2 / 12.0, rel=0.01)


def test_no_count_of_an_encoder_asks_a_loop_for_more_than_a_fifth_of_its_torque() -> None:
    """Each was half of what a pan and tilt head has: at its limit in 4 to 18 % of the samples, it
    was refused every experiment, because of "friction or weight".
    """
    told, fine = (
        JointInfo(name="tilt", torque_max=6.0, counts_per_unit=counts / math.tau)
        for counts in (4096.0, 131072.0)
    )
    J = np.array([0.1])
    assert cutoff_for([fine], J, 3.0) == 80.0 and widest_bandwidth([fine], J) > 15.0
    w = math.tau * 3.0
    for joints in ([told], [fine, told]):
        cutoff = cutoff_for(joints, np.full(len(joints), 0.1), 3.0)
        assert 30.0 <= cutoff < 80.0
        assert 2.0 * 0.1 * w * math.tau * cutoff * math.tau / 4096.0 <= 0.2 * 6.0 + 1e-9
    band = widest_bandwidth([told], J)
    assert 3.0 < band < 4.0 and cutoff_for([told], J, band) == pytest.approx(10.0 * band)
