"""The node `inverse_dynamics` with powers, and on feet without force plates."""

import numpy as np
import pytest
from mechanisms import joint, link, urdf
from nodes.joint_stream import DEEP, MS, SCENES, live
from std_msgs.msg import Float64MultiArray, String

from mbd_ros.jobs.domain_claim import claimed_domain
from mbd_ros.methods.inverse_dynamics.power import ObservedPower
from mbd_ros.nodes.shell.robot_description import LATCHED

G = 9.81
HOPPER = urdf(
    *(link("world"), link("rail"), link("trunk", 5.0, (0.0, 0.0, 0.1), (0.1, 0.1, 0.1))),
    *(link("thigh", 1.0, (0, 0, -0.2), (0.01,) * 3), link("foot", 0.5, (0, 0, -0.2), (0.01,) * 3)),
    joint("x", "prismatic", "world", "rail", (1, 0, 0)),
    joint("z", "prismatic", "rail", "trunk", (0, 0, 1)),
    joint("hip", "revolute", "trunk", "thigh", (0, 1, 0)),
    joint("knee", "revolute", "thigh", "foot", (0, 1, 0), (0.0, 0.0, -0.4)),
)
SCENE = """robot: {urdf: hopper.urdf}
actuators: [{type: ideal, joints: [hip, knee]}]
contacts:
- type: rigid
  name: toe
  between: [{frame: foot, points: [[0, 0, -0.4]]}, ground]
  friction: 0.8
"""
PHASES = """phases:
  stance: {contacts: [toe], until: {late: {time: 1.0}}, then: flight}
  flight: {contacts: [], until: {late: {time: 1.0}}, then: stance}
"""
HIP = 0.3  # rad; the knee bends back twice as far, so that the toe is below the hip


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    folder = tmp_path_factory.mktemp("power")
    scene = SCENES / "prosthetic_leg.yaml"
    with claimed_domain() as own, live(own, folder, scene, power="true") as stream:
        yield stream


@pytest.fixture(scope="module")
def hopper(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stance")
    (folder / "hopper.urdf").write_text(HOPPER, encoding="utf-8")
    (folder / "hopper.yaml").write_text(SCENE + PHASES, encoding="utf-8")
    asked = {"stance": "minimum-norm", "phase_topic": "/phase", "power": "true"}
    with claimed_domain() as own, live(own, folder, folder / "hopper.yaml", **asked) as stream:
        yield stream


def powers(stream):
    """Messages of the topic, as they come."""
    found = []
    topic = f"{stream.name}/power"
    stream.kept = stream.probe.node.create_subscription(
        Float64MultiArray, topic, found.append, DEEP
    )
    stream.probe.spin_until(stream.kept.get_publisher_count)
    stream.probe.spin_until(lambda: stream.kept.get_publisher_count())
    return found


def named(message):
    return dict(zip([one.label for one in message.layout.dim], message.data, strict=True))


def test_powers_come_with_every_joint_state_at_500_hz(arm):
    """By name, as the same code gives them in one process; sums balance."""
    found, count = powers(arm), 60
    arm.reset()
    for k in range(count):
        arm.send(0.2 * k)  # 2 ms
    arm.probe.spin_until(lambda: len(found) >= count)
    assert len(found) == count
    scene, solver = arm.scene, arm.scene.inverse_dynamics()
    power = ObservedPower(scene.robot, solver, scene.wrenches, scene.forces_without_input)
    q, still = arm.position(0.2 * (count - 1)), np.zeros(len(arm.joints))
    expected = power.values(q, arm.speed, still, solver.solve(q, arm.speed, still))
    last = named(found[-1])
    assert list(last) == [output.name for output in power.outputs]
    np.testing.assert_allclose(list(last.values()), expected, rtol=1e-9, atol=1e-7)
    assert abs(last["power.residual"]) <= 1e-9 < abs(last["power.gravity"])
    assert {"hip_flexion.power", "shank.proximal_power", "knee_slide_x.coupling_power"} <= {*last}


def stand(hopper, k, height):
    """A sample of the hopper with its toe at a height."""
    bent = 2.0 * 0.4 * np.cos(HIP)
    position = {"x": 0.1, "z": bent + height, "hip": HIP, "knee": -2.0 * HIP}
    values = [position[name] for name in hopper.joints]
    return hopper.message(k, position=values, velocity=np.zeros(4))


def test_a_foot_without_a_plate_carries_the_robot_live(hopper):
    """Statics: the knee holds the weight of all above it less that of the shank's lever."""
    found = powers(hopper)
    hopper.reset()
    for k in range(5):
        hopper.publish(stand(hopper, k, 0.0))
    torques = hopper.answers(5)[-1]
    effort = dict(zip(torques.name, torques.effort, strict=True))
    hopper.probe.spin_until(lambda: len(hopper.forces) >= 5 and len(found) >= 5)
    forces = dict(zip(hopper.forces[-1].name, hopper.forces[-1].effort, strict=True))
    weight, side = 6.5 * G, 0.4 * np.sin(HIP)
    assert forces["toe.normal"] == pytest.approx(weight, abs=1e-9)
    assert abs(effort["knee"]) == pytest.approx(side * (weight - 0.25 * G), abs=1e-9)
    assert effort["z"] == pytest.approx(0.0, abs=1e-9)  # what nothing carries
    assert named(found[-1])["power.residual"] == pytest.approx(0.0, abs=1e-9)
    health = hopper.probe.wait_health(lambda h: h.values.get("on the ground") == "toe")
    assert "contacts of unknown force" not in health.values
    hopper.reset(hopper.begin + 100 * MS)
    for k in range(3):
        hopper.publish(stand(hopper, k, 0.1))
    torques = hopper.answers(3)[-1]
    effort = dict(zip(torques.name, torques.effort, strict=True))
    assert effort["z"] == pytest.approx(weight, abs=1e-9)  # it flies, and would have to fall
    hopper.probe.wait_health(lambda h: h.values.get("on the ground") == "none")


def test_the_newest_phase_says_what_is_on_the_ground(hopper):
    """In flight nothing carries the robot, its toe at the floor; a wrong name changes nothing."""
    create, spin = hopper.probe.node.create_publisher, hopper.probe.spin_until
    phase = create(String, "/phase", LATCHED)
    spin(phase.get_subscription_count)
    said = ("flight", "none", 6.5 * G), ("stance", "toe", 0.0), ("leap", "toe", 0.0)
    for name, ground, lacking in said:
        phase.publish(String(data=name))
        hopper.reset(hopper.begin + 1000 * MS)

        hopper.publish(stand(hopper, 0, 0.0))
        hopper.probe.wait_health(lambda h, ground=ground: h.values.get("on the ground") == ground)
        hopper.publish(stand(hopper, 1, 0.0))
        torques = hopper.answers(2)[-1]
        effort = dict(zip(torques.name, torques.effort, strict=True))
        assert effort["z"] == pytest.approx(lacking, abs=1e-9)
    hopper.probe.wait_health(lambda h: int(h.values.get("dropped.phase", "0")) >= 1)
