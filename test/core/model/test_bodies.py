"""Several robots and free bodies in one model: rigid-body motion, momentum, names."""

import numpy as np
import pinocchio as pin
import pytest
from places import ROOT
from scipy.integrate import quad, solve_ivp

from mbd_ros import load_scene, scene_from
from mbd_ros.core.kinematics.poses import world_pose
from mbd_ros.errors import SceneError, SolveError

SATELLITE = """<robot name="satellite">
  <link name="trunk"><inertial><origin xyz="0.1 0 0.05"/><mass value="3.0"/>
    <inertia ixx="0.2" iyy="0.3" izz="0.4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="upper"><inertial><origin xyz="0 0 -0.3"/><mass value="1.0"/>
    <inertia ixx="0.03" iyy="0.03" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0 0 -0.2"/><mass value="0.5"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="swing" type="revolute"><parent link="trunk"/><child link="upper"/>
    <origin xyz="0.2 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="10" velocity="10"/></joint>
  <joint name="twist" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0 0 -0.6"/><axis xyz="0.6 0.8 0"/>
    <limit lower="-3" upper="3" effort="10" velocity="10"/></joint>
</robot>"""
BRICK = """<robot name="brick"><link name="clay"><inertial><mass value="2.0"/>
  <inertia ixx="0.06" iyy="0.05" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""
BOX = {"shape": {"box": [0.1, 0.3, 0.5]}, "mass": 2.0}
TILT = {"xyz": [1.0, 2.0, 3.0], "rpy": [0.3, -0.2, 0.7]}
SPINNING = {"linear": [1.0, -2.0, 0.5], "angular": [0.3, 1.2, -0.4]}
SWUNG = {"linear": [0.1, 0.2, -0.1], "angular": [0.5, 0.2, -0.3]}
EXACT = {"type": "dop853"}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bodies")
    for name, text in (("satellite", SATELLITE), ("brick", BRICK)):
        (folder / f"{name}.urdf").write_text(text, encoding="utf-8")
    return {name: str(folder / f"{name}.urdf") for name in ("satellite", "brick")}


def states(scene, duration, **options):
    return list(scene.simulation(**options).run(scene.initial, duration))


def momenta(robot, x):
    """Linear momentum, and angular momentum about the origin, summed over the bodies."""
    model, data = robot.model, pin.Data(robot.model)
    pin.forwardKinematics(model, data, x.q, x.v)
    linear, angular = np.zeros((2, 3))
    for inertia, place, speed in list(zip(model.inertias, data.oMi, data.v, strict=True))[1:]:
        own = inertia.mass * (speed.linear + np.cross(speed.angular, inertia.lever))
        p = place.rotation @ own
        spin = place.rotation @ (inertia.inertia @ speed.angular)
        linear, angular = linear + p, angular + spin + np.cross(place.act(inertia.lever), p)
    return np.concatenate((linear, angular))


@pytest.mark.parametrize("kind", ["symmetric", "any"])
def test_torque_free_rotation_and_ballistic_flight(kind):
    """A top in closed form or by scipy, and the parabola of its centre."""
    shape = {"cylinder": {"radius": 0.3, "length": 0.2}} if kind == "symmetric" else BOX["shape"]
    body = {"shape": shape, "mass": 2.0, "pose": TILT}
    scene = scene_from({"bodies": {"it": body}, "initial": {"twist": {"it": SPINNING}}})
    start, end = scene.initial, 3.0
    x = states(scene, end, integrator={**EXACT, "tolerance": 1e-12}, dt=0.1)[-1]
    turn = pin.XYZQUATToSE3(start.q).rotation
    fall = 0.5 * end**2 * np.array([0.0, 0.0, -9.81])
    np.testing.assert_allclose(x.q[:3], start.q[:3] + end * turn @ start.v[:3] + fall, atol=1e-9)
    moments = np.diag(scene.robot.inertias()["it"].inertia)
    top = symmetric_top if kind == "symmetric" else any_top
    rotation, w = top(moments, turn, start.v[3:], end)
    np.testing.assert_allclose(x.v[3:], w, atol=1e-9)
    np.testing.assert_allclose(pin.XYZQUATToSE3(x.q).rotation, rotation, atol=1e-9)


def symmetric_top(moments, turn, w, t):
    """Steady precession about L and steady spin. Landau, Lifshitz, Mechanics, 33."""
    along = turn @ (moments * w) / moments[0]
    spin = w[2] * (1.0 - moments[2] / moments[0]) * np.array([0.0, 0.0, 1.0])
    rotation = pin.exp3(along * t) @ turn @ pin.exp3(spin * t)
    return rotation, rotation.T @ along + spin


def any_top(moments, turn, w, t):
    """Euler's equations and R' = R [w] by another integrator."""

    def rates(_, y):
        w, R = y[:3], y[3:].reshape(3, 3)
        slope = np.cross(moments * w, w) / moments
        return np.concatenate((slope, (R @ pin.skew(w)).ravel()))

    start = np.concatenate((w, turn.ravel()))
    y = solve_ivp(rates, (0.0, t), start, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return y[3:].reshape(3, 3), y[:3]


def test_momentum_of_a_free_flying_arm(files):
    """Over 10 s, while springs swing the arm."""
    robot = {"urdf": files["satellite"], "base": "floating", "gravity": [0.0, 0.0, 0.0]}
    initial = {"position": {"swing": 0.5, "twist": -0.8}, "twist": {"base": SWUNG}}
    springs = [
        {"type": "joint_spring", "joint": "swing", "stiffness": 20.0},
        {"type": "joint_spring", "joint": "twist", "stiffness": 5.0},
    ]
    scene = scene_from({"robot": robot, "forces": springs, "initial": initial})
    before = momenta(scene.robot, scene.initial)
    assert np.abs(before).max() > 0.5
    moved = states(scene, 10.0, integrator=EXACT, dt=5e-3)[::100]
    assert max(abs(x.q[7] - scene.initial.q[7]) for x in moved) > 0.5
    assert max(np.abs(momenta(scene.robot, x) - before).max() for x in moved) < 1e-11


def test_arm_and_bodies_that_pull_on_each_other_keep_momentum_and_energy(files):
    entries = {
        "robot": {"urdf": files["satellite"], "base": "floating"},
        "gravity": [0.0, 0.0, 0.0],
        "bodies": {
            "box": {**BOX, "pose": {"xyz": [0.8, 0.1, -0.6]}},
            "ball": {"shape": {"sphere": 0.1}, "mass": 0.4, "pose": {"xyz": [-1.0, 0.0, 0.3]}},
        },
        "forces": [
            {**SPRING, "frame_a": "lower", "frame_b": "box", "point_b": [0.05, 0.1, 0.2]},
            {**SPRING, "frame_a": "ball", "frame_b": "box", "point_a": [0.0, 0.0, -0.1]},
        ],
        "initial": {"position": {"swing": 0.5}, "twist": {"base": SWUNG, "box": SPINNING}},
    }
    scene = scene_from(entries)
    assert [base.name for base in scene.robot.bases] == ["base", "box", "ball"]
    simulation = scene.simulation(integrator={**EXACT, "tolerance": 1e-13}, dt=0.1)
    motion = list(simulation.run(scene.initial, 2.0))
    energies = [simulation.system.energy(x) for x in motion]
    pulls = np.array([momenta(scene.robot, x) for x in motion])
    assert np.ptp([x.v[3] for x in motion]) > 0.1
    assert np.ptp(energies) < 1e-11 * max(energies)
    assert np.abs(pulls - pulls[0]).max() < 1e-11 * np.abs(pulls).max()


def test_the_embedded_scene_keeps_its_momentum():
    scene = load_scene("free_flyer")
    before = momenta(scene.robot, scene.initial)
    after = momenta(scene.robot, states(scene, 1.0, integrator=EXACT, dt=5e-3)[-1])
    np.testing.assert_allclose(after, before, atol=1e-10)


SPRING = {"type": "point_spring", "stiffness": 15.0, "length": 0.3}
STOPS = {
    "type": "joint_stop",
    "joints": ["sat/swing", "sat/twist"],
    "lower": -0.3,
    "upper": 0.4,
    "time_constant": 0.02,
}
STOP = {"type": "joint_stop", "joint": "sat/swing", "upper": 0.6, "restitution": 0.5}
FRICTION = {"type": "dry_friction", "joint": "sat/twist", "limit": 0.5}
DISTANCE = {
    "type": "distance",
    "frame_a": "world",
    "point_a": [0.3, 0.1, 2.0],
    "frame_b": "sat/lower",
    "distance": 1.6,
}
CURVED = {"sat/twist": {"parent": "sat/swing", "polynomial": [0.1, 0.5, 0.2]}}
KINDS = {
    "open chain": {},
    "linear coupling": {"couplings": {"sat/twist": {"parent": "sat/swing", "factor": 0.5}}},
    "coupling": {"couplings": CURVED},
    "rows": {"constraints": [DISTANCE]},
    "stops": {"constraints": [STOPS]},
    "rows and stops": {"constraints": [DISTANCE, STOPS]},
    "impacts": {"constraints": [STOP, {**STOP, "joint": "sat/twist", "lower": -0.05}, FRICTION]},
}


@pytest.mark.parametrize(
    ("kind", "method"),
    [
        *((kind, "rk4") for kind in KINDS),
        ("open chain", "gauss_legendre"),
        ("rows", "gauss_legendre"),
        ("rows and stops", "semi_implicit_euler"),
    ],
)
def test_another_free_body_changes_nothing(kind, method, files):
    """Wherever it stands in q and v: first, last or both."""
    alone = followed(kind, method, files, (), ())
    assert np.abs(alone[-1] - alone[0]).max() > 0.1
    for first, last in (("first",), ()), ((), ("last",)), (("first",), ("last", "more")):
        found = followed(kind, method, files, first, last)
        np.testing.assert_allclose(found, alone, atol=1e-12)


def followed(kind, method, files, first, last):
    """Motion of a satellite beside bricks, shape (n, 17)."""
    pose = {"xyz": [0.3, 0.1, 1.0], "rpy": [0.2, 0.5, -0.1]}
    satellite = {"urdf": files["satellite"], "base": "floating", "pose": pose}
    brick = {"urdf": files["brick"], "base": "floating", "pose": TILT}
    initial = {
        "position": {"sat/swing": 0.5},
        "velocity": {"sat/swing": 2.0},
        "twist": {"sat": SWUNG, **dict.fromkeys((*first, *last), SPINNING)},
    }
    scene = scene_from(
        {
            "robots": {**dict.fromkeys(first, brick), "sat": satellite},
            "bodies": {name: {"urdf": files["brick"], "pose": TILT} for name in last},
            "initial": initial,
            **KINDS[kind],
        }
    )
    robot = scene.robot
    base = next(base for base in robot.bases if base.name == "sat")
    assert base.q.start == 7 * len(first)
    joints = [robot.joint(name) for name in ("sat/swing", "sat/twist")]
    q = [*range(base.q.start, base.q.stop), *(joint.q for joint in joints)]
    v = [*range(base.v.start, base.v.stop), *(joint.v for joint in joints)]
    run = states(scene, 0.2, integrator={"type": method}, dt=2e-3)
    return np.array([np.concatenate((x.q[q], x.v[v])) for x in run])


TWO = """<robot name="two"><link name="world"/>{links}</robot>"""
MOUNT = """<joint name="{0}mount" type="fixed"><parent link="world"/><child link="{0}trunk"/>
  <origin xyz="{1} {2} {3}" rpy="{4} {5} {6}"/></joint>"""


@pytest.mark.parametrize(
    "extra",
    [
        {},
        {"couplings": {"right/swing": {"parent": "left/swing", "factor": -0.5, "offset": 0.1}}},
        {
            "constraints": [
                {"type": "distance", "frame_a": "left/lower", "frame_b": "right/lower"},
            ]
        },
        {"forces": [{**SPRING, "frame_a": "left/lower", "frame_b": "right/lower"}]},
    ],
    ids=["apart", "coupled", "looped", "sprung"],
)
@pytest.mark.parametrize("away", [0.0, 1.0e6])
def test_two_robots_move_as_one_description_of_both(extra, away, files):
    """One URDF that someone wrote by hand, both robots in it."""
    poses = {
        "left": ([away, 0.5, 1.0], [0.1, 0.2, 0.3]),
        "right": ([away + 0.75, -0.25, 1.0], [0.0, 0.0, 1.5]),
    }
    if "constraints" in extra:
        extra = {"constraints": [{**extra["constraints"][0], "distance": 1.1}]}
    start = {"left/swing": 0.4, "left/twist": 0.2, "right/twist": -0.3}
    initial = {"position": start, "velocity": {"left/swing": 1.0, "left/twist": -2.0}}
    robots = {
        name: {"urdf": files["satellite"], "pose": {"xyz": xyz, "rpy": rpy}}
        for name, (xyz, rpy) in poses.items()
    }
    joined = scene_from({"robots": robots, "initial": initial, **extra})
    body = SATELLITE.partition(">")[2].rpartition("<")[0]
    links = "".join(
        MOUNT.format(f"{name}/", *xyz, *rpy) + prefixed(body, name)
        for name, (xyz, rpy) in poses.items()
    )
    whole = scene_from({"initial": initial, **extra}, urdf=TWO.format(links=links))
    assert joined.robot.origin == pytest.approx(whole.robot.origin, abs=1e-9)
    assert (joined.robot.origin[0] != 0.0) == (away > 0.0)
    found, expected = (states(one, 0.1, integrator={"type": "rk4"})[-1] for one in (joined, whole))
    order = [whole.robot.joint(joint.name).v for joint in joined.robot.joints]
    atol = 1e-12 if away == 0.0 else 1e-7  # poses so far away have 1e-10 m themselves
    np.testing.assert_allclose(found.q, expected.q[order], atol=atol)
    np.testing.assert_allclose(found.v, expected.v[order], atol=10 * atol)


def test_far_from_the_origin_a_body_beside_a_robot_moves_as_near_it(files):
    """All of it moved by 10^6 m: the same motion, and poses in the world."""
    found = []
    for away in (0.0, 1.0e6):
        robot = {"urdf": files["satellite"], "pose": {"xyz": [away, 0.5, 1.0]}}
        bodies = {name: {**BOX, "pose": {"xyz": [away, 1.0, 0.0]}} for name in ("box", "other")}
        spring = {**SPRING, "frame_a": "left/lower", "frame_b": "box"}
        initial = {
            "position": {"left/swing": 0.4},
            "pose": {"box": {"xyz": [away + 0.25, 0.5, 0.0]}},
            "twist": {"box": SPINNING},
        }
        scene = scene_from(
            {"robots": {"left": robot}, "bodies": bodies, "forces": [spring], "initial": initial}
        )
        x = states(scene, 0.2, integrator={"type": "rk4"})[-1]
        box = world_pose(scene.robot, x.q[scene.robot.bases[0].q])
        found.append(np.concatenate((x.q[:2], x.v, box - [away, 0, 0, 0, 0, 0, 0])))
    np.testing.assert_allclose(found[1][:-7], found[0][:-7], atol=1e-12)
    np.testing.assert_allclose(found[1][-7:], found[0][-7:], atol=1e-9)


def prefixed(text, name):
    for key in ('name="', 'link="'):
        text = text.replace(key, f"{key}{name}/")
    return text


def test_names_of_robots_and_bodies(files):
    entries = {
        "robot": {"urdf": files["satellite"], "base": "floating"},
        "robots": {"left": {"urdf": files["satellite"], "locked": {"twist": 0.1}}},
        "bodies": {
            "box": {**BOX, "pose": TILT},
            "brick": {"urdf": files["brick"]},
            "table": {"shape": {"cylinder": {"radius": 1.0, "length": 0.1}}, "free": False},
        },
    }
    scene = scene_from(entries)
    robot = scene.robot
    assert [(j.name, j.member) for j in robot.joints] == [
        ("swing", ""),
        ("twist", ""),
        ("left/swing", "left"),
    ]
    assert [(b.name, b.frame) for b in robot.bases] == [
        ("base", "trunk"),
        ("box", "box"),
        ("brick", "brick/clay"),
    ]
    for base in robot.bases:
        joint = robot.model.joints[base.joint]
        assert (joint.idx_q, joint.idx_v) == (base.q.start, base.v.start)
        assert robot.model.frames[robot.frame(base.frame)].parentJoint == base.joint
    assert [(j.q, j.v) for j in robot.joints] == [(7, 6), (8, 7), (9, 8)]
    assert robot.locked == {"left/twist": 0.1}
    for name in ("left", "left/trunk", "table", "world", "universe"):
        assert not robot.point(name).moves
    assert robot.point("brick") == robot.point("brick/clay")._replace(frame="brick")
    np.testing.assert_array_equal(scene.initial.q[10:13], TILT["xyz"])
    assert "body" in scene.check() and "free: base, box, brick" in repr(scene)


ARM = """<robot name="arm"><link name="foot"/><link name="hand"><inertial><mass value="1.0"/>
  <origin xyz="0 0 0.2"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
  <joint name="elbow" type="revolute"><parent link="foot"/><child link="hand"/><axis xyz="1 0 0"/>
    <limit lower="-3" upper="3" effort="10" velocity="10"/></joint></robot>"""


def test_the_example_of_the_page_runs(tmp_path):
    page = (ROOT / "docs/scene.md").read_text(encoding="utf-8")
    _, _, text = page.partition("## Several robots and bodies\n```yaml\n")
    for name, description in (("scene.yaml", text.partition("```")[0]), ("arm.urdf", ARM)):
        (tmp_path / name).write_text(description, encoding="utf-8")
    (tmp_path / "tool.urdf").write_text(BRICK, encoding="utf-8")
    scene = load_scene(tmp_path / "scene.yaml")
    x = states(scene, 0.01)[-1]
    left, right = (scene.robot.joint(f"{side}/elbow").q for side in ("left", "right"))
    assert x.q[right] == pytest.approx(x.q[left]) and np.isfinite(x.q).all()
    assert len(scene.robot.bases) == 6 and "box from" in scene.check()


def test_what_a_description_says_besides_goes_by_the_name_of_its_robot(tmp_path):
    """Mimic joints, friction and damping, doubts, names for topics."""
    said = ARM.partition("</robot>")[0] + (
        '<link name="thumb"/><joint name="grip" type="revolute"><parent link="hand"/>'
        '<child link="thumb"/><axis xyz="1 0 0"/><dynamics damping="0.5"/>'
        '<mimic joint="elbow" multiplier="2" offset="0.1"/>'
        '<limit lower="-3" upper="3" effort="10" velocity="10"/></joint></robot>'
    )
    (tmp_path / "arm.urdf").write_text(said, encoding="utf-8")
    entry = {"urdf": str(tmp_path / "arm.urdf"), "rename": {"elbow": "bend"}}
    scene = scene_from({"robots": {"left": entry, "right": entry}})
    assert scene.couplings.parents == {"left/grip": "left/bend", "right/grip": "right/bend"}
    assert scene.robot.joint("right/bend").urdf_name == "right/elbow"
    assert {name: rub.damping for name, rub in scene.robot.joint_friction.items()} == {
        "left/grip": 0.5,
        "right/grip": 0.5,
    }
    assert [line.partition(":")[0] for line in scene.robot.inertia_warnings] == ["left", "right"]
    assert "damping of left/grip, right/grip" in scene.check()


def test_poses_and_velocities_at_the_start():
    given = {
        "pose": {"box": {"xyz": [1, 2, 3], "quaternion": [0, 0, 2, 2]}, "ball": {}},
        "twist": {
            "box": {"linear": [1, 0, 0], "angular": [0, 2, 0], "expressed_in": "world"},
            "ball": {"angular": [0, 0, 1]},
        },
    }
    ball = {"shape": {"sphere": 0.1}, "mass": 1.0, "pose": TILT}
    scene = scene_from({"bodies": {"box": BOX, "ball": ball}, "initial": given})
    half = np.sqrt(0.5)
    np.testing.assert_allclose(scene.initial.q[:7], [1, 2, 3, 0, 0, half, half], atol=1e-15)
    np.testing.assert_allclose(scene.initial.q[7:], [0, 0, 0, 0, 0, 0, 1])
    np.testing.assert_allclose(scene.initial.v[:6], [0, -1, 0, 2, 0, 0], atol=1e-15)
    np.testing.assert_allclose(scene.initial.v[6:], [0, 0, 0, 0, 0, 1])


@pytest.mark.parametrize(
    ("shape", "half", "radius"),
    [
        ({"sphere": 0.3}, 0.3, lambda z: np.sqrt(0.09 - z * z)),
        ({"cylinder": {"radius": 0.2, "length": 0.7}}, 0.35, lambda z: 0.2),
        (
            {"capsule": {"radius": 0.2, "length": 0.7}},
            0.55,
            lambda z: np.sqrt(0.04 - max(abs(z) - 0.35, 0.0) ** 2),
        ),
    ],
    ids=["sphere", "cylinder", "capsule"],
)
def test_moments_of_round_shapes_are_those_of_their_discs(shape, half, radius):
    scene = scene_from({"bodies": {"it": {"shape": shape, "mass": 1.7}}})

    def total(of_disc):
        return (
            2.0 * quad(of_disc, 0.0, half, points=[0.35] if half > 0.35 else None, epsabs=1e-13)[0]
        )

    volume = total(lambda z: radius(z) ** 2)
    along = total(lambda z: radius(z) ** 4 / 2.0) / volume
    across = total(lambda z: radius(z) ** 2 * (radius(z) ** 2 / 4.0 + z * z)) / volume
    found = scene.robot.inertias()["it"]
    assert (found.mass, found.lever.tolist()) == (1.7, [0.0, 0.0, 0.0])
    np.testing.assert_allclose(found.inertia, 1.7 * np.diag([across, across, along]), rtol=1e-9)


def test_a_box_and_given_moments():
    entry = {"shape": {"box": [0.2, 0.4, 0.6]}, "mass": 3.0}
    scene = scene_from({"bodies": {"box": entry}})
    np.testing.assert_allclose(
        scene.robot.inertias()["box"].inertia, np.diag([0.13, 0.1, 0.05]), rtol=1e-14
    )
    other = scene.with_({"box.mass": 6.0, "box.inertia": [0.1, 0.2, 0.25]})
    assert other.robot.inertias()["box"].mass == 6.0
    np.testing.assert_allclose(np.diag(other.robot.inertias()["box"].inertia), [0.1, 0.2, 0.25])


def test_other_inertias_of_links_of_several(files):
    entries = {
        "robots": {"left": {"urdf": files["satellite"]}, "right": {"urdf": files["satellite"]}},
        "bodies": {"box": BOX, "brick": {"urdf": files["brick"]}},
    }
    heavy = (5.0, [0.0, 0.0, 0.1], np.eye(3))
    names = ("right/lower", "box", "brick")
    scene = scene_from(entries).with_inertias(dict.fromkeys(names, heavy))
    masses = {name: inertia.mass for name, inertia in scene.robot.inertias().items()}
    assert [masses[name] for name in names] == [5.0] * 3
    assert masses["left/lower"] == 0.5 and masses["right/upper"] == 1.0
    assert pin.computeTotalMass(scene.robot.model) == pytest.approx(1.5 + 6.0 + 10.0)
    for name, message in (
        ("left/nose", "left: .*: no link 'nose'; the links are trunk, upper"),
        ("nose", "no link 'nose'; the links are left, left/upper"),
    ):
        with pytest.raises(SceneError, match=message):
            scene.with_inertias({name: heavy})


def test_a_body_without_mass_is_named(files):
    shell = '<robot name="shell"><link name="skin"/></robot>'
    entries = {"robot": {"base": "floating"}, "bodies": {"box": BOX}}
    with pytest.raises(SolveError, match="the floating base moves nothing that has mass"):
        states(scene_from(entries, urdf=shell), 0.1)
    entries = {"bodies": {"box": BOX, "thin": {**BOX, "inertia": [0.0, 0.0, 0.0]}}}
    with pytest.raises(SolveError, match="free body 'thin' moves nothing that has mass"):
        states(scene_from(entries), 0.1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"bodies": {"box": {"mass": 1.0}}}, "bodies.box: give either 'urdf' or 'shape'"),
        ({"bodies": {"box": {"shape": {"box": [1, 1, 1]}}}}, "bodies.box: key 'mass' is missing"),
        ({"bodies": {"box": {**BOX, "mass": 0.0}}}, "bodies.box.mass: 0 is out of range"),
        (
            {"bodies": {"box": {"shape": {"cone": 1.0}, "mass": 1.0}}},
            "bodies.box.shape: expected one of box, sphere, cylinder, capsule, got cone",
        ),
        (
            {"bodies": {"box": {"shape": {"cylinder": 1.0}, "mass": 1.0}}},
            "bodies.box.shape.cylinder: expected a mapping, got 1.0",
        ),
        ({"bodies": {"box": {**BOX, "inertia": [1.0]}}}, "box.inertia: expected 3 numbers or 3 x"),
        (
            {"bodies": {"box": {**BOX, "inertia": [1.0, 1.0, 9.0]}}},
            "link 'box': inertia violates the triangle inequality",
        ),
        ({"bodies": {"my box": BOX}}, "bodies.my box: is no ROS name"),
        (
            {"bodies": dict.fromkeys([f"box_{i}" for i in range(50)], BOX)},
            "there are 302 moving joints, where a free body counts as six; at most 300",
        ),
        ({"bodies": {"base": BOX}}, "name 'base' is reserved"),
        ({"bodies": {"sat": BOX}}, "name 'sat' is used twice"),
        (
            {"bodies": {"box": {**BOX, "pose": {"rpy": [0, 0, 0], "quaternion": [0, 0, 0, 1]}}}},
            "bodies.box.pose: give either 'rpy' or 'quaternion'",
        ),
        (
            {"initial": {"pose": {"box": {"quaternion": [0, 0, 0, 0]}}}},
            "initial.pose.box.quaternion: [0.0, 0.0, 0.0, 0.0] says no rotation",
        ),
        (
            {"initial": {"twist": {"sat": {}}}},
            "initial.twist.sat: is no free body; box moves freely",
        ),
        ({"robots": {"sat": {}}}, "robots.sat: key 'urdf' is missing"),
        (
            {"robot": {"urdf": "x", "gravity": [0, 0, 0]}, "gravity": [0, 0, 1]},
            "gravity: given tw",
        ),
        ({"gravity": [0, 0]}, "gravity: expected 3 numbers, got [0, 0]"),
        ({"couplings": {"sat/swing": {"parent": "swing", "factor": 1.0}}}, "no joint 'swing'"),
    ],
)
def test_mistakes_are_named(changes, message, files):
    entries = {"robots": {"sat": {"urdf": files["satellite"]}}, "bodies": {"box": BOX}, **changes}
    with pytest.raises(SceneError) as caught:
        scene_from(entries)
    assert message in str(caught.value)
