"""Storages of OpenSim: what others write is read, what is written comes back, all else refused."""

import gzip

import numpy as np
import pytest

from mbd_ros.cli import main
from mbd_ros.errors import DataError
from mbd_ros.files.table import Column, Result, Table, read_result
from mbd_ros.motion.recordings import read_columns, read_motion

HEADER = "Coordinates\nversion=1\nnRows=3\nnColumns=3\ninDegrees={}\n\nUnits are S.I.\nendheader\n"
ROWS = "0.0\t90.0\t0.5\n0.1\t45.0\t0.6\n  0.2   -30.0\t0.7\n\n"
MOTION = HEADER.format("yes") + "time\tknee\tslide\n" + ROWS


def written(folder, text, name="walk.mot"):
    path = folder / name
    path.write_bytes(gzip.compress(text.encode()) if name.endswith(".gz") else text.encode())
    return path


@pytest.mark.parametrize("name", ["a.mot", "a.sto", "a.mot.gz", "a.sto.gz"])
def test_degrees_become_radians_of_the_joints_that_turn_alone(tmp_path, name):
    path = written(tmp_path, MOTION, name)
    raw = read_result(path)
    odd = {"repeated": [], "remarks": []}
    assert raw.metadata == {"name": "Coordinates", "in_degrees": True, **odd}
    assert raw["samples"]["knee"].tolist() == [90.0, 45.0, -30.0]
    motion = read_motion(path, ("knee", "slide"), sliding={"slide"}).motion
    assert motion.position == pytest.approx(
        np.column_stack([np.deg2rad([90.0, 45.0, -30.0]), [0.5, 0.6, 0.7]]), rel=1e-15
    )
    assert motion.velocity is None and motion.stamps.tolist() == [0, 100_000_000, 200_000_000]


def test_radians_stay_and_states_go_by_their_paths(tmp_path):
    labels = "time\t/jointset/knee_r/knee/value\t/jointset/knee_r/knee/speed\n"
    path = written(tmp_path, HEADER.format("no") + labels + ROWS, "states.sto")
    motion = read_motion(path, ("knee",)).motion
    assert motion.position.T.tolist() == [[90.0, 45.0, -30.0]]
    assert motion.velocity.T.tolist() == [[0.5, 0.6, 0.7]]
    old = written(tmp_path, HEADER.format("yes") + "time knee knee_u\n" + ROWS, "old.sto")
    velocity = read_motion(old, ("knee",)).motion.velocity
    assert velocity.T[0] == pytest.approx(np.deg2rad([0.5, 0.6, 0.7]), rel=1e-15)
    forces = HEADER.format("no") + "time knee_moment slide_force\n" + ROWS
    effort = read_motion(
        written(tmp_path, forces, "id.sto"), ("knee", "slide"), required=()
    ).motion.effort
    assert effort.T.tolist() == [[90.0, 45.0, -30.0], [0.5, 0.6, 0.7]]


def test_states_of_muscles_go_by_the_name_of_the_part(tmp_path):
    labels = "time\t/jointset/k/knee/value\t/forceset/soleus_r/activation\n"
    path = written(tmp_path, HEADER.format("no") + labels + ROWS, "states.sto")
    assert read_columns(path, ["soleus_r.activation"]).T.tolist() == [[0.5, 0.6, 0.7]]
    assert list(read_result(path)["samples"])[2] == "/forceset/soleus_r/activation"


def test_a_run_and_its_torques_go_through_storages_and_are_drawn(tmp_path):
    run, torques = tmp_path / "run.mot", tmp_path / "id.sto"
    for words in (
        ["simulate", "arm7", "-t", "0.02", "-o", run],
        ["inverse", "arm7", run, "-o", torques],
        ["simulate", "arm7", "-t", "0.01", "--from", run, "-o", tmp_path / "more.sto"],
        ["plot", torques, "-o", tmp_path / "id.svg"],
    ):
        assert main([str(word) for word in words]) == 0
    efforts = read_result(torques)["samples"]
    assert max(np.abs(efforts[f"joint{i}.effort"]).max() for i in range(1, 8)) < 1e-9


def test_simm_files_are_in_degrees_and_may_give_the_range_of_times_alone(tmp_path):
    simm = "name walk\ndatacolumns {}\ndatarows 3\notherdata 1\nrange 0.0 0.5\nendheader\n"
    with_time = written(tmp_path, simm.format(3) + "time knee slide\n" + ROWS)
    assert read_result(with_time).metadata["in_degrees"] is True
    without = written(tmp_path, simm.format(2) + "knee slide\n1 2\n3 4\n5 6\n", "b.mot")
    assert read_result(without)["samples"]["time"].tolist() == [0.0, 0.25, 0.5]


def test_a_joint_that_a_motion_lacks_stays_where_it_is_told(tmp_path):
    found = read_motion(
        written(tmp_path, MOTION), ("knee", "hip"), sliding=(), assumed=lambda name: 0.25
    )
    assert found.motion.position[:, 1].tolist() == [0.25, 0.25, 0.25]
    assert found.assumed == ("hip",) and found.unused == ("slide",)
    with pytest.raises(DataError, match="no column hip.position; there are: time, knee.position"):
        read_motion(written(tmp_path, MOTION), ("knee", "hip"))


@pytest.mark.parametrize("degrees", [False, True])
def test_a_result_comes_back_with_units_and_metadata(tmp_path, degrees):
    rng = np.random.default_rng(3)
    units = {"knee.position": "rad", "knee.effort": "N·m", "slide.velocity": "m/s", "load.x": "N"}
    columns = [Column("time", 0.1 * np.arange(9), "s")]
    columns += [Column(n, rng.standard_normal(9), u, "base") for n, u in units.items()]
    columns += [Column("knee.acceleration", np.r_[np.nan, rng.standard_normal(8)], "rad/s^2")]
    columns += [Column("phase", np.arange(9))]
    result = Result({"samples": Table(columns)}, {"scene": "leg", "remarks": ["a = b", "ü"]})
    result.to(tmp_path / "o.sto", degrees=degrees)
    read = read_result(tmp_path / "o.sto")
    assert read.metadata == result.metadata
    for ours, theirs in zip(result["samples"].columns, read["samples"].columns, strict=True):
        assert (ours.name, ours.unit, ours.frame) == (theirs.name, theirs.unit, theirs.frame)
        assert theirs.values.dtype == ours.values.dtype
        allowed = 4e-16 if degrees else 0.0  # to degrees and back
        assert np.allclose(ours.values, theirs.values, rtol=allowed, atol=0.0, equal_nan=True)
    lines = (tmp_path / "o.sto").read_text().splitlines()
    assert lines[4] == f"inDegrees={'yes' if degrees else 'no'}" and lines[6] == "endheader"
    labels = "time knee knee_moment slide_u load.x knee.acceleration phase"
    assert lines[7].split("\t") == labels.split()
    value = float(lines[8].split("\t")[1])
    scale = np.pi / 180 if degrees else 1.0
    assert value * scale == pytest.approx(columns[1].values[0], rel=1e-15)


def test_a_result_that_a_storage_cannot_hold_is_refused(tmp_path):
    time = Column("time", np.arange(2.0), "s")
    for column, match in (
        (Column("a", np.zeros((2, 3))), "float64 of shape 3 a row, this format holds one finite"),
        (Column("a", np.array([0.0, np.inf])), "column a is float64 a row"),
        (Column("a\tb", np.zeros(2)), "this format holds one finite number or nan a row"),
    ):
        with pytest.raises(DataError, match=match):
            Result({"samples": Table([time, column])}).to(tmp_path / "o.sto")
    with pytest.raises(DataError, match="the first column of table samples is no time"):
        Result({"samples": Table([Column("a", np.zeros(2))])}).to(tmp_path / "o.sto")
    both = [Column("knee.position", np.zeros(2), "rad"), Column("knee", np.zeros(2))]
    with pytest.raises(DataError, match="columns would meet at label knee"):
        Result({"samples": Table([time, *both])}).to(tmp_path / "o.sto")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "no line 'endheader', so it is no storage of OpenSim, or it is cut"),
        (HEADER.format("yes")[:-4], "no line 'endheader'"),
        (HEADER.format("yes"), "line 9: expected labels, there are none"),
        (HEADER.format("yes") + "time\tknee\tslide\n", "has a header and no data"),
        (
            MOTION[: MOTION.index("\n  0.2")],
            "has 2 rows, its header says 3, and the last line has",
        ),
        (MOTION.replace("0.6\n", "0.6"), "line 11 has 6 numbers, expected 3"),
        (MOTION[:-6], "line 12 has 2 numbers, expected 3"),
        (MOTION.replace("nColumns=3", "nColumns=4"), "has 3 columns, its header says 4"),
        (MOTION.replace("slide\n", "slide\textra\n"), "line 10 has 3 numbers, expected 4"),
        (MOTION.replace("slide\n", "knee\n"), "several columns are called knee"),
        (MOTION.replace("time\tknee", "time\t"), "line 9: column 2 has no label"),
        (MOTION.replace("time", "frame"), "line 9: first column is 'frame', expected 'time'"),
        (MOTION.replace("45.0", "4_5"), "line 11, column knee: '4_5' is not a plain finite"),
        (MOTION.replace("45.0", "inf"), "line 11, column knee: 'inf' is not a plain finite"),
        (MOTION.replace("45.0", "1,5"), "line 11, column knee: '1,5' is not a plain finite"),
        (MOTION.replace("0.1\t", "0.3\t"), "row 3 of the data, column time: 0.2 is not after 0.3"),
        (MOTION.replace("0.1\t", "nan\t"), "row 2 of the data, column time: nan is not after"),
        (MOTION.replace("45.0", "nan"), "column knee: no number at 0.1 s"),
        (
            MOTION.replace("slide\n", "/jointset/k/knee/value\n"),
            "columns knee and /jointset/k/knee/value are both knee.position",
        ),
    ],
)
def test_bad_storages_are_refused(tmp_path, text, match):
    with pytest.raises(DataError, match="walk.mot") as refused:
        read_motion(written(tmp_path, text), ("knee",))
    assert match in str(refused.value)


def test_what_files_of_laboratories_have_is_read_and_said(tmp_path):
    """Rows taken out by hand, rows written twice, labels of unused columns that repeat."""
    text = MOTION.replace("nRows=3", "nRows=5").replace("nColumns=3", "nColumns=5")
    text = text.replace("slide\n", "slide\tf\tf\n").replace("0.5\n", "0.5\t1\t2\n")
    text = text.replace("0.6\n", "0.6\t3\t4\n0.1\t45\t0.6\t3\t4\n").replace("0.7\n", "0.7\t5\t6\n")
    path = written(tmp_path, text)
    result = read_result(path)
    assert list(result["samples"]) == ["time", "knee", "slide", "f", "f (2)"]
    assert result["samples"]["f (2)"].tolist() == [2.0, 4.0, 6.0]
    assert result.metadata["repeated"] == ["f"]
    said = ("has 4 rows, its header says 5", "1 rows at the time of the row before are left out")
    found = read_motion(path, ("knee",))
    assert found.remarks == said and len(found.motion.stamps) == 3
    with pytest.raises(DataError, match="several columns are called f"):
        read_motion(path, ("f",))


def test_a_truncated_gzip_is_refused(tmp_path):
    path = written(tmp_path, MOTION, "walk.mot.gz")
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(DataError, match="truncated or corrupt gzip file"):
        read_result(path)


def test_a_header_of_another_kind_is_refused(tmp_path):
    Result({"samples": Table([Column("time", np.arange(3.0), "s")])}).to(tmp_path / "o.sto")
    text = (tmp_path / "o.sto").read_text()
    for change, match in (
        (text.replace('"mbd_ros": 1', '"mbd_ros": 2'), "is of another kind"),
        (text.replace('"dtype": "<f8"', '"dtype": "odd"'), "column time: of no known kind"),
        (text.replace("mbd_ros={", "mbd_ros=["), "its description of columns cannot be read"),
    ):
        with pytest.raises(DataError, match=match):
            read_result(written(tmp_path, change, "o.sto"))
