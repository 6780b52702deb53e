"""Recordings of motion capture: markers and force plates of .c3d."""

import subprocess
import sys

import numpy as np
import pytest
from c3d_recordings import CORNERS, TURN, recording

from mbd_ros.errors import DataError
from mbd_ros.features.markers.job import with_axes
from mbd_ros.files.laboratory.markers import read_markers
from mbd_ros.files.table import Column, Result, Table, read_result
from mbd_ros.motion.recordings import read_capture, read_wrenches


@pytest.fixture(scope="module")
def ezc3d():
    return pytest.importorskip("ezc3d", reason="ezc3d is optional (extra: biomechanics)")


@pytest.mark.parametrize(("unit", "kind"), [("mm", 2), ("m", 2), ("mm", 3), ("mm", 4), ("m", 3)])
def test_markers_and_plates_are_read_in_si(ezc3d, tmp_path, unit, kind):
    rng = np.random.default_rng(9)
    wrenches = [(rng.standard_normal((8, 3)) * 100, rng.standard_normal((8, 3))) for _ in "ab"]
    positions = recording(ezc3d, tmp_path / "walk.c3d", wrenches, kind, unit)
    markers = read_markers(tmp_path / "walk.c3d")
    assert markers.labels == ("R.Knee Med", "Heel")
    assert markers.stamps.tolist() == [500_000_000 + 10_000_000 * i for i in range(4)]
    expected = positions.transpose(2, 1, 0)
    assert np.allclose(markers.position, expected, rtol=2e-7, atol=1e-7, equal_nan=True)
    loads = read_wrenches(tmp_path / "walk.c3d", {"plate1": None, "plate2": None})
    for (force, torque), name in zip(wrenches, loads, strict=True):
        assert loads[name].stamps.tolist() == [500_000_000 + 5_000_000 * i for i in range(8)]
        given = np.hstack([force, torque])
        assert loads[name].wrench == pytest.approx(given, abs=1e-4)
    with pytest.raises(DataError, match="no column plate3.force.x"):
        read_wrenches(tmp_path / "walk.c3d", {"plate3": None})


def test_axes_of_the_screen_turn_markers(ezc3d, tmp_path):
    """Forwards is -y and z upwards in the laboratory, x and y in the scene."""
    path = tmp_path / "walk.c3d"
    positions = recording(ezc3d, path)
    whole = ezc3d.c3d(str(path))
    whole.add_parameter("POINT", "X_SCREEN", ["-Y"])
    whole.add_parameter("POINT", "Y_SCREEN", ["+Z"])
    whole.write(str(path))
    capture = read_capture(path)
    assert capture.screen == ("-Y", "+Z")
    found = with_axes(capture, "screen").places
    x, y, z = positions
    expected = np.stack([-y, z, -x]).transpose(2, 1, 0)
    assert np.allclose(found, expected, rtol=2e-7, atol=1e-7, equal_nan=True)


def test_plates_that_give_their_centre_of_pressure(ezc3d, tmp_path):
    """Type 1: force, centre of pressure about the middle of the corners, and free moment."""
    path, force = tmp_path / "walk.c3d", np.full((8, 3), 10.0)
    recording(ezc3d, path, [(force, np.zeros((8, 3)))], kind=1)
    whole = ezc3d.c3d(str(path))
    raw = whole["data"]["analogs"][0]
    loads = read_wrenches(path, {"plate1": None})["plate1"].wrench
    places = CORNERS @ TURN.T
    R = np.column_stack([TURN[:, 0], TURN[:, 1], np.cross(TURN[:, 0], TURN[:, 1])])
    cop = places.mean(axis=0) + (R @ np.vstack([raw[3:5] / 1000.0, np.zeros(8)])).T
    free = (R @ np.vstack([np.zeros((2, 8)), raw[5] / 1000.0])).T
    assert loads[:, :3] == pytest.approx(force, abs=1e-4)
    assert loads[:, 3:] == pytest.approx(np.cross(cop, force) + free, abs=1e-4)


def test_markers_come_back_to_seven_digits(ezc3d, tmp_path):
    rng = np.random.default_rng(2)
    points = {"a b": rng.standard_normal((6, 3)), "c": rng.standard_normal((6, 3))}
    points["c"][1] = np.nan
    columns = [Column("time", 0.1 + np.arange(6) / 50.0, "s")]
    columns += [Column(name, values, "m", "ground") for name, values in points.items()]
    metadata = {"markers": list(points), "rate": 50.0}
    result = Result({"samples": Table(columns)}, metadata)
    result.to(tmp_path / "o.c3d")
    read = read_result(tmp_path / "o.c3d")
    assert read.metadata == metadata
    assert read["samples"]["time"] == pytest.approx(columns[0].values, abs=1e-9)
    for name, values in points.items():
        assert np.allclose(read["samples"][name], values, rtol=1e-7, atol=1e-7, equal_nan=True)
    odd = [Column("time", np.array([0.0, 0.1, 0.5]), "s"), Column("a", np.zeros((3, 3)), "m")]
    with pytest.raises(DataError, match=r".c3d holds markers at a steady rate, these are none"):
        Result({"samples": Table(odd)}).to(tmp_path / "odd.c3d")
    assert [item.name for item in tmp_path.iterdir()] == ["o.c3d"]


def test_bad_recordings_are_refused(ezc3d, tmp_path):
    path = tmp_path / "walk.c3d"
    recording(ezc3d, path, [(np.ones((8, 3)), np.ones((8, 3)))])
    whole = path.read_bytes()
    for content, match in (
        (b"", "no .c3d"),
        (b"abc", "no .c3d"),
        (whole[:600], "cannot be read as .c3d, or is cut"),
        (whole[:2] + b"\xff" * 2000, "cannot be read as .c3d, or is cut"),
    ):
        path.write_bytes(content)
        with pytest.raises(DataError, match=match):
            read_result(path)
    with pytest.raises(DataError, match="cannot be read"):
        read_result(tmp_path / "none.c3d")


def test_without_ezc3d_it_is_said_how_to_install_it(tmp_path):
    program = (
        "import sys; sys.modules['ezc3d'] = None\n"
        "from mbd_ros.files.table import read_result\n"
        f"read_result({str(tmp_path / 'walk.c3d')!r})\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert "ezc3d is not installed: pip install 'mbd_ros[biomechanics]'" in ended.stderr
