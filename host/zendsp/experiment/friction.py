"""Friction of every joint: of the WAM in its pose and with its weight compensated, of any other
machine as it stands.
"""

from __future__ import annotations

from zendsp.experiment import any_friction, wam_friction
from zendsp.experiment.lab import Lab
from zendsp.experiment.result import Result


def friction(lab: Lab) -> Result:
    """Coulomb and viscous friction of every joint and direction.

    The WAM has settings of its own: the paper's speeds, a pose in which every joint has room, and
    a program that knows its weight. What it finds of the weight is what the data sheet lacks, so
    no test decides whether a joint carries any.
    """
    if lab.shipped("friction") == wam_friction.MACHINE:
        return wam_friction.friction(lab)
    return any_friction.friction(lab)
