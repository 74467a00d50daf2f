"""Runs of the story on the target: each starts the program anew and is recorded from the first
sample.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from zendsp.demo.controller import flags, sources
from zendsp.demo.stage import Stage, nominal_model
from zendsp.errors import AcquisitionError, Refused
from zendsp.here.stopped import ended
from zendsp.link import Target
from zendsp.physics.model import Model
from zendsp.physics.simulation.run import simulate
from zendsp.recording import Recording
from zendsp.reference import Reference
from zendsp_protocol.states import ProgramState
from zendsp_protocol.values import Assignable

CHANNELS = ("q", "r", "tau", "e", "aout", "tau_comp")
REST_S = 0.3  # after the last row


@dataclass(frozen=True)
class Machine:
    """A target with the compiled control program of the story."""

    target: Target
    stage: Stage
    model: Model
    key: str

    def run(
        self,
        motion: Reference,
        note: str,
        update: tuple[float, Mapping[str, float | list[float]]] | None = None,
    ) -> Recording:
        """Start the program afresh and record a motion.

        Parameters
        ----------
        note : str
            Kept in the recording.
        update : (float, mapping), optional
            Time in the run, s, and the parameters that change there, all in one sample.

        Returns
        -------
        Recording
            Its log has the sample at which the update took effect.

        Raises
        ------
        Refused
            The machine tripped.
        """
        target = self.target
        if target.status().state == ProgramState.RUNNING:
            target.pause()
        target.load(self.key)
        for table, rows in motion.tables().items():
            target.upload(table, rows)
        target.update(None, **self.settings())
        rate = target.info.rate_hz
        if update is not None:
            target.update(round(update[0] * rate), **update[1])
        seconds = self.stage.approach_s + motion.duration + REST_S
        try:
            recording = target.acquire(list(CHANNELS), seconds=seconds, start=True, note=note)
        except AcquisitionError:
            self._refuse_trip(note)
            raise
        self._refuse_trip(note)
        return recording

    def _refuse_trip(self, note: str) -> None:
        """Raise an error where the machine tripped, and make it ready for another run."""
        trip = self.target.status().trip
        if trip is not None and trip.reason:
            self.target.acknowledge()
            raise Refused(
                f"the motion {note} did not come to its end: {ended(trip)}. Begin anew; a run with"
                " --seed N can be repeated"
            )

    def settings(self) -> dict[str, Assignable]:
        """Parameters of the control program on this machine."""
        s = self.stage
        limit = tuple(s.plan.limits.torque.tolist())
        return {
            "approach_time": s.approach_s, "Kp": s.Kp, "Kd": s.Kd, "cutoff": s.cutoff,
            "limit": limit,
        }

    def simulate(self, motion: Reference) -> Recording:
        """The same program and motion, simulated in closed loop with the model that the host
        believes.
        """
        n = self.model.joints
        return simulate(
            sources(self.model),
            self.model,
            reference=motion,
            parameters=self.settings(),
            channels=["q", "r", "tau", "e"],
            position=self.stage.plan.home,
            seconds=self.stage.approach_s + motion.duration + REST_S,
            flags=flags(n),
        )


def prepare_machine(target: Target, stage: Stage, folder: Path = Path()) -> tuple[Machine, float]:
    """Ask the target for its encoders, write down the nominal model (its bodies into the folder,
    where they have a file), and compile the control program on the target.

    Returns
    -------
    machine : Machine
    seconds : float
        That the compiler took.
    """
    target.download("template.c")  # a machine says what it is once a program is loaded
    counts = tuple(joint.counts_per_unit for joint in target.machine().joints)
    model = nominal_model(stage, counts, 1.0 / target.info.rate_hz, folder)
    built = target.compile(sources(model), flags(model.joints))
    return Machine(target, stage, model, built.key), built.seconds
