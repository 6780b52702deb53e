"""The command `muscles`: what it writes, its options, several motions, bad input."""

import gzip

import numpy as np
import pytest
from muscle_arm import NAMES, SCENE, URDF, motion
from places import RECORDINGS

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.errors import DataError, MbdError, SceneError
from mbd_ros.files.table import Column, Result, Table


@pytest.fixture(scope="module")
def arm():
    return mbd.scene_from(SCENE, urdf=URDF)


@pytest.fixture
def files(tmp_path):
    """The same as files: scene, URDF and motion."""
    import yaml

    (tmp_path / "arm.urdf").write_text(URDF)
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump({"robot": {"urdf": "arm.urdf"}, **SCENE}))
    motion().to(tmp_path / "swing.csv")
    return tmp_path


def exerted(scene, table, names):
    """Torques of the joints by the forces of muscles, by differences of the lengths of paths."""
    q = np.column_stack([table[f"{joint}.position"] for joint in ("shoulder", "elbow")])
    torque = np.zeros_like(q)
    k = mbd_kinematics(scene)
    for row, angles in enumerate(q):
        for joint in range(2):
            h = np.zeros(2)
            h[joint] = 1e-6
            for name in names:
                slope = (k(name, angles + h) - k(name, angles - h)) / 2e-6
                torque[row, joint] -= slope * table[f"{name}.force"][row]
    return torque


def mbd_kinematics(scene):
    from mbd_ros.core.kinematics.kinematics import Kinematics
    from mbd_ros.core.state import State

    k = Kinematics(scene.robot)

    def length(name, q):
        k.refresh(q, np.zeros(2))
        return scene.parts["paths"][name].length(k, State(0.0, q, np.zeros(2)))

    return length


def test_muscles_exert_what_inverse_dynamics_asks_for(arm):
    table = arm.muscle_forces(motion(), reserves=0.01)["samples"]
    needed = arm.inverse(motion())["samples"]
    for i, joint in enumerate(("shoulder", "elbow")):
        assert table[f"{joint}.effort"] == pytest.approx(needed[f"{joint}.effort"], abs=1e-12)
        given = exerted(arm, table, NAMES)[:, i] + table[f"{joint}_reserve.force"]
        assert given == pytest.approx(table[f"{joint}.effort"], abs=1e-6)
    activations = np.column_stack([table[f"{name}.activation"] for name in NAMES])
    assert activations.min() >= 0.01
    assert activations.max() <= 1.0
    assert table["muscles.residual"].max() <= 1e-8
    assert (table["muscles.null_space"] == 6).all()
    assert (table["muscles.is_unique"] == 1).all()


def test_lines_say_what_was_done(arm):
    found = arm.muscle_forces(motion(), reserves=0.01)
    said = "\n".join(found.metadata["remarks"])
    assert "objective: activation, exponent 2, 6 muscles and 2 reserves" in said
    assert "passive force of the fibres is left out" in said
    assert "reserve shoulder_reserve: at most" in said
    assert found.metadata["inputs"]["reserves"] == 0.01


def test_frames_beyond_the_muscles_are_named(arm):
    """Weak muscles: what lacks is the difference to what they exert at full activation."""
    weak = [{**muscle, "max_isometric_force": 5.0} for muscle in SCENE["muscles"]]
    scene = arm.with_(muscles=weak)
    found = scene.muscle_forces(motion())
    table, said = found["samples"], "\n".join(found.metadata["remarks"])
    lacks = table["muscles.is_feasible"] == 0
    assert lacks.any()
    assert f"warning: {lacks.sum()} of 40 frames need more than muscles and reserves" in said
    assert "shoulder lacks" in said
    given = exerted(scene, table, NAMES)
    for i, joint in enumerate(("shoulder", "elbow")):
        lacking = table[f"{joint}.effort"] - given[:, i]
        assert table[f"{joint}.lacking"] == pytest.approx(lacking, abs=1e-6)


def test_linear_objectives_are_cheaper_than_squares_by_their_own_measure(arm):
    square = arm.muscle_forces(motion(), reserves=1.0)["samples"]
    linear = arm.muscle_forces(motion(), reserves=1.0, exponent=1)["samples"]
    names = [f"{name}.activation" for name in NAMES]
    efforts = [f"{joint}_reserve.force" for joint in ("shoulder", "elbow")]
    cost = sum(np.abs(square[name]) for name in (*names, *efforts))
    assert (linear["muscles.objective"] <= cost + 1e-9).all()
    assert linear["muscles.objective"].sum() < cost.sum() * (1.0 - 1e-4)


def test_motors_and_commanded_forces_share_within_their_limits(arm):
    """Their efforts cost in units of their limit; the forces balance with them."""
    push = {"type": "body_force", "name": "push", "frame": "lower", "direction": [1, 0, 0]}
    motor = {"type": "ideal", "name": "motor", "joints": ["elbow"], "limit": 3.0}
    scene = arm.with_(forces=[{**push, "limit": 5.0}], actuators=[motor])
    options = {"reserves": 0.01, "reactions": "ground"}
    table = scene.muscle_forces(motion(), **options)["samples"]
    alone = arm.muscle_forces(motion(), **options)["samples"]
    needed = arm.inverse(motion())["samples"]
    assert np.abs(table["motor.force"]).max() <= 3.0
    assert np.abs(table["push.force"]).max() <= 5.0
    assert (table["muscles.objective"] <= alone["muscles.objective"] + 1e-12).all()
    given = exerted(scene, table, NAMES)[:, 1] + table["motor.force"]
    assert table["elbow.effort"] == pytest.approx(needed["elbow.effort"], abs=1e-12)
    rest = table["elbow.effort"] - given - table["elbow_reserve.force"]
    assert np.abs(rest).max() <= 1e-6  # the push acts at the elbow itself
    assert scene.inverse(motion())["samples"]["elbow.effort"] == pytest.approx(
        needed["elbow.effort"], abs=1e-12
    )


def test_loads_of_joints_by_muscle_add_up(arm):
    options = {"reserves": 1.0, "reactions": "ground", "links": ["lower"], "by_muscle": True}
    table = arm.muscle_forces(motion(), **options)["samples"]
    idle = arm.with_(muscles=[{**m, "max_isometric_force": 1e-9} for m in SCENE["muscles"]])
    bare = idle.muscle_forces(motion(), **options)["samples"]
    for axis in "xz":
        parts = sum(table[f"lower.{name}.force_{axis}"] for name in NAMES)
        total = table[f"lower.load.force_{axis}"]
        assert total == pytest.approx(parts + bare[f"lower.load.force_{axis}"], abs=1e-6)
    assert table.column("lower.load.moment_y").unit == "N·m"
    with pytest.raises(SceneError, match="no joint carries link 'trunk'; accepted: upper"):
        arm.muscle_forces(motion(), reactions="child", links=["trunk"])


def test_the_command_writes_the_same(files, arm, capsys):
    out = files / "forces.csv"
    words = ["muscles", files / "arm.yaml", files / "swing.csv", "-o", out, "--reserves", "0.5"]
    assert main([str(word) for word in words]) == 0
    expected = arm.muscle_forces(motion(), reserves=0.5)["samples"]
    found = mbd.read_result(out)["samples"]
    assert list(found) == list(expected)
    for name in found:
        assert found[name] == pytest.approx(expected[name], rel=1e-9, abs=1e-9)
    assert "40 frames, given derivatives" in capsys.readouterr().out


def test_a_task_file_says_the_same_and_options_win(files, capsys):
    task = files / "task.yaml"
    task.write_text("muscles: {objective: stress, reserves: {shoulder: 2.0, elbow: 3.0}}\n")
    words = ["muscles", files / "arm.yaml", files / "swing.csv", "-o", files / "a.npz"]
    words += ["--task", task, "--exponent", "2", "--time-range", "0", "0.1"]
    assert main([str(word) for word in words]) == 0
    said = capsys.readouterr().out
    assert "objective: stress, exponent 2, 6 muscles and 2 reserves" in said
    found = mbd.read_result(files / "a.npz")
    asked = found.metadata["inputs"]
    assert found["samples"].rows == 4
    assert asked["reserves"] == {"shoulder": 2.0, "elbow": 3.0}


def test_several_motions_go_into_a_folder(files, capsys):
    motion(20, 0.3).to(files / "small.csv")
    words = ["muscles", files / "arm.yaml", files / "swing.csv", files / "small.csv"]
    words += ["-o", files / "all", "--reserves", "1", "--workers", "1"]
    assert main([str(word) for word in words]) == 0
    assert mbd.read_result(files / "all" / "small.csv")["samples"].rows == 20
    assert mbd.read_result(files / "all" / "swing.csv")["samples"].rows == 40
    words += ["--external", "a.xml", "b.xml", "c.xml"]
    assert main([str(word) for word in words]) == 2
    assert "--external names 3 files for 2 motions" in capsys.readouterr().err


def test_measured_activations_are_least(arm, tmp_path):
    path = tmp_path / "emg.csv"
    times, level = np.array([0.0, 0.5, 1.0]), np.array([0.1, 0.3, 0.1])
    columns = [Column("time", times, "s"), Column("flexor.activation", level)]
    Result({"samples": Table(columns)}).to(path)
    table = arm.muscle_forces(motion(), reserves=1.0, emg=str(path), emg_use="least")["samples"]
    measured = np.interp(table["time"], times, level)
    assert (table["flexor.activation"] >= measured - 1e-12).all()
    tracked = arm.muscle_forces(motion(), reserves=1.0, emg=str(path), emg_weight=1e4)["samples"]
    assert np.abs(tracked["flexor.activation"] - measured).max() <= 1e-2


@pytest.mark.parametrize(
    ("column", "times", "match"),
    [
        ("biceps.activation", [0.0, 1.0], "has no column of a muscle, accepted: front.activation"),
        ("flexor.activation", [0.3, 1.0], "do not cover the motion at 0 to 1 s"),
        ("flexor.activation", [0.0, 1.0, 2.0], "flexor.activation at 2 s is 2, accepted: 0 .. 1"),
    ],
)
def test_bad_measurements_are_refused(arm, tmp_path, column, times, match):
    path = tmp_path / "emg.csv"
    columns = [Column("time", np.array(times), "s"), Column(column, np.array(times))]
    Result({"samples": Table(columns)}).to(path)
    with pytest.raises(DataError, match=match):
        arm.muscle_forces(motion(), emg=str(path))


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"objective": "joy"}, "expected one of activation, stress, volume, metabolic"),
        ({"exponent": 0.5}, "1 .. 10"),
        ({"reserves": {"knee": 1.0}}, "no joint 'knee'"),
        ({"reserves": -1.0}, "reserves"),
        ({"reserves": "none.xml"}, "none.xml"),
        ({"residuals": [{"name": "F", "frame": "hand", "force": [1, 0, 0]}]}, "no frame 'hand'"),
        (
            {"residuals": [{"name": "front", "frame": "upper", "force": [1, 0, 0]}]},
            "has the name of a muscle",
        ),
        ({"links": ["lower"]}, "reactions: is missing"),
        ({"speed": 1.0}, "unknown key 'speed'"),
    ],
)
def test_bad_options_are_refused(arm, options, match):
    with pytest.raises(MbdError, match=match):
        arm.muscle_forces(motion(), **options)


def test_scenes_that_cannot_be_served_are_refused(arm):
    with pytest.raises(SceneError, match="the scene has no muscles"):
        arm.with_(muscles=None).muscle_forces(motion())
    loop = {"type": "distance", "frame_a": "world", "frame_b": "lower", "distance": 0.3}
    with pytest.raises(SceneError, match="leave out the loops lower_distance"):
        arm.with_(constraints=[loop]).muscle_forces(motion())


def test_nothing_is_written_where_a_frame_fails(files):
    bad = files / "bad.csv"
    bad.write_text("time,shoulder.position\n0.0,0.1\n0.1,0.2\n")
    out = files / "out.csv"
    words = ["muscles", files / "arm.yaml", bad, "-o", out]
    assert main([str(word) for word in words]) != 0
    assert not out.exists()


def test_laboratory_files_give_muscle_forces_and_knee_loads(tmp_path):
    """.osim, .mot, ground reactions and reserves as they come; filter and splines of OpenSim."""
    folder = RECORDINGS / "gait10dof/muscles"
    names = ["subject01.osim", "subject01_walk_IK.mot", "subject01_walk_grf.mot"]
    names += ["subject01_walk_grf.xml", "gait10dof_Reserve_Actuators.xml"]
    for name in names:
        with gzip.open(folder / "raw" / f"{name}.gz") as packed:
            (tmp_path / name).write_bytes(packed.read())
    model, walk, _, loads, reserves = (tmp_path / name for name in names)
    out = tmp_path / "walk.npz"
    words = ["muscles", model, walk, "--external", loads, "--reserves", reserves, "-o", out]
    words += ["--derivatives", "opensim", "--cutoff", "6", "--reactions", "child"]
    assert main([str(word) for word in words]) == 0
    found = mbd.read_result(out)["samples"]
    with gzip.open(folder / "so_weak_reserves_exact_true_pennation.csv.gz", "rt") as file:
        expected = np.genfromtxt(file, delimiter=",", names=True, deletechars="")
    for muscle in ("soleus_r", "vasti_l", "hamstrings_r"):
        error = np.abs(found[f"{muscle}.activation"] - expected[f"{muscle}.activation"])
        assert error.max() <= 0.01  # accelerations of another spline, see the conventions
        assert np.sqrt(np.mean(error**2)) <= 0.002
    assert -3500.0 < found["tibia_r.load.force_y"].min() < -2500.0
