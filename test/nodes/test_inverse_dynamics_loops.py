"""The node `inverse_dynamics` on a leg whose knee is a loop."""

import numpy as np
import pytest
from inverse_dynamics_streams import motion, offline, play
from nodes.joint_stream import SCENES, live
from sensor_msgs.msg import JointState

from mbd_ros.jobs.domain_claim import claimed_domain
from msg_adapters.diagnostics import WARN
from msg_adapters.joint_state import write_joint_state

ACTUATORS = "actuators: [{type: ideal, joints: [hip_flexion, knee_anterior, ankle]}]\n"


@pytest.fixture(scope="module")
def leg(tmp_path_factory):
    folder = tmp_path_factory.mktemp("leg")
    text = (SCENES / "four_bar_leg.yaml").read_text(encoding="utf-8") + ACTUATORS
    scene = folder / "leg.yaml"
    scene.write_text(text.replace("../robots", str(SCENES.parent / "robots")), encoding="utf-8")
    with claimed_domain() as own, live(own, folder, scene) as stream:
        yield stream


def swing(leg, count):
    """Offsets [ns], positions and velocities as measured: on the loop but for 0.1 mrad."""
    offsets, q, v = motion(count, 3)
    loops, robot = leg.scene.closed_loop().motion, leg.scene.robot
    known = [robot.joint(name).v for name in ("hip_flexion", "knee_posterior", "ankle")]
    measured, random = np.zeros(5, dtype=bool), np.random.default_rng(3)
    measured[known] = True
    before, rows = loops.assemble(leg.scene.initial), []
    for angles, rates in zip(q - 0.3, v, strict=True):
        x = leg.scene.initial._replace(q=before.copy(), v=np.zeros(5))
        x.q[known], x.v[known] = leg.scene.initial.q[known] + angles, rates
        x, _, _ = loops.close_loops(before, x, np.zeros(5), measured)
        before = x.q
        rows.append((x.q + 1e-4 * random.normal(size=5), x.v))
    order = [robot.joint(name).v for name in leg.joints]
    return offsets, *(np.array(each)[:, order] for each in zip(*rows, strict=True))


def test_live_torques_are_those_of_the_estimator_in_one_process(leg):
    offsets, q, v = swing(leg, 40)

    def message(i, stamp):
        return write_joint_state(JointState(), stamp, leg.joints, position=q[i], velocity=v[i])

    efforts, _ = play(leg, offsets, message)
    expected, _ = offline(leg.scene, offsets, q, v)
    np.testing.assert_allclose(efforts, expected, rtol=0, atol=1e-10)
    _check_rows(leg, q)
    driven = {"hip_flexion", "knee_anterior", "ankle"}
    for joint, effort in zip(leg.joints, efforts.T, strict=True):
        assert effort.any() == (joint in driven)


def _check_rows(leg, q):
    """Multipliers by row explain the torques; the violation is that of what was measured."""
    scene = leg.scene
    inverse = scene.closed_loop()
    leg.probe.spin_until(lambda: len(leg.forces) == len(leg.torques))
    rows = tuple(row.name for row in inverse.constraints.rows)
    order = [scene.robot.joint(name).q for name in leg.joints]
    system = scene.system()
    for force, torque, position in zip(leg.forces, leg.torques, q, strict=True):
        assert force.header == torque.header
        assert tuple(force.name) == rows and len(rows) == 2
        measured = scene.initial.q.copy()
        measured[order] = position
        gap = system.residual(0.0, measured)
        np.testing.assert_allclose(force.position, gap, rtol=0, atol=1e-12)
        assert 0.0 < np.abs(gap).max() < 1e-3
    still = np.zeros(scene.robot.model.nv)
    leg.reset()
    leg.send(0, position=q[0], velocity=np.zeros(len(leg.joints)))
    leg.probe.spin_until(lambda: leg.forces)
    measured[order] = q[0]
    x, a = inverse.project_motion(scene.initial._replace(q=measured, v=still), still)
    expected = inverse.solve(x, a).multipliers
    np.testing.assert_allclose(leg.forces[0].effort, expected, rtol=1e-9, atol=1e-9)
    assert np.abs(expected).max() > 0.1


def test_positions_that_cannot_be_assembled_are_dropped_and_the_node_lives(leg):
    _, q, _ = swing(leg, 1)
    leg.reset()
    broken = {"hip_flexion": 0.3, "knee_anterior": 3.0, "knee_tibial": 0.2, "knee_posterior": -1.1}
    position = [broken.get(joint, 0.0) for joint in leg.joints]
    leg.send(0, position=position, velocity=np.zeros(5))
    leg.probe.wait_health(lambda h: h.values.get("dropped.unsolved") == "1")
    leg.reset()
    leg.send(0, position=q[0] + 0.2 * (np.array(leg.joints) == "knee_tibial"))
    leg.probe.wait_health(lambda h: h.level == WARN and "off the loops by" in h.message)
    leg.reset()
    leg.send(1, position=q[0], velocity=np.zeros(5))
    (answer,) = leg.answers(1)
    expected = leg.scene.inverse_dynamics().solve(q[0], np.zeros(5), np.zeros(5))
    np.testing.assert_allclose(answer.effort, expected.tau, rtol=1e-9, atol=1e-9)
