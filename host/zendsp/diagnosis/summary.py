"""The outcome in ten seconds, for a terminal."""

from __future__ import annotations

from zendsp.diagnosis.result import Diagnosis


def summary(d: Diagnosis) -> str:
    """Text of at most a screen: verdict, findings, fit, where, what next."""
    headline = {
        "complete": "COMPLETE: nothing significant is missing from this model.",
        "missing": f"MISSING PHYSICS: {len(d.findings)} finding{'s' if len(d.findings) != 1 else ''}.",
        "unexplained": "UNEXPLAINED: something is missing that no known effect explains.",
    }[d.verdict]
    lines = [headline, ""]
    for k, f in enumerate(d.findings, 1):
        lines.append(f"{k}. {f.effect}, joint {f.joint} (confidence {100 * f.confidence:.0f} %)")
        lines.append(f"   {f.sentence}")
    if d.unexplained:
        lines.append(d.unexplained)
    if d.findings or d.unexplained:
        lines.append("")
    lines.append(
        f"position error within 0.25 s ({d.unit}, RMS)   given      calibrated  improved   noise floor"
    )
    for name, table in (("  recordings of the fit", d.estimation), ("  held-out recordings", d.heldout)):
        lines.append(
            f"{name:<44} {table.given:<10.3g} {table.calibrated:<11.3g} {table.improved:<10.3g} {d.noise_floor:.3g}"
        )
    for r in d.regions[:2]:
        lines.append(
            f"mismatch: joint {r.joint}, {r.variable} {r.interval[0]:.3g} … {r.interval[1]:.3g}: {100 * r.share:.0f} % of it in {100 * r.time_share:.0f} % of the time"
        )
    if d.next_recording:
        lines += ["", f"next: {d.next_recording.sentence}"]
    if d.notes:
        lines += ["", *[f"note: {n}" for n in d.notes]]
    lines.append(f"({d.seconds:.1f} s)")
    return "\n".join(lines)
