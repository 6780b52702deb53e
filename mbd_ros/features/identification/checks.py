"""Whether efforts and motion can say anything, in words of who recorded them."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.identification.base_parameters import BaseParameters
from mbd_ros.features.identification.least_squares import Joint, solved

_LOW, _HIGH = 0.2, 5.0  # measured over given torque: no robot is described as badly as that
_MATTERS = 0.3  # of the torque: what the given robot explains at least, to compare units
_CONDITION = 2.0e4  # of scaled columns: more is a motion that hides some of them
_IN_PHASE = 3.0e2  # the same, of a motion in which all joints follow one another
_PART = 0.2  # of a hidden direction: parameters that are named
_FEWEST = 2.0  # independent rows for each unknown
_LITTLE = 0.02  # rad or m: a joint that moves less shows nothing


def check_units(
    where: str, labels: Sequence[str], joints: Sequence[Joint], given: Array, r: int
) -> None:
    """Refuse efforts that are the torque of the given robot times something else.

    Args:
        where: The recordings.
        labels: Names of the joints.
        joints: Their triangles.
        given: Base parameters of the description.
        r: Number of base parameters.

    Raises:
        DataError: Most joints that carry much say so.
    """
    slopes = {}
    for label, joint in zip(labels, joints, strict=True):
        model, y = joint.R[:, :r] @ given, joint.R[:, -1]
        plain = [i for i, c in enumerate(joint.columns) if c.term in ("viscous", "offset")]
        dry = [i for i, c in enumerate(joint.columns) if c.term == "coulomb"][2:3]
        others = joint.R[:, [r + i for i in plain + dry]]
        alone = model - others @ solved(others, model)[0] if others.shape[1] else model
        left = y - others @ solved(others, y)[0] if others.shape[1] else y
        if np.linalg.norm(alone) < 1e-9 * max(np.linalg.norm(y), 1e-300) or not left.any():
            continue
        along = float(alone @ left) / float(np.linalg.norm(alone) * np.linalg.norm(left))
        if (
            abs(along) > 1.0 - _MATTERS
            and np.linalg.norm(left) > _MATTERS * np.linalg.norm(y) / 3.0
        ):
            slopes[label] = float(alone @ left / (alone @ alone))
    off = {name: slope for name, slope in slopes.items() if not _LOW < slope < _HIGH}
    if off and 2 * len(off) > len(slopes):
        found = ", ".join(f"{name} {slope:.3g}" for name, slope in off.items())
        raise DataError(
            f"{where}: efforts are the torques of the given robot times {found}: these look like "
            "motor currents, torques before the gear or of the other sign, not N·m at the joint; "
            "give the torque for a unit of effort of each joint, --gain JOINT=VALUE .., or have "
            "it estimated from what is known, --currents"
        )


def check_excitation(
    where: str,
    base: BaseParameters,
    texts: Sequence[str],
    rows: Array,
    partial: bool,
    in_phase: bool = False,
) -> list[str]:
    """Refuse a motion that hides base parameters, or name them.

    Args:
        where: The recordings.
        base: What states can show.
        texts: Expressions of the base parameters.
        rows: Weighted rows of the base parameters, shape (k, r).
        partial: Name them only.
        in_phase: All joints move in one phase, which tells sums from parts by curvature alone.

    Raises:
        DataError: With the names.
    """
    most = _IN_PHASE if in_phase else _CONDITION
    scale = np.linalg.norm(rows, axis=0)
    hidden = scale <= 1e-9 * scale.max(initial=0.0)
    seen = np.flatnonzero(~hidden)
    _, s, V = np.linalg.svd(rows[:, seen] / scale[seen], full_matrices=True)
    s = np.r_[s, np.zeros(len(seen) - len(s))]
    weak = V[s * most < s.max(initial=0.0)]
    hidden[seen] |= (np.abs(weak) > _PART).any(axis=0)
    if not hidden.any():
        return []
    names = [texts[i] for i in np.flatnonzero(hidden)]
    how = ", all joints in one phase," if in_phase else ""
    said = f"{where}: the motion{how} does not show {'; '.join(names)}"
    if not partial:
        raise DataError(
            f"{said}. Move all joints, together and fast (mbd-ros excite makes such a motion), or "
            "go on without these (--partial)"
        )
    return [said]


def check_still(
    where: str,
    movement: Sequence[tuple[str, float, str]],
    texts: Sequence[str],
    partial: bool,
) -> list[str]:
    """Refuse joints that do not move, with the parameters that they would show.

    Args:
        where: The recordings.
        movement: Of each row: name, how far it moves [rad or m], body that it moves first.
        texts: Expressions of the base parameters.
        partial: Name them only.

    Raises:
        DataError: With the names.
    """
    said = []
    for label, far, body in movement:
        if far < _LITTLE:
            own = [text for text in texts if text.startswith(f"{body}.")]
            shown = f": that does not show {'; '.join(own)}" if own else ""
            said.append(f"{where}: {label} moves by {far:.2g} only{shown}")
    if said and not partial:
        raise DataError(f"{said[0]}. Let it move, or go on without these (--partial)")
    return said


def check_length(where: str, joints: Sequence[Joint], unknown: int, seconds: float) -> None:
    """Refuse a recording with fewer independent rows than unknowns.

    Raises:
        DataError: Says how long it would have to be.
    """
    rows = sum(joint.rows for joint in joints)
    if rows < _FEWEST * unknown:
        enough = f"; about {seconds * _FEWEST * unknown / rows:.3g} s would do" if rows else ""
        raise DataError(
            f"{where}: {seconds:.3g} s to learn from are too short: {rows:.0f} independent values "
            f"for {unknown} unknowns{enough}"
        )
