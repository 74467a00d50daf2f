"""Whether a missing body explains a mismatch that a regression would blame on a column."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.regression import PER_COLUMN, TURNS, Slow
from zendsp.physics.model import Model, per_joint
from zendsp.physics.robots.bodies import NUMBERS, Links, machine_tree

Array = npt.NDArray[np.float64]

EXPLAINED = 0.8  # R^2 of a torque that a body explains


def is_carried(slow: Slow, model: Model, joint: int, body: tuple[Array, Array]) -> bool:
    """Whether a missing body on a joint's own link explains its torque (1-based). Where all joints
    swing, its pull may be larger than the link's own inertia, and against it.
    """
    links = _links(slow, model)
    if links is None:
        return False
    felt, a, lacking = _borne(slow, model, body, links, joint - 1, joint - 1)
    if len(a) < PER_COLUMN * a.shape[1]:
        return False
    theta, right = _solved(a, lacking, _variance(slow, model, joint - 1))
    inertia = float(np.mean(theta[: len(felt)] @ felt))  # negative: a flipped sign
    return inertia > 0 and right


def is_tool(slow: Slow, model: Model, body: tuple[Array, Array]) -> bool:
    """Whether one body on the last link, no heavier than the robot, explains the missing torque of
    all joints.
    """
    links = _links(slow, model)
    if links is None:
        return False
    blocks, lacking, rows = [], [], []
    for i in range(len(links.bodies)):
        _, a, left = _borne(slow, model, body, links, i, len(links.bodies) - 1)
        unit = math.sqrt(_variance(slow, model, i)) or 1.0
        blocks.append(a / unit)
        lacking.append(left / unit)
        rows.append(len(left))
    shared, own = len(NUMBERS), blocks[0].shape[1] - len(NUMBERS)  # columns
    whole = np.zeros((sum(rows), shared + own * len(rows)))
    ends = np.cumsum(rows)
    for i, (a, end) in enumerate(zip(blocks, ends, strict=True)):
        whole[end - rows[i] : end, :shared] = a[:, :shared]
        whole[end - rows[i] : end, shared + own * i : shared + own * (i + 1)] = a[:, shared:]
    if len(whole) < PER_COLUMN * whole.shape[1]:
        return False
    theta, _ = _solved(whole, np.concatenate(lacking), 1.0)
    rest = np.split(np.concatenate(lacking) - whole @ theta, ends[:-1])
    explained = all(float(x @ x) < (1 - EXPLAINED) * len(x) for x in rest)
    return explained and 0.0 < theta[0] < sum(b.mass for b in links.bodies)


def _links(slow: Slow, model: Model) -> Links | None:
    """The machine's links along the motion; None where its kind has none."""
    tree = machine_tree(model)
    states = np.stack([slow.q, slow.qd, slow.qdd], axis=1)
    return Links(tuple(tree[0]), tree[1], states) if tree is not None else None


def _borne(
    slow: Slow, model: Model, body: tuple[Array, Array], links: Links, i: int, link: int
) -> tuple[Array, Array, Array]:
    """The regression of joint ``i`` (from 0): the inertia by each number of a link; columns of the
    numbers, friction and a constant; and the missing torque.
    """
    if links.moves(i, link):
        felt, borne = links.columns(i, link)
    else:
        felt, borne = np.zeros((2, len(NUMBERS), slow.q.shape[1]))
    qd, use = slow.qd[i], ~slow.at_edge[i]
    dry = np.tanh(qd / (TURNS * float(np.sqrt(np.mean(qd**2))) + 1e-300))
    a = np.stack([*borne, qd, dry, np.ones_like(qd)], axis=1)
    torque = per_joint(model.actuator.gain, i + 1, 1.0) * slow.command[i]
    return felt, a[use], (torque - body[0][i] - body[1][i])[use]


def _variance(slow: Slow, model: Model, i: int) -> float:
    """The variance of the torque of joint ``i`` (from 0); 0 where it is always at its limit."""
    use = ~slow.at_edge[i]
    if not use.any():
        return 0.0
    return float(np.var(per_joint(model.actuator.gain, i + 1, 1.0) * slow.command[i][use]))


def _solved(a: Array, lacking: Array, variance: float) -> tuple[Array, bool]:
    """The least-squares solution, and whether it leaves little of a torque of that variance."""
    scale = np.maximum(np.linalg.norm(a, axis=0), 1e-300)
    theta = np.linalg.lstsq(a / scale, lacking, rcond=1e-9)[0] / scale
    left = lacking - a @ theta
    return theta, float(left @ left) < (1 - EXPLAINED) * len(left) * variance
