"""Small mechanisms for tests, and scenes without files.

Revolute joints turn about z, rods lie along x.
"""

from mbd_ros.api import scene_from
from mbd_ros.core.dynamics.output_values import Showing
from mbd_ros.core.state import NONE
from mbd_ros.scene.schema.strict_yaml import mapping_of


def scene_of(text, urdf=None):
    """The scene of a YAML text, and perhaps of a robot description, without a file."""
    return scene_from(mapping_of(text, "scene"), urdf=urdf)


def scaled(scene, scale):
    """The scene with all masses and inertias scaled."""
    inertias = scene.robot.inertias().items()
    return scene.with_inertias(
        {name: (scale * y.mass, y.lever, scale * y.inertia) for name, y in inertias}
    )


def wrenches_of(system, x, lam):
    """Wrenches that loops, bars and anchors of a system show at a state."""
    return Showing(system.k, system.layout).wrenches(x, NONE, NONE, lam)


def link(name, mass=0.0, com=(0.0, 0.0, 0.0), moments=(1.0, 1.0, 1.0)):
    """A link with principal moments about its mass centre; without mass it has no inertia."""
    if not mass:
        return f'<link name="{name}"/>'
    ixx, iyy, izz = moments
    return (
        f'<link name="{name}"><inertial><origin xyz="{_words(com)}"/><mass value="{mass}"/>'
        f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/>'
        "</inertial></link>"
    )


def joint(name, kind, parent, child, axis=(0, 0, 1), at=(0.0, 0.0, 0.0), limits=(-99.0, 99.0)):
    """A joint at a point of its parent."""
    lower, upper = limits
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{_words(at)}"/><axis xyz="{_words(axis)}"/>'
        f'<limit lower="{lower}" upper="{upper}" effort="100" velocity="10"/></joint>'
    )


def rod(name, length, mass):
    """A homogeneous rod along x from its origin, a hundredth of its length thick."""
    slender = mass * length**2 / 12.0
    thin = 1e-4 * mass * length**2
    return link(name, mass, (length / 2.0, 0.0, 0.0), (thin, slender, slender))


def urdf(*elements):
    return f'<robot name="mechanism">{"".join(elements)}</robot>'


def double_pendulum(lengths=(1.0, 1.0), masses=(1.0, 1.0)):
    """Two rods, joints `joint_1` and `joint_2`, links `rod_1` and `rod_2`."""
    return chain(2, lengths, masses)


def chain(n, lengths=None, masses=None):
    """Joints `joint_1` ..., rods `rod_1` ..., of 1 m and 1 kg unless told otherwise."""
    lengths, masses = lengths or [1.0] * n, masses or [1.0] * n
    elements = [link("world")]
    for i in range(n):
        parent, at = (f"rod_{i}", (lengths[i - 1], 0.0, 0.0)) if i else ("world", (0.0, 0.0, 0.0))
        elements.append(rod(f"rod_{i + 1}", lengths[i], masses[i]))
        elements.append(joint(f"joint_{i + 1}", "revolute", parent, f"rod_{i + 1}", at=at))
    return urdf(*elements)


def four_bar(crank=1.0, coupler=2.0, rocker=1.5, ground=2.0, masses=(1.0, 2.0, 1.5)):
    """Open four-bar in the x-y plane: joints `crank`, `coupler` (on the crank) and `rocker`.

    It is closed where `four_bar_closure` says.
    """
    return urdf(
        *(link("world"), rod("crank_link", crank, masses[0])),
        *(rod("coupler_link", coupler, masses[1]), rod("rocker_link", rocker, masses[2])),
        joint("crank", "revolute", "world", "crank_link"),
        joint("coupler", "revolute", "crank_link", "coupler_link", at=(crank, 0.0, 0.0)),
        joint("rocker", "revolute", "world", "rocker_link", at=(ground, 0.0, 0.0)),
    )


def four_bar_closure(coupler=2.0, rocker=1.5):
    """Arguments of the loop closure of `four_bar`."""
    return {
        "frame_a": "coupler_link",
        "point_a": [coupler, 0.0, 0.0],
        "frame_b": "rocker_link",
        "point_b": [rocker, 0.0, 0.0],
        "directions": "xy",
    }


def floating_body(mass=3.0, moments=(0.2, 0.3, 0.4)):
    """A trunk with two arms on skew axes; read it with `base="floating"`."""
    return urdf(
        link("trunk", mass, (0.1, 0.0, 0.05), moments),
        link("left", 1.0, (0.0, 0.1, -0.3), (0.03, 0.03, 0.01)),
        link("right", 0.7, (0.1, 0.0, -0.2), (0.02, 0.02, 0.01)),
        joint("left_swing", "revolute", "trunk", "left", (0.0, 1.0, 0.3), (0.0, 0.2, 0.0)),
        joint("right_slide", "prismatic", "trunk", "right", (1.0, 0.0, -1.0), (0.0, -0.2, 0.0)),
    )


def _words(vector):
    return " ".join(str(component) for component in vector)
