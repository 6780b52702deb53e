"""`mbd-ros kinematics`: recorded markers to motion, its tables and lines, and bad input."""

import csv
import gzip
import shutil

import numpy as np
import pytest
from places import RECORDINGS

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.errors import DataError, MbdError, SceneError
from mbd_ros.features.markers.kinematics_task import CoordinateTask, KinematicsTask
from mbd_ros.files.table import Column, Result, Table

MARKERS = {
    "hip.1": ("residual_limb", [0.05, 0.0, -0.2]),
    "hip.2": ("residual_limb", [-0.04, 0.05, -0.1]),
    "shin.1": ("shank", [0.06, 0.02, -0.2]),
    "shin.2": ("shank", [0.0, -0.05, -0.1]),
    "toe": ("foot", [0.12, 0.03, -0.02]),
    "heel": ("foot", [-0.06, 0.0, 0.0]),
}
SENSORS = {
    label.replace(".", "_"): {"type": "marker", "frame": frame, "xyz": xyz, "label": label}
    for label, (frame, xyz) in MARKERS.items()
}


@pytest.fixture(scope="module")
def leg():
    start = {"position": {"hip_flexion": 0.3, "knee": -0.5}, "velocity": {"hip_flexion": -2.0}}
    return mbd.scene_from({"sensors": SENSORS, "initial": start}, urdf="prosthetic_leg")


@pytest.fixture(scope="module")
def swing(leg):
    """A simulated motion with what its markers show."""
    return leg.simulate(0.2, dt=0.01)


def recorded(swing, scale=1.0, **changes):
    """The markers of a simulation as a recording: one table, labels as columns."""
    samples = swing["samples"]
    places = {
        label: scale * np.column_stack([samples[f"{name}.position_{axis}"] for axis in "xyz"])
        for label, name in zip(MARKERS, SENSORS, strict=True)
    }
    places.update(changes)
    columns = [
        Column(f"{label}.{axis}", place[:, i])
        for label, place in places.items()
        if place is not None
        for i, axis in enumerate("xyz")
    ]
    return Result({"samples": Table([Column("time", samples["time"], "s"), *columns])})


def assert_same_motion(result, swing, rows=slice(None), atol=1e-9):
    for name, values in result["samples"].items():
        np.testing.assert_allclose(values, swing["samples"][name][rows], atol=atol, err_msg=name)


def test_markers_of_a_simulation_give_its_motion_back(leg, swing):
    """From the columns of simulate themselves, and from a recording with labels."""
    for source in (swing, recorded(swing)):
        result = leg.kinematics(source, limits=False)
        assert_same_motion(result, swing)
        assert result["residuals"]["objective"].max() < 1e-15
        assert result["residuals"]["toe.distance"].max() < 1e-8
    assert list(result["samples"]) == [
        "time",
        *(f"{joint.name}.position" for joint in leg.robot.joints),
    ]


TURNS = {
    "x,z,-y": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "-y,x,z": [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
}


def turned(swing, axes):
    """A recording in other axes; `axes` are those that turn it back."""
    R, samples = np.array(TURNS[axes], dtype=float), swing["samples"]
    names = {label: [f"{name}.position_{a}" for a in "xyz"] for label, name in
             zip(MARKERS, SENSORS, strict=True)}  # fmt: skip
    places = {n: np.column_stack([samples[a] for a in each]) @ R for n, each in names.items()}
    return recorded(swing, **places)


@pytest.mark.parametrize("axes", TURNS)
def test_other_axes_of_a_recording_are_named_and_turned(leg, swing, axes):
    found = leg.kinematics(turned(swing, axes), limits=False)
    said = "\n".join(found.metadata["remarks"])
    assert "warning: the recording seems to have other axes than the scene" in said
    assert f"mm with --axes {axes}" in said
    result = leg.kinematics(turned(swing, axes), limits=False, axes=axes)
    assert_same_motion(result, swing)
    assert "other axes" not in "\n".join(result.metadata["remarks"])


def test_markers_that_miss_for_another_reason_are_not_turned(leg, swing):
    places = np.random.default_rng(3).normal(size=(len(swing["samples"]["time"]), 3))
    said = leg.kinematics(recorded(swing, toe=places), limits=False).metadata["remarks"]
    assert "other axes" not in "\n".join(said)


@pytest.mark.parametrize(
    ("axes", "match"),
    [
        ("x,z,y", "--axes x,z,y is a mirror image; accepted: three of"),
        ("x,y", "--axes x,y: accepted: three of x, y, z, -x"),
        ("x,y,up", "--axes x,y,up: accepted"),
        ("screen", "--axes screen: it has no POINT:X_SCREEN, Y_SCREEN"),
    ],
)
def test_axes_that_are_none_are_refused(leg, swing, axes, match):
    with pytest.raises(DataError, match=match):
        leg.kinematics(recorded(swing), axes=axes)


def test_millimetres_are_asked_for_by_name(leg, swing):
    far = recorded(swing, scale=1e5)
    with pytest.raises(DataError, match="looks like millimetres .6 markers.; give --unit mm"):
        leg.kinematics(far)
    result = leg.kinematics(recorded(swing, scale=1e3), unit="mm", limits=False)
    assert_same_motion(result, swing)
    with pytest.raises(DataError, match="are in m according to the file, not in mm"):
        leg.kinematics(swing, unit="mm")
    with pytest.raises(DataError, match="unknown unit 'inch', accepted: m, mm, cm"):
        leg.kinematics(swing, unit="inch")


def test_range_of_times(leg, swing):
    result = leg.kinematics(swing, begin=0.05, end=0.1, limits=False)
    np.testing.assert_allclose(result["samples"]["time"], np.arange(5, 11) * 0.01)
    with pytest.raises(
        DataError, match=r"no frame from 3 to 4 s; there are frames from 0 to 0\.2"
    ):
        leg.kinematics(swing, begin=3.0, end=4.0)


def test_labels_that_do_not_match_are_named_with_the_nearest(leg, swing):
    renamed = recorded(swing, toe=None)
    columns = [
        column._replace(name=column.name.replace("heel", "Heel"))
        for column in renamed["samples"].columns
    ]
    result = leg.kinematics(Result({"samples": Table(columns)}), limits=False)
    lines = result.metadata["remarks"]
    assert "not recorded: toe, heel; perhaps heel is Heel" in lines
    assert "recorded and not in the scene: Heel; perhaps Heel is heel" in lines
    only = [c for c in columns if c.name == "time" or c.name.startswith("Heel")]
    with pytest.raises(DataError, match=r"no recorded marker is one of the scene.*Heel to heel"):
        leg.kinematics(Result({"samples": Table(only)}))


def test_frames_without_markers_are_left_out_and_named(leg, swing):
    gone = recorded(swing)
    values = {name: v.copy() for name, v in gone["samples"].items()}
    for name in values:
        if name != "time":
            values[name][[7, 8]] = np.nan
    values["toe.x"][3] = np.nan
    result = leg.kinematics(
        Result({"samples": Table(Column(name, v) for name, v in values.items())}), limits=False
    )
    rows = np.delete(np.arange(21), [7, 8])
    assert_same_motion(result, swing, rows)
    assert np.isnan(result["residuals"]["toe.distance"][3])
    (line,) = [line for line in result.metadata["remarks"] if "left out" in line]
    assert line == (
        "warning: left out 2 frames without any marker, the first at 0.07 s, the last at 0.08 s"
    )
    for name in values:
        if name != "time":
            values[name][:] = np.nan
    with pytest.raises(DataError, match="no frame has a marker of the scene"):
        leg.kinematics(Result({"samples": Table(Column(n, v) for n, v in values.items())}))


def test_exchanged_labels_are_named(leg, swing):
    true = recorded(swing)["samples"]
    place = {
        label: np.column_stack([true[f"{label}.{axis}"] for axis in "xyz"]) for label in MARKERS
    }
    wrong = recorded(swing, toe=place["hip.1"], **{"hip.1": place["toe"]})
    (line,) = [
        line
        for line in leg.kinematics(wrong, limits=False).metadata["remarks"]
        if "exchanged" in line
    ]
    assert "labels hip.1 and toe seem exchanged from 0 to 0.2 s" in line
    clean = leg.kinematics(recorded(swing), limits=False)
    assert not any("exchanged" in line for line in clean.metadata["remarks"])


def test_what_is_not_determined_and_what_is_at_a_limit_is_named(leg, swing):
    few = recorded(swing, **{"shin.1": None, "shin.2": None, "toe": None, "heel": None})
    lines = leg.kinematics(few, limits=False).metadata["remarks"]
    assert any("markers do not determine" in line and "ankle" in line for line in lines)
    samples = leg.kinematics(swing)["samples"]
    for joint in leg.robot.joints:
        values = samples[f"{joint.name}.position"]
        assert (values >= joint.lower).all() and (values <= joint.upper).all()


def test_tasks_of_a_file_and_of_a_set_up_are_the_same(leg, swing, tmp_path):
    yaml, xml = tmp_path / "task.yaml", tmp_path / "setup.xml"
    yaml.write_text(
        "kinematics:\n  markers: {hip.1: 2.0, hip.2: 1.0, shin.1: 1.0}\n"
        "  coordinates: {ankle: {weight: 0.5, value: 0.1}, knee: 0.01}\n  begin: 0.1\n  end: 0.2\n"
    )
    marker = "<IKMarkerTask name='{}'><apply>{}</apply><weight>{}</weight></IKMarkerTask>"
    joint = (
        "<IKCoordinateTask name='{}'><apply>true</apply><weight>{}</weight>"
        "<value_type>{}</value_type><value>0.1</value></IKCoordinateTask>"
    )
    tasks = [marker.format("hip.1", "true", 2), marker.format("hip.2", "true", 1)]
    tasks += [marker.format("shin.1", "true", 1), marker.format("toe", "false", 1)]
    tasks += [
        joint.format("ankle", 0.5, "manual_value"),
        joint.format("knee", 0.01, "default_value"),
    ]
    xml.write_text(
        "<OpenSimDocument Version='40000'><InverseKinematicsTool><IKTaskSet><objects>"
        f"{''.join(tasks)}</objects></IKTaskSet><time_range> 0.1 0.2</time_range>"
        "</InverseKinematicsTool></OpenSimDocument>"
    )
    first, second = (leg.kinematics(swing, task=path) for path in (yaml, xml))
    assert first["samples"] == second["samples"] and first["samples"].rows == 11
    np.testing.assert_allclose(first["samples"]["ankle.position"], 0.1, atol=1e-9)
    given = KinematicsTask({"hip.1": 1.0}, {"knee": CoordinateTask(1.0, -0.2)})
    knee = leg.kinematics(swing, task=given)["samples"]["knee.position"]
    np.testing.assert_allclose(knee, -0.2, atol=1e-12)


def test_coordinates_that_a_recorded_motion_gives(leg, swing, tmp_path):
    swing.to(tmp_path / "motion.npz")
    task = tmp_path / "task.yaml"
    entry = "{weight: 1.0, from_motion: true}"
    task.write_text(
        f"kinematics:\n  markers: {{hip.1: 1.0}}\n  coordinates: {{ankle: {entry}}}\n"
        "  motion: motion.npz\n"
    )
    found = leg.kinematics(swing, task=task, limits=False)["samples"]["ankle.position"]
    np.testing.assert_allclose(found, swing["samples"]["ankle.position"], atol=1e-9)
    task.write_text(task.read_text().replace("motion.npz", "../motion"))
    with pytest.raises(DataError, match="follows a column of a table, not a bag"):
        leg.kinematics(swing, task=task)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("kinematics: {coordinates: {anckle: 1.0}}", "no joint 'anckle'"),
        (
            "kinematics: {coordinates: {ankle: {weight: 1.0, from_motion: true}}}",
            "motion: is missing",
        ),
        ("kinematics: {weights: {toe: 1.0}}", "unknown key 'weights', accepted: markers"),
        ("kinematics: {markers: {toe: -1.0}}", "out of range"),
        ("simulate: {duration: 1.0}", "has no section 'kinematics'"),
    ],
)
def test_bad_task_files(leg, swing, tmp_path, text, words):
    path = tmp_path / "task.yaml"
    path.write_text(text)
    with pytest.raises(SceneError, match=words):
        leg.kinematics(swing, task=path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<OpenSimDocument><IKTask", "not well-formed"),
        ("<OpenSimDocument Version='40000'><X/></OpenSimDocument>", "no <IKTaskSet>"),
        (
            "<D><IKTaskSet><IKMarkerTask name='toe'><weight>x</weight></IKMarkerTask></IKTaskSet>"
            "</D>",
            "weight 'x'",
        ),
        ("<D><IKTaskSet><IKMarkerTask/></IKTaskSet></D>", "without a name"),
    ],
)
def test_bad_set_ups(leg, swing, tmp_path, text, words):
    path = tmp_path / "setup.xml"
    path.write_text(text)
    with pytest.raises(SceneError, match=words):
        leg.kinematics(swing, task=path)


def test_bad_recordings(leg, swing, tmp_path):
    time = Column("time", np.array([0.0, 0.1]), "s")
    with pytest.raises(DataError, match=r"no markers; accepted are columns <label>\.x"):
        leg.kinematics(Result({"samples": Table([time, Column("a", np.zeros(2))])}))
    back = Column("time", np.array([0.1, 0.0]), "s")
    places = [Column(f"toe.{axis}", np.zeros(2)) for axis in "xyz"]
    with pytest.raises(DataError, match="must be finite and increase"):
        leg.kinematics(Result({"samples": Table([back, *places])}))
    bare = mbd.scene_from(urdf="prosthetic_leg")
    with pytest.raises(DataError, match="no markers: the scene needs sensors of type marker"):
        bare.kinematics(swing)
    twice = {**SENSORS, "other": {**SENSORS["toe"]}}
    with pytest.raises(DataError, match="two markers have the label toe"):
        mbd.scene_from({"sensors": twice}, urdf="prosthetic_leg").kinematics(swing)
    with pytest.raises(MbdError, match=r"nosuch\.csv"):
        leg.kinematics(tmp_path / "nosuch.csv")


def test_locked_and_coupled_joints_are_in_the_motion(swing):
    entries = {
        "robot": {"locked": {"knee_slide_x": 0.002}},
        "couplings": {"knee_slide_y": {"parent": "knee", "factor": 0.01}},
        "sensors": SENSORS,
    }
    leg = mbd.scene_from(entries, urdf="prosthetic_leg")
    samples = leg.kinematics(swing, limits=False)["samples"]
    assert (samples["knee_slide_x.position"] == 0.002).all()
    assert samples.column("knee_slide_x.position").unit == "m"
    np.testing.assert_allclose(
        samples["knee_slide_y.position"], 0.01 * samples["knee.position"], atol=1e-15
    )


def test_free_bodies_have_poses(swing):
    leg = mbd.scene_from(
        {"robot": {"base": "floating"}, "sensors": SENSORS}, urdf="prosthetic_leg"
    )
    samples = leg.kinematics(swing)["samples"]
    quaternion = np.column_stack([samples[f"base.orientation.{axis}"] for axis in "xyzw"])
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=1), 1.0, atol=1e-12)
    assert "base.position.x" in samples


def test_smooth_motion_by_option(leg, swing):
    alone, smooth = (leg.kinematics(swing, smoothness=s, limits=False) for s in (0.0, 1e-4))
    assert smooth["residuals"]["objective"].sum() > alone["residuals"]["objective"].sum()
    assert smooth["residuals"]["remainder"].max() <= 1e-8


def table(path):
    with gzip.open(path, "rt") as file:
        names, *rows = csv.reader(file)
    return names, np.array(rows, dtype=np.float64)


@pytest.mark.parametrize(
    ("name", "model", "setup", "markers"),
    [
        ("arm26", "arm26", "arm26_Setup_InverseKinematics", "arm26_elbow_flex_shifted"),
        ("gait10dof", "subject01", "walk_Setup_IK", "subject01_walk"),
    ],
)
def test_files_of_a_laboratory_give_the_exact_optimum(tmp_path, name, model, setup, markers):
    """Objective within 1e-9 of an independent program, joints within 1e-6 rad or m."""
    folder = RECORDINGS / name / "marker_ik"
    scene, task, recording = (
        tmp_path / name for name in (f"{model}.osim", f"{setup}.xml", f"{markers}.trc")
    )
    for target in (scene, task, recording):
        packed = folder / "raw" / f"{target.name}.gz"
        with gzip.open(packed) as source, target.open("wb") as plain:
            shutil.copyfileobj(source, plain)
    out, residuals = tmp_path / "ik.mot", tmp_path / "residuals.csv"
    words = ["kinematics", str(scene), str(recording), str(task)]
    assert main([*words, "-o", str(out), "--residuals", str(residuals)]) == 0
    joints, exact = table(folder / "ik_exact.csv.gz")
    found = mbd.read_result(out)["samples"]
    for column, joint in enumerate(joints[1:-1], start=1):
        np.testing.assert_allclose(found[joint], exact[:, column], atol=1e-6)
    weights = {
        row["name"]: float(row["weight"])
        for row in csv.DictReader((folder / "tasks.csv").open())
        if row["kind"] == "marker"
    }
    ours = mbd.read_result(residuals)["samples"]["objective"] * 2.0 * sum(weights.values())
    assert (ours <= exact[:, -1] * (1.0 + 1e-9)).all()
    torques = mbd.load_scene(scene).inverse(out)
    assert "positions alone: opensim derivatives" in torques.metadata["remarks"]


def test_command_leaves_nothing_behind_where_it_fails(tmp_path, swing, capsys):
    swing.to(tmp_path / "swing.npz")
    out = tmp_path / "ik.csv"
    words = ["kinematics", "prosthetic_leg", str(tmp_path / "swing.npz"), "-o", str(out)]
    assert main(words) != 0
    assert "needs sensors of type marker" in capsys.readouterr().err
    assert not out.exists()
    assert main([*words[:-1], str(tmp_path / "swing.npz")]) != 0
    assert "would take the place" in capsys.readouterr().err
