"""Writes ``docs/results.md``: the results of the experiments beside those of the papers, and why
they differ.
"""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from zendsp.errors import RecordingError
from zendsp.experiment.estimates import NORMAL
from zendsp.experiment.names import result_file
from zendsp.experiment.result import Cell, Estimate, Result, Row, number
from zendsp.experiment.sliding import cannot_separate
from zendsp.experiment.truth import TRUTH
from zendsp.whole_file import write_whole, writing

Rows = Sequence[Sequence[str]]
WIDTH = 100  # columns of the page's prose
REACHED = 0.1  # rad at the end: nearer than that is at the goal


def write_report(folder: Path, path: Path) -> Path:
    """Write the report of all experiments of a folder.

    Parameters
    ----------
    folder : Path
        Where ``zendsp experiment all`` left its results.
    path : Path
        Markdown file; figures are copied to ``figures/`` beside it.

    Raises
    ------
    RecordingError
        An experiment has not been made yet.
    """
    files = {name: result_file(folder, name) for name in _SECTIONS}
    missing = [name for name, file in files.items() if not file.exists()]
    if missing:
        raise RecordingError(
            f"{folder}: lacks {', '.join(missing)}: make all experiments first (zendsp experiment"
            " all)"
        )
    results = {name: Result.load(file) for name, file in files.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    figures = path.parent / "figures"
    figures.mkdir(exist_ok=True)
    parts = [_HEAD]
    for name, section in _SECTIONS.items():
        result = results[name]
        if result.figure:
            picture = figures / f"{name}.png"
            with writing(picture):
                shutil.copyfile(files[name].parent / result.figure, picture)
        parts.append(f"## {result.title}\n\n`zendsp experiment {name}`, on {result.target}.\n")
        parts.append(section(result))
        if result.figure:
            parts.append(f"![{result.title}](figures/{name}.png)\n")
        if result.warnings:
            parts.append("\n".join(f"- {text}" for text in result.warnings) + "\n")
    with writing(path):
        write_whole(path, wrapped("\n".join(parts)))
    return path


def wrapped(page: str) -> str:
    """The page with its long paragraphs and list items wrapped; tables and figures stay whole."""
    lines = []
    for line in page.split("\n"):
        if len(line) <= WIDTH or line.startswith(("|", "#", "!")):
            lines.append(line)
            continue
        hang = "  " if line.startswith("- ") else ""
        lines += textwrap.wrap(
            line, WIDTH, subsequent_indent=hang, break_long_words=False, break_on_hyphens=False
        )
    return "\n".join(lines)


_HEAD = """# Results of the experiments

    zendsp experiment all --report docs/results.md

makes every experiment again, in some minutes, and writes this page. Tables, and the sentences that
judge them, are computed; typed by hand are the papers' numbers and those of the machines' sources.

The machines are the [simulated ones](machines_simulated.md) that come with zendsp, with their noise
and imperfections, driven through the link like real ones. Their experiments are those of three
publications:

- imi_planar: Bona, Indri and Smaldone (Politecnico di Torino), fast prototyping of the control of a
  planar arm with two direct drives;
- pendulum: "Experimental Platform for Analyzing Friction Models Applied to Mechanical Systems with
  Revolute Joints", Hardware 2025, 3(3), 11;
- wam7: "Dynamic Model of a 7-DOF Whole Arm Manipulator and Validation from Experimental Data".

*Paper* is what the publication reports, *machine* what the simulated machine has, *ours* what the
experiment found. The *simulation* is the host's: another program, with the model that the
experiments found. A digit in a name is the joint; *ccw* and *+* are the positive direction, *cw*
and *-* the negative one; *level* is Coulomb friction.

± is one standard deviation. An interval is of 95 %: 1.96 of them to either side. It holds the
machine's value or does not; [the same over many repetitions](measurements/experiments.md).

**What is recovered by construction, and what is not.** The machines are built from laws that the
experiments assume: friction with a level for each direction, a viscous part, bristles that bend as
Dahl's do; a motor with k_a and R_a; the published masses. That such a law fits is no finding, and
says nothing of real machines. What the experiments are not told is what their intervals are made
of: noise of sensors and drives, resolution, the current loop, how friction varies with place, the
weight and the rotors that the WAM's data sheet lacks.
"""


def _judge(r: Result, names: Sequence[str] | None = None) -> str:
    """How many intervals hold the machine's value, and which do not, in a sentence."""
    truth = TRUTH[r.name]
    known = [n for n in (names or truth) if n in r.values and r.values[n].std > 0]
    missed = [n for n in known if abs(r.values[n].value - truth[n]) > NORMAL * r.values[n].std]
    text = f"{len(known) - len(missed)} of {len(known)} intervals hold the machine's value"
    if not missed:
        return text + ".\n"
    far = (
        f"{n.replace('_', ' ')} is {100 * (r.values[n].value / truth[n] - 1):+.1f} % off"
        for n in missed
    )
    return f"{text}: {', '.join(far)}.\n"


def _beside(r: Result, names: Sequence[str], published: Mapping[str, float] | None = None) -> str:
    """Found values beside the machine's, and beside a published model's."""
    header = ["quantity", "ours", *(["published model"] if published else []), "machine"]
    rows = []
    for name in names:
        e = r.values[name]
        middle = [f"{published[name.split('_')[0]]:g} {e.unit}"] if published else []
        rows.append(
            [name.replace("_", " "), str(e), *middle, f"{TRUTH[r.name][name]:.4g} {e.unit}"]
        )
    return table(header, rows) + "\n" + _judge(r, names)


def table(header: Sequence[str], rows: Rows) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows), ""])


def _from_dicts(rows: Sequence[Row]) -> str:
    header = list(rows[0])
    return table(header, [[_cell(row.get(key, "")) for key in header] for row in rows])


def _cell(value: Cell) -> str:
    return ", ".join(f"{x:.4g}" for x in value) if isinstance(value, list) else str(value)


def _static(r: Result) -> str:
    return _beside(r, list(TRUTH[r.name])) + (
        "\nThe paper prints no breakaway torques. The machine's value is the mean over all places;"
        " friction varies with place by 5 %, and the places were drawn at random.\n"
    )


def _viscous(r: Result) -> str:
    published = {"viscous1": 5.3, "viscous2": 1.1, "level1": 8.45, "level2": 2.35}
    return _beside(r, list(TRUTH[r.name]), published)


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
            f"{number(row, 'split'):.2f}",
            str(r.values[f"joint{row['joint']}_rms"]),
        ]
        for row in r.tables["program"]
    ]
    text = table(
        [
            "joint", "low speed, c0 … c3 (N m, rad/s)", "high speed, c0 … c2", "joined at rad/s",
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
    return (
        table(["", "joint 1", "joint 2", "paper"], rows)
        + "\n"
        + _judge_circle(r)
        + _from_dicts(r.tables["slower circles, compensated"])
    )


def _judge_circle(r: Result) -> str:
    """Sentences that compare the circle's errors with the paper's."""

    def both(key: str) -> list[float]:
        return [r.values[f"{key}_joint{j}"].value for j in (1, 2)]

    without, improved = both("machine_without"), both("machine_improvement")
    orders = [10.0**-3 <= without[0] < 10.0**-2, 10.0**-2 <= without[1] < 10.0**-1]
    agree = "both have" if all(orders) else "not both have"
    least, published = min(improved), min(both("published_improvement"))
    differs = max(both("simulation_differs_without"))
    apart = max(both("simulation_differs_with"))
    circles = r.tables["slower circles, compensated"]
    first, second = (
        number(circles[-1], of) / number(circles[0], of)
        for of in ("rms joint 1 rad", "rms joint 2 rad")
    )
    return (
        f"Without compensation {agree} the paper's order of magnitude, and the simulation is within"
        f" {differs:.0f} % of the machine; with it, where little is left, within {apart:.0f} %."
        f" Compensation with the measured curves takes {least:.0f} % or more away (the paper: about"
        f" 75 %), with the published Coulomb and viscous figures {published:.0f} %. On the slowest"
        f" circle the errors are {first:.1f} and {second:.1f} times those of the fastest (the"
        " paper: a floor that pre-sliding sets).\n\n"
    )


def _short(e: Estimate) -> str:
    return f"{e.value:.1f} %" if e.unit == "%" else f"{e.value:.2e} {e.unit}"


def _electrical(r: Result) -> str:
    return _beside(r, ["k_a", "R_a"])


def _mechanical(r: Result) -> str:
    v, truth = r.values, TRUTH[r.name]
    rows = [
        [
            k,
            str(v[f"{k}_paper"]) if f"{k}_paper" in v else "",
            str(v[k]),
            f"{x:.4g} {v[k].unit}",
        ]
        for k, x in truth.items()
    ]
    rows += [
        ["rms, fitted", str(v["rms_fitted_paper"]), str(v["rms_fitted_viscous"]), ""],
        ["rms, held out", str(v["rms_held_out_paper"]), str(v["rms_held_out_viscous"]), ""],
    ]
    text = table(
        ["quantity", "three parameters, as the paper", "and viscous friction", "machine"], rows
    )
    better = v["rms_held_out_viscous"].value < v["rms_held_out_paper"].value
    return (
        f"{text}\nWith viscous friction: {_judge(r)}"
        "theta1 is the inertia, theta2 times 9.81 m/s^2 the torque of the weight, theta3 the"
        " Coulomb friction. Under the torque that was held out the position is predicted"
        f" {'better' if better else 'no better'} with viscous friction than without. The paper"
        " prints no values that could be compared. Its torque turns the shaft one way only, and the"
        " machine's friction is that of this direction.\n"
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
                    # no -0.000
                    f"{round(v[f'{name}_{key}'].value, 3) + 0.0:.3f} {v[f'{name}_{key}'].unit}"
                    for key in ("final_error", "path_rms", "torque_activity")
                ),
            ]
        )
    text = table(
        [
            "run", "error at the end", "rms distance from its plan",
            "torque swings beyond the plan's",
        ],
        rows,
    )
    error = {n: v[f"{n}_final_error"].value for n in ("open_loop", "closed_loop", "feedback_level")}
    swings = v["feedback_level_torque_activity"].value > 2 * v["closed_loop_torque_activity"].value
    reached = [n.replace("_", " ") for n, e in error.items() if e < REACHED]
    return text + (
        f"\nThe goal is reached within {REACHED:g} rad by: {', '.join(reached) or 'none'} (the"
        " paper: with friction in the model even in open loop). Compensation at the feedback level"
        f" {'makes' if swings else 'does not make'} the torque swing more than twice as much as a"
        " closed loop does (the paper: it oscillates).\n"
    )


def _wam(r: Result) -> str:
    text = _from_dicts(r.tables["friction"]) + "\n" + _judge(r)
    lacks = ", ".join(
        f"{r.values[key].value:.2g}"
        for key in (f"gravity{j}_lacking" for j in range(1, 8))
        if key in r.values
    )
    text += (
        "\nThe program compensates the weight of the data sheet, and the arm weighs something else:"
        f" beside friction the maps find what is lacking, at most {lacks} N m along each joint's"
        " way. It is what makes the Coulomb levels of heavy joints uncertain: a constant weight and"
        " a difference between the directions look alike; the mean of the two levels is known far"
        " better. The machine has 2.80 (joint 2, -), 0.50 and 0.45 (joint 4) and 0.30 N m s/rad"
        " (joint 5, +) where the paper prints negative coefficients, which no friction can have."
        " With slow speeds only, where friction falls with speed (Stribeck):\n\n"
    )
    if "narrow range" not in r.tables:
        return text
    narrow = (e for key, e in r.values.items() if key.endswith("_narrow"))
    few = sum(cannot_separate(e.value, NORMAL * e.std) for e in narrow)
    return text + _from_dicts(r.tables["narrow range"]) + (
        f"\n{few} of these are no physical constants, and the experiment says so.\n"
    )


def _tracking(r: Result) -> str:
    apart = [e.value for key, e in r.values.items() if key.endswith("_apart")]
    return _from_dicts(r.tables["errors"]) + (
        f"\nThe simulation's error curve is {min(apart):.0f} to {max(apart):.0f} % of the machine's"
        " away from it. The paper shows agreement in figures, without a number. What the model"
        " lacks: bristles and breakaway, rotors, and the arm's true weight.\n"
    )


_SECTIONS: dict[str, Callable[[Result], str]] = {
    "breakaway": _static, "high-speed": _viscous, "low-speed": _low, "friction-curve": _fit,
    "circle": _circle, "electrical": _electrical, "mechanical": _mechanical,
    "swing": _swing, "friction": _wam, "tracking": _tracking,
}
