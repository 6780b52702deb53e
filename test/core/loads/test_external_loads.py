"""A motion and force plates as a laboratory has them: loads of an .xml, torques as OpenSim's."""

import gzip
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from muscle_arm import SCENE, URDF, motion
from places import RECORDINGS
from scipy.interpolate import CubicSpline

from mbd_ros import read_result, scene_from
from mbd_ros.cli import main
from mbd_ros.errors import DataError
from mbd_ros.files.laboratory.external_loads import read_external_loads
from mbd_ros.files.table import Column, Result, Table
from mbd_ros.files.tables.csv import read_table
from mbd_ros.methods.signals.opensim_splines import opensim_splines

LOADS = """<?xml version="1.0" encoding="UTF-8" ?>
<OpenSimDocument Version="40000"><ExternalLoads name="grf"><objects>
<ExternalForce name="right foot">
  <applied_to_body>{body}</applied_to_body>
  <force_expressed_in_body>{axes}</force_expressed_in_body>
  <point_expressed_in_body>ground</point_expressed_in_body>
  <force_identifier>plate_v</force_identifier><point_identifier>plate_p</point_identifier>
  <torque_identifier>plate_m</torque_identifier>
  <data_source_name>{own}</data_source_name>
</ExternalForce>
<ExternalForce name="off"><appliesForce>false</appliesForce></ExternalForce>
</objects><datafile>{file}</datafile></ExternalLoads></OpenSimDocument>
"""
LABELS = [f"plate_{kind}{axis}" for kind in "vpm" for axis in "xyz"]
GIVEN = {"body": "link7", "axes": "ground", "own": "Unassigned", "file": r"..\data\plate.mot"}


def plate(times, values):
    rows = "".join("\t".join(map(repr, row)) + "\n" for row in np.c_[times, values].tolist())
    head = f"plate\nversion=1\nnRows={len(times)}\nnColumns=10\ninDegrees=yes\nendheader\n"
    return head + "\t".join(["time", *LABELS]) + "\n" + rows


@pytest.fixture
def laboratory(tmp_path):
    """An .xml and its data, which the .xml names with separators of Windows."""
    (tmp_path / "setup").mkdir()
    (tmp_path / "data").mkdir()
    times, rng = np.linspace(0.0, 1.0, 21), np.random.default_rng(4)
    values = rng.standard_normal((21, 9))
    (tmp_path / "data" / "plate.mot").write_text(plate(times, values))
    (tmp_path / "setup" / "grf.xml").write_text(LOADS.format(**GIVEN))
    return tmp_path / "setup" / "grf.xml", times, values


def changed(path, **other):
    path.write_text(LOADS.format(**{**GIVEN, **other}))
    return path


def test_columns_are_found_through_windows_separators_and_beside_the_file(laboratory):
    path, times, values = laboratory
    (load,) = read_external_loads(path)
    assert (load.name, load.body, load.frame) == ("right_foot", "link7", "ground")
    assert np.hstack([load.force, load.point, load.torque]).tolist() == values.tolist()
    assert load.stamps.tolist() == np.round(times * 1e9).tolist()
    (path.parents[1] / "data" / "plate.mot").rename(path.parent / "plate.mot")
    assert read_external_loads(path)[0].force.tolist() == values[:, :3].tolist()
    changed(path, file=r"C:\trials\plate.mot")
    assert read_external_loads(path)[0].force.tolist() == values[:, :3].tolist()
    changed(path, file="Unassigned", own="plate.mot")
    assert read_external_loads(path)[0].force.tolist() == values[:, :3].tolist()


def test_a_load_acts_by_splines_of_force_point_and_torque(laboratory):
    """Against the wrench columns of a table, with the splines taken here."""
    path, times, values = laboratory
    scene, n = scene_from(urdf="arm7"), 41
    joints = scene.couplings.independent
    time = np.linspace(0.0, 1.0, n)
    motion = {"time": time}
    for i, name in enumerate(joints):
        motion[f"{name}.position"] = 0.3 * np.sin(3.0 * time + i)
        motion[f"{name}.velocity"] = 0.9 * np.cos(3.0 * time + i)
        motion[f"{name}.acceleration"] = -2.7 * np.sin(3.0 * time + i)
    given = Result({"samples": Table(Column(k, v) for k, v in motion.items())})
    ours = scene.inverse(given, external=path)["samples"]
    force, point, torque = np.split(CubicSpline(times, values, bc_type="natural")(time), 3, axis=1)
    named = {"force": force, "torque": torque + np.cross(point, force)}
    columns = [Column("time", time)]
    columns += [
        Column(f"right_foot.{kind}.{axis}", v[:, i])
        for kind, v in named.items()
        for i, axis in enumerate("xyz")
    ]
    loaded = scene.with_(
        external_wrenches={"right_foot": {"frame": "link7", "expressed_in": "world"}}
    )
    theirs = loaded.inverse(given, wrenches=Result({"samples": Table(columns)}))["samples"]
    unloaded = scene.inverse(given)["samples"]
    for name in joints:
        effort = theirs[f"{name}.effort"]
        assert ours[f"{name}.effort"] == pytest.approx(effort, rel=1e-12, abs=1e-12)
    assert np.abs(theirs["joint1.effort"] - unloaded["joint1.effort"]).max() > 0.1


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"file": "no.mot"}, "data file 'no.mot' does not exist, looked for .*no.mot"),
        ({"file": ""}, "neither datafile nor data_source_name names a file"),
        ({"body": "ground"}, "applied_to_body 'ground', expected a body that moves"),
        (
            {"axes": "link7"},
            "force_expressed_in_body 'link7' and point_expressed_in_body 'ground'",
        ),
    ],
)
def test_bad_external_loads_are_refused(laboratory, change, match):
    path, _, _ = laboratory
    with pytest.raises(DataError, match=match):
        read_external_loads(changed(path, **change))


def test_bad_xml_and_columns_are_refused(laboratory):
    path, times, values = laboratory
    data = path.parents[1] / "data" / "plate.mot"
    text, good = path.read_text(), data.read_text()
    for bad, match in (
        (text[:-30], "not well-formed XML"),
        ("<a/>", "<a> without <ExternalLoads>"),
        (text.replace("plate_v<", "force_v<"), "force_identifier 'force_v' begins 0 columns"),
        (text.replace("plate_p<", "plate_<"), "point_identifier 'plate_' begins 9 columns"),
        (text.replace('"off"', '"right_foot"').replace("<applies", "<no"), "grf.xml"),
    ):
        path.write_text(bad)
        with pytest.raises(DataError, match=match):
            read_external_loads(path)
    path.write_text(text)
    data.write_text(plate(times, values * np.repeat([1.0, 1000.0, 1.0], 3)))
    with pytest.raises(DataError, match="points more than 100 m away, are they in mm"):
        read_external_loads(path)
    data.write_text(good.replace(repr(float(values[3, 1])), "nan"))
    with pytest.raises(DataError, match="plate_vx, plate_vy, plate_vz: no number at 0.15 s"):
        read_external_loads(path)


def test_loads_that_do_not_reach_over_the_motion_are_refused(laboratory, tmp_path):
    path, times, values = laboratory
    data = path.parents[1] / "data" / "plate.mot"
    names = [f"joint{i}" for i in range(1, 8)]
    rows = "".join(f"{t:.2f}\t" + "\t".join(["10"] * 7) + "\n" for t in np.arange(0, 1, 0.05))
    head = "Coordinates\nversion=1\nnRows=20\nnColumns=8\ninDegrees=yes\nendheader\n"
    (tmp_path / "walk.mot").write_text(head + "\t".join(["time", *names]) + "\n" + rows)
    scene = scene_from(urdf="arm7")
    for shift, match in (
        (5.0, "the times do not overlap"),
        (0.3, "loads do not cover the motion"),
    ):
        data.write_text(plate(times + shift, values))
        with pytest.raises(DataError, match=match):
            scene.inverse(tmp_path / "walk.mot", external=path)
    data.write_text(plate(times, values))
    with pytest.raises(DataError, match="is not accepted together with --wrenches"):
        scene.inverse(tmp_path / "walk.mot", external=path, wrenches=tmp_path / "walk.mot")
    changed(path, body="thumb")
    with pytest.raises(DataError, match="ExternalForce right_foot: no frame 'thumb'"):
        scene.inverse(tmp_path / "walk.mot", external=path)


def test_a_time_range_takes_samples_out_behind_the_filter(laboratory, tmp_path):
    path, _, _ = laboratory
    rows = "".join(f"{t!r}\t{90 * math.sin(3 * t)!r}\n" for t in np.arange(-1, 2, 0.05).tolist())
    head = "Coordinates\nversion=1\nnRows=60\nnColumns=2\ninDegrees=yes\nendheader\n"
    (tmp_path / "walk.mot").write_text(head + "time\tjoint2\n" + rows)
    scene, options = scene_from(urdf="arm7"), {"derivatives": "opensim", "cutoff": 4.0}
    whole = scene.inverse(tmp_path / "walk.mot", **options)["samples"]
    part = scene.inverse(tmp_path / "walk.mot", **options, external=path, time_range=(0.0, 1.0))
    table = part["samples"]
    inside = (whole["time"] > -1e-3) & (whole["time"] < 1.001)
    assert table["time"].tolist() == whole["time"][inside].tolist() and table.rows == 21
    found = table["joint2.acceleration"]
    assert found.tolist() == whole["joint2.acceleration"][inside].tolist()
    assert part.metadata["inputs"]["time_range"] == [0.0, 1.0]
    with pytest.raises(DataError, match="--time-range 3 4 contains no sample; the motion is at"):
        scene.inverse(tmp_path / "walk.mot", **options, time_range=(3.0, 4.0))


def test_muscles_share_a_part_and_say_what_is_odd_about_loads(laboratory):
    path, times, values = laboratory
    odd = plate([*times, times[-1]], [*values, values[-1]])
    (path.parents[1] / "data" / "plate.mot").write_text(odd)
    scene = scene_from(SCENE, urdf=URDF)
    given = {"external": changed(path, body="lower"), "reserves": 100.0}
    whole = scene.muscle_forces(motion(), **given)
    assert "1 rows at the time of the row before" in "\n".join(whole.metadata["remarks"])
    part = scene.muscle_forces(motion(), **given, time_range=(0.1, 0.2))
    time = whole["samples"]["time"]
    inside = (time > 0.0999) & (time < 0.2001)
    assert part["samples"]["time"].tolist() == time[inside].tolist()
    expected = whole["samples"]["front.activation"][inside]
    assert part["samples"]["front.activation"] == pytest.approx(expected, abs=1e-12)
    assert part.metadata["inputs"]["time_range"] == [0.1, 0.2]


def test_wrenches_of_another_vertical_are_turned(laboratory):
    """Force and torque as recorded with z upwards, for a scene with y upwards."""
    path, _, _ = laboratory
    load = {"plate": {"frame": "lower", "expressed_in": "world"}}
    scene, rng = scene_from({**SCENE, "external_wrenches": load}, urdf=URDF), np.random
    wrench = rng.default_rng(8).standard_normal((40, 6))
    time = motion()["samples"]["time"]
    kinds = [f"plate.{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz"]

    def plates(rows):
        columns = [Column(n, column) for n, column in zip(kinds, rows.T, strict=True)]
        return Result({"samples": Table([Column("time", time, "s"), *columns])})

    expected = scene.inverse(motion(), wrenches=plates(wrench))["samples"]["elbow.effort"]
    lying = wrench[:, [0, 2, 1, 3, 5, 4]] * [1, -1, 1, 1, -1, 1]
    options = {"wrenches": plates(lying), "wrench_axes": "x,z,-y"}
    found = scene.inverse(motion(), **options)
    assert found["samples"]["elbow.effort"] == pytest.approx(expected, abs=1e-12)
    assert found.metadata["inputs"]["wrench_axes"] == "x,z,-y"
    shared = scene.muscle_forces(motion(), reserves=1.0, **options)["samples"]
    assert shared["elbow.effort"] == pytest.approx(expected, abs=1e-12)
    for given, match in (
        ({"wrenches": plates(lying), "wrench_axes": "y,x,z"}, "--wrench-axes y,x,z is a mirror"),
        ({"wrenches": plates(lying), "wrench_axes": "screen"}, "it has no POINT:X_SCREEN"),
        (
            {"external": path, "wrench_axes": "x,z,-y"},
            "is not accepted together with --wrench-axes",
        ),
    ):
        with pytest.raises(DataError, match=match):
            scene.inverse(motion(), **given)


def test_a_motion_in_degrees_of_some_joints_gives_torques_and_says_what_is_assumed(tmp_path):
    scene = scene_from({"initial": {"position": {"joint7": 0.5}}}, urdf="arm7")
    labels = "time\tjoint1\tjoint2\tjoint3\tjoint4\tjoint5\tjoint6\tmarker_error"
    rows = "".join(f"{0.01 * i}\t{3 * i}\t-20\t5\t-90\t0\t60\t{i}\n" for i in range(50))
    head = "Coordinates\nversion=1\nnRows=50\nnColumns=8\ninDegrees=yes\nendheader\n"
    (tmp_path / "reach.mot").write_text(head + labels + "\n" + rows)
    result = scene.inverse(tmp_path / "reach.mot", derivatives="opensim", cutoff=np.inf)
    said = " ".join(result.metadata["remarks"])
    assert "some joints have no column and stay at their initial position: joint7 = 0.5" in said
    assert "columns of no joint, not used: marker_error" in said
    table = result["samples"]
    assert table["joint1.velocity"] == pytest.approx(np.full(50, np.deg2rad(300.0)), rel=1e-9)
    assert table["joint7.position"] == pytest.approx(np.full(50, 0.5), rel=1e-14)
    assert table["joint4.position"] == pytest.approx(np.full(50, -np.pi / 2), rel=1e-12)
    plain = scene.inverse(tmp_path / "reach.mot")
    assert "positions alone: opensim derivatives" in plain.metadata["remarks"]
    filtered = "opensim derivatives: low-pass at 6 Hz, both ways, quintic splines"
    assert filtered in plain.metadata["remarks"]
    assert plain.metadata["inputs"]["derivatives"] == "opensim"


def test_the_filter_is_two_passes_of_a_butterworth_filter():
    """A sine far from the ends passes by |H|^2 of a bilinear filter, tan prewarp, without lag."""
    rate, cutoff, n = 100.0, 6.0, 2001
    stamps = (np.arange(n) * 10_000_000).astype(np.int64)
    for f in (2.0, 6.0, 12.0):
        wave = np.sin(2 * np.pi * f * stamps * 1e-9 + 0.3)[:, None]
        ratio = np.tan(np.pi * f / rate) / np.tan(np.pi * cutoff / rate)
        expected = wave / (1.0 + ratio**6)
        passed = opensim_splines(stamps, wave, cutoff)
        middle = slice(900, 1100)
        assert passed.stamps.tolist() == stamps.tolist()
        assert passed.position[middle] == pytest.approx(expected[middle], abs=1e-9)
        w = 2 * np.pi * f
        second = -w * w * expected[middle]
        assert passed.acceleration[middle] == pytest.approx(second, abs=2e-3 * w * w)
    with pytest.raises(DataError, match="5 samples, quintic splines need 6"):
        opensim_splines(stamps[:5], wave[:5], cutoff)
    with pytest.raises(DataError, match="cutoff -1.0 Hz must be finite and > 0"):
        opensim_splines(stamps, wave, -1.0)


class Laboratory(NamedTuple):
    """Files of a set, unpacked."""

    model: Path
    motion: Path
    loads: list[Path]
    folder: Path  # of what OpenSim gives


@pytest.fixture(params=["gait10dof", "arm26"])
def trial(request, tmp_path):
    folder = RECORDINGS / request.param / "muscles"
    for packed in (folder / "raw").glob("*.gz"):
        (tmp_path / packed.stem).write_bytes(gzip.decompress(packed.read_bytes()))
    walk = request.param == "gait10dof"
    model = tmp_path / ("subject01.osim" if walk else "arm26.osim")
    motion = tmp_path / ("subject01_walk_IK.mot" if walk else "arm26_InverseKinematics.mot")
    return Laboratory(model, motion, [tmp_path / "subject01_walk_grf.xml"] * walk, folder)


def expected_of(path):
    table = read_table(path)
    return dict(zip(table.columns, table.values.T, strict=True))


def inverse(trial, *words):
    loads = ["--external", *trial.loads] if trial.loads else []
    return main([str(word) for word in ["inverse", trial.model, *words, *loads]])


def test_torques_from_the_files_of_the_laboratory_equal_those_of_opensim(trial, tmp_path):
    """From model, raw .mot and plates: 1e-8 of the largest, the digits of the reference."""
    out = tmp_path / "id.sto"
    asked = [] if trial.loads else ["--derivatives", "opensim", "--cutoff", "6"]
    assert inverse(trial, trial.motion, *asked, "-o", out) == 0
    ours = read_result(out)["samples"]
    expected = expected_of(trial.folder / "inverse_dynamics_tool.csv.gz")
    assert ours["time"] == pytest.approx(expected.pop("time"), abs=1e-9)
    assert len(expected) == (10 if trial.loads else 2)
    for column, values in expected.items():
        assert ours[column] == pytest.approx(values, abs=1e-8 * np.abs(values).max()), column
    assert inverse(trial, out, "-o", tmp_path / "again.csv") == 0
    again = read_result(tmp_path / "again.csv")["samples"]
    assert all(again[column] == pytest.approx(ours[column], abs=1e-9) for column in expected)


def test_torques_of_a_motion_that_is_given_equal_those_of_opensim(trial, tmp_path):
    out, motion = tmp_path / "id.csv", trial.folder / "motion.csv.gz"
    assert inverse(trial, motion, "-o", out) == 0
    ours = read_result(out)["samples"]
    expected = expected_of(trial.folder / "inverse_dynamics_no_muscles.csv.gz")
    del expected["time"]
    for column, values in expected.items():
        assert ours[column] == pytest.approx(values, abs=1e-9 * np.abs(values).max()), column


def test_each_trial_may_have_loads_of_its_own(laboratory, tmp_path, capsys):
    path, times, values = laboratory
    (path.parent / "other.xml").write_text(path.read_text().replace("plate.mot", "other.mot"))
    (path.parents[1] / "data" / "other.mot").write_text(plate(times, 2.0 * values))
    head = "Coordinates\nversion=1\nnRows=9\nnColumns=2\ninDegrees=yes\nendheader\n"
    rows = "".join(f"{0.1 * i}\t{10 * i}\n" for i in range(9))
    for name in "ab":
        (tmp_path / f"{name}.mot").write_text(head + "time\tjoint1\n" + rows)
    words = ["inverse", "arm7", tmp_path / "a.mot", tmp_path / "b.mot", "--derivatives", "opensim"]
    words += ["-o", tmp_path / "out", "--workers", 1, "--external", path]
    assert main([str(word) for word in [*words, path.parent / "other.xml"]]) == 0
    scene = scene_from(urdf="arm7")
    for name, file in (("a", path), ("b", path.parent / "other.xml")):
        found = read_result(tmp_path / "out" / f"{name}.mot")["samples"]
        expected = scene.inverse(tmp_path / f"{name}.mot", derivatives="opensim", external=file)
        assert found == expected["samples"]
    assert main([str(word) for word in [*words, path, path]]) == 2
    assert "names 3 files for 2 motions; accepted: one for all" in capsys.readouterr().err
