"""The model that is given: wrong by a few percent, its friction fitted without the concealed
effect.
"""

from __future__ import annotations

import numpy as np

from zendsp.proof.draft import Array, Draft, Scale
from zendsp.proof.model_table import (
    Columns,
    EffectTable,
    Mechanism,
    ModelTable,
    Parameter,
    one_or_each,
    parameter,
)
from zendsp.proof.reality import inverse_dynamics

PARAMETER = {"viscous": "coefficient", "coulomb": "level", "quadratic_drag": "coefficient"}
TRUTH = {"viscous": "viscous_pos", "coulomb": "coulomb_pos", "quadratic_drag": "drag"}


def feature(law: str, v: Array) -> Array:
    """Torque of a friction law with coefficient 1."""
    if law == "viscous":
        return v
    return np.sign(v) if law == "coulomb" else v * np.abs(v)


def inertial_torque(d: Draft, parameters: dict[str, float], scales: list[Scale]) -> list[Array]:
    """M(q) a + bias of the given mechanism along the true motion, per joint."""
    s = scales[0]
    if d.kind == "urdf":
        q, v, a = (np.stack([getattr(x, name) for x in scales], 1) for name in "qva")
        return list(inverse_dynamics(d.mechanism_alone(), q, v, a).T)
    if d.kind == "linear":
        return [parameters["mass"] * s.a]
    if d.kind == "rotary":
        return [parameters["inertia"] * s.a + parameters.get("gravity", 0.0) * np.sin(s.q)]
    p1, p2, p3 = (parameters[k] for k in ("p1", "p2", "p3"))
    (a1, a2), (v1, v2), q2 = (scales[0].a, scales[1].a), (scales[0].v, scales[1].v), scales[1].q
    c, k = p3 * np.cos(q2), p3 * np.sin(q2)
    return [
        (p1 + 2 * c) * a1 + (p2 + c) * a2 - k * v2 * (2 * v1 + v2),
        (p2 + c) * a1 + p2 * a2 + k * v1**2,
    ]


def given_parameters(d: Draft, rng: np.random.Generator) -> dict[str, float]:
    """True inertial figures with errors of 3 % (none where the draft says exact or the figure is
    fixed).
    """
    out = {}
    for name, value in d.parameters.items():
        wrong = 1 + 0.03 * rng.standard_normal()
        sure = d.exact or name in d.fixed
        out[name] = 0.0 if name in d.absent else value if sure else value * wrong
    return out


def fit_terms(d: Draft, parameters: dict[str, float], scales: list[Scale]) -> list[EffectTable]:
    """Friction of the given laws by least squares on the true motion, wrong inertia and concealed
    effect included.
    """
    out: list[EffectTable] = []
    inertial = inertial_torque(d, parameters, scales)
    for i, s in enumerate(scales):
        names = sorted(d.terms[i], reverse=True)
        if not names:
            continue
        columns = np.stack([feature(name, s.v) for name in names], 1)
        if d.exact or d.fixed_terms:
            fit = np.array([d.joints[i].get(TRUTH[name], 0.0) for name in names])
        else:
            target = s.drive - inertial[i] - known_torque(d, i, s)
            fit = np.linalg.lstsq(columns, target, rcond=None)[0]
        for name, value in zip(names, fit, strict=True):
            key = PARAMETER[name]
            floor = 1e-3 * s.torque / float(np.sqrt(np.mean(feature(name, s.v) ** 2)))
            entry = parameter(max(float(value), floor), d.fixed_terms)
            out.append({"kind": name, "joint": i + 1, key: entry})
    return out


def known_torque(d: Draft, joint: int, s: Scale) -> Array:
    """Torque of the effects that the given model has as they are."""
    total = np.zeros_like(s.v)
    for term in d.known:
        if term.joint != joint + 1:
            continue
        p = term.values
        if term.kind == "stiffness":
            total += p["coefficient"] * (s.q - p["neutral"])
        elif term.kind == "ripple":
            total += p["amplitude"] * np.sin(p["order"] * s.q + p["phase"])
        elif term.kind == "quadratic_drag":
            total += p["coefficient"] * s.v * np.abs(s.v)
        elif term.kind == "torque_offset":
            total += p["level"]
    return total


def model_file(
    d: Draft, scales: list[Scale], columns: Columns, rng: np.random.Generator, name: str
) -> ModelTable:
    """The given model as the table that ``model.toml`` holds."""
    parameters = given_parameters(d, rng)
    mechanism: Mechanism = {"kind": d.kind}
    if d.kind == "urdf":
        mechanism["file"] = "arm.urdf"
    else:
        mechanism["parameters"] = figures(d, parameters)
    effects = [*fit_terms(d, parameters, scales), *known_terms(d, rng)]
    table: ModelTable = {
        "name": name,
        "sample_time": d.sample_time,
        "mechanism": mechanism,
        "effect": effects,
        "actuator": {
            "gain": parameter(one_or_each(d.stated_gain), fixed=True),
            "limit": one_or_each([j["limit"] for j in d.joints]),
            "hold": d.sample_time,
            "delay": d.known_delay,
        },
        "sensor": {"position_resolution": one_or_each([j["resolution"] for j in d.joints])},
        "columns": columns,
    }
    if not effects:
        del table["effect"]
    if d.show_controller and not d.open_loop:
        table["controller"] = {"kind": "pd", "kp": one_or_each(d.kp), "kd": one_or_each(d.kd)}
    return table


def figures(d: Draft, parameters: dict[str, float]) -> dict[str, Parameter]:
    """``[mechanism.parameters]``; what the draft fixes, or leaves out, is not calibrated."""
    fixed = {*d.fixed, *d.absent, *(["gravity"] if parameters.get("gravity") == 0.0 else [])}
    out = {key: parameter(value, key in fixed) for key, value in parameters.items()}
    if d.kind == "planar2r":
        out |= {"l1": parameter(0.36, fixed=True), "l2": parameter(0.34, fixed=True)}
    return out


def known_terms(d: Draft, rng: np.random.Generator) -> list[EffectTable]:
    """Effects of the truth that the given model has; sizes off by 3 % unless the draft is exact."""
    out: list[EffectTable] = []
    for term in d.known:
        entry: EffectTable = {"kind": term.kind, "joint": term.joint, **term.extra}
        for key, value in term.values.items():
            sure = d.exact or key in ("order", "neutral", "phase")
            entry[key] = parameter(value * (1.0 if sure else 1 + 0.03 * rng.standard_normal()))
        out.append(entry)
    return out
