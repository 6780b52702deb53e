"""Every format gives a result back, or says what it cannot hold and where it can go."""

import io
import json
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from installed_package import install

from mbd_ros.errors import DataError
from mbd_ros.files import formats
from mbd_ros.files.bags.bag_reader import messages, topic_types
from mbd_ros.files.bags.bag_writer import BagWriter
from mbd_ros.files.table import Column, Result, Table, read_result
from mbd_ros.motion.recordings import read_motion, read_wrenches

BAGS = ("bag", "bag.mcap", "bag.db3")
EVERY = ("o.csv", "o.csv.gz", "o.npz", "o.parquet", "o.mot", "o.sto.gz", *BAGS)


def scalars(n=50):
    rng = np.random.default_rng(7)
    names = [f"{j}.{f}" for f in ("position", "velocity", "acceleration", "effort") for j in "ab"]
    units = dict.fromkeys(names, "rad")
    columns = [Column(name, rng.standard_normal(n), units[name]) for name in names]
    columns += [Column("loop.x.multiplier", rng.standard_normal(n), "N", "base")]
    columns += [Column("energy", rng.standard_normal(n), "J")]
    return [Column("time", 0.1 * np.arange(n), "s"), *columns]


@pytest.fixture
def result():
    metadata = {"scene": "leg.yaml", "seed": 3, "versions": {"numpy": "2"}, "remarks": ["a", "ü"]}
    return Result({"samples": Table(scalars())}, metadata)


@pytest.fixture
def arrays():
    n = 20
    rng = np.random.default_rng(8)
    odd = np.array([np.nan, -0.0, 5e-324, np.inf, *rng.standard_normal(n - 4)])
    samples = [
        Column("time", np.arange(n) * 1e-3, "s"),
        Column("hand.rotation", rng.standard_normal((n, 3, 3)), "", "base"),
        Column("count", np.arange(n, dtype=np.int32)),
        Column("touches", np.arange(n) % 2 == 0),
        Column("odd", odd, "m"),
    ]
    events = [Column("time", np.zeros(0), "s"), Column("impulse", np.zeros((0, 3)), "N·s")]
    return Result({"samples": Table(samples), "events": Table(events)}, {"seed": 1})


@pytest.mark.parametrize("name", EVERY)
def test_scalars_come_back(tmp_path, result, name):
    path = tmp_path / name
    result.to(path)
    assert [item.name for item in tmp_path.iterdir()] == [name]
    read = read_result(path)
    if ".csv" in name:  # a contract without units and metadata
        assert list(read["samples"]) == list(result["samples"])
        assert all((read["samples"][c] == v).all() for c, v in result["samples"].items())
    else:
        assert read == result
        assert all(
            read["samples"][c].tobytes() == v.tobytes() for c, v in result["samples"].items()
        )


@pytest.mark.parametrize("name", ["o.npz", *BAGS])
def test_arrays_and_several_tables_come_back_to_the_bit(tmp_path, arrays, name):
    arrays.to(tmp_path / name)
    read = read_result(tmp_path / name)
    assert read == arrays
    for table in arrays:
        for column, values in arrays[table].items():
            found = read[table][column]
            assert found.tobytes() == values.tobytes() and found.dtype == values.dtype


def test_parquet_holds_one_table_of_any_shape_and_text(tmp_path, arrays):
    pytest.importorskip("pyarrow", reason="pyarrow is optional (extra: tables)")
    texts = Column("what", np.array([f"event {i}" for i in range(20)]))
    table = Table([*arrays["samples"].columns, texts])
    whole = Result({"samples": table}, arrays.metadata)
    whole.to_parquet(tmp_path / "o.parquet")
    read = read_result(tmp_path / "o.parquet")
    assert read == whole
    assert all(read["samples"][c].tobytes() == v.tobytes() for c, v in table.items())
    arrays.to_parquet(tmp_path / "e.parquet", table="events")
    assert read_result(tmp_path / "e.parquet")["events"] == arrays["events"]


def test_csv_refuses_a_3_by_3_column_and_says_where_it_can_go(tmp_path, arrays):
    sentence = (
        r"o.csv: column hand.rotation is float64 of shape 3 x 3 a row, this format holds one "
        r"number a row; .npz and .parquet hold every shape"
    )
    with pytest.raises(DataError, match=sentence):
        arrays.to_csv(tmp_path / "o.csv")
    text = Result({"samples": Table([Column("what", np.array(["a"]))])})
    for name in ("o.csv", "bag"):
        with pytest.raises(DataError, match="column what is str.* a row, this format holds"):
            text.to(tmp_path / name)
    wide = [Column(f"c{i}", np.zeros(1)) for i in range(10_001)]
    with pytest.raises(DataError, match=r"10001 columns, .csv holds 10000; .npz and .parquet"):
        Result({"samples": Table(wide)}).to_csv(tmp_path / "o.csv")
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_suffix_lists_what_is_accepted(tmp_path, result):
    accepted = r"accepted: .csv, .csv.gz, .mcap, .db3, .npz, .parquet.* folder of a bag"
    for call in (result.to, read_result):
        with pytest.raises(DataError, match=rf"o.xls: no format has this suffix; {accepted}"):
            call(tmp_path / "o.xls")
    with pytest.raises(DataError, match=r"o.csv: expected the suffix .npz"):
        result.to_npz(tmp_path / "o.csv")
    assert list(tmp_path.iterdir()) == []


def test_topics_say_which_messages_carry_the_columns(tmp_path, result):
    topics = {
        "/joint_torques": {"position": "position", "effort": "effort"},
        "/constraint_forces": {"effort": "multiplier"},
        "/energy": {"data": ["energy"]},
    }
    told = Result(result.tables, {**result.metadata, "topics": topics})
    told.to_bag(tmp_path / "bag")
    assert set(topic_types(tmp_path / "bag")) == {*topics, "/samples", "/result"}
    assert read_result(tmp_path / "bag") == told
    labels = [d.label for d in next(messages(tmp_path / "bag", {"/samples": MULTI}))[2].layout.dim]
    assert labels == ["time", *(f"{j}.{f}" for f in ("velocity", "acceleration") for j in "ab")]
    with pytest.raises(DataError, match="metadata topics: /a: fields place, accepted: position"):
        Result(result.tables, {"topics": {"/a": {"place": "position"}}}).to(tmp_path / "other")


MULTI = "std_msgs/msg/Float64MultiArray"


def test_times_of_today_keep_their_nanoseconds(tmp_path):
    from mbd_ros.files.table import stamps_of, time_columns

    stamps = 1_763_800_000_000_000_001 + 1_000_003 * np.arange(9)
    table = Table([*time_columns(stamps), Column("a.position", np.zeros(9), "rad")])
    assert list(table) == ["time", "stamp", "a.position"]
    assert [column.name for column in time_columns(1_000_000 * np.arange(5_000))] == ["time"]
    for name in ("o.npz", *BAGS):
        Result({"samples": table}).to(tmp_path / name)
        read = read_result(tmp_path / name)["samples"]
        assert read == table and (stamps_of(read) == stamps).all()
        assert (read_motion(tmp_path / name, ["a"]).motion.stamps == stamps).all()
    Result({"samples": table}).to(tmp_path / "o.csv")
    assert list(read_result(tmp_path / "o.csv")["samples"]) == ["time", "a.position"]


@pytest.mark.parametrize("name", ["memory", "o.csv", "o.npz", "o.parquet", "o.mcap"])
def test_a_motion_is_read_from_a_result_and_from_each_of_its_files(tmp_path, result, name):
    if name != "memory":
        result.to(tmp_path / name)
    motion = read_motion(result if name == "memory" else tmp_path / name, ["b", "a"]).motion
    assert (motion.position[:, 0] == result["samples"]["b.position"]).all()
    assert (motion.effort[:, 1] == result["samples"]["a.effort"]).all()
    assert motion.stamps.tolist() == [100_000_000 * i for i in range(50)] or name == "o.mcap"
    with pytest.raises(DataError, match="no .*c"):
        read_motion(result if name == "memory" else tmp_path / name, ["c"])


def test_wrenches_are_read_from_a_result(tmp_path):
    axes = [Column(f"plate.{f}.{x}", np.arange(4.0)) for f in ("force", "torque") for x in "xyz"]
    result = Result({"samples": Table([Column("time", np.arange(4.0), "s"), *axes])})
    result.to(tmp_path / "w.npz")
    for source in (result, tmp_path / "w.npz"):
        samples = read_wrenches(source, {"plate": None})["plate"]
        assert samples.wrench.tolist() == [[i] * 6 for i in range(4)]


def test_a_bag_of_others_gives_its_joint_states(tmp_path, result):
    result.to(tmp_path / "full")
    with BagWriter(tmp_path / "bare") as bag:
        for topic, time, message in messages(tmp_path / "full"):
            if topic == "/joint_states":
                bag.write(topic, "sensor_msgs/msg/JointState", time, message)
    read = read_result(tmp_path / "bare")["samples"]
    fields = ("position", "velocity", "effort")
    assert list(read) == ["time", *(f"{j}.{f}" for f in fields for j in "ab")]
    assert (read["b.effort"] == result["samples"]["b.effort"]).all()


@pytest.mark.parametrize("name", ["o.npz", "o.parquet", "bag.mcap", "bag.db3"])
def test_spoiled_files_are_refused_with_their_name(tmp_path, result, name):
    result.to(tmp_path / name)
    whole, rng = (tmp_path / name).read_bytes(), np.random.default_rng(3)
    for k in range(40):
        spoiled = bytearray(whole)
        if k % 2:
            spoiled = spoiled[: int(rng.integers(len(whole)))]
        else:
            spoiled[int(rng.integers(len(whole)))] ^= 1 << int(rng.integers(8))
        (tmp_path / name).write_bytes(spoiled)
        try:
            read = read_result(tmp_path / name)
        except DataError as error:
            assert name in str(error)
        else:
            assert isinstance(read["samples"], Table)
    with pytest.raises(DataError, match="nowhere"):
        read_result(tmp_path / f"nowhere{name[name.index('.') :]}")


def test_an_npz_of_others_is_refused(tmp_path):
    np.savez(tmp_path / "o.npz", a=np.zeros(3))
    with pytest.raises(DataError, match=r"o.npz: .*not a result of mbd_ros"):
        read_result(tmp_path / "o.npz")
    for text in (b"{}", b"[]", b"\xff", json.dumps({"mbd_ros": 9, "tables": {}, "metadata": {}})):
        description = np.frombuffer(text if isinstance(text, bytes) else text.encode(), np.uint8)
        np.savez(tmp_path / "o.npz", **{"description.json": description})
        with pytest.raises(DataError, match=r"o.npz: its description"):
            read_result(tmp_path / "o.npz")
    with zipfile.ZipFile(tmp_path / "o.npz", "w") as packed:
        packed.writestr("description.json.npy", np.lib.format.magic(1, 0) + b"\x00")
    with pytest.raises(DataError, match=r"o.npz"):
        read_result(tmp_path / "o.npz")


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_a_plot_is_written_and_not_read(tmp_path, result, suffix):
    path = tmp_path / f"o{suffix}"
    result.to(path)
    head = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}[suffix]
    assert path.read_bytes().startswith(head) and len(list(tmp_path.iterdir())) == 1
    with pytest.raises(DataError, match="a picture, which is only written"):
        read_result(path)


def test_a_plot_has_a_panel_a_quantity(result):
    drawn = result.plot()
    labels = [axes.get_ylabel() for axes in drawn.axes]
    assert labels == ["position\n[rad]", "velocity\n[rad]", "effort\n[rad]", "multiplier\n[N]"]
    line = drawn.axes[0].lines[1]
    assert (line.get_ydata() == result["samples"]["b.position"]).all()
    assert drawn.axes[-1].get_xlabel() == "time [s]" and drawn._repr_png_()[:4] == b"\x89PNG"
    assert len(result.plot(columns=["energy", "a.effort"]).axes) == 2
    with pytest.raises(DataError, match="o.csv: no suffix of a picture, accepted: .png"):
        result.plot("o.csv")
    with pytest.raises(DataError, match="no column knee; there are: time"):
        result.plot(columns=["knee"])


def test_formats_are_imported_when_a_path_asks_for_them(tmp_path):
    code = (
        "import sys; from mbd_ros.files.formats import *; from mbd_ros.files.table import *\n"
        "import numpy as np\n"
        "r = Result({'samples': Table([Column('time', np.arange(3.0))])})\n"
        f"for n in ('o.csv', 'o.npz'): r.to({str(tmp_path)!r} + '/' + n)\n"
        "print(sorted({'rosbags', 'matplotlib', 'pyarrow', 'pandas'} & {*sys.modules}))\n"
        "import importlib.metadata; print(suffix_of('a.csv'))"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.split("\n")[:2] == ["[]", ".csv"]


FORMAT = """
import json
from pathlib import Path

from mbd_ros.files.table import Column, Result, Table


class Lines:
    content, one_table = "one number a row", True

    def holds(self, column):
        return column.values.ndim == 1

    def read(self, path):
        columns = json.loads(Path(path).read_text())
        return Result({"samples": Table(Column(n, v, u) for n, v, u in columns)})

    def write(self, path, result):
        ((_, table),) = result.tables.items()
        rows = [[c.name, c.values.tolist(), c.unit] for c in table.columns]
        Path(path).write_text(json.dumps(rows))
"""


def test_a_format_of_an_installed_package_needs_one_file(tmp_path):
    """The package is built and installed by pip, into a folder of its own."""
    entries = {"jlines": "my_lines:Lines"}
    target = install(tmp_path, "my-lines", {"my_lines": FORMAT}, "mbd_ros.formats", entries)
    code = (
        f"import sys; sys.path.insert(0, {str(target)!r})\n"
        "import numpy as np\n"
        "from mbd_ros.files.formats import *; from mbd_ros.files.table import *\n"
        "from mbd_ros.motion.recordings import read_motion\n"
        "place = Column('a.position', np.ones(3), 'rad')\n"
        "t = Table([Column('time', np.arange(3.0), 's'), place])\n"
        f"path = {str(tmp_path)!r} + '/o.jlines'\n"
        "Result({'samples': t}).to(path)\n"
        "assert read_result(path)['samples'] == t\n"
        "assert read_motion(path, ['a']).motion.position.tolist() == [[1.0]] * 3\n"
        "try: suffix_of('o.xls')\n"
        "except Exception as error: print(error)\n"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert ".jlines" in ran.stdout


def test_a_format_that_cannot_be_imported_is_named(monkeypatch, tmp_path):
    from importlib.metadata import EntryPoint

    broken = EntryPoint("odd", "no_such_module:Odd", formats.GROUP)
    monkeypatch.setattr(formats, "_installed", lambda: {".odd": broken})
    with pytest.raises(DataError, match="format no_such_module:Odd of .odd cannot be imported"):
        Result({"samples": Table([])}).to(tmp_path / "o.odd")


def test_without_pyarrow_the_error_says_what_to_install(tmp_path, result, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(DataError, match=".parquet: pyarrow is not installed: pip install"):
        result.to(tmp_path / "o.parquet")
    assert list(tmp_path.iterdir()) == []


def test_metadata_is_what_json_holds():
    with pytest.raises(DataError, match="metadata: .*not JSON"):
        Result({}, {"file": io.StringIO()})
    assert Result({}, {"a": (1, 2)}).metadata == {"a": [1, 2]}
