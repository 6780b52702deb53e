"""What an identification is asked for, and what it returns."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.identification.regressor import TERMS
from mbd_ros.files.table import Table
from mbd_ros.jobs.progress import Say
from mbd_ros.motion.recordings import Source
from mbd_ros.scene.built_scene import Scene

AUTO = "auto"


class Task(NamedTuple):
    """What is asked for.

    Attributes:
        motions: Results, files or bags.
        wrenches: Of tables with external loads, one a motion, or none.
        topic: JointState topic of bags.
        derivatives: given or zero-phase; None: given where a motion has accelerations.
        band: End of the band that is looked at [Hz]; None: from the motion.
        friction: Terms of friction that may be taken, or `auto` for all.
        gains: Joint -> torque for a unit of its effort, such as a motor constant [N·m/A].
        passive: Joints without a motor.
        learned: Share of the time of each recording that is learned from.
        delay: Of efforts against motion [s]; None: estimated.
        held: Motions with a known load.
        payload: That load: link, and mass, centre and perhaps principal moments about it in the
            axes of the link.
        known: Links that the description has right.
        currents: Efforts are in other units, whose gains are estimated.
        partial: Go on with a motion that does not show all that states can show.
    """

    motions: Sequence[Source]
    wrenches: Sequence[Source] = ()
    topic: str = "/joint_states"
    derivatives: str | None = None
    band: float | None = None
    friction: Sequence[str] = (AUTO,)
    gains: Mapping[str, float] = {}
    passive: Sequence[str] = ()
    learned: float = 0.6
    delay: float | None = None
    partial: bool = False
    held: Sequence[Source] = ()
    payload: tuple[str, Sequence[float]] | None = None
    known: Sequence[str] = ()
    currents: bool = False

    @property
    def allowed(self) -> tuple[str, ...]:
        """Terms of friction that may be taken.

        Raises:
            DataError: A term that does not exist.
        """
        if list(self.friction) == [AUTO]:
            return TERMS
        if list(self.friction) == ["none"]:
            return ()
        unknown = [term for term in self.friction if term not in TERMS]
        if unknown:
            raise DataError(
                f"--friction {' '.join(unknown)}: accepted are {AUTO}, none, {', '.join(TERMS)}"
            )
        return tuple(self.friction)


class Identified(NamedTuple):
    """What an identification found.

    Attributes:
        scene: The scene with these numbers; its bodies are consistent.
        tables: `base_parameters`, `bodies`, `friction`, `drives`, `validation`, by name.
        inertias: Link -> `pinocchio.Inertia` that differs from the given one.
        covariance: Of the base parameters by least squares, shape (r, r).
        delay: Of efforts against the motion [s].
        band: End of the band that was looked at [Hz]; None for all that was measured.
        condition: Of the scaled, weighted rows.
        errors: Share of the torque that is not explained, of what was not learned from:
            `identified` and `given`, in the band, `.. as measured`, and so `.. without feedback`:
            with what drives answer to noise of the measured velocity.
        remarks: Lines for people.
        residuals: Of the test, for pictures: times [s], torques measured, identified and given,
            shape (n, m) each; None without a test.
    """

    scene: Scene
    tables: dict[str, Table]
    inertias: dict[str, Any]
    covariance: Array
    delay: float
    band: float | None
    condition: float
    errors: dict[str, float]
    remarks: list[str]
    residuals: tuple[Array, Array, Array, Array] | None


def keep_remarks(say: Say | None) -> tuple[list[str], Say]:
    """A list of lines for people, and what adds lines to it and says them."""
    remarks: list[str] = []

    def tell(line: str) -> None:
        remarks.append(line)
        if say is not None:
            say(line)

    return remarks, tell
