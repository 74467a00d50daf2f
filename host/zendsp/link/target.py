"""A target as its user sees it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Concatenate, Generic, NoReturn, ParamSpec, TypeVar, overload

from zendsp.errors import LinkError
from zendsp.link import left_moving
from zendsp.link.acquire import Recorder
from zendsp.link.concealed import Concealment
from zendsp.link.drives import Drives
from zendsp.link.link import Link
from zendsp.link.live import LiveViews
from zendsp.link.parameters import ParameterSets
from zendsp.link.programs import Programs
from zendsp.link.requests import Requests
from zendsp.link.tables import Tables
from zendsp.link.variables import Variables
from zendsp_protocol import messages as m
from zendsp_protocol.states import ProgramState, VariableKind
from zendsp_protocol.values import Assignable
from zendsp_protocol.views import html_table, sentence, short

_PARTS = (
    "variables", "parameter_sets", "programs", "recorder", "views", "tables", "drives",
    "concealment",
)
_ATTRIBUTES = ("info", "requests", *_PARTS)

Given = ParamSpec("Given")
Result = TypeVar("Result")


class _of(Generic[Given, Result]):
    """A descriptor: a method of a part, as a method of the target. Once looked up, it is an
    attribute of the target.
    """

    def __init__(self, part: str, method: Callable[Concatenate[Any, Given], Result]) -> None:
        self._part, self._method = part, method

    @overload
    def __get__(self, target: None, kind: type) -> Callable[Concatenate[Any, Given], Result]: ...
    @overload
    def __get__(self, target: object, kind: type) -> Callable[Given, Result]: ...
    def __get__(self, target: object | None, kind: type) -> Callable[..., Result]:
        if target is None:
            return self._method
        name = self._method.__name__
        bound: Callable[..., Result] = getattr(getattr(target, self._part), name)
        target.__dict__[name] = bound
        return bound


def _quoted(name: str) -> str:
    return f'"{name}"'


class Target:
    """A target that runs somewhere: load programs, tune variables, record, watch.

    Made by `zendsp.connect` and `zendsp.local`. Safe to use from several threads. Its
    parts hold the methods; each of them is a method of the target too, so that ``target.start()``
    is ``target.programs.start()``.

    Attributes
    ----------
    info : Info
        Name, machine, joints, rate, clock, versions.
    variables : Variables
        Read, write, stage, update, the log; called, it gives the dictionary of the running code.
    parameter_sets : ParameterSets
        All parameters at once: read, restore, reset.
    programs : Programs
        Compile, load, start, pause, STOP, status.
    recorder : Recorder
        Acquisition: configure, start, bring home.
    views : LiveViews
        Follow channels live.
    tables : Tables
        Large arrays.
    drives : Drives
        The machine, its limits, the safe sequence, who commands.
    concealment : Concealment
        What a simulated machine hides.
    requests : Requests
        Any verb of the protocol.

    Examples
    --------
    >>> import zendsp
    >>> with zendsp.local("imi_planar") as target:    # doctest: +SKIP
    ...     target.download("pd.c")
    ...     target.start()
    ...     target["Kp1"] = 400.0
    ...     tick = target.update(Kp1=450.0, Kd1=40.0)
    ...     rec = target.acquire(["q", "tau"], seconds=2.0)
    """

    def __init__(
        self,
        link: Link,
        on_close: Callable[[], None] | None = None,
        reopen: Callable[[], Link] | None = None,
    ) -> None:
        self.requests = requests = Requests(link)
        self.variables = Variables(requests)
        self.parameter_sets = ParameterSets(requests, self.variables)
        self.programs = Programs(requests)
        requests.outlives = on_close is None
        self.recorder = Recorder(requests, self.parameter_sets)
        self.views = LiveViews(requests)
        self.tables = Tables(requests)
        self.drives = Drives(requests)
        self.concealment = Concealment(requests)
        self._on_close = on_close
        self._reopen = reopen
        try:
            self.info: m.Info = self.request("info")
            link.instance = _instance(self.info.instance) or link.instance
        except BaseException:
            link.close()
            raise

    def __setattr__(self, name: str, value: Any) -> None:
        if not name.startswith("_") and name not in _ATTRIBUTES and not hasattr(type(self), name):
            raise AttributeError(
                f"a target has no attribute {name!r}; to write a variable: target[{_quoted(name)}]"
                f" = {value!r}"
            )
        super().__setattr__(name, value)

    # which knows the attributes there are, and would take all others for good
    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> NoReturn:
            hint = "" if name.startswith("_") else f"; to read a variable: target[{_quoted(name)}]"
            raise AttributeError(f"a target has no attribute {name!r}{hint}")

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            f"the connection to {self.name!r} belongs to this process: hand its name on, and"
            " connect() in the other"
        )

    request = _of("requests", Requests.request)
    insist = _of("requests", Requests.insist)

    __getitem__ = _of("variables", Variables.__getitem__)
    __setitem__ = _of("variables", Variables.__setitem__)
    __iter__ = _of("variables", Variables.__iter__)
    __contains__ = _of("variables", Variables.__contains__)
    read = _of("variables", Variables.read)
    write = _of("variables", Variables.write)
    stage = _of("variables", Variables.stage)
    discard = _of("variables", Variables.discard)
    update = _of("variables", Variables.update)
    fade = _of("variables", Variables.fade)
    builtins = _of("variables", Variables.builtins)
    log = _of("variables", Variables.log)

    parameters = _of("parameter_sets", ParameterSets.parameters)
    restore = _of("parameter_sets", ParameterSets.restore)
    reset = _of("parameter_sets", ParameterSets.reset)
    parameter_names = _of("parameter_sets", ParameterSets.parameter_names)

    compile = _of("programs", Programs.compile)
    load = _of("programs", Programs.load)
    download = _of("programs", Programs.download)
    start = _of("programs", Programs.start)
    pause = _of("programs", Programs.pause)
    stop = _of("programs", Programs.stop)
    stop_page = _of("programs", Programs.stop_page)
    acknowledge = _of("programs", Programs.acknowledge)
    unload = _of("programs", Programs.unload)
    status = _of("programs", Programs.status)
    program = _of("programs", Programs.program)
    run_for = _of("programs", Programs.run_for)
    watch_start = _of("programs", Programs.watch_start)
    wait = _of("programs", Programs.wait)

    acquire = _of("recorder", Recorder.acquire)
    acquire_configure = _of("recorder", Recorder.acquire_configure)
    acquire_start = _of("recorder", Recorder.acquire_start)
    acquire_stop = _of("recorder", Recorder.acquire_stop)
    acquire_status = _of("recorder", Recorder.acquire_status)
    acquire_load = _of("recorder", Recorder.acquire_load)
    acquire_finish = _of("recorder", Recorder.acquire_finish)
    load_rows = _of("recorder", Recorder.load_rows)

    live = _of("views", LiveViews.live)

    upload = _of("tables", Tables.upload)

    machine = _of("drives", Drives.machine)
    limits = _of("drives", Drives.limits)
    joints = _of("drives", Drives.joints)
    set_limits = _of("drives", Drives.set_limits)
    set_drive = _of("drives", Drives.set_drive)
    home = _of("drives", Drives.home)
    set_ramp = _of("drives", Drives.set_ramp)
    set_overrun = _of("drives", Drives.set_overrun)
    set_inputs = _of("drives", Drives.set_inputs)
    drive_status = _of("drives", Drives.drive_status)
    power_on = _of("drives", Drives.power_on)
    power_off = _of("drives", Drives.power_off)
    home_and_wait = _of("drives", Drives.home_and_wait)
    home_if_needed = _of("drives", Drives.home_if_needed)
    enable = _of("drives", Drives.enable)
    disable = _of("drives", Drives.disable)
    drive_auto = _of("drives", Drives.drive_auto)
    take_command = _of("drives", Drives.take_command)
    release_command = _of("drives", Drives.release_command)
    set_host_lost = _of("drives", Drives.set_host_lost)

    seal = _of("concealment", Concealment.seal)
    reveal = _of("concealment", Concealment.reveal)

    @property
    def staged(self) -> dict[str, Assignable]:
        """The values that are staged for the next `update`."""
        return self.variables.staged

    @property
    def link(self) -> Link:
        """The present link; `reconnect` makes another."""
        return self.requests.link

    @property
    def name(self) -> str:
        """Name of the target."""
        return self.link.target

    @property
    def alive(self) -> bool:
        """Whether the target is reachable now, as the link itself knows it."""
        return self.link.alive

    def reconnect(self) -> None:
        """Look the target up again and connect to it; one that was restarted has another address.

        After an outage of the link alone no call is needed: the connection comes back by itself.
        Live views continue; staged values stay staged.

        Raises
        ------
        LinkError
            No target of that name, or nothing answers; the old connection is closed all the same.
        """
        if self._reopen is None:
            raise LinkError(
                f"{self.name} was started by this host and ended with it; start another with"
                " local()"
            )
        old = self.link
        old.close()
        self.requests.link = link = self._reopen()
        self.info = self.request("info")
        link.instance = bytes.fromhex(self.info.instance) or link.instance
        link.take_over(old)

    def close(self) -> None:
        """End the connection. A target started by `zendsp.local` ends with it, others go on."""
        if self._on_close is None and self.alive:
            left_moving.say(self.link, on_purpose=True)
        left_moving.ended(self.link)
        self.link.close()
        if self._on_close is not None:
            on_close, self._on_close = self._on_close, None
            on_close()

    def __enter__(self) -> Target:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            left_moving.say(self.link)
        self.close()

    def _ipython_key_completions_(self) -> list[str]:
        """Names for ``target["<Tab>`` at a prompt."""
        if not self.alive or self.status().state == ProgramState.EMPTY:
            return []
        return [*self.variables(), *self.builtins()]

    def _repr_html_(self) -> str:
        """The state of the target and the present values of the program's variables, for a
        notebook.
        """
        if not self.alive:
            return sentence(repr(self))
        status = self.status()
        shown = sentence(repr(self)) + status._repr_html_()
        if status.state in (ProgramState.EMPTY, ProgramState.CRASHED):
            return shown
        infos = [v for v in self.variables().values() if v.kind != VariableKind.TABLE]
        if not infos:
            return shown
        values = self.read([v.name for v in infos]).values
        rows = [(v.name, short(values[v.name]), v.unit, v.description) for v in infos]
        return shown + html_table(("variable", "value", "unit", "description"), rows)

    def __repr__(self) -> str:
        state = "" if self.alive else ", not reachable"
        return (
            f"<Target {self.name}: {self.info.machine}, {self.info.rate_hz:g} Hz,"
            f" {self.info.clock}{state}>"
        )


def _instance(told: str) -> bytes:
    """What a target calls this run of itself; empty where it is older than that."""
    try:
        return bytes.fromhex(told)
    except ValueError as error:
        raise LinkError(
            f"the target told a malformed instance, {told[:32]!r}: is it a target of zendsp?"
        ) from error
