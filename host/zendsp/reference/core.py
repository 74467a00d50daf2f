"""The planned motion that Execute plays: samples on a uniform grid, and how they came about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from zendsp.errors import ReferenceError_

Array = npt.NDArray[np.float64]
Mode = Literal["position", "torque"]


def differentiate(x: Array, sample_time: float) -> Array:
    """Second-order finite differences along the first axis.

    Parameters
    ----------
    x : ndarray, shape (N, joints)
        Samples.
    sample_time : float
        Spacing, s.

    Returns
    -------
    ndarray, shape (N, joints)
        dx/dt, central inside and one-sided at the ends.

    Examples
    --------
    >>> import numpy as np
    >>> differentiate(np.array([[0.0], [1.0], [4.0]]), 1.0).ravel().tolist()
    [0.0, 2.0, 4.0]
    """
    if len(x) < 3:
        return np.zeros_like(x)
    return np.asarray(np.gradient(x, sample_time, axis=0, edge_order=2), dtype=np.float64)


def _columns(name: str, value: npt.ArrayLike) -> Array:
    """A read-only float64 copy of shape (N, joints); a 1-D array is one joint."""
    x = np.array(value, dtype=np.float64)
    if x.ndim == 1:
        x = x[:, None]
    if x.ndim != 2:
        raise ReferenceError_(f"reference: {name} has shape {x.shape}; expected (samples, joints)")
    bad = np.argwhere(~np.isfinite(x))
    if len(bad):
        row, joint = bad[0]
        raise ReferenceError_(
            f"reference: {name} of joint {joint + 1} is {x[row, joint]} at sample {row}; every"
            " sample must be a finite number: mend the file or the parameters that made it"
        )
    x.setflags(write=False)
    return x


@dataclass(frozen=True, eq=False)
class Reference:
    """Samples of a planned motion, row k at time k · sample_time.

    ``Reference(q, 0.001)`` is enough: missing derivatives come from finite differences.

    Parameters
    ----------
    q : array_like, shape (N, joints) or (N,)
        Joint positions, rad (m for a linear axis). In mode "torque": the predicted motion, or
        constant where unknown.
    sample_time : float
        Spacing of the samples, s.
    qd, qdd : array_like, shape (N, joints), optional
        Velocity and acceleration, rad/s and rad/s^2.
    tau : array_like, shape (N, joints), optional
        Feed-forward torque, N m; in mode "torque" the command itself.
    kind : str
        Name of the generator, see ``zendsp.reference.KINDS``.
    parameters : mapping
        What the generator was given, so that the motion can be made again.
    machine : str
        Name of the machine it was planned for, "" where none.
    mode : {"position", "torque"}
        Whether a feedback law follows q, or tau is played open loop.
    cyclic : bool
        The last sample joins the first, so that Execute may repeat it.
    unit : str
        Unit of q, "rad" or "m".

    Raises
    ------
    ReferenceError_
        Shapes that disagree, fewer than two samples, numbers that are not finite, mode "torque"
        without tau.

    Examples
    --------
    >>> import numpy as np
    >>> ref = Reference(np.linspace(0.0, 1.0, 11), 0.1)
    >>> ref.joints, ref.duration, round(float(ref.qd[5, 0]), 6)
    (1, 1.0, 1.0)
    """

    q: Array
    sample_time: float
    qd: Array = None  # type: ignore[assignment]  # filled below where not given
    qdd: Array = None  # type: ignore[assignment]
    tau: Array | None = None
    kind: str = "user"
    parameters: Mapping[str, Any] = field(default_factory=dict)
    machine: str = ""
    mode: Mode = "position"
    cyclic: bool = False
    unit: str = "rad"

    def __repr__(self) -> str:
        joints = f"{self.joints} joint{'' if self.joints == 1 else 's'}"
        whose = f" for {self.machine}" if self.machine else ""
        cyclic = ", cyclic" if self.cyclic else ""
        return (
            f"<Reference {self.kind}{whose}: {joints}, {self.mode}, {self.duration:g} s, "
            f"{self.samples} samples of {1e3 * self.sample_time:g} ms{cyclic}>"
        )

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sample_time) and self.sample_time > 0.0):
            raise ReferenceError_(
                f"reference: sample_time is {self.sample_time} s; it must be positive, e.g. 0.001"
            )
        q = _columns("q", self.q)
        if len(q) < 2:
            raise ReferenceError_(
                f"reference: {len(q)} sample(s); at least 2 are needed: give a longer duration"
            )
        given = {"qd": self.qd, "qdd": self.qdd, "tau": self.tau}
        arrays = {name: None if x is None else _columns(name, x) for name, x in given.items()}
        for name, x in arrays.items():
            if x is not None and x.shape != q.shape:
                raise ReferenceError_(
                    f"reference: {name} has shape {x.shape}, q has {q.shape}; they must be the same"
                )
        qd = arrays["qd"] if arrays["qd"] is not None else differentiate(q, self.sample_time)
        qdd = arrays["qdd"] if arrays["qdd"] is not None else differentiate(qd, self.sample_time)
        if self.mode not in ("position", "torque"):
            raise ReferenceError_(
                f'reference: mode is "{self.mode}"; expected "position" or "torque"'
            )
        if self.mode == "torque" and arrays["tau"] is None:
            raise ReferenceError_('reference: mode "torque" needs tau, the command to play')
        for name, value in (("q", q), ("qd", qd), ("qdd", qdd), ("tau", arrays["tau"])):
            object.__setattr__(self, name, value)  # frozen: the arrays are settled here once
        object.__setattr__(self, "sample_time", float(self.sample_time))

    def tables(self) -> dict[str, Array]:
        """What a control program plays, in the order in which to send it: ``ref_tau``, then
        ``ref``, which begins the motion.

        Returns
        -------
        dict of str to ndarray, shape (N, joints)
            Torque (one row of zeros where there is none) and positions; docs/references.md has the
            convention.

        Examples
        --------
        >>> import numpy as np
        >>> list(Reference(np.zeros(3), 0.001).tables())
        ['ref_tau', 'ref']
        """
        return {
            "ref_tau": np.zeros((1, self.joints)) if self.tau is None else self.tau,
            "ref": self.q,
        }

    @property
    def t(self) -> Array:
        """Time of each row, s, from 0."""
        return np.arange(len(self.q), dtype=np.float64) * self.sample_time

    @property
    def headroom(self) -> float:
        """Share of the speed, acceleration and torque limits that it was planned to stay within; 1
        where nobody said.
        """
        return float(self.parameters.get("headroom", 1.0))

    @property
    def jumps(self) -> bool:
        """Whether its position does (a step): its speed and acceleration say nothing then, and how
        the machine moves is its loop's answer.

        Examples
        --------
        >>> import numpy as np
        >>> still = np.zeros(4)
        >>> Reference([0.0, 0.0, 0.1, 0.1], 0.001, still, still).jumps
        True
        """
        stood = (self.qd[1:] == 0.0) & (self.qd[:-1] == 0.0)
        return self.mode == "position" and bool(np.any(stood & (np.diff(self.q, axis=0) != 0.0)))

    @property
    def joints(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    @property
    def samples(self) -> int:
        """Number of rows."""
        return len(self.q)

    @property
    def duration(self) -> float:
        """From the first row to the last, s."""
        return (len(self.q) - 1) * self.sample_time
