"""What a machine is, and what its drives need and may."""

from __future__ import annotations

from zendsp_protocol.messages.base import Message
from zendsp_protocol.states import DriveState, HostLost


class JointInfo(Message, frozen=True):
    """One joint of the machine."""

    name: str  # of the joint
    unit: str = "rad"  # rad or m
    command: str = "torque"  # what the analog output means: torque, force or voltage
    counts_per_unit: float = 1.0  # encoder counts per rad or m
    zero_counts: float = 0.0  # encoder reading at position zero
    mv_per_torque: float = 0.0  # mV per N m or N; 0 where the command is a voltage
    mv_per_speed: float = 0.0  # mV per rad/s or m/s, in velocity mode
    command_max: float = float("inf")  # mV
    position_min: float = float("-inf")  # rad or m
    position_max: float = float("inf")  # rad or m
    speed_max: float = float("inf")  # rad/s or m/s
    torque_max: float = float("inf")  # N m or N
    home: float = 0.0  # rad or m, where homing ends
    length: float = 0.0  # m, of the link; 0 where it means nothing


class MachineInfo(Message, frozen=True):
    """What the machine says of itself."""

    name: str  # of the machine
    text: str = ""  # what it is
    simulated: bool = False  # whether it is a simulation
    joints: tuple[JointInfo, ...] = ()  # see JointInfo
    adc_names: tuple[str, ...] = ()  # of the analog inputs
    adc_units: tuple[str, ...] = ()  # of the analog inputs
    dins: int = 0  # digital inputs
    douts: int = 0  # digital outputs
    stop_input: int = -1  # digital input that stops; -1 where none
    needs_homing: bool = False  # before it may be enabled
    model: str = ""  # path, on the target, of the MuJoCo model that is simulated; empty: none
    options: tuple[str, ...] = ()  # that the model was started with, KEY=VALUE each

    def __repr__(self) -> str:
        joints = ", ".join(
            f"{j.name} [{j.unit}] {j.position_min:g} … {j.position_max:g}" for j in self.joints
        )
        simulated = ", simulated" if self.simulated else ""
        return f"<MachineInfo {self.name}{simulated}: {joints or 'no joints yet'}>"


class Limits(Message, frozen=True):
    """Checked every sample, below the user's code; one entry per joint."""

    position_min: tuple[float, ...]  # rad or m
    position_max: tuple[float, ...]  # rad or m
    speed_max: tuple[float, ...]  # rad/s or m/s
    torque_max: tuple[float, ...]  # N m or N
    command_max: tuple[float, ...]  # mV
    torque_clamp: bool = True  # true: clamp a command at its limit; false: trip


class Condition(Message, frozen=True, kw_only=True):
    """One thing that enabling the drives needs."""

    name: str  # of the condition
    met: bool  # now
    advice: str = ""  # what to do where it is not met


class DriveStatus(Message, frozen=True, kw_only=True):
    """Where the drives are in the safe sequence."""

    state: DriveState  # off, ready, homed, enabled, running, stopped or tripped
    mode: str = "off"  # what the drives are told: off, torque or velocity
    managed: bool = False  # the sequence cannot be left (--managed)
    # the sequence is in use; else the drives go on at start and off at pause
    explicit: bool = False
    homed: bool = True  # whether positions mean anything
    commander: str = ""  # who has the exclusive right to command
    moved_by: str = ""  # whose run, or attended start, moves the machine now
    host_lost: HostLost = HostLost.STOP  # when the commander disappears: stop, hold or finish
    conditions: tuple[Condition, ...] = ()  # of enabling

    def __repr__(self) -> str:
        how = "explicit" if self.explicit else "automatic: on at start, off at pause"
        unmet = ", ".join(c.name for c in self.conditions if not c.met) or "none"
        return (
            f"<DriveStatus {self.state}, {self.mode}, {how}; commands:"
            f" {self.commander or 'nobody'}; conditions not met: {unmet}>"
        )


class RunBegun(Message, frozen=True, kw_only=True):
    """A run began: what it sets is put back when it ends, or when its host is lost."""

    run: int  # number, for run_end
    names: tuple[str, ...]  # that are put back
    follows: bool = True  # the program follows its table
