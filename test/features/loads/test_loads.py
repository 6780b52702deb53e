"""Loads on a body that is cut free: balance, joints, muscles, closed forms, bad input."""

import subprocess
import sys

import numpy as np
import pinocchio as pin
import pytest
from loads import RATE, ROD, spin

import mbd_ros as mbd
from mbd_ros.core.contracts import Wrench
from mbd_ros.core.state import State
from mbd_ros.errors import DataError, MbdError, ModelError, SceneError
from mbd_ros.features.loads.free_body import BodyWrench, FreeBody, balance
from mbd_ros.files.table import Column, Result, Table
from mbd_ros.scene.schema.locate import embedded_scenes

ROBOTS = {name for name in embedded_scenes() if not name.startswith("particles/")}
MANY = {"benchmark/a02_four_bars_40", "benchmark/x06_chain"}
PLATES = {"prosthetic_leg_stance", "level_walker"}  # plates and states that a run does not write


def spun(offset=(0.0, 0.0, 0.0)):
    """A rod of 2 kg with a tip of 0.5 kg that spins at a constant rate about a vertical hinge."""
    place = " ".join(map(str, offset))
    text = ROD.replace('<origin xyz="0 0 0"/>\n', f'<origin xyz="{place}"/>\n')
    return mbd.scene_from(urdf=text)


def vector(samples, name):
    return np.column_stack([samples[f"{name}_{axis}"] for axis in "xyz"])


def bodies(scene):
    return [link for link, inertia in scene.robot.inertias().items()]


def everywhere(scene, rng, most=20):
    """The bodies of a scene, whole and cut at fixed joints too, in a random motion with loads."""
    robot, links = scene.robot, bodies(scene)
    for link in links[:: -(-len(links) // most)]:
        for cuts in (False, True):
            try:
                whole = FreeBody(robot, link)
                names = fixed_joints(whole) if cuts else ()
                body = FreeBody(robot, link, names) if names else whole
            except ModelError as error:
                assert "has no mass" in str(error)
                continue
            if cuts and not names:
                continue
            q = pin.integrate(robot.model, robot.neutral(), rng.normal(size=robot.model.nv))
            v, a = rng.normal(size=(2, robot.model.nv))
            body.k.refresh(q, v)
            acting = [
                BodyWrench("push", "force", Wrench(on, *rng.normal(size=(3, 3)))) for on in links
            ]
            yield body, *body.loads(State(0.0, q, v), a, acting)


def fixed_joints(body):
    edges = body._tree.edges
    here = [edges[i] for i in edges if body._robot.model.frames[i].name == body.link]
    return [edge.name for edge in here if not edge.joint and edge.parent]


def test_every_body_of_every_scene_balances_under_random_loads():
    """Any state, any accelerations, a wrench on every link; also cut at fixed joints."""
    rng, seen = np.random.default_rng(36), 0
    for name in sorted(ROBOTS - MANY):
        for body, loads, motion in everywhere(mbd.load_scene(name), rng, most=3):
            assert balance(loads, body.inertia, motion).off <= 1e-12, (name, body.link)
            seen += 1
    assert seen > 60


@pytest.mark.soak
@pytest.mark.parametrize("name", sorted(ROBOTS - PLATES))
def test_every_body_of_every_scene_balances_in_its_own_motion(name):
    scene = mbd.load_scene(name)
    motion = scene.simulate(2e-4 if "ndrews" in name else 0.02)
    links = bodies(scene)
    for link in links[:: -(-len(links) // 20)]:
        try:
            samples = scene.loads(motion, body=link)["samples"]
        except SceneError as error:
            assert "has no mass" in str(error)
            continue
        assert samples["balance.off"].max() <= 1e-9


@pytest.fixture(scope="module")
def walk():
    """The leg that rolls over its foot, and its motion."""
    scene = mbd.load_scene("prosthetic_leg_roll_over")
    return scene, scene.simulate(0.1)


def axis_of(model, name):
    """Of a hinge, in axes of its child."""
    data, joint = pin.Data(model), model.getJointId(name)
    pin.computeJointJacobians(model, data, pin.neutral(model))
    J = pin.getJointJacobian(model, data, joint, pin.LOCAL)
    return J[3:, model.joints[joint].idx_v]


def test_along_its_axis_a_joint_transmits_effort_spring_and_couplings(walk):
    """Of the knee and the ankle, on both of their bodies; contacts act at their points."""
    scene, motion = walk
    table = scene.inverse(motion)["samples"]
    shank, foot = (scene.loads(motion, body=body)["samples"] for body in ("shank", "foot"))
    spring = {
        "knee": -600.0 * (table["knee.position"] + 0.1) - 10.0 * table["knee.velocity"],
        "ankle": -250.0 * table["ankle.position"] - 5.0 * table["ankle.velocity"],
    }
    slides = "knee_slide_x", "knee_slide_y"
    speed, moves = table["knee.velocity"], np.abs(table["knee.velocity"]) > 0.01
    pull = sum(table[f"{one}.multiplier"] * motion["samples"][f"{one}.velocity"] for one in slides)
    spring["knee"] -= np.divide(pull, speed, where=moves, out=np.zeros_like(pull))
    for joint, on in (("knee", shank), ("ankle", foot)):
        across = vector(on, f"{joint}.torque") @ axis_of(scene.robot.model, joint)
        expected = table[f"{joint}.effort"] + spring[joint]
        assert across[moves] == pytest.approx(expected[moves], abs=1e-9 * np.abs(expected).max())
    pushed = [name for name in foot if name.startswith(("heel", "toe")) and "point_z" in name]
    assert len(pushed) == 2
    assert all(foot[name] == pytest.approx(-0.06825) for name in pushed)
    assert vector(foot, "ankle.force").std() > 1.0


def test_action_and_reaction(walk):
    """The ankle exerts on the shank what it exerts on the foot, opposite, in world axes."""
    scene, motion = walk
    table, k = scene.inverse(motion)["samples"], pin.Data(scene.robot.model)
    on = {body: scene.loads(motion, body=body)["samples"] for body in ("shank", "foot")}
    model = scene.robot.model
    angle = table["ankle.position"]
    force = {body: vector(each, "ankle.force") for body, each in on.items()}
    joint = model.getJointId("ankle")
    for row in range(0, len(angle), 10):
        q = pin.neutral(model)
        q[model.joints[joint].idx_q] = angle[row]
        pin.forwardKinematics(model, k, q)
        R = k.liMi[joint].rotation
        assert R @ force["foot"][row] == pytest.approx(-force["shank"][row], abs=1e-9)


def test_a_cut_at_a_fixed_joint(walk):
    """A tube that hangs on the shank: what it is held by is its weight and inertia."""
    scene, motion = walk
    found = scene.loads(motion, body="tibial_pylon", joints=["tibial_pylon_fix"])
    samples = found["samples"]
    assert found.metadata["mass"] == pytest.approx(0.0629248)
    carried = vector(samples, "weight.force") + vector(samples, "inertia.force")
    assert vector(samples, "tibial_pylon_fix.force") == pytest.approx(-carried, abs=1e-12)


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (100.0, -70.0, 3.0)])
def test_a_spinning_rod(offset):
    """Closed form: m omega^2 l of rod and tip towards the hinge; 100 m away the same."""
    scene = spun(offset)
    whole = scene.loads(spin(), body="rod")
    centre = (2.0 * 0.5 + 0.5 * 1.0) * RATE**2
    force = vector(whole["samples"], "hinge.force")
    assert force == pytest.approx(np.tile([-centre, 0.0, 2.5 * 9.81], (5, 1)), rel=1e-9, abs=1e-9)
    assert whole.metadata["links"] == ["rod", "tip"]
    cut = scene.loads(spin(), body="rod", joints=["weld"], units="mm")
    pull, moment = (vector(cut["samples"], name) for name in ("weld.force", "hinge.torque"))
    assert pull[:, 0] == pytest.approx(0.5 * RATE**2, rel=1e-9)
    assert moment[:, 1] == pytest.approx(-1000.0 * 9.81 * (2.0 * 0.5 + 0.5), rel=1e-9)
    assert cut.metadata["mass"] == pytest.approx(0.002)
    assert cut["samples"].column("hinge.torque_y").unit == "N·mm"
    push = vector(cut["samples"], "gravity.acceleration")
    assert push[:, 2] == pytest.approx(-9810.0)


def test_muscles_pull_at_their_points():
    """Joint loads with muscles are those of `muscles --reactions`, which takes another way."""
    scene = mbd.load_scene("muscle_leg")
    motion = scene.simulate(0.02)
    shares = scene.muscle_forces(motion, reserves=100.0, reactions="child", links=["tibia"])
    link = "tibia"
    found = scene.loads(motion, body=link, muscle_forces=shares)
    names = [n for n in found["samples"] if n.endswith(".force_x")]
    kinds = found.metadata["kinds"]
    joint = found.metadata["joints"][0]
    expected = vector(shares["samples"], f"{link}.load.force")
    exerted = vector(found["samples"], f"{joint}.force")
    assert exerted == pytest.approx(expected, rel=1e-6, abs=1e-6)
    assert "muscle" in kinds.values() and len(names) > 3
    assert found["samples"]["balance.off"].max() <= 1e-9
    still = scene.loads(motion, body=link)  # tensions of the simulation itself
    off = vector(still["samples"], f"{joint}.force") - expected
    assert np.abs(off).max() > 1.0


def test_planted_mistakes_do_not_balance(walk):
    """Units of a moment or a point, axes of the world, a load left out, the wrong sign."""
    scene, _ = walk
    (body, loads, motion), *_ = (
        each for each in everywhere(scene, np.random.default_rng(1)) if each[0].link == "shank"
    )
    assert balance(loads, body.inertia, motion).off <= 1e-12
    joint = loads[0]
    R = body.k.rotation(body._point)
    wrong = [
        joint._replace(moment=1000.0 * joint.moment),
        joint._replace(point=1000.0 * (joint.point + 0.01)),
        joint._replace(force=R @ joint.force),
        joint._replace(force=-joint.force),
        joint._replace(force=0.0 * joint.force),
    ]
    for one in wrong:
        assert balance([one, *loads[1:]], body.inertia, motion).off > 1e-3
    turned = motion._replace(gravity=R @ motion.gravity)
    assert balance(loads, body.inertia, turned).off > 1e-3
    slower = motion._replace(angular_velocity=motion.angular_velocity * np.pi / 180.0)
    assert balance(loads, body.inertia, slower).off > 1e-3


def test_peaks_and_chosen_instants(walk):
    scene, motion = walk
    found = scene.loads(motion, body="foot", at=[0.0234])
    samples, instants = found["samples"], found["instants"]
    names = dict(zip(instants["name"], instants["row"], strict=True))
    size = np.linalg.norm(vector(samples, "ankle.force"), axis=1)
    assert names["ankle.force"] == size.argmax()
    assert samples["time"][names["chosen"]] == pytest.approx(0.024)
    assert set(np.flatnonzero(samples["is_instant"])) == set(instants["row"])


@pytest.mark.parametrize(
    ("words", "error", "says"),
    [
        ({"body": "shin"}, SceneError, "no frame 'shin'; the links are"),
        ({"body": "universe"}, SceneError, "unknown link 'universe'"),
        ({"body": "knee_slider"}, SceneError, "body 'knee_slider' has no mass"),
        (
            {"body": "foot", "joints": ["knee"]},
            SceneError,
            "not one of this body, accepted",
        ),
        ({"body": "foot", "at": [3.0]}, DataError, "--at 3: is outside of the motion"),
        ({"body": "foot", "units": "inch"}, DataError, "--units inch: accepted: m"),
        ({"body": "foot", "time_range": (5.0, 6.0)}, DataError, "contains no sample"),
    ],
)
def test_bad_input(walk, words, error, says):
    scene, motion = walk
    with pytest.raises(error, match=says):
        scene.loads(motion, **words)


def test_tensions_that_are_not_there():
    scene = mbd.load_scene("muscle_leg")
    motion = scene.simulate(0.01)
    with pytest.raises(MbdError, match="no column"):
        scene.loads(motion, body="tibia", muscle_forces=spin())
    columns = [c for c in motion["samples"].columns if not c.name.endswith(".tension")]
    found = scene.loads(Result({"samples": Table(columns)}), body="tibia")
    assert any("are taken as 0" in text for text in found.metadata["remarks"])


def test_the_command(walk, tmp_path):
    _, motion = walk
    motion.to(tmp_path / "walk.csv")
    words = ["loads", "prosthetic_leg_roll_over", str(tmp_path / "walk.csv"), "--body", "shank"]
    words += ["-o", str(tmp_path / "shank.npz"), "--at", "0.05"]
    run = [sys.executable, "-m", "mbd_ros", *words]
    done = subprocess.run(run, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "cut at knee, ankle" in done.stdout
    assert mbd.read_result(tmp_path / "shank.npz")["samples"]["balance.off"].max() <= 1e-9


def test_a_force_plate():
    """The load of the plate arrives whole, in axes of the foot, and the ankle carries it."""
    scene = mbd.load_scene("prosthetic_leg_stance")
    motion = scene.simulate(0.02)
    time = motion["samples"]["time"]
    pushed = {"force.z": 700.0, "force.x": 40.0, "torque.y": -30.0}
    names = [f"{word}.{axis}" for word in ("force", "torque") for axis in "xyz"]
    columns = [
        Column(f"ground_reaction.{n}", np.full(len(time), pushed.get(n, 0.0))) for n in names
    ]
    plate = Result({"samples": Table([Column("time", time), *columns])})
    found = scene.loads(motion, body="foot", wrenches=plate)
    assert found.metadata["kinds"] == {"ankle": "joint", "ground_reaction": "external wrench"}
    samples = found["samples"]
    size = np.linalg.norm(vector(samples, "ground_reaction.force"), axis=1)
    assert size == pytest.approx(np.hypot(700.0, 40.0))
    assert samples["balance.off"].max() <= 1e-12


def test_a_free_body_a_hundred_metres_away():
    """The balance loses no digits that count."""
    robot, rng = mbd.load_scene("prosthetic_leg_roll_over").robot, np.random.default_rng(2)
    body = FreeBody(robot, "shank")
    q, (v, a) = robot.neutral(), rng.normal(size=(2, robot.model.nv))
    q[:3] += [100.0, -70.0, 30.0]
    body.k.refresh(q, v)
    place = body.k.position(body._point)
    push = [BodyWrench("push", "force", Wrench("foot", place, *rng.normal(size=(2, 3))))]
    loads, motion = body.loads(State(0.0, q, v), a, push)
    assert balance(loads, body.inertia, motion).off <= 1e-12
