"""What a column probably holds, by its name and its unit."""

from __future__ import annotations

import re
from enum import Enum

from zendsp.recording.units import ENCODER, to_si


class Role(Enum):
    """What a column of a recording holds; the value is the key in a model file's ``[columns]``."""

    TIME = "time"
    POSITION = "position"
    COMMAND = "command"
    REFERENCE = "reference"
    VELOCITY = "velocity"
    CURRENT = "current"
    TEMPERATURE = "temperature"
    TORQUE_MEASURED = "torque_measured"
    NONE = ""


WORDS = {
    Role.TIME: {"t", "time", "timestamp", "stamp", "zeit", "zeitstempel", "messzeit", "clock"},
    Role.POSITION: {
        "q", "theta", "phi", "pos", "position", "positions", "angle", "x", "enc", "encoder",
        "winkel", "qm", "lage", "massstab",
    },
    Role.COMMAND: {
        "u", "tau", "torque", "torques", "effort", "efforts", "force", "voltage", "volt", "cmd",
        "command", "control", "moment", "drehmoment", "aout", "dac", "vir", "kraft", "spannung",
    },
    Role.REFERENCE: {
        "r", "ref", "reference", "des", "desired", "setpoint", "sp", "goal", "target", "soll",
        "sollwert", "set", "qref", "qdes", "qg",
    },
    Role.VELOCITY: {
        "qd", "dq", "qdot", "vel", "velocity", "velocities", "omega", "speed", "thetad", "w",
        "velo", "geschwindigkeit", "drehzahl",
    },
    Role.CURRENT: {"i", "iq", "current", "currents", "amps", "strom"},
    Role.TEMPERATURE: {"temp", "temperature", "temperatur", "celsius"},
}
# of time only where the reader of the file has made seconds of them
DATES = {"date", "datetime", "datum", "uhrzeit"}
MEASURED = {"meas", "measured", "actual", "sensor", "sensed"}
ACCELERATION = {"qdd", "ddq", "acc", "acceleration", "accel", "beschleunigung"}
# what a loop is off by, as wide as a position and in its unit
ERROR = {"e", "err", "error", "fehler", "schleppfehler", "schleppabstand", "regelabweichung"}
# German writes a quantity and what it is of as one word, the quantity last; Soll and Ist come first
NOUNS = (
    "position", "winkel", "massstab", "strom", "moment", "kraft", "spannung", "geschwindigkeit",
    "drehzahl", "beschleunigung", "temperatur",
)
UNITS = {
    "rad": Role.POSITION, "m": Role.POSITION, "rad/s": Role.VELOCITY, "m/s": Role.VELOCITY,
    "N m": Role.COMMAND, "Nm": Role.COMMAND, "N": Role.COMMAND, "V": Role.COMMAND,
    "A": Role.CURRENT, "°C": Role.TEMPERATURE, "degC": Role.TEMPERATURE,
}
ALLOWED = {  # units that a role can have; any where the file states none
    Role.TIME: {"s"},
    Role.POSITION: {"rad", "m", *ENCODER},
    Role.REFERENCE: {"rad", "m", *ENCODER},
    Role.VELOCITY: {"rad/s", "m/s"},
    Role.CURRENT: {"A"},
}


def role_of(name: str, unit: str = "") -> Role:
    """What the column ``name [unit]`` probably holds; ``Role.NONE`` where neither tells.

    Examples
    --------
    >>> role_of("q1").value, role_of("motor_torque").value, role_of("JointPositionCmd").value
    ('position', 'command', 'reference')
    >>> role_of("signal 3", "deg").value, role_of("joint_states.elbow.effort").value
    ('position', 'command')
    >>> role_of("Sollposition", "mm").value, role_of("Motorstrom", "A").value
    ('reference', 'current')
    """
    unit = unit.partition(", ")[0]  # of a vector whose elements differ: "m, rad"
    known = to_si(unit) if unit else None
    si = known[1] if known else ""
    words = _words(name)
    asked = words & WORDS[Role.REFERENCE] or words & WORDS[Role.COMMAND]
    if words & (ACCELERATION | ERROR) or (words & WORDS[Role.VELOCITY] and asked):
        return Role.NONE
    found = _by_words(words)
    if found is Role.NONE and si == "s" and words & DATES:
        return Role.TIME
    if found is Role.NONE or (si and si not in ALLOWED.get(found, {si})):
        by_unit = UNITS.get(si, Role.NONE)
        return (
            by_unit if found is not Role.REFERENCE or by_unit is not Role.COMMAND else Role.COMMAND
        )
    if found is Role.COMMAND and si in ("rad", "m"):
        return Role.REFERENCE  # a command of position
    return found


def _words(name: str) -> set[str]:
    spaced = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    # of a path such as joint_states.elbow.effort the last part says what the number is, if it says
    # anything
    last = re.split(r"[./]", spaced)[-1]
    for part in (last, spaced):
        words = {word.lower() for word in re.findall(r"[^\W\d_]+", part)} | {
            re.sub(r"[\W\d_]", "", part).lower()
        }
        words |= {p for word in words for p in parts_of(word)}
        if any(words & some for some in (*WORDS.values(), ACCELERATION, ERROR)):
            break
    return words


def parts_of(word: str) -> set[str]:
    """What a German word is made of, where it ends with a quantity; empty where it does not.

    Examples
    --------
    >>> sorted(parts_of("sollposition")), sorted(parts_of("lageistwert")), parts_of("motor")
    (['position', 'soll'], ['lage'], set())
    """
    plain = word.replace("ß", "ss")
    stem, asked = re.sub(r"^(?:soll|ist)|(?:soll|ist)wert$", "", plain), "soll" in plain
    found = {noun for noun in (*NOUNS, "lage") if stem == noun}
    found |= {noun for noun in NOUNS if stem.endswith(noun)}
    return found | {"soll"} if found and asked else found


def _by_words(words: set[str]) -> Role:
    has = {role: bool(words & some) for role, some in WORDS.items()}
    if "iq" in words:
        return Role.CURRENT
    if has[Role.COMMAND] and words & MEASURED:
        return Role.TORQUE_MEASURED
    if has[Role.VELOCITY]:
        return Role.VELOCITY
    if has[Role.POSITION]:
        return Role.REFERENCE if has[Role.REFERENCE] or has[Role.COMMAND] else Role.POSITION
    for role in (Role.COMMAND, Role.REFERENCE, Role.CURRENT, Role.TEMPERATURE, Role.TIME):
        if has[role]:
            return role
    return Role.NONE
