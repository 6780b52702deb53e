"""Loads on a body as tables."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.features.loads.fem.units import Units
from mbd_ros.features.loads.free_body_balance import inertial_load
from mbd_ros.features.loads.history import History
from mbd_ros.features.loads.instants import Instant
from mbd_ros.files.table import MAIN, Column, Table
from mbd_ros.files.times import time_columns

INSTANTS = "instants"


def tables_of(history: History, instants: Sequence[Instant], units: Units) -> dict[str, Table]:
    """Table `samples` with all loads, and table `instants` with the marked ones."""
    marked = np.zeros(len(history.stamps))
    marked[[each.row for each in instants]] = 1.0
    columns = [*time_columns(history.stamps), Column("is_instant", marked)]
    columns += _load_columns(history, units)
    columns += _inertial_columns(history, units)
    balance = history.balance()
    left, turning = (np.linalg.norm(each, axis=1) for each in balance[:2])
    columns += [
        Column("balance.force", left, "N"),
        Column("balance.torque", turning * units.per_metre, units.moment),
        Column("balance.off", balance.off),
    ]
    return {MAIN: Table(columns), INSTANTS: _instants(history, instants, units)}


def about_body(history: History, units: Units) -> dict[str, Any]:
    """What the metadata of the result says of the body, in its units."""
    inertia, L = history.inertia, units.per_metre
    mass = float(inertia.mass) * (1.0 if units.mass == "kg" else 1e-3)
    per_mass = mass / float(inertia.mass)
    return {
        "body": history.body,
        "links": list(history.links),
        "joints": list(history.joints),
        "kinds": {slot.name: slot.kind for slot in history.slots},
        "units": {"length": units.name, "mass": units.mass, "force": "N", "time": "s"},
        "mass": mass,
        "mass_centre": (inertia.lever * L).tolist(),
        "inertia": (inertia.inertia * per_mass * L**2).tolist(),
    }


def _load_columns(history: History, units: Units) -> list[Column]:
    columns, L = [], units.per_metre
    for i, slot in enumerate(history.slots):
        columns += _vectors(f"{slot.name}.force_", history.force[:, i], "N", history.body)
        moment = history.moment[:, i] * L
        columns += _vectors(f"{slot.name}.torque_", moment, units.moment, history.body)
        point = history.point[:, i] * L
        columns += _vectors(f"{slot.name}.point_", point, units.name, history.body)
    return columns


def _inertial_columns(history: History, units: Units) -> list[Column]:
    """Motion of the body, and what weight and inertia exert on it about its mass centre."""
    body, L, (gravity, push, spin, turn) = history.body, units.per_metre, history.motion
    force, moment = inertial_load(history.inertia, history.motion)
    weight = history.inertia.mass * gravity
    return [
        *_vectors("gravity.acceleration_", gravity * L, units.acceleration, body),
        *_vectors(f"{body}.linear_acceleration.", push * L, units.acceleration, body),
        *_vectors(f"{body}.angular_velocity.", spin, "rad/s", body),
        *_vectors(f"{body}.angular_acceleration.", turn, "rad/s^2", body),
        *_vectors("weight.force_", weight, "N", body),
        *_vectors("inertia.force_", force - weight, "N", body),
        *_vectors("inertia.torque_", moment * L, units.moment, body),
    ]


def _instants(history: History, instants: Sequence[Instant], units: Units) -> Table:
    turns = np.array([each.name.endswith(".torque") for each in instants], dtype=bool)
    values = np.array([each.value for each in instants]) * np.where(turns, units.per_metre, 1.0)
    rows = [each.row for each in instants]
    return Table(
        [
            Column("time", history.stamps[rows] * NANOSECOND, "s"),
            Column("row", np.array(rows, dtype=np.int64)),
            Column("name", np.array([each.name for each in instants], dtype=np.str_)),
            Column("value", values),
        ]
    )


def _vectors(name: str, values: Array, unit: str, frame: str) -> list[Column]:
    return [
        Column(f"{name}{axis}", np.array(column), unit, frame)
        for axis, column in zip("xyz", values.T, strict=True)
    ]
