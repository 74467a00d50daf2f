"""Who a target is, how it is, and what it conceals."""

from __future__ import annotations

from zendsp_protocol.messages.base import Message
from zendsp_protocol.states import Clock, DriveMode, DriveState, ProgramState, TripReason
from zendsp_protocol.texts import counted
from zendsp_protocol.values import WireValue
from zendsp_protocol.views import html_table


class Info(Message, frozen=True, kw_only=True):
    """Who a target is; does not change while it lives."""

    v: int  # protocol version
    name: str  # of the target
    machine: str  # what it drives
    joints: int  # 0 before the first program is loaded
    rate_hz: float  # samples a second
    clock: Clock  # real or fast
    pid: int  # process of the monitor
    hostname: str  # machine on which it runs
    versions: dict[str, str]  # of zendsp, Python, the kernel and the libraries
    verbs: list[str]  # that this target answers
    started: float = 0.0  # Unix s
    instance: str = ""  # of this run of the target, hexadecimal: another after each start

    def __repr__(self) -> str:
        return (
            f"<Info {self.name}: {self.machine}, {self.rate_hz:g} Hz, {self.clock} clock, process"
            f" {self.pid} on {self.hostname}, zendsp {self.versions.get('zendsp', '?')}>"
        )


class Timing(Message, frozen=True):
    """Timing counted by the runtime; ns."""

    ticks: int = 0  # samples counted
    overruns: int = 0  # samples that took longer than the period
    missed: int = 0  # samples that were skipped
    exec_mean_ns: float = 0.0  # ns, time in the ISR
    exec_max_ns: int = 0  # ns
    late_mean_ns: float = 0.0  # ns, start of the ISR after its deadline
    late_max_ns: int = 0  # ns
    exec_histogram: WireValue = 0  # counts per bin
    late_histogram: WireValue = 0  # counts per bin
    histogram_edges_ns: WireValue = 0  # ns, one more than there are bins

    def __repr__(self) -> str:
        def spent(mean: float, most: float) -> str:
            return f"{mean / 1e3:.1f} (at most {most / 1e3:.1f}) us"

        return (
            f"<Timing {self.ticks} samples, {self.overruns} overruns, {self.missed} missed;"
            f" execution {spent(self.exec_mean_ns, self.exec_max_ns)},"
            f" late {spent(self.late_mean_ns, self.late_max_ns)}>"
        )


class Trip(Message, frozen=True):
    """Why the drive tripped."""

    # stop, stop input, host lost, torque, speed, position, command, nan, overrun, sensor, homing,
    # stall or outside
    reason: TripReason
    joint: int = 0  # from 1; 0 where none
    tick: int = 0  # sample at which it happened
    value: float = 0.0  # that broke the limit
    limit: float = 0.0  # that was broken, same unit
    text: str = ""  # a sentence for people
    cause: str = ""  # its first words: what broke which limit
    number: int = 0  # of trips, and STOPs beside them, of this target; moves on with a STOP
    idle: bool = False  # of position or speed: the program commands 0 to this joint


class Status(Message, frozen=True):
    """The state of the target now."""

    state: ProgramState  # empty, loaded, running, paused, stopped or crashed
    tick: int = 0  # samples since the program was loaded
    t: float = 0.0  # s since the program was loaded
    rate_hz: float = 0.0  # samples a second
    clock: Clock = Clock.REAL  # real or fast
    scheduling: str = ""  # a sentence: what the kernel granted and refused
    machine: str = ""  # name
    joints: int = 0  # number
    program: str = ""  # key of the loaded program
    timing: Timing = Timing()  # see Timing
    drive: DriveState = DriveState.OFF  # off, ready, homed, enabled, running, stopped or tripped
    trip: Trip | None = None  # latched until acknowledged
    crash: str = ""  # empty, or how the runner died and at which sample
    # enc, aout, adc, din, dout; fault of hardware at rest; crashed: no outputs
    io: dict[str, WireValue] = {}
    homed: bool = True  # whether positions mean anything
    drive_mode: DriveMode = DriveMode.OFF  # what the drives are told: off, torque or velocity
    hosts: tuple[str, ...] = ()  # filled in by the server: who is connected
    unsafe: str = ""  # why the machine may still move where no program runs; empty: it is safe
    own: tuple[str, ...] = ()  # parameters that the program itself sets, a sentence each
    pressed: bool = False  # the machine's STOP input is active
    homings: int = 0  # that came to their end since the program was loaded
    homing: bool = False  # the machine's homing moves it now, not the program

    @property
    def doing(self) -> str:
        """The state in a word, *homing* where the machine's own routine moves it."""
        return "homing" if self.homing else self.state

    def __repr__(self) -> str:
        trip = (self.trip.text or self.trip.reason) if self.trip else ""
        trouble = self.crash or self.unsafe or trip
        return (
            f"<Status {self.machine}: {self.doing}, drives {self.drive}, {self.t:.3f} s at"
            f" {self.rate_hz:g} Hz{f', {trouble}' if trouble else ''}>"
        )

    def _repr_html_(self) -> str:
        t = self.timing
        when = f"sample {self.tick} ({self.t:.3f} s at {self.rate_hz:g} Hz)"
        joints = f"{counted(self.joints, 'joint')}, " if self.joints else ""  # told by the program
        rows = [
            ("machine", f"{self.machine}, {joints}{self.clock} clock"),
            ("program", f"{self.doing}, {when}"),
            ("drives", f"{self.drive}, {self.drive_mode}"),
            ("time in ISR", f"{t.exec_mean_ns / 1e3:.1f} µs, at most {t.exec_max_ns / 1e3:.1f}"),
            ("begins late by", f"{t.late_mean_ns / 1e3:.1f} µs, at most {t.late_max_ns / 1e3:.1f}"),
            ("overruns, missed", f"{t.overruns}, {t.missed}"),
            ("hosts", ", ".join(self.hosts) or "none"),
        ]
        if self.trip is not None:
            rows.append(("trip", self.trip.text or self.trip.reason))
        if self.crash:
            rows.append(("crash", self.crash))
        elif self.unsafe:
            rows.append(("machine", self.unsafe))
        return html_table(("", ""), rows)


class Seal(Message, frozen=True, kw_only=True):
    """Commitment to what a simulated machine conceals, told before the diagnosis."""

    sha256: str  # of the record's UTF-8 bytes, hexadecimal


class Revealed(Message, frozen=True, kw_only=True):
    """What a simulated machine conceals, told after the diagnosis."""

    # JSON: machine, source, friction, nonce, effects [{effect, joint, parameters {name: {value,
    # unit}}}]
    record: str
    sha256: str  # of its UTF-8 bytes, as in Seal
    tick: int  # at which it was told
