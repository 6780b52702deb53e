"""Lengths, speeds and moment arms of all paths over many samples."""

import csv
import gzip

import numpy as np
import pytest
from places import RECORDINGS

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.paths.paths import PathBatch
from mbd_ros.core.state import State
from mbd_ros.errors import DataError
from mbd_ros.files.table import Column, Result, Table
from mbd_ros.scene.runs.path_search import state_paths

ARM26 = RECORDINGS / "arm26/muscles/raw/arm26.osim.gz"
GAIT = RECORDINGS / "gait10dof/muscles/raw/subject01.osim.gz"
TEST_MODELS = "opensim/moment_arm_test_models"
TIMES = ("time", "case")
SMALL = (
    "MovingPathPointMomentArmTest",
    "MovingPointCustomJointMomentArmTest",
    "MultipleMPPsMomentArmTest",
    "P2PCustomJointMomentArmTest",
)


def table(path):
    with gzip.open(path, "rt") as file:
        names, *rows = csv.reader(file)
    return dict(zip(names, np.array(rows, dtype=float).T, strict=True))


def motion(columns):
    """Poses as a motion: those of random ones stand 10 ms apart."""
    (time,) = (0.01 * x if n == "case" else x for n, x in columns.items() if n in TIMES)
    named = {"time": time}
    for name, row in columns.items():
        if name not in TIMES:
            named[name if "." in name else f"{name}.position"] = row
    return Result({"samples": Table([Column(n, x) for n, x in named.items()])})


def straight(scene):
    """The same scene without wraps."""
    entries = scene.entries["paths"]
    plain = {
        name: {k: given for k, given in path.items() if k != "wraps"}
        for name, path in entries.items()
    }
    return scene.with_(paths=plain)


def compare(result, lengths, arms, speeds):
    """Largest difference of lengths, arms and speeds."""
    found, off = result["samples"], [0.0, 0.0, 0.0]
    for name, expected in lengths.items():
        if name.endswith(".length"):
            off[0] = max(off[0], np.abs(found[name] - expected).max())
        if name.endswith(".speed") and speeds:
            off[2] = max(off[2], np.abs(found[name] - expected).max())
    for name, expected in arms.items():
        if name not in ("case", "time"):
            off[1] = max(off[1], np.abs(found[name] - expected).max())
    return off


@pytest.mark.parametrize("which", ["motion", "random50"])
@pytest.mark.parametrize("model", [ARM26, GAIT], ids=["arm26", "gait10dof"])
def test_straight_paths_are_those_of_opensim(model, which):
    """All muscles; 12 digits of 0.5 m are in the files."""
    folder, scene = model.parents[1], straight(mbd.load_scene(model))
    prefix = "no_wrap_" if model == ARM26 else ""
    start = "" if which == "motion" else "random50_"
    asked = "motion" if which == "motion" else f"{prefix}random50_coordinates"
    result = scene.moment_arms(motion(table(folder / f"{asked}.csv.gz")))
    lengths = table(folder / f"{prefix}{start}lengths.csv.gz")
    arms = table(folder / f"{prefix}{start}moment_arms.csv.gz")
    off = compare(result, lengths, arms, which == "motion")
    assert max(off) <= 1e-12


@pytest.mark.parametrize("name", SMALL)
def test_moving_points_are_those_of_opensim(data_dir, name):
    """Arms are -dl/dq; OpenSim leaves out lines of one body, of which there are none here."""
    folder = data_dir / TEST_MODELS / name
    scene = mbd.load_scene(folder / f"{name}_40600.osim.gz")  # the numbers OpenSim took
    result = scene.moment_arms(motion(table(folder / "random50_coordinates.csv.gz")))
    lengths = table(folder / "random50_lengths.csv.gz")
    arms = table(folder / "random50_moment_arms.csv.gz")
    assert max(compare(result, lengths, arms, False)) <= 1e-12


def test_samples_are_those_of_the_paths_one_by_one():
    """With wraps; -G' J by the coupling Jacobian."""
    scene = mbd.load_scene(ARM26)
    rng = np.random.default_rng(4)
    y, w = rng.uniform(0.0, 2.0, (12, 2)), rng.normal(size=(12, 2))
    found = PathBatch(scene.robot, scene.couplings, scene.parts["paths"]).evaluate(y, w)
    for i, path in enumerate(scene.parts["paths"].values()):
        for j in range(12):
            k = Kinematics(scene.robot)
            k.refresh(y[j], w[j])
            length, slope = path.measured(k, State(0.0, y[j], w[j]))
            assert found.lengths[j, i] == pytest.approx(length, abs=1e-14)
            np.testing.assert_allclose(found.arms[j, i], -slope, atol=1e-11)
            assert found.speeds[j, i] == pytest.approx(slope @ w[j], abs=1e-11)


def native_and_one_by_one(scene):
    """Largest difference of lengths, speeds and columns at random states."""
    paths = list(scene.parts["paths"].values())
    robot, couplings, data = scene.robot, scene.couplings, scene.robot.model.createData()
    native = state_paths(robot, data, couplings, paths, len(paths))
    assert native is not None
    rng, k, off = np.random.default_rng(5), Kinematics(robot, data), 0.0
    for _ in range(40):
        q, v, a = np.zeros(robot.model.nq), np.zeros(robot.model.nv), np.zeros(robot.model.nv)
        q[couplings.q_index] = rng.uniform(-1.5, 1.5, len(couplings.q_index))
        v[couplings.v_index] = rng.normal(size=len(couplings.v_index))
        slopes = couplings.expand(q, v, a)
        k.refresh(q, v)
        assert native(q, v, slopes)
        G = couplings.jacobian(q)
        for i, path in enumerate(paths):
            length, slope = path.measured(k, State(0.0, q, v))
            found = native.length[i] - length, native.speed[i] - slope @ v
            off = max(off, *np.abs(found), np.abs(native.columns[:, i] + G.T @ slope).max())
    return off


@pytest.mark.parametrize("model", ["muscle_leg", GAIT], ids=["muscle_leg", "gait10dof"])
def test_native_paths_are_those_one_by_one(model):
    """Conditional and moving points, coupled joints; arms are some 0.1 m."""
    assert native_and_one_by_one(mbd.load_scene(model)) <= 1e-14


def test_native_paths_over_surfaces_are_those_one_by_one():
    """Searches end at 1e-13 of the sines at contacts, in numpy too."""
    assert native_and_one_by_one(mbd.load_scene(ARM26)) <= 1e-12


@pytest.mark.parametrize(
    ("name", "bound"),
    [*((name, 1e-14) for name in SMALL), ("WrapPathCustomJointMomentArmTest", 1e-12)],
)
def test_native_paths_of_small_models_are_those_one_by_one(data_dir, name, bound):
    file = data_dir / TEST_MODELS / name / f"{name}_40600.osim.gz"
    assert native_and_one_by_one(mbd.load_scene(file)) <= bound


def test_paths_are_not_native_without_a_compiler(monkeypatch):
    monkeypatch.setenv("CC", "no_such_compiler")
    scene = mbd.load_scene("muscle_leg")
    paths, robot = list(scene.parts["paths"].values()), scene.robot
    data = robot.model.createData()
    assert state_paths(robot, data, scene.couplings, paths, len(paths)) is None


def test_dependent_joints_move_along():
    """Arms by differences of lengths along the independent coordinates alone."""
    scene = mbd.load_scene(GAIT)
    batch = PathBatch(scene.robot, scene.couplings, scene.parts["paths"])
    y, h = np.full((1, 10), -0.3), 1e-4
    steps = np.concatenate([y + s * h * np.eye(10) for s in (-2, -1, 1, 2)])
    ends = batch.evaluate(steps).lengths.reshape(4, 10, -1)
    rate = (8.0 * (ends[2] - ends[1]) - (ends[3] - ends[0])) / (12.0 * h)
    np.testing.assert_allclose(batch.evaluate(y).arms[0].T, -rate, atol=1e-10)


def test_a_scene_without_paths_is_refused():
    with pytest.raises(DataError, match="has no paths"):
        mbd.load_scene("arm7").moment_arms(motion({"time": np.zeros(2)}))


def test_the_command_writes_a_table(tmp_path, capsys):
    out = tmp_path / "arms.csv"
    words = [ARM26, ARM26.parents[1] / "motion.csv.gz", "-o", out]
    assert main(["moment-arms", *map(str, words)]) == 0
    assert "121 samples of 6 paths" in capsys.readouterr().out
    head = out.read_text().splitlines()[0].split(",")
    assert {"BRA.length", "BRA.speed", "BRA.r_elbow_flex"} <= set(head)
    assert "BRA.r_shoulder_elev" not in head
