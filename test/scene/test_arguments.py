"""What annotations and docstrings say of the arguments of constructors."""

import math
from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

import pytest

from mbd_ros.core.ranges import Gain, Unit, Within, described
from mbd_ros.errors import ModelError
from mbd_ros.parts.controllers.sliding_mode import SlidingMode
from mbd_ros.scene.schema.schema import arguments, entries

DOC = """Say something.

    Args: of nothing, this is a sentence.

    Args:
        first: One line.
        second (float): Two lines,
            joined: with a colon.

            And a paragraph.
        *rest: Others.
        empty:

    Returns:
        first: not an argument.

    Attributes:
        third: Kept.
    Source: nobody.
    """


def test_a_section_of_a_docstring_is_read_entry_by_entry():
    assert entries(DOC) == {
        "first": "One line.",
        "second": "Two lines, joined: with a colon. And a paragraph.",
        "rest": "Others.",
        "empty": "",
    }
    assert entries(DOC, "Attributes") == {"third": "Kept."}
    assert entries(DOC, "Returns") == {"first": "not an argument."}
    assert entries(DOC, "Raises") == entries(None) == entries("") == entries("Args:") == {}
    assert entries("A.\n\nArgs:\n  a: b\n    c") == {"a": "b c"}


def test_the_outermost_range_and_unit_of_an_annotation_hold():
    inner = Annotated[float, Within(0.0, 1.0), Unit("m")]
    assert described(Annotated[inner, "a note"]) == (float, (0.0, 1.0, False), "m", None)
    assert described(Annotated[inner, Within(0.0, 2.0), Unit("mm")]) == (
        float,
        (0.0, 2.0, False),
        "mm",
        None,
    )
    assert described(float) == (float, None, "", None)


class Law:
    """A law.

    Args:
        joints: What it controls.
        kp: Stiffness.
        order: Of the filter.
        mode: How.
        soft: Whether it is.
    """

    def __init__(
        self,
        joints,
        *,
        kp: Annotated[Gain, Unit("1/s^2")],
        order: Annotated[int, Within(1, 8)] = 2,
        mode: Literal["slow", "fast"] = "slow",
        soft: bool = False,
        label: str = "",
    ):
        pass


class Values(NamedTuple):
    """Values.

    Attributes:
        cutoff: Of a filter.
    """

    cutoff: Annotated[float, Within(1.0, 2.0), Unit("Hz")] = 1.5


def test_arguments_of_a_class_in_the_order_of_its_constructor():
    kp, order, mode, soft, label = arguments(Law, skip=1)
    assert kp == ("kp", float, True, None, 0.0, math.inf, "1/s^2", (), "Stiffness.")
    assert order == ("order", int, False, 2, 1, 8, "", (), "Of the filter.")
    assert (mode.kind, mode.default, mode.choices) == (str, "slow", ("slow", "fast"))
    assert (soft.kind, soft.default, label.text) == (bool, False, "")


def test_arguments_of_a_named_tuple_are_its_fields():
    (cutoff,) = arguments(Values)
    assert cutoff == ("cutoff", float, False, 1.5, 1.0, 2.0, "Hz", (), "Of a filter.")


def test_a_law_of_the_package_is_described_whole():
    found = {gain.name: gain for gain in arguments(SlidingMode, skip=1)}
    assert found["gain"][1:7] == (float, True, 60.0, 0.0, math.inf, "rad/s^2 or m/s^2")
    assert found["law"].choices == ("constant", "exponential", "power_rate")
    assert found["power"][3:6] == (0.5, 1.0e-6, 0.999999)
    assert all(gain.text for gain in found.values())


def bare(value):
    pass


def mapped(value: dict[str, float]):
    pass


def listed(value: Sequence[float]):
    pass


def optional(value: float | None = None):
    pass


def numbered(value: Literal[1, 2] = 1):
    pass


def spread(*value: float):
    pass


@pytest.mark.parametrize("function", [bare, mapped, listed, optional, numbered, spread])
def test_an_argument_that_nobody_can_give_is_named(function):
    with pytest.raises(ModelError, match="argument 'value' has .* annotation.*; accepted: float,"):
        arguments(function)
