"""What the page draws, by numbers: poses, lines, arrows, colours, curves; no browser, no viser."""

import io

import numpy as np
import pinocchio as pin
import pytest
from places import RECORDINGS

from mbd_ros.api import load_scene, scene_from
from mbd_ros.features.simulation.job import simulate
from mbd_ros.scene.schema.locate import embedded_scenes
from mbd_ros.view import surfaces
from mbd_ros.view.controls import Rerun, mp4
from mbd_ros.view.curves import ALL, Curves, MotionCurves, cursor
from mbd_ros.view.frames import COUPLING, Frames, arrow_ends, cone_lines, tension_colours, upright
from mbd_ros.view.motion import still, viewed_motion
from mbd_ros.view.page import advanced, nearest_row
from mbd_ros.view.solids import equal_box, solids_of, solids_of_scene

ARM = """
<robot name="arm">
  <link name="base"/>
  <link name="arm">
    {visual}
    <inertial><origin xyz="0.5 0 0"/><mass value="2"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.17" iyz="0" izz="0.17"/></inertial>
  </link>
  <joint name="elbow" type="revolute">
    <parent link="base"/><child link="arm"/><origin xyz="0 0 1"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="10" velocity="10"/>
  </joint>
</robot>
"""


def arm(tmp_path, visual="", **sections):
    (tmp_path / "arm.urdf").write_text(ARM.format(visual=visual), encoding="utf-8")
    return scene_from({"robot": {"urdf": str(tmp_path / "arm.urdf")}, **sections})


def volume(surface):
    """By the divergence theorem; positive where all triangles look outwards."""
    a, b, c = surface.vertices[surface.triangles.astype(int)].astype(float).transpose(1, 0, 2)
    return float((a * np.cross(b, c)).sum() / 6.0)


@pytest.mark.parametrize(
    ("surface", "expected", "rel"),
    [
        (surfaces.box([1.0, 2.0, 3.0]), 6.0, 1e-6),
        (surfaces.sphere(1.0), 4.0 * np.pi / 3.0, 0.04),
        (surfaces.cylinder(1.0, 2.0), 2.0 * np.pi, 0.02),
        (surfaces.capsule(1.0, 2.0), 2.0 * np.pi + 4.0 * np.pi / 3.0, 0.04),
        (surfaces.bone(np.array([0.0, 0.0, 1.0])), 2.0 * 0.12**2 / 3.0, 1e-6),
    ],
)
def test_surfaces_enclose_the_volume_of_the_body(surface, expected, rel):
    assert volume(surface) == pytest.approx(expected, rel=rel)


def test_the_box_of_an_inertia_is_the_box_it_came_from():
    turn = pin.exp3(np.array([0.3, -0.2, 0.5]))
    inertia = pin.Inertia.FromBox(3.0, 0.1, 0.2, 0.4).se3Action(pin.SE3(turn, np.zeros(3)))
    size, axes = equal_box(inertia)
    assert sorted(size) == pytest.approx([0.1, 0.2, 0.4])
    assert np.abs(np.linalg.det(axes)) == pytest.approx(1.0)


def test_a_pose_is_that_of_the_angle(tmp_path):
    scene = arm(tmp_path)
    drawn = Frames(scene).at(still(scene).states[0]._replace(q=np.array([0.8])))
    assert drawn.poses[1] == pytest.approx([0.0, 0.0, 1.0, np.cos(0.4), 0.0, np.sin(0.4), 0.0])


def test_visuals_come_from_the_description_with_place_and_colour(tmp_path):
    visual = """<visual><origin xyz="1 0 0" rpy="0 0 1.5707963267948966"/>
      <geometry><box size="0.4 0.2 0.2"/></geometry>
      <material name="m"><color rgba="1 0.5 0 1"/></material></visual>"""
    solids, lacking = solids_of(arm(tmp_path, visual).robot)
    drawn = [s for s in solids if s.link == "arm"]
    assert lacking == [] and [s.colour for s in drawn] == [(255, 128, 0)]
    extent = np.ptp(drawn[0].surface.vertices, axis=0)
    assert extent == pytest.approx([0.2, 0.4, 0.2], abs=1e-6)


def test_a_missing_mesh_is_drawn_as_its_bone_and_named_once(tmp_path):
    visual = '<visual><geometry><mesh filename="package://nowhere/m.stl"/></geometry></visual>'
    solids, lacking = solids_of(arm(tmp_path, visual * 2).robot)
    assert lacking == ["package://nowhere/m.stl: not found or no mesh, drawn as a bone"]
    assert [s.link for s in solids if s.joint] == ["arm", "arm"]  # bone and box of the inertia


def test_a_mesh_beside_the_description_is_found_in_its_package(tmp_path):
    package = tmp_path / "my_arm"
    (package / "meshes").mkdir(parents=True)
    text = "o m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    (package / "meshes/m.obj").write_text(text, encoding="utf-8")
    visual = """<visual><geometry><mesh filename="package://my_arm/meshes/m.obj" scale="2 1 1"/>
      </geometry></visual>"""
    solids, lacking = solids_of(arm(package, visual).robot)
    assert lacking == []
    assert max(volume(s.surface) for s in solids if s.joint) == pytest.approx(2.0 / 6.0)


ROBOTS = [n for n in embedded_scenes() if "40" not in n and not n.startswith("particles/")]


@pytest.mark.parametrize("name", ROBOTS)
def test_every_embedded_scene_shows_its_start(name):
    scene = load_scene(name)
    solids, lacking = solids_of(scene.robot)
    drawn = Frames(scene).at(still(scene).states[0])
    assert solids and lacking == [] and np.isfinite(drawn.poses).all()
    assert np.isfinite(drawn.lines).all() and len(drawn.lines) == len(drawn.colours)


@pytest.mark.parametrize(
    ("file", "links"),
    [
        ("psyonic_hand/psyonic_ability_hand_right_large.urdf", 11),
        ("panda/panda_nohand.urdf", 8),
    ],
)
def test_robots_whose_meshes_are_not_here_show_as_bones(file, links):
    scene = scene_from({"robot": {"urdf": str(RECORDINGS / file)}})
    solids, lacking = solids_of(scene.robot)
    assert len({s.link for s in solids}) >= links
    assert len(lacking) == len(set(lacking)) and all("drawn as a bone" in line for line in lacking)


def test_arrows_of_a_motion_are_the_forces_that_hold_it():
    """Two resting contact forces on a block: they balance its weight, and one the other."""
    scene = load_scene("four_legged_table")
    frames = Frames(scene)
    motion = viewed_motion(scene, simulate(scene, 0.05), frames.rows)
    drawn = frames.at(motion.states[-1], motion.accelerations[-1], motion.multipliers[-1])
    mass = pin.computeTotalMass(scene.robot.model)
    assert drawn.arrows[:, 1].sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-6)
    assert np.abs(drawn.arrows[:, 1, 2]).max() == pytest.approx(9.80665 * mass, rel=1e-3)
    assert len(drawn.cones) == 1


def test_a_path_over_a_surface_is_as_long_as_its_length():
    scene = load_scene("muscle_leg")
    frames, x = Frames(scene), still(scene).states[0]
    drawn = frames.at(x)
    k = scene.system().k
    k.refresh(x.q, x.v)
    lengths = sum(muscle.path.length(k, x) for muscle in scene.muscles)
    lines = drawn.lines[(drawn.colours != COUPLING).any(axis=1)]
    pieces = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)
    assert pieces.sum() == pytest.approx(lengths, rel=0.01)


def test_colours_go_from_slack_to_the_largest_tension():
    colours = tension_colours(np.array([0.0, 50.0, 100.0, np.nan]))
    assert colours[0] == pytest.approx(colours[3])
    assert colours[1] == pytest.approx((colours[0] + colours[2]) / 2.0)
    assert colours[2, 0] > 200.0 > colours[0, 0]


def test_an_arrow_is_its_force_times_the_scale():
    arrows = np.array([[[1.0, 0.0, 0.0], [0.0, 0.0, 10.0]], [[0.0] * 3, [0.0] * 3]])
    assert arrow_ends(arrows, 0.01).tolist() == [[[1.0, 0.0, 0.0], [1.0, 0.0, 0.1]]]


def test_a_cone_opens_by_its_coefficient():
    lines = cone_lines(np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 10.0, 0.5]]), 0.1, around=8)
    rim = lines[:8, 1]
    assert rim[:, 2] == pytest.approx(np.full(8, 2.0))
    assert np.hypot(rim[:, 0], rim[:, 1]) == pytest.approx(np.full(8, 0.5))


def test_curves_are_the_columns_of_the_motion(tmp_path):
    scene = arm(tmp_path)
    result = simulate(scene, 0.1)
    motion = viewed_motion(scene, result, Frames(scene).rows)
    curves = MotionCurves(scene, motion, ())
    assert np.array_equal(
        curves.of("elbow", "position").values[:, 0], result["samples"]["elbow.position"]
    )
    assert curves.of(ALL, "velocity").names == ("elbow",)
    assert curves.values("elbow", 0)[0] == "position 0 rad"
    assert motion.times[-1] == pytest.approx(0.1)
    assert curves.of(ALL, "energy").values[:, 0] == pytest.approx(result["samples"]["energy"])


def test_a_free_body_has_curves_of_its_place_and_none_of_efforts():
    scene = load_scene("sphere_on_plane")
    curves = MotionCurves(scene, viewed_motion(scene, simulate(scene, 0.02), ()), ())
    name = scene.robot.bases[0].name
    assert curves.of(name, "position").names == (f"{name}.x", f"{name}.y", f"{name}.z")
    assert curves.of(ALL, "effort").names == ()
    assert len(curves.values(name, 0)) == 3


def test_the_cursor_rises_at_its_time():
    curves = Curves(np.array([0.0, 1.0, 2.0]), ("a",), np.array([[-1.0], [0.0], [3.0]]))
    assert cursor(curves, 1.0).tolist() == [-1.0, -1.0, 3.0]
    assert cursor(curves, 2.0).tolist() == [-1.0, -1.0, 3.0]


def test_time_begins_again_or_stays_at_the_end():
    assert advanced(1.9, 0.2, 2.0, loops=True) == pytest.approx(0.1)
    assert advanced(1.9, 0.2, 2.0, loops=False) == 2.0
    assert [nearest_row(np.array([0.0, 0.1, 0.2]), t) for t in (-1.0, 0.1, 0.15, 9.0)] == [
        *(0, 1, 1, 2)
    ]


def test_a_run_from_another_start_begins_there(tmp_path):
    rerun = Rerun(arm(tmp_path), ())
    rerun.duration = 0.01
    _, result, _ = rerun.run({"elbow": 0.7})
    assert rerun.starts["elbow"] == (0.0, -3.0, 3.0)
    assert result["samples"]["elbow.position"][0] == pytest.approx(0.7)


def test_a_run_with_another_number_has_it(tmp_path):
    spring = {"type": "joint_spring", "joint": "elbow", "stiffness": 4.0}
    scene, name = arm(tmp_path, forces=[spring]), "elbow_joint_spring.stiffness"
    rerun = Rerun(scene, [name])
    rerun.duration = 0.01
    assert rerun.numbers[name] == (4.0, 0.0, 8.0)
    ran, _, _ = rerun.run({name: 7.0})
    assert ran.entries["forces"][0]["stiffness"] == 7.0


def test_reactions_balance_weight_and_inertia_of_all_that_hangs_on_a_joint():
    """By the change of momenta of the whole, an independent way: force and moment at the root."""
    scene = load_scene("controlled_arm")
    frames, model = Frames(scene), scene.robot.model
    motion = viewed_motion(scene, simulate(scene, 0.1), frames.rows)
    x, a = motion.states[-1], motion.accelerations[-1]
    forces, moments = frames.reactions(x, a, motion.multipliers[-1])
    data = model.createData()
    pin.computeCentroidalMomentumTimeVariation(model, data, x.q, x.v, a)
    mass, weight = pin.computeTotalMass(model), model.gravity.linear
    force = data.dhg.linear - mass * weight
    assert forces[0, 1] == pytest.approx(force, abs=1e-9)
    arm = data.com[0] - forces[0, 0]
    assert moments[0, 1] == pytest.approx(data.dhg.angular + np.cross(arm, force), abs=1e-9)


def test_a_coupled_joint_is_joined_by_a_line_to_the_one_that_it_follows():
    scene = load_scene("prosthetic_leg").with_(
        couplings={"ankle": {"parent": "hip_flexion", "factor": 0.5}}
    )
    drawn = Frames(scene).at(still(scene).states[0])
    coupled = drawn.lines[(drawn.colours == COUPLING).all(axis=1)]
    joints = scene.robot.model.names.tolist()
    ends = [drawn.poses[joints.index(name), :3] for name in ("hip_flexion", "ankle")]
    np.testing.assert_allclose(coupled, [ends], atol=1e-12)


@pytest.mark.parametrize(
    ("gravity", "up"),
    [([0, -9.8, 0], [0, 1, 0]), ([0.5, 0.0, -9.8], [0, 0, 1]), ([0, 0, 0], [0, 0, 1])],
)
def test_up_is_the_axis_that_gravity_points_away_from(tmp_path, gravity, up):
    (tmp_path / "arm.urdf").write_text(ARM.format(visual=""), encoding="utf-8")
    robot = {"urdf": str(tmp_path / "arm.urdf"), "gravity": gravity}
    axes = upright(scene_from({"robot": robot}).robot)
    np.testing.assert_allclose(axes[:, 2], up, atol=1e-12)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)


def test_a_film_reads_back_with_its_images_in_their_order():
    av = pytest.importorskip("av", reason="av is not installed")
    shades = [0, 100, 200]
    images = [np.full((64, 96, 3), shade, np.uint8) for shade in shades]
    with av.open(io.BytesIO(mp4(images))) as file:
        read = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
        assert file.streams.video[0].average_rate == 30
    assert [frame.shape for frame in read] == [(64, 96, 3)] * 3
    np.testing.assert_allclose([frame.mean() for frame in read], shades, atol=4)


def test_spokes_lead_to_the_points_at_which_a_wheel_touches():
    solids, _ = solids_of_scene(load_scene("rimless_wheel"))
    lengths = [np.linalg.norm(s.surface.vertices, axis=1).max() for s in solids if s.link == "hub"]
    assert sorted(lengths)[-2:] == pytest.approx([1.0, 1.0], abs=1e-6)


def test_a_half_space_is_shown_where_it_is_no_floor():
    normals = []
    for name in ("block_on_incline", "sphere_on_plane"):
        grounds = [s for s in solids_of_scene(load_scene(name))[0] if s.is_ground]
        for solid in grounds:
            a, b, c = solid.surface.vertices[solid.surface.triangles[-2].astype(int)].astype(float)
            normals.append(np.cross(b - a, c - a))
    (normal,) = normals
    expected = [-np.sin(np.radians(20.0)), 0.0, np.cos(np.radians(20.0))]
    assert normal / np.linalg.norm(normal) == pytest.approx(expected, abs=1e-5)
