"""Paths against geometry by hand and differences, cables against equations of motion by hand."""

import itertools
import math

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import double_pendulum, floating_body, four_bar, four_bar_closure
from places import ROOT
from scipy.integrate import simpson, solve_ivp
from scipy.interpolate import CubicSpline

from mbd_ros.api import Scene, scene_from
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.state import NONE, State
from mbd_ros.errors import SceneError
from mbd_ros.scene.reading.path_entries import path_of

ROBOTS = ROOT / "config/robots"
ARM_TEXT = (ROBOTS / "arm7.urdf").read_text(encoding="utf-8")
ARM, FREE_ARM = read_robot(ARM_TEXT), read_robot(ARM_TEXT, base="floating")
every_base = pytest.mark.parametrize("robot", [ARM, FREE_ARM], ids=["fixed", "floating"])
MOVED = ARM.joints[3].name
STRAIGHT = [
    {"frame": "link1", "xyz": [0.1, 0.0, 0.05]},
    {"frame": "link3", "xyz": [0.05, 0.1, 0.0]},
    {"frame": "link3", "xyz": [0.05, 0.1, 0.1]},
    {"frame": "link5", "xyz": [0.0, -0.1, 0.05]},
    {"frame": "flange", "xyz": [0.02, 0.03, 0.0]},
]
SLIDING = [
    STRAIGHT[0],
    {
        "frame": "link4",
        "xyz": [9.0, 0.08, 9.0],
        "moves": {
            "joint": MOVED,
            "x": {"polynomial": [0.05, 0.03, -0.02]},
            "z": {"spline": {"x": [-3.0, -1.0, 0.5, 3.0], "y": [0.1, 0.0, 0.05, 0.2]}},
        },
    },
    STRAIGHT[4],
]
THERE = {"joint": MOVED, "lower": -0.6, "upper": 0.7}
SWITCHED = [STRAIGHT[0], {**STRAIGHT[1], "within": THERE}, *SLIDING[1:]]
PULLEYS = {ARM.joints[1].name: 0.03, ARM.joints[5].name: [0.2, -0.02, 0.004, 0.01]}
PATHS = {
    "straight": {"points": STRAIGHT},
    "sliding": {"points": SLIDING},
    "switched": {"points": SWITCHED},
    "joints": {"joints": PULLEYS},
    "both": {"points": STRAIGHT, "joints": PULLEYS},
}
every_path = pytest.mark.parametrize("entry", PATHS.values(), ids=PATHS)


def length_by_hand(robot, entry, q):
    """Pinocchio's frames, and the functions written down again."""
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, q)
    joint = {one.name: q[one.q] for one in robot.joints}
    places = []
    for via in entry.get("points", ()):
        point, angle = np.array(via.get("xyz", (0.0, 0.0, 0.0))), joint[MOVED]
        if "moves" in via:
            point[0] = 0.05 + 0.03 * angle - 0.02 * angle**2
            point[2] = natural_spline(angle)
        if "within" not in via or THERE["lower"] <= angle <= THERE["upper"]:
            places.append(data.oMf[robot.frame(via["frame"])].act(point))
    length = sum(np.linalg.norm(b - a) for a, b in itertools.pairwise(places))
    if "joints" in entry:
        length += 0.03 * joint[ARM.joints[1].name]
        length += np.polyval([0.01, 0.004, -0.02, 0.2], joint[ARM.joints[5].name])
    return length


def natural_spline(angle, derivative=0):
    spline = SLIDING[1]["moves"]["z"]["spline"]
    curve = CubicSpline(spline["x"], spline["y"], bc_type="natural")
    return float(curve(angle, derivative))


def states(robot, count=6):
    """Random ones, with the joint of `within` on either side of its ends."""
    rng, model = np.random.default_rng(2), robot.model
    index = robot.joint(MOVED).q
    for i in range(count):
        q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.0, 1.0, model.nv))
        q[index] = (-0.3, 1.1, -0.9)[i % 3]
        yield State(0.0, q, rng.normal(size=model.nv))


def at(robot, x):
    k = Kinematics(robot)
    k.refresh(x.q, x.v)
    return k


@every_base
@every_path
def test_length_moment_arms_and_drift_are_those_of_the_geometry(entry, robot):
    """Central differences of lengths by hand: 3e-6 of 1 m leaves 1e-10, of J v 1e-9."""
    path, model, h = path_of(robot, entry, "here"), robot.model, 3e-6
    for x in states(robot):
        length, slope = path.measured(at(robot, x), x)
        assert length == pytest.approx(length_by_hand(robot, entry, x.q), abs=1e-14)
        assert path.length(at(robot, x), x) == length
        by_hand = [
            (
                length_by_hand(robot, entry, pin.integrate(model, x.q, step))
                - length_by_hand(robot, entry, pin.integrate(model, x.q, -step))
            )
            / (2.0 * h)
            for step in h * np.eye(model.nv)
        ]
        assert np.abs(slope).max() > 0.01
        np.testing.assert_allclose(slope, by_hand, atol=1e-9)
        ends = [x._replace(q=pin.integrate(model, x.q, s * h * x.v)) for s in (-1.0, 1.0)]
        rates = [path.measured(at(robot, end), end)[1] @ x.v for end in ends]
        bent = (rates[1] - rates[0]) / (2.0 * h)
        assert path.drift(at(robot, x), x) == pytest.approx(bent, abs=1e-8)


@every_base
@every_path
def test_forces_on_bodies_do_the_work_of_the_tension(entry, robot):
    """-F l' = sum of forces . velocities of body points + what joints do, and no net load."""
    path, model = path_of(robot, entry, "here"), robot.model
    for x in states(robot):
        pulls, slope = path.pulls(at(robot, x), x), path.measured(at(robot, x), x)[1]
        data = model.createData()
        pin.forwardKinematics(model, data, x.q, x.v)
        power, net = 0.0, np.zeros(6)
        for frame, point, force in pulls:
            body = model.frames[robot.frame(frame)].parentJoint
            twist = data.oMi[body].act(data.v[body])  # about the origin of the world
            power += force @ (twist.linear + np.cross(twist.angular, point))
            net += np.concatenate((force, np.cross(point, force)))
        np.testing.assert_allclose(net, 0.0, atol=1e-14)
        in_joints = sum(slope_in_joints(robot, entry, x, pulls).values())
        assert -slope @ x.v == pytest.approx(power + in_joints, abs=1e-12)


def slope_in_joints(robot, entry, x, pulls):
    """Power of a tension of 1 N on pulleys, and along points that joints slide."""
    found, joint = {}, {one.name: one for one in robot.joints}
    if "joints" in entry:
        one, other = (joint[ARM.joints[i].name] for i in (1, 5))
        q = x.q[other.q]
        found["radius"] = -0.03 * x.v[one.v]
        found["curve"] = -(-0.02 + 0.008 * q + 0.03 * q**2) * x.v[other.v]
    if any("moves" in via for via in entry.get("points", ())):
        data, q = robot.model.createData(), x.q[joint[MOVED].q]
        pin.framesForwardKinematics(robot.model, data, x.q)
        axes = data.oMf[robot.frame("link4")].rotation
        curve = natural_spline(q, derivative=1)
        (force,) = (pull.force for pull in pulls if pull.frame == "link4")
        found["slide"] = force @ axes @ [0.03 - 0.04 * q, 0.0, curve] * x.v[joint[MOVED].v]
    return found


def test_a_path_over_one_joint_alone_is_a_joint_spring():
    strap = {"path": {"joints": {"knee": 0.04}}, "stiffness": 500.0, "slack_length": -9.0}
    scene = scene_from({"forces": [{"type": "cable", **strap}]}, urdf="prosthetic_leg")
    (part,), x = scene.forces, scene.initial
    x.q[scene.robot.joint("knee").q] = 0.3
    tau = part.force(Kinematics(scene.robot), x, NONE)
    assert tau[scene.robot.joint("knee").v] == pytest.approx(-500.0 * (9.0 + 0.012) * 0.04)
    assert np.count_nonzero(tau) == 1
    assert part.wrenches(Kinematics(scene.robot), x, NONE) == ()


HOOK, EYE, TIP = np.array([0.4, 0.0, 0.1]), np.array([0.25, 0.0, -0.2]), np.array([0.0, 0.0, -0.8])
STIFFNESS, DAMPING, SLACK = 60.0, 2.0, 1.05
MASS, INERTIA, CENTRE, GRAVITY = 1.0, 0.0833583 + 0.25, 0.5, 9.81  # of pendulum.urdf


def pendulum_cable(**more):
    """A cable from the world through an eye at rest to the tip of the rod, over its hinge."""
    through = [
        {"frame": "world", "xyz": HOOK.tolist()},
        {"frame": "world", "xyz": EYE.tolist()},
        {"frame": "rod", "xyz": TIP.tolist()},
    ]
    cable = {"type": "cable", "stiffness": STIFFNESS, "damping": DAMPING, "slack_length": SLACK}
    entries = {"forces": [{**cable, **more, "path": {"points": through}}], "dt": 0.01}
    entries["integrator"] = {"type": "dop853", "tolerance": 1e-12}
    return scene_from(
        {**entries, "initial": {"position": {"hinge": 1.5}}},
        urdf="pendulum",
    )


def tension_by_hand(q, v, damping):
    tip = np.array([0.8 * math.sin(q), 0.0, -0.8 * math.cos(q)])
    along = np.array([0.8 * math.cos(q), 0.0, 0.8 * math.sin(q)])
    line = tip - EYE
    length = np.linalg.norm(EYE - HOOK) + np.linalg.norm(line)
    arm = along @ line / np.linalg.norm(line)
    stretch = length - SLACK
    tension = max(0.0, STIFFNESS * stretch + damping * arm * v) if stretch > 0.0 else 0.0
    return tension, arm, stretch


@pytest.mark.parametrize("damping", [0.0, DAMPING])
def test_a_cable_over_a_joint_moves_as_its_equation_by_hand(damping):
    """2 s of I q'' = -m g c sin q - F dl/dq, slack and taut, by pieces between the two."""

    def rates(t, y):
        tension, arm, _ = tension_by_hand(*y, damping)
        return y[1], (-MASS * GRAVITY * CENTRE * math.sin(y[0]) - tension * arm) / INERTIA

    def switch(t, y):
        return tension_by_hand(*y, damping)[2]

    switch.terminal = True
    t, y, times = 0.0, [1.5, 0.0], []
    while t < 2.0:  # a method of another family, begun anew where the cable becomes taut or slack
        solved = solve_ivp(rates, (t, 2.0), y, "Radau", rtol=1e-12, atol=1e-13, events=switch)
        t, y = solved.t[-1], solved.y[:, -1]
        times.append(t)
        t, y = (t, y) if t >= 2.0 else stepped(rates, t, y)
    assert len(times) == 3
    end = list(pendulum_cable(damping=damping).simulation().run(State(0.0, *START), 2.0))[-1]
    assert end.q[0] == pytest.approx(y[0], abs=1e-9)
    assert end.v[0] == pytest.approx(y[1], abs=1e-9)


START = np.array([1.5]), np.zeros(1)


def stepped(rates, t, y, h=1e-7):
    """A step past the event, which the next search would find again; its error is h^3."""
    middle = y + 0.5 * h * np.array(rates(t, y))
    return t + h, y + h * np.array(rates(t + 0.5 * h, middle))


def test_a_damped_cable_on_a_floating_body_takes_what_the_energy_loses():
    """E(0) - E(1 s) is the integral of (F - stiffness s) l', and there is no net load."""
    points = [
        {"frame": "left", "xyz": [0.0, 0.1, -0.3]},
        {"frame": "trunk", "xyz": [0.1, 0.0, 0.3]},
        {"frame": "right", "xyz": [0.1, 0.1, -0.2]},
    ]
    cable = {"path": {"points": points}, "stiffness": 40.0, "damping": 2.0, "slack_length": 0.2}
    entries = {
        "robot": {"base": "floating"},
        "forces": [{"type": "cable", **cable}],
        "initial": {"position": {"left_swing": 0.4}, "velocity": {"right_slide": 0.3}},
        "integrator": {"type": "dop853", "tolerance": 1e-12},
        "dt": 1e-3,
    }
    scene = scene_from(entries, urdf=floating_body())
    simulation, (part,) = scene.simulation(), scene.forces
    energies, lost = [], []
    for x in simulation.run(scene.initial, 1.0):
        k = at(scene.robot, x)
        length, slope = part.path.measured(k, x)
        tension = part.show(k, x, NONE, None)[0]
        energies.append(simulation.system.energy(x))
        lost.append((tension - 40.0 * (length - 0.2)) * (slope @ x.v))
        assert tension > 5.0
        assert part.force(k, x, NONE)[:6] == pytest.approx(np.zeros(6), abs=1e-14 * tension)
    whole = simpson(lost, dx=1e-3)
    assert whole > 0.05
    assert energies[0] - energies[-1] == pytest.approx(whole, rel=1e-9)


def test_a_cable_over_a_coupled_joint_acts_through_its_slope():
    """joint_2 = 0.5 joint_1 + 0.2 joint_1^2: G' tau of Lagrange's equation, by differences."""
    entries = {
        "couplings": {"joint_2": {"parent": "joint_1", "polynomial": [0.0, 0.5, 0.2]}},
        "gravity": [0.0, -9.81, 0.0],
        "forces": [
            {
                "type": "cable",
                "path": {
                    "points": [
                        {"frame": "world", "xyz": [0.0, 0.3, 0.0]},
                        {"frame": "rod_1", "xyz": [0.5, 0.1, 0.0]},
                        {"frame": "rod_2", "xyz": [0.6, 0.0, 0.0]},
                    ]
                },
                "stiffness": 300.0,
                "slack_length": 0.3,
            }
        ],
    }
    scene = scene_from(entries, urdf=double_pendulum())
    bare = scene.with_(forces=[])
    y, h = 0.7, 1e-6

    def stored(angle):
        """Energy of the cable by hand."""
        other = 0.5 * angle + 0.2 * angle**2
        one = rotated(angle, [0.5, 0.1])
        two = rotated(angle, [1.0, 0.0]) + rotated(angle + other, [0.6, 0.0])
        length = np.linalg.norm(one - [0.0, 0.3]) + np.linalg.norm(two - one)
        return 0.5 * 300.0 * (length - 0.3) ** 2

    wanted = (stored(y - h) - stored(y + h)) / (2.0 * h)
    z = np.array([y]), np.array([0.4]), np.array([-0.3])
    moved, free = (one.inverse_dynamics().solve(*z).tau for one in (scene, bare))
    assert free - moved == pytest.approx([wanted], rel=1e-8)


def rotated(angle, point):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * point[0] - s * point[1], s * point[0] + c * point[1]])


def test_a_cable_in_a_closed_loop_keeps_the_energy():
    """Two seconds of a four-bar, cable from crank to rocker, to 1e-9 of the energy."""
    cable = {
        "type": "cable",
        "path": {
            "points": [
                {"frame": "crank_link", "xyz": [0.5, 0.1, 0.0]},
                {"frame": "world", "xyz": [1.0, -0.4, 0.0]},
                {"frame": "rocker_link", "xyz": [0.8, 0.0, 0.0]},
            ]
        },
        "stiffness": 80.0,
        "slack_length": 0.5,
    }
    entries = {
        "gravity": [0.0, -9.81, 0.0],
        "forces": [cable],
        "constraints": [{"type": "loop_closure", **four_bar_closure()}],
        "initial": {"position": {"crank": 1.0, "coupler": -0.7, "rocker": 1.3}},
        "integrator": {"type": "dop853", "tolerance": 1e-12},
        "dt": 0.02,
    }
    simulation = scene_from(entries, urdf=four_bar()).simulation()
    x = simulation.system.expand(simulation.start(scene_from(entries, urdf=four_bar()).initial))
    energies = [simulation.system.energy(one) for one in simulation.run(x, 2.0)]
    assert len(energies) == 101
    assert np.ptp(energies) < 1e-9 * max(np.abs(energies))


def test_length_and_tension_are_columns():
    table = Scene.of(pendulum_cable(name="stay")).simulate(0.1)["samples"]
    units = {column.name: column.unit for column in table.columns}
    assert (units["stay.tension"], units["stay.length"]) == ("N", "m")
    for i in (0, 5):
        expected, _, stretch = tension_by_hand(
            table["hinge.position"][i], table["hinge.velocity"][i], DAMPING
        )
        assert table["stay.tension"][i] == pytest.approx(expected, rel=1e-12)
        assert table["stay.length"][i] == pytest.approx(stretch + SLACK, rel=1e-14)


def test_a_named_path_is_shared_and_its_numbers_have_names():
    strap = {"joints": {"knee": 0.04, "ankle": 0.02}}
    both = [
        {"type": "cable", "path": "strap", "stiffness": 500.0, "slack_length": 0.1},
        {"type": "cable", "path": "strap", "stiffness": 10.0, "slack_length": 0.0},
    ]
    scene = scene_from({"paths": {"strap": strap}, "forces": both}, urdf="prosthetic_leg")
    assert [part.name for part in scene.forces] == ["strap_cable", "strap_cable_2"]
    assert all(part.path is scene.parts["paths"]["strap"] for part in scene.forces)
    assert "path        strap over knee, ankle" in scene.check()
    other = scene.with_({"strap.joints.knee": 0.05, "strap_cable.stiffness": 400.0})
    x = other.initial
    x.q[other.robot.joint("knee").q] = 1.0
    assert other.forces[1].path.length(Kinematics(other.robot), x) == 0.05
    kept = scene.with_({"strap_cable.stiffness": 400.0})
    assert kept.forces[0].path is scene.forces[0].path


POINTS = [{"frame": "world"}, {"frame": "foot"}]
SHANK = {"frame": "shank"}
KNEE = {"joint": "knee", "lower": 0.1}


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("strip", "forces[0].path: no path 'strip', accepted: strap"),
        ({}, "forces[0].path: a path needs points, joints or polynomial"),
        ({"points": POINTS[:1]}, "forces[0].path: a path needs two points or more, got 1"),
        ({"points": [POINTS[1], {"frame": "toe"}]}, "frames 'foot' and 'toe' have no relative"),
        ({"points": [{"frame": "nose"}, POINTS[1]]}, "path.points[0]: no frame 'nose'; the links"),
        (
            {"points": POINTS, "bends": []},
            "path: unknown key 'bends', accepted: points, joints, wraps",
        ),
        ({"points": [{**POINTS[0], "within": KNEE}, POINTS[1]]}, "the ends of a path do not come"),
        (
            {
                "points": [
                    POINTS[0],
                    {**SHANK, "within": {**KNEE, "upper": 0.0}},
                    POINTS[1],
                ]
            },
            "points[1].within: lower 0.1 is above upper 0",
        ),
        (
            {"points": [POINTS[0], {**SHANK, "moves": {"joint": "knee"}}, POINTS[1]]},
            "points[1].moves: give x, y or z as a function",
        ),
        (
            {"points": [{"frame": "world", "moves": {"joint": "knee", "x": {}}}, POINTS[1]]},
            "points[0].moves.x: give exactly one of factor, polynomial, spline",
        ),
        (
            {"points": [POINTS[0], *[{**SHANK, "within": KNEE}] * 9, POINTS[1]]},
            "9 points",
        ),
        ({"joints": {"nose": 0.1}}, "forces[0].path: no joint 'nose'"),
        ({"joints": {"knee": "far"}}, "path.joints.knee: expected a number, got 'far'"),
    ],
)
def test_a_wrong_path_is_named_with_its_key(path, message):
    cable = {"type": "cable", "path": path, "stiffness": 1.0, "slack_length": 0.1}
    entries = {"paths": {"strap": {"joints": {"knee": 0.1}}}, "forces": [cable]}
    with pytest.raises(SceneError) as caught:
        scene_from(entries, urdf="prosthetic_leg")
    assert message in str(caught.value)


def test_a_path_and_a_part_do_not_share_a_name():
    cable = {"type": "cable", "path": "strap", "stiffness": 1.0, "slack_length": 0.1}
    entries = {"paths": {"strap": {"joints": {"knee": 0.1}}}}
    with pytest.raises(SceneError, match="name 'strap' is that of a part of paths"):
        scene_from({**entries, "forces": [{**cable, "name": "strap"}]}, urdf="prosthetic_leg")
