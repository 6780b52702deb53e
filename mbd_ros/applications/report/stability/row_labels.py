"""The label of a row of the map."""

from collections.abc import Mapping
from typing import Any

from mbd_ros.applications.report.stability.cases import is_another

_WHOLE = 0.999  # of the span


def row_label(row: Mapping[str, Any]) -> str:
    """Label, with the steps that were run where others were asked for, and the compared time.

    Args:
        row: Outcome of an extreme scene, or of one of a user.
    """
    label = str(row["label"])
    if "x recommended" in label:
        label += _other_steps(row)
    if "span" in row and row["known_until"] < _WHOLE * row["span"]:
        label += f" (compared to {row['known_until']:.3g} of {row['span']:.3g} s)"
    return label


def _other_steps(row: Mapping[str, Any]) -> str:
    ran = [cell["ran"] for cell in row["cells"] if is_another(row["factor"], cell["ran"])]
    if not ran:
        return ""
    least, most = (f"{end(ran):.3g}" for end in (min, max))
    return f" ({least if least == most else f'{least} to {most}'} x)"
