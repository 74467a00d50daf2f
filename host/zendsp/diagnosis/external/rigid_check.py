"""Whether a simulator is a rigid body: it starts where it is told, accelerates in proportion to a
torque, and has no memory but position and speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.regression import look
from zendsp.diagnosis.data.signals import Signals
from zendsp.diagnosis.decide.contract import listed
from zendsp.diagnosis.external.asked import ROWS_EACH, SLIDES, State
from zendsp.diagnosis.external.inside import DRY, FLUID, ROTOR, Inside, Sizes
from zendsp.diagnosis.external.likeness import same_shape
from zendsp.diagnosis.external.numbers import expanded
from zendsp.diagnosis.external.rigid import (
    AGREES,
    BENT,
    NOT_ITS_OWN,
    PUSHED,
    REVERSES,
    RIGID_SHARE,
    STATES_ASKED,
    Called,
    Near,
)
from zendsp.diagnosis.external.simulator import Simulator
from zendsp.diagnosis.progress import Progress
from zendsp.errors import ModelError
from zendsp.physics.kernel.signals import measure, noise_beside_quantisation, smooth
from zendsp.physics.model import Model, per_joint

Array = npt.NDArray[np.float64]

STARTS_AT = 1e-6  # of the range: a simulator begins this near to where it is told
SPEED_AT = 0.1  # of the speed: and as near to the speed
ANEW_AFTER = 0.02  # s: after which it is started anew from where it is
NUMBERS_TRIED = 0.1  # of the numbers: whether the torque is linear in them
# of the speed: slower joints are made faster in states at which a simulator is asked what it is
MOVES = 0.3
STATES_INSIDE = 16  # at which a simulator is asked what is a term of the model
# corrections of a torque, at most, until it keeps up a speed: until none is more of the torque
KEPT_UP, KEPT = 3, 1e-6
# times REVERSES: speeds at which the torque against a joint is asked for, each from the one before;
# the last two say what friction it is
AGAINST_AT = 10.0, 2.0, 1.0
STATES_FITTED = 300  # states to which numbers are fitted roughly
FITS = 2  # the second about the numbers of the first
# of a joint's torque: less is no friction, since rigid bodies differ by up to 0.4 %
RUBS_INSIDE = 0.005
OUT_OF_PROPORTION = (
    "does not answer twice a push with twice the acceleration (joint {joint}: off by {by:.2g} of"
    " the answer in {states} of {of} states, at most {most:g})"
)
REMEMBERS = (
    "has a lag, a delay, a spring or the like inside: {late:g} s after a push it accelerates"
    " otherwise than one that starts there (joint {joint}: by {by:.2g} of the push in {states} of"
    " {of} states, at most {most:g})"
)


def rigid(
    signals: Sequence[Signals], model: Model, simulator: Simulator, tell: Progress
) -> Called | str:
    """A simulator as a rigid body; or why it is none, in words that follow its name."""
    s = signals[0]
    joints = range(s.position.shape[1])
    gains = np.array([per_joint(model.actuator.gain, j + 1, 1.0) for j in joints])
    effort = np.sqrt(np.mean(np.concatenate([x.command for x in signals]) ** 2, axis=0))
    if not np.all(effort > 0):
        return f"is given no command at {listed(np.flatnonzero(effort <= 0) + 1)}"
    states = _states(s)
    some = _spread(states, STATES_ASKED)
    names = expanded(model)
    values = {k: q[0].value for k, q in names.mechanism.items()}
    torque = np.abs(gains) * effort
    # friction inside makes slow joints stick or turn, and a push is answered by less than the body
    probe = states.at(some).no_slower(MOVES * np.std(states.qd[some], axis=0))
    called = Called(names, simulator, s.sample_time, torque, probe, values, tell)
    try:
        why = _unlike_a_body(called, called.probe, gains * s.command[some])
    except ModelError as error:
        if model.kind == "fmu":  # whose process is gone
            raise
        why = f"cannot be called for a few rows ({error})"
    if why:
        return why
    called.inside = terms_inside(called)
    called.model = called.inside.added_to(names)
    called.weight = weight_inside(called)
    _straighten(called, s, gains)
    return called


def terms_inside(called: Called) -> Inside:
    """What is a term of the model inside a simulator. Friction is half of what the torque of each
    joint changes by with the direction, at two low speeds and from these at none; a rotor is what
    numbers say.
    """
    near = called.near(called.probe.at(slice(None, None, STATES_ASKED // STATES_INSIDE)))
    dry, fluid = np.zeros((2, called.joints))
    for j in range(called.joints):
        at = [times * REVERSES * float(np.std(near.at.qd[:, j])) for times in AGAINST_AT]
        *_, twice, once = _against(called, near, j, at)
        dry[j] = 2.0 * once - twice
        fluid[j] = (twice - once) / at[-1]
    numbers, sizes = _numbers(called, near), {}
    speed = np.sqrt(np.mean(near.at.qd**2, axis=0))
    for effect, found, torque in ((DRY, dry, dry), (FLUID, fluid, fluid * speed)):
        own = _sum_of(called, numbers[effect])
        size = np.where(torque > RUBS_INSIDE * called.torque, found, np.maximum(own, 0.0))
        sizes[effect] = tuple(float(x) for x in size)
        numbers[effect] = {
            key: units for key, units in numbers[effect].items()
            if all(x > 0.0 for x, unit in zip(size, units, strict=True) if unit)
        }  # fmt: skip
    rotors = _sum_of(called, numbers[ROTOR])
    if np.any(rotors >= np.einsum("njj->nj", near.mass).min(axis=0)):  # no bodies are left
        rotors, numbers[ROTOR] = 0.0 * rotors, {}
    sizes[ROTOR] = tuple(float(x) for x in rotors)
    return Inside(sizes, numbers)


def _sum_of(called: Called, numbers: Mapping[str, Sizes]) -> Array:
    """What all numbers of an effect make, (joints,)."""
    each = [called.about[key] * np.array(units) for key, units in numbers.items()]
    return np.asarray(sum(each, np.zeros(called.joints)))


def _against(called: Called, near: Near, j: int, speeds: Sequence[float]) -> list[float]:
    """The torque against a joint's motion (from 0) at some speeds: half of its change with the
    direction. The others move, so that none sticks; both ways, so that what they add cancels.
    """
    out = np.zeros((len(speeds), len(near.at)))
    for others, way in product((1.0, -1.0), (1.0, -1.0)):
        qd, torque = others * near.at.qd, near.torque
        for k, speed in enumerate(speeds):
            qd[:, j] = way * speed
            torque = _kept_up(called, near, qd, torque)
            out[k] += 0.25 * way * torque[:, j]
    return [float(x) for x in np.median(out, axis=1)]


def _kept_up(called: Called, near: Near, qd: Array, torque: Array) -> Array:
    """The torques that keep up other speeds (n, joints), from nearly these: a joint that stops by
    its friction tells little of it.
    """
    at = State(near.at.q, qd, np.zeros_like(qd))
    for _ in range(KEPT_UP):
        came = called.accelerations(at, torque, called.numbers())
        lacks = np.einsum("nij,nj->ni", near.mass, came)
        torque = torque - lacks
        if np.all(np.abs(lacks) < KEPT * called.torque):
            break
    return torque


def weight_inside(called: Called) -> tuple[float, float] | None:
    """The weight inside a simulator of one joint that turns, N m, and the position at which it
    hangs, rad; None where it has none.
    """
    if called.joints > 1 or called.model.joint_kind(1) == "linear":
        return None
    near = called.near(called.probe)
    # friction is against either
    both = [_kept_up(called, near, way * near.at.qd, near.torque) for way in (1.0, -1.0)]
    still = 0.5 * (both[0] + both[1])[:, 0]
    q = near.at.q[:, 0]
    shapes = np.stack([np.sin(q), np.cos(q), np.ones_like(q)], axis=1)
    along, across, _ = np.linalg.lstsq(shapes, still, rcond=1e-9)[0]
    torque = math.hypot(along, across)
    weighs = torque > RUBS_INSIDE * called.torque[0]
    return (torque, math.atan2(-across, along)) if weighs else None


def _numbers(called: Called, near: Near) -> dict[str, dict[str, Sizes]]:
    """By effect: what a unit of each number adds to the joints' sizes, of those that do nothing
    else.
    """
    shapes = {DRY: np.sign(near.at.qd), FLUID: near.at.qd}
    out: dict[str, dict[str, Sizes]] = {effect: {} for effect in (*shapes, ROTOR)}
    for key, items in called.model.mechanism.items():
        value = items[0].value
        if not value:
            continue
        change, rest = called.moved(near, key)
        felt = abs(value) * np.sqrt(np.mean(rest**2, axis=0)) > NOT_ITS_OWN * called.torque
        inertial = np.einsum("nij,nj->ni", change, near.at.qdd)
        whole = inertial + rest
        if called.joints > 1 and same_shape(whole.ravel(), inertial.ravel()):
            own = _on_own_joint(change)
            if own is not None:
                out[ROTOR][key] = own
        # a viscosity is in the mass matrix by what a push makes the simulator faster
        if not any(felt) or not same_shape(whole.ravel(), rest.ravel()):
            continue
        for effect, shape in shapes.items():
            if all(same_shape(shape[:, j], rest[:, j]) for j in np.flatnonzero(felt)):
                units = felt * (shape * rest).sum(axis=0) / (shape**2).sum(axis=0)
                out[effect][key] = tuple(float(u) for u in units)
    return out


def _on_own_joint(change: Array) -> Sizes | None:
    """What a number adds to the inertia of each joint, where it is the same at all poses and no
    other joint feels it; else None.
    """
    each = np.diag(change.mean(axis=0))
    units = np.where(np.abs(each) > NOT_ITS_OWN * np.abs(each).max(), each, 0.0)
    alike = same_shape(np.broadcast_to(np.diag(units), change.shape).ravel(), change.ravel())
    return tuple(float(u) for u in units) if alike else None


def _spread(states: State, count: int) -> npt.NDArray[np.int64]:
    """Rows spread over a motion."""
    n = len(states)
    return np.unique(np.linspace(0.02 * n, 0.98 * n - 1, count).astype(np.int64))


def _straighten(called: Called, s: Signals, gains: Array) -> None:
    """Take torques as linear about numbers near those of the machine, where they are not linear."""
    ways = np.resize([1.0 + NUMBERS_TRIED, 1.0 - NUMBERS_TRIED], len(called.free))
    other = {k: w * called.about[k] for k, w in zip(called.free, ways, strict=True)}
    if not called.free or called.bent(other) < BENT:
        return
    noise = [
        noise_beside_quantisation(y, float(r))
        for y, r in zip(s.position.T, s.resolution, strict=True)
    ]
    slow = look(s.position.T, s.command.T, s.sample_time, np.array(noise))
    state = State(slow.q.T, slow.qd.T, slow.qdd.T)
    some = _spread(state, STATES_FITTED)
    for _ in range(FITS):
        called.move_to(called.calibrated(state.at(some), gains * slow.command.T[some]))


def _unlike_a_body(called: Called, at: State, torque: Array) -> str:
    """Why the simulator is no rigid body at most of some states, under the torques there; empty
    where it is one.
    """
    late = max(ROWS_EACH + 2, round(ANEW_AFTER / called.sample_time))
    base = called.simulated(at, torque, called.numbers(), late)
    if not np.isfinite(base).all():
        raise ModelError(
            f"{called.simulator.name}: gives positions that are no finite numbers, with the numbers"
            " of the model file and from states of the recording"
        )
    if why := _starts_elsewhere(called, at, base):
        return why
    off, memory = np.zeros((2, called.joints, len(at)))
    turns = np.zeros(off.shape, dtype=np.bool_)
    for j in range(called.joints):
        ways, onwards = [], np.where(at.qd[:, j] < 0.0, -1.0, 1.0)
        for times in (1.0, 2.0):
            more = torque.copy()
            more[:, j] += times * PUSHED * called.torque[j] * onwards
            ways.append((more, called.simulated(at, more, called.numbers(), late)))
        (push, once), (_, twice) = ways
        answers = [np.diff(w[:, :3] - base[:, :3], 2, axis=1)[:, 0] for w in (once, twice)]
        size = np.abs(answers[0]).max(axis=1)
        size[size == 0] = np.finfo(float).tiny
        off[j] = np.abs(answers[0] - 0.5 * answers[1]).max(axis=1) / size
        off[j][np.abs(answers[1]).max(axis=1) == 0] = 1.0  # a push that does nothing
        memory[j] = _forgets(called, push, once) * called.sample_time**2 / size
        turns[j] = _turned(called, at, np.stack([base, once, twice]))
    # one with friction of its own may stick where a joint turns; of six joints one often does
    counts = ~turns | turns.all(axis=1, keepdims=True)
    if np.all(_share(np.maximum(off, memory), counts) <= 1.0 - RIGID_SHARE):
        return ""
    disagree = OUT_OF_PROPORTION, REMEMBERS
    shares = [_share(x, counts) for x in (off, memory)]
    which = int(shares[1].max() > shares[0].max())
    j = int(np.argmax(shares[which]))
    of = int(counts[j].sum())
    return disagree[which].format(
        joint=j + 1, by=float(np.median((off, memory)[which][j, counts[j]])),
        states=round(of * float(shares[which][j])), of=of, most=AGREES, late=ANEW_AFTER,
    )  # fmt: skip


def _share(off: Array, counts: npt.NDArray[np.bool_]) -> Array:
    """The share of the states that count in which a push is answered otherwise, by joint."""
    return np.asarray(np.sum((off >= AGREES) & counts, axis=1) / counts.sum(axis=1))


def _turned(called: Called, at: State, ways: Array) -> npt.NDArray[np.bool_]:
    """Whether some joint all but stands on one of the ways (ways, n, rows, joints) from a state,
    (n,).
    """
    onwards = np.diff(ways, axis=2) * np.where(at.qd < 0.0, -1.0, 1.0)[:, None]
    least = SLIDES * np.std(called.probe.qd, axis=0) * called.sample_time
    return np.asarray((onwards < least).any(axis=(0, 2, 3)))


def _forgets(called: Called, torque: Array, way: Array) -> Array:
    """The largest difference of the accelerations at the end of a simulation (n, rows, joints) from
    those of one that starts there, (n,). A lag, a delay or a spring inside remembers more.
    """
    h = called.sample_time
    q, speed = way[:, -2], (way[:, -1] - way[:, -3]) / (2.0 * h)
    change = np.diff(way[:, -3:], 2, axis=1)[:, 0] / h**2
    anew = called.accelerations(State(q, speed, change), torque, called.numbers())
    return np.asarray(np.abs(anew - change).max(axis=1))


def _starts_elsewhere(called: Called, at: State, answer: Array) -> str:
    """How simulations start elsewhere than at the position and the speed that they are told, in
    words; empty where they do not.
    """
    h = called.sample_time
    begun = at.q - at.qd * h + 0.5 * at.qdd * h**2
    span, speed = np.ptp(at.q, axis=0).max(), np.sqrt(np.mean(at.qd**2, axis=0))
    away = np.abs(answer[:, 0] - begun).max(axis=0)
    if np.any(away > STARTS_AT * span):
        j = int(np.argmax(away))
        unit = called.model.position_unit(j + 1)
        return f"does not start where it is told (joint {j + 1}: up to {away[j]:.2g} {unit} away)"
    # of its first row, whatever it accelerates with under this torque
    first = (answer[:, 1] - answer[:, 0] - 0.5 * np.diff(answer[:, :3], 2, axis=1)[:, 0]) / h
    off = np.sqrt(np.mean((first - (at.qd - at.qdd * h)) ** 2, axis=0)) / speed
    if np.any(off > SPEED_AT):
        j = int(np.argmax(off))
        return (
            f"does not start with the speed that it is told (joint {j + 1}: off by {off[j]:.0%},"
            f" at most {SPEED_AT:.0%})"
        )
    return ""


def _states(s: Signals) -> State:
    """The smoothed motion of a recording."""
    states = []
    for j in range(s.position.shape[1]):
        y = np.ascontiguousarray(s.position[:, j])
        resolution = float(s.resolution[j])
        seen = measure(y, s.sample_time, resolution, noise_beside_quantisation(y, resolution))
        states.append(smooth(seen, s.sample_time).states)
    return State(*np.ascontiguousarray(np.stack(states).transpose(1, 2, 0)))
