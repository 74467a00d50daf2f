"""The rigid-body part of a model as C."""

from __future__ import annotations

from importlib import resources

import numpy as np
import numpy.typing as npt

from zendsp.errors import ModelError
from zendsp.physics.codegen.terms import Variable, number
from zendsp.physics.model import TREES, Model, per_joint
from zendsp.physics.simulation.plant import aside_of, tree_of

Array = npt.NDArray[np.float64]


def rigid_code(model: Model) -> tuple[list[Variable], str, str, str]:
    """C of M(q) qdd + C(q, qd) qd + g(q) for one model.

    Returns
    -------
    variables : list of Variable
        Numbers that can be tuned.
    text : str
        Definitions and the two functions ``model_rigid`` and ``model_gravity``.
    declarations : str
        Further lines for UserInit (arrays).
    note : str
        The equation.

    Raises
    ------
    ModelError
        A kind that has no rigid-body form.
    """
    if model.kind in ("rotary", "linear"):
        return _diagonal(model)
    if model.kind == "planar2r":
        return _planar(model)
    if model.kind in TREES:
        return _tree(model)
    raise ModelError(
        f"{model.name}: kind = {model.kind!r} has no rigid-body form that could become C"
    )


def _function(name: str, body: str) -> str:
    return (
        f"static inline void {name}("
        "const double *pos, const double *vel, const double *acc, double *torque) {\n"
        f"    (void)pos, (void)vel, (void)acc;\n{body}}}\n"
    )


def _diagonal(model: Model) -> tuple[list[Variable], str, str, str]:
    key, unit = ("inertia", "kg m^2") if model.kind == "rotary" else ("mass", "kg")
    variables, rigid, gravity = [], "", ""
    for j in range(model.joints):
        masses = tuple(q.value for q in model.mechanism[key])
        weights = (
            tuple(q.value for q in model.mechanism.get("gravity", ()))
            if model.kind == "rotary"
            else ()
        )
        name = f"model_{key}{j + 1}"
        variables.append(
            Variable(name, per_joint(masses, j + 1, 0.0), unit, f"{key} of joint {j + 1}")
        )
        term = "0.0"
        if per_joint(weights, j + 1, 0.0) != 0.0:
            variables.append(
                Variable(
                    f"model_gravity{j + 1}", per_joint(weights, j + 1, 0.0), "N m",
                    f"gravity torque of joint {j + 1}, m g l",
                )
            )
            term = f"model_gravity{j + 1} * sin(pos[{j}])"
        rigid += f"    torque[{j}] = {name} * acc[{j}] + {term};\n"
        gravity += f"    torque[{j}] = {term};\n"
    return (
        variables,
        _function("model_rigid", rigid) + "\n" + _function("model_gravity", gravity),
        "",
        f"{key} qdd + gravity sin(q)",
    )


def _planar(model: Model) -> tuple[list[Variable], str, str, str]:
    words = {
        "p1": "inertia of both links about axis 1",
        "p2": "inertia of link 2 about axis 2",
        "p3": "coupling of the links",
    }
    variables = [
        Variable(f"model_{k}", model.mechanism[k][0].value, "kg m^2", text)
        for k, text in words.items()
    ]
    at = "pos[1]"
    if aside := aside_of(model):
        variables.append(Variable("model_p3_angle", aside, "rad", "of a load beside link 2's line"))
        at = "pos[1] + model_p3_angle"
    rigid = (
        f"    const double c = model_p3 * cos({at}), s = model_p3 * sin({at});\n"
        "    torque[0] = (model_p1 + 2.0 * c) * acc[0] + (model_p2 + c) * acc[1]"
        " - s * vel[1] * (2.0 * vel[0] + vel[1]);\n"
        "    torque[1] = (model_p2 + c) * acc[0] + model_p2 * acc[1] + s * vel[0] * vel[0];\n"
    )
    gravity = "    torque[0] = torque[1] = 0.0;\n"
    note = "M = [[p1 + 2 p3 cos q2, p2 + p3 cos q2], [p2 + p3 cos q2, p2]]"
    return (
        variables,
        _function("model_rigid", rigid) + "\n" + _function("model_gravity", gravity),
        "",
        note,
    )


def _tree(model: Model) -> tuple[list[Variable], str, str, str]:
    rows, gravity = tree_of(model)
    n = len(rows)
    sources = resources.files("zendsp.physics.simulation")
    head = sources.joinpath("tree.h").read_text(encoding="utf-8")

    def array(name: str, values: Array, size: str) -> str:
        return (
            f"static double {name}[{size}] = {{{', '.join(number(v) for v in np.ravel(values))}}};"
        )

    geometry = (
        "static const double model_geometry[MODEL_JOINTS * 17] = { /* parent, prismatic, axis, R, p"
        " of each joint */\n"
        + "".join(f"    {', '.join(number(v) for v in row[:17])},\n" for row in rows)
        + "};"
    )
    text = "\n".join(
        [
            head,
            geometry,
            array("model_mass", rows[:, 17], "MODEL_JOINTS"),
            array("model_com", rows[:, 18:21], "MODEL_JOINTS * 3"),
            array("model_inertia", rows[:, 21:27], "MODEL_JOINTS * 6"),
            array("model_rotor", rows[:, 27], "MODEL_JOINTS"),
            array("model_g", gravity, "3"),
            _TREE,
        ]
    )
    declarations = "\n".join(
        [
            '    PARAMETER_ARRAY(model_mass, "kg", 0.0, NO_MAX, "mass of each link");',
            (
                '    PARAMETER_ARRAY(model_com, "m", NO_MIN, NO_MAX, "centre of mass of each link,'
                ' x y z");'
            ),
            (
                '    PARAMETER_ARRAY(model_inertia, "kg m^2", NO_MIN, NO_MAX, "inertia of each link'
                ' about it, xx yy zz xy xz yz");'
            ),
            (
                '    PARAMETER_ARRAY(model_rotor, "kg m^2", 0.0, NO_MAX, "inertia added at each'
                ' joint");'
            ),
            '    PARAMETER_ARRAY(model_g, "m/s^2", NO_MIN, NO_MAX, "gravity, x y z of the base");',
        ]
    )
    return [], text, declarations, f"Newton-Euler over the {n} joints of {model.file}"


_TREE = """
static inline void model_links(double *tree) {
    for (int j = 0; j < MODEL_JOINTS; j++) {
        double *row = tree + j * TREE_ROW;
        for (int i = 0; i < 17; i++)
            row[i] = model_geometry[j * 17 + i];
        row[TREE_MASS] = model_mass[j];
        for (int i = 0; i < 3; i++)
            row[TREE_COM + i] = model_com[j * 3 + i];
        for (int i = 0; i < 6; i++)
            row[TREE_I + i] = model_inertia[j * 6 + i];
        row[TREE_ROTOR] = model_rotor[j];
    }
}

static inline void model_rigid(const double *pos, const double *vel, const double *acc, double *torque) {
    double tree[MODEL_JOINTS * TREE_ROW];
    tree_pose pose;
    model_links(tree);
    tree_place(MODEL_JOINTS, tree, pos, &pose);
    tree_torque(MODEL_JOINTS, tree, &pose, model_g, vel, acc, torque);
}

static inline void model_gravity(const double *pos, const double *vel, const double *acc, double *torque) {
    const double still[MODEL_JOINTS] = {0.0};
    (void)vel, (void)acc;
    model_rigid(pos, still, still, torque);
}
"""  # noqa: E501
