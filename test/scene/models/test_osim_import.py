"""Models of OpenSim against the numbers that OpenSim gives on them."""

import csv
import gzip

import numpy as np
import pinocchio as pin
import pytest
from places import RECORDINGS

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.state import State
from mbd_ros.files.table import Column, Result, Table

SETS = {"arm26": "arm26.osim.gz", "gait10dof": "subject01.osim.gz"}


def table(path):
    with gzip.open(path, "rt") as file:
        names, *rows = csv.reader(file)
    return dict(zip(names, np.array(rows, dtype=float).T, strict=True))


def result(columns):
    return Result({"samples": Table([Column(name, row) for name, row in columns.items()])})


def lengths(scene, positions):
    """Lengths of all paths, shape (n,) each, at positions by joint."""
    k, nv = Kinematics(scene.robot), scene.robot.model.nv
    found = {name: [] for name in scene.parts["paths"]}
    for row in np.transpose(list(positions.values())):
        q, v = np.zeros(nv), np.zeros(nv)
        for name, value in zip(positions, row, strict=True):
            q[scene.robot.joint(name).q] = value
        scene.couplings.expand(q, v, np.zeros(nv))
        k.refresh(q, v)
        for name, path in scene.parts["paths"].items():
            found[name].append(path.length(k, State(0.0, q, v)))
    return found


@pytest.fixture(scope="module", params=SETS)
def measured(request):
    folder = RECORDINGS / request.param / "muscles"
    return folder, mbd.load_scene(folder / "raw" / SETS[request.param])


def test_inverse_dynamics_is_that_of_opensim(measured):
    """Motion with speeds and accelerations, and plate forces, as OpenSim took them."""
    folder, scene = measured
    expected = table(folder / "inverse_dynamics_no_muscles.csv.gz")
    plates = folder / "external_wrenches.csv.gz"
    if plates.exists():
        frames = {"right": "calcn_r", "left": "calcn_l"}
        entry = {n: {"frame": frame, "expressed_in": "ground"} for n, frame in frames.items()}
        scene = scene.with_(external_wrenches=entry)
    motion = result(table(folder / "motion.csv.gz"))
    wrenches = result(table(plates)) if plates.exists() else None
    found = scene.inverse(motion, wrenches=wrenches)["samples"]
    assert {f"{name}.effort" for name in scene.couplings.independent} < set(expected) | {"time"}
    for name in scene.couplings.independent:
        scale = max(np.abs(row).max() for key, row in expected.items() if key != "time")
        error = np.abs(found[f"{name}.effort"] - expected[f"{name}.effort"]).max()
        assert error <= 1e-9 * scale


def test_lengths_of_paths_without_wraps_are_those_of_opensim(measured):
    """At 50 random poses; conditional and moving points among them."""
    folder, scene = measured
    entries = scene.entries["paths"]
    plain = {
        name: {k: given for k, given in path.items() if k != "wraps"}
        for name, path in entries.items()
    }
    scene = scene.with_(paths=plain)
    prefix = "no_wrap_" if folder.parent.name == "arm26" else ""
    poses = table(folder / f"{prefix}random50_coordinates.csv.gz")
    expected = table(folder / f"{prefix}random50_lengths.csv.gz")
    positions = {n.removesuffix(".position"): row for n, row in poses.items() if n != "case"}
    for name, found in lengths(scene, positions).items():
        muscle = name.removesuffix("_path")
        stored = expected[f"{muscle}.length" if f"{muscle}.length" in expected else muscle]
        assert np.abs(found - stored).max() <= 1e-12


def test_the_written_scene_is_the_same_mechanism(measured, tmp_path, capsys):
    """Poses of links, masses and paths of both at a random pose."""
    folder, scene = measured
    model = folder / "raw" / SETS[folder.parent.name]
    assert main(["import-opensim", str(model), "-o", str(tmp_path / "made")]) == 0
    (written,) = (tmp_path / "made").glob("*.yaml")
    left_out = written.with_name(f"{written.stem}.left_out.txt").read_text().splitlines()
    said = capsys.readouterr().out.splitlines()
    assert [f"left out: {line}" for line in left_out] == [
        s for s in said[1:] if "nothing" not in s
    ]
    other = mbd.load_scene(written)
    assert list(other.entries["paths"]) == list(scene.entries["paths"])
    q = np.random.default_rng(3).uniform(-0.5, 0.5, scene.robot.model.nv)
    for name in scene.robot.joints:
        assert other.robot.joint(name.name) == name
    ours, theirs = (pin.crba(s.robot.model, s.robot.model.createData(), q) for s in (scene, other))
    assert np.array_equal(ours, theirs)
