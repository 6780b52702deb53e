"""Recordings that a motion tracks."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.core.prediction.problem import Goal
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.files.formats import read_result
from mbd_ros.files.table import MAIN
from mbd_ros.files.times import TIME

_SAMPLES = 501  # of a recording that a search begins with


def recorded_lines(quantities: Any, file: Path) -> dict[str, tuple[float, ...]]:
    """A motion in a file as lines of a guess: quantity -> values at equal times.

    Raises:
        DataError: A file that cannot be read, or that has no quantity of the motion.
    """
    table = read_result(file)[MAIN]
    places = np.linspace(table[TIME][0], table[TIME][-1], _SAMPLES)
    found = {
        name: tuple(np.interp(places, table[TIME], table[name]).tolist())
        for name in table
        if name in quantities.names and quantities.find(name)[0].letter in tuple("qvzu")
    }
    if not found:
        raise DataError(f"{file}: no column of the motion, such as {quantities.names[0]}")
    return found


def references_of(goals: Sequence[Goal]) -> Any:
    """A function of the name of a quantity and times [s]: what recordings say it should be.

    Raises:
        DataError: A file that cannot be read.
    """
    tables = {
        goal.options["file"]: read_result(goal.options["file"])[MAIN]
        for goal in goals
        if goal.kind == "tracking"
    }

    def reference(name: str, times: Array) -> Array:
        for file, table in tables.items():
            if name in table:
                return np.interp(times, table[TIME] - table[TIME][0], table[name])
            names = ", ".join(list(table)[:20])
            raise DataError(f"{file}: no column {name}, which is tracked; there are {names}")
        raise DataError(f"{name} is tracked without a file")

    return reference
