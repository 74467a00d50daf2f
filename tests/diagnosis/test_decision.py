"""What is claimed, and what is not: the decision on recordings that neither the fit nor any choice
has touched.
"""

from __future__ import annotations

from pathlib import Path

import pytest
import reality

from zendsp.diagnosis import Diagnosis, diagnose

RATE = 500.0
KNOWN = [reality.effect("viscous", coefficient=0.004), reality.effect("coulomb", level=0.03)]


def decided(
    folder: Path, fit: reality.Machine, held: reality.Machine | None = None, *effects: object
) -> Diagnosis:
    machines = ((fit, 9.0, 1), (held or fit, 12.0, 2))
    files = [
        reality.save(
            folder / f"run{seed}.csv",
            reality.simulate(m, reality.multisine(s, RATE, seed), RATE, seed),
        )
        for m, s, seed in machines
    ]
    model = reality.model_file(
        folder / "model.toml", RATE, *(effects or KNOWN), resolution=fit.resolution
    )
    return diagnose(files[0], model, files[1])


def test_what_only_the_recordings_of_the_fit_show_is_not_claimed(tmp_path: Path) -> None:
    d = decided(tmp_path, reality.Machine(ripple=0.02), reality.Machine())
    assert d.findings == ()
    assert d.test is not None and d.test.improved <= d.test.calibrated


def test_a_look_alike_of_a_law_is_a_mechanism_without_one_or_unexplained(tmp_path: Path) -> None:
    d = decided(tmp_path, reality.Machine(sticky=0.02))
    assert d.verdict in ("missing", "unexplained")
    assert all(
        f.effect == "unknown" and f.mechanism == "dry_friction" for f in d.findings
    ), d.findings


def test_a_push_is_a_disturbance_with_its_times(tmp_path: Path) -> None:
    d = decided(
        tmp_path, reality.Machine(push=(0.06, 2.0, 4.0)), reality.Machine(push=(0.06, 8.0, 10.0))
    )
    assert [f.effect for f in d.findings] == ["disturbance"]
    spans = d.findings[0].numbers["intervals"]
    assert spans[0][0] == pytest.approx(8.0, abs=0.2) and spans[-1][1] == pytest.approx(
        10.0, abs=0.2
    )
    assert d.findings[0].parameters["peak"].value == pytest.approx(0.06, rel=0.3)


def test_one_mechanism_is_one_finding(tmp_path: Path) -> None:
    d = decided(tmp_path, reality.Machine(breakaway=0.05), None, KNOWN[0])
    assert [f.mechanism for f in d.findings] == ["dry_friction"]


def test_complete_says_what_would_have_been_seen_and_an_effect_of_twice_that_is_named(
    tmp_path: Path,
) -> None:
    d = decided(tmp_path, reality.Machine())
    assert d.verdict == "complete"
    ripple = next(x for x in d.detectable if x.effect == "ripple")
    assert 0 < ripple.size < 0.01
    again = decided(tmp_path, reality.Machine(ripple=2 * ripple.size))
    assert [f.effect for f in again.findings] == ["ripple"]
