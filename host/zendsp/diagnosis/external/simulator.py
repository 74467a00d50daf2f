"""A black-box simulator (``kind = "python"`` or ``"fmu"``): finds it, calls it, and adds effects to
its input.
"""

from __future__ import annotations

import contextlib
import faulthandler
import importlib
import importlib.util
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.signals import Signals, joint_columns
from zendsp.diagnosis.external.columns import Columns, Parameters
from zendsp.errors import ModelError
from zendsp.physics.calibration.joint import JointRecord, along
from zendsp.physics.calibration.observed import sensed, trace
from zendsp.physics.effects import Effect, get_effect, library
from zendsp.physics.effects.base import Scale
from zendsp.physics.kernel.signals import measure, noise_beside_quantisation, smooth
from zendsp.physics.model import Model, per_joint

Array = npt.NDArray[np.float64]
Function = Callable[[Columns, Parameters], npt.ArrayLike]


class Simulator(Protocol):
    """The interface of a simulator: recordings in, positions out."""

    name: str  # in sentences

    def run(self, recordings: Sequence[Columns], parameters: Parameters) -> list[Array]:
        """The position at every row of each recording."""

    def close(self) -> None:
        """Release processes and folders."""


class Entry:
    """The Python function that ``entry`` names; it is called in this process, so that a crash of
    its libraries ends it too: the last lines then name the line of the simulator.
    """

    def __init__(self, model: Model) -> None:
        if not faulthandler.is_enabled():
            with contextlib.suppress(AttributeError, OSError, ValueError):  # no standard error
                faulthandler.enable(sys.__stderr__ or sys.stderr, all_threads=False)
        self.function, self.name = load_entry(model), f"the simulator {model.entry!r}"

    def run(self, recordings: Sequence[Columns], parameters: Parameters) -> list[Array]:
        """One call a recording."""
        try:
            return [np.asarray(self.function(r, parameters), float) for r in recordings]
        except Exception as error:
            raise ModelError(f"{self.name} failed: {type(error).__name__}: {error}") from error

    def close(self) -> None:
        """Nothing to release."""


def simulator_of(model: Model, jobs: int) -> Simulator:
    """The simulator of a model whose kind is in ``CALLED``."""
    if model.kind == "fmu":
        from zendsp.diagnosis.external.fmu import Fmu

        return Fmu(model, jobs)
    return Entry(model)


def on_timing() -> list[Effect]:
    """The effects that act on the command's timing."""
    return [effect for effect in library().values() if effect.retime is not None]


def on_input(effect: Effect) -> bool:
    """Whether an effect can act on a simulator's input or output, unlike one with states inside the
    simulator.
    """
    return effect.site not in ("setup", "body") or effect.retime is not None or bool(effect.same_as)


def load_entry(model: Model) -> Function:
    """The function that ``entry = "module:function"`` names; the module may stand beside the model
    file.

    Raises
    ------
    ModelError
        There is no such module or function, or the module cannot be imported.
    """
    module_name, _, name = model.entry.partition(":")
    if not module_name or not name:
        raise ModelError(f"[mechanism] entry = {model.entry!r}: expected \"module:function\"")
    beside = model.folder / (module_name.replace(".", "/") + ".py")
    try:
        if beside.exists():
            spec = importlib.util.spec_from_file_location(
                f"zendsp_simulator_{module_name.replace('.', '_')}", beside
            )
            assert spec is not None and spec.loader is not None
            module = importlib.util.module_from_spec(spec)
            sys.modules[spec.name] = module
            spec.loader.exec_module(module)
        else:
            module = importlib.import_module(module_name)
    except Exception as error:
        raise ModelError(
            f"[mechanism] entry = {model.entry!r}: module {module_name!r} cannot be imported"
            f" ({type(error).__name__}: {error}); it is looked for beside the model file and on the"
            " Python path"
        ) from error
    function = getattr(module, name, None)
    if not callable(function):
        raise ModelError(
            f"[mechanism] entry = {model.entry!r}: module {module_name!r} has no function {name!r}"
        )
    return function  # type: ignore[no-any-return]


@dataclass
class Bench:
    """One recording with its smoothed motion, and the simulator that is to reproduce it.

    ``size``: rows of a window; each is given to the simulator as a recording of its own. 0: the
    whole recording at once.
    """

    signals: Signals
    records: tuple[JointRecord, ...]
    simulator: Simulator
    given: Model
    size: int = 0
    blur: float = 1.0  # times the speed below which the direction of motion is not known
    calls: int = 0
    ran: Callable[[], None] = lambda: None  # called for each simulation

    @property
    def n(self) -> int:
        """Number of samples."""
        return len(self.signals.time)

    @property
    def unit(self) -> str:
        """The unit of the first joint's position."""
        return "m" if self.given.joint_kind(1) == "linear" else "rad"

    def simulate(self, model: Model) -> Array:
        """The simulated position with a model's parameters and effects, (n, joints), rad or m.

        Raises
        ------
        ModelError
            The user's function fails or returns something else.
        """
        return self.sensed(self.run(self.command(model), model), model)

    def run(self, command: Array, model: Model) -> Array:
        """The simulator's response to a command, (n, joints), without effects on the sensor."""
        parameters = {
            k: items[0].value if len(items) == 1 else [q.value for q in items]
            for k, items in model.mechanism.items()
        }
        step = self.size or self.n
        rows = [slice(a, min(a + step, self.n)) for a in range(0, self.n, step)]
        recordings = [self._recording(command, r) for r in rows]
        parts = []
        for recording, part in zip(
            recordings, self.simulator.run(recordings, parameters), strict=True
        ):
            out = part[:, None] if np.ndim(part) == 1 else part
            wanted = (len(recording["time"]), len(self.records))
            if out.shape != wanted:
                raise ModelError(
                    f"{self.simulator.name} returned shape {out.shape} for {self.signals.name};"
                    f" expected {wanted}: a position for every row"
                )
            parts.append(out)
        self.calls += 1
        self.ran()
        return np.concatenate(parts)

    def _recording(self, command: Array, rows: slice) -> Columns:
        """Rows of the recording as input of a simulator."""
        s = self.signals
        velocity = np.stack([r.motion.states[1] for r in self.records], axis=1)[rows]
        position = s.position[rows].copy()
        if self.size:  # smoothed, since a count would be an error of velocity
            position[0] = [r.motion.states[0][rows.start] for r in self.records]

        def shaped(values: Array) -> Array:
            return values[:, 0] if values.shape[1] == 1 else values

        return {
            "time": s.time[rows] - s.time[rows.start],
            "sample_time": s.sample_time,
            "position": shaped(position),
            "velocity": shaped(velocity),
            "command": shaped(command[rows]),
            "reference": None if s.reference is None else shaped(s.reference[rows]),
        }

    def error(self, model: Model) -> Array:
        """Measured minus simulated position, (n, joints); for windows without the part that an
        error of their initial position and velocity explains.
        """
        return self.told(self.signals.position - self.simulate(model))

    def told(self, e: Array) -> Array:
        """Errors (n, joints) without the mean and slope of each window."""
        if not self.size:
            return e
        out = np.empty_like(e)
        whole = self.n - self.n % self.size
        for rows, count in ((slice(0, whole), self.size), (slice(whole, None), self.n - whole)):
            if count:
                part = e[rows].reshape(-1, count, e.shape[1])
                x = np.linspace(-1.0, 1.0, count)[None, :, None] if count > 1 else np.zeros(1)
                slope = (x * part).sum(axis=1, keepdims=True) / max(float((x * x).sum()), 1e-300)
                left = part - part.mean(axis=1, keepdims=True) - x * slope
                out[rows] = left.reshape(-1, e.shape[1])
        return out

    def command(self, model: Model) -> Array:
        """The recorded command less the torque of a model's effects, (n, joints)."""
        return np.stack([self.command_of(i, model) for i in range(len(self.records))], axis=1)

    def command_of(self, i: int, model: Model) -> Array:
        """The command of one joint (0-based) less its effects, (n,)."""
        record = self.records[i]
        gain = per_joint(model.actuator.gain, i + 1, 1.0)
        effects = [(t, get_effect(t.effect)) for t in model.at(i + 1)]
        terms = tuple(t for t, effect in effects if effect.site not in ("setup", "sensor"))
        floor = max(
            2.0 * float(np.sqrt(np.median(record.motion.variances[1]))),
            0.01 * record.scale.speed,
        ) * self.blur
        torque = trace(record, model, terms, floor) if terms else np.zeros(record.n)
        motion, command = along(record, model), self._arrived(record)
        for term, effect in effects:
            numbers = {name: q.value for name, q in term.parameters.items()}
            if effect.retime is not None:
                command = effect.retime(command, record.sample_time, numbers)
            elif effect.column is not None and on_input(effect):
                torque = torque + effect.column(motion, numbers)
        # held from its row to the next: the effects of both are averaged
        held = 0.5 * (torque + np.r_[torque[1:], torque[-1:]])
        return np.asarray(command - held / gain, dtype=np.float64)

    def _arrived(self, record: JointRecord) -> Array:
        """A joint's command as late as ``[actuator] delay`` says, (n,)."""
        late, moved = self.given.actuator.delay, get_effect("delay").retime
        if not late or moved is None:
            return record.command
        before = record.command[0]  # what was commanded before the first row is not known
        arrived = before + moved(record.command - before, record.sample_time, {"time": late})
        return np.asarray(arrived, dtype=np.float64)

    def sensed(self, out: Array, model: Model) -> Array:
        """The readings of the position sensors for a simulated motion, (N, joints)."""
        out = out.copy()
        for i, record in enumerate(self.records):
            if terms := tuple(t for t in model.at(i + 1) if get_effect(t.effect).site == "sensor"):
                out[:, i] += sensed(record, terms, np.ascontiguousarray(out[:, i]))
        return np.clip(np.nan_to_num(out, nan=1e6), -1e6, 1e6)


def bench(signals: Signals, model: Model, simulator: Simulator) -> Bench:
    """The bench of a recording: its smoothed motion, along which effects are evaluated, and the
    simulator.
    """
    count = signals.position.shape[1]
    measurements, motions = [], []
    for i in range(count):
        y = np.ascontiguousarray(signals.position[:, i])
        resolution = float(signals.resolution[i])
        measurements.append(
            measure(y, signals.sample_time, resolution, noise_beside_quantisation(y, resolution))
        )
        motions.append(smooth(measurements[i], signals.sample_time))
    others = np.ascontiguousarray(np.stack([m.states for m in motions]))
    records = []
    for i in range(count):
        q, qd, qdd = motions[i].states
        gain = per_joint(model.actuator.gain, i + 1, 1.0)
        effort = float(np.sqrt(np.mean((gain * signals.command[:, i]) ** 2)))
        rms = float(np.sqrt(np.mean(qdd**2)))
        known = next((model.mechanism[k] for k in ("inertia", "mass") if k in model.mechanism), ())
        inertia = (
            known[min(i, len(known) - 1)].value if known else effort / max(rms, 1e-12)
        ) or 1.0
        scale = Scale(
            torque=effort or abs(inertia) * rms,
            speed=max(float(np.sqrt(np.mean(qd**2))), 1e-9),
            position=max(float(np.ptp(q)), 1e-9),
            inertia=abs(inertia),
            command=max(float(np.sqrt(np.mean(signals.command[:, i] ** 2))), 1e-12),
            seconds=float(signals.time[-1] - signals.time[0]),
        )
        records.append(
            JointRecord(
                joint=i + 1,
                sample_time=signals.sample_time,
                t0=float(signals.time[0]),
                origin=float(signals.time[0]),
                command=np.ascontiguousarray(signals.command[:, i]),
                measurement=measurements[i],
                motion=motions[i],
                basis={},
                others=others,
                scale=scale,
                base_offset=0.0,
                position=np.ascontiguousarray(signals.position[:, i]),
                columns=joint_columns(signals, i),
            )
        )
    return Bench(signals, tuple(records), simulator, model)
