"""The values that the simulated machines have by their C sources, for reports and for counting how
often stated intervals hold. No experiment reads them.
"""

from __future__ import annotations

# N m and N m s/rad of the WAM, pos and neg, as in wam7.c
_WAM = {
    1: (4.4748, 4.3609, 1.3348, 0.8266), 2: (2.6385, 3.5643, 3.5572, 2.80),
    3: (1.7399, 2.3529, 0.3944, 1.2075), 4: (1.5414, 0.7342, 0.50, 0.45),
    5: (0.2798, 0.1172, 0.30, 1.467), 6: (0.4834, 0.4417, 0.8291, 0.1836),
    7: (0.0538, 0.1370, 1.0689, 0.7954),
}
_NAMES = ("coulomb{}_pos", "coulomb{}_neg", "viscous{}_pos", "viscous{}_neg")

# Experiment to quantity to value, in the quantity's unit. Levels of the planar arm are means over
# all places; the pendulum's are those of the direction in which the experiment turns it.
TRUTH: dict[str, dict[str, float]] = {
    "breakaway": {
        "breakaway1_ccw": 11.4 * 1.05,
        "breakaway1_cw": 11.4 * 0.95,
        "breakaway2_ccw": 3.1 * 0.96,
        "breakaway2_cw": 3.1 * 1.04,
        "stiffness1": 12000.0,
        "stiffness2": 1500.0,
    },
    "high-speed": {
        "viscous1_ccw": 5.3 * 1.02,
        "viscous1_cw": 5.3 * 0.98,
        "viscous2_ccw": 1.1 * 0.97,
        "viscous2_cw": 1.1 * 1.03,
        "level1_ccw": 8.45 * 1.05,
        "level1_cw": 8.45 * 0.95,
        "level2_ccw": 2.35 * 0.96,
        "level2_cw": 2.35 * 1.04,
    },
    "electrical": {"k_a": 0.1762, "R_a": 5.54},
    "mechanical": {
        "theta1": 2.07e-3, "theta2": 0.0170, "theta3": 0.104, "viscous": 0.0052,
    },
    "friction": {
        name.format(joint): value
        for joint, row in _WAM.items()
        for name, value in zip(_NAMES, row, strict=True)
    },
}

_PLANAR = TRUTH["high-speed"]


def _both_ways(found: dict[str, float]) -> dict[str, float]:
    """The values, with the means of both directions added."""
    means = {
        name[:-4]: 0.5 * (value + found[f"{name[:-4]}_neg"])
        for name, value in found.items()
        if name.endswith("_pos")
    }
    return found | means


# Machine to quantity to value: what `friction` of any machine finds
FRICTION: dict[str, dict[str, float]] = {
    "imi_planar": _both_ways({
        f"{new}{joint}_{end}": _PLANAR[f"{old}{joint}_{way}"]
        for joint in (1, 2)
        for old, new in (("level", "coulomb"), ("viscous", "viscous"))
        for end, way in (("pos", "ccw"), ("neg", "cw"))
    }),
    "pendulum": _both_ways({
        "coulomb1_pos": 0.104, "coulomb1_neg": 0.096,
        "viscous1_pos": 0.0052, "viscous1_neg": 0.0048,
    }),
    "wam7": _both_ways(TRUTH["friction"]),
}

# What the experiments of any machine find on the pendulum, its brake at 0.08 N m
PENDULUM: dict[str, dict[str, float]] = {
    "low-speed": {"inertia1": 2.07e-3, "weight1_sin": 0.16677},
    "breakaway": {"breakaway1": 0.1 * (1.27 + 1.19) / 2},
    "high-speed": {"level1": 0.1, "viscous1": 0.005},
}
