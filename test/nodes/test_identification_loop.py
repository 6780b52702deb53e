"""Excitation, simulator, controller, recording, identification: the whole way over DDS."""

import numpy as np
import pytest
from identification_data import others, recording
from nodes.relay import started
from nodes.simulation_client import DEEP, QuickProbe, simulated
from places import ROOT
from sensor_msgs.msg import JointState

from mbd_ros.cli import main
from mbd_ros.core.model.inertial_parameters import parameters_of
from mbd_ros.features.identification.job import identify
from mbd_ros.features.identification.outcome import description_of
from mbd_ros.features.identification.problem import Problem
from mbd_ros.features.identification.task import Task
from mbd_ros.jobs.domain_claim import claimed_domain
from mbd_ros.scene.reader import load_scene
from msg_adapters.time import read_time

pytest.importorskip("clarabel", reason="clarabel is optional (extra: identification)")
pytestmark = [pytest.mark.alone, pytest.mark.soak]
PERIOD, RATE = 10.0, 250.0  # s, Hz
LEAD = 3.0  # s: the controller leads to where the motion begins
NOISE = np.array([0.6, 0.6, 0.4, 0.4, 0.2, 0.1, 0.05])  # N·m


def plant(folder, true):
    """Text of the simulated scene: other masses than the controller knows."""
    (folder / "true.urdf").write_text(description_of(true), encoding="utf-8")
    scene = (ROOT / "config/scenes/controlled_arm7.yaml").read_text(encoding="utf-8")
    return scene.replace("../robots/arm7.urdf", str(folder / "true.urdf"))


def recorded(folder, true, bag):
    """Joint states of the simulator while the controller follows a trajectory."""
    found = []
    with claimed_domain() as domain, QuickProbe(domain) as probe:
        probe.node.create_subscription(JointState, "/joint_states", found.append, DEEP)
        lock = {"lock_step": "true", "publish_clock": "true", "rate": RATE}
        scene = ROOT / "config/scenes/controlled_arm7.yaml"
        with simulated(domain, folder, plant(folder, true), **lock):
            values = {"scene": scene, "use_sim_time": "true", "error_limit": 0.0}
            to = ("-r", "~/commands:=/simulator/commands")
            lead = ("-r", "joint_trajectory:=/qp_controller/joint_trajectory")
            lead += ("-r", "state:=/qp_controller/state")
            nodes = [started(domain, folder, "qp_controller", to, **values)]
            try:
                nodes.append(
                    started(domain, folder, "reference_player", lead, bag=bag, use_sim_time="true")
                )
                probe.spin_until(lambda: found and found[-1].header.stamp.sec >= PERIOD + LEAD)
                assert all(node.stop() == 0 for node in reversed(nodes))
            finally:
                for node in nodes:
                    if node.process.poll() is None:
                        node.process.kill()
                        node.wait()
    return found


def test_an_arm_is_identified_from_a_controlled_run_with_noise(tmp_path):
    """Every base parameter within 3 of its deviations, which are as small as the noise lets."""
    scene = load_scene("arm7")
    true, out = others(scene), tmp_path / "excitation"
    words = ["--evaluations", "300", "--share", "0.7", "--period", str(PERIOD)]
    assert main(["excite", "arm7", "-o", str(out), *words]) == 0
    messages = recorded(tmp_path, true, out / "trajectory.mcap")
    names = list(messages[0].name)
    order = [names.index(name) for name in scene.couplings.independent]
    t = np.array([read_time(m.header.stamp) for m in messages]) * 1e-9
    t, first = np.unique(t, return_index=True)  # while the loop starts, states repeat
    fields = {
        field: np.array([getattr(messages[i], field) for i in first])[:, order]
        for field in ("position", "velocity", "effort")
    }
    fields["effort"] += NOISE * np.random.default_rng(0).normal(size=fields["effort"].shape)
    data = recording(scene.couplings.independent, t, **fields)
    found = identify(scene, data, learned=1.0)
    exact = Problem(scene, Task([data]), lambda line: None).base.values(
        parameters_of(true.robot.model).ravel()
    )
    table = found.tables["base_parameters"]
    off = np.abs(table["estimate"] - exact) / table["deviation"]
    assert (off < 3.0).all()
