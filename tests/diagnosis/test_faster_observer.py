"""Friction that falls with the speed faster than the usual observers follow."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import reality
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.explain import faster_observer
from zendsp.diagnosis.measure import bursts
from zendsp.diagnosis.measure.discrepancy import BANDS
from zendsp.diagnosis.search.hypothesis import Rival

QUICKLY = 1000.0  # Hz
BENCH = model_of(VISCOUS, COULOMB, rate=QUICKLY)
FAST = 4.0 * BANDS[0]  # rad/s


def parts_of() -> Parts:
    run = reality.simulate(reality.Machine(), reality.multisine(2.0, QUICKLY, 3), QUICKLY)
    data = data_of(run, BENCH, QUICKLY)
    held_out = data_of(run, BENCH, QUICKLY)
    return Parts(data, held_out, held_out)


@pytest.mark.parametrize(
    ("kind", "given", "falls", "under", "verdict"),
    [
        (Verdict.DISTURBANCE, 0.0, True, [64.0, FAST], Verdict.MISSING),
        (Verdict.UNEXPLAINED, 0.0, True, [64.0, FAST], Verdict.MISSING),
        (Verdict.UNEXPLAINED, 0.0, False, [64.0], Verdict.UNEXPLAINED),
        (Verdict.COMPLETE, 0.0, True, [64.0], Verdict.COMPLETE),
        (Verdict.COMPLETE, 119.0, True, [FAST], Verdict.MISSING),  # the given model's own
    ],
)
def test_a_joint_whose_friction_falls_fast_is_searched_under_a_faster_observer(
    kind: Verdict,
    given: float,
    falls: bool,
    under: list[float],
    verdict: Verdict,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A Stribeck curve of 119 /s was a disturbance (0.85) in three machines of an examiner's."""
    asked: list[float] = []

    def search(parts: Parts) -> Any:
        asked.append(parts.fit.bandwidth[0])
        assert parts.choose is parts.test and parts.test.bandwidth == parts.fit.bandwidth
        return None, SimpleNamespace(kind=kind if asked[-1] == 64.0 else Verdict.MISSING)

    monkeypatch.setattr(faster_observer, "runs_away", lambda *_: given)
    monkeypatch.setattr(faster_observer, "_falls_fast", lambda *_: falls)
    _, decision = faster_observer.searched(search, parts_of(), BENCH, 1, 1, lambda _: None)
    assert asked == under and decision.kind == verdict


def test_recordings_too_slow_for_a_faster_observer_keep_theirs() -> None:
    record: Any = SimpleNamespace(sample_time=0.01)
    data: Any = SimpleNamespace(records=((record,),))
    assert faster_observer.faster(Parts(data, data, data), 1) is None


@pytest.mark.parametrize(
    ("deviance", "away", "fast"),
    [(-900.0, 119.0, True), (-900.0, 30.0, False), (-520.0, 119.0, False)],
)
def test_friction_falls_fast_where_that_explains_more_than_all_that_was_found(
    deviance: float, away: float, fast: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    base: Any = SimpleNamespace(model=BENCH, deviance=0.0)
    found: Any = SimpleNamespace(base=base, final=SimpleNamespace(deviance=-500.0))
    scored: Any = SimpleNamespace(deviance=deviance, model=BENCH)
    monkeypatch.setattr(faster_observer, "calibrate_joint", lambda *_: base)
    monkeypatch.setattr(faster_observer, "runs_away", lambda *_: away)

    def only(_: Any, __: Any, laws: frozenset[str]) -> list[Rival]:
        assert "stribeck" in laws
        return [Rival("stribeck", 1, scored, 0.0, (), ())]

    monkeypatch.setattr(faster_observer.Rounds, "stand_ins", only)
    assert faster_observer._falls_fast(parts_of(), found, 1, 1, lambda _: None) is fast


def test_no_push_is_seen_by_an_observer_that_does_not_hold_the_model(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    fast = faster_observer.faster(parts_of(), 1)
    assert fast is not None
    monkeypatch.setattr(bursts, "lacks_of", lambda *_: pytest.fail("its torque is no push"))
    assert bursts.bursts(fast.test, BENCH, 1, fast.fit) is None
