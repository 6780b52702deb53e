"""Contacts of a live simulator over DDS: forces, states, markers, and the bits of a run."""

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from nodes.simulation_client import DEEP, NAME, simulated
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import Marker, MarkerArray

import mbd_ros as mbd
from mbd_ros.core.geometry.contact_outputs import OPEN, SLIP, STICK
from mbd_ros.files.table import Column, Result, Table
from msg_adapters.time import read_time
from msg_adapters.wrench import read_wrench

MASS, MU, RADIUS, TICK, COUNT = 2.5, 0.4, 0.05, 0.01, 60
FAR = (120.0, -40.0, 0.0)  # of the first joint, from the origin
JOINTS = "xyz"
URDF = """<robot name="r"><link name="world"/>{links}{joints}</robot>"""
LINK = """<link name="{name}"><inertial><mass value="{mass}"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{name}" type="prismatic"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{at}"/><axis xyz="{axis}"/><limit lower="-9" upper="9" effort="99" velocity="9"/>
</joint>"""
SCENE = f"""robot: {{urdf: ball.urdf}}
actuators: [{{type: ideal, joints: [x, y, z]}}]
contacts:
- {{type: rigid, between: [{{frame: ball, SHAPE}}, ground], friction: {MU}}}
initial: {{position: {{z: 0.1}}}}
dt: {TICK}
"""


def urdf():
    """A ball that slides along x, y and z."""
    chain = ("world", "a", "b", "ball")
    links = "".join(
        LINK.format(name=name, mass=mass)
        for name, mass in zip(chain[1:], (1e-3, 1e-3, MASS), strict=True)
    )
    places = (" ".join(map(str, FAR)), "0 0 0", "0 0 0")
    rows = zip(JOINTS, chain, chain[1:], places, ("1 0 0", "0 1 0", "0 0 1"), strict=False)
    joints = "".join(
        JOINT.format(name=name, parent=a, child=b, at=at, axis=axis)
        for name, a, b, at, axis in rows
    )
    return URDF.format(links=links, joints=joints)


def commands():
    """A push along the ground that friction holds at first, then not, then again."""
    t = TICK * np.arange(COUNT)
    push = np.where(t < 0.25, 3.0, 0.0) + np.where((t >= 0.25) & (t < 0.35), 18.0, 0.0)
    return np.column_stack((push, 0.5 * push, np.zeros(COUNT)))


def offline(folder, text):
    """The samples of a run under the same commands."""
    path = folder / "offline.yaml"
    path.write_text(text, encoding="utf-8")
    columns = [Column("time", TICK * np.arange(COUNT))]
    columns += [Column(f"{n}.command", u) for n, u in zip(JOINTS, commands().T, strict=True)]
    given = Result({"samples": Table(columns)})
    return mbd.load_scene(path).simulate(COUNT * TICK, efforts=given)["samples"]


FEET = f"points: {[[x, y, -RADIUS] for x in (-0.1, 0.1) for y in (-0.2, 0.2)]}"


@pytest.mark.parametrize(
    ("method", "shape"),
    [("rk4", f"sphere: {RADIUS}"), ("moreau_jean", FEET)],
    ids=["rk4", "moreau_jean"],
)
def test_contacts_in_lock_step_are_those_of_a_run(domain, tmp_path, method, shape):
    """Joint states and outputs have the bits of the run; the wrench is that of its multipliers.

    Four feet of a link that does not turn share its weight: one of them is enough.
    """
    (tmp_path / "ball.urdf").write_text(urdf(), encoding="utf-8")
    text = f"{SCENE}integrator: {{type: {method}}}\n".replace("SHAPE", shape)
    expected = offline(tmp_path, text)
    given = {"rate": 1 / TICK, "lock_step": "true", "publish_clock": "true"}
    with simulated(domain, tmp_path, text, **given, marker_rate=1000.0) as client:
        heard = {}
        for kind, topic in (
            (WrenchStamped, "contacts/ball_contact"),
            (Float64MultiArray, "outputs"),
            (MarkerArray, "markers"),
        ):
            heard[topic] = []
            listen = client.probe.node.create_subscription
            topic_of = listen(kind, f"{NAME}/{topic}", heard[topic].append, DEEP)
            client.probe.spin_until(topic_of.get_publisher_count)
        client.repeat(client.reset, lambda: all(heard.values()))
        client.settle()
        heard["outputs"].clear()
        for k, u in enumerate(commands(), 1):
            client.command(u)
            due = round(k * TICK * 1e9)
            client.probe.spin_until(lambda due=due: client.newest.stamp == due)
            sample = client.newest
            for i, name in enumerate(JOINTS):
                assert sample.position[i] == expected[f"{name}.position"][k]
                assert sample.velocity[i] == expected[f"{name}.velocity"][k]
        client.probe.spin_until(lambda: len(heard["outputs"]) == COUNT)
        health = client.probe.wait_health(lambda h: "stick" in h.values.get("contacts", ""))
        assert_outputs(heard["outputs"], expected)
        assert_wrenches(heard["contacts/ball_contact"], expected)
        assert_drawn(heard["markers"][-1], expected)
        assert health.values["contacts"].startswith("ball_contact stick, gap ")
        assert health.values["smallest gap"].endswith(" m, ball_contact")
        if method == "moreau_jean":
            worst = max(float(expected[name].max()) for name in expected if "residual" in name)
            name, number, unit = health.values["worst contact residual"].split()
            assert name in ("primal", "dual", "cone", "correction") and unit in ("m/s", "N·s")
            assert 0.0 <= float(number) <= max(worst * 1.1, 1e-300) <= 1e-8
            assert len(health.values["contact residuals"].split(", ")) == 4


def assert_outputs(messages, expected):
    labels = [dimension.label for dimension in messages[0].layout.dim]
    shown = np.array([message.data for message in messages])
    same = np.ones(COUNT, dtype=bool)  # a live state shows forces of the command that ends there
    same[:-1] = (np.diff(commands(), axis=0) == 0.0).all(axis=1)
    for label, values in zip(labels, shown.T, strict=True):
        assert (values == expected[label][1:])[same].all(), label
    assert {"ball_contact.gap", "ball_contact.state"} <= {*labels}
    assert set(expected["ball_contact.state"]) == {OPEN, SLIP, STICK}
    presses = expected["ball_contact.state"] != OPEN
    centre = expected["ball_contact.centre_of_pressure_x"][presses]
    assert centre == pytest.approx(FAR[0] + expected["x.position"][presses], abs=1e-9)


def assert_wrenches(messages, expected):
    """On the ball, about its centre: friction has the moment of its lever."""
    stamps, seen = [round(t * 1e9) for t in expected["time"]], 0
    rows = {read_time(message.header.stamp): read_wrench(message) for message in messages}
    for k, stamp in enumerate(stamps[1:], 1):
        if stamp in rows:
            seen += 1
        if stamp in rows and (k == COUNT or (commands()[k] == commands()[k - 1]).all()):
            frame, wrench = rows[stamp].frame_id, rows[stamp].wrench
            force = [expected[f"ball_contact.force_{axis}"][k] for axis in JOINTS]
            assert frame == "ball"
            assert wrench[:3] == pytest.approx(force, abs=1e-9)
            moment = np.cross((0.0, 0.0, -RADIUS), force)
            assert wrench[3:] == pytest.approx(moment, abs=1e-9)
    assert seen == COUNT


def assert_drawn(message, expected):
    """Arrows begin where the ball touches, and so does the cone, as high as the normal force."""
    on_ball, on_world, cone = message.markers
    assert [m.ns for m in message.markers] == [
        f"ball_contact.{what}" for what in ("on_ball", "on_world", "cone")
    ]
    assert (on_ball.type, cone.type) == (Marker.ARROW, Marker.TRIANGLE_LIST)
    touched = [expected[f"ball_contact.centre_of_pressure_{axis}"][-1] for axis in JOINTS]
    tail, position = on_ball.points[0], cone.pose.position
    assert [tail.x, tail.y, tail.z] == pytest.approx(touched, abs=1e-9)
    assert [position.x, position.y, position.z] == pytest.approx(touched, abs=1e-9)
    assert cone.scale.z == pytest.approx(0.002 * expected["ball_contact.force_z"][-1])
    assert cone.scale.x == pytest.approx(MU * cone.scale.z)
    assert on_world.points[1].z < tail.z
