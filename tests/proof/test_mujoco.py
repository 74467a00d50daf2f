"""The MuJoCo reality: a machine that equals its model except for what is concealed."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import signal

from zendsp.proof.build_case import Request, Unusable, make_case
from zendsp.proof.cases import write_all
from zendsp.proof.forms import DRY, FLUID, FORMS, Frame
from zendsp.proof.mechanisms import LAWS, MECHANISM

mujoco = pytest.importorskip("mujoco")

from zendsp.proof.mujoco import make  # noqa: E402
from zendsp.proof.mujoco.chain import urdf  # noqa: E402
from zendsp.proof.mujoco.foreign import PARTS, TOGETHER  # noqa: E402
from zendsp.proof.mujoco.friction import lugre  # noqa: E402
from zendsp.proof.mujoco.machines import MACHINES, Bench, harden  # noqa: E402
from zendsp.proof.mujoco.programme import QUICK, UNFIT, requests  # noqa: E402
from zendsp.proof.mujoco.simulate import Nominal, Record, Row, simulate  # noqa: E402
from zendsp.proof.mujoco.truths import MAKERS  # noqa: E402


def bench(machine: str, seed: int, seconds: float = 3.0) -> tuple[Bench, Record]:
    """A machine with nothing concealed, its dry friction hard, and a short recording of it."""
    rng = np.random.default_rng(seed)
    b = MACHINES[machine](rng)
    harden(b)
    b.seconds = seconds
    return b, simulate(b, b.train_shape, rng)


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Recordings of two seconds in place of ten to twenty."""

    def shortened(machine: str) -> Callable[[np.random.Generator], Bench]:
        drawn = MACHINES[machine]
        return lambda rng: replace(drawn(rng), seconds=2.0)

    monkeypatch.setattr(make, "MACHINES", {machine: shortened(machine) for machine in MACHINES})


def test_same_seed_same_bits(short: None) -> None:
    a, b = (
        make_case(Request(13, "complete", "mj_joint", "plain", 1.0, "mujoco")) for _ in range(2)
    )
    assert (
        np.array_equal(a.train.measured, b.train.measured)
        and a.model == b.model
        and a.truth == b.truth
    )
    assert not np.array_equal(a.heldout.measured, a.untouched.measured)


@pytest.mark.parametrize(
    ("machine", "seed"), [("mj_joint", 1), ("mj_cart", 2), ("mj_planar2r", 3), ("mj_arm6", 8)]
)
def test_complete_machine_leaves_the_oracle_nothing(machine: str, seed: int) -> None:
    """The given structure explains MuJoCo's torque to a thousandth: other integrators and hold
    included.
    """
    b, record = bench(machine, seed)
    for joint in range(b.n):
        seen = make.visible(b, record, joint)
        assert seen["torque_share"] < 1e-3 and not seen["detectable"]


@pytest.mark.parametrize("machine", ["mj_arm6", "mj_arm7"])
def test_urdf_of_the_given_model_is_the_machine_of_the_mjcf(machine: str) -> None:
    """Pinocchio on the URDF gives the torque that MuJoCo gives on the MJCF, rotors apart."""
    pin = pytest.importorskip("pinocchio")
    b = MACHINES[machine](np.random.default_rng(5))
    rotors = np.array(b.nominal_armature)
    model = pin.buildModelFromXML(urdf(b.nominal, b.limit, machine))
    data, rng = model.createData(), np.random.default_rng(6)
    for _ in range(5):
        q, v, a = rng.uniform(-2, 2, (3, b.n))
        expected = pin.rnea(model, data, q, v, a) + rotors * a
        assert np.allclose(Nominal(b).torque(q, v, a), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("machine", ["mj_joint", "mj_cart", "mj_planar2r", "mj_arm6"])
def test_every_effect_that_fits_can_be_concealed_and_is_named_by_the_contract(machine: str) -> None:
    b, record = bench(machine, 8, 1.5)
    scales = make.scales_of(b, record)
    for name in MAKERS:
        if name in UNFIT[machine] or (name == "gravity" and b.gravity == 0.0):
            continue
        changed = copy.deepcopy(b)
        concealed = MAKERS[name](changed, 0, scales[0], 0.1, np.random.default_rng(9))
        assert concealed.effect in MECHANISM
        assert set(concealed.accepted) <= set(MECHANISM) and set(concealed.mechanisms) <= set(LAWS)
        changed.seconds = 0.1
        assert np.all(np.isfinite(simulate(changed, "sines", np.random.default_rng(9)).run.q)), name


EITHER = pytest.mark.long("an equality is the harder way to hold them; lost: a spring")


@pytest.mark.parametrize("name", [pytest.param("elasticity", marks=EITHER), "equality"])
def test_a_rotor_drags_its_load_along_whatever_holds_them_together(name: str) -> None:
    b, record = bench("mj_cart", 3, 4.0)
    scale = make.scales_of(b, record)[0]
    MAKERS[name](b, 0, scale, 0.1, np.random.default_rng(1))
    b.seconds = 4.0
    run = simulate(b, "sines", np.random.default_rng(2)).run
    slow = signal.butter(2, 2.0 * 2 * b.sample_time, output="sos")
    speed = np.gradient(signal.sosfiltfilt(slow, run.q[:, 0]), b.sample_time)
    motion = np.stack([np.gradient(speed, b.sample_time), speed, np.tanh(speed / 1e-3)], axis=1)
    force = b.joints[0].gain * signal.sosfiltfilt(slow, run.command[:, 0])
    inner = slice(len(force) // 8, -len(force) // 8)
    mass = np.linalg.lstsq(motion[inner], force[inner], rcond=None)[0][0]
    assert mass == pytest.approx(b.links[0].mass + b.joints[0].armature, rel=0.1)


def test_gravity_is_not_concealed_where_there_is_none() -> None:
    flat = next(
        b for k in range(40) if (b := MACHINES["mj_joint"](np.random.default_rng(k))).gravity == 0.0
    )
    flat.seconds = 0.5
    scale = make.scales_of(flat, simulate(flat, "sines", np.random.default_rng(1)))[0]
    with pytest.raises(Unusable):
        MAKERS["gravity"](flat, 0, scale, 0.1, np.random.default_rng(1))


def test_what_is_concealed_acts_with_the_size_that_was_asked_for() -> None:
    """A spring of a tenth of the torque moves the torque along the motion by a tenth of it."""
    b, _ = bench("mj_cart", 3)
    b.fixed = True  # nothing may absorb it but friction
    s = make.scales_of(b, simulate(b, b.train_shape, np.random.default_rng(2)))[0]
    MAKERS["stiffness"](b, 0, s, 0.1, np.random.default_rng(1))
    again = simulate(b, b.train_shape, np.random.default_rng(2))  # the same reference
    assert make.visible(b, again, 0)["torque_share"] == pytest.approx(0.1, rel=0.3)


def test_lugre_slides_at_its_level_and_holds_at_rest() -> None:
    torque = lugre(fc=2.0, fs=2.0, vs=0.1, stiffness=400.0)(1e-4)
    for k in range(4000):
        slid = torque(k * 1e-4, 0.0, 0.5, 0.0)
    assert slid == pytest.approx(-2.0, rel=1e-6)
    held = lugre(fc=2.0, fs=2.0, vs=0.1, stiffness=400.0)(1e-4)
    for k in range(100):  # a creep of 1 mrad, far within the bristle
        stuck = held(k * 1e-4, 0.0, 0.1, 0.0)
    assert stuck == pytest.approx(
        -0.4 * (1 - 0.1), abs=0.05
    )  # stiffness · way, less the slip so far


def test_foreign_forms_are_sized_and_parts_too() -> None:
    b, record = bench("mj_joint", 12)
    scales = make.scales_of(b, record)
    for name in ("sin3tanh", "wall", "memory"):
        changed = copy.deepcopy(b)
        concealed = make.foreign_of(changed, name, 0, scales, 0.1, np.random.default_rng(3))
        again = simulate(changed, b.train_shape, np.random.default_rng(12))
        assert concealed.effect == "foreign" and set(concealed.mechanisms) <= set(LAWS)
        assert 0.02 < make.visible(changed, again, 0)["torque_share"] < 0.25
    changed = copy.deepcopy(b)
    stop = make.foreign_of(changed, "stop", 0, scales, 0.1, np.random.default_rng(3))
    assert 0.03 < stop.size < 0.3
    assert len(FORMS) + len(PARTS) + len(TOGETHER) >= 30


def test_a_foreign_friction_that_needs_no_step_at_standstill_may_be_called_fluid() -> None:
    """Dry friction has most of its torque at a tenth of the usual speed; what rises with the speed
    is fluid, or either. (Where a torque of the motor's or of earlier motion rubs, both are left
    out.)
    """
    rubbing = {name: form for name, form in FORMS.items() if {DRY, FLUID} & set(form.mechanisms)}
    for name in rubbing.keys() - {"gainplace", "memory"}:
        shape = rubbing[name].make(Frame(0.0, 1.0, 1.0, 3.0, 20.0), np.random.default_rng(1))()
        at = [np.hypot.reduce([shape(x, w, 1.0, 1.0) for x in np.linspace(-1.0, 1.0, 41)])
              for w in np.linspace(0.1, 3.0, 30)]  # fmt: skip
        assert (at[0] < 0.5 * max(at)) == (FLUID in rubbing[name].mechanisms), name


def test_jitter_is_in_the_stamps_and_they_are_true() -> None:
    rng = np.random.default_rng(2)
    b = MACHINES["mj_joint"](rng)
    b.faults = ["jitter"]
    b.seconds = 2.0
    run = simulate(b, "sines", rng).run
    step = np.diff(run.time) / b.sample_time
    assert step.min() < 0.8 and step.max() > 1.2 and abs(step.mean() - 1) < 0.02
    # between its stamps the joint moves as fast as it is said to: the stamps are when it was read
    moved = np.diff(run.q[:, 0]) / np.diff(run.time)
    assert np.allclose(moved, 0.5 * (run.v[1:, 0] + run.v[:-1, 0]), atol=0.02 * np.abs(run.v).max())


def test_written_case_gives_away_nothing_and_its_model_is_read(short: None, tmp_path: Path) -> None:
    from zendsp.physics import load_model

    wanted = [
        Request(31, "single", "mj_joint", "dry_soft", 0.1, "mujoco"),
        Request(35, "single", "mj_arm6", "heavier", 1.0, "mujoco"),
    ]
    write_all(wanted, tmp_path / "c", tmp_path / "t")
    for folder in sorted((tmp_path / "c").iterdir()):
        load_model(folder / "model.toml")
        kept = {p.name for p in folder.iterdir()}
        assert "case.json" in kept and not any("untouched" in name for name in kept)
        model = tomllib.loads((folder / "model.toml").read_text())
        kinds = {e["kind"] for e in model.get("effect", []) if e["joint"] == 1}
        assert "coulomb" not in kinds or model["mechanism"]["kind"] == "urdf"
        assert (tmp_path / "t" / f"{folder.name}_untouched.npz").exists()


def test_quick_holds_what_a_diagnosis_without_gates_gets_wrong() -> None:
    quick = requests(0, quick=True)
    assert len(quick) == len(QUICK) and {r.reality for r in quick} == {"mujoco"}
    assert {"complete", "nuisance", "foreign", "single"} == {r.kind for r in quick}
    assert all(r.size <= 0.05 for r in quick if r.kind == "foreign")


@pytest.mark.parametrize(
    "machine", ["mj_arm7", pytest.param("mj_arm6", marks=pytest.mark.long("as seven joints are"))]
)
def test_an_arm_given_as_mjcf_is_the_model_that_is_given_as_urdf(
    short: None, tmp_path: Path, machine: str
) -> None:
    """A diagnosis sees the same bodies, effects and actuators: it cannot but find the same."""
    from zendsp.physics.files.model_file import parse_model
    from zendsp.physics.robots.robot import robot_tree

    models = []
    for given in ("", "mjcf"):
        case = make_case(Request(5, "single", machine, "payload", 1.0, "mujoco", given))
        for name, content in case.files.items():
            (tmp_path / name).write_text(content)
        models.append(parse_model(case.model, str(tmp_path / "model.toml")))
    a, b = models
    assert (a.kind, b.kind) == ("urdf", "mjcf")
    for x, y in zip(robot_tree(a)[0], robot_tree(b)[0], strict=True):
        assert x.parent == y.parent and x.slides == y.slides
        for key in ("axis", "rotation", "place", "mass", "com", "inertia"):
            assert getattr(x, key) == pytest.approx(getattr(y, key), rel=1e-9, abs=1e-12), key
    values = [
        {(t.effect, t.joint): [q.value for q in t.parameters.values()] for t in m.terms}
        for m in models
    ]
    assert values[0] == values[1] and len(values[0]) == len(a.terms) == len(b.terms)
    assert a.actuator.gain == pytest.approx(b.actuator.gain)
    assert a.actuator.limit == pytest.approx(b.actuator.limit)
    assert a.joint_kinds == b.joint_kinds


@pytest.mark.parametrize("substeps", [1, 3])
def test_a_delay_acts_as_many_substeps_later_as_is_sealed(substeps: int) -> None:
    b = MACHINES["mj_joint"](np.random.default_rng(0))
    b.joints[0].delay = substeps * b.substep
    acts: list[float] = []

    class Engine:
        """Keeps what reaches the motor in each substep."""

        def mj_step(self, model: object, data: SimpleNamespace) -> None:
            acts.append(float(data.ctrl[0]))

    n = len(b.joints)
    data = SimpleNamespace(
        qfrc_applied=np.zeros(n), ctrl=np.zeros(n), qpos=np.zeros(n), qvel=np.zeros(n)
    )
    row = Row(Engine(), None, data, b, list(range(n)))
    row.pass_by(0.0, 6, np.ones(n), np.zeros(n))
    assert acts == [0.0] * substeps + [1.0] * (6 - substeps)
