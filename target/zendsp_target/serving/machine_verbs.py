"""Verbs of the machine and its limits, in terms of a runtime."""

from __future__ import annotations

from zendsp_protocol import messages as m
from zendsp_protocol import verbs
from zendsp_target.api import RuntimeApi
from zendsp_target.serving.variable_verbs import applied


class MachineVerbs:
    """Handlers: ``do_<verb>(arguments, author) -> result``."""

    def __init__(self, runtime: RuntimeApi) -> None:
        self.runtime = runtime

    def do_machine(self, args: verbs.Nothing, by: str) -> m.MachineInfo:
        return self.runtime.machine()

    def do_limits(self, args: verbs.Nothing, by: str) -> m.Limits:
        return self.runtime.limits()

    def do_set_limits(self, args: verbs.SetLimits, by: str) -> m.Applied:
        given = {name: getattr(args, name) for name in args.__struct_fields__}
        changes = {
            n: tuple(v) if isinstance(v, list) else v for n, v in given.items() if v is not None
        }
        return applied(self.runtime, self.runtime.set_limits(by, **changes))

    def do_set_drive(self, args: verbs.SetDrive, by: str) -> m.Empty:
        self.runtime.set_drive(args.mode)
        return m.Empty()

    def do_set_ramp(self, args: verbs.SetRamp, by: str) -> m.Empty:
        self.runtime.set_ramp(args.seconds)
        return m.Empty()

    def do_set_overrun(self, args: verbs.SetOverrun, by: str) -> m.Empty:
        self.runtime.set_overrun(args.policy, args.limit)
        return m.Empty()

    def do_set_inputs(self, args: verbs.SetInputs, by: str) -> m.Empty:
        self.runtime.set_inputs(args.bits)
        return m.Empty()

    def do_home(self, args: verbs.Nothing, by: str) -> m.Empty:
        self.runtime.home()
        return m.Empty()

    def do_acknowledge(self, args: verbs.Acknowledge, by: str) -> m.Said:
        self.runtime.acknowledge(args.trip)
        return m.Said()
