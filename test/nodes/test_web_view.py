"""The node `web_view` over DDS and websockets: what a page is told, and what it asks for."""

import math
import re
import signal
import time
from collections import Counter

import numpy as np
import pytest
from deadline import until
from geometry_msgs.msg import Point, WrenchStamped
from nodes.joint_stream import ACTIVE
from places import ROOT
from sensor_msgs.msg import JointState
from visualization_msgs.msg import Marker, MarkerArray

pytest.importorskip("viser", reason="viser is not installed")

from nodes.page_client import PageClient
from viser import _messages
from web_view import free_port
from websockets.exceptions import InvalidStatus

from mbd_ros.scene.reader import load_scene
from msg_adapters.wrench import read_wrench, write_wrench

NAME = "/web_view"
TARGET = ("-m", "mbd_ros.nodes", "web_view")
ARM = ROOT / "config/scenes/arm7.yaml"
JOINTS = [f"joint{i}" for i in range(1, 8)]


@pytest.fixture
def view(start_node):
    """Starts a node with parameters; the node and the address of its page."""

    def start(scene=ARM, **values):
        port = free_port()
        lines = "".join(f"    {name}: {value}\n" for name, value in values.items())
        text = f"/**:\n  ros__parameters:\n    scene: {scene}\n    port: {port}\n{lines}"
        node = start_node(text, target=TARGET)
        node.wait_for(ACTIVE)
        return node, f"http://127.0.0.1:{port}"

    return start


class Streams:
    """Joint states of some robots at 500 Hz."""

    def __init__(self, probe, topics):
        self._probe = probe
        self._topics = [probe.node.create_publisher(JointState, topic, 10) for topic in topics]
        self._message, self.sent = JointState(name=JOINTS), 0
        for topic in self._topics:
            probe.spin_until(topic.get_subscription_count)

    def publish(self, message):
        """One message to all."""
        for topic in self._topics:
            topic.publish(message)

    def run(self, seconds):
        """Publish for so many seconds."""
        end, due = time.monotonic() + seconds, time.monotonic()
        while (now := time.monotonic()) < end:
            self.sent += 1
            self._message.header.stamp = self._probe.node.get_clock().now().to_msg()
            angle = 0.5 * np.sin(2.0 * self.sent / 500.0)
            self._message.position = [angle] * len(JOINTS)
            self.publish(self._message)
            due = max(due + 0.002, now)
            self._probe.spin_for(max(0.0, due - time.monotonic()))


def titles(page):
    """What the robots of a page are called."""
    return [m["props"]["text"] for key, m in page.state.items() if key[0] == "LabelMessage"]


def turned(messages):
    """Joint of the page -> how often it was turned."""
    return Counter(m["name"] for m in messages if m["type"] == "SetOrientationMessage")


def test_robots_by_namespace_get_thirty_frames_a_second_and_a_sleeping_browser_costs_nothing(
    view, probe
):
    _, address = view(namespaces="[left, right]")
    streams = Streams(probe, ["/left/joint_states", "/right/joint_states"])
    sleeping = PageClient(address)  # never reads
    begin, page, counts = time.monotonic(), PageClient(address), Counter()
    until(lambda: page.hear(0.05) and len(titles(page)) == 2)
    assert titles(page) == ["left", "right"]

    def are_drawn():
        streams.run(0.2)
        counts.update(turned(page.hear(0.05)))
        return {name[:2] for name in counts} == {"/0", "/1"} and min(counts.values()) > 60

    until(are_drawn)
    assert max(counts.values()) <= 1.0 + 30.0 * (time.monotonic() - begin)
    page.close()
    sleeping.socket.socket.close()


def test_another_address_asks_for_a_token_before_anything_is_sent(view):
    node, address = view(host="0.0.0.0", origins="['https://robots.example']")
    token = node.log.partition("/?token=")[2].split()[0]
    for refused in (address, f"{address}/?token=other", f"{address}/?token="):
        with pytest.raises(InvalidStatus, match="401"):
            PageClient(refused)
    with pytest.raises(InvalidStatus, match="403"):
        PageClient(f"{address}/?token={token}", origin="http://elsewhere.example")
    for origin in (None, address, "https://robots.example"):
        page = PageClient(f"{address}/?token={token}", origin=origin)
        page.labelled("state")
        page.close()
    assert node.stop(signal.SIGTERM) == 0
    assert "Traceback" not in node.log


def test_a_target_is_reached_by_the_reference_that_the_controller_gets(view, probe):
    """Forward kinematics of the reference put the led link where its handle was dragged."""
    import pinocchio as pin

    scene = load_scene(ARM)
    heard = []
    probe.node.create_subscription(JointState, "/my_controller/reference", heard.append, 10)
    _, address = view()
    probe.meet(NAME)
    page = PageClient(address)
    page.set("joint", "joint6")
    page.set("target of the joint", True)
    page.wait_for(lambda m: m["type"] == "TransformControlsMessage")
    until(lambda: ("SetPositionMessage", "/handle") in page.state or page.hear(0.05) is None)
    start = np.array(page.state["SetPositionMessage", "/handle"]["position"])
    wanted = start + np.array([-0.1, 0.15, -0.1])
    turn = (1.0, 0.0, 0.0, 0.0)
    page.say(_messages.TransformControlsUpdateMessage("/handle", turn, tuple(wanted)))
    probe.spin_until(lambda: heard)
    model, data = scene.robot.model, pin.Data(scene.robot.model)
    pin.forwardKinematics(model, data, scene.initial.q)
    held = data.oMi[6].actInv(start)

    def missed():
        pin.forwardKinematics(model, data, np.array(heard[-1].position))
        return np.linalg.norm(data.oMi[6].act(held) - wanted)

    probe.spin_until(lambda: missed() < 1e-4)
    assert heard[-1].name == JOINTS
    page.close()


def test_what_topics_tell_is_on_the_page_and_a_pull_is_the_wrench_of_the_scene(
    view, probe, tmp_path
):
    """The pull is a force at the place that was taken, about the origin of the world."""
    scene = tmp_path / "loaded.yaml"
    load = "external_wrenches: {hand: {frame: link7, expressed_in: world}}\n"
    scene.write_text(f"robot: {{urdf: {ROOT}/config/robots/arm7.urdf}}\n{load}")
    _, address = view(scene)
    page = PageClient(address)
    create = probe.node.create_publisher
    torques = create(JointState, "/inverse_dynamics/joint_torques", 10)
    markers = create(MarkerArray, "/markers", 10)
    loads = create(WrenchStamped, "/simulator/wrench/hand", 10)
    for publisher in (torques, markers, loads):
        probe.spin_until(publisher.get_subscription_count)
    streams = Streams(probe, ["/joint_states"])
    page.set("joint", "joint6")
    page.set("quantity", "torque")

    def tell():
        torques.publish(JointState(name=JOINTS, effort=[0.25] * 7))
        marker = Marker(type=Marker.SPHERE)
        marker.pose.position.z = 2.0
        markers.publish(MarkerArray(markers=[marker]))
        loads.publish(write_wrench(WrenchStamped(), 1, "world", np.arange(6.0)))
        streams.run(0.1)
        page.hear(0.1)

    def is_shown():
        tell()
        said = str(page.state)
        drawn = {key[1] for key in page.state}
        return {"/0/points", "/0/forces"} <= drawn and "torque 0.25 N·m" in said

    probe.spin_until(is_shown)
    probe.spin_until(lambda: tell() or "/web_view: ok shown" in str(page.state))

    heard = []
    probe.node.create_subscription(WrenchStamped, "/simulator/wrench/hand", heard.append, 10)
    solid = next(key[1] for key in page.state if re.fullmatch("/0/7/[0-9]+", key[1]))
    streams.publish(JointState(name=JOINTS, position=[0.0] * 7))
    probe.meet(NAME)  # it has heard that
    page.hear(0.3)
    taken, pointer = np.array([0.0, 0.02, 1.2]), np.array([0.3, 0.02, 1.3])
    middle = (0.5, 0.5)
    for phase in ("start", "update"):
        places = (tuple(taken), middle, tuple(pointer), middle)
        drag = _messages.SceneNodeDragMessage(phase, solid, None, *places, "left", "shift")
        page.say(drag)
    probe.spin_until(lambda: [m for m in heard if m.wrench.force.x > 0.0 and m.wrench.torque.y])
    got = read_wrench(heard[-1])
    assert got.frame_id == "world"
    force, torque = got.wrench[:3], got.wrench[3:]
    np.testing.assert_allclose(np.cross(force, pointer - taken), 0.0, atol=1e-6)
    np.testing.assert_allclose(torque, np.cross(taken, force), rtol=1e-5, atol=1e-6)
    page.say(_messages.SceneNodeDragMessage("end", solid, None, *places, "left", "shift"))
    probe.spin_until(lambda: not read_wrench(heard[-1]).wrench.any())
    page.close()


def test_hostile_messages_and_browsers_leave_a_page_that_draws(view, probe):
    node, address = view()
    hostile, page = PageClient(address), PageClient(address)
    hostile.set("target of the joint", True)
    hostile.set("joint", "joint6")
    hostile.wait_for(lambda m: m["type"] == "TransformControlsMessage")
    for label in ("joint", "quantity", "follow", "time", "scale of arrows", "strength"):
        for value in ("nothing", math.nan, math.inf, -1e300, [1], None):
            hostile.set(label, value)
    hostile.set("real-time factor", math.nan)
    far, turn, nowhere = (math.inf, math.nan, 1e300), (0.0,) * 4, (0.5, 0.5)
    solid = next(key[1] for key in hostile.state if re.fullmatch("/0/6/[0-9]+", key[1]))
    for phase in ("update", "start", "update"):
        places = (far, nowhere, far, nowhere)
        drag = _messages.SceneNodeDragMessage(phase, solid, None, *places, "left", "shift")
        hostile.say(drag)
    hostile.say(_messages.TransformControlsUpdateMessage("/handle", turn, far))
    hostile.say(_messages.TransformControlsUpdateMessage("/handle", turn, (1e9, -1e9, 1e9)))
    streams = Streams(probe, ["/joint_states"])
    markers = probe.node.create_publisher(MarkerArray, "/markers", 10)
    probe.spin_until(markers.get_subscription_count)
    far_away = Marker(type=Marker.POINTS, points=[Point(x=math.nan), Point(y=1e308)])
    markers.publish(MarkerArray(markers=[far_away, Marker(type=77), Marker(type=Marker.ARROW)]))
    bad = JointState(name=JOINTS, position=[math.nan, math.inf, 1e300, 0.0, 0.0, 0.0, 0.1])
    streams.publish(bad)
    streams.publish(JointState(name=JOINTS, position=[0.0]))
    hostile.socket.send(b"\x00" * 100)
    streams.run(0.5)
    page.hear(0.3)
    until(lambda: streams.run(0.1) or turned(page.hear(0.1)))
    assert node.process.poll() is None
    assert node.stop() == 0


def test_bad_parameters_are_named(view, start_node):
    for lines, said in (
        ("namespaces: ['a b']", "is no namespace"),
        ("offsets: [1.0]", "parameter 'offsets' has 1 numbers"),
        ("host: 192.0.2.1", "host '192.0.2.1', port 8080"),
    ):
        text = f"/**:\n  ros__parameters:\n    scene: {ARM}\n    {lines}\n"
        node = start_node(text, target=TARGET)
        node.wait_for(said)
        assert node.stop() == 0
