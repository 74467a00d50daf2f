"""The torque of an added body, compared with the inverse dynamics of the changed machine and with
Pinocchio.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from zendsp.errors import ModelError
from zendsp.physics.files.model_file import load_model, parse_model
from zendsp.physics.files.model_write import model_text
from zendsp.physics.model import Quantity, Term
from zendsp.physics.robots.bodies import Links, change_of, changed, numbers_of, turned_gravity
from zendsp.physics.robots.rigid import bases
from zendsp.physics.robots.urdf import read_urdf
from zendsp.tree import inverse_dynamics, mass_matrices, own_inertias, torque_slope

MODELS = Path(__file__).parents[2] / "examples" / "models"
ARM = MODELS / "wam7.urdf"
N = 40


def term(effect: str, joint: int = 1, **values: float) -> Term:
    return Term(effect, joint, {key: Quantity(value) for key, value in values.items()})


TERMS = {
    "payload at the tool": [
        term("payload", 7, mass=1.3, com_x=0.02, com_y=-0.05, com_z=0.11, inertia=0.004)
    ],
    "payload on the forearm": [term("payload", 4, mass=0.7, com_x=0.1, com_y=0.0, com_z=-0.03)],
    "heavier link": [term("body", 2, mass=0.4)],
    "shifted link": [term("body", 4, com_x=0.03, com_y=-0.01, com_z=0.02, inertia=0.003)],
    "tilted base": [term("base_tilt", angle_x=0.3, angle_y=-0.2)],
    "payload on a tilted base": [
        term("base_tilt", angle_x=-0.1, angle_y=0.4),
        term("payload", 7, mass=0.9, com_z=0.2),
    ],
}


@pytest.fixture(scope="module")
def motion() -> np.ndarray:
    scale = np.array([1.5, 2.0, 8.0])[None, :, None]
    return np.asarray(np.random.default_rng(3).normal(size=(7, 3, N)) * scale)


def torque(bodies, gravity, motion: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Torque of all joints, (joints, n)."""
    return inverse_dynamics(bodies, gravity, *(motion[:, i].T for i in range(3))).T


@pytest.mark.parametrize("name", TERMS)
def test_terms_add_what_the_inverse_dynamics_of_the_changed_arm_does(
    name: str, motion: np.ndarray
) -> None:
    bodies, gravity = read_urdf(str(ARM))
    terms, links = TERMS[name], Links(tuple(bodies), gravity, motion)
    truth = torque(changed(bodies, terms), turned_gravity(gravity, terms), motion) - torque(
        bodies, gravity, motion
    )
    for j in range(7):
        change = links.change(terms, j)
        got = change.inertia * motion[j, 2] + change.bias
        assert np.abs(got - truth[j]).max() < 1e-9 * max(1.0, np.abs(truth).max())


def test_inertia_is_the_derivative_of_torque_by_the_joints_own_acceleration(
    motion: np.ndarray
) -> None:
    bodies, gravity = read_urdf(str(ARM))
    terms = TERMS["payload at the tool"]
    more = changed(bodies, terms)
    for j in range(7):
        pushed = motion.copy()
        pushed[j, 2] += 1.0  # torque is linear in the acceleration: a step of any size is exact
        answer = (torque(more, gravity, pushed) - torque(more, gravity, motion))[j]
        answer -= (torque(bodies, gravity, pushed) - torque(bodies, gravity, motion))[j]
        assert (
            np.abs(Links(tuple(bodies), gravity, motion).change(terms, j).inertia - answer).max()
            < 1e-10
        )


@pytest.mark.parametrize("slides", [(), (0, 3)])
def test_a_joints_own_inertia_is_the_mass_matrixs(
    slides: tuple[int, ...], motion: np.ndarray
) -> None:
    bodies = [replace(b, slides=k in slides) for k, b in enumerate(read_urdf(str(ARM))[0])]
    q = motion[:, 0].T
    whole = np.diagonal(mass_matrices(bodies, q), axis1=1, axis2=2)
    np.testing.assert_allclose(own_inertias(bodies, q), whole, rtol=1e-10)


@pytest.mark.parametrize("slides", [(), (0, 3, 5)])
def test_the_slope_of_a_torque_is_its_derivative_by_the_joints_own_position(
    slides: tuple[int, ...], motion: np.ndarray
) -> None:
    bodies, gravity = read_urdf(str(ARM))
    carried = ((2.0, np.array([0.1, -0.2, 0.05])),)  # what a gravity compensation bears
    some = [
        replace(b, slides=k in slides, lifted=carried if k == 4 else ())
        for k, b in enumerate(bodies)
    ]
    q, qd, qdd = (motion[:, i].T for i in range(3))
    for j in range(7):
        step = 1e-5 * np.eye(7)[j]
        ahead, back = (inverse_dynamics(some, gravity, q + way, qd, qdd)[:, j]
                       for way in (step, -step))  # fmt: skip
        slope = torque_slope(some, gravity, q, qd, qdd, j)
        np.testing.assert_allclose(
            slope, (ahead - back) / 2e-5, atol=1e-8 * max(1.0, np.abs(slope).max())
        )


def test_columns_are_pinocchios_regressor(motion: np.ndarray) -> None:
    import pinocchio as pin

    robot = pin.buildModelFromUrdf(str(ARM))
    data = robot.createData()
    bodies, gravity = read_urdf(str(ARM))
    links = Links(tuple(bodies), gravity, motion)
    # Pinocchio's order is m, h, ixx, ixy, iyy, ixz, iyz, izz about the link's origin; ours has the
    # diagonal first
    order = [0, 1, 2, 3, 4, 6, 9, 5, 7, 8]
    for at in range(0, N, 8):
        theirs = pin.computeJointTorqueRegressor(
            robot, data, *(motion[:, i, at].copy() for i in range(3))
        )
        for j in range(7):
            for k in range(7):
                ours = links.columns(j, k)[1][:, at] if links.moves(j, k) else np.zeros(10)
                assert np.abs(ours - theirs[j, 10 * k : 10 * k + 10][order]).max() < 1e-9


def test_all_links_together_are_the_torque_of_the_arm(motion: np.ndarray) -> None:
    bodies, gravity = read_urdf(str(ARM))
    links = Links(tuple(bodies), gravity, motion)
    whole = torque(bodies, gravity, motion)
    for j in range(7):
        parts = sum(
            numbers_of(b.mass, b.com, b.inertia) @ links.columns(j, k)[1]
            for k, b in enumerate(bodies)
            if links.moves(j, k)
        )
        assert np.abs(parts - whole[j]).max() < 1e-9


def test_a_payload_at_the_tip_of_the_planar_arm_changes_its_three_parameters_together() -> None:
    from zendsp.physics.robots.bodies import machine_tree

    arm = {"p1": 0.5, "p2": 0.08, "p3": 0.1, "l1": 0.36, "l2": 0.34}
    model = parse_model(
        {"sample_time": 0.001, "mechanism": {"kind": "planar2r", "parameters": arm}}
    )
    tree = machine_tree(model)
    assert tree is not None
    states = list(np.random.default_rng(4).normal(size=(2, 3, N)))
    links = Links(tuple(tree[0]), tree[1], np.stack(states))
    mass, c = 0.8, 0.3
    delta = {"p1": mass * (0.36**2 + c**2), "p2": mass * c**2, "p3": mass * 0.36 * c}
    basis = bases(model, states)
    for j in range(2):
        change = links.change([term("payload", 2, mass=mass, com_x=c)], j)
        want = sum(delta[key] * b.inertia for key, b in basis[j].items())
        assert np.abs(change.inertia - want).max() < 1e-12
        assert (
            np.abs(change.bias - sum(delta[key] * b.bias for key, b in basis[j].items())).max()
            < 1e-12
        )


def test_a_wrong_body_is_a_difference_of_torque_and_no_body_is_none() -> None:
    body = read_urdf(str(ARM))[0][1]
    assert np.all(change_of(term("body", 2), body) == 0.0)
    heavier = change_of(term("body", 2, mass=0.4), body)
    # as if the link were denser everywhere
    denser = 0.4 / body.mass * numbers_of(body.mass, body.com, body.inertia)
    assert np.abs(heavier - denser).max() < 1e-12


def test_a_link_without_mass_left_is_refused_by_name_and_number() -> None:
    bodies, _ = read_urdf(str(ARM))
    with pytest.raises(
        ModelError,
        match=(
            r"body of joint 2: mass = -99 kg leaves a link of .* kg with -.* kg; it has to stay"
            r" above 0"
        ),
    ):
        changed(bodies, [term("body", 2, mass=-99.0)])


def test_a_payload_on_a_machine_without_bodies_is_refused(tmp_path: Path) -> None:
    from zendsp.diagnosis.data.prepare import prepare
    from zendsp.diagnosis.data.signals import Signals

    model = parse_model(
        {
            "name": "cart",
            "sample_time": 0.01,
            "mechanism": {"kind": "linear", "parameters": {"mass": 2.0}},
            "effect": [{"kind": "payload", "joint": 1, "mass": 1.0}],
        }
    )
    t = np.arange(400) * 0.01
    q = np.sin(t)[:, None]
    signals = Signals("cart", t, 0.01, q, -2.0 * q, None, np.zeros(1))
    with pytest.raises(ModelError, match=r"cart: .*'payload' needs bodies: .*'urdf'"):
        prepare([signals], model)


def test_the_file_keeps_a_payload(tmp_path: Path) -> None:
    given = load_model(MODELS / "wam7.toml")
    carried = given.with_terms((*given.terms, *TERMS["payload at the tool"]))
    (tmp_path / "arm.toml").write_text(model_text(replace(carried, file=str(ARM))))
    back = load_model(tmp_path / "arm.toml")
    assert back.terms[-1].effect == "payload" and back.terms[-1].value("com_z") == 0.11


@pytest.mark.parametrize(
    ("inertial", "words"),
    [
        ('<mass value="nan"/><inertia ixx="1" iyy="1" izz="1"/>', "link 'b': .* of nan kg"),
        ('<mass value="-1"/><inertia ixx="1" iyy="1" izz="1"/>', "link 'b': .* of -1 kg"),
        ('<mass value="1"/><inertia ixx="1e400" iyy="1" izz="1"/>', "link 'b': .* finite"),
        # a joint of negative inertia ended a diagnosis in a traceback
        ('<mass value="1"/><inertia ixx="1" iyy="-1" izz="1"/>', "link 'b': .* iyy and izz of 0"),
        ('<mass value="1"/><inertia ixx="1" iyy="x" izz="1"/>', "link 'b': .* float: 'x'"),
        ('<mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="2"/>', "moment of -1 kg"),
        ('<mass value="1"/>', "link 'b': <inertial> is without <mass> or <inertia>"),
        (None, "two of its 3 links have the same name"),
    ],
)
def test_a_urdf_with_a_mass_that_is_not_a_number_is_refused(
    tmp_path: Path, inertial: str | None, words: str
) -> None:
    second = '<link name="b"/>' if inertial is None else ""
    path = tmp_path / "arm.urdf"
    path.write_text(
        f"<robot name='r'><link name='a'/>{second}<link name='b'><inertial>{inertial or ''}"
        "</inertial></link><joint name='j' type='revolute'><parent link='a'/><child link='b'/>"
        "<axis xyz='0 1 0'/><limit lower='-1' upper='1' effort='1' velocity='1'/></joint></robot>"
    )
    with pytest.raises(ModelError, match=words):
        read_urdf(str(path))


def test_a_chain_of_links_that_is_too_long_is_refused_as_that(tmp_path: Path) -> None:
    links = "".join(
        f'<link name="l{k}"/><joint name="j{k}" type="fixed"><parent link="l{k - 1}"/>'
        f'<child link="l{k}"/></joint>'
        for k in range(1, 3000)
    )
    file = tmp_path / "chain.urdf"
    file.write_text(f'<robot name="chain"><link name="l0"/>{links}</robot>')
    with pytest.raises(ModelError, match="a chain that is too long"):
        read_urdf(str(file))


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        (["one base a", "two b c", "three c b"], "in a loop, among them b, c"),
        (["one base a", "two a b", "two b c"], "two of its joints are called 'two'"),
        (["one base a", "two a b", "three b c", "four c base"], "a loop: one has to be the base"),
        (["one base a"], r"3 of its links hang on no joint \(base, b, c\): one has to be the base"),
    ],
)
def test_a_urdf_with_a_loop_beside_its_tree_or_two_joints_of_a_name_is_refused(
    tmp_path: Path, joints: list[str], words: str
) -> None:
    rows = "".join(
        f"<joint name='{name}' type='continuous'><parent link='{parent}'/>"
        f"<child link='{child}'/><axis xyz='0 1 0'/></joint>"
        for name, parent, child in map(str.split, joints)
    )
    links = "".join(f"<link name='{name}'/>" for name in ("base", "a", "b", "c"))
    path = tmp_path / "arm.urdf"
    path.write_text(f"<robot name='r'>{links}{rows}</robot>")
    with pytest.raises(ModelError, match=words):
        read_urdf(str(path))


def _gripper(tmp_path: Path, fingers: str = "prismatic") -> Path:
    """A URDF of two joints with a gripper of two fingers, the second of which follows the first."""
    def link(name: str, mass: float) -> str:
        inertia = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
        return (
            f'<link name="{name}"><inertial><origin xyz="0 0 0.1"/><mass value="{mass}"/>{inertia}'
            "</inertial></link>"
        )

    def joint(name: str, kind: str, parent: str, child: str, more: str = "") -> str:
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>{more}</joint>'
        )

    parts = [
        '<link name="base"/>', link("upper", 2.0), link("fore", 1.0), link("a", 0.3), link("b", 0.3)
    ]
    parts += [joint("j1", "continuous", "base", "upper"), joint("j2", "revolute", "upper", "fore")]
    parts += [joint("left", fingers, "fore", "a")]
    parts += [joint("right", fingers, "fore", "b", '<mimic joint="left"/>')]
    file = tmp_path / "gripper.urdf"
    file.write_text(f'<robot name="r">{"".join(parts)}</robot>')
    return file


def test_joints_of_a_urdf_that_were_not_recorded_are_held_and_their_links_carried(
    tmp_path: Path,
) -> None:
    file = _gripper(tmp_path)
    moving, _ = read_urdf(str(file), ["j1", "j2"])
    fixed = tmp_path / "fixed.urdf"
    fixed.write_text(file.read_text().replace('"prismatic"', '"fixed"'))
    for one, other in zip(moving, read_urdf(str(fixed))[0], strict=True):
        assert one.mass == other.mass and np.array_equal(one.com, other.com)
    assert moving[1].mass == pytest.approx(1.6)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ([], r"'right' follows 'left' .* joints = \['j1', 'j2'\]"),
        (["j1", "j2", "left"], r"'right' follows 'left' .* joints = \['j1', 'j2'\]"),
        (["j2", "j1"], r"in the order of the chain: \['j1', 'j2'\]"),
        (["j1", "elbow"], "called 'elbow'; it has j1, j2"),
    ],
)
def test_joints_of_a_urdf_that_follow_others_or_do_not_exist_are_named(
    tmp_path: Path, names: list[str], words: str
) -> None:
    with pytest.raises(ModelError, match=words):
        read_urdf(str(_gripper(tmp_path)), names)


def test_a_urdf_with_expressions_of_xacro_is_told_as_that(tmp_path: Path) -> None:
    file = tmp_path / "arm.xacro"
    file.write_text(ARM.read_text().replace('<mass value="', '<mass value="${2} ', 1))
    with pytest.raises(ModelError, match="xacro has to make a URDF of it first"):
        read_urdf(str(file))
