"""A chain of rigid bodies as data, written as MJCF for the reality and as URDF for the given model.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

Triple = tuple[float, float, float]
STANDARD = (0.02, 1.0)  # MuJoCo's own solref: time constant s, damping ratio
SOFT = (0.9, 0.95, 0.001)  # MuJoCo's own solimp: a constraint that gives way
HARD = (0.999, 0.9999, 0.001)
YIELDING = 0.05  # impedance of a stop that gives way like a spring


@dataclass(frozen=True)
class Link:
    """One moving body, and the joint that carries it.

    Attributes
    ----------
    place : triple of float
        Origin of the joint in the frame of the link before, m; frames are parallel where q = 0.
    axis : triple of float
        Of the joint, unit length.
    mass : float
        kg.
    com : triple of float
        Centre of mass in the link's frame, m.
    inertia : six floats
        xx yy zz xy xz yz about the centre of mass, kg m².
    slides : bool
        A prismatic joint; False: a revolute one.
    """

    place: Triple
    axis: Triple
    mass: float
    com: Triple
    inertia: tuple[float, float, float, float, float, float]
    slides: bool = False

    def heavier(self, ratio: float) -> Link:
        """The same shape of a denser stuff."""
        i = self.inertia
        scaled = (
            i[0] * ratio, i[1] * ratio, i[2] * ratio, i[3] * ratio, i[4] * ratio, i[5] * ratio,
        )
        return replace(self, mass=self.mass * ratio, inertia=scaled)

    def moved(self, by: Triple) -> Link:
        """The same body with its centre of mass elsewhere."""
        c = self.com
        return replace(self, com=(c[0] + by[0], c[1] + by[1], c[2] + by[2]))


@dataclass
class Joint:
    """What acts in one joint of the reality; zero, or None, where nothing does.

    Torques are N m (N where the joint slides), positions rad (m), times s.
    """

    armature: float = 0.0  # kg m² (kg), rotor inertia as the joint feels it
    damping: float = 0.0
    dry: float = 0.0  # MuJoCo's frictionloss
    solref: tuple[float, float] = STANDARD  # of the dry friction
    solimp: tuple[float, float, float] = HARD
    stiffness: float = 0.0
    springref: float = 0.0
    stops: tuple[float, float] | None = None  # joint range, a soft limit
    stop_solref: tuple[float, float] = (0.05, 1.0)
    gain: float = 1.0  # torque per unit of command
    force_limit: float = 0.0  # torque, 0: none
    lag: float = 0.0  # activation dynamics
    delay: float = 0.0
    dead_zone: float = 0.0  # command units
    offset: float = 0.0
    # a second body in the joint: rotor inertia, spring, damper; the sensor stays on the rotor
    spring: tuple[float, float] | None = None  # stiffness, damping
    gap: tuple[float, float, float] | None = None  # full width, time constant of contact, damping
    equality: tuple[float, float] | None = None  # solref of a soft equality between rotor and link

    @property
    def two_sided(self) -> bool:
        """The rotor and the link move on their own."""
        return self.spring is not None or self.gap is not None or self.equality is not None


@dataclass
class World:
    """What surrounds the chain, as MJCF.

    Attributes
    ----------
    gravity : triple of float
        m/s².
    base : str
        Joints of the base's own body: a base that moves. Empty: it stands.
    on_link : dict of int to str
        Elements of a link's body (sites, geoms, bodies that it carries), by link.
    still : str
        Elements that stand.
    tendons : str
        Elements of <tendon>.
    """

    gravity: Triple = (0.0, 0.0, -9.81)
    base: str = ""
    on_link: dict[int, str] = field(default_factory=dict)
    still: str = ""
    tendons: str = ""


def numbers(values: object) -> str:
    """Space-separated, so that reading gives the same floats."""
    return " ".join(repr(float(v)) for v in np.atleast_1d(np.asarray(values, float)))


def rod(mass: float, length: float, radius: float, along: int) -> Link:
    """A solid cylinder that begins at its joint, to be placed with ``dataclasses.replace``."""
    thin = mass * (3 * radius**2 + length**2) / 12
    inertia = [thin, thin, thin]
    inertia[along] = 0.5 * mass * radius**2
    com = [0.0, 0.0, 0.0]
    com[along] = 0.5 * length
    return Link(
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 1.0),
        mass,
        (com[0], com[1], com[2]),
        (inertia[0], inertia[1], inertia[2], 0.0, 0.0, 0.0),
    )


def mjcf(links: list[Link], joints: list[Joint], world: World, step: float, integrator: str) -> str:
    """The reality as an MJCF document; joint k is ``j0``… and its motor ``m0``…."""
    heads, tails, beside = [], [], []
    for k, (link, joint) in enumerate(zip(links, joints, strict=True)):
        body = (
            f'<inertial pos="{numbers(link.com)}" mass="{numbers(link.mass)}"'
            f' fullinertia="{numbers(link.inertia)}"/>'
        )
        kind = "slide" if link.slides else "hinge"
        motor = (
            f'<joint name="j{k}" type="{kind}" axis="{numbers(link.axis)}"'
            f' armature="{numbers(joint.armature)}" damping="{numbers(joint.damping)}"'
            f' frictionloss="{numbers(joint.dry)}" solreffriction="{numbers(joint.solref)}"'
            f' solimpfriction="{numbers(joint.solimp)}" stiffness="{numbers(joint.stiffness)}"'
            f' springref="{numbers(joint.springref)}"{stops(joint)}/>'
        )
        place = f'pos="{numbers(link.place)}"'
        named = f'name="link{k + 1}"'  # as its URDF calls it
        if joint.equality is not None:
            beside.append(f"<body {place}>{motor}{ROTOR}</body>")
            inner = f'<joint name="f{k}" type="{kind}" axis="{numbers(link.axis)}"/>'
            heads.append(f"<body {named} {place}>{inner}{body}{world.on_link.get(k, '')}")
        elif joint.two_sided:
            inner = flexible(k, joint, kind, link)
            heads.append(
                f"<body {place}>{motor}{ROTOR}<body {named}>{inner}{body}{world.on_link.get(k, '')}"
            )
            tails.append("</body>")
        else:
            heads.append(f"<body {named} {place}>{motor}{body}{world.on_link.get(k, '')}")
        tails.append("</body>")
    chain = "".join(heads) + "".join(tails)
    if world.base:
        mass = '<inertial pos="0 0 0" mass="20" diaginertia="0.5 0.5 0.5"/>'
        chain = f"<body>{world.base}{mass}{chain}</body>"
    equal = "".join(
        f'<joint joint1="f{k}" joint2="j{k}" solref="{numbers(j.equality)}" solimp="0.9 0.9'
        ' 0.001"/>'
        for k, j in enumerate(joints)
        if j.equality is not None
    )
    return (
        f'<mujoco><compiler angle="radian" autolimits="true"/><option timestep="{numbers(step)}" '
        f'integrator="{integrator}" gravity="{numbers(world.gravity)}" iterations="200"'
        ' tolerance="1e-12"/>'
        f"<worldbody>{world.still}{''.join(beside)}{chain}</worldbody>"
        f"{'<tendon>' + world.tendons + '</tendon>' if world.tendons else ''}"
        f"{'<equality>' + equal + '</equality>' if equal else ''}"
        f"<actuator>{''.join(motor_of(k, j) for k, j in enumerate(joints))}</actuator></mujoco>"
    )


ROTOR = '<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>'


def stops(joint: Joint) -> str:
    """Attributes of a joint's soft end stops."""
    if joint.stops is None:
        return ""
    return (
        f' range="{numbers(joint.stops)}" solreflimit="{numbers(joint.stop_solref)}" '
        f'solimplimit="{YIELDING} {YIELDING} 0.001"'
    )


def flexible(k: int, joint: Joint, kind: str, link: Link) -> str:
    """The joint between rotor and link."""
    head = f'<joint name="f{k}" type="{kind}" axis="{numbers(link.axis)}"'
    if joint.gap is not None:
        width, contact, damping = joint.gap
        return (
            f'{head} range="{numbers((-width / 2, width / 2))}"'
            f' solreflimit="{numbers((contact, 1.0))}" solimplimit="0.95 0.99 0.001"'
            f' damping="{numbers(damping)}"/>'
        )
    assert joint.spring is not None
    return f'{head} stiffness="{numbers(joint.spring[0])}" damping="{numbers(joint.spring[1])}"/>'


def motor_of(k: int, joint: Joint) -> str:
    """The actuator: gain, activation dynamics, limit of force."""
    limit = (
        f' forcerange="{numbers((-joint.force_limit, joint.force_limit))}"'
        if joint.force_limit
        else ""
    )
    lag = f' dyntype="filterexact" dynprm="{numbers(joint.lag)}"' if joint.lag else ""
    return f'<general name="m{k}" joint="j{k}" gainprm="{numbers(joint.gain)}"{lag}{limit}/>'


def urdf(links: list[Link], limits: list[float], name: str) -> str:
    """The same bodies as URDF text, every joint turning (``limits``: effort, N m)."""
    lines = ['<?xml version="1.0"?>', f'<robot name="{name}">', '  <link name="base"/>']
    parent = "base"
    for k, (link, limit) in enumerate(zip(links, limits, strict=True), 1):
        xx, yy, zz, xy, xz, yz = link.inertia
        parts = {"ixx": xx, "iyy": yy, "izz": zz, "ixy": xy, "ixz": xz, "iyz": yz}
        tensor = " ".join(f'{n}="{float(v)!r}"' for n, v in parts.items())
        lines += [
            f'  <link name="link{k}"><inertial>',
            f'    <origin xyz="{numbers(link.com)}" rpy="0 0 0"/>',
            f'    <mass value="{numbers(link.mass)}"/><inertia {tensor}/>',
            "  </inertial></link>",
            f'  <joint name="joint{k}" type="revolute">',
            f'    <parent link="{parent}"/><child link="link{k}"/>',
            (
                f'    <origin xyz="{numbers(link.place)}" rpy="0 0 0"/><axis'
                f' xyz="{numbers(link.axis)}"/>'
            ),
            f'    <limit lower="-6" upper="6" effort="{limit!r}" velocity="10"/>',
            "  </joint>",
        ]
        parent = f"link{k}"
    return "\n".join([*lines, "</robot>"]) + "\n"
