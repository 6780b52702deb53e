"""`mbd-ros predict` along recordings: of a person who walks, of markers, of a free body."""

import gzip
from csv import DictReader

import numpy as np
import pytest
from opensim_muscles import columns
from places import RECORDINGS
from prediction_scenes import joint, link, mass

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.errors import BAD_INPUT, OK, MbdError
from mbd_ros.files.table import Column, Table, read_result

WALK = "gait10dof/muscles"
TASK = """
predict:
  recording: {motion: subject01_walk_IK.mot, external: subject01_walk_grf.xml, times: [1.0, 1.4],
    cutoff: 6.0}
  driven_by: joints
  tolerance: 1.0e-4
  goals: [{type: tracking, of: "*.position", weight: 100}, {type: effort, weight: 1.0e-11}]
"""


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """A folder with the files of OpenSim as they come."""
    folder = tmp_path_factory.mktemp("walk")
    for name in ("gait10dof/muscles", "gait10dof/marker_ik"):
        for file in (RECORDINGS / name / "raw").glob("*.gz"):
            (folder / file.name.removesuffix(".gz")).write_bytes(
                gzip.decompress(file.read_bytes())
            )
    return folder


def test_a_recorded_walk_takes_the_torques_of_inverse_dynamics(walk, capsys):
    """Tracked closely, with the loads of the plates: OpenSim's InverseDynamicsTool, 2 % rms."""
    (walk / "track.yaml").write_text(TASK)
    out = walk / "tracked.npz"
    words = ["predict", str(walk / "subject01.osim"), str(walk / "track.yaml"), "-o", str(out)]
    assert main(words) == OK
    assert "residual pelvis_tilt.effort: rms" in capsys.readouterr().out
    result = read_result(out)
    assert result.metadata["replay"] < 10.0 * result.metadata["error"] < 1.0e-3
    samples = result["samples"]
    assert samples["time"][[0, -1]] == pytest.approx([1.0, 1.4])
    theirs = columns(RECORDINGS / WALK / "inverse_dynamics_tool.csv.gz")
    kept = (theirs["time"] > 1.1) & (theirs["time"] < 1.3)
    for name in [name for name in theirs if name.endswith(".effort")]:
        ours = np.interp(theirs["time"][kept], samples["time"], samples[name])
        off = np.linalg.norm(ours - theirs[name][kept])
        assert off < 0.02 * np.linalg.norm(theirs[name][kept]), name
    assert set(result.metadata["residuals"]) == {
        f"pelvis_{k}.effort" for k in ("tx", "ty", "tilt")
    }


def test_markers_are_tracked(walk):
    """Where marker kinematics puts the person, frame by frame; ends are left out."""
    with (RECORDINGS / "gait10dof/marker_ik/tasks.csv").open(encoding="utf-8") as file:
        weights = {row["name"].replace(".", "_"): float(row["weight"]) for row in DictReader(file)}
    of = {f"{name}.{axis}": weight for name, weight in weights.items() for axis in "xyz"}
    scene = mbd.load_scene(str(walk / "subject01.osim"))
    files = {"motion": "subject01_walk_IK.mot", "external": "subject01_walk_grf.xml"}
    found = scene.predict(
        {
            "recording": {key: str(walk / name) for key, name in files.items()}
            | {"times": [1.0, 1.3]},
            "driven_by": "joints",
            "tolerance": 1.0e-3,
            "goals": [
                {"type": "tracking", "of": of, "file": str(walk / "subject01_walk.trc")},
                {"type": "effort", "weight": 1.0e-11},
            ],
        }
    )
    theirs = columns(RECORDINGS / "gait10dof/marker_ik/ik_exact.csv.gz")
    kept = (theirs["time"] > 1.05) & (theirs["time"] < 1.25)
    for name in ("hip_flexion_r.position", "knee_angle_l.position", "pelvis_ty.position"):
        ours = np.interp(theirs["time"][kept], found["samples"]["time"], found["samples"][name])
        np.testing.assert_allclose(ours, theirs[name][kept], atol=0.02)


ROBOT = (
    "<robot name='r'>"
    + link("body", 2.0, inertia=0.2)
    + link("arm", 1.0, "0 0 -0.3", 0.03)
    + joint("swing", "continuous", "body", "arm", "0 1 0")
    + "</robot>"
)


def floating(t):
    """A free body that goes along a line at 4 m/s^2, its arm hanging down."""
    names = [f"base.position.{axis}" for axis in "xyz"] + [
        f"base.orientation.{axis}" for axis in "xyzw"
    ]
    values = [2.0 * t**2, 0 * t, 0 * t, 0 * t, 0 * t, 0 * t, 1 + 0 * t]
    table = [Column("time", t, "s"), *(Column(*one) for one in zip(names, values, strict=True))]
    return Table([*table, Column("swing.position", 0 * t, "rad")])


def test_a_free_base_is_held_by_a_residual(tmp_path):
    """Newton: F = (m a, 0, m g), and m l a at the arm; next to the ends efforts go to zero."""
    from mbd_ros.files.table import Result

    Result({"samples": floating(np.linspace(5.0, 6.0, 41))}).to(tmp_path / "motion.csv")
    scene = mbd.scene_from({"robot": {"base": "floating"}}, urdf=ROBOT)
    recording = {"motion": str(tmp_path / "motion.csv"), "times": [5.2, 5.8]}
    goals = [
        {"type": "tracking", "of": "*.position*", "weight": 1.0e6},
        {"type": "tracking", "of": "*.orientation*", "weight": 1.0e6},
        {"type": "effort", "weight": 1.0e-9},
    ]
    task = {"recording": recording, "driven_by": "joints", "goals": goals, "tolerance": 1.0e-4}
    found = scene.predict(task)
    residuals = found.metadata["residuals"]
    assert residuals["base_residual.Fx"][0] == pytest.approx(3.0 * 4.0, rel=0.03)
    assert residuals["base_residual.Fz"][0] == pytest.approx(3.0 * 9.81, rel=0.03)
    middle = found["samples"]["swing.effort"][100:140]
    assert middle.mean() == pytest.approx(-0.3 * 4.0, rel=0.01)


def test_what_sensors_and_parts_show_has_a_name():
    """The place of a marker, as tables call it."""
    sensors = {"dot": {"type": "marker", "frame": "mass", "xyz": [0.1, 0.0, 0.0]}}
    goals = [{"type": "effort"}, {"type": "final", "of": "dot.x", "target": 1.1, "weight": 1.0e8}]
    found = mass().with_(sensors=sensors).predict({"duration": 1.0, "goals": goals})
    assert found["samples"]["slide.position"][-1] == pytest.approx(1.0, abs=1.0e-4)


def test_what_parts_show_and_inputs_are_tracked(tmp_path):
    """The force of a spring and the command of a motion, by lines between samples."""
    path = {"points": [{"frame": "ground", "xyz": [-1.0, 0.5, 0.0]}, {"frame": "mass"}]}
    spring = {"type": "path_spring", "name": "band", "path": path, "stiffness": 20.0}
    scene = mass().with_(forces=[spring | {"resting_length": 0.1}])
    task = {"duration": 1.0, "end": {"slide.position": 1.0, "slide.velocity": 0.0}}
    once = scene.predict(task | {"goals": [{"type": "effort"}]})
    file = str(tmp_path / "once.npz")
    once.to(file)
    goals = [
        {"type": "tracking", "of": "band.tension", "file": file, "weight": 1.0e3},
        {"type": "tracking", "of": "slide.effort", "file": file},
    ]
    again = scene.predict({"duration": 1.0, "goals": goals, "tolerance": 1.0e-5})
    off = again["samples"]["slide.position"] - once["samples"]["slide.position"]
    assert np.abs(off).max() < 0.01
    last = [one["samples"]["band.tension"][-1] for one in (once, again)]
    assert last[1] == pytest.approx(last[0], rel=1.0e-2)


@pytest.mark.parametrize(
    ("recording", "said"),
    [
        ({"times": [0.5, 2.0]}, "0.5 .. 2 s is outside of the motion"),
        ({"external": "a.xml", "wrenches": "b.csv"}, "give one of them"),
        ({"cutoff": -1.0}, "cutoff"),
        ({"speed": 1.0}, "unknown key 'speed'"),
    ],
)
def test_recordings_that_do_not_fit_are_refused(recording, said, tmp_path):
    (tmp_path / "motion.csv").write_text("time,slide.position\n0,0\n0.5,0.2\n1,0.5\n")
    task = {
        "recording": {"motion": str(tmp_path / "motion.csv"), **recording},
        "goals": [{"type": "tracking", "of": "slide.position"}],
    }
    with pytest.raises(MbdError, match=said):
        mass().predict(task)


def test_a_recording_without_what_is_tracked_is_named(tmp_path, capsys):
    (tmp_path / "motion.csv").write_text("time,slide.position\n0,0\n0.5,0.2\n1,0.5\n")
    (tmp_path / "task.yaml").write_text(
        "predict: {recording: motion.csv, goals: [{type: tracking, of: shoulder_flexion.effort}]}"
    )
    words = ["predict", "prosthetic_arm", str(tmp_path / "task.yaml")]
    assert main(words) == BAD_INPUT
    assert "motion.csv" in capsys.readouterr().err
