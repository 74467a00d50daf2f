"""All experiments by name, in the order in which they build on one another."""

from __future__ import annotations

from dataclasses import dataclass

from zendsp.errors import Refused
from zendsp.experiment.names import present_name
from zendsp.experiment.needs import Needs
from zendsp_protocol.errors import nearest
from zendsp_protocol.messages import MachineInfo


@dataclass(frozen=True)
class Experiment:
    """One experiment of the list.

    Attributes
    ----------
    name : str
        What it measures.
    shipped : str
        The machine that is started for it where no target is given.
    needs : Needs
        What any other machine must have.
    title : str
        One line for people.
    function : str
        Where it is: "module:function".
    models : bool
        Whether its result has something that a model file holds.
    takes_model : bool
        Whether it makes anything of a model file: beside what `needs` says, inertia and weight.
    """

    name: str
    shipped: str
    needs: Needs
    title: str
    function: str
    models: bool = False
    takes_model: bool = False

    def lacking(self, machine: MachineInfo, has_model: bool = False) -> str:
        """What this machine lacks for it, in a sentence; "" where it can be made."""
        own = machine.name == self.shipped and not machine.model
        return self.needs.lacking(machine, has_model or own)

    def check_model(self) -> None:
        """Refuse a model file where the experiment makes nothing of it.

        Raises
        ------
        Refused
        """
        if not self.takes_model:
            raise Refused(
                f"{self.name} takes no model: what it needs it finds in the motion. Leave the model"
                " away, or take low-speed, which measures friction beside a model's inertia and"
                " weight"
            )


EXPERIMENTS = {
    e.name: e
    for e in (
        Experiment(
            "friction", "wam7", Needs(),
            "Friction of every joint: constant speeds both ways, with confidence intervals.",
            "friction:friction", models=True,
        ),
        Experiment(
            "breakaway", "imi_planar", Needs(),
            "Static friction of each joint: torque steps both ways from several positions.",
            "breakaway:breakaway", takes_model=True,
        ),
        Experiment(
            "high-speed", "imi_planar", Needs(),
            "Friction of each joint at high speed: constant torque, open loop.",
            "high_speed:high_speed", takes_model=True,
        ),
        Experiment(
            "low-speed", "imi_planar", Needs(),
            "Friction of each joint at low speed, inertia, weight: triangular velocity, averaged.",
            "low_speed:low_speed", takes_model=True,
        ),
        Experiment(
            "friction-curve", "imi_planar", Needs(),
            "One friction curve of two polynomials through the three.",
            "friction_curve:friction_curve", models=True, takes_model=True,
        ),
        Experiment(
            "circle", "imi_planar", Needs(least=2, model="with two joints that turn in one plane"),
            "Circle under inverse dynamics, compensated or not, machine and simulation.",
            "circle:circle", takes_model=True,
        ),
        Experiment(
            "electrical", "pendulum", Needs("voltage", sensed=True),
            "Torque constant and resistance of each motor, by the straight line.",
            "motor:electrical",
        ),
        Experiment(
            "mechanical", "pendulum", Needs(),
            "Inertia, weight, Coulomb and viscous friction of each joint.",
            "mechanics:mechanical", models=True,
        ),
        Experiment(
            "swing", "pendulum", Needs(most=1),
            "Optimal swing open and closed loop, and friction at the feedback level.",
            "swing:swing",
        ),
        Experiment(
            "tracking", "wam7", Needs(model="with friction"),
            "Joint error of machine and simulation, each joint alone and all together.",
            "tracking:tracking", takes_model=True,
        ),
    )
}


def experiment_named(name: str) -> Experiment:
    """The experiment of a name, also of a former one.

    Raises
    ------
    Refused
        There is none.

    Examples
    --------
    >>> experiment_named("imi-static").name
    'breakaway'
    """
    now = present_name(name)
    if now not in EXPERIMENTS:
        close = nearest(now, EXPERIMENTS)
        near = f"did you mean {close[0]}? There" if close else "there"
        raise Refused(f"no experiment {name!r}; {near} are {', '.join(EXPERIMENTS)}")
    return EXPERIMENTS[now]
