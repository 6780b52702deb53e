"""The robots and scenes that come with the package, against their documentation and sources."""

import importlib
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import yaml
from places import ROOT

from mbd_ros.scene.reader import load_scene

ROBOTS = ROOT / "config" / "robots"
SCENES = ROOT / "config" / "scenes"
HEIGHT, MASS = 1.75, 75.0
URDFS = (
    *("pendulum.urdf", "arm7.urdf", "prosthetic_arm.urdf", "prosthetic_leg.urdf"),
    *("gripper.urdf", "table.urdf"),
)
LEGS = ("prosthetic_leg.yaml", "prosthetic_leg_stance.yaml")
INDEPENDENT = {
    "empty.yaml": ("hinge",),
    "arm7.yaml": tuple(f"joint{i}" for i in range(1, 8)),
    "prosthetic_arm.yaml": (
        "shoulder_flexion",
        "shoulder_abduction",
        "wrist_rotation",
        "wrist_flexion",
    ),
    **dict.fromkeys(LEGS, ("hip_flexion", "knee", "ankle")),
}
# Tibia height over knee angle in the OpenSim model gait2392 (Yamaguchi and Zajac 1989)
KNEE_ANGLE = [-2.0944, -1.22173, -0.523599, -0.349066, -0.174533]
TIBIA_HEIGHT = [-0.4226, -0.4082, -0.399, -0.3976, -0.3966]
TIBIA_HEIGHT_STRAIGHT = -0.39582  # natural cubic spline at 0


def inertials(urdf):
    """Mass, centre of mass and 3 x 3 inertia of every link that has an <inertial>."""
    found = {}
    for link in ElementTree.parse(ROBOTS / urdf).getroot().iter("link"):
        if (inertial := link.find("inertial")) is not None:
            i = {k: float(v) for k, v in inertial.find("inertia").attrib.items()}
            found[link.get("name")] = (
                float(inertial.find("mass").get("value")),
                np.array(inertial.find("origin").get("xyz").split(), dtype=float),
                np.array(
                    [
                        [i["ixx"], i["ixy"], i["ixz"]],
                        [i["ixy"], i["iyy"], i["iyz"]],
                        [i["ixz"], i["iyz"], i["izz"]],
                    ]
                ),
            )
    return found


def frustum_part(mass, length, com, density, kept):
    """Mass, centre of mass and moments of the upper part of a cone frustum, in closed form."""
    ratio = max(np.roots([3 - 4 * com, 2 - 4 * com, 1 - 4 * com]).real)
    top = np.sqrt(3 * mass / (density * np.pi * length * (1 + ratio + ratio**2)))
    radius = np.poly1d([-top * (1 - ratio) / length, top])  # over the distance from the upper end
    slice_mass, x = density * np.pi * radius**2, np.poly1d([1.0, 0.0])
    part, first, second, axial = (
        p.integ()(kept * length)
        for p in (slice_mass, slice_mass * x, slice_mass * x**2, slice_mass * radius**2 / 2)
    )
    return part, first / part, second - first**2 / part + axial / 2, axial


@pytest.mark.parametrize("urdf", URDFS)
def test_every_inertia_can_exist(urdf):
    """Mass > 0, positive definite, and the triangle inequality with room to spare."""
    for name, (mass, _, inertia) in inertials(urdf).items():
        first, second, third = np.linalg.eigvalsh(inertia)
        assert mass > 0, name
        assert first > 0, name
        assert first + second > third * (1 + 1e-6), name


@pytest.fixture(scope="module")
def reference():
    """The page of robots that `make docs` generates."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "docs/site"))
        return importlib.import_module("robot_reference").page()


@pytest.mark.parametrize("urdf", URDFS)
def test_masses_are_those_of_the_documentation(urdf, reference):
    section = re.split(r"^## ", reference.split(f"\n## {Path(urdf).stem}\n")[1], flags=re.M)[0]
    table = section.split("| link |")[1]
    documented = {
        name: float(mass) for name, mass in re.findall(r"^\| `(\w+)` \| (\S+)", table, re.M)
    }
    assert documented == {name: mass for name, (mass, _, _) in inertials(urdf).items()}
    total = float(re.search(r"The links have (\S+) kg", section)[1])
    model = pin.buildModelFromUrdf(str(ROBOTS / urdf), pin.JointModelFreeFlyer())
    assert pin.computeTotalMass(model) == pytest.approx(total, rel=1e-5)


@pytest.mark.parametrize(
    ("urdf", "fraction", "length", "com", "density"),
    [
        ("prosthetic_leg.urdf", 0.100, 0.245 * HEIGHT, 0.433, 1050.0),
        ("prosthetic_arm.urdf", 0.028, 0.186 * HEIGHT, 0.436, 1070.0),
    ],
)
def test_residual_limb_is_cut_from_winters_segment(urdf, fraction, length, com, density):
    """Values in the file are rounded to 4 digits."""
    mass, centre, inertia = inertials(urdf)["residual_limb"]
    expected = frustum_part(fraction * MASS, length, com, density, kept=0.6)
    assert (mass, -centre[2], inertia[0, 0], inertia[2, 2]) == pytest.approx(expected, rel=1e-4)


def test_segment_lengths_are_winters_fractions_of_the_height():
    leg = pin.buildModelFromUrdf(str(ROBOTS / "prosthetic_leg.urdf"))
    data = leg.createData()
    pin.framesForwardKinematics(leg, data, pin.neutral(leg))
    names = ("residual_limb", "shank", "foot", "heel", "toe")
    hip, knee, ankle, heel, toe = (data.oMf[leg.getFrameId(n)].translation for n in names)
    lengths = [hip[2] - knee[2], knee[2] - ankle[2], ankle[2] - heel[2], toe[0] - heel[0]]
    assert np.divide(lengths, HEIGHT) == pytest.approx([0.245, 0.246, 0.039, 0.152])
    assert heel[2] == pytest.approx(0.0, abs=1e-9)  # the sole stands on the force plate
    arm = pin.buildModelFromUrdf(str(ROBOTS / "prosthetic_arm.urdf"))
    upper_arm = -arm.jointPlacements[arm.getJointId("elbow")].translation[2]
    joints = ("wrist_rotation", "wrist_flexion")
    forearm = -sum(arm.jointPlacements[arm.getJointId(j)].translation[2] for j in joints)
    assert np.divide([upper_arm, forearm], HEIGHT) == pytest.approx([0.186, 0.146])


@pytest.mark.parametrize("name", sorted(INDEPENDENT))
def test_scene_builds_and_stays_within_its_joint_limits(name):
    """Wherever the independent joints may go, the dependent ones stay in range and speed."""
    scene = load_scene(SCENES / name)
    couplings, joints = scene.couplings, scene.robot.joints
    assert couplings.independent == INDEPENDENT[name]
    lower, upper, speed = np.array([(j.lower, j.upper, j.max_velocity) for j in joints]).T
    assert np.all(lower < upper)
    assert all(j.max_velocity > 0 and j.max_effort > 0 for j in joints)
    v = couplings.v_index
    for share in np.linspace(0.0, 1.0, 201):
        q = couplings.positions(lower[v] + share * (upper[v] - lower[v]))
        assert np.array_equal(q, np.clip(q, lower - 1e-12, upper + 1e-12))
        assert np.all(np.abs(couplings.jacobian(q)) @ speed[v] <= speed + 1e-12)


@pytest.mark.parametrize("name", LEGS)
def test_knee_path_is_the_published_one(name):
    """The fit of the vertical slide is good to 0.15 mm; the forward slide keeps its table."""
    entries = yaml.safe_load((SCENES / name).read_text())["couplings"]
    table = entries["knee_slide_x"]["spline"]
    assert len(table["x"]) == len(table["y"]) == 12
    assert np.all(np.diff(table["x"]) > 0)
    couplings = load_scene(SCENES / name).couplings
    published = np.array(TIBIA_HEIGHT) - TIBIA_HEIGHT_STRAIGHT
    slides = [couplings.positions(np.array([0.0, z, 0.0]))[1:3] for z in KNEE_ANGLE]
    assert np.array(slides)[:, 1] == pytest.approx(published, abs=1.5e-4)
    angles = np.linspace(-2.0944, 0.0, 2001)
    path = np.array([couplings.positions(np.array([0.0, z, 0.0]))[1:3] for z in angles])
    assert path[[0, -1], 1] == pytest.approx([published[0], 0.0], abs=1.5e-4)
    assert min(table["y"]) <= path[:, 0].min()
    assert path[:, 0].max() <= max(table["y"]) + 3e-4  # a spline may pass its knots
    assert np.abs(np.diff(path, axis=0)).max() < 0.03 * (angles[1] - angles[0])  # no jump


def test_leg_hangs_straight_below_the_hip():
    scene = load_scene(SCENES / "prosthetic_leg.yaml")
    model, data = scene.robot.model, scene.robot.model.createData()
    com = pin.centerOfMass(model, data, scene.couplings.positions(np.zeros(3)))
    hip = model.jointPlacements[model.getJointId("hip_flexion")].translation
    assert com[2] < hip[2] - 0.2
    assert com[:2] == pytest.approx(hip[:2], abs=0.01)


@pytest.mark.parametrize(
    ("urdf", "joint", "frame", "direction"),
    [
        ("pendulum.urdf", "hinge", "rod", (1, 0, 0)),
        ("prosthetic_arm.urdf", "shoulder_flexion", "hand", (1, 0, 0)),
        ("prosthetic_arm.urdf", "shoulder_abduction", "hand", (0, -1, 0)),
        ("prosthetic_arm.urdf", "elbow", "hand", (1, 0, 0)),
        ("prosthetic_arm.urdf", "wrist_flexion", "hand", (0, 1, 0)),
        ("prosthetic_leg.urdf", "hip_flexion", "foot", (1, 0, 0)),
        ("prosthetic_leg.urdf", "knee", "foot", (1, 0, 0)),
        ("prosthetic_leg.urdf", "ankle", "toe", (0, 0, 1)),
    ],
)
def test_positive_angles_turn_as_documented(urdf, joint, frame, direction):
    """Motion of a body's centre of mass, or of a point without mass, from the hanging pose."""
    model = pin.buildModelFromUrdf(str(ROBOTS / urdf))
    data = model.createData()
    index = model.getFrameId(frame)
    centre = inertials(urdf).get(frame, (0, np.zeros(3)))[1]
    q = pin.neutral(model)
    J = pin.computeFrameJacobian(model, data, q, index, pin.LOCAL_WORLD_ALIGNED)
    column = J.reshape(6, model.nv)[:, model.joints[model.getJointId(joint)].idx_v]
    pin.framesForwardKinematics(model, data, q)
    velocity = column[:3] + np.cross(column[3:], data.oMf[index].rotation @ centre)
    assert velocity @ np.array(direction) > 0.05
