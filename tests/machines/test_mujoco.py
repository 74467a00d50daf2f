"""Any MuJoCo model as a machine: its motion against MuJoCo's own integrator, its limits, what it
allocates.
"""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plants import MODELS, OFF, VELOCITY, edited, robot

from zendsp_isr.build import build, source_root
from zendsp_isr.parts import build_machine
from zendsp_protocol.errors import Refused
from zendsp_target.runtime.process.runner import look_at
from zendsp_target.runtime.process.settings import Settings

mujoco: Any = pytest.importorskip("mujoco")
ARM, ACROBOT = MODELS / "bench_arm.xml", MODELS / "acrobot_and_ball.xml"


def own_motion(
    model: Path, torque: Sequence[float], seconds: float, by: str = "mjINT_RK4"
) -> Any:
    """MuJoCo's own integrator, with torques held on the actuators."""
    m = mujoco.MjModel.from_xml_path(str(model))
    m.opt.integrator = getattr(mujoco.mjtIntegrator, by)
    m.opt.timestep = 1e-4
    d = mujoco.MjData(m)
    d.ctrl[:] = torque
    for _ in range(round(seconds / m.opt.timestep)):
        mujoco.mj_step(m, d)
    return d


def test_a_driven_arm_without_friction_moves_as_mujocos_own_integrator_moves_it(
    tmp_path: Path,
) -> None:
    model = edited(
        tmp_path,
        ARM,
        ('damping="0.5" frictionloss="0.8"', ""),
        ("<position joint", "<motor joint"),
        ('kp="300"', 'ctrlrange="-30 30"'),
    )
    with robot(model) as plant:
        for _ in range(300):
            plant.torque([3.0, -6.0, 0.5])
        truth = own_motion(model, [3.0, -6.0 / 50.0, 0.5], 0.3)
        # both of second order or better at 0.1 ms: what is left is the step of the explicit
        # midpoint
        assert plant.q == pytest.approx(truth.qpos, abs=2e-5)
        assert plant.qd == pytest.approx(truth.qvel, abs=2e-4)
        assert np.abs(plant.q).min() > 0.05, "every joint has moved"


def test_bodies_without_a_drive_move_freely_beside_the_joints() -> None:
    """The passive joint of an acrobot and a ball that falls: neither is a joint of the machine."""
    with robot(ACROBOT) as plant:
        assert plant.joints == 1
        for _ in range(250):
            plant.torque([4.0])
        truth = own_motion(ACROBOT, [4.0], 0.25)
        assert plant.q[0] == pytest.approx(truth.qpos[1], abs=2e-5)
        plant.torque([4.0])
        ball, top = plant.sensors.adc[2], plant.sensors.adc[3]
        assert ball == pytest.approx(truth.xpos[3][2], abs=2e-4) and ball < 0.3
        assert top == pytest.approx(truth.qpos[0], abs=2e-5) and abs(top) > 0.05
        for _ in range(1500):
            plant.torque([0.0])
        assert plant.sensors.adc[2] == pytest.approx(0.1, abs=0.01), "it lies on the plane"


def test_a_light_finger_with_much_damping_beside_the_drives_does_not_blow_up(
    tmp_path: Path,
) -> None:
    """Damping over inertia of 60000/s, as in dm_control's manipulator: MuJoCo takes it in steps."""
    model = tmp_path / "finger.xml"
    model.write_text(
        """<mujoco><worldbody><body><joint name="arm" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02" mass="0.5"/>
        <body pos="0.2 0 0"><joint name="finger" axis="0 1 0" damping="0.5"/>
        <geom size="0.01" pos="0.03 0 0" mass="0.01"/></body></body></worldbody>
        <actuator><motor joint="arm" ctrlrange="-5 5"/></actuator>
        <sensor><jointpos joint="finger"/></sensor></mujoco>"""
    )
    with robot(model) as plant:
        for _ in range(300):
            plant.torque([2.0])
        truth = own_motion(model, [2.0], 0.3, "mjINT_EULER")  # damping implicit
        # a step of 0.1 ms of first order, at 60 rad/s
        assert plant.q[0] == pytest.approx(truth.qpos[0], rel=1e-3)
        plant.torque([2.0])
        assert plant.sensors.adc[0] == pytest.approx(truth.qpos[1], rel=0.02)


def test_the_reaction_of_concealed_inertia_reaches_what_is_not_driven(tmp_path: Path) -> None:
    """More inertia at the elbow acts as a rotor there, like an armature in the model."""
    heavier = edited(tmp_path, ACROBOT, ('name="elbow" axis', 'name="elbow" armature="0.05" axis'))
    with robot(ACROBOT, "effect1 = inertia joint=1 amount=0.05") as plant:
        for _ in range(250):
            plant.torque([4.0])
        truth = own_motion(heavier, [4.0], 0.25)
        assert plant.q[0] == pytest.approx(truth.qpos[1], abs=2e-5)
        plant.torque([4.0])
        assert plant.sensors.adc[3] == pytest.approx(truth.qpos[0], abs=2e-5)


def test_dry_friction_of_the_model_holds_a_joint_against_its_weight_without_creeping(
    tmp_path: Path,
) -> None:
    model = edited(tmp_path, ARM, ('frictionloss="0.8"', 'frictionloss="40"'))
    with robot(model, "q2 = 0.6") as plant:
        for _ in range(300):
            plant.torque([0.0, 0.0, 0.0])
        rest = plant.q
        for _ in range(3000):
            plant.torque([0.0, 0.0, 0.0])
        assert plant.q == pytest.approx(rest, abs=1e-6)
        assert plant.q[1] == pytest.approx(0.6, abs=1e-4), "no give that a reversal would show"


def test_sliding_friction_is_the_models_loss_and_damping() -> None:
    with robot(ARM) as plant:
        for _ in range(3000):
            plant.sample(np.array([0.3 * plant.info.joint[0].mv_per_speed, 0.0, 0.0]), VELOCITY)
        assert plant.qd[0] == pytest.approx(0.3, abs=1e-3)
        steady = plant.truth_current(0)
        assert steady == pytest.approx(0.8 + 0.5 * 0.3, rel=0.01)


def test_names_units_and_limits_come_from_the_model() -> None:
    with robot(ARM) as plant:
        joint = [plant.info.joint[j] for j in range(3)]
        assert [plant.ffi.string(j.name).decode() for j in joint] == ["turn", "shoulder", "elbow"]
        # ctrlrange; ctrlrange x gear; forcerange
        assert [j.torque_max for j in joint] == [40.0, 80.0, 30.0]
        assert [(j.position_min, j.position_max) for j in joint] == [
            (-2.5, 2.5), (-1.8, 1.8), (-2.4, 2.4),
        ]
        assert plant.ffi.string(plant.info.name) == b"bench_arm"
        assert [plant.ffi.string(plant.info.adc_name[i]) for i in range(2)] == [
            b"elbow speed", b"elbow torque",
        ]


def test_a_joint_that_would_start_at_the_end_of_its_range_starts_inside_it(tmp_path: Path) -> None:
    """Most published arms have no keyframe, and zero lies outside a range: they would trip at once.
    """
    model = edited(
        tmp_path, ARM, ('"-2.5 2.5"', '"0 2.5"'), ('"-1.8 1.8"', '"-1.8 -0.3"'),
    )  # fmt: skip
    with robot(model) as plant:
        assert plant.q == pytest.approx([1.25, -1.05, 0.0]), "in the middle of the range"
    with robot(model, "q1 = 0.0") as plant:
        assert plant.q[0] == 0.0, "what somebody asked for stays"


def test_a_linkage_follows_a_joint_that_starts_inside_its_range(tmp_path: Path) -> None:
    """For example a gripper whose driven joint begins closed; its rod had been flung to its place.
    """
    model = tmp_path / "linkage.xml"
    model.write_text(
        """<mujoco><option gravity="0 0 0"/><default><joint axis="0 1 0"/><geom contype="0"
        conaffinity="0"/></default><worldbody>
        <body name="crank"><joint name="crank" range="0 85" limited="true"/>
        <geom type="capsule" fromto="0 0 0 0.04 0 0" size="0.005" mass="0.1"/></body>
        <body pos="0 0 0.02"><joint name="knuckle"/>
        <geom type="capsule" fromto="0 0 0 0.04 0 0" size="0.005" mass="0.1"/>
        <body name="rod" pos="0.04 0 0"><joint name="rod"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.02" size="0.005" mass="0.1"/></body></body>
        </worldbody><equality><connect body1="rod" body2="crank" anchor="0 0 -0.02"/></equality>
        <actuator><motor joint="crank" ctrlrange="-1 1"/></actuator>
        <sensor><jointpos joint="knuckle"/></sensor></mujoco>"""
    )
    with robot(model) as plant:
        for _ in range(20):
            plant.sample([0.0], VELOCITY)
            assert abs(plant.qd[0]) < 0.01
        assert plant.q[0] == pytest.approx(np.radians(42.5), abs=1e-3)
        assert plant.sensors.adc[0] == pytest.approx(plant.q[0], abs=1e-3), "a parallelogram"


def test_gains_from_the_inertia_that_the_machine_says_are_stable_where_an_arm_stands_straight(
    tmp_path: Path,
) -> None:
    """When the axes of a straight arm are in line, each of them alone has hardly any inertia."""
    axes, length = ("0 0 1", "0 1 0") * 3 + ("0 0 1",), (0.3, 0.2, 0.2, 0.2, 0.2, 0.1, 0.05)
    links = "".join(
        f'<body pos="0 0 {before}"><joint name="j{k}" axis="{axis}" range="-2 2"/>'
        f'<geom type="capsule" fromto="0 0 0 0 0 {long}" size="0.04" mass="{10 * long}"/>'
        for k, (axis, before, long) in enumerate(zip(axes, (0.1, *length), length, strict=False))
    )
    motors = "".join(f'<motor joint="j{k}" ctrlrange="-100 100"/>' for k in range(7))
    arm = tmp_path / "straight.xml"
    arm.write_text(f"<mujoco><worldbody>{links}{'</body>' * 7}</worldbody>"
                   f"<actuator>{motors}</actuator></mujoco>")  # fmt: skip
    model = mujoco.MjModel.from_xml_path(str(arm))
    data, mass = mujoco.MjData(model), np.zeros((7, 7))
    with robot(arm) as plant:
        inertia = np.diag([plant.info.joint[j].inertia for j in range(7)])
    for pose in (0.0, 0.2, -0.2):
        data.qpos[:] = pose * np.cos(np.arange(7.0))
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        ratio = np.linalg.eigvals(np.linalg.solve(mass, inertia)).real
        # the integral of joint_pd.c is stable above 1 / (2 damping w reset), its velocity filter
        # of 80 Hz with 1.5 ms of delay below 15
        assert ratio.min() > 0.088 and ratio.max() < 15.0


def test_two_motors_of_a_joint_are_one_drive_as_strong_as_both(tmp_path: Path) -> None:
    second = '<actuator><motor joint="turn" gear="5" ctrlrange="-4 4"/>'
    with robot(edited(tmp_path, ARM, ("<actuator>", second))) as plant:
        assert plant.info.joint[0].torque_max == 40.0 + 5 * 4
    unlimited = '<actuator><motor joint="shoulder"/>'
    with robot(edited(tmp_path, ARM, ("<actuator>", unlimited))) as plant:
        assert plant.info.joint[1].torque_max != 80.0, "one of the two has no limit"


def test_a_joint_without_a_limit_is_as_strong_as_its_weight_asks_wherever_it_turns(
    tmp_path: Path,
) -> None:
    """Upright it weighs nothing; a drive that lifts nothing lets it fall at the first sway."""
    model = tmp_path / "upright.xml"
    model.write_text(
        """<mujoco><worldbody><body><joint name="turn" axis="0 1 0" frictionloss="0.2"/>
        <geom size="0.01" pos="0 0 0.2" mass="0.5"/></body></worldbody></mujoco>"""
    )
    with robot(model) as plant:
        weighs, turns = 0.5 * 9.81 * 0.2, 0.5 * 0.2**2
        wanted = 2.0 * (weighs + 0.2) + 50.0 * turns
        assert plant.info.joint[0].torque_max == pytest.approx(wanted, rel=0.03)


@pytest.mark.parametrize("limit", [2.0, 2000.0])
def test_a_torque_limit_beyond_all_need_makes_no_noise_that_moves_the_joint(
    tmp_path: Path, limit: float
) -> None:
    """As in URDFs, in which 1000 N m stand wherever nobody knew."""
    model = tmp_path / "light.xml"
    model.write_text(
        f"""<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="turn" axis="0 1 0"/>
        <geom size="0.05" mass="1"/></body></worldbody>
        <actuator><motor joint="turn" ctrlrange="-{limit} {limit}"/></actuator></mujoco>"""
    )
    with robot(model, ideal=False) as plant:
        assert plant.info.joint[0].torque_max == limit, "the limit is the file's"
        speeds = []
        for _ in range(400):
            plant.torque([0.0])
            speeds.append(plant.qd[0])
    inertia, fits = 1e-3, 50.0 * 1e-3
    noise = np.std(np.diff(speeds)) * inertia / 0.001
    assert 0.3e-4 * fits < noise < 1.5e-4 * fits


def test_a_slide_is_in_metres_and_joints_without_a_motor_have_an_encoder_when_named() -> None:
    with robot(MODELS / "cart.xml", "joints = slider,pole", "q2 = 0.1") as plant:
        assert [plant.ffi.string(plant.info.joint[j].unit) for j in range(2)] == [b"m", b"rad"]
        assert [plant.ffi.string(plant.info.joint[j].command) for j in range(2)] == [
            b"force", b"none",
        ]
        for _ in range(300):
            measured = plant.sample([5000.0, 5000.0])
        assert measured[0] > 0.2, "10 N push the cart"
        assert measured[1] < 0.0 or measured[1] > 0.2, "and the pole falls"


def test_the_encoder_is_noisy_unless_ideal_and_the_seed_repeats_it() -> None:
    def still(*lines: str, ideal: bool) -> list[int]:
        # not at zero, which lies between two counts
        with robot(ARM, "q1 = 0.1", *lines, ideal=ideal) as plant:
            counts = []
            for _ in range(200):
                plant.sample(np.zeros(3), VELOCITY)
                counts.append(plant.sensors.enc[0])
            return counts[100:]

    assert np.ptp(still(ideal=True)) == 0
    noisy = still(ideal=False)
    assert 1 <= np.ptp(noisy) <= 6
    assert noisy == still("seed = 1", ideal=False) and noisy != still("seed = 2", ideal=False)


def test_a_model_that_is_too_slow_for_the_real_clock_says_how_slow(tmp_path: Path) -> None:
    # time constants of microseconds
    stiff = edited(tmp_path, ARM, ('damping="0.5"', 'damping="20000"'))
    with pytest.raises(ValueError, match=r"simulating 1 ms takes .* ms here, in steps of .* us"):
        robot(stiff, clock="real")
    with robot(stiff):
        pass  # the fast clock waits for nobody


def test_a_model_that_takes_too_long_to_open_says_what_helps(tmp_path: Path) -> None:
    settings = Settings(str(ARM), {"model": str(ARM)}, load_s=1e-3)
    with pytest.raises(Refused, match=r"did not open within 0\.001 s, .* smaller meshes or none$"):
        look_at(settings, tmp_path)


HARNESS = rb"""
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include "machine.h"
extern void *__libc_malloc(size_t), *__libc_calloc(size_t, size_t), *__libc_realloc(void *, size_t), __libc_free(void *);
extern void *__libc_memalign(size_t, size_t);
static int armed; static long calls;
void *malloc(size_t n) { calls += armed; return __libc_malloc(n); }
void *calloc(size_t n, size_t m) { calls += armed; return __libc_calloc(n, m); }
void *realloc(void *p, size_t n) { calls += armed; return __libc_realloc(p, n); }
void *aligned_alloc(size_t a, size_t n) { calls += armed; return __libc_memalign(a, n); }
int posix_memalign(void **p, size_t a, size_t n) { calls += armed; *p = __libc_memalign(a, n); return *p ? 0 : 12; }
void free(void *p) { calls += armed; __libc_free(p); }
int main(int count, char **word) {
    void *library = dlopen(word[1], RTLD_NOW), *handle;
    const machine_ops *m = library ? dlsym(library, "zendsp_machine") : NULL;
    static machine_info info; static machine_sensors s; static machine_actuators a;
    char error[512];
    armed = 1;
    if (!m || m->open(&handle, word[2], 1e-3, &info, error, sizeof error)) { printf("%s\n", m ? error : dlerror()); return 1; }
    const long works = calls; calls = 0; /* opening allocates, in MuJoCo's library too */
    for (int k = 0; k < 3000; k++) {
        a.mode = k < 2000 ? MACHINE_TORQUE : k < 2500 ? MACHINE_VELOCITY : MACHINE_OFF;
        for (int j = 0; j < info.joints; j++) a.aout[j] = 3000.0 * ((k / 150) % 3 - 1);
        m->write(handle, &a); m->read(handle, &s); m->step(handle, 1e-3);
    }
    armed = 0;
    printf("%ld %ld\n", works, calls);
    return count == 0;
}
"""  # noqa: E501


@pytest.mark.parametrize("model", [ARM, ACROBOT], ids=["arm", "ball"])
def test_the_loop_of_a_mujoco_machine_allocates_nothing(model: Path) -> None:
    """With contacts (arm and ball meet the plane), stops, all drive modes and sensors; the counter
    is seen to count.
    """
    built = build(
        "test", {"count.c": HARNESS}, [source_root() / "include"], shared=False, libraries=("-ldl",)
    )
    assert built.path is not None, built.messages
    config = f"model = {model}\nclock = fast\neffect1 = delay joint=1 time=0.003\n"
    done = subprocess.run(
        [built.path, build_machine(str(model)), config], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
    works, calls = map(int, done.stdout.split())
    assert works > 100
    assert calls == 0


def test_power_off_lets_the_arm_sink_and_the_models_stops_hold_it() -> None:
    with robot(ARM, "q2 = 0.8") as plant:
        for _ in range(6000):
            plant.sample(np.zeros(3), OFF)
        assert 1.75 < plant.q[1] < 1.85
        assert np.abs(plant.qd).max() < 1e-3
