"""Signatures as schemas: every value that does not fit is named with what is expected."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Optional

import pytest

from mbd_ros.core.ranges import Gain
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene.built_scene import Solver
from mbd_ros.scene.schema import schema


class Part:
    def __init__(self, robot, *, joint: str, size: float = 1.0, odd: Any = None):
        if size < 0:
            raise ModelError(f"size {size:g} must be >= 0")
        self.given = robot, joint, size, odd


@pytest.mark.parametrize(
    ("given", "hint", "expected"),
    [
        (3, float, 3.0),
        (3.5, float, 3.5),
        (3, int, 3),
        ("a", str, "a"),
        (True, bool, True),
        (None, float | None, None),
        (2, float | None, 2.0),
        (2, Optional[float], 2.0),  # noqa: UP045, other packages may write it so
        ([1, 2.5], Sequence[float], [1.0, 2.5]),
        ([1, 2], list[int], [1, 2]),
        ([[1], []], Sequence[Sequence[float]], [[1.0], []]),
        ({"a": 1}, Mapping[str, float], {"a": 1.0}),
        ({"a": [1]}, dict[str, Sequence[float]], {"a": [1.0]}),
        ({"a": [1, "x"]}, Any, {"a": [1, "x"]}),
        ([1], list, [1]),
        ("b", Literal["a", "b"], "b"),
        (1, Gain, 1.0),
        ([1, 2.5], Gain, [1.0, 2.5]),
    ],
)
def test_value_that_fits_passes_and_integers_are_numbers(given, hint, expected):
    read = schema.value(given, hint, "f: k")
    assert read == expected
    assert type(read) is type(expected)


@pytest.mark.parametrize(
    ("given", "hint", "message"),
    [
        ("nan", float, "f: k: expected a number, got 'nan'"),
        (True, float, "f: k: expected a number, got True"),
        (None, float, "f: k: expected a number, got None"),
        (1.0, int, "f: k: expected an integer, got 1.0"),
        (False, int, "f: k: expected an integer, got False"),
        (1, str, "f: k: expected a word, got 1"),
        ("yes", bool, "f: k: expected true or false, got 'yes'"),
        (1, bool, "f: k: expected true or false, got 1"),
        ("x", float | None, "f: k: expected a number, got 'x'"),
        (1.0, Sequence[float], "f: k: expected a list, got 1.0"),
        ("ab", Sequence[str], "f: k: expected a list, got 'ab'"),
        ([1, [2]], Sequence[float], "f: k[1]: expected a number, got [2]"),
        ([1], Mapping[str, float], "f: k: expected a mapping, got [1]"),
        ({"a": {"b": "x"}}, Mapping[str, Mapping[str, float]], "f: k.a.b: expected a number"),
        ("/tmp", Path, "f: k: expected <class 'pathlib"),
        ("c", Literal["a", "b"], "f: k: expected one of a, b, got 'c'"),
        ([1, -1], Gain, "f: k[1]: -1 is out of range, accepted: 0 .. inf"),
        (-1, Gain, "f: k: -1 is out of range, accepted: 0 .. inf"),
        ("x", Gain, "f: k: expected a number, got 'x'"),
    ],
)
def test_value_that_does_not_fit_is_named(given, hint, message):
    with pytest.raises(SceneError) as caught:
        schema.value(given, hint, "f: k")
    assert message in str(caught.value)


def test_entry_becomes_arguments_after_the_context():
    assert schema.call(Part, {"joint": "a", "size": 2}, "f: k", "R").given == ("R", "a", 2.0, None)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"joint": "a", "sise": 1}, "f: k: unknown key 'sise', accepted: joint, size, odd"),
        ("ideal", "f: k: expected a mapping, got 'ideal'"),
        ({"joint": "a", "robot": "b"}, "f: k: unknown key 'robot', accepted: joint, size, odd"),
        ({"size": 1}, "f: k: key 'joint' is missing"),
        ({"joint": "a", "size": "b"}, "f: k.size: expected a number, got 'b'"),
        ({"joint": "a", "size": -2}, "f: k: size -2 must be >= 0"),
        (None, "f: k: expected a mapping, got None"),
        ([1], "f: k: expected a mapping, got [1]"),
    ],
)
def test_entry_that_does_not_fit_is_named(entry, message):
    with pytest.raises(SceneError) as caught:
        schema.call(Part, entry, "f: k", "R")
    assert str(caught.value) == message


def test_what_takes_no_key_says_so_and_a_bare_type_gets_a_hint():
    with pytest.raises(SceneError, match="f: k: unknown key 'a', accepted: none$"):
        schema.call(lambda: None, {"a": 1}, "f: k")
    with pytest.raises(SceneError, match=r"f: k: expected .*, got 'x': write \{type: x\}$"):
        schema.call(Solver, "x", "f: k")
