"""A co-simulation FMU (FMI 2.0 and 3.0) as a black-box simulator.

An FMU is foreign machine code. Each of its instances lives in a process of its own, with its own
unpacked folder: a crash, an endless step or a flood of output affects that process only, never the
diagnosis. Each simulation begins anew (reset and replay), since many FMUs cannot save their state.
"""

from __future__ import annotations

import ctypes
import difflib
import faulthandler
import multiprocessing
import os
import signal
import tempfile
import time
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.external.columns import Columns, Parameters
from zendsp.errors import ModelError
from zendsp.extras import need
from zendsp.physics.model import Model
from zendsp.recording.units import to_si

Array = npt.NDArray[np.float64]

DONE_ONE = ""  # what a worker says after simulations, before its answer
SAYS_EVERY = 0.01  # s between that, at least
TIME_LIMIT = 60.0  # s, for one recording or window; [mechanism] time_limit
REAL = ("Real", "Float64")
LOG = "said.txt"  # output of an FMU


@dataclass(frozen=True)
class Work:
    """Simulations for a worker, in units of the FMU: one message, since a simulation of a few rows
    takes less time than to send its recording.

    Attributes
    ----------
    numbers : list of float
        Parameters, the same for all.
    begin : ndarray, shape (simulations, …)
        The values of start_position and start_velocity.
    command : list of ndarray, shape (rows, joints)
        One for each; one array where all have as many rows.
    steps : list of float
        s
    """

    numbers: list[float]
    begin: Array
    command: Array | list[Array]
    steps: list[float]


@dataclass(frozen=True)
class Ports:
    """Value references of an FMU's variables, in the order of the joints."""

    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    start_position: tuple[int, ...]
    start_velocity: tuple[int, ...]
    parameters: Mapping[str, int]
    units: Mapping[int, tuple[float, float]]  # by reference: SI = factor * value + offset

    def told(self, references: Sequence[int], values: Array) -> Array:
        """Values in SI as the FMU wants them, (…, references)."""
        if not references:
            return values[..., :0]
        factor, offset = np.array([self.units[r] for r in references]).T
        out: Array = (values - offset) / factor
        return out

    def said(self, values: Array) -> Array:
        """Outputs of the FMU in SI, (…, joints)."""
        factor, offset = np.array([self.units[r] for r in self.outputs]).T
        out: Array = factor * values + offset
        return out


class Fmu:
    """Processes that simulate one FMU.

    Parameters
    ----------
    model : Model
        Of ``kind = "fmu"``.
    jobs : int
        Number of processes.

    Raises
    ------
    ModelError
        Not a co-simulation FMU for this computer, or variables that it does not have.
    """

    def __init__(self, model: Model, jobs: int) -> None:
        path = Path(model.file) if Path(model.file).is_absolute() else model.folder / model.file
        self.name = f"[mechanism] file = {model.file!r}"
        if not path.is_file():
            raise ModelError(f"{self.name}: no such file beside the model ({path})")
        self.path, self.limit = path, model.fmu.time_limit or TIME_LIMIT
        self.fmpy = need("fmpy", "fmpy", 'a model of kind = "fmu"', ModelError)
        self.description = self._described()
        self.ports = self._ports(model)
        self.workers = [_Worker(self) for _ in range(max(1, jobs))]

    def _described(self) -> Any:
        try:
            description = self.fmpy.read_model_description(str(self.path), validate=False)
            with zipfile.ZipFile(self.path) as archive:
                files = [name.split("/") for name in archive.namelist()]
        except Exception as error:  # of zipfile, lxml, and fmpy's own
            said = " ".join(str(error).split())
            if isinstance(error, (AttributeError, KeyError, TypeError)):  # fmpy, of what it misses
                said = "its modelDescription.xml is missing, or is none of FMI 2.0 or 3.0"
            raise ModelError(f"{self.name}: is not an FMU that can be read: {said}") from error
        if not str(description.fmiVersion).startswith(("2.", "3.")):
            raise ModelError(f"{self.name}: is FMI {description.fmiVersion}; expected 2.0 or 3.0")
        if description.coSimulation is None:
            raise ModelError(
                f"{self.name}: has no co-simulation; export it as a co-simulation FMU, with its"
                " solver"
            )
        platforms = sorted({f[1] for f in files if f[0] == "binaries" and len(f) > 2 and f[2]})
        if not {self.fmpy.platform, self.fmpy.platform_tuple} & set(platforms):
            raise ModelError(
                f"{self.name}: has no binary for {self.fmpy.platform} (it has"
                f" {', '.join(platforms) or 'none'}): export it for this computer"
            )
        return description

    def _ports(self, model: Model) -> Ports:
        variables = {v.name: v for v in self.description.modelVariables}

        def references(key: str, names: Sequence[str], causality: str = "") -> tuple[int, ...]:
            out = []
            for name in names:
                v = variables.get(name)
                if v is None:
                    near = difflib.get_close_matches(name, list(variables), 3)
                    raise ModelError(
                        f"{self.name}: {key}: the FMU has no variable {name!r}; "
                        + (f"did you mean {', '.join(near)}?" if near else
                           f"it has {', '.join(list(variables)[:12])}")
                    )  # fmt: skip
                if v.type not in REAL or (causality and v.causality != causality):
                    wanted = f"a real {causality or 'number'}"
                    raise ModelError(
                        f"{self.name}: {key} {name!r} is of type {v.type}, causality"
                        f" {v.causality}; expected {wanted}"
                    )
                out.append(int(v.valueReference))
            return tuple(out)

        def column(role: str) -> Sequence[str]:
            spec = model.columns.get(role, [])
            return [spec] if isinstance(spec, str) else list(spec)

        inputs = model.fmu.inputs or column("command")
        outputs = model.fmu.outputs or column("position")
        starts = (model.fmu.start_position, model.fmu.start_velocity)
        for key, names in zip(("inputs", "start_position", "start_velocity"), (inputs, *starts),
                              strict=True):  # fmt: skip
            if names and len(names) != len(outputs):
                raise ModelError(
                    f"{self.name}: {key} has {len(names)} names, outputs {len(outputs)}; expected"
                    " one for each joint"
                )
        return Ports(
            references("inputs", inputs, "input"),
            references("outputs", outputs, "output"),
            references("start_position", starts[0]),
            references("start_velocity", starts[1]),
            {name: references("[mechanism.parameters]", [name])[0] for name in model.mechanism},
            {
                int(variables[name].valueReference): _unit(self.description, variables[name])
                for name in (*inputs, *outputs, *starts[0], *starts[1])
            },
        )

    def run(self, recordings: Sequence[Columns], parameters: Parameters) -> list[Array]:
        """Positions of all recordings, (n, joints) each, simulated side by side."""
        shares = np.array_split(np.arange(len(recordings)), len(self.workers))
        busy = [(w, share) for w, share in zip(self.workers, shares, strict=True) if len(share)]
        for worker, share in busy:
            worker.send(self._work([recordings[i] for i in share], parameters))
        return [self.ports.said(out) for worker, _ in busy for out in worker.receive()]

    def _work(self, recordings: Sequence[Columns], parameters: Parameters) -> Work:
        p = self.ports
        q, qd = (
            np.array([np.atleast_1d(x[0]) for x in values], dtype=np.float64)
            for values in zip(*((r["position"], r["velocity"]) for r in recordings), strict=True)
        )
        begin = [p.told(p.start_position, q), p.told(p.start_velocity, qd)]
        each = [np.asarray(r["command"], float).reshape(len(r["time"]), -1) for r in recordings]
        alike = len({len(c) for c in each}) == 1
        command = p.told(p.inputs, np.array(each)) if alike else [p.told(p.inputs, c) for c in each]
        return Work(
            [float(np.atleast_1d(parameters[name])[0]) for name in p.parameters],
            np.concatenate(begin, axis=1), command, [float(r["sample_time"]) for r in recordings],
        )  # fmt: skip

    def close(self) -> None:
        """End the processes and remove their folders."""
        for worker in self.workers:
            worker.close()


class _Worker:
    """One process with one instance."""

    def __init__(self, fmu: Fmu) -> None:
        self.fmu, self.folder = fmu, tempfile.TemporaryDirectory(prefix="zendsp-fmu-")
        context = multiprocessing.get_context("fork")
        self.pipe, child = context.Pipe()
        self.process = context.Process(
            target=_serve, args=(child, self.pipe, fmu, self.folder.name), daemon=True
        )
        self.process.start()
        child.close()

    def send(self, work: Work) -> None:
        try:
            self.pipe.send(work)
        except OSError:
            raise self._crash() from None

    def receive(self) -> list[Array]:
        answer: str | Sequence[Array] = DONE_ONE
        while isinstance(answer, str) and answer == DONE_ONE:
            if not self.pipe.poll(self.fmu.limit):
                self.process.kill()
                raise ModelError(
                    f"{self.fmu.name}: the FMU did not answer within {self.fmu.limit:g} s; raise"
                    " [mechanism] time_limit, or shorten the recording"
                )
            try:
                answer = self.pipe.recv()
            except (EOFError, OSError):
                raise self._crash() from None
        if isinstance(answer, str):
            raise ModelError(f"{self.fmu.name}: the FMU failed: {answer}{self._said()}")
        return list(answer)

    def _crash(self) -> ModelError:
        self.process.join(5.0)
        code = self.process.exitcode or 0
        how = f"by {signal.Signals(-code).name}" if code < 0 else f"with status {code}"
        return ModelError(f"{self.fmu.name}: the FMU ended its process {how}{self._said()}")

    def _said(self) -> str:
        try:
            text = (Path(self.folder.name) / LOG).read_bytes()[-2000:].decode(errors="replace")
        except OSError:
            return ""
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        return f"; the last that it said: {lines[-1][:200]}" if lines else ""

    def close(self) -> None:
        self.pipe.close()
        if self.process.is_alive():
            self.process.kill()
        self.process.join()
        self.folder.cleanup()


def _serve(pipe: Any, other: Any, fmu: Fmu, folder: str) -> None:
    """The loop of a worker process, which answers with positions or with the sentence of an error.
    """
    other.close()
    faulthandler.disable()  # its crash becomes one sentence
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the diagnosis handles Ctrl-C
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # by which it ends this process
    said = os.open(str(Path(folder) / LOG), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(said, 1)
    os.dup2(said, 2)
    instance = None
    while True:
        try:
            work = pipe.recv()
        except EOFError:
            os._exit(0)  # skips exit handlers of the FMU
        try:
            instance, told = instance or _Instance(fmu, folder), time.monotonic()
            answer: Any = []
            for begin, command, step in zip(work.begin, work.command, work.steps, strict=True):
                answer.append(instance.simulate([*work.numbers, *begin], command, step))
                if (now := time.monotonic()) > told + SAYS_EVERY:
                    pipe.send(DONE_ONE)
                    told = now
            if not isinstance(work.command, list):
                answer = np.array(answer)
        except Exception as error:
            answer, instance = " ".join(f"{type(error).__name__}: {error}".split()), None
        pipe.send(answer)


class _Instance:
    """An FMU in this process; FMI 2.0 and 3.0 behind one interface."""

    def __init__(self, fmu: Fmu, folder: str) -> None:
        d, self.ports, self.fmpy = fmu.description, fmu.ports, fmu.fmpy
        unpacked = str(Path(folder) / "fmu")
        self.fmpy.extract(str(fmu.path), unpacked)
        self.three = str(d.fmiVersion).startswith("3.")
        if self.three:
            from fmpy.fmi3 import FMU3Slave as Slave
        else:
            from fmpy.fmi2 import FMU2Slave as Slave
        self.slave: Any = Slave(
            instanceName="zendsp", guid=d.guid, unzipDirectory=unpacked,
            modelIdentifier=d.coSimulation.modelIdentifier,
        )
        self.fresh = False
        self._make()

    def _make(self) -> None:
        self.slave.instantiate()
        self.fresh, self.calls = True, self._calls()

    def _again(self) -> None:
        """Return to the state before initialisation, by reset or by a new instance."""
        if self.fresh:
            return
        try:
            self.slave.terminate()
            self.slave.reset()
        except Exception:
            self.slave.fmi3FreeInstance(self.slave.component) if self.three else (
                self.slave.fmi2FreeInstance(self.slave.component)
            )
            self._make()

    def _set(self, references: Sequence[int], values: Sequence[float] | Array) -> None:
        if references:
            put = self.slave.setFloat64 if self.three else self.slave.setReal
            put(list(references), [float(v) for v in values])

    def simulate(self, begin: Sequence[float], command: Array, step: float) -> Array:
        """Output at every row, (n, joints), with values of the parameters and of the start."""
        s, p = self.slave, self.ports
        self._again()
        self.fresh = False
        if not self.three:
            s.setupExperiment(startTime=0.0)
        # at once: each call of an FMU's costs as much as a row of a small one
        self._set((*p.parameters.values(), *p.start_position, *p.start_velocity), begin)
        if self.three:
            s.enterInitializationMode(startTime=0.0)
        else:
            s.enterInitializationMode()
        self._set(p.inputs, command[0])
        s.exitInitializationMode()
        return self._replayed(command, step)

    def _replayed(self, command: Array, step: float) -> Array:
        """The outputs of all rows. A row costs three foreign calls and no fmpy objects, which would
        take ten times as long as a small FMU.
        """
        get, put, do = self.calls
        told, said = (ctypes.c_double * command.shape[1])(), (ctypes.c_double * len(
            self.ports.outputs))()  # fmt: skip
        rows, out = command.tolist(), []
        for k, u in enumerate(rows):
            _check("get", get(said))
            out.append(said[:])
            if k + 1 < len(rows):
                told[:] = u
                _check("set", put(told))
                _check("doStep", do(k * step, step))
        return np.array(out)

    def _calls(self) -> tuple[Any, Any, Any]:
        """The three functions for each row: with a buffer of outputs, with one of inputs, with time
        and step.
        """
        dll, c, p = self.slave.dll, self.slave.component, self.ports
        reads, writes = ((ctypes.c_uint * len(r))(*r) for r in (p.outputs, p.inputs))
        n, m = len(reads), len(writes)
        if not self.three:
            get, put, do = dll.fmi2GetReal, dll.fmi2SetReal, dll.fmi2DoStep
            return (
                lambda x: get(c, reads, n, x),
                lambda x: put(c, writes, m, x),
                lambda t, h: do(c, ctypes.c_double(t), ctypes.c_double(h), 1),
            )
        get, put, do = dll.fmi3GetFloat64, dll.fmi3SetFloat64, dll.fmi3DoStep
        flags, last = [ctypes.c_bool() for _ in range(3)], ctypes.c_double()
        told = (*(ctypes.byref(f) for f in flags), ctypes.byref(last))

        def step(t: float, h: float) -> int:
            done = do(c, ctypes.c_double(t), ctypes.c_double(h), ctypes.c_bool(True), *told)
            if flags[1].value:
                raise RuntimeError(f"it asked to end the simulation at t = {t:.4g} s")
            return int(done)

        return (
            lambda x: get(c, reads, ctypes.c_size_t(n), x, ctypes.c_size_t(n)),
            lambda x: put(c, writes, ctypes.c_size_t(m), x, ctypes.c_size_t(m)),
            step,
        )


def _unit(description: Any, variable: Any) -> tuple[float, float]:
    """Factor and offset from a variable's unit to SI: as the FMU defines it, else as its name says;
    one without a unit is in SI, as a column of a recording is.
    """
    name = variable.unit or getattr(variable.declaredType, "unit", None) or ""
    defined = next((u.baseUnit for u in description.unitDefinitions if u.name == name), None)
    if defined is not None:
        return float(defined.factor or 1.0), float(defined.offset or 0.0)
    known = to_si(name)
    return (known[0] if known else 1.0), 0.0


def _check(what: str, status: int) -> None:
    """Raise an error for any status but ok and warning."""
    if status > 1:
        words = ("ok", "warning", "discard", "error", "fatal")
        said = words[status] if status < len(words) else "unknown"
        raise RuntimeError(f"{what} answered {said} (status {status})")
