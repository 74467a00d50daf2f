"""How sure it is that one explanation of bodies predicts better than another."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from zendsp.diagnosis.search.body_columns import NUISANCE
from zendsp.diagnosis.search.body_hypotheses import LIMITS
from zendsp.diagnosis.search.body_solver import Solver

BLOCKS, SAMPLES = 16, 150
# how far the arm swings in each block: it does most of its motion in three of them
SWINGS = np.array([1, 1, 1, 30, 1, 1, 1, 1, 20, 1, 1, 1, 25, 1, 1, 1], float)


def sums(torque: float, rng: np.random.Generator) -> Any:
    """Gram matrices of one joint: nuisance, the column of a body, innovations that hold so much of
    it beside noise.
    """
    grams, counts = np.zeros((1, BLOCKS, NUISANCE + 2, NUISANCE + 2)), np.full((1, BLOCKS), 150.0)
    for block, swing in enumerate(SWINGS):
        nuisance = rng.normal(size=(NUISANCE, SAMPLES))
        body = swing * np.sin(np.linspace(0, 6, SAMPLES) + rng.uniform(0, 6))
        left = -torque * body + rng.normal(size=SAMPLES)
        columns = np.concatenate([nuisance, [body, left]])
        grams[0, block] = columns @ columns.T
    return SimpleNamespace(grams=grams, counts=counts, whole=grams.sum(axis=1), alike=2)


def sureness(torque: float, seed: int) -> float:
    """Of the body's column, estimated on one recording, over nothing, on another."""
    rng = np.random.default_rng(seed)
    layout: Any = SimpleNamespace(joints=1, width=NUISANCE + 1, own=NUISANCE + 1)
    solver = Solver(sums(torque, rng), sums(torque, rng), layout, LIMITS)
    gram = solver.rest[0]
    found = np.zeros((1, layout.width))
    found[0, NUISANCE] = -gram[0, 1] / gram[0, 0]
    return solver.better(found, np.zeros((1, layout.width)))


def test_a_body_that_is_felt_in_few_blocks_only_is_sure() -> None:
    """The mean gain of a block over its spread stays below 3 here, however heavy the body is; 0.3
    of the column is 100 standard deviations of the noise, known from three blocks' spread.
    """
    assert all(sureness(0.3, seed) > LIMITS.sure for seed in range(20))
    assert all(sureness(3.0, seed) > 10 for seed in range(20))


def test_a_body_that_is_not_there_is_hardly_ever_sure() -> None:
    """Of a normal deviate 0.1 % are above three; 4 of 400 leaves room for the draw."""
    assert sum(sureness(0.0, seed) > LIMITS.sure for seed in range(400)) <= 4
