"""Estimated torques against a reference, joint by joint."""

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path

import numpy as np

from mbd_ros.core.state import Array, Motion
from mbd_ros.errors import DataError
from mbd_ros.files.table import MAIN, Column, Result, Table
from mbd_ros.files.times import time_columns
from mbd_ros.motion.recordings import read_motion

UNIT = "N·m or N"


class TorqueErrors:
    """Root mean square errors of one recording of torques against another.

    The reference is interpolated to the stamps of the estimate; samples outside of it are left
    out.

    Args:
        estimate: Recording whose efforts are judged.
        reference: Recording of the same joints with the efforts to compare with.
        skip: Time left out at the start, where filters and controllers settle [s].

    Attributes:
        joints: Joints that the reference has.
        rms_error: [N·m or N], shape (len(joints),).
        rms_reference: [N·m or N], shape (len(joints),).
        overall: Norm of all errors over norm of all references.
        samples: Number of samples that are judged.
        stamps: Theirs [ns], shape (samples,).
        estimate: Their efforts [N·m or N], shape (samples, len(joints)).
        known: Those of the reference, same shape.
    """

    def __init__(self, estimate: Motion, reference: Motion, skip: float) -> None:
        columns = [i for i in range(len(estimate.names)) if _is_known(reference, i)]
        self.joints = tuple(estimate.names[i] for i in columns)
        begin = max(reference.stamps[0], estimate.stamps[0] + int(skip * 1e9))
        judged = (estimate.stamps >= begin) & (estimate.stamps <= reference.stamps[-1])
        stamps = estimate.stamps[judged]
        assert estimate.effort is not None
        known = np.empty((len(stamps), len(columns)))
        for i, column in enumerate(columns):
            known[:, i] = _interpolate(reference, column, stamps)
        error = estimate.effort[judged][:, columns] - known
        self.samples, self.stamps = len(stamps), stamps
        self.estimate, self.known = estimate.effort[judged][:, columns], known
        self.rms_error, self.rms_reference = _rms(error), _rms(known)
        total = float(np.linalg.norm(known))
        self.overall = float(np.linalg.norm(error)) / total if total > 0 else float("inf")

    def lines(self) -> Iterator[str]:
        """The table, a line each."""
        yield f"{'joint':<28}{'rms error':>12}{'rms reference':>16}{'error':>10}"
        for name, error, reference in zip(
            self.joints, self.rms_error, self.rms_reference, strict=True
        ):
            share = f"{100 * error / reference:.3f} %" if reference > 0 else "-"
            yield f"{name:<28}{error:>12.5g}{reference:>16.5g}{share:>10}"
        yield f"overall {100 * self.overall:.3f} % (norm of errors over norm of references)"

    def tables(self) -> dict[str, Table]:
        """`samples`: estimate, reference and error by time; `errors`: a row a joint."""
        kinds = {
            "effort": self.estimate,
            "reference": self.known,
            "error": self.estimate - self.known,
        }
        columns = time_columns(self.stamps)
        for kind, values in kinds.items():
            for name, column in zip(self.joints, values.T, strict=True):
                columns.append(Column(f"{name}.{kind}", column, UNIT))
        errors = [
            Column("joint", np.array(self.joints, dtype=np.str_)),
            Column("rms_error", self.rms_error, UNIT),
            Column("rms_reference", self.rms_reference, UNIT),
        ]
        return {MAIN: Table(columns), "errors": Table(errors)}


def compare(
    estimate: tuple[Path, str],
    reference: tuple[Path, str],
    joints: Sequence[str],
    skip: float,
    say: Callable[[str], None],
    members: Collection[str] = (),
) -> Result:
    """Compare two topics.

    Args:
        estimate: Bag and JointState topic of the torques.
        reference: Bag and JointState topic of the true ones.
        joints: Joints to compare.
        skip: Time left out at the start [s].
        say: Is told the table of errors, a line each.
        members: Names of robots in front of those of their joints, each of which has a topic of
            true ones beside the reference.

    Returns:
        Tables of `TorqueErrors`; metadata `overall`, and `overall_whole` without skipping.
    """
    if not 0 <= skip < math.inf:
        raise DataError(f"skip {skip:g} s must be finite and >= 0")
    judged = read_motion(estimate[0], joints, topic=estimate[1], required=()).motion
    known = read_motion(
        reference[0], joints, topic=reference[1], required=(), members=members
    ).motion
    if known.effort is None:
        say(f"{reference[0]}: no effort on {reference[1]}: nothing to compare with")
    settled, whole = TorqueErrors(judged, known, skip), TorqueErrors(judged, known, 0.0)
    overall = {"overall": settled.overall, "overall_whole": whole.overall}
    result = Result(settled.tables(), {key: v for key, v in overall.items() if math.isfinite(v)})
    if known.effort is None:
        return result
    say(f"against the effort on {reference[1]}, without the first {skip:g} s:")
    if not settled.samples:
        say("no sample is left to compare")
        return result
    for line in settled.lines():
        say(line)
    say(f"overall with the first {skip:g} s: {100 * whole.overall:.3f} %")
    return result


def _is_known(reference: Motion, column: int) -> bool:
    return reference.effort is not None and bool(np.isfinite(reference.effort[:, column]).any())


def _interpolate(reference: Motion, column: int, stamps: np.ndarray) -> Array:
    assert reference.effort is not None
    finite = np.isfinite(reference.effort[:, column])
    # Differences, since nanoseconds since 1970 have more digits than a float.
    begin = reference.stamps[0]
    values = reference.effort[finite, column]
    return np.interp(stamps - begin, reference.stamps[finite] - begin, values)


def _rms(values: Array) -> Array:
    return np.sqrt(np.sum(values**2, axis=0) / max(len(values), 1))
