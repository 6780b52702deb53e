"""CSV files: exact, strict, whole or not at all."""

import gzip
import resource

import numpy as np
import pytest
from places import RECORDINGS

from mbd_ros.errors import DataError
from mbd_ros.files.tables.csv import read_table, write_table

EDGE = [0.1, -0.0, 5e-324, 1.7976931348623157e308, 1 / 3, 1e22, -123456.789, 2**53 + 2.0]


@pytest.fixture
def values():
    """Numbers over the whole range of float64."""
    rng = np.random.default_rng(7)
    values = rng.integers(-(2**62), 2**62, (5000, 4)).view(np.float64)
    values = np.where(np.isfinite(values), values, 0.5)
    values[: len(EDGE), 1] = EDGE
    values[:, 0] = np.arange(5000) / 1000
    return values


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz"])
def test_round_trip_is_exact_to_the_bit(tmp_path, values, suffix):
    write_table(tmp_path / f"x{suffix}", ["time", "a", "b.c", "d"], values)
    table = read_table(tmp_path / f"x{suffix}")
    assert table.columns == ("time", "a", "b.c", "d")
    assert table.values.tobytes() == values.tobytes()
    assert [path.name for path in tmp_path.iterdir()] == [f"x{suffix}"]


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz"])
def test_equal_tables_give_equal_files(tmp_path, values, suffix):
    for name in ("one", "two"):
        write_table(tmp_path / (name + suffix), ["time", "a", "b", "c"], values)
    assert (tmp_path / f"one{suffix}").read_bytes() == (tmp_path / f"two{suffix}").read_bytes()


def test_windows_line_ends_mark_and_missing_last_newline_are_read(tmp_path):
    path = tmp_path / "x.csv"
    path.write_bytes(b"\xef\xbb\xbftime,a\r\n0,+1.\r\n1,.5e+0")
    assert read_table(path).values.tolist() == [[0, 1], [1, 0.5]]


CELLS = ["nan", "NaN", "inf", "-inf", "1e999", "1_000", "0x10", "", " 1", "1 ", "one", "1e", "--1"]
CELLS += ['"1"', "1;2", "\u0663", "True", "1.2.3", "1" * 400]


@pytest.mark.parametrize("cell", CELLS)
def test_cell_that_is_no_plain_number_is_named(tmp_path, cell):
    path = tmp_path / "x.csv"
    path.write_text(f"time,a,b\n0,1,2\n1,{cell},2\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"x\.csv: line 3, column a: '.*' is not a plain finite"):
        read_table(path)


FILES = {
    "is empty": b"",
    "has a header and no data": b"time,a\n",
    "line 1: first column is 'a', expected 'time'": b"a,time\n1,2\n",
    "line 1 repeats column a": b"time,a,a\n0,1,2\n",
    "line 1: column 2 has no name": b"time,,a\n0,1,2\n",
    "line 3 has 1 fields, expected 2": b"time,a\n0,1\n1\n",
    "line 3 has 3 fields, expected 2": b"time,a\n0,1\n1,2,3\n",
    "line 3 has 1 fields": b"time,a\n0,1\n\n1,2\n",
    "line 4, column time: 1.0 is not after 1.0": b"time,a\n0,1\n1,1\n1,1\n",
    "line 3, column time: -1.0 is not after 0.0": b"time,a\n0,1\n-1,1\n",
    "line 1 is not text": b"\xff\xfe\x00\x01\n0",
}


@pytest.mark.parametrize("message", FILES)
def test_malformed_file_is_refused_with_its_reason(tmp_path, message):
    path = tmp_path / "x.csv"
    path.write_bytes(FILES[message])
    with pytest.raises(DataError, match=f"x.csv: {message}"):
        read_table(path)


def test_missing_file_and_directory_are_refused(tmp_path):
    with pytest.raises(DataError, match=r"no\.csv: cannot be read \(No such file"):
        read_table(tmp_path / "no.csv")
    with pytest.raises(DataError, match="cannot be read"):
        read_table(tmp_path)


def test_nan_passes_only_in_columns_that_may_hold_it(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text("time,p,f\n0,nan,1\n1,2,nan\n")
    with pytest.raises(DataError, match="line 3, column f: 'nan'"):
        read_table(path, lambda column: column == "p")
    path.write_text("time,p,f\n0,nan,1\n1,2,3\n")
    values = read_table(path, lambda column: column == "p").values
    assert np.isnan(values[0, 1]) and np.isfinite(values).sum() == 5


def test_every_truncated_or_altered_gzip_is_refused_or_reads_well(tmp_path):
    path = tmp_path / "x.csv.gz"
    noise = np.random.default_rng(0).random(50)
    write_table(path, ["time", "a"], np.column_stack([np.arange(50), noise]))
    good, values, refused = path.read_bytes(), read_table(path).values, 0
    cuts = [good[:size] for size in range(0, len(good), 3)]
    flips = [bytes([*good[:i], good[i] ^ 0x10, *good[i + 1 :]]) for i in range(len(good))]
    for data in cuts + flips:
        path.write_bytes(data)
        try:
            assert (read_table(path).values == values).all()
        except DataError as error:
            refused += 1
            assert "x.csv.gz: " in str(error)
    assert refused > len(cuts + flips) - 12  # only flips in the header that carry no data pass


def test_places_that_cannot_be_written_are_refused(tmp_path):
    values = np.zeros((1, 1))
    with pytest.raises(DataError, match="no: directory .* does not exist|does not exist"):
        write_table(tmp_path / "no" / "x.csv", ["time"], values)
    (tmp_path / "x.csv").mkdir()
    with pytest.raises(DataError, match="not a regular file"):
        write_table(tmp_path / "x.csv", ["time"], values)
    with pytest.raises(DataError, match="2 columns for values of shape"):
        write_table(tmp_path / "y.csv", ["time", "a"], values)


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz"])
def test_write_that_fails_half_way_leaves_the_old_file_alone(tmp_path, values, suffix):
    """The system refuses to let the file grow beyond 20 kB, as a full disk would."""
    path = tmp_path / f"x{suffix}"
    path.write_bytes(b"old")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        with pytest.raises(DataError, match="cannot be written"):
            write_table(path, ["time", "a", "b", "c"], values)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 1


def test_recorded_walk_is_read_whole_and_exact():
    path = RECORDINGS / "gait10dof/walk" / "motion.csv.gz"
    table = read_table(path)
    lines = gzip.decompress(path.read_bytes()).decode().splitlines()[1:]
    assert table.values.tolist() == [[float(cell) for cell in line.split(",")] for line in lines]
