"""A motion with what explains it, and the power of that."""

from collections.abc import Callable, Collection, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.inverse_dynamics.power_balance import Exerted, PowerBalance
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array, State
from mbd_ros.files.table import Column
from mbd_ros.jobs.progress import progress
from mbd_ros.motion.columns import output_columns
from mbd_ros.scene.built_scene import Scene


class Explained(NamedTuple):
    """What explains a motion.

    Attributes:
        rows: Those of the multipliers.
        driven: Joints whose efforts are given.
        count: How many samples there are.
        motions: Gives, sample by sample, state, accelerations and what acts.
    """

    rows: ConstraintRows
    driven: Sequence[str]
    count: int
    motions: Callable[[], Iterator[tuple[State, Array, Exerted]]]


class Way(NamedTuple):
    """What a way to solve a motion gives.

    Attributes:
        columns: Of motion, efforts and multipliers.
        remarks: Lines for people.
        explained: The same as states and forces.
    """

    columns: list[Column]
    remarks: list[str]
    explained: Explained


def power_columns(
    scene: Scene, explained: Explained, wrenches: Sequence[Array], contacts: Collection[str]
) -> tuple[list[Column], str]:
    """Columns of powers, and a line about their balance.

    Args:
        scene: The scene.
        explained: What explains its motion.
        wrenches: One (n, 6) array for every load of the scene.
        contacts: Names of the loads that are forces of contacts.
    """
    rows, driven, count, motions = explained
    loads = scene.wrenches
    balance = PowerBalance(scene.robot, rows, driven, loads, scene.acting, contacts)
    values = np.array(
        [
            balance.values(*motion, [load[i] for load in wrenches])
            for i, motion in enumerate(progress(motions(), count, "power"))
        ]
    )
    columns = output_columns(balance.outputs, values)
    return columns, _balance_line(columns)


def _balance_line(columns: Sequence[Column]) -> str:
    """How far the powers are from the rate of the kinetic energy."""
    named = {column.name: column.values for column in columns}
    sums = [v for name, v in named.items() if name.startswith("power.") and "energy" not in name]
    off = float(np.abs(named["power.residual"]).max())
    largest = max(float(np.abs(values).max()) for values in sums)
    return f"power: balance off by at most {off:.2g} W, the largest sum is {largest:.4g} W"
