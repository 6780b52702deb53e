"""Motions that show masses: limits at every sample, condition numbers, files."""

import numpy as np
import pinocchio as pin
import pytest
import yaml

from mbd_ros.api import load_scene, scene_from
from mbd_ros.cli import main
from mbd_ros.errors import DataError
from mbd_ros.features.identification.excite.job import Fourier, excite
from mbd_ros.files.bags.bag_reader import raw_messages, topic_types
from mbd_ros.files.bags.bag_types import from_cdr


def limits_kept(scene, samples):
    """Positions, velocities and torques of all joints, by other calls than those of the search."""
    model, data = scene.robot.model, scene.robot.model.createData()
    names = scene.couplings.independent
    found = {
        f: np.transpose([samples[f"{n}.{f}"] for n in names])
        for f in ("position", "velocity", "acceleration")
    }
    worst = np.zeros(3)
    for y, v, a in zip(*found.values(), strict=True):
        q, rate, push = np.zeros((3, model.nv))
        q[scene.couplings.q_index], rate[scene.couplings.v_index] = y, v
        push[scene.couplings.v_index] = a
        slopes = scene.couplings.expand(q, rate, push)
        tau, _ = scene.couplings.reduce(pin.rnea(model, data, q, rate, push), slopes)
        for joint in scene.robot.joints:
            middle, half = 0.5 * (joint.upper + joint.lower), 0.5 * (joint.upper - joint.lower)
            shares = [
                abs(q[joint.q] - middle) / half,
                abs(rate[joint.v]) / joint.max_velocity,
                0.0,
            ]
            if joint.name in names:
                shares[2] = abs(tau[names.index(joint.name)]) / joint.max_effort
            worst = np.maximum(worst, shares)
    return worst


@pytest.mark.parametrize(("name", "most"), [("arm7", 30.0), ("prosthetic_arm", None)])
def test_a_motion_keeps_all_limits_and_is_better_than_random_ones(name, most):
    """Within 90 % of all limits at 1 kHz; condition 30, or half of the best of 200 random ones."""
    scene = load_scene(name)
    found = excite(scene, evaluations=300)
    assert limits_kept(scene, found.samples(1000.0)["samples"]).max() <= 0.9 + 1e-6
    assert found.condition <= (most or 0.5 * found.random)


def test_motions_begin_and_end_at_rest():
    random = np.random.default_rng(1)
    A, B = random.normal(size=(2, 5, 3))
    motion = Fourier.at_rest(np.zeros(3), A, B, 7.0)
    t = np.array([0.0, 7.0])
    position, velocity, acceleration = motion.at(t)
    assert np.abs(velocity).max() < 1e-12
    assert np.abs(acceleration).max() < 1e-12
    assert position[0] == pytest.approx(position[1])
    t, h = np.linspace(0.1, 6.9, 7), 1e-5
    above, below = motion.at(t + h), motion.at(t - h)
    for k in (0, 1):
        assert (above[k] - below[k]) / (2 * h) == pytest.approx(motion.at(t)[k + 1], abs=1e-7)


BALL = '<collision><geometry><sphere radius="0.06"/></geometry></collision>'


def test_links_that_would_touch_keep_apart():
    """Two arms of one base, whose tips could meet; spheres against an independent distance."""
    links = "".join(
        f'<link name="l{i}"><inertial><origin xyz="0 0 0.2"/><mass value="1"/><inertia ixx="0.02" '
        f'iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<link name="tip{i}">{BALL}</link><joint name="f{i}" type="fixed"><parent link="l{i}"/>'
        f'<child link="tip{i}"/><origin xyz="0 0 0.3"/></joint>'
        f'<joint name="j{i}" type="revolute"><parent link="base"/><child link="l{i}"/>'
        f'<origin xyz="{0.3 * i} 0 0"/><axis xyz="0 1 0"/>'
        f'<limit lower="-1.5" upper="1.5" velocity="4" effort="100"/></joint>'
        for i in (0, 1)
    )
    scene = scene_from({}, urdf=f'<robot name="two"><link name="base"/>{links}</robot>')
    found = excite(scene, evaluations=200)
    t = np.linspace(0.0, found.motion.period, 1000)
    q = found.motion.at(t)[0]
    tips = [np.stack([0.3 * i + 0.3 * np.sin(q[:, i]), 0.3 * np.cos(q[:, i])]) for i in (0, 1)]
    assert np.linalg.norm(tips[0] - tips[1], axis=0).min() > 0.118


def test_the_command_writes_the_same_trajectory_three_times(tmp_path, capsys):
    out = tmp_path / "out"
    words = ["excite", "arm7", "-o", str(out), "--evaluations", "200", "--rate", "20"]
    assert main(words) == 0
    assert "condition number" in capsys.readouterr().out
    written = yaml.safe_load((out / "trajectory.yaml").read_text(encoding="utf-8"))
    bag = out / "trajectory.mcap"
    topics = topic_types(bag)
    assert topics == {"/joint_trajectory": "trajectory_msgs/msg/JointTrajectory"}
    message = from_cdr(next(raw_messages(bag, topics)).cdr, topics["/joint_trajectory"])
    assert message.joint_names == written["joint_names"]
    assert len(message.points) == len(written["points"]) == 201
    for point, other in zip(message.points, written["points"], strict=True):
        assert point.positions.tolist() == other["positions"]
        assert point.velocities.tolist() == other["velocities"]
        assert point.time_from_start.nanosec == other["time_from_start"]["nanosec"]


@pytest.mark.parametrize(
    ("scene", "words", "said"),
    [
        ("four_bar_leg", [], "identify accepts recordings of loops"),
        ("free_flyer", [], "fix the base"),
        ("arm7", ["--harmonics", "2"], "--harmonics 2: accepted are 3 .. 50"),
        ("arm7", ["--rate", "1000"], "10000 points"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, capsys, scene, words, said):
    assert main(["excite", scene, "-o", str(tmp_path / "out"), *words]) == 2
    assert said in capsys.readouterr().err


def test_no_motion_within_limits_is_said():
    scene = load_scene("prosthetic_leg").with_(external_wrenches=None)
    heavy = {
        k: (80.0 * i.mass, i.lever, 80.0 * i.inertia)
        for k, i in scene.robot.inertias().items()
        if i.mass
    }
    with pytest.raises(DataError, match="no motion keeps"):
        excite(scene.with_inertias(heavy), evaluations=200)
