"""The shipped machines in C as a reality: they equal their model except for what is concealed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from zendsp.proof import shipped
from zendsp.proof.case import Request
from zendsp.proof.mechanisms import LAWS, MECHANISM
from zendsp.proof.shipped import record, scale_of
from zendsp.proof.shipped_laws import EFFECTS, FOREIGN, FOREIGN_MECHANISMS, PERIOD, RIGS, Rig


def rig(machine: str, seconds: float) -> Rig:
    r = RIGS[machine]()
    r.seconds = seconds
    return r


def test_torque_of_the_planar_machine_is_its_models() -> None:
    """M(q) qdd + C + friction along the true motion is the command of the row before, to a
    hundredth, where the drives add neither noise nor steps.
    """
    r = rig("c_planar", 3.0)
    r.ideal = True
    run = record(r, "sines", np.random.default_rng(1))
    q, v = 0.5 * (run.q[1:] + run.q[:-1]), 0.5 * (run.v[1:] + run.v[:-1])
    a = np.diff(run.v, axis=0) / PERIOD
    p1, p2, p3 = (r.figures[k] for k in ("p1", "p2", "p3"))
    c, s = p3 * np.cos(q[:, 1]), p3 * np.sin(q[:, 1])
    torque = np.stack(
        [
            (p1 + 2 * c) * a[:, 0] + (p2 + c) * a[:, 1] - s * v[:, 1] * (2 * v[:, 0] + v[:, 1]),
            (p2 + c) * a[:, 0] + p2 * a[:, 1] + s * v[:, 0] ** 2,
        ],
        1,
    ) + np.array(r.viscous) * v + np.array(r.coulomb) * np.sign(v)  # fmt: skip
    slides = np.all(np.abs(v) > 0.05, axis=1)[1:]
    rest = (torque[1:] - run.command[:-2])[slides]
    assert slides.sum() > 1000
    assert np.all(np.sqrt(np.mean(rest**2, 0)) < 0.01 * np.sqrt(np.mean(run.command**2, 0)))


@pytest.mark.parametrize("machine", RIGS)
def test_every_effect_is_taken_by_the_machine_and_named_by_the_contract(machine: str) -> None:
    r = rig(machine, 1.0)
    scale = scale_of(r, record(r, "sines", np.random.default_rng(2)), 0)
    for kind, names in (("single", EFFECTS), ("foreign", FOREIGN)):
        for name in names:
            changed = rig(machine, 0.05)
            shipped.conceal(
                changed, Request(1, kind, machine, name, 0.1), 0, scale, np.random.default_rng(3)
            )
            (truth,) = changed.truths
            assert truth["effect"] in MECHANISM or kind == "foreign"
            record(changed, "sines", np.random.default_rng(2))  # the machine knows its words
    assert all(set(m) <= set(LAWS) for m in FOREIGN_MECHANISMS)


def test_same_seed_same_bits_and_the_truth_is_not_in_the_model(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def short(make: Callable[[], Rig]) -> Callable[[], Rig]:
        def made() -> Rig:
            r = make()
            r.seconds = 1.0
            return r

        return made

    monkeypatch.setattr(shipped, "RIGS", {name: short(make) for name, make in RIGS.items()})
    request = Request(5, "single", "c_planar", "coulomb", 0.2, "machines")
    a, b = (shipped.attempt_case(request, np.random.default_rng(5)) for _ in range(2))
    assert (
        np.array_equal(a.train.measured, b.train.measured)
        and a.model == b.model
        and a.truth == b.truth
    )
    joint = a.truth["effects"][0]["joint"]
    assert ("coulomb", joint) not in {(e["kind"], e["joint"]) for e in a.model["effect"]}
    assert ("coulomb", 3 - joint) in {(e["kind"], e["joint"]) for e in a.model["effect"]}
