"""Planned motions: made from parameters, checked against a machine's limits, saved as the MAT file
that Execute plays.
"""

from zendsp.reference.core import Mode, Reference
from zendsp.reference.crest import crest_factor
from zendsp.reference.dynamics import predict_motion
from zendsp.reference.files import load_reference, save_reference
from zendsp.reference.fits import check_fits
from zendsp.reference.kind import Kind, Parameter
from zendsp.reference.kinds.chirp import make_chirp
from zendsp.reference.kinds.circle import make_circle
from zendsp.reference.kinds.from_file import make_from_file
from zendsp.reference.kinds.line import make_line
from zendsp.reference.kinds.lspb import make_lspb
from zendsp.reference.kinds.multisine import make_multisine
from zendsp.reference.kinds.point_to_point import make_point_to_point
from zendsp.reference.kinds.prbs import make_prbs
from zendsp.reference.kinds.step import make_step
from zendsp.reference.kinds.swing import make_swing
from zendsp.reference.kinds.torque_law import make_torque_law
from zendsp.reference.kinds.trapezoid import make_trapezoid
from zendsp.reference.kinds.triangle import make_triangle
from zendsp.reference.kinematics import forward_kinematics, inverse_kinematics
from zendsp.reference.limits import Limits, Violation, find_violations
from zendsp.reference.machine import (
    JUMPS,
    MACHINES,
    UNPREDICTED,
    Machine,
    load_machine,
    make_limited,
)
from zendsp.reference.plot import plot_reference
from zendsp.reference.registry import KINDS, make_reference

__all__ = [
    "JUMPS", "KINDS", "MACHINES", "UNPREDICTED", "Kind", "Limits", "Machine", "Mode", "Parameter",
    "Reference", "Violation", "check_fits", "crest_factor", "find_violations", "forward_kinematics",
    "inverse_kinematics", "load_machine", "load_reference", "make_chirp", "make_circle",
    "make_from_file", "make_limited", "make_line", "make_lspb", "make_multisine",
    "make_point_to_point", "make_prbs", "make_reference", "make_step", "make_swing",
    "make_torque_law", "make_trapezoid", "make_triangle", "plot_reference", "predict_motion",
    "save_reference",
]
