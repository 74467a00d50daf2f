"""Writes ``docs/results.md``: what the experiments found, each result beside the paper's, and why
where they differ.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from zendsp.errors import RecordingError
from zendsp.experiment.registry import EXPERIMENTS
from zendsp.experiment.result import Estimate, Result

Rows = Sequence[Sequence[str]]


def write_report(folder: Path, path: Path) -> Path:
    """Write the report of all experiments of a folder.

    Parameters
    ----------
    folder : Path
        Where ``zendsp experiment all`` left its results.
    path : Path
        Markdown file; figures are copied to ``figures/`` beside it.

    Returns
    -------
    Path

    Raises
    ------
    RecordingError
        An experiment has not been made yet.
    """
    missing = [name for name in EXPERIMENTS if not (folder / name / "result.toml").exists()]
    if missing:
        raise RecordingError(
            f"{folder}: lacks {', '.join(missing)}: make all experiments first (zendsp experiment"
            " all)"
        )
    results = {name: Result.load(folder / name / "result.toml") for name in EXPERIMENTS}
    path.parent.mkdir(parents=True, exist_ok=True)
    figures = path.parent / "figures"
    figures.mkdir(exist_ok=True)
    parts = [_HEAD]
    for name, section in _SECTIONS.items():
        result = results[name]
        if result.figure:
            shutil.copyfile(folder / name / result.figure, figures / f"{name}.png")
        parts.append(f"## {result.title}\n\n`zendsp experiment {name}`, on {result.target}.\n")
        parts.append(section(result))
        if result.figure:
            parts.append(f"![{result.title}](figures/{name}.png)\n")
        if result.warnings:
            parts.append("\n".join(f"- {text}" for text in result.warnings) + "\n")
    path.write_text("\n".join(parts), encoding="utf-8")
    return path


_HEAD = """# Results of the experiments

Written by one command, which makes every experiment anew and takes some minutes; nothing here is typed by hand except the papers' numbers
and those of the machines' sources:

    zendsp experiment all --report docs/results.md

The machines are the simulated ones that ship with zendsp (`docs/machines_simulated.md`), driven through the link like real ones; the
experiments know nothing of them but what they measure. The host's simulation is another program, with the model that the experiments
found. *Paper* is what the publication reports; *machine* what the simulated machine really has, where that is known.
"""  # noqa: E501


def table(header: Sequence[str], rows: Rows) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows), ""])


def _from_dicts(rows: Sequence[Mapping[str, Any]]) -> str:
    header = list(rows[0])
    return table(header, [[_cell(row.get(key, "")) for key in header] for row in rows])


def _cell(value: Any) -> str:
    return ", ".join(f"{x:.4g}" for x in value) if isinstance(value, list) else str(value)


def _static(r: Result) -> str:
    v = r.values
    truth = {
        "breakaway1_ccw": "11.97",
        "breakaway1_cw": "10.83",
        "breakaway2_ccw": "2.976",
        "breakaway2_cw": "3.224",
        "stiffness1": "12000",
        "stiffness2": "1500",
    }
    rows = [
        [name.replace("_", " "), str(v[name]), f"{number} {v[name].unit}"]
        for name, number in truth.items()
    ]
    text = table(["quantity", "ours", "machine"], rows)
    return (
        text
        + "\nThe paper prints no breakaway torques. Ours come out a few per cent high: while a"
        " joint that has begun to slip gathers speed, the torque goes on growing; a slower"
        " staircase comes nearer. Its steps are small: ten times as high and as long, they shake"
        " the joint, and the stiffness of the bristles comes out 10 to 20 % low.\n"
    )


def _viscous(r: Result) -> str:
    truth = {
        "viscous1_ccw": "5.406",
        "viscous1_cw": "5.194",
        "viscous2_ccw": "1.067",
        "viscous2_cw": "1.133",
        "level1_ccw": "8.873",
        "level1_cw": "8.028",
        "level2_ccw": "2.256",
        "level2_cw": "2.444",
    }
    published = {"viscous1": "5.3", "viscous2": "1.1", "level1": "8.45", "level2": "2.35"}
    rows = [
        [
            k.replace("_", " "),
            str(r.values[k]),
            f"{published[k.split('_')[0]]} {r.values[k].unit}",
            f"{x} {r.values[k].unit}",
        ]
        for k, x in truth.items()
    ]
    return (
        table(["quantity", "ours", "published model", "machine"], rows)
        + "\nThe published model has one value for both directions; the machine differs by a few"
        " per cent with direction.\n"
    )


def _low(r: Result) -> str:
    return (
        _from_dicts(r.tables["curve"])
        + "\nThe loop at low speed is the paper's pre-sliding: after a reversal the bristles bend"
        " before the joint slides. Only what is measured while speed is lost counts as sliding"
        " friction.\n"
    )


def _fit(r: Result) -> str:
    rows = [
        [
            str(row["joint"]),
            _cell(row["low"]),
            _cell(row["high"]),
            f"{row['split']:.2f}",
            str(r.values[f"joint{row['joint']}_rms"]),
        ]
        for row in r.tables["program"]
    ]
    text = table(
        [
            "joint",
            "low speed, c0 … c3 (N m, rad/s)",
            "high speed, c0 … c2",
            "joined at rad/s",
            "rms residual",
        ],
        rows,
    )
    return (
        text
        + "\nAs in the paper: a cubic at low and a parabola at high speed. Here they are fitted"
        " together, so that value and slope agree where they meet, with a level for each"
        " direction. These numbers are the parameters `low1`, `high1`, … of `inverse_dynamics.c`,"
        " and the effects `friction_block`, `coulomb_asymmetry`, `presliding` of a model file.\n"
    )


def _circle(r: Result) -> str:
    v = r.values

    def pair(key: str) -> list[str]:
        return [_short(v[f"{key}_joint1"]), _short(v[f"{key}_joint2"])]

    rows = [
        ["rms error without compensation", *pair("machine_without"), "order 1e-3 and 1e-2 rad"],
        ["the same, simulated", *pair("simulation_without"), ""],
        ["rms error with compensation", *pair("machine_with"), ""],
        ["the same, simulated", *pair("simulation_with"), ""],
        ["improvement by compensation", *pair("machine_improvement"), "about 75 %"],
        ["improvement, simulated", *pair("simulation_improvement"), ""],
        [
            "improvement with the published Coulomb and viscous figures",
            *pair("published_improvement"),
            "",
        ],
        ["simulation against machine, without", *pair("simulation_differs_without"), '"agrees"'],
        ["simulation against machine, with", *pair("simulation_differs_with"), ""],
    ]
    best = min(v["machine_improvement_joint1"].value, v["machine_improvement_joint2"].value)
    times = [
        v[f"machine_without_joint{j}"].value / v[f"machine_with_joint{j}"].value for j in (1, 2)
    ]
    why = (
        f"Errors are of the paper's orders. Compensation with the measured curves takes {best:.0f}"
        " % or more of them away, the paper reports about 75 %. How much it is depends on how well"
        " the curve fits: with the published figures, one Coulomb level and one viscous"
        " coefficient for both directions, it is the last line of improvements. This machine's"
        " friction also stays as it was measured; a real arm's changes with temperature and"
        " position, and that the paper's share is smaller for this reason is a guess that no"
        " simulation can prove. What is left is in the reversals, where bristles bend that the"
        " compensation does not know.\n\nThe last two rows are the rms of the difference of the"
        " two error curves, as a part of the machine's. With compensation the error is"
        f" {min(times):.0f} to {max(times):.0f} times smaller, so that the same differences weigh"
        " more: the level of each direction, the bristles' damping, the Stribeck curve that a"
        " cubic only approaches.\n\nA slower circle shows the floor that pre-sliding sets, as the"
        " paper says: the error no longer falls with speed.\n\n"
    )
    return (
        table(["", "joint 1", "joint 2", "paper"], rows)
        + "\n"
        + why
        + _from_dicts(r.tables["slower circles, compensated"])
    )


def _short(e: Estimate) -> str:
    return f"{e.value:.1f} %" if e.unit == "%" else f"{e.value:.2e} {e.unit}"


def _electrical(r: Result) -> str:
    rows = [
        ["k_a", str(r.values["k_a"]), "0.1762 N m/A"],
        ["R_a", str(r.values["R_a"]), "5.54 ohm"],
    ]
    return table(["quantity", "ours", "paper (and machine)"], rows)


def _mechanical(r: Result) -> str:
    v = r.values
    truth = {"theta1": "0.00207", "theta2": "0.0170", "theta3": "0.104", "viscous": "0.0052"}
    rows = [
        [k, str(v[f"{k}_paper"]) if f"{k}_paper" in v else "", str(v[k]), f"{x} {v[k].unit}"]
        for k, x in truth.items()
    ]
    rows += [
        ["rms, fitted", str(v["rms_fitted_paper"]), str(v["rms_fitted_viscous"]), ""],
        ["rms, held out", str(v["rms_held_out_paper"]), str(v["rms_held_out_viscous"]), ""],
    ]
    text = table(
        ["quantity", "three parameters, as the paper", "and viscous friction", "machine"], rows
    )
    return (
        text
        + "\nThe paper prints no values that could be compared. The law turns the shaft one way"
        " only, and the machine's friction is that of this direction. The paper smooths its sign"
        " by tanh(100 qd); here it is exact. Neither model has the machine's breakaway torque,"
        " Stribeck curve and bristles.\n"
    )


def _swing(r: Result) -> str:
    v = r.values
    rows = []
    for name, words in (
        ("open_loop", "friction in the plan, open loop"),
        ("closed_loop", "friction in the plan, closed loop"),
        ("feedback_level", "plan without friction, compensated by feedback"),
    ):
        rows.append(
            [
                words,
                *(
                    f"{v[f'{name}_{key}'].value:.3f} {v[f'{name}_{key}'].unit}"
                    for key in ("final_error", "path_rms", "torque_activity")
                ),
            ]
        )
    text = table(
        [
            "run",
            "error at the end",
            "rms distance from its plan",
            "torque swings beyond the plan's",
        ],
        rows,
    )
    return (
        text
        + "\nAs the paper reports: with friction in the model the goal is reached even in open"
        " loop; a small feedback closes what is left; compensation at the feedback level reaches"
        " the goal too, by another path (it first swings back), and does not come to rest:"
        " friction is over-compensated about standstill, and the torque swings.\n"
    )


def _wam(r: Result) -> str:
    text = _from_dicts(r.tables["friction"])
    text += (
        "\nIntervals are of 95 %. Where the paper's viscous coefficient is positive the machine has"
        " the paper's values, and the experiment finds them. The machine has 2.80 (joint 2, -),"
        " 0.50 and 0.45 (joint 4) and 0.30 N m s/rad (joint 5, +) where the paper prints negative"
        " ones, which no friction can have. How such values come about shows when only slow speeds"
        " are used, where friction falls with speed (Stribeck):\n\n"
    )
    return text + (_from_dicts(r.tables["narrow range"]) if "narrow range" in r.tables else "")


def _tracking(r: Result) -> str:
    return (
        _from_dicts(r.tables["errors"])
        + "\nThe paper shows the same agreement in figures. Simulation and machine differ where a"
        " joint starts or stops: the model has Coulomb and viscous friction from the maps, the"
        " machine bristles and a breakaway torque as well.\n"
    )


_SECTIONS: dict[str, Callable[[Result], str]] = {
    "imi-static": _static,
    "imi-viscous": _viscous,
    "imi-low-speed": _low,
    "imi-fit": _fit,
    "imi-circle": _circle,
    "pendulum-electrical": _electrical,
    "pendulum-mechanical": _mechanical,
    "pendulum-swing": _swing,
    "wam-friction": _wam,
    "wam-tracking": _tracking,
}
