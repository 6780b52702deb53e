"""The contents of a file with a learned model: a network as ONNX, with what it belongs to.

The file says in its metadata for which robot it was learned and within which range, and holds the
SHA-256 of itself, computed with zeros in the place of the sum. Reading it runs no code.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.model.inertial_parameters import moving_bodies
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

VERSION = 1
ABOUT, SUM = "mbd_ros", "mbd_ros.sha256"  # keys of the metadata
ZEROS = "0" * 64
LARGEST = 64_000_000  # bytes
_SAME = 1.0e-6  # of the largest number of a body: what writing and reading a description leaves
_TABLES = ("robot", "physics", "bodies", "friction", "stiffness", "given")
_NONE: Mapping[str, Sequence[float]] = MappingProxyType({})
_VALUE = b"\x12\x40"  # protobuf: field 2, 64 bytes


class LearnedFile(NamedTuple):
    """A file that a scene names.

    Attributes:
        name: For the messages.
        content: Its bytes.
    """

    name: str
    content: bytes


class About(NamedTuple):
    """What a model says of itself.

    Attributes:
        kind: free or structured.
        scene: Name of the scene that it was learned on.
        joints: Whose torques it gives, in its order.
        low: Smallest positions and velocities that it has seen, shape (2 m,).
        high: Largest ones, same shape.
        robot: Numbers of the robot, as `numbers_of` gives them.
        physics: What else of the scene shapes its torques, as `physics_of` gives it; nothing where
            nobody wrote it down.
        bodies: Corrections of inertias, as `Corrections` takes them.
        friction: Corrections of friction, as `Corrections` takes them.
        stiffness: Corrections of stiffness, as `Corrections` takes them.
        given: Numbers of the robot before it was identified; nothing where it was not.
    """

    kind: str
    scene: str
    joints: tuple[str, ...]
    low: Array
    high: Array
    robot: Mapping[str, Sequence[float]]
    physics: Mapping[str, Sequence[float]] = _NONE
    bodies: Mapping[str, Sequence[float]] = _NONE
    friction: Mapping[str, Sequence[float]] = _NONE
    stiffness: Mapping[str, Sequence[float]] = _NONE
    given: Mapping[str, Sequence[float]] = _NONE

    def text(self) -> str:
        """As metadata of a file."""
        values = self._asdict() | {"low": self.low.tolist(), "high": self.high.tolist()}
        values |= {key: dict(values[key]) for key in _TABLES}
        return json.dumps({"version": VERSION, **values})


def signed(content: bytes) -> bytes:
    """A file that holds zeros in the place of its sum, with the sum.

    Raises:
        ValueError: There is no such place, or there are several.
    """
    if content.count(_place()) != 1:
        raise ValueError("the metadata have no place for the sum")
    return content.replace(_place() + ZEROS.encode(), _place() + _sum(content))


def about(file: LearnedFile) -> About:
    """What a file says of itself.

    Raises:
        ModelError: It is no such file, of another version, or damaged; names it.
    """
    content, place = file.content, _place()
    at = content.find(place) + len(place)
    if content.count(place) != 1 or len(content) < at + len(ZEROS):
        raise ModelError(f"{file.name} is no file of mbd-ros learn, or it is cut off")
    blank = content[:at] + ZEROS.encode() + content[at + len(ZEROS) :]
    if _sum(blank) != content[at : at + len(ZEROS)]:
        raise ModelError(f"{file.name} is damaged: its contents do not match their sum")
    return about_of(file.name, _metadata(file))


def _metadata(file: LearnedFile) -> dict[str, Any]:
    """The JSON of the metadata, from the bytes of the file."""
    start = file.content.find(b'{"version": ')
    try:
        text = file.content[start:].decode("utf-8", errors="replace")
        found, _ = json.JSONDecoder().raw_decode(text)
    except ValueError as error:
        raise ModelError(f"{file.name} does not say what it belongs to") from error
    if not isinstance(found, dict):
        raise ModelError(f"{file.name} does not say what it belongs to")
    return found


def about_of(name: str, found: dict[str, Any]) -> About:
    """What a model says of itself, from the values of its JSON.

    Args:
        name: For the messages.
        found: The values.

    Raises:
        ModelError: It is of another version, or does not say it; names it.
    """
    version = found.pop("version", None)
    if version != VERSION:
        raise ModelError(
            f"{name} has version {version!r} of learned models, accepted: {VERSION}; "
            "learn it again"
        )
    try:
        made = About(**found)
        low, high = (np.array(one, dtype=np.float64) for one in (made.low, made.high))
        joints = tuple(map(str, made.joints))
        tables: dict[str, Any] = {key: _table(getattr(made, key)) for key in _TABLES}
    except (TypeError, ValueError, AttributeError) as error:
        raise ModelError(f"{name} does not say what it belongs to: {error}") from error
    is_whole = low.shape == high.shape == (2 * len(joints),) and np.isfinite([low, high]).all()
    if not (is_whole and (low < high).all()):
        raise ModelError(f"{name}: its range is none")
    return made._replace(low=low, high=high, joints=joints, **tables)


def _table(given: Mapping[str, Sequence[float]]) -> dict[str, list[float]]:
    """Names and numbers.

    Raises:
        ValueError: A number that is not finite.
    """
    found = {str(key): [float(x) for x in values] for key, values in given.items()}
    if not all(np.isfinite(values).all() for values in found.values()):
        raise ValueError("a number is not finite")
    return found


def _place() -> bytes:
    """What stands before the sum."""
    return SUM.encode() + _VALUE


def _sum(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


def numbers_of(robot: Robot) -> dict[str, list[float]]:
    """Numbers by which a model knows its robot again.

    Gravity; of each body that hangs on something its ten inertial numbers, and where its joint
    stands on a body that moves, too. A base that is free in one scene and fixed in another is the
    same robot.
    """
    model, roots = robot.model, {0, *(base.joint for base in robot.bases)}
    found: dict[str, list[float]] = {"gravity": model.gravity.linear.tolist()}
    for body in moving_bodies(robot):
        if body.joint in roots:
            continue
        numbers = model.inertias[body.joint].toDynamicParameters().tolist()
        if int(model.parents[body.joint]) not in roots:
            place = model.jointPlacements[body.joint]
            numbers += [*place.translation.tolist(), *place.rotation.ravel().tolist()]
        found[body.name] = numbers
    return found


def check_robot(name: str, said: About, robot: Robot) -> None:
    """Refuse a model of another robot.

    Args:
        name: Of the file.
        said: What it says of itself.
        robot: The robot of the scene.

    Raises:
        ModelError: Names file, joint or body, and both numbers.
    """
    own = {joint.name for joint in robot.joints}
    missing = [joint for joint in said.joints if joint not in own]
    if missing:
        raise ModelError(
            f"{name} was learned on {said.scene}, another robot: it has a joint '{missing[0]}', "
            f"this one has {', '.join(joint.name for joint in robot.joints)}"
        )
    here = numbers_of(robot)
    for key, numbers in said.robot.items():
        if key not in here:
            raise ModelError(f"{name} was learned on {said.scene}, which has a body '{key}'")
        there = np.array(numbers, dtype=np.float64)
        size = max(float(np.abs(there).max(initial=0.0)), 1.0e-12)
        if there.shape != np.shape(here[key]) or np.abs(there - here[key]).max() > _SAME * size:
            what = key if key == "gravity" else f"inertia or place of '{key}'"
            raise ModelError(
                f"{name} was learned on {said.scene} with another {what}: a residual belongs to "
                "the numbers that it was learned on; learn it again, or load that scene"
            )
