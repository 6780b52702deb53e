"""What time-stepped contacts leave of their laws, as columns and as a line for people."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.complementarity.contact_problem import Residuals
from mbd_ros.files.table import Column, Table

UNITS = {"primal": "m/s", "dual": "N·s", "cone": "N·s", "correction": "m/s"}


def with_residuals(table: Table, found: Sequence[Residuals]) -> Table:
    """The table with the worst residuals of the steps that lead to each sample.

    Args:
        table: One row a sample; perhaps without the last ones.
        found: One entry a sample.
    """
    values = np.array(found[: table.rows]).reshape(-1, len(UNITS))
    columns = zip(UNITS.items(), values.T, strict=True)
    more = [Column(f"contacts.residual.{name}", values, unit) for (name, unit), values in columns]
    return Table([*table.columns, *more])


def residual_line(found: Sequence[Residuals]) -> str:
    """The worst residuals of a run.

    Args:
        found: One entry a sample.
    """
    worst = np.array(found).max(axis=0)
    words = (
        f"{name} {value:.2g} {unit}"
        for (name, unit), value in zip(UNITS.items(), worst, strict=True)
    )
    return f"largest residuals of contacts: {', '.join(words)}"
