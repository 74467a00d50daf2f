"""Predictions of a model along one joint's recording by the kernel: with an observer, and free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from zendsp.errors import RecordingError
from zendsp.physics.calibration.joint import JointRecord, mechanism_value, own_terms
from zendsp.physics.effects import get_effect
from zendsp.physics.kernel.native import LANES, native
from zendsp.physics.model import Model, Term, per_joint
from zendsp.physics.robots.bodies import body_terms
from zendsp.physics.term_numbers import added_inertia

Array = npt.NDArray[np.float64]

MAX_PARAMETERS = 6
_NOTHING = np.zeros(0)
# value that the kernel writes from where a prediction diverges: 1000 rad or m off, or at 1e5 rad/s
# or m/s
RAN_AWAY = 1e9
LONGEST = 1.5  # longest integration step, times inertia over damping
MOST_STEPS = 8  # a sample
REMEMBERED = 32  # predictions kept for a recording, since a decision repeats some
# errors of the sensor: a joint whose first rows span less begins at rest. Steps of the fit of a
# spring's start in motion
AT_REST, STARTS = 8.0, 3
# s: as much of a recording shows whether its spring was bent when it began, by the likeliest of
# some stiffnesses: with one that is a fifth wrong the other start may seem to fit. It is not bent
# where that leaves less than this part of the squares: of a ring 0.001, far from its numbers 0.7;
# where none is seen both leave the same within 0.1 %, and a fit must not go from one to the other
SHOWS_START, NEARBY, CLEARER = 2.0, (0.7, 0.85, 1.0, 1.2), 0.9
AT_FIRST = 0.03  # s, over which the acceleration at the beginning is measured


def pack(terms: tuple[Term, ...]) -> tuple[npt.NDArray[np.int32], Array]:
    """The effects in the kernel's form: indices and a table of parameters.

    The Stribeck parameter is the excess over the Coulomb level of the same joint (model files give
    the breakaway).
    """
    index = native().index
    terms = own_terms(terms)
    kinds = np.zeros(max(1, len(terms)), np.int32)
    table = np.zeros((max(1, len(terms)), MAX_PARAMETERS))
    for row, term in enumerate(terms):
        effect = get_effect(term.effect)
        kinds[row] = index[term.effect]
        for column, parameter in enumerate(effect.parameters):
            table[row, column] = term.value(parameter.name, parameter.default or 0.0) - (
                parameter.size == "joint"
            )
    return kinds, table


@dataclass(frozen=True)
class Run:
    """Outcome of one pass of the kernel: weighted innovations (n,), states and torque where asked
    for, sample at which it diverged.
    """

    innovations: Array
    q: Array | None
    qd: Array | None
    torque: Array | None
    diverged: int


def ran_away(innovations: Array) -> bool:
    """Whether a prediction has diverged, so that its innovations say nothing."""
    return not float(np.max(np.abs(innovations), initial=0.0)) < RAN_AWAY


def run(
    record: JointRecord,
    model: Model,
    bandwidth: float,
    *,
    inner: int = 2,
    states: Literal["", "seen", "beyond"] = "",
    free_every: int = 0,
    extra: Array | None = None,
    begun: bool = False,
) -> Run:
    """Predict every sample of one joint with a model.

    Parameters
    ----------
    model : Model
        With the terms in kernel form (see ``pack``).
    bandwidth : float
        Of the observer, rad/s.
    inner : int
        Integration steps per sample.
    states : str
        States to return too, with the torque: of the side of a transmission that the sensor sees,
        or of the side beyond.
    free_every : int
        Samples between restarts from the smoothed motion, with free simulation between; 0:
        observer. An unmeasured load behind a spring restarts from an observer's estimate.
    extra : ndarray or None, shape (n,)
        Resisting torque added from outside, N m or N.
    begun : bool
        Whether a load on a spring begins as it fits the recording best, where that begins in
        motion: to judge a model. In a fit it is still, so that all numbers have derivatives; where
        it is, see ``unbent``.
    """
    lib, n = native(), record.n
    p = lib.doubles
    packed = pack(model.at(record.joint))
    key = _key(record, model, packed, bandwidth, inner, free_every)
    released = unbent(record, model, bandwidth, inner)
    start = _begun(record, model, bandwidth, inner, released) if begun else (0.0, 0.0)
    key = (*key, released, start)
    asked_again = not states and extra is None
    found = record.runs.pop(key, None) if asked_again else None
    if found is not None:
        known: Run = found
        _keep(record, key, known)  # as the latest: what is asked for most stays
        return known
    m = lib.ffi.new("zk_model *")
    alive = fill(m, record, model, bandwidth, inner, packed=packed)
    m.beyond = int(states == "beyond")
    m.unbent, m.b0, m.bd0 = released, *start
    if free_every:
        value, half, w = record.position, np.zeros(n), np.ones(n)
        m.m, m.half, m.w, m.reset = p(value), p(half), p(w), free_every
        ahead = _unseen(record, model, bandwidth, inner)
        if ahead is not None:
            m.rb, m.rbd = p(ahead[0]), p(ahead[1])
    if extra is not None:
        m.extra = p(extra)
    r = np.empty(n)
    xq, xqd, torque = (np.empty(n), np.empty(n), np.empty(n)) if states else (None, None, None)
    out = [p(a) if a is not None else lib.ffi.NULL for a in (xq, xqd, torque)]
    diverged = int(lib.lib.zk_run(m, p(r), *out))
    del alive
    r.setflags(write=False)
    done = Run(r, xq, xqd, torque, diverged)
    if asked_again:
        _keep(record, key, done)
    return done


def unbent(record: JointRecord, model: Model, bandwidth: float, inner: int) -> float:
    """1 where the spring of a model is clearly not bent when a recording begins from rest: as of a
    machine that was let go then, and of most simulated ones. 0 where its load hangs still: the
    drives held it.

    (A load of an arm rang behind a motor that dry friction held. Fitted with it hanging, its spring
    had a damping six times too large, and was not claimed.)
    """
    if not _on_spring(record, model) or not (_rests(record) or _first_acceleration(record) == 0.0):
        return 0.0
    key = "unbent", _key(record, model, pack(model.at(record.joint)), bandwidth, inner, 0)
    if key not in record.begun:
        rows = min(record.n, round(SHOWS_START / record.sample_time))
        near = [_harder(model, record.joint, by) for by in NEARBY]

        def least(start: tuple[float, float, float]) -> float:
            left = (_from(record, m, bandwidth, inner, start, rows) for m in near)
            return min(float(r @ r) for r in left)

        clear = least((1.0, 0.0, 0.0)) < CLEARER * least((0.0, 0.0, 0.0))
        record.begun[key] = float(clear), 0.0
    return record.begun[key][0]


def _harder(model: Model, joint: int, by: float) -> Model:
    """The model with stiffer springs between motor and load of a joint, by a factor."""

    def moved(term: Term) -> Term:
        if term.joint != joint or get_effect(term.effect).family != "transmission":
            return term
        same = term.parameters.items()
        numbers = {k: replace(q, value=by * q.value) if k == "stiffness" else q for k, q in same}
        return replace(term, parameters=numbers)

    return model.with_terms(tuple(moved(t) for t in model.terms))


def _on_spring(record: JointRecord, model: Model) -> bool:
    """Whether a load is on a spring without a gap."""
    springs = (t for t in model.at(record.joint) if "stiffness" in t.parameters)
    kinds = [get_effect(t.effect) for t in springs]
    return any(e.family == "transmission" and not e.rough for e in kinds)


def _rests(record: JointRecord) -> bool:
    """Whether a joint does not move when a recording begins."""
    first = record.position[: max(2, round(3.0 * AT_FIRST / record.sample_time))]
    return float(np.ptp(first)) < AT_REST * record.measurement.std


def _begun(
    record: JointRecord, model: Model, bandwidth: float, inner: int, released: float
) -> tuple[float, float]:
    """By how much the unseen side of a spring is ahead of where it would be, rad or m, and how much
    faster, where a recording begins in motion: it may ring. Both are fitted to all innovations by
    steps of Gauss and Newton; 0 where that is no better.
    """
    if not _on_spring(record, model) or _rests(record):
        return 0.0, 0.0
    key = _key(record, model, pack(model.at(record.joint)), bandwidth, inner, 0)
    if key not in record.begun:
        off = max(record.measurement.std, 1e-12)
        steps = np.diag([off, off / AT_FIRST])

        def left_by(start: Array) -> Array:
            at = (released, float(start[0]), float(start[1]))
            return _from(record, model, bandwidth, inner, at, record.n)

        kept, left = np.zeros(2), left_by(np.zeros(2))
        for _ in range(STARTS):
            moved = [left_by(kept + s) - left for s in steps]
            found = np.linalg.lstsq(np.stack(moved, axis=1), left, rcond=None)[0]
            start = kept - found @ steps
            then = left_by(start)
            if not float(then @ then) < float(left @ left):
                break
            kept, left = start, then
        record.begun[key] = float(kept[0]), float(kept[1])
    return record.begun[key]


def _from(
    record: JointRecord,
    model: Model,
    bandwidth: float,
    inner: int,
    start: tuple[float, float, float],
    rows: int,
) -> Array:
    """Innovations of the first ``rows`` from a ``start`` of the unseen side."""
    lib = native()
    m = lib.ffi.new("zk_model *")
    alive = fill(m, record, model, bandwidth, inner)
    m.unbent, m.b0, m.bd0 = start
    m.n = rows
    r = np.empty(rows)
    lib.lib.zk_run(m, lib.doubles(r), lib.ffi.NULL, lib.ffi.NULL, lib.ffi.NULL)
    del alive
    return np.clip(r, -RAN_AWAY, RAN_AWAY)


def _keep(record: JointRecord, key: tuple[object, ...], done: Run) -> None:
    record.runs[key] = done
    while len(record.runs) > REMEMBERED:
        record.runs.pop(list(record.runs)[0], None)  # noqa: RUF015  in one step: threads


def _unseen(
    record: JointRecord, model: Model, bandwidth: float, inner: int
) -> tuple[Array, Array] | None:
    """The lead of the unmeasured side of a transmission by an observer's estimate: position and
    speed, (n,) each; None where motor and load are one.
    """
    if not any(get_effect(t.effect).family == "transmission" for t in model.at(record.joint)):
        return None
    seen = run(record, model, bandwidth, inner=inner, states="seen", begun=True)
    beyond = run(record, model, bandwidth, inner=inner, states="beyond", begun=True)
    if seen.q is None or seen.qd is None or beyond.q is None or beyond.qd is None:
        return None
    return beyond.q - seen.q, beyond.qd - seen.qd


def run_many(
    record: JointRecord, models: Sequence[Model], bandwidth: float, *, inner: int = 2
) -> Array:
    """Weighted innovations of several models that differ in numbers only, (n, models): eight take
    little longer than two.

    Parameters
    ----------
    models : sequence of Model
        Of the same terms in the same order, in kernel form; a coupling's joint and law are the same
        too. Those that are the same for this joint are run once.
    bandwidth, inner
        As for ``run``.
    """
    lib, n = native(), record.n
    released = unbent(record, models[0], bandwidth, inner)
    places: dict[bytes, int] = {}
    packed = [pack(model.at(record.joint)) for model in models]
    place = [
        places.setdefault(_numbers(record, model, table), len(places))
        for model, (_, table) in zip(models, packed, strict=True)
    ]
    unlike = [models[place.index(i)] for i in range(len(places))]
    tables = [packed[place.index(i)] for i in range(len(places))]
    out = np.empty((n, len(unlike)))
    for begin in range(0, len(unlike), LANES):
        some = unlike[begin : begin + LANES]
        if len(some) == 1:
            out[:, begin] = run(record, some[0], bandwidth, inner=inner).innovations
            continue
        m = lib.ffi.new("zk_model[]", LANES)
        known: dict[tuple[float, ...], tuple[Array, Array]] = {}
        alive = [
            fill(m + i, record, model, bandwidth, inner, known, tables[begin + i])
            for i, model in enumerate(some)
        ]
        finest = max(m[i].sub for i in range(len(some)))  # all take the same steps
        stiff = max(m[i].stiff for i in range(len(some)))
        for i in range(LANES):
            if i >= len(some):
                m[i] = m[0]  # idle
            m[i].sub, m[i].stiff, m[i].unbent = finest, stiff, released
        r = np.empty((n, LANES))
        lib.lib.zk_run_lanes(m, lib.doubles(r))
        out[:, begin : begin + len(some)] = r[:, : len(some)]
        del alive
    return out if len(unlike) == len(models) else out[:, place]


def _numbers(record: JointRecord, model: Model, table: Array) -> bytes:
    """The numbers of a model on which one joint's prediction depends; ``table``: of its effects."""
    j = record.joint
    numbers = [mechanism_value(model, key, j) for key in record.basis]
    numbers += [
        mechanism_value(model, "gravity", j),
        per_joint(model.actuator.gain, j, 1.0),
        per_joint(model.actuator.limit, j, 0.0),
    ]
    numbers += [model.actuator.delay, per_joint(model.sensor.offset, j, 0.0)]
    numbers += _body_numbers(model)
    return table.tobytes() + np.array(numbers).tobytes()


def _key(
    record: JointRecord,
    model: Model,
    packed: tuple[npt.NDArray[np.int32], Array],
    bandwidth: float,
    inner: int,
    free_every: int,
) -> tuple[object, ...]:
    """The key of one joint's prediction: all that it depends on. ``packed``: its effects."""
    kinds, table = packed
    bodies = tuple((t.effect, t.joint) for t in body_terms(model))
    numbers = _numbers(record, model, table)
    whole = model.kind, model.sensor.side, kinds.tobytes(), numbers, bodies
    return record.number, whole, bandwidth, inner, free_every


def _body_numbers(model: Model) -> tuple[float, ...]:
    """All numbers of a model's bodies: every joint's inertia and bias may depend on them."""
    return tuple(q.value for term in body_terms(model) for q in term.parameters.values())


def fill(
    m: Any,
    record: JointRecord,
    model: Model,
    bandwidth: float,
    inner: int,
    known: dict[tuple[float, ...], tuple[Array, Array]] | None = None,
    packed: tuple[npt.NDArray[np.int32], Array] | None = None,
) -> list[Any]:
    """Fill a zk_model, given as a pointer. What it points to must outlive the call: it is returned,
    or the record's. ``known``: inertia and bias by mechanism values; ``packed``: the joint's
    effects, where they are packed already.
    """
    lib = native()
    p, ffi = lib.doubles, lib.ffi
    kinds, table = packed or pack(model.at(record.joint))
    values = tuple(
        1.0 if key == "fixed" else mechanism_value(model, key, record.joint) for key in record.basis
    ) + _body_numbers(model)
    known = {} if known is None else known
    if values not in known:
        known[values] = record.inertia_and_bias(model)
    inertia, bias = known[values]
    if bandwidth not in record.filled:
        record.filled[bandwidth] = _of_record(record, bandwidth)  # the same by any thread
    ffi.memmove(m, record.filled[bandwidth], ffi.sizeof("zk_model"))
    m.sub, m.stiff = steps(record, model, inertia, inner)
    m.delay = model.actuator.delay
    m.gain = per_joint(model.actuator.gain, record.joint, 1.0)
    m.limit = per_joint(model.actuator.limit, record.joint, 0.0)
    fill_rigid(m, record, model, inertia, bias)
    own = own_terms(model.at(record.joint))
    felt(record, own)  # refuses what reads a column that is not there
    m.nfx, m.kind, m.p = len(own), ffi.cast("int *", ffi.from_buffer(kinds)), p(table)
    fill_shift(m, record, per_joint(model.sensor.offset, record.joint, 0.0))
    m.load_sensor = 1 if model.sensor.side == "load" else 0
    return [kinds, table, inertia, bias]


def _of_record(record: JointRecord, bandwidth: float) -> Any:
    """A zk_model with all that is independent of the model; the record keeps what it points to."""
    lib = native()
    p, m = lib.doubles, lib.ffi.new("zk_model *")
    rq, rqd = record.motion.states[0], record.motion.states[1]
    m.n, m.T, m.ucum = record.n, record.sample_time, p(record.integral)
    m.m, m.half = p(record.measurement.value), p(record.measurement.half)
    m.k1, m.k2, m.w = (p(gain) for gain in record.gains(bandwidth))
    m.other, m.temperature = p(record.others), p(felt(record, ()))
    m.qd0, m.a0 = float(rqd[0]), _first_acceleration(record)
    m.rq, m.rqd, m.t0 = p(rq), p(rqd), record.began
    return m


def _first_acceleration(record: JointRecord) -> float:
    """The acceleration of a motion already under way when a recording begins, rad/s²; 0 from rest,
    where nothing has bent a spring yet.
    """
    soon = min(record.n - 1, max(1, round(AT_FIRST / record.sample_time)))
    speed = record.motion.states[1]
    gained = float(speed[soon] - speed[0])
    return 0.0 if abs(speed[0]) < abs(gained) else gained / (soon * record.sample_time)


def steps(record: JointRecord, model: Model, inertia: Array, inner: int) -> tuple[int, bool]:
    """Integration steps per sample, ``inner`` or more, and whether even these are too few for the
    joint's damping. A small inertia with much viscous friction stops in less than a step, and an
    explicit step longer than twice that time diverges.
    """
    damping = sum(
        max([0.0, *(term.value(p.name) for p in effect.parameters if p.size == "torque/speed")])
        for term in model.at(record.joint)
        if (effect := get_effect(term.effect)).mechanism == "fluid_friction"
    )
    least = max(float(np.min(inertia)) + added_inertia(model, record.joint), 1e-12)
    wanted = damping * record.sample_time / (LONGEST * least)
    while inner < min(wanted, MOST_STEPS):
        inner *= 2
    return inner, inner < wanted


def fill_rigid(m: Any, record: JointRecord, model: Model, inertia: Array, bias: Array) -> None:
    """Fill in inertia and torque of the rigid body; the arrays must outlive the call."""
    p = native().doubles
    m.inertia, m.bias, m.reference = p(inertia), p(bias), record.reference_inertia(model, inertia)
    loose = any(get_effect(t.effect).family == "transmission" for t in model.at(record.joint))
    m.bias_slope = p(record.bias_slope(model)) if loose and bias.any() else native().ffi.NULL
    m.gravity = mechanism_value(model, "gravity", record.joint) if model.kind == "rotary" else 0.0


def fill_shift(m: Any, record: JointRecord, offset: float) -> None:
    """Fill in the sensor's zero, and with it the start of the prediction."""
    m.shift = offset - record.base_offset
    m.q0 = float(record.motion.states[0][0] + m.shift)


def felt(record: JointRecord, terms: tuple[Term, ...]) -> Array:
    """The temperature column, (n,) °C; empty where there is none and no term asks for it.

    Raises
    ------
    RecordingError
        A term reads a column that the recording has not.
    """
    for term in terms:
        for column in get_effect(term.effect).reads:
            if column not in record.columns:
                raise RecordingError(
                    f"the model's {term.effect} of joint {term.joint} needs a column of {column}:"
                    f" name it in [columns] {column}"
                )
    felt = record.columns.get("temperature", _NOTHING)
    if len(felt) not in (0, record.n):
        raise RecordingError(
            f"temperature has {len(felt)} rows; expected {record.n}, as many as the position"
        )
    return felt
