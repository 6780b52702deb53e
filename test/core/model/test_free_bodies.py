"""Free bodies in simulations, recordings and inverse dynamics: poses, twists, root wrenches."""

from functools import partial

import numpy as np
import pytest
import yaml
from mechanisms import floating_body, four_bar, four_bar_closure, link, scene_of, urdf
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from simulator_plant import plant

from mbd_ros.api import load_scene
from mbd_ros.errors import DataError
from mbd_ros.features.inverse_dynamics.job import inverse
from mbd_ros.features.simulation.job import simulate
from mbd_ros.files.bags.bag_reader import messages, topic_types
from mbd_ros.files.bags.bag_writer import BagWriter
from mbd_ros.files.table import Column, Result, Table
from mbd_ros.nodes.inverse_dynamics.pipeline import MOST, SampleAssembler
from msg_adapters.errors import MessageError
from msg_adapters.joint_state_cdr import JointStateCdrWriter
from msg_adapters.pose import OdometryCdrWriter, read_odometry

ODOMETRY, JOINT_STATE = "nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState"
JOINTS = ("left_swing", "right_slide")
MASS, COM = 3.0, np.array([0.1, -0.2, 0.05])
MOMENTS = np.array([0.2, 0.3, 0.4])
GRAVITY = np.array([0.0, 0.0, -9.81])
BOX = urdf(link("box", MASS, COM, MOMENTS))
FREE = "robot: {base: floating}\ndt: 0.001\nintegrator: {type: rk4}\n"
ARM = FREE + "actuators: [{type: ideal, joints: [left_swing, right_slide]}]\n"
COUPLED = ARM.replace(", right_slide]", "]") + (
    "couplings: {right_slide: {parent: left_swing, factor: 0.3, offset: 0.1}}\n"
)
POSE = [f"base.position.{x}" for x in "xyz"] + [f"base.orientation.{x}" for x in "xyzw"]
TWIST = [f"base.{word}_velocity.{x}" for word in ("linear", "angular") for x in "xyz"]
PUSH = [f"base.{word}_acceleration.{x}" for word in ("linear", "angular") for x in "xyz"]
ROOT = [f"base.residual.{word}_{x}" for word in ("force", "torque") for x in "xyz"]


def values(result, names):
    return np.column_stack([result["samples"][name] for name in names])


def without(result, *words):
    """The result without columns whose name holds one of the words."""
    kept = [c for c in result["samples"].columns if not any(word in c.name for word in words)]
    return Result({"samples": Table(kept)})


def commands(names, duration=0.5):
    """Torques that keep changing, and the table that holds them."""
    t = np.arange(0.0, duration + 1e-9, 1e-3)
    tau = {name: (2.0 + i) * np.sin((5.0 - i) * t + i) for i, name in enumerate(names)}
    columns = [Column(f"{name}.command", column) for name, column in tau.items()]
    return tau, Result({"samples": Table([Column("time", t), *columns])})


# ---------------------------------------------------------------------- applied torques come back


@pytest.mark.parametrize(
    ("text", "robot", "driven"),
    [
        (ARM, floating_body(), ("left_swing", "right_slide")),
        (COUPLED, floating_body(), ("left_swing",)),
    ],
)
def test_inverse_returns_the_applied_torques_and_no_root_wrench(text, robot, driven):
    scene, (tau, efforts) = scene_of(text, robot), commands(driven)
    found = inverse(scene, simulate(scene, 0.5, efforts=efforts))
    for name, applied in tau.items():
        assert found["samples"][f"{name}.effort"] == pytest.approx(applied, abs=1e-9)
    assert np.abs(values(found, ROOT)).max() < 1e-9


def four_bar_on_a_trunk():
    """The four-bar linkage, its ground a trunk that floats."""
    trunk = link("trunk", 9.0, (0.3, 0.1, 0.2), (0.9, 1.1, 1.3))
    return four_bar().replace('<link name="world"/>', trunk).replace('"world"', '"trunk"')


def test_a_free_flying_linkage_with_a_loop_has_no_root_wrench_either():
    scene = scene_of(FREE + "actuators: [{type: ideal, joints: [crank]}]\n", four_bar_on_a_trunk())
    scene = scene.with_(
        constraints=[{"type": "loop_closure", **four_bar_closure()}],
        initial={"position": {"crank": 1.2, "coupler": -0.8, "rocker": 1.6}},
    )
    tau, efforts = commands(("crank",), 0.2)
    run = simulate(scene, 0.2, efforts=efforts)
    for motion in (run, without(run, "coupler.")):  # which the loop gives
        found = inverse(scene, motion)
        assert found["samples"]["crank.effort"] == pytest.approx(tau["crank"], abs=1e-9)
        assert np.abs(values(found, ROOT)).max() < 1e-9


# ---------------------------------------------------------------------- closed forms


def tumbling(t, far=0.0):
    """Pose in the world of a body that wobbles and flies, from angles by scipy."""
    angles = np.column_stack([2.0 * t, 0.4 * np.sin(3.0 * t), 0.7 * t + 0.2 * np.cos(2.0 * t)])
    place = np.column_stack([far + np.sin(t), t**2, 0.5 * np.cos(3.0 * t)])
    return place, Rotation.from_euler("ZYX", angles)


def exact(t, h=2e-3):
    """Twist and its derivative in axes of the body by central differences of sixth order.

    omega' from R' R' = hat: all by numpy and scipy, in the world first.
    """
    weights = {1: 45.0 / 60.0, 2: -9.0 / 60.0, 3: 1.0 / 60.0}

    def derivative(f):
        return lambda s: sum(w * (f(s + k * h) - f(s - k * h)) for k, w in weights.items()) / h

    def omega(s):
        turn = tumbling(s)[1].as_matrix()
        rate = derivative(lambda r: tumbling(r)[1].as_matrix())(s)
        hat = np.einsum("nji,njk->nik", turn, rate)  # R' dR/dt
        return np.column_stack([hat[:, 2, 1], hat[:, 0, 2], hat[:, 1, 0]])

    def linear(s):
        return tumbling(s)[1].inv().apply(derivative(lambda r: tumbling(r)[0])(s))

    twist = np.hstack([linear(t), omega(t)])
    return twist, np.hstack([derivative(linear)(t), derivative(omega)(t)])


def pose_table(t, flips=None, far=0.0):
    place, turn = tumbling(t, far)
    quaternion = turn.as_quat() * (1.0 if flips is None else flips[:, None])
    columns = zip(POSE, np.hstack([place, quaternion]).T, strict=True)
    return [Column("time", t), *(Column(name, column) for name, column in columns)]


def root_wrench(t):
    """What must push a rigid body along `tumbling`: Newton and Euler about its origin, by hand."""
    twist, push = exact(t)
    v, w, dv, dw = twist[:, :3], twist[:, 3:], push[:, :3], push[:, 3:]
    fall = tumbling(t)[1].inv().apply(np.tile(GRAVITY, (len(t), 1)))
    centre = dv + np.cross(w, v) + np.cross(dw, COM) + np.cross(w, np.cross(w, COM)) - fall
    moment = dw * MOMENTS + np.cross(w, w * MOMENTS) + np.cross(COM, MASS * centre)
    return np.hstack([MASS * centre, moment])


@pytest.mark.parametrize("far", [0.0, 1e4])
def test_root_wrench_of_a_rigid_body_is_that_of_newton_and_euler(far):
    t = np.arange(0.0, 1.0, 0.01)
    twist, push = exact(t)
    given = zip(TWIST + PUSH, np.hstack([twist, push]).T, strict=True)
    table = Table([*pose_table(t, far=far), *(Column(name, column) for name, column in given)])
    found = inverse(scene_of(FREE, BOX), Result({"samples": table}))
    assert values(found, ROOT) == pytest.approx(root_wrench(t), abs=1e-8)


@pytest.mark.parametrize("options", [{}, {"half_width": 3}])
def test_poses_alone_are_differentiated_whatever_the_signs_of_their_quaternions(options):
    t = np.arange(0.0, 2.0, 0.005)
    flips = np.random.default_rng(0).choice([-1.0, 1.0], len(t))
    table = Result({"samples": Table(pose_table(t, flips))})
    found = inverse(scene_of(FREE, BOX), table, derivatives="zero-phase", **options)
    inside, (twist, push) = slice(60, -60), exact(t)
    assert values(found, TWIST)[inside] == pytest.approx(twist[inside], abs=1e-5)
    assert values(found, PUSH)[inside] == pytest.approx(push[inside], abs=2e-3)
    quaternions = values(found, POSE)[:, 3:]
    assert ((quaternions[1:] * quaternions[:-1]).sum(axis=1) > 0.9).all()
    assert abs(quaternions[0].dot(tumbling(t)[1].as_quat()[0])) == pytest.approx(1.0, abs=1e-9)


def test_causal_filters_pass_a_constant_twist_as_it_is():
    """A screw motion over several turns: no lag, no acceleration but that of its own axes."""
    t = np.arange(0.0, 3.0, 0.002)
    axis, speed = np.array([0.6, 0.0, 0.8]), 9.0
    turn = Rotation.from_rotvec(np.outer(speed * t, axis))
    twist = np.array([0.0, 0.0, 0.0, *(speed * axis)])
    poses = np.hstack([np.zeros((len(t), 3)), turn.as_quat()]).T
    columns = [Column("time", t), *(Column(n, c) for n, c in zip(POSE, poses, strict=True))]
    table = Result({"samples": Table(columns)})
    found = inverse(scene_of(FREE, BOX), table, derivatives="causal", cutoff=10.0)
    assert values(found, TWIST)[200:] == pytest.approx(np.tile(twist, (len(t) - 200, 1)), abs=1e-9)
    assert np.abs(values(found, PUSH)[200:]).max() < 1e-6


def test_what_is_not_given_is_asked_for():
    t = np.arange(0.0, 1.0, 0.01)
    table = pose_table(t)
    with pytest.raises(
        DataError, match=r"no base\.linear_velocity and base\.angular_velocity; ch"
    ):
        inverse(scene_of(FREE, BOX), Result({"samples": Table(table)}))
    with pytest.raises(DataError, match=r"no column base\.orientation\.w; there are: time"):
        inverse(scene_of(FREE, BOX), Result({"samples": Table(table[:-1])}))
    still = [c if "orientation" not in c.name else c._replace(values=0.0 * t) for c in table]
    with pytest.raises(
        DataError, match=r"base\.orientation at 0 s has the length 0, but a unit quat"
    ):
        inverse(scene_of(FREE, BOX), Result({"samples": Table(still)}))
    huge = [c if "orientation" not in c.name else c._replace(values=1e200 + t) for c in table]
    with pytest.raises(DataError, match=r"base\.orientation\.x is 1e\+200 in row 1, but its size"):
        inverse(scene_of(FREE, BOX), Result({"samples": Table(huge)}))


# ---------------------------------------------------------------------- files


def test_a_bag_holds_odometry_and_comes_back_to_the_bit(tmp_path):
    scene, (_, efforts) = scene_of(ARM, floating_body()), commands(("left_swing", "right_slide"))
    run = simulate(scene, 0.1, start=0.1, efforts=efforts)
    run.to(tmp_path / "bag")
    sent = [message for _, _, message in messages(tmp_path / "bag", {"/odometry": ODOMETRY})]
    assert {(m.header.frame_id, m.child_frame_id) for m in sent} == {("world", "trunk")}
    places = np.array([[getattr(m.pose.pose.position, x) for x in "xyz"] for m in sent])
    assert np.array_equal(places, values(run, POSE[:3]))
    again = [
        simulate(scene, 0.05, start=0.15, origin=o, efforts=efforts)
        for o in (run, tmp_path / "bag")
    ]
    assert again[0]["samples"] == again[1]["samples"]
    for name in (*POSE, *TWIST):
        assert np.array_equal(again[0]["samples"][name], run["samples"][name][50:]), name
    of_bag = inverse(scene, tmp_path / "bag", derivatives="zero-phase")
    of_table = inverse(scene, without(run, "acceleration"), derivatives="zero-phase")
    assert of_bag["samples"] == of_table["samples"]


def test_messages_without_a_partner_of_their_stamp_are_left_out_and_counted(tmp_path):
    t = np.arange(0.0, 1.0, 0.01)
    scene = scene_of(ARM, floating_body())
    run = simulate(scene, 0.1)
    run.to(tmp_path / "whole")
    kept = 0
    with BagWriter(tmp_path / "bag") as bag:
        for topic, log_time, message in messages(tmp_path / "whole"):
            if topic == "/joint_states":
                bag.write(topic, "sensor_msgs/msg/JointState", log_time, message)
            elif topic == "/odometry" and (kept := kept + 1) % 4:
                bag.write(topic, ODOMETRY, log_time, message)
        wrong = np.array([0.0, 0, 0, 0, 0, 0, 1]), np.zeros(6)
        bag.write("/odometry", ODOMETRY, 10**9, OdometryCdrWriter("", "").write(10**9, *wrong))
    lines = []
    found = inverse(scene, tmp_path / "bag", derivatives="causal", say=lines.append)
    assert found["samples"].rows == 101 - 25 < len(t)
    left_out = [line for line in lines if "no message of its stamp on the other topics" in line]
    assert [line.split(": ")[1].split()[0] for line in left_out] == ["25", "1"]


def test_a_wrench_from_outside_explains_the_motion_of_a_free_flying_arm():
    """Through a geared motor and a spring, beside a load on a link; with bounds too."""
    scene = scene_of(ARM, floating_body()).with_(
        actuators=[
            {"type": "geared_motor", "joint": "left_swing", "ratio": 50.0, "rotor_inertia": 1e-4},
            {"type": "series_elastic", "joint": "right_slide", "stiffness": 50.0},
        ],
        external_wrenches={"push": {"frame": "right"}},
    )
    t = np.arange(0.0, 0.3, 1e-3)
    told = {"left_swing": 0.02 * np.sin(9.0 * t), "right_slide": 0.1 * np.cos(4.0 * t)}
    load = np.column_stack([3.0 * np.sin(5 * t), np.cos(t), 2.0 + 0.0 * t, t, -t, np.sin(3 * t)])
    names = [f"push.{word}.{axis}" for word in ("force", "torque") for axis in "xyz"]
    commanded = [Column(f"{name}.command", u) for name, u in told.items()]
    loads = [Column(name, column) for name, column in zip(names, load.T, strict=True)]
    time = Column("time", t)
    efforts, wrenches = (Result({"samples": Table([time, *c])}) for c in (commanded, loads))
    run = simulate(scene, 0.25, efforts=efforts, wrenches=wrenches)
    for bounds in (False, True):
        found = inverse(scene, run, wrenches=wrenches, bounds=bounds)
        assert np.abs(values(found, ROOT)).max() < 1e-9
        for name, u in told.items():
            assert found["samples"][f"{name}.command"] == pytest.approx(u[:251], abs=1e-9)


def test_a_body_without_any_joint_goes_everywhere(tmp_path):
    """Simulated, in a bag, started from there, through inverse dynamics and in the simulator."""
    twist = {"linear": [1.0, -2.0, 0.5], "angular": [3.0, 1.2, -0.4]}
    (tmp_path / "scene.yaml").write_text(
        "bodies: {box: {shape: {box: [0.1, 0.3, 0.5]}, mass: 2.0}}\n"
        "dt: 0.001\nintegrator: {type: rk4}\n"
        + yaml.safe_dump({"initial": {"twist": {"box": twist}}}),
        encoding="utf-8",
    )
    scene = load_scene(tmp_path / "scene.yaml")
    run = simulate(scene, 0.2, start=0.1)
    run.to(tmp_path / "bag")
    later = simulate(scene, 0.1, start=0.2, origin=tmp_path / "bag")
    for name, column in later["samples"].items():
        if name.startswith("box."):
            assert np.array_equal(column, run["samples"][name][100:]), name
    found = inverse(scene, tmp_path / "bag", derivatives="zero-phase")
    roots = [f"box.residual.{word}_{axis}" for word in ("force", "torque") for axis in "xyz"]
    assert np.abs(values(found, roots)[20:-20]).max() < 1e-6
    there = plant(tmp_path / "scene.yaml", rate=1000.0)
    there.live.tick()
    assert there.joint_states(1) == []
    (sent,) = (read_odometry(deserialize_message(c, Odometry)) for c in there.odometry(1))
    assert sent.pose[0] == run["samples"]["box.position.x"][1]


# ---------------------------------------------------------------------- several robots


@pytest.fixture
def two_arms(tmp_path):
    """A free-flying arm, one that stands far away, and a box, as a scene file."""
    (tmp_path / "arm.urdf").write_text(floating_body(), encoding="utf-8")
    arm = {"urdf": "arm.urdf"}
    joints = [f"{robot}/{name}" for robot in ("left", "right") for name in JOINTS]
    entries = {
        "robots": {
            "left": {**arm, "base": "floating", "pose": {"xyz": [1.0, 2.0, 3.0]}},
            "right": {**arm, "pose": {"xyz": [-500.0, 0.0, 3.0], "rpy": [0.1, 0.2, 0.3]}},
        },
        "bodies": {"box": {"shape": {"box": [0.1, 0.3, 0.5]}, "mass": 2.0}},
        "actuators": [{"type": "ideal", "joints": joints}],
        "initial": {"twist": {"box": {"linear": [1.0, -2.0, 0.5], "angular": [3.0, 1.2, -0.4]}}},
        "dt": 0.001,
        "integrator": {"type": "rk4"},
    }
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(entries), encoding="utf-8")
    return tmp_path / "scene.yaml", joints


def test_joints_of_several_robots_are_on_topics_of_their_own_without_prefix(two_arms, tmp_path):
    path, joints = two_arms
    scene, (tau, efforts) = load_scene(path), commands(joints, 0.3)
    run = simulate(scene, 0.1, start=0.1, efforts=efforts)
    assert run["samples"]["left.position.x"][0] == 1.0
    run.to(tmp_path / "bag")
    types = topic_types(tmp_path / "bag")
    assert {topic for topic, kind in types.items() if kind == JOINT_STATE} == {
        "/left/joint_states",
        "/right/joint_states",
    }
    assert {t for t, kind in types.items() if kind == ODOMETRY} == {
        "/left/odometry",
        "/box/odometry",
    }
    (_, _, first), *_ = messages(tmp_path / "bag", {"/right/joint_states": JOINT_STATE})
    assert tuple(first.name) == JOINTS
    again = [
        simulate(scene, 0.05, start=0.15, origin=o, efforts=e)["samples"]
        for o, e in ((run, run), (tmp_path / "bag", tmp_path / "bag"))
    ]
    assert again[0] == again[1]
    found = inverse(scene, run)["samples"]
    for name, applied in tau.items():
        assert found[f"{name}.effort"] == pytest.approx(applied[100:201], abs=1e-9)
    roots = [
        f"{b}.residual.{w}_{x}"
        for b in ("left", "box")
        for w in ("force", "torque")
        for x in "xyz"
    ]
    assert max(np.abs(found[name]).max() for name in roots) < 1e-9


def test_a_second_free_body_first_or_last_changes_no_digit_of_inverse_dynamics(tmp_path):
    """Nor of a table, nor of the causal estimate; couplings included."""
    for name, text in (("arm", floating_body()), ("box", BOX)):
        (tmp_path / f"{name}.urdf").write_text(text, encoding="utf-8")
    arm, box = ({"urdf": f"{name}.urdf", "base": "floating"} for name in ("arm", "box"))
    _, efforts = commands(["arm/left_swing"], 0.3)
    found = []
    for i, robots in enumerate(({"arm": arm}, {"arm": arm, "box": box}, {"box": box, "arm": arm})):
        entries = {
            "robots": robots,
            "couplings": {"arm/right_slide": {"parent": "arm/left_swing", "factor": 0.3}},
            "actuators": [{"type": "ideal", "joints": ["arm/left_swing"]}],
            "initial": {"twist": {"arm": {"linear": [0.0, 0.0, 1.0], "angular": [1.0, 4.0, 0.3]}}},
            "dt": 0.001,
            "integrator": {"type": "rk4"},
        }
        (path := tmp_path / f"scene_{i}.yaml").write_text(yaml.safe_dump(entries), "utf-8")
        scene = load_scene(path)
        run = simulate(scene, 0.25, efforts=efforts)
        results = run, inverse(scene, run), inverse(scene, run, derivatives="causal")
        names = [name for name in results[1]["samples"] if name.startswith("arm")]
        found.append(
            [values(result, [n for n in names if n in result["samples"]]) for result in results]
        )
    for others in found[1:]:
        for one, other in zip(found[0], others, strict=True):
            assert other == pytest.approx(one, rel=1e-12, abs=1e-12)


def test_the_simulator_publishes_each_robot_by_itself(two_arms):
    path, joints = two_arms
    there = plant(path)
    there.live.tick()
    pairs = zip(there.members, there.joint_states(5), strict=True)
    sent = {member: deserialize_message(cdr, JointState) for member, cdr in pairs}
    assert {member: tuple(message.name) for member, message in sent.items()} == {
        "left": JOINTS,
        "right": JOINTS,
    }
    position = [*sent["left"].position, *sent["right"].position]
    assert position == there.live.now.position.tolist()
    assert joints == [joint.name for joint in there.scene.robot.joints]
    assert there.bodies == ["left", "box"]
    assert [len(cdr) for cdr in there.odometry(5)] == [len(cdr) for cdr in there.odometry(6)]


# ---------------------------------------------------------------------- parts of a sample, live


def whole_samples():
    deserialize = partial(deserialize_message, message_type=JointState)
    names = ("left/a", "right/a", "b")
    return SampleAssembler(names, {"left", "right"}, ["base", "box"], deserialize)


def part_of(whole, topic, stamp, velocity=1.0):
    """A part as it comes on a topic."""
    if topic in whole.joint_topics:
        own = ["a"] if "/" in topic else ["b"]
        cdr = JointStateCdrWriter(own).write(stamp, position=0.5, velocity=velocity, effort=0.0)
        return whole.read(topic, cdr)
    place = np.array([velocity, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    cdr = OdometryCdrWriter("world", "x").write(stamp, place, np.full(6, velocity))
    return read_odometry(deserialize_message(cdr, Odometry))


@pytest.mark.parametrize("seed", range(5))
def test_parts_of_a_stamp_make_a_sample_in_whatever_order_they_come(seed):
    whole, rng = whole_samples(), np.random.default_rng(seed)
    topics = [*whole.joint_topics, *whole.body_topics]
    assert topics == [
        *("left/joint_states", "right/joint_states", "joint_states"),
        *("odometry", "box/odometry"),
    ]
    for stamp in range(1, 5):
        for i, k in enumerate(rng.permutation(len(topics))):
            sample, lost = whole.add(topics[k], stamp, part_of(whole, topics[k], stamp, 1.0 + k))
            assert lost == 0 and (sample is None) == (i < len(topics) - 1)
        assert sample.joints.velocity.tolist() == [1.0, 2.0, 3.0]
        assert sample.bodies[0][:, 0].tolist() == sample.bodies[1][:, 5].tolist() == [4.0, 5.0]
        assert sample.present is whole.present and sample.present.all()
    assert not whole.unheard


def test_parts_that_lost_their_partner_are_given_up_and_never_kept_for_ever():
    whole = whole_samples()
    topics = [*whole.joint_topics, *whole.body_topics]
    for stamp in (1, 2):
        for topic in topics[1:]:
            assert whole.add(topic, stamp, part_of(whole, topic, stamp)) == (None, 0)
    found = [whole.add(topic, 3, part_of(whole, topic, 3)) for topic in topics]
    assert [lost for _, lost in found] == [0, 0, 0, 0, 2]
    lost = [whole.add("odometry", s, part_of(whole, "odometry", s))[1] for s in range(10, 2000)]
    assert sum(lost) == len(lost) - MOST
    with pytest.raises(MessageError, match="stamp is 0, and parts of a sample are found by their"):
        whole.add("odometry", 7, part_of(whole, "odometry", 0))
