"""How each effect of the contract is put into a true machine, at a size that is a knob.

Every function changes the draft's truth, says which friction laws the given model has, and returns
what was concealed in the contract's words. ``size`` 1 is clearly felt (torque effects: about a
fifth of the torque's RMS), 0.3 and 0.1 are that much smaller. ``accepted`` names only what is the
same equation by algebra; what a given recording cannot separate is measured by the oracle, not
declared here.
"""

from __future__ import annotations

from zendsp.proof import effects_drive, effects_friction, effects_mechanics
from zendsp.proof.effect_kit import Maker

# The order is part of every seed's meaning.
EFFECTS: dict[str, Maker] = {
    **effects_friction.MAKERS, **effects_mechanics.MAKERS, **effects_drive.MAKERS,
    "disturbance": effects_drive.add_disturbance,
}
SINGLE = tuple(EFFECTS)
