"""Marker files: labels with blanks, missing markers, units; all of it comes back."""

import gzip

import numpy as np
import pytest
from places import RECORDINGS

from mbd_ros.errors import DataError
from mbd_ros.files.laboratory.markers import read_markers
from mbd_ros.files.table import Column, Result, Table, read_result

HEAD = (
    "PathFileType\t4\t(X/Y/Z)\twalk.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\n"
    "100\t100\t3\t2\tmm\t100\n"
    "Frame#\tTime\tR.Knee Med\t\t\tHeel\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n\n"
)
ROWS = (
    "1\t0.00\t1000\t2000\t3000\t-10\t20\t30\n"
    "2\t0.01\t\t\t\t-11\t21\t31\n"
    "3\t0.02\t1002\t2002\t3002\n"
)


def written(folder, text, name="walk.trc"):
    path = folder / name
    path.write_bytes(gzip.compress(text.encode()) if name.endswith(".gz") else text.encode())
    return path


@pytest.mark.parametrize("name", ["walk.trc", "walk.trc.gz"])
def test_markers_are_read_in_metres_and_missing_ones_are_nan(tmp_path, name):
    markers = read_markers(written(tmp_path, HEAD + ROWS, name))
    assert markers.labels == ("R.Knee Med", "Heel")
    assert markers.stamps.tolist() == [0, 10_000_000, 20_000_000]
    nan = [np.nan] * 3
    expected = [[[1.0, 2.0, 3.0], [-0.01, 0.02, 0.03]], [nan, [-0.011, 0.021, 0.031]]]
    expected += [[[1.002, 2.002, 3.002], nan]]
    assert np.allclose(markers.position, expected, rtol=1e-15, atol=0, equal_nan=True)


@pytest.mark.parametrize(("unit", "scale"), [("m", 1.0), ("cm", 0.01), ("mm", 0.001)])
def test_units_are_those_of_the_header(tmp_path, unit, scale):
    text = (HEAD + ROWS).replace("\tmm\t", f"\t{unit}\t")
    position = read_markers(written(tmp_path, text)).position
    assert position[0, 1] == pytest.approx(np.array([-10.0, 20.0, 30.0]) * scale, rel=1e-15)


@pytest.mark.parametrize(("unit", "error"), [("m", 0.0), ("mm", 3e-16)])
def test_markers_come_back(tmp_path, unit, error):
    rng = np.random.default_rng(5)
    points = {name: rng.standard_normal((7, 3)) for name in ("a b", "L.Heel", "c")}
    points["c"][2:4] = np.nan
    columns = [Column(name, values, "m", "ground") for name, values in points.items()]
    time = Column("time", np.arange(7) / 60.0, "s")
    metadata = {"markers": list(points), "rate": 60.0}
    result = Result({"samples": Table([time, *columns])}, metadata)
    result.to(tmp_path / "o.trc", unit=unit)
    read = read_result(tmp_path / "o.trc")
    assert read.metadata == metadata and list(read["samples"]) == ["time", *points]
    assert read["samples"]["time"].tolist() == time.values.tolist()
    for name, values in points.items():
        found = read["samples"][name]
        assert np.allclose(found, values, rtol=error, atol=0.0, equal_nan=True)
    if unit == "m":
        assert read == result


def test_what_is_no_marker_is_not_written(tmp_path):
    time = Column("time", np.arange(2.0), "s")
    angle = Result({"samples": Table([time, Column("knee.position", np.zeros(2), "rad")])})
    with pytest.raises(DataError, match="this format holds three numbers a row, of a marker"):
        angle.to(tmp_path / "o.trc")
    points = Column("a", np.zeros((2, 3)), "m")
    with pytest.raises(DataError, match="expected a column time, and the unit m, cm, mm"):
        Result({"samples": Table([points])}).to(tmp_path / "o.trc")
    with pytest.raises(DataError, match="the unit m, cm, mm, not 'ft'"):
        Result({"samples": Table([time, points])}).to(tmp_path / "o.trc", unit="ft")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("PathFileType", "Path", "line 1 does not begin with PathFileType, so it is no .trc"),
        ("\tmm\t", "\tinch\t", "line 3: Units 'inch', accepted: m, cm, mm"),
        ("\tUnits\t", "\tUnit\t", "line 2 has no key Units; there are: datarate, camerarate"),
        ("\tmm\t", "\t", "line 2 has 6 keys, line 3 5 values"),
        ("100\t3\t2", "100\t4\t2", "has 3 frames, its header says 4"),
        ("100\t3\t2", "100\tx\t2", "line 3, column NumFrames: 'x' is not a plain finite number"),
        ("100\t3\t2", "100\t3\t2.5", "line 3: NumMarkers 2.5 is no whole number"),
        ("100\t3\t2", "100\t3\t3", "line 4 has 2 labels, NumMarkers says 3"),
        ("Heel", "R.Knee Med", "line 4 repeats label R.Knee Med"),
        ("Frame#", "Frame", "line 4 does not begin with Frame# and Time"),
        ("\t30\n", "\t30\t40\n", "line 7 has 9 cells, expected 8"),
        ("\t30\n", "\tabc\n", "line 7, column Heel Z: 'abc' is not a plain finite number"),
        ("\t30\n", "\n", "marker Heel at 0 s lacks some of its coordinates"),
        ("2\t0.01", "2\t0.05", "row 3 of the data, column time: 0.02 is not after 0.05"),
        ("2\t0.01", "2\t", "row 2 of the data, column time: nan"),
    ],
)
def test_bad_marker_files_are_refused(tmp_path, old, new, match):
    path = written(tmp_path, (HEAD + ROWS).replace(old, new, 1))
    with pytest.raises(DataError, match="walk.trc") as refused:
        read_result(path)
    assert match in str(refused.value)


def test_truncated_marker_files_are_refused(tmp_path):
    last = len(HEAD + ROWS) - len(ROWS.splitlines()[-1]) - 1
    for length, match in ((40, "line 2 has"), (120, "line 4"), (last, "has 2 frames, its header")):
        with pytest.raises(DataError, match=match):
            read_result(written(tmp_path, (HEAD + ROWS)[:length]))
    table = Result({"samples": Table([Column("time", np.zeros(1))])})
    with pytest.raises(DataError, match="the result: no markers: no columns of three numbers"):
        read_markers(table)


def test_a_recording_of_a_laboratory_is_read():
    """Against the same markers in another file."""
    folder = RECORDINGS / "gait10dof/marker_ik"
    markers = read_markers(folder / "raw" / "subject01_walk.trc.gz")
    assert markers.position.shape == (151, 41, 3) and markers.labels[:2] == ("R.ASIS", "L.ASIS")
    known = read_result(folder / "markers.csv.gz")["samples"]
    named = [label for label in markers.labels if f"{label}.x" in known]
    assert len(named) >= 30
    for label in named:
        theirs = np.column_stack([known[f"{label}.{axis}"] for axis in "xyz"])
        ours = markers.position[:, markers.labels.index(label)]
        assert ours == pytest.approx(theirs, abs=1e-8)
