"""Model files: what is written is read back, and every wrong key is named with what was expected.
"""

from __future__ import annotations

import math
import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from zendsp.errors import ModelError
from zendsp.physics.effects import library, unit_of
from zendsp.physics.files.model_file import load_model, parse_model
from zendsp.physics.files.model_write import model_text
from zendsp.physics.model import Model, position_limits

EXAMPLES = sorted((Path(__file__).parents[2] / "examples" / "models").glob("*.toml"))
GOOD: dict[str, Any] = {
    "name": "two",
    "sample_time": 0.001,
    "mechanism": {
        "kind": "planar2r",
        "parameters": {"p1": 0.3, "p2": {"value": 0.1, "free": False}, "p3": 0.1},
    },
    "effect": [
        {
            "kind": "viscous",
            "joint": 2,
            "coefficient": {"value": 0.2, "std": 0.01, "unit": "N m s/rad"},
        }
    ],
    "actuator": {
        "gain": {"value": [1.0, 2.0], "std": [0.1, 0.3]},
        "limit": [3.0, 4.0],
        "delay": 0.001,
    },
    "sensor": {
        "position_resolution": [0.001, 0.002],
        "matrix": [[1, 0], [0.5, 1]],
        "offset": [0.1, 0.2],
    },
    "columns": {"time": "t", "position": ["q1", "q2"], "command": ["u1", "u2"]},
    "discrepancy": {"torque": [0.02, 0.01], "state": [0.01, 0.0]},
}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_example_models_survive_writing_and_reading(path: Path) -> None:
    model = load_model(path)
    again = parse_model(tomllib.loads(model_text(model)), str(path))
    assert model_text(again) == model_text(model)
    assert again.terms == model.terms and again.joints == model.joints


def test_every_part_of_a_model_survives_writing_and_reading() -> None:
    model = parse_model(GOOD)
    again = parse_model(tomllib.loads(model_text(model)))
    for part in (
        "name", "sample_time", "kind", "mechanism", "terms", "actuator", "sensor", "discrepancy",
        "columns",
    ):
        assert getattr(again, part) == getattr(model, part), part


@pytest.mark.parametrize("name", library())
def test_every_effect_can_stand_in_a_model_file(name: str) -> None:
    effect = library()[name]
    whole = {"from_joint": 1.0, "law": 2.0}
    numbers = {
        p.name: whole.get(
            p.name, p.default if p.default is not None else max(p.lower, min(p.upper, 0.5))
        )
        for p in effect.parameters
    }
    model = parse_model(
        {
            "mechanism": {"kind": "rotary", "parameters": {"inertia": 0.01}},
            "effect": [{"kind": name, "joint": 1, **numbers}],
        }
    )
    again = parse_model(tomllib.loads(model_text(model)))
    assert {k: q.value for k, q in again.terms[0].parameters.items()} == pytest.approx(numbers)


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"mechanism": {"kind": "planar2r", "parameters": {"p1": 0.3, "p2": 0.1}}}, "p3"),
    ({"mechanism": {"kind": "planar2r", "parameters": {"p1": -0.3, "p2": 0.1, "p3": 0.1}}}, "p1"),
    ({"mechanism": {"kind": "round"}}, "kind"),
    ({"discrepancy": {"torque": [-0.1]}}, "discrepancy"),
    ({"mechanism": {"kind": "rotary", "parameters": {"inertia": {"value": 1, "std": -1}}}}, "std"),
    ({"mechanism": {"kind": "rotary", "parameters": {"inertia": {"value": 1, "std": "x"}}}}, "std"),
    (
        {"mechanism": {"kind": "rotary", "parameters": {"inertia": {"value": 1, "std": [1, 2]}}}},
        "one number, or 1",
    ),
    ({"mechanism": 3}, "mechanism"),
    ({"effect": {"kind": "viscous"}}, "array of tables"),
    ({"effect": [{"joint": 1}]}, "kind"),
    ({"effect": [{"kind": "viscous", "joint": 3, "coefficient": 0.1}]}, "1 … 2"),
    ({"effect": [{"kind": "viscous", "joint": True, "coefficient": 0.1}]}, "joint"),
    ({"effect": [{"kind": "viscous", "coefficient": {"value": 0.1, "free": "yes"}}]}, "free"),
    (
        {
            "effect": [
                {"kind": "coupling", "joint": 1, "from_joint": 2, "law": "love", "coefficient": 1.0}
            ]
        },
        "inertia | coriolis",
    ),
    ({"effect": [{"kind": "coulomb", "level": -1.0}]}, "level"),
    ({"sensor": {"matrix": [[1, 0]]}}, "square"),
    ({"sensor": {"side": "outside"}}, "motor"),
    ({"sensor": {"position_resolution": -1.0}}, "position_resolution"),
    ({"actuator": {"gain": 0.0}}, "gain"),
    ({"actuator": {"delay": -0.1}}, "delay"),
    ({"actuator": {"limit": []}}, "limit"),
    ({"sample_time": "fast"}, "sample_time"),
    ({"sample_time": 10**400}, "a finite number"),
]


@pytest.mark.parametrize(("change", "words"), WRONG, ids=lambda v: str(v)[:60])
def test_wrong_key_is_named(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ModelError) as error:
        parse_model({**GOOD, **change}, "bench.toml")
    assert "bench.toml" in str(error.value) and words in str(error.value)


def _inertia(actuator: str, **quantity: Any) -> Any:
    mechanism = {"kind": "rotary", "parameters": {"inertia": quantity}}
    given = {"mechanism": mechanism, "actuator": {"unit": actuator}}
    return parse_model(given, "bench.toml").mechanism["inertia"][0]


def test_a_unit_is_converted_and_one_that_is_not_known_is_refused() -> None:
    found = _inertia("V", value=493.0, std=7.0, unit="kg cm^2")
    assert found.value == pytest.approx(0.0493) and found.std == pytest.approx(0.0007)
    assert found.unit == "kg m^2"
    with pytest.raises(ModelError, match="inertia: the unit 'kgcm2' is not known"):
        _inertia("V", value=493.0, unit="kgcm2")
    for own in ("mV", "DAC"):  # a command may have any unit, and what is told in it stays
        assert _inertia(own, value=3.0, unit=f"{own} s^2/rad").value == 3.0


@pytest.mark.parametrize(
    ("table", "key", "meant"),
    [
        ("", "sampletime", "sample_time"),
        ("mechanism", "fil", "file"),
        ("mechanism.parameters", "gravty", "gravity"),
        ("mechanism.parameters.inertia", "fre", "free"),
        ("actuator", "dealy", "delay"),
        ("sensor", "position_resolutoin", "position_resolution"),
        ("controller", "cutof", "cutoff"),
        ("columns", "velocty", "velocity"),
        ("effect", "coeficient", "coefficient"),
        ("limits", "positon", "position"),
    ],
)
def test_a_key_that_nobody_reads_is_refused_with_the_one_that_was_meant(
    table: str, key: str, meant: str
) -> None:
    effect: dict[str, Any] = {"kind": "viscous", "joint": 1, "coefficient": 0.1}
    data: dict[str, Any] = {
        "mechanism": {"kind": "rotary", "parameters": {"inertia": {"value": 1.0}}},
        "effect": [effect],
        "actuator": {},
        "sensor": {},
        "controller": {},
        "columns": {
            "position": "q",
            "position_load": "ql",
            "torque_measured": "tm",
            "current": "i",
            "temperature": "T",
        },
        "limits": {},
    }
    parse_model(data, "bench.toml")
    place: Any = data
    for name in filter(None, table.split(".")):
        place = place[name]
    (place if table != "effect" else effect)[key] = 1.0
    with pytest.raises(
        ModelError, match=rf"bench\.toml: .*{key}.*; did you mean {meant}\? Allowed: "
    ):
        parse_model(data, "bench.toml")


def test_columns_are_names() -> None:
    with pytest.raises(
        ModelError, match=r"\[columns\] position = 3: expected the name of a column"
    ):
        parse_model(
            {
                "mechanism": {"kind": "rotary", "parameters": {"inertia": 1.0}},
                "columns": {"position": 3},
            },
            "bench.toml",
        )


def test_an_endlessly_nested_file_is_refused_as_toml(tmp_path: Path) -> None:
    (tmp_path / "deep.toml").write_text(f'name = "a"\nb = {"[" * 20_000}{"]" * 20_000}\n')
    with pytest.raises(ModelError, match=r"deep.toml: is not TOML: .*nested"):
        load_model(tmp_path / "deep.toml")


@pytest.mark.parametrize(
    ("name", "kind"), [("arm.xml", "mjcf"), ("arm.urdf", "urdf"), ("arm.fmu", "fmu")]
)
def test_a_robots_own_file_in_place_of_a_model_file_is_told_where_it_belongs(
    tmp_path: Path, name: str, kind: str
) -> None:
    (tmp_path / name).write_bytes(b"PK\x03\x04\xff" if kind == "fmu" else b"<robot/>")
    with pytest.raises(ModelError, match=f'not TOML.*kind = "{kind}", file = "{name}"'):
        load_model(tmp_path / name)


def test_a_shipped_model_is_found_by_its_name_from_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_model("wam7.toml").joints == 7, "with the URDF beside it"
    with pytest.raises(ModelError, match=r"imi_planar: cannot be read: .*imi_planar.toml"):
        load_model("imi_planar")
    (tmp_path / "wam7.toml").write_text("oops")
    with pytest.raises(ModelError, match="is not TOML"):
        load_model("wam7.toml")  # the user's own goes first


def _limited(position: object) -> Model:
    arm = {"kind": "planar2r", "parameters": {"p1": 2.0, "p2": 0.5, "p3": 0.3}}
    return parse_model({"mechanism": arm, "limits": {"position": position}})


@pytest.mark.parametrize(
    ("position", "second"),
    [([-1, 2.0], (-1.0, 2.0)), ([[-1.0, 2.0]], (-1.0, 2.0)), ([[-1, 2], [-3, 0.5]], (-3.0, 0.5))],
)
def test_position_limits_are_one_pair_or_a_pair_a_joint(
    position: object, second: tuple[float, float]
) -> None:
    model = _limited(position)
    assert position_limits(model, 1) == (-1.0, 2.0) and position_limits(model, 2) == second
    assert parse_model(tomllib.loads(model_text(model))).limits == model.limits
    assert position_limits(replace(model, limits={}), 1) == (-math.inf, math.inf)


@pytest.mark.parametrize("position", [2.0, [1.0], [2.0, 1.0], [[-1, 1], [0, 1, 2]], [[-1, 1], 3.0]])
def test_position_limits_that_are_no_pairs_are_refused(position: object) -> None:
    with pytest.raises(ModelError, match=r"\[limits\] position .*one such pair a joint"):
        _limited(position)


def test_a_changed_robot_file_is_read_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Folders of two arms with files of the same names, then one of the files written again."""
    link = '<link name="l{0}"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1"'
    link += ' iyz="0" izz="1"/></inertial></link>'
    hinge = '<joint name="j{0}" type="continuous"><parent link="l{1}"/><child link="l{0}"/></joint>'

    def write(folder: Path, joints: int) -> None:
        folder.mkdir(exist_ok=True)
        parts = [link.format(0)]
        for k in range(1, joints + 1):
            parts += [link.format(k), hinge.format(k, k - 1)]
        (folder / "arm.urdf").write_text(f'<robot name="arm">{"".join(parts)}</robot>')
        (folder / "arm.toml").write_text(
            'name = "arm"\nsample_time = 0.01\n[mechanism]\nkind = "urdf"\nfile = "arm.urdf"\n'
        )

    for joints in (2, 3):
        folder = tmp_path / str(joints)
        write(folder, joints)
        monkeypatch.chdir(folder)
        assert load_model("arm.toml").joints == joints
    write(tmp_path / "3", 4)
    assert load_model("arm.toml").joints == 4


def test_a_urdfs_joints_are_named_as_an_mjcfs_and_written_again(tmp_path: Path) -> None:
    hinge = '<joint name="j{0}" type="continuous"><parent link="l{1}"/><child link="l{0}"/></joint>'
    links = '<link name="l0"/><link name="l1"/><link name="l2"/>'
    robot = f'<robot name="a">{links}{hinge.format(1, 0)}{hinge.format(2, 1)}</robot>'
    (tmp_path / "arm.urdf").write_text(robot)
    text = 'name = "arm"\nsample_time = 0.01\n[mechanism]\nkind = "urdf"\nfile = "arm.urdf"\n'
    (tmp_path / "arm.toml").write_text(text + 'joints = ["j2"]\n')
    model = load_model(tmp_path / "arm.toml")
    assert model.joints == 1 and model.robot.joints == ("j2",)
    assert parse_model(tomllib.loads(model_text(model))).robot.joints == ("j2",)
    with pytest.raises(ModelError, match="joints belongs to kind = 'urdf' or 'mjcf', not 'rotary'"):
        parse_model({"mechanism": {"kind": "rotary", "joints": ["a"], "parameters": {}}})


ROD = """<mujoco><worldbody><body><joint name="a" axis="0 0 1" armature="0.05"/>
<inertial pos="0.2 0 0" mass="2" diaginertia="0.01 0.01 0.01"/><body pos="0.4 0 0">
<joint name="b" axis="0 0 1"/><inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.004"/>
</body></body></worldbody><actuator><motor joint="a"/><motor joint="b"/></actuator></mujoco>"""


def test_the_load_of_a_spring_is_what_the_links_of_a_robots_file_turn(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    (tmp_path / "rod.xml").write_text(ROD)
    head = 'name = "rod"\nsample_time = 0.001\n[mechanism]\nkind = "mjcf"\nfile = "rod.xml"\n'
    spring = '[[effect]]\nkind = "elasticity"\njoint = 1\nstiffness = 4e3\ndamping = 1.0\n'
    (tmp_path / "rod.toml").write_text(head + spring)
    term = next(t for t in load_model(tmp_path / "rod.toml").terms if t.effect == "elasticity")
    # 2 kg at 0.2 m, 1 kg at 0.5 m, and their own; the rotor is before the spring
    links = 2 * 0.2**2 + 0.01 + 1 * 0.5**2 + 0.004
    assert term.value("load_inertia") == pytest.approx(links)
    assert term.value("links_inertia") == pytest.approx(links)
    (tmp_path / "rod.toml").write_text(head + spring + "load_inertia = 0.3\n")
    term = next(t for t in load_model(tmp_path / "rod.toml").terms if t.effect == "elasticity")
    assert (term.value("load_inertia"), term.value("links_inertia")) == (0.3, 0.0), "as given"
    with pytest.raises(ModelError, match="lacks 'load_inertia': part of the joint's inertia that"):
        parse_model({
            "mechanism": {"kind": "rotary", "parameters": {"inertia": 1.0}},
            "effect": [{"kind": "elasticity", "stiffness": 4e3, "damping": 1.0}],
        })  # fmt: skip


@pytest.mark.parametrize(
    ("inertia", "viscous", "refused"),
    [
        ("kg cm^2", "mN m s/rad", ""),
        ("kg m^2", "N m s", ""),
        ("deg", "N m s/rad", "inertia.unit = 'deg': expected kg m^2"),
        ("kg m", "N m s/rad", "inertia.unit = 'kg m': expected kg m^2"),
        ("kg m^2", "N m", "coefficient.unit = 'N m': expected N m s/rad"),
    ],
)
def test_a_unit_of_another_kind_than_the_number_is_refused(
    inertia: str, viscous: str, refused: str
) -> None:
    """An inertia in degrees was taken, multiplied by pi/180, and a payload was found."""
    data = {
        "sample_time": 0.001,
        "mechanism": {
            "kind": "rotary", "parameters": {"inertia": {"value": 0.06, "unit": inertia}},
        },
        "effect": [
            {"kind": "viscous", "joint": 1, "coefficient": {"value": 0.1, "unit": viscous}}
        ],
    }
    if not refused:
        assert parse_model(data).terms[0].value("coefficient") > 0.0
        return
    with pytest.raises(ModelError, match=re.escape(refused)):
        parse_model(data)


@pytest.mark.parametrize("kind", ["rotary", "linear"])
@pytest.mark.parametrize("command", ["", "A", "N m"])
def test_every_unit_that_a_report_writes_is_read_again(kind: str, command: str) -> None:
    mass = {"inertia": 0.1} if kind == "rotary" else {"mass": 0.1}
    data: dict[str, Any] = {"sample_time": 0.001, "mechanism": {"kind": kind, "parameters": mass}}
    if command:
        data["actuator"] = {"unit": command}
    model = parse_model(data)
    for effect in library().values():
        if effect.coupled:
            continue
        table: dict[str, Any] = {"kind": effect.name, "joint": 1}
        for one in effect.parameters:
            value = min(max(0.5, one.lower), one.upper)
            unit = unit_of(one.size, kind, command, model.torque_unit(1))
            table[one.name] = {"value": value, "unit": unit}
        parse_model({**data, "effect": [table]})
