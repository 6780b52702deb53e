"""Columns, tables and results as values; what formats do with them is in test_formats."""

import numpy as np
import pytest

from mbd_ros.errors import DataError, MbdError
from mbd_ros.files.table import Column, Result, Table


def table(**changes):
    columns = {
        "time": Column("time", np.array([0.0, 0.1]), "s"),
        "knee.position": Column("knee.position", np.array([1.0, np.nan]), "rad"),
        "hand": Column("hand", np.arange(6.0).reshape(2, 3), "m", "base_link"),
        "event": Column("event", np.array(["stop", ""])),
    }
    return Table({**columns, **changes}.values())


def test_a_table_reads_by_name():
    one = table()
    assert list(one) == ["time", "knee.position", "hand", "event"]
    assert one["hand"].shape == (2, 3) and one.column("hand").frame == "base_link"
    assert [column.unit for column in one.columns] == ["s", "rad", "m", ""]
    assert one.rows == 2 and len(one) == 4 and "hand" in one and "foot" not in one
    assert list(one.first(1)["time"]) == [0.0]


def test_equal_are_the_same_numbers_names_units_and_shapes():
    assert table() == table()
    time = table().columns[0]
    for other in (
        time._replace(values=np.array([0.0, 0.1 + 1e-16])),
        time._replace(unit="ms"),
        time._replace(frame="base_link"),
        time._replace(values=np.array([0, 1])),
        time._replace(values=np.zeros((2, 1))),
        time._replace(name="t"),
    ):
        assert table() != table(time=other)
    assert table() != Table(table().columns[:-1])
    assert Result({"samples": table()}, {"seed": 1}) == Result({"samples": table()}, {"seed": 1})
    assert Result({"samples": table()}, {"seed": 1}) != Result({"samples": table()}, {"seed": 2})


def test_what_is_no_table_is_refused_by_name():
    with pytest.raises(DataError, match="unequal length: time has 2 rows, hip has 3"):
        table(hip=Column("hip", np.zeros(3)))
    with pytest.raises(DataError, match="repeated: time"):
        table(hip=Column("time", np.zeros(2)))
    with pytest.raises(DataError, match="column hip: object of shape"):
        table(hip=Column("hip", np.array([None, {}])))
    with pytest.raises(MbdError, match="no column knee; there are: time, knee.position") as found:
        table()["knee"]
    assert isinstance(found.value, KeyError) and not str(found.value).startswith("'")
    with pytest.raises(MbdError, match="no table events; there are: samples"):
        Result({"samples": table()})["events"]


def test_what_a_notebook_shows_is_short_and_escaped():
    wide = Table(Column(f"joint_{i}<b>.position", np.arange(500.0), "rad") for i in range(300))
    result = Result({f"table {i}": wide for i in range(30)}, {"scene": "x" * 5000})
    for text in (repr(wide), repr(result)):
        assert len(text.splitlines()) <= 10 and len(text) < 2000
    page = result._repr_html_()
    assert len(page) < 30_000 and "<b>" not in page and "500 rows, 300 columns" in page
    assert "joint_299&lt;b&gt;.position [rad]" in wide._repr_html_()


def test_a_dataframe_needs_pandas_and_says_so():
    result = Result({"samples": table()})
    pandas = pytest.importorskip("pandas", reason="pandas is optional (extra: tables)")
    frame = result.to_dataframe()
    assert list(frame.columns) == list(table()) and frame["hand"][1].tolist() == [3.0, 4.0, 5.0]
    assert isinstance(frame, pandas.DataFrame)


def test_without_pandas_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with pytest.raises(DataError, match="pandas is not installed: pip install pandas"):
        Result({"samples": table()}).to_dataframe()
