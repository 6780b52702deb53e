"""Models of MuJoCo against MuJoCo."""

import numpy as np
import pinocchio as pin
import pytest

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.state import State

mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed: pip install mujoco")

PARTS = """
<geom type="box" size="0.1 0.2 0.3" pos="0.1 0 0"/>
<geom type="capsule" fromto="0 0 0 0.1 0.2 0.3" size="0.03"/>
<frame pos="0.1 0 0" euler="0 30 0">
  <body name="u" pos="0 0 -0.3" axisangle="1 1 0 30">{u}
    <inertial pos="0.1 0.2 0" mass="2" diaginertia="0.2 0.3 0.4" euler="10 0 20"/>
    <site name="on_u" pos="0.1 0 0.2"/></body>
  <geom type="cylinder" size="0.04 0.1" mass="0.4"/>
  <body name="v" xyaxes="1 1 0 0 1 1" pos="0.2 0 0">
    <joint name="v" class="b" axis="1 2 3"/><geom type="ellipsoid" size="0.1 0.2 0.3"/>
    <body name="w" zaxis="1 0 1"><geom type="ellipsoid" fromto="0 0 0 0.2 0.1 0" size="0.05"/>
      <geom type="box" fromto="0 0 0 0.2 0.1 0" size="0.05"/>
      <geom type="cylinder" fromto="0 0 0 0.2 0.1 0" size="0.05"/></body></body></frame>
<frame euler="30 0 0" pos="0.1 0 0.3"><body name="f"><frame euler="0 40 0" pos="0 0.2 0">
  <joint name="fj" pos="0.1 0 0"/><geom type="sphere" size="0.1"/></frame></body></frame>
"""
DEFAULTS = """
<default><geom density="700"/><joint armature="0.02"/><default class="a">
  <joint axis="1 0 0" range="-30 40"/>
  <default class="b"><joint armature="0.5" ref="20"/></default></default></default>
"""
BALL = '<joint name="ball" class="main" armature="0" type="ball" pos="0 0.1 0.1"/>'
CHAIN = (
    '<joint name="t" type="slide" axis="0 1 1" ref="0.2"/><joint name="t1" pos="0.1 0 0.2"/>'
    '<joint name="t2" axis="0 2 1" class="b" pos="0 0.1 0"/>'
)
WHOLE = 'balanceinertia="true" boundmass="0.5" boundinertia="0.1" inertiafromgeom="true"'


def model(inside, compiler='angle="degree"', more="", gravity="1 2 -9"):
    return (
        f'<mujoco model="m"><compiler {compiler}/><option gravity="{gravity}"/>{DEFAULTS}'
        f'<worldbody><geom name="floor" type="plane" size="1 1 1"/>{inside}</worldbody>'
        f"{more}</mujoco>"
    )


def tree(joints, compiler='angle="degree" eulerseq="zYx"', u=BALL):
    body = f'<body name="t" pos="0 0.1 1" euler="10 20 30" childclass="a">{joints}'
    return model(f"{body}{PARTS.format(u=u)}</body>", compiler)


def star():
    """A mesh that is not convex, seen from outside, as words of an asset."""
    ring = [(np.cos(a), np.sin(a)) for a in np.arange(10) * np.pi / 5]
    rim = [(x * r, y * r, 0.0) for (x, y), r in zip(ring, [0.3, 0.12] * 5, strict=True)]
    points = [*rim, (0.02, 0.0, 0.25), (0.0, 0.01, -0.1)]
    sides = [(i, (i + 1) % 10) for i in range(10)]
    faces = [*((i, j, 10) for i, j in sides), *((j, i, 11) for i, j in sides)]
    exact = np.round(np.array(points) * 1024) / 1024
    words = (" ".join(str(n) for row in rows for n in row) for rows in (exact.tolist(), faces))
    return 'vertex="{}" face="{}" scale="1 0.5 2"'.format(*words)


def meshed(rule):
    asset = f'<asset><mesh name="star" {star()} inertia="{rule}"/></asset>'
    geom = '<geom type="mesh" mesh="star" pos="0.1 0 0.2" euler="10 20 30"/>'
    return model(f'<body name="b" pos="0 0 1"><freejoint name="f"/>{geom}</body>', more=asset)


BOXES = "".join(
    f'<body name="{n}" pos="{x} 0 1" euler="0 0 {40 * x}"><freejoint name="{n}"/>'
    '<geom type="box" size="0.1 0.2 0.3" pos="0.1 0 0"/></body>'
    for n, x in (("one", 0), ("two", 2))
)
MODELS = {
    "two free bodies": model(BOXES),
    **{f"{rule} mesh": meshed(rule) for rule in ("legacy", "convex", "exact")},
    "chain": tree(CHAIN),
    "floating": tree('<freejoint name="root"/>', 'eulerseq="XyZ"'),
    "from geoms": tree(
        CHAIN, f'angle="radian" {WHOLE}', '<geom type="capsule" size="0.1 0.2"/>'
    ).replace('"-30 40"', '"-0.5 0.6"'),
}


def both(tmp_path, text):
    file = tmp_path / "model.xml"
    file.write_text(text)
    return mbd.load_scene(file), mujoco.MjModel.from_xml_path(str(file))


def ball(q):
    """Rotation of three hinges, and the angular velocity of each in the axes of the body."""
    x, y, z = (pin.AngleAxis(a, e).toRotationMatrix() for a, e in zip(q, np.eye(3), strict=True))
    return x @ y @ z, np.column_stack(((y @ z).T[:, 0], z.T[:, 1], np.eye(3)[2]))


def at_rest(scene, theirs, q):
    """MuJoCo at a configuration of ours, and what its velocities are of ours, (nv, nv)."""
    data, robot = mujoco.MjData(theirs), scene.robot
    turn = np.zeros((theirs.nv, robot.model.nv))
    for j in range(theirs.njnt):
        name, a, b = theirs.joint(j).name, theirs.jnt_qposadr[j], theirs.jnt_dofadr[j]
        kind = theirs.jnt_type[j]
        if kind == mujoco.mjtJoint.mjJNT_FREE and robot.bases:
            data.qpos[a : a + 7] = [*q[:3], q[6], *q[3:6]]
            turn[b : b + 3, :3] = pin.Quaternion(q[3:7]).toRotationMatrix()
            turn[b + 3 : b + 6, 3:6] = np.eye(3)
        elif kind == mujoco.mjtJoint.mjJNT_FREE:
            hinges = [robot.joint(f"{name}_{kind}{letter}") for kind in "tr" for letter in "xyz"]
            w, *xyz = theirs.body_quat[theirs.jnt_bodyid[j]]
            rotation, slopes = ball([q[hinge.q] for hinge in hinges[3:]])
            x, y, z, w = (pin.Quaternion(w, *xyz) * pin.Quaternion(rotation)).coeffs()
            data.qpos[a : a + 7] = [*(q[hinge.q] for hinge in hinges[:3]), w, x, y, z]
            turn[b : b + 3, [hinge.v for hinge in hinges[:3]]] = np.eye(3)
            turn[b + 3 : b + 6, [hinge.v for hinge in hinges[3:]]] = slopes
        elif kind == mujoco.mjtJoint.mjJNT_BALL:
            hinges = [robot.joint(f"{name}_{letter}") for letter in "xyz"]
            rotation, slopes = ball([q[hinge.q] for hinge in hinges])
            x, y, z, w = pin.Quaternion(rotation).coeffs()
            data.qpos[a : a + 4] = [w, x, y, z]
            turn[b : b + 3, [hinge.v for hinge in hinges]] = slopes
        else:
            data.qpos[a] = q[robot.joint(name).q]
            turn[b, robot.joint(name).v] = 1.0
    mujoco.mj_forward(theirs, data)
    return data, turn


def random_configuration(robot, seed):
    pin.seed(seed)
    return pin.randomConfiguration(robot.model, -np.ones(robot.model.nq), np.ones(robot.model.nq))


@pytest.mark.parametrize("name", MODELS)
def test_poses_masses_and_weights_are_those_of_mujoco(tmp_path, name):
    scene, theirs = both(tmp_path, MODELS[name])
    model, data = scene.robot.model, scene.robot.model.createData()
    limit = 1e-10 if "mesh" in name else 1e-12  # MuJoCo keeps meshes in single precision
    for seed in range(3):
        q = random_configuration(scene.robot, seed)
        found, turn = at_rest(scene, theirs, q)
        full = np.zeros((theirs.nv, theirs.nv))
        mujoco.mj_fullM(theirs, found, full)
        upper = np.triu(pin.crba(model, data, q))
        mass = upper + np.triu(upper, 1).T
        assert np.abs(mass - turn.T @ full @ turn).max() <= limit * np.abs(full).max()
        weight = pin.computeGeneralizedGravity(model, data, q)
        assert np.abs(weight - turn.T @ found.qfrc_bias).max() <= limit * np.abs(weight).max()
        pin.framesForwardKinematics(model, data, q)
        for body in range(1, theirs.nbody):
            at = data.oMf[model.getFrameId(theirs.body(body).name)]
            assert np.abs(at.translation - found.xpos[body]).max() <= 1e-13
            assert np.abs(at.rotation - found.xmat[body].reshape(3, 3)).max() <= 1e-13


@pytest.mark.parametrize("name", ["chain", "from geoms"])
def test_bias_forces_are_those_of_mujoco(tmp_path, name):
    """With velocities; hinges and slides have the same coordinates in both."""
    text = MODELS[name].replace(BALL, '<joint name="ball" pos="0 0.1 0.1"/>')
    scene, theirs = both(tmp_path, text)
    assert scene.robot.model.nv == theirs.nv
    q, v = random_configuration(scene.robot, 5), np.linspace(-2.0, 3.0, theirs.nv)
    found, turn = at_rest(scene, theirs, q)
    found.qvel[:] = turn @ v
    mujoco.mj_forward(theirs, found)
    bias = pin.nonLinearEffects(scene.robot.model, scene.robot.model.createData(), q, v)
    assert np.abs(bias - turn.T @ found.qfrc_bias).max() <= 1e-12 * np.abs(bias).max()


def rod(name, inside="", joint="", at="0 0 0"):
    return (
        f'<body name="{name}" pos="{at}"><joint name="{name}" axis="0 1 0" {joint}/>'
        f'<geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.02"/>{inside}</body>'
    )


SITES = '<site name="far" pos="0.3 0 0.05"/><site name="beside" pos="0.1 0 0.3"/>'
ARM = rod(
    "upper",
    '<geom name="ball" type="sphere" size="0.03" pos="0.4 0 0"/>'
    '<geom name="rod" type="cylinder" size="0.03 0.1" pos="0.4 0 0" euler="90 0 0"/>'
    '<site name="near" pos="0.1 0.01 0.06"/><site name="above" pos="0.4 0 0.2"/>'
    + rod("lower", SITES, 'damping="0.2" stiffness="3" springref="10"', "0.4 0 0"),
    'frictionloss="0.1" ref="30"',
)
TENDONS = """
<tendon><fixed name="joints"><joint joint="upper" coef="0.3"/>
<joint joint="lower" coef="-0.1"/></fixed>
<spatial name="line"><site site="near"/><site site="beside"/><site site="far"/></spatial>
<spatial name="over ball"><site site="near"/><geom geom="ball"/><site site="far"/></spatial>
<spatial name="over rod"><site site="near"/><geom geom="rod" sidesite="above"/>
<site site="far"/></spatial>
<spatial name="string" springlength="0 0.2" stiffness="50">
<site site="near"/><site site="far"/></spatial>
<spatial name="split"><site site="near"/><site site="far"/><pulley divisor="2"/><site site="near"/>
<site site="beside"/></spatial></tendon>
"""


def test_lengths_and_moment_arms_are_those_of_mujoco(tmp_path):
    """Joints, lines, a sphere, a cylinder with the side that a site names."""
    scene, theirs = both(tmp_path, model(ARM, more=TENDONS))
    names = ["joints", "line", "over_ball", "over_rod", "string"]
    assert list(scene.parts["paths"]) == names
    assert "spatial split (pulleys divide it)" in scene.robot.ignored
    k, v = Kinematics(scene.robot), np.array([0.4, -0.9])
    for q in np.array([[0.3, 0.4], [-0.5, 1.0], [0.2, -0.6]]):
        found, _ = at_rest(scene, theirs, q)
        found.qvel[:] = v
        mujoco.mj_forward(theirs, found)
        k.refresh(q, v)
        for i, name in enumerate(names):
            length, slope = scene.parts["paths"][name].measured(k, State(0.0, q, v))
            assert length == pytest.approx(found.ten_length[i], abs=1e-10), (name, q)
            assert slope @ v == pytest.approx(found.ten_velocity[i], abs=1e-8), (name, q)


EQUALITIES = """
<equality><joint joint1="lower" joint2="upper" polycoef="0.1 0.5 -0.2 0.3"/></equality>
"""


def test_equalities_of_joints_are_couplings(tmp_path):
    """Polynomials count from the reference positions."""
    scene, theirs = both(tmp_path, model(ARM, more=EQUALITIES))
    data = mujoco.MjData(theirs)
    q = np.array([0.7, 0.0])
    scene.couplings.expand(q, np.zeros(2), np.zeros(2))
    data.qpos[:] = q
    mujoco.mj_forward(theirs, data)
    assert (
        np.abs(data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]).max() <= 1e-15
    )
    assert scene.couplings.dependent == ("lower",) or "lower" in scene.couplings.dependent


def test_one_joint_of_an_equality_is_locked(tmp_path):
    more = '<equality><joint joint1="upper" polycoef="0.2"/></equality>'
    scene, theirs = both(tmp_path, model(ARM, more=more))
    assert [joint.name for joint in scene.robot.joints] == ["lower"]
    assert scene.entries["robot"]["locked"]["upper"] == pytest.approx(np.deg2rad(30.0) + 0.2)
    assert theirs.nv == 2


CLOSED = ARM + rod("other", '<site name="tip" pos="0.2 0 0" euler="0 20 0"/>', at="0 0 -0.5")


@pytest.mark.parametrize(
    "closure",
    [
        '<connect body1="lower" body2="other" anchor="0.1 0.2 0"/>',
        '<connect body1="lower" anchor="0.1 0.2 0"/>',
        '<connect site1="far" site2="tip"/>',
        '<weld body1="lower" body2="other" anchor="0.1 0 0" relpose="0.1 0 0.2 2 0 1 0"/>',
        '<weld body1="lower" body2="other"/>',
        '<weld site1="far" site2="tip"/>',
    ],
)
def test_closures_hold_where_those_of_mujoco_do(tmp_path, closure):
    """Positions of all rows at a random configuration: the same distances."""
    scene, theirs = both(tmp_path, model(CLOSED, more=f"<equality>{closure}</equality>"))
    (rows,) = scene.parts["constraints"]
    q = np.array([0.3, -0.4, 0.8])
    found, _ = at_rest(scene, theirs, q)
    k = Kinematics(scene.robot)
    k.refresh(q, np.zeros(3))
    ours = rows.residual(k, State(0.0, q, np.zeros(3)))
    gap = found.efc_pos[:3] if len(found.efc_pos) else np.zeros(3)
    assert np.linalg.norm(ours[:3]) == pytest.approx(np.linalg.norm(gap), abs=1e-12)
    assert len(ours) == (6 if "weld" in closure else 3)


ACTUATORS = """
<actuator><motor name="m" joint="upper" gear="20" ctrlrange="-1 1"/>
<position name="p" joint="lower" kp="30" forcerange="-5 5"/>
<motor name="pull" tendon="joints" gear="2"/><motor name="push" site="far" gear="0 0 3"/>
<muscle name="flesh" tendon="line"/></actuator>
"""


def test_actuators_and_passive_forces(tmp_path):
    scene, theirs = both(tmp_path, model(ARM, more=TENDONS + ACTUATORS))
    kinds = {entry["name"]: entry["type"] for entry in scene.entries["actuators"]}
    assert kinds == {"m": "geared_motor", "p": "geared_motor"}
    assert scene.entries["actuators"][0]["limit"] == 20.0
    forces = {entry["name"]: entry for entry in scene.entries["forces"]}
    assert forces["pull"]["type"] == "path_force"
    assert forces["push"]["direction"] == pytest.approx([0.0, 0.0, 1.0])
    assert any("muscle flesh" in line for line in scene.robot.ignored)
    q, v = np.array([0.3, 0.5]), np.array([0.0, -0.7])
    found, _ = at_rest(scene, theirs, q)
    found.qvel[:] = v
    mujoco.mj_forward(theirs, found)
    k, x = Kinematics(scene.robot), State(0.0, q, v)
    k.refresh(q, v)
    names = ("lower_spring", "string_spring")
    ours = sum(
        part.force(k, x, np.zeros(4)) for part in scene.parts["forces"] if part.name in names
    )
    assert ours == pytest.approx(found.qfrc_passive, abs=1e-12)


def test_a_second_free_body_starts_where_it_is_placed(tmp_path):
    scene, theirs = both(tmp_path, model(BOXES))
    robot, data = scene.robot, mujoco.MjData(theirs)
    mujoco.mj_forward(theirs, data)
    places = robot.model.createData()
    pin.framesForwardKinematics(robot.model, places, np.array(scene.initial.q))
    at = places.oMf[robot.model.getFrameId("two")]
    assert robot.model.nv == 12
    assert at.translation == pytest.approx(data.xpos[2], abs=1e-15)
    assert at.rotation.ravel() == pytest.approx(data.xmat[2], abs=1e-15)


def test_the_written_scene_is_the_same_mechanism(tmp_path, capsys):
    scene, _ = both(tmp_path, model(CLOSED, more=TENDONS + ACTUATORS))
    assert main(["import-mjcf", str(tmp_path / "model.xml"), "-o", str(tmp_path / "made")]) == 0
    other = mbd.load_scene(tmp_path / "made" / "m.yaml")
    assert "left out: spatial 'split': pulleys divide it" in capsys.readouterr().out
    q = np.array([0.1, -0.2, 0.3])
    ours, theirs = (pin.crba(s.robot.model, s.robot.model.createData(), q) for s in (scene, other))
    assert np.array_equal(ours, theirs)
    assert other.entries["paths"] == scene.entries["paths"]


def test_a_model_is_a_scene_on_the_command_line(tmp_path, capsys):
    both(tmp_path, model(ARM, more=TENDONS + ACTUATORS))
    assert main(["check", str(tmp_path / "model.xml")]) == 0
    assert "geom" in capsys.readouterr().out
