"""Ten minutes of closed loop at 500 Hz: `make soak`."""

import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from nodes.control_client import POSE, controlled
from nodes.simulation_client import ARM, JOINTS, NAME, simulated
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

pytestmark = pytest.mark.alone

RATE = 500.0
SWING = np.array([0.3, 0.2, 0.3, 0.2])


def swinging(seconds, begin):
    """A slow sine about POSE, for that long; `begin` is the stamp of its first point [ns]."""
    message = JointTrajectory(joint_names=list(JOINTS))
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(begin, 1_000_000_000)
    for t in np.arange(0.0, seconds, 0.25):
        w = 2 * np.pi * np.array([0.2, 0.3, 0.25, 0.35])
        point = JointTrajectoryPoint(
            positions=(POSE + SWING * np.sin(w * t)).tolist(),
            velocities=(SWING * w * np.cos(w * t)).tolist(),
            accelerations=(-SWING * w**2 * np.sin(w * t)).tolist(),
        )
        whole, part = divmod(round(t * 1e9), 1_000_000_000)
        point.time_from_start.sec, point.time_from_start.nanosec = whole, part
        message.points.append(point)
    return message


def memory(node):
    """Resident memory of a process [MB]."""
    pages = int(Path(f"/proc/{node.pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


@pytest.mark.soak
@pytest.mark.parametrize("seconds", [600.0])
def test_closed_loop_for_long(domain, tmp_path, seconds):
    """No missed watchdog, no growth of memory beyond 5 MB after the first minute."""
    (folder := tmp_path / "simulator").mkdir()
    (other := tmp_path / "controller").mkdir()
    with simulated(domain, folder, ARM, rate=RATE, marker_rate=0.0) as plant:
        plant.probe.node.destroy_publisher(plant._vectors)
        with controlled(domain, other, plant=NAME, timeout=0.1) as client:
            client.probe.spin_until(lambda: client.states)
            client.lead(swinging(seconds + 5.0, client.states[-1].stamp + 500_000_000))
            start, nodes = time.perf_counter(), (plant.node, client.node)
            used, answered, latencies, worst = [], 0, [], 0.0
            while time.perf_counter() - start < seconds:
                del plant.states[:-1], plant.arrivals[:-1]
                first = time.perf_counter()
                client.states.clear()
                client.commands.clear()
                client.arrivals.clear()
                plant.probe.spin_for(0.0)
                client.probe.spin_for(5.0)
                plant.probe.spin_for(0.01)
                answered += len(client.states)
                rate = len(client.states) / (time.perf_counter() - first)
                errors = np.abs([state.position for state in client.states])
                if time.perf_counter() - start > 10.0:
                    worst = max(worst, errors.max())
                client.assert_finite()
                used.append([memory(node) for node in nodes])
                latencies.append(rate)
            health = client.wait_health(lambda h: h.message == "controlling")
            taken = min(12, len(used) // 2)
            growth = np.max(used[taken:], axis=0) - used[taken]
            sys.stdout.write(
                f"{answered} states answered, {np.mean(latencies):.1f}/s; largest error "
                f"{1e3 * worst:.3g} mrad; memory {used[taken]} MB, growth {growth} MB\n"
            )
            assert health.values["times gone safe"] == "0"
            assert health.values["updates without an answer of the law"] == "0"
            assert (growth < 5.0).all()
            assert np.mean(latencies) == pytest.approx(RATE, rel=0.01)
            assert worst < 5e-3
