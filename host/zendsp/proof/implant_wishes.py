"""What is put into which recordings of `zendsp prove --implant`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Wish:
    """An effect to put into a joint of a machine: at a multiple of its stated size; where none is
    stated, at a share of the RMS torque, or not at all (0).
    """

    effect: str
    joint: int = 1
    times: float = 1.3
    share: float = 0.1


W = Wish
# machine: recordings, each with one implant a joint
WANTED: dict[str, tuple[tuple[Wish, ...], ...]] = {
    "emps": (
        (W("stiffness", times=0.5),),
        (W("stiffness"),),
        (W("stiffness", times=4.0),),
        (W("ripple", times=0.5),),
        (W("ripple"),),
        (W("cubic_stiffness"),),
        (W("cubic_stiffness", times=2.0),),
        (W("quadratic_drag"),),
        (W("gain_drift"),),
        (W("delay", share=0.0),),
        (W("delay", times=2.0, share=0.0),),
        (W("dead_zone"),),
        (W("dead_zone", times=2.0),),
        (W("position_friction"),),
        (W("load_friction"),),
        (W("disturbance"),),
        (W("disturbance", times=2.0),),
        (W("stribeck"),),
        (W("friction_drift"),),
        (W("hysteresis"),),
    ),
    "tx40": (
        (
            W("dead_zone", 1),
            W("position_friction", 2),
            W("stiffness", 3),
            W("ripple", 4),
            W("gain_drift", 5),
            W("disturbance", 6),
        ),
        (
            W("disturbance", 1),
            W("load_friction", 2),
            W("quadratic_drag", 3),
            W("cubic_stiffness", 4),
            W("stribeck", 5),
            W("stiffness", 6),
        ),
        (
            W("delay", 1, 2.0, 0.0),
            W("dead_zone", 2, 2.0),
            W("ripple", 3, 2.0),
            W("disturbance", 4, 2.0),
            W("position_friction", 5, 2.0),
            W("hysteresis", 6),
        ),
    ),
    "kuka_kr300": (
        (
            W("stiffness", 1, 2.0),
            W("disturbance", 2, 2.0),
            W("ripple", 4),
            W("dead_zone", 5, 2.0),
            W("position_friction", 6),
        ),
    ),
}
QUICK = {"emps": WANTED["emps"][1:5]}
