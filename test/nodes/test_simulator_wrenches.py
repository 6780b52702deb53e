"""External loads of a live simulator, over DDS."""

import numpy as np
from geometry_msgs.msg import WrenchStamped
from nodes.simulation_client import DEEP, NAME, PENDULUM, simulated

from mbd_ros.api import load_scene
from mbd_ros.methods.simulation.live_simulation import LiveSimulation
from mbd_ros.methods.simulation.safe_command import CommandWatch
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.wrench import write_wrench

PUSHED = f"{PENDULUM}external_wrenches: {{gust: {{frame: rod, expressed_in: world}}}}\n"
LOAD = np.array([3.0, -1.0, 2.0, 0.2, 0.5, -0.1])
NOT_HEARD = "external wrenches not heard"
TICK, TIMEOUT = 0.01, 0.05


def test_a_wrench_acts_from_its_message_until_it_is_lost(domain, tmp_path):
    """Ticks are those of the same simulation in this process; a wrong frame changes nothing."""
    path = tmp_path / "local.yaml"
    path.write_text(PUSHED, encoding="utf-8")
    scene, watch = load_scene(path), CommandWatch(TIMEOUT, 0.03)
    commands = CommandWatch(TIMEOUT, 0.03)
    heard = [(scene.wrenches["gust"].u, watch)]
    live = LiveSimulation(scene.simulation, scene.initial, TICK, commands, scene.safe, heard)
    times = {"rate": 1 / TICK, "command_timeout": TIMEOUT, "safe_ramp": 0.03, "paused": "true"}
    with simulated(domain, tmp_path, PUSHED, **times) as client:
        topic = f"{NAME}/wrench/gust"
        publisher = client.probe.node.create_publisher(WrenchStamped, topic, DEEP)
        client.probe.spin_until(publisher.get_subscription_count)

        def send(frame, load):
            publisher.publish(write_wrench(WrenchStamped(), 1, frame, load))

        def health(done):
            return client.probe.wait_health(lambda h: h.name == NAME and done(h))

        assert health(lambda h: True).values[NOT_HEARD] == "gust"
        send("world", LOAD)
        assert health(lambda h: h.values[NOT_HEARD] == "none").level in (OK, WARN)
        send("rod", 9.0 * LOAD)
        client.node.wait_for("wrench 'gust': frame 'rod', expected 'world'")
        watch.take(LOAD)
        for _ in range(12):
            now, sample = live.tick(), client.step()
            np.testing.assert_allclose(sample.position, now.position, rtol=0, atol=1e-12)
            np.testing.assert_allclose(sample.velocity, now.velocity, rtol=0, atol=1e-12)
        assert watch.weight == 1.0  # lost, and given up without a jump
        lost = health(lambda h: "no wrench 'gust' for 0.12 s" in h.message)
        assert lost.level == WARN


def test_a_wrench_moves_what_it_pushes(tmp_path):
    path = tmp_path / "local.yaml"
    path.write_text(PUSHED, encoding="utf-8")
    scene, ends = load_scene(path), []
    for load in (np.zeros(6), LOAD):
        commands, watch = CommandWatch(1.0, 0.0), CommandWatch(1.0, 0.0)
        heard = [(scene.wrenches["gust"].u, watch)]
        live = LiveSimulation(scene.simulation, scene.initial, TICK, commands, scene.safe, heard)
        watch.take(load)
        commands.take(np.zeros(1))
        ends.append([live.tick().velocity[0] for _ in range(10)][-1])
    assert abs(ends[1] - ends[0]) > 0.01


def is_refused(publisher, node, frame):
    """Send a push on a frame; whether the node has named it: it may not hear the first one."""
    publisher.publish(write_wrench(WrenchStamped(), 1, frame, 9.0 * LOAD))
    return f"frame {frame} is no pushed link: rod" in node.log


def test_a_push_on_a_link_acts_as_the_load_of_that_link(domain, tmp_path):
    """Ticks are those of a scene with that load; a frame that cannot be pushed is named."""
    path = tmp_path / "local.yaml"
    path.write_text(PENDULUM + "external_wrenches: {push: {frame: rod}}\n", encoding="utf-8")
    scene, watch = load_scene(path), CommandWatch(TIMEOUT, 0.0)
    heard = [(scene.wrenches["push"].u, watch)]
    commands = CommandWatch(TIMEOUT, 0.0)
    live = LiveSimulation(scene.simulation, scene.initial, TICK, commands, scene.safe, heard)
    times = {"rate": 1 / TICK, "command_timeout": TIMEOUT, "safe_ramp": 0.0, "paused": "true"}
    with simulated(domain, tmp_path, PENDULUM, **times, pushed_links="['*']") as client:
        publisher = client.probe.node.create_publisher(WrenchStamped, f"{NAME}/push", DEEP)
        client.probe.spin_until(publisher.get_subscription_count)
        client.probe.spin_until(lambda: is_refused(publisher, client.node, "bar"))
        publisher.publish(write_wrench(WrenchStamped(), 1, "rod", LOAD))
        client.probe.state(NAME)  # handled
        watch.take(LOAD)
        for _ in range(8):
            now, sample = live.tick(), client.step()
            np.testing.assert_allclose(sample.velocity, now.velocity, rtol=0, atol=1e-12)
        assert watch.weight == 1.0
