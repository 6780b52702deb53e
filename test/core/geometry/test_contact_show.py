"""What contacts show: gap, state, force and centre of pressure, by hand and in closed form."""

import numpy as np
import pytest
from rclpy.validate_full_topic_name import validate_full_topic_name

import mbd_ros as mbd
from mbd_ros.core.contracts import Kind
from mbd_ros.core.dynamics.output_values import Showing
from mbd_ros.core.geometry.contact_outputs import OPEN, SLIP, STICK
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.rows.constraint_rows import RowLayout
from mbd_ros.core.state import State
from mbd_ros.methods.simulation.checked_steps import last_finite
from mbd_ros.nodes.shell.contact_topics import topic_of

G, MASS = 9.81, 3.0
CORNERS = [[x, y, -0.1] for x in (-0.3, 0.2) for y in (-0.15, 0.15)]
FEET = {"frame": "box", "points": CORNERS}
BOX = {"box": {"shape": {"box": [0.6, 0.3, 0.2]}, "mass": MASS}}


def resting(friction=0.6, slope=0.0, offset=(0.0, 0.0, 0.0), **more):
    """A box on four points over a plane through `offset`, tilted about y by `slope`."""
    s, c = np.sin(slope), np.cos(slope)
    plane = {"half_space": [float(s), 0.0, float(c)], "xyz": list(map(float, offset))}
    place = np.array(offset) + 0.1 * np.array((s, 0.0, c))
    pose = {"xyz": place.tolist(), "rpy": [0.0, float(slope), 0.0]}
    return mbd.scene_from(
        {
            "bodies": {"box": {**BOX["box"], "pose": pose}},
            "contacts": [{"type": "rigid", "between": [FEET, plane], "friction": friction}],
            "dt": 0.01,
            **more,
        }
    )


def rotation(rng):
    """A random rotation and its quaternion (x, y, z, w)."""
    quaternion = rng.normal(size=4)
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    cross = np.array(((0, -z, y), (z, 0, -x), (-y, x, 0)))
    return np.eye(3) + 2.0 * cross @ (cross + w * np.eye(3)), (x, y, z, w)


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (100.0, -70.0, 30.0)])
def test_the_wrench_at_the_centre_of_pressure_is_that_of_all_forces(offset):
    """Sums over four points in an arbitrary pose, about the origin of the world."""
    rng, scene = np.random.default_rng(4), resting(offset=offset)
    (part,), robot = scene.constraints, scene.robot
    k, base = Kinematics(robot), robot.bases[0]
    for _ in range(5):
        R, quaternion = rotation(rng)
        place = np.array(offset) + rng.normal(size=3)
        q = robot.neutral().copy()
        q[base.q] = *(place - robot.origin), *quaternion
        k.refresh(q, np.zeros(6), Reads.POSITION)
        forces = rng.uniform(0.5, 9.0, (4, 3))
        points = place + np.array(CORNERS) @ R.T
        each = forces[:, [1, 2, 0]]  # tangents and normal of a level plane are the axes x, y, z
        shown = dict(zip(part.outputs, part.contact.values(k, forces), strict=True))
        shown = {output.name: value for output, value in shown.items()}
        centre = forces[:, 0] @ points / forces[:, 0].sum()
        assert shown["centre_of_pressure"] == pytest.approx(centre, abs=1e-12)
        assert shown["force"] == pytest.approx(each.sum(axis=0), rel=1e-12)
        about_origin = np.cross(points, each).sum(axis=0)
        moved = shown["torque"] + np.cross(shown["centre_of_pressure"], shown["force"])
        assert moved == pytest.approx(about_origin, rel=1e-11, abs=1e-11)
        gaps = points[:, 2] - offset[2]
        assert shown["gap"] == pytest.approx(gaps.min(), abs=1e-12)
        assert [shown[f"gap_point_{i}"] for i in range(4)] == pytest.approx(gaps, abs=1e-12)
        on_box, on_ground = part.wrenches(k, State(0.0, q, np.zeros(6)), forces.ravel())
        assert (on_box.frame, on_box.force.tolist()) == ("box", shown["force"].tolist())
        assert on_ground.force.tolist() == (-on_box.force).tolist()
        assert shown["on_box"].tolist() == [*on_box.point, *on_box.numbers]


def test_states_tell_open_slip_and_stick_apart():
    (part,) = resting(friction=[0.5, 0.5, 0.0, 0.5]).constraints
    forces = np.array(((2.0, 0.6, -0.8), (2.0, 0.3, 0.1), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    assert part.contact.states(forces).tolist() == [SLIP, STICK, SLIP, OPEN]
    forces[1, 0] = forces[1, 1] = 1e-6  # a share that is rounding
    assert part.contact.states(forces).tolist() == [SLIP, OPEN, SLIP, OPEN]
    forces[1, 0] = 2.0
    slips = np.array((False, True, False, True))
    assert part.contact.states(forces, slips).tolist() == [STICK, SLIP, STICK, OPEN]


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (100.0, 50.0, -20.0)])
def test_a_box_at_rest_presses_below_its_mass_centre(place):
    """On a slope it sticks, and the centre of pressure is where the weight meets the plane."""
    slope = 0.3
    scene = resting(0.6, slope, place, integrator={"type": "moreau_jean"})
    table = scene.simulate(0.03)["samples"]
    s, c = np.sin(slope), np.cos(slope)
    mass_centre = np.array(place) + 0.1 * np.array((s, 0.0, c))
    below = mass_centre - np.array((0.0, 0.0, 0.1 / c))
    name = "box_contact"
    for row in range(len(table["time"])):
        centre, force, torque = (
            np.array([table[f"{name}.{what}_{axis}"][row] for axis in "xyz"])
            for what in ("centre_of_pressure", "force", "torque")
        )
        assert centre == pytest.approx(below, abs=1e-9)
        assert force == pytest.approx((0.0, 0.0, MASS * G), abs=1e-8)
        assert torque == pytest.approx(np.zeros(3), abs=1e-8)
    assert set(table[f"{name}.state"]) == {STICK}
    assert np.abs(table[f"{name}.gap"]).max() <= 1e-9
    assert table.column(f"{name}.centre_of_pressure_x").unit == "m"


def test_a_box_that_slides_or_flies_says_so():
    scene = resting(0.2, 0.3, integrator={"type": "moreau_jean"})
    table = scene.simulate(0.05)["samples"]
    assert set(table["box_contact.state"][1:]) == {SLIP}
    body = {**BOX["box"], "pose": {"xyz": [0.0, 0.0, 2.0]}}
    table = scene.with_(bodies={"box": body}).simulate(0.05)["samples"]
    assert set(table["box_contact.state"]) == {OPEN}
    assert (table["box_contact.force_z"] == 0.0).all()
    assert table["box_contact.gap"][0] == pytest.approx(1.9 * np.cos(0.3) - 0.3 * np.sin(0.3))


def test_arrows_and_cones_stand_where_the_contact_presses():
    """At rest the cone is as high as the weight; without forces it has no height."""
    scene = resting(0.6, offset=(5.0, 0.0, 1.0), integrator={"type": "moreau_jean"})
    robot = scene.robot
    showing = Showing(Kinematics(robot), RowLayout(scene.constraints))
    assert [one.name for one in showing.arrows] == ["box_contact.on_box", "box_contact.on_world"]
    assert {one.kind for one in showing.arrows} == {Kind.PLACED_WRENCH}
    assert showing.cones == ("box_contact.cone",)
    lam = np.zeros((4, 3))
    lam[:, 0] = MASS * G / 4.0
    for forces, height in ((lam.ravel(), MASS * G), (np.zeros(12), 0.0)):
        asked = scene.initial, np.zeros(0), np.zeros(6), forces
        (on_box, on_world), (cone,) = showing.wrenches(*asked), showing.cones_at(*asked)
        assert on_box.point + robot.origin == pytest.approx(cone.point + robot.origin)
        assert on_box.force == pytest.approx((0.0, 0.0, height))
        assert on_world.force == pytest.approx((0.0, 0.0, -height))
        assert cone.normal == pytest.approx((0.0, 0.0, height))
        assert cone.mu == (0.6 if height else 0.0)
    assert on_box.point + robot.origin == pytest.approx((4.7, -0.15, 1.0))  # the nearest of four


BALL = {"shape": {"sphere": 0.1}, "mass": 2.0}


def rolling(**more):
    """A ball that falls 0.2 m onto a plane with a spin: it bounces, slides and rolls."""
    return mbd.scene_from(
        {
            "bodies": {"ball": BALL},
            "contacts": [{"type": "rigid", "between": ["ball", "ground"], "friction": 0.3} | more],
            "initial": {
                "pose": {"ball": {"xyz": [0.0, 0.0, 0.3]}},
                "twist": {"ball": {"linear": [4.0, 0.0, 0.0]}},
            },
            "dt": 0.01,
        }
    )


def test_events_of_contacts_say_impulse_and_state():
    """The ball lands with 4 m/s; mu times the impulse slows it, then it rolls."""
    result = rolling().simulate(1.0, integrator="dop853")
    events, samples = result["events"], result["samples"]
    landing, begins_to_roll = events["ball_contact.state.after"].tolist()
    assert (landing, begins_to_roll) == (SLIP, STICK)
    assert events["ball_contact.state.before"].tolist() == [OPEN, SLIP]
    fall = np.sqrt(2.0 * 0.2 * G)
    assert events["ball_contact.normal.impulse"][0] == pytest.approx(2.0 * fall, rel=1e-9)
    along = (
        events["ball_contact.friction_x.impulse"][0],
        events["ball_contact.friction_y.impulse"][0],
    )
    assert np.hypot(*along) == pytest.approx(0.3 * 2.0 * fall, rel=1e-9)
    assert samples["ball_contact.state"][-1] == STICK
    rolled = 4.0 - 0.3 * (fall + G * (events["time"][1] - events["time"][0]))
    assert rolled == pytest.approx(4.0 * 5.0 / 7.0, rel=1e-11)  # of a homogeneous ball


def test_a_fault_of_free_bodies_alone_names_the_fastest():
    scene = resting()
    state = scene.initial._replace(v=np.array((0.0, -3.0, 1.0, 0.0, 0.0, 0.0)))
    text = last_finite(scene.without(["contacts"]).system(), state)
    assert "fastest free body box with -3/s; positions box 0, 0, 0.1" in text


@pytest.mark.parametrize(
    "friction",
    [{"creep": 0.02}, {"bristle_stiffness": 1e5, "bristle_damping": 300.0}],
    ids=["creep", "bristle"],
)
@pytest.mark.parametrize(("mu", "state"), [(0.5, STICK), (0.2, SLIP)])
def test_contacts_that_give_way_show_the_same(friction, mu, state):
    """On a slope of 0.3 rad friction holds the weight, or slips at its largest."""
    entry = {"type": "compliant", "stiffness": 1e5, "dissipation": 300.0, "friction": mu}
    scene = resting(slope=0.3)
    plane = scene.entries["contacts"][0]["between"]
    scene = scene.with_(contacts=[{**entry, **friction, "between": plane}], dt=1e-3)
    table = scene.simulate(0.25, integrator="rk4")["samples"]
    s, c = np.sin(0.3), np.cos(0.3)
    last = {name: values[-1] for name, values in table.items() if "box_contact." in name}
    last = {name.partition(".")[2]: value for name, value in last.items()}
    friction_force = MASS * G * (s if state == STICK else mu * c)
    assert last["state"] == state
    assert sum(last[f"point_{i}_normal"] for i in range(4)) == pytest.approx(MASS * G * c, 1e-6)
    along = [sum(last[f"point_{i}_friction_{axis}"] for i in range(4)) for axis in "xy"]
    assert np.hypot(*along) == pytest.approx(friction_force, rel=1e-6)
    force = np.array([last[f"force_{axis}"] for axis in "xyz"])
    assert force @ (s, 0.0, c) == pytest.approx(MASS * G * c, rel=1e-6)
    assert force @ (-c, 0.0, s) == pytest.approx(friction_force, rel=1e-6)
    assert -2e-4 < last["gap"] < 0.0


@pytest.mark.parametrize(
    ("contact", "topic"),
    [
        ("foot_contact", "~/contacts/foot_contact"),
        ("left/foot_contact", "~/contacts/left/foot_contact"),
        ("tip.1 contact#2", "~/contacts/tip_1_contact_2"),
        ("2nd", "~/contacts/_2nd"),
    ],
)
def test_contacts_have_topics_that_ros_accepts(contact, topic):
    assert topic_of(contact) == topic
    validate_full_topic_name(topic.replace("~", "/simulator"))
