"""`mbd-ros demo` that is stopped, loses a node or is disturbed by others."""

import os
import re
import signal
import subprocess
from pathlib import Path

import pytest
import rclpy
from deadline import DEADLINE, until
from nodes.demo_command import command
from nodes.probe import Probe
from rclpy.context import Context
from rosgraph_msgs.msg import Clock

from mbd_ros.applications.demo.loop import CLASSES, DIAGNOSTICS, Recorder
from mbd_ros.applications.demo.processes import Failed
from mbd_ros.jobs.isolated_domain import isolated_domain
from msg_adapters.time import read_time

DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"


def children(pid):
    """Processes of the demo by node."""
    found = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    names = [Path(f"/proc/{child}/cmdline").read_bytes().decode() for child in found]
    nodes = [re.search(r"mbd_ros\.nodes\0(\w+)", name) for name in names]
    return {node[1]: int(child) for node, child in zip(nodes, found, strict=True) if node}


def wait_until_time_runs(pid):
    """Until the simulator of a demo, a process, has come to 0.1 s."""
    domain = re.search(rb"\0ROS_DOMAIN_ID=(\d+)", Path(f"/proc/{pid}/environ").read_bytes())
    shown = []
    with Probe(int(domain[1])) as probe:
        probe.node.create_subscription(Clock, "/clock", shown.append, 1)
        probe.spin_until(lambda: shown and read_time(shown[-1].clock) > 100_000_000)


def interrupted(tmp_path, act):
    """Exit code and stderr of a demo to which something happens while it runs."""
    line, environment = command("--time", 60, "-o", tmp_path / "out")
    with subprocess.Popen(
        line,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as running:
        until(lambda: running.poll() is not None or len(children(running.pid)) == 3)
        nodes = children(running.pid)
        wait_until_time_runs(nodes["simulator"])
        act(running.pid, nodes)
        said = running.stderr.read()
        code = running.wait(DEADLINE)
    assert not any(Path(f"/proc/{pid}").exists() for pid in nodes.values())
    assert list(tmp_path.iterdir()) == []
    assert "Traceback" not in said
    return code, said


@pytest.mark.parametrize("how", ["terminal", pytest.param("terminate", marks=pytest.mark.soak)])
def test_a_signal_leaves_neither_folder_nor_process(tmp_path, how):
    """A terminal sends Ctrl-C to the nodes as well; `kill` only to the command."""

    def act(pid, nodes):
        if how == "terminal":
            os.killpg(pid, signal.SIGINT)
        else:
            os.kill(pid, signal.SIGTERM)

    assert interrupted(tmp_path, act) == (130, "interrupted\n")


def test_a_node_that_dies_is_1_and_leaves_nothing(tmp_path):
    code, said = interrupted(
        tmp_path, lambda _, nodes: os.kill(nodes["simulator"], signal.SIGKILL)
    )
    assert code == 1
    assert said.startswith("mbd-ros demo: node simulator ended with exit code -9")


@pytest.mark.parametrize("topic", ["/joint_states", DIAGNOSTICS])
def test_what_another_program_publishes_is_no_recording(topic):
    """It was not there when the domain was chosen: the recording fails, and says why."""
    types = {"/joint_states": "sensor_msgs/msg/JointState", DIAGNOSTICS: DIAGNOSTIC_ARRAY}
    with isolated_domain():
        recorder = Recorder(types, lambda: None, nodes=2)
        kind, count = CLASSES[types[topic]], 2 if topic == DIAGNOSTICS else 1
        own = [recorder.node.create_publisher(kind, topic, 1) for _ in range(count)]
        recorder.wait(lambda: all(p.get_subscription_count() for p in own), "own publishers")
        recorder.spin(0.1)
        other = Context()
        rclpy.init(context=other, domain_id=recorder.node.context.get_domain_id())
        stranger = rclpy.create_node("stranger", context=other)
        stranger.create_publisher(kind, topic, 1)
        with pytest.raises(Failed, match=f"{topic}: another program publishes it"):
            recorder.wait(lambda: False, "a stranger")
        stranger.destroy_node()
        rclpy.shutdown(context=other)
        recorder.close()
