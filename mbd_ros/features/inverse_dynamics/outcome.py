"""What every result of inverse dynamics says of itself, and what it must be."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbd_ros.core.inverse_dynamics.inverse_dynamics import TorqueComponents
from mbd_ros.errors import DataError
from mbd_ros.files.table import Table
from mbd_ros.files.times import TIME
from mbd_ros.motion.result_metadata import metadata_of
from mbd_ros.motion.samples import Task
from mbd_ros.scene.built_scene import Scene


def about_result(scene: Scene, task: Task, topics: Mapping[str, object]) -> dict[str, Any]:
    """Metadata of the result, `topics` those of the way it was found."""
    about_it = metadata_of("inverse", scene, _inputs(task), _topics(topics, task))
    return {**about_it, "stamps": "recorded"}


def _inputs(task: Task) -> dict[str, object]:
    """What the metadata of the result says."""
    source, cutoff, half_width = task.derivatives
    asked = {"motion": task.motion, "wrenches": task.wrenches, "derivatives": source}
    between = task.time_range and list(task.time_range)
    filters = {
        "time_range": between,
        "external": task.external,
        "cutoff": cutoff,
        "half_width": half_width,
    }
    also = {name: getattr(task, name) for name in ("parts", "bounds", "power", "wrench_axes")}
    stance = None if task.stance is None else task.stance.method
    return {**asked, **filters, **also, "stance": stance}


def _topics(topics: Mapping[str, object], task: Task) -> dict[str, object]:
    """Topics of a bag, see `files.bags.bag_streams`."""
    causes = TorqueComponents._fields if task.parts else ()
    return {**topics, **{f"/joint_torques/{cause}": {"effort": cause} for cause in causes}}


def check_finite(where: str, table: Table) -> None:
    """Refuse efforts and multipliers that are not."""
    kinds = ("position", "velocity", "acceleration", TIME, "stamp")
    found = [v for name, v in table.items() if name.rpartition(".")[2] not in kinds]
    bad = [int(np.flatnonzero(~np.isfinite(v))[0]) for v in found if not np.isfinite(v).all()]
    if bad:
        raise DataError(f"{where}: torques at {table[TIME][min(bad)]} s are not finite")
