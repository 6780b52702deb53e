"""Plans to follow: a table `plan` of a result, in one file with the motion itself."""

from pathlib import Path

import numpy as np

from mbd_ros.errors import DataError, ModelError
from mbd_ros.files.table import TIME, Column, Result, Table, read_result
from mbd_ros.methods.control.tracking_plan import TrackingPlan

PLAN = "plan"  # table, and entry of the metadata
_FIELDS = ("position", "velocity", "effort", "gain", "cost")


def plan_table(plan: TrackingPlan) -> Table:
    """Columns of a plan, a row a sample."""
    arrays = plan.q, plan.v, plan.u, plan.gain, plan.cost
    columns = [Column(name, values) for name, values in zip(_FIELDS, arrays, strict=True)]
    return Table([Column(TIME, plan.times, "s"), *columns])


def plan_words(plan: TrackingPlan) -> dict[str, object]:
    """Return the metadata of a plan: names in the order of its arrays, and the tube."""
    return {"joints": list(plan.joints), "inputs": list(plan.inputs), "level": plan.level}


def read_plan(path: str | Path | Result) -> TrackingPlan:
    """The plan of a file, or of a result.

    Raises:
        DataError: It cannot be read, or holds none.
    """
    where = "plan" if isinstance(path, Result) else str(path)
    result = path if isinstance(path, Result) else read_result(path)
    words, table = result.metadata.get(PLAN), result.tables.get(PLAN)
    if not isinstance(words, dict) or table is None:
        raise DataError(f"{where}: holds no plan; `mbd-ros follow` writes one")
    try:
        joints, inputs = (tuple(map(str, words[key])) for key in ("joints", "inputs"))
        arrays = [np.asarray(table[name], dtype=np.float64) for name in (TIME, *_FIELDS)]
        return TrackingPlan(joints, inputs, *arrays, float(words["level"]))
    except (KeyError, TypeError, ValueError, ModelError) as error:
        raise DataError(f"{where}: holds no plan: {error}") from error
