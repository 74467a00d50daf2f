"""Models of machines, the library of physical effects, simulation, calibration, and C for the ISR.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from zendsp.first_use import on_first_use

# name -> module that holds it; imported on first use: a model file needs neither SciPy nor a
# compiler
_LAZY = {
    "Model": "zendsp.physics.model",
    "load_model": "zendsp.physics.files.model_file",
    "parse_model": "zendsp.physics.files.model_file",
    "model_text": "zendsp.physics.files.model_write",
    "Effect": "zendsp.physics.effects",
    "library": "zendsp.physics.effects",
    "load_effects": "zendsp.physics.effects",
    "Plant": "zendsp.physics.simulation.plant",
    "simulate": "zendsp.physics.simulation.run",
    "simulate_loop": "zendsp.physics.simulation.control",
    "compensation": "zendsp.physics.codegen.compensation",
    "model_code": "zendsp.physics.codegen.model_code",
    "inverse_dynamics": "zendsp.physics.codegen.model_torque",
}

if TYPE_CHECKING:
    from zendsp.physics.codegen.compensation import compensation as compensation
    from zendsp.physics.codegen.model_code import model_code as model_code
    from zendsp.physics.codegen.model_torque import inverse_dynamics as inverse_dynamics
    from zendsp.physics.effects import Effect as Effect
    from zendsp.physics.effects import library as library
    from zendsp.physics.effects import load_effects as load_effects
    from zendsp.physics.files.model_file import load_model as load_model
    from zendsp.physics.files.model_file import parse_model as parse_model
    from zendsp.physics.files.model_write import model_text as model_text
    from zendsp.physics.model import Model as Model
    from zendsp.physics.simulation.control import simulate_loop as simulate_loop
    from zendsp.physics.simulation.plant import Plant as Plant
    from zendsp.physics.simulation.run import simulate as simulate

__all__ = sorted(_LAZY)

__getattr__ = on_first_use(__name__, _LAZY)


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY})
