"""Options and result of an identification."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.identification.regressor import TERMS
from mbd_ros.files.table import Table
from mbd_ros.jobs.progress import Say
from mbd_ros.motion.recordings import Source
from mbd_ros.scene.built_scene import Scene

AUTO = "auto"


class Task(NamedTuple):
    """Options of an identification.

    Attributes:
        motions: Results, tables or bags with positions and efforts.
        wrenches: Tables of the external loads, one per motion; a bag contains its own.
        topic: JointState topic of bags.
        derivatives: Source of velocities and accelerations. By default given for a motion with
            accelerations, else zero-phase.
        band: End of the frequency band of the fit [Hz]. By default it is chosen from the motion
            and printed.
        friction: Terms of friction that may be used: auto for all, none, or some of viscous,
            coulomb, offset, load, stribeck and inertia.
        gains: Torque for a unit of the effort of a joint, such as a motor constant behind a gear
            [N·m/A].
        passive: Joints without a motor. By default joints that place the first body, if nothing
            but wrenches is measured.
        learned: Share of the time of each recording that is used for the fit; the remaining part
            is for the test.
        delay: Delay of efforts against motion [s]. By default it is estimated.
        held: Recordings of the robot with a known load, which `payload` describes.
        payload: The known load: a link, and mass [kg], centre [m] and optionally principal moments
            about the centre [kg m^2], in the axes of the link.
        known: Links whose inertia in the description is right.
        currents: Efforts are in other units, such as motor currents. Their gains are estimated
            from a known load, link or force.
        partial: Accept a motion that hides some parameters; these keep their values.
    """

    motions: Sequence[Source]
    wrenches: Sequence[Source] = ()
    topic: str = "/joint_states"
    derivatives: Literal["given", "zero-phase"] | None = None
    band: float | None = None
    friction: Sequence[str] = ("auto",)
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
        """Terms of friction that may be used.

        Raises:
            DataError: A term does not exist.
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
    """Result of an identification.

    Attributes:
        scene: The identified scene; its bodies are physically consistent.
        tables: `base_parameters`, `bodies`, `friction`, `drives`, `validation`, by name.
        inertias: Link -> `pinocchio.Inertia`, for links whose inertia changed.
        covariance: Covariance of the base parameters by least squares, shape (r, r).
        delay: Delay of efforts against the motion [s].
        band: End of the frequency band of the fit [Hz]; None if samples were not filtered.
        condition: Condition number of the scaled, weighted rows.
        errors: Relative errors of the torques in the test. `identified` and `given` are those of
            the two scenes in the band, `.. as measured` those without a filter. `.. without
            feedback` are the latter without the correction for drives that feed the noise of the
            measured velocity back.
        remarks: Lines for people.
        residuals: Times [s] and torques measured, identified and given, shape (n, m) each, of the
            test; None without a test.
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
    """Return a list of lines, and a function that adds a line to it and passes it to `say`."""
    remarks: list[str] = []

    def tell(line: str) -> None:
        remarks.append(line)
        if say is not None:
            say(line)

    return remarks, tell
