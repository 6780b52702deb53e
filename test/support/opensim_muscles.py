"""Muscles of the recorded sets as entries of a scene, and their tables."""

import csv
import gzip

import numpy as np

from mbd_ros.api import scene_from

ANY_PATH = {"points": [{"frame": "world", "xyz": [0.1, 0.0, 1.0]}, {"frame": "foot"}]}
SHARED = {
    "max_isometric_force": "max_isometric_force",
    "optimal_fiber_length": "optimal_fiber_length",
    "tendon_slack_length": "tendon_slack_length",
    "pennation_angle": "pennation_at_optimal",
    "maximum_pennation_angle": "maximum_pennation_angle",
    "max_contraction_velocity": "max_contraction_velocity",
    "activation_time": "activation_time_constant",
    "deactivation_time": "deactivation_time_constant",
    "minimum_activation": "minimum_activation",
}
THELEN = {
    "active_shape": "KshapeActive",
    "passive_shape": "KshapePassive",
    "passive_strain": "FmaxMuscleStrain",
    "tendon_strain": "FmaxTendonStrain",
    "velocity_shape": "Af",
    "lengthening_force": "Flen",
    "fv_extrapolation": "fv_linear_extrap_threshold",
}


def entries(folder):
    """Muscles of a set without their paths, by name."""
    with (folder / "muscles.csv").open(encoding="utf-8") as file:
        return {row["muscle"]: entry(row) for row in csv.DictReader(file)}


def entry(row):
    """A muscle of a table; curves of Millard stand at their defaults in all sets."""
    thelen = row["class"] == "Thelen2003Muscle"
    keys = SHARED | (THELEN if thelen else {"damping": "fiber_damping"})
    numbers = {key: float(row[column]) for key, column in keys.items()}
    return {"type": "thelen" if thelen else "millard", "name": row["muscle"], **numbers}


def muscles(folder, **more):
    """The muscles of a set as parts, along some path."""
    given = [{**one, "path": ANY_PATH, **more} for one in entries(folder).values()]
    return scene_from({"muscles": given}, urdf="prosthetic_leg").muscles


def columns(path):
    """Column -> values, NaN where OpenSim has none."""
    with gzip.open(path, "rt", encoding="utf-8") as file:
        names = next(file).strip().split(",")
        return dict(zip(names, np.loadtxt(file, delimiter=",").T, strict=True))


def at_times(table, times):
    """Rows of a table at some of its times."""
    rows = [int(np.abs(table["time"] - t).argmin()) for t in times]
    return {name: values[rows] for name, values in table.items()}
