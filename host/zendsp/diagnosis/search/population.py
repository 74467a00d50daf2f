"""The minimum of a rough cost, by populations of models that learn their covariance (Hansen, "The
CMA Evolution Strategy: A Tutorial", arXiv 1604.00772).

Only the order of the costs counts, so that neither their steps nor their false slopes mislead.
Numbers are drawn as logarithms, around a mean and with a covariance that follow the likeliest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.measure.likelihood import deviances
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.handles import Handle, get_values, set_values
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

# two rounds of the kernel's eight lanes. With 32 the same seven gaps ended no deeper, in twice the
# time; with 12 one in five went nowhere
SIZE, PARENTS = 16, 5
LEARNED = 0.25  # of the covariance, in each generation
GENERATIONS, LOOKS = 60, 10  # at most; from look to look at what was gained
SETTLING = 2  # looks before one without a gain ends the search: it begins too wide
SEED = 1


def likeliest(
    data: Data,
    model: Model,
    handles: Sequence[Handle],
    joint: int,
    spread: Array,
    worth: float,
    jobs: int,
) -> Model:
    """The likeliest model met; ``model`` itself where none gained what is ``worth`` it.

    Parameters
    ----------
    data : Data
        The recordings.
    model : Model
        Where the search begins.
    handles : sequence of Handle
        The p numbers that it moves; those that are zero stay.
    joint : int
        1-based.
    spread : ndarray, shape (p, p)
        The covariance of their logarithms to begin with.
    worth : float
        Gain in deviance, from look to look, below which the search ends.
    jobs : int
        Threads.
    """
    begin, rng = get_values(model, handles), np.random.default_rng(SEED)
    moved = np.flatnonzero(begin)
    mean, covariance = np.zeros(len(moved)), spread[np.ix_(moved, moved)]
    weight = np.log(PARENTS + 0.5) - np.log(np.arange(1, PARENTS + 1))
    weight /= weight.sum()
    (least,) = deviances(data, [model], joint, jobs)
    best, first, known = model, least, least
    for generation in range(1, GENERATIONS + 1):
        drawn = rng.multivariate_normal(mean, covariance, SIZE, method="eigh")
        numbers = np.tile(begin, (SIZE, 1))
        numbers[:, moved] *= np.exp(drawn)
        models = [set_values(model, handles, x) for x in numbers]
        cost = np.array(deviances(data, models, joint, jobs))
        parents = np.argsort(cost, kind="stable")[:PARENTS]
        if cost[parents[0]] < least:
            best, least = models[parents[0]], float(cost[parents[0]])
        away = drawn[parents] - mean
        mean = mean + weight @ away
        covariance = (1.0 - LEARNED) * covariance + LEARNED * (away.T * weight) @ away
        look, rest = divmod(generation, LOOKS)
        if not rest:
            if look >= SETTLING and known - least < worth:
                break
            known = least
    return best if first - least >= worth else model
