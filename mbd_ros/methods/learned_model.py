"""Learned corrections of a model: their torques, their range of validity, and their files.

    tau = Y(q, v, a) p + sum_k c_k tanh(v / v_k) + d v + offset + k (q - q0)

Y is the regressor of inverse dynamics, so p holds ten inertial parameters of each body, which are
added to those of the model. By themselves they need not be physically consistent.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.contracts import Load
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.inertial_parameters import COUNT, moving_bodies
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import NONE, Array, State
from mbd_ros.errors import ModelError

_NO_NUMBERS: Mapping[str, Sequence[float]] = MappingProxyType({})
FADE = 0.25  # default width of the fade, relative to half the range of an entry
VERSION = 1
FREE, STRUCTURED = "free", "structured"
KINDS = (FREE, STRUCTURED)
_SHOWN = 40  # characters of a wrong value in a message
ABOUT, SUM = "mbd_ros", "mbd_ros.sha256"  # keys of the metadata
ZEROS = "0" * 64
LARGEST = 64_000_000  # bytes
_TABLES = ("robot", "physics", "bodies", "friction", "stiffness", "given")
_VALUE = b"\x12\x40"  # protobuf: field 2, 64 bytes
_STATES = 4
_SAME = 1.0e-6  # relative difference of numbers that reading and writing a file can leave
_FORCE = "force "  # prefix of the names of forces
_ROTORS = "inertia of drives"


class Corrections:
    """Torque and inertia of learned corrections, on all joints.

    Y(q, v, a) p is computed as the difference of two robots: one with p added to some mass in each
    body, the other with that mass alone, since Pinocchio has no inertia without mass.

    Args:
        robot: The robot.
        bodies: Body -> ten inertial parameters that are added to its own.
        friction: Joint -> offset [N·m], viscous [N·m·s/rad], then a torque [N·m] and the velocity
            [rad/s] at which it has 76 % of its size, for each curve.
        stiffness: Joint -> k [N·m/rad] and q0 [rad].

    Raises:
        ModelError: A body or joint that the robot does not have, or numbers of another form.
    """

    def __init__(
        self,
        robot: Robot,
        bodies: Mapping[str, Sequence[float]],
        friction: Mapping[str, Sequence[float]],
        stiffness: Mapping[str, Sequence[float]] = _NO_NUMBERS,
    ) -> None:
        if any(len(values) != 2 for values in stiffness.values()):
            raise ModelError("each correction of stiffness needs two numbers: stiffness and rest")
        self._spring_v = [robot.joint(name).v for name in stiffness]
        self._spring_q = [robot.joint(name).q for name in stiffness]
        self._k, self._rest_position = np.array([*stiffness.values()]).reshape(-1, 2).T
        self.has_inertia, self._nv = bool(bodies), int(robot.model.nv)
        self._pairs = _pairs(robot, bodies) if bodies else ()
        self._zero = np.zeros(self._nv)
        self._at = [robot.joint(name).v for name in friction]
        if len({len(values) for values in friction.values()}) > 1:
            raise ModelError("all corrections of friction need the same number of values")
        table = np.array([*friction.values()], dtype=np.float64)
        if not self._at:
            return
        if table.shape[1] < 2 or table.shape[1] % 2 or not (table[:, 3::2] > 0.0).all():
            raise ModelError(
                "a correction of friction needs offset, viscous, then pairs torque, velocity > 0"
            )
        self._offset, self._viscous = table[:, 0], table[:, 1]
        self._size, self._bend = table[:, 2::2], table[:, 3::2]

    def torque(self, q: Array, v: Array) -> Array:
        """Return the torque at zero acceleration [N·m or N], shape (nv,)."""
        tau = np.zeros(self._nv)
        if self.has_inertia:
            heavy, light = (np.array(pin.rnea(*pair, q, v, self._zero)) for pair in self._pairs)
            tau += heavy - light
        if self._at:
            rate = v[self._at]
            dry = (self._size * np.tanh(rate[:, None] / self._bend)).sum(axis=1)
            tau[self._at] += dry + self._viscous * rate + self._offset
        if self._spring_v:
            tau[self._spring_v] += self._k * (q[self._spring_q] - self._rest_position)
        return tau

    def inertia(self, q: Array) -> Array:
        """Return the contribution to the mass matrix, shape (nv, nv)."""
        heavy, light = (np.array(pin.crba(*pair, q)) for pair in self._pairs)
        upper = np.triu(heavy - light)
        return np.asarray(upper + np.triu(upper, 1).T)

    def potential(self, q: Array) -> float:
        """Return the potential energy of gravity and springs of the corrections [J]."""
        energy = 0.5 * float(self._k @ np.square(q[self._spring_q] - self._rest_position))
        if not self.has_inertia:
            return energy
        heavy, light = (float(pin.computePotentialEnergy(*pair, q)) for pair in self._pairs)
        return energy + heavy - light


def _pairs(robot: Robot, bodies: Mapping[str, Sequence[float]]) -> tuple[tuple[Any, Any], ...]:
    """Return models with mass in each body, with and without corrections, and their data."""
    places = {body.name: body.joint for body in moving_bodies(robot)}
    for name, numbers in bodies.items():
        if name not in places:
            raise ModelError(f"the robot has no body '{name}'; accepted: {', '.join(places)}")
        if len(numbers) != COUNT:
            raise ModelError(
                f"the correction of '{name}' has {len(numbers)} numbers, accepted: {COUNT}"
            )
    largest = max(abs(numbers[0]) for numbers in bodies.values())
    some = (1.0 + 2.0 * largest) * np.eye(COUNT)[0]
    corrected, base = robot.model.copy(), robot.model.copy()
    for joint in range(1, robot.model.njoints):
        base.inertias[joint] = pin.Inertia.FromDynamicParameters(some)
        corrected.inertias[joint] = base.inertias[joint]
    for name, numbers in bodies.items():
        inertia = pin.Inertia.FromDynamicParameters(some + np.array(numbers))
        corrected.inertias[places[name]] = inertia
    return tuple((model, pin.Data(model)) for model in (corrected, base))


class TrainingRange:
    """Box of positions and velocities in the training data, beyond which a model fades out.

    Let d be the largest distance of an entry beyond its bound, relative to half its range. The
    share is 1 for d = 0, (1 + 2 d / fade) (1 - d / fade)^2 for d < fade, and 0 beyond.

    Args:
        low: Lower bounds, shape (n,).
        high: Upper bounds, shape (n,).
        fade: Width of the fade, relative to half the range of an entry.
    """

    def __init__(self, low: Array, high: Array, fade: float = FADE) -> None:
        self._middle, self._half = 0.5 * (low + high), 0.5 * (high - low)
        self._fade = fade

    def beyond(self, values: Array) -> Array:
        """Return the distance beyond the bounds relative to half the range, 0 inside, (n,)."""
        distance: Array = np.abs(values - self._middle) / self._half - 1.0
        return np.maximum(distance, 0.0)

    def share(self, values: Array) -> float:
        """Return the share of the model at these values, 0 .. 1."""
        far = float(self.beyond(values).max(initial=0.0)) / self._fade
        return (1.0 + 2.0 * far) * (1.0 - far) ** 2 if far < 1.0 else 0.0

    def shares(self, values: Array) -> Array:
        """Return the shares at many sets of values, one a row, shape (rows,)."""
        far = np.minimum(self.beyond(values).max(axis=1, initial=0.0) / self._fade, 1.0)
        return np.asarray((1.0 + 2.0 * far) * (1.0 - far) ** 2)


class LearnedFile(NamedTuple):
    """Content of a file with a learned model: a network in ONNX format.

    The metadata describe the robot and the range of training, and hold the SHA-256 of the file,
    computed with zeros in place of the sum. Reading the file runs no code.

    Attributes:
        name: Name of the file for messages.
        content: Bytes of the file.
    """

    name: str
    content: bytes


def about(file: LearnedFile) -> About:
    """Return the description in the metadata of a file.

    Raises:
        ModelError: The file holds no learned model, has another version, or is damaged.
    """
    content, place = file.content, _place()
    at = content.find(place) + len(place)
    if content.count(place) != 1 or len(content) < at + len(ZEROS):
        raise ModelError(f"{file.name} is not a file of mbd-ros learn, or it is truncated")
    blank = content[:at] + ZEROS.encode() + content[at + len(ZEROS) :]
    if _sum(blank) != content[at : at + len(ZEROS)]:
        raise ModelError(f"{file.name} is damaged: its content does not match its checksum")
    return about_in(file.name, _metadata(file))


class About(NamedTuple):
    """Description of a learned model, the metadata of its file.

    Attributes:
        kind: free or structured.
        scene: Name of the scene of its training.
        joints: Joints of its torques, in their order.
        low: Smallest positions, then velocities in the training data, shape (2 m,).
        high: Largest positions, then velocities in the training data, shape (2 m,).
        robot: Parameters of the robot, see `numbers_of`.
        physics: Other physics of the scene, see `physics_of`; empty if it was not recorded.
        bodies: Corrections of inertias, see `Corrections`.
        friction: Corrections of friction, see `Corrections`.
        stiffness: Corrections of stiffness, see `Corrections`.
        given: Parameters of the robot before its identification; empty if it was not identified.
    """

    kind: str
    scene: str
    joints: tuple[str, ...]
    low: Array
    high: Array
    robot: Mapping[str, Sequence[float]]
    physics: Mapping[str, Sequence[float]] = _NO_NUMBERS
    bodies: Mapping[str, Sequence[float]] = _NO_NUMBERS
    friction: Mapping[str, Sequence[float]] = _NO_NUMBERS
    stiffness: Mapping[str, Sequence[float]] = _NO_NUMBERS
    given: Mapping[str, Sequence[float]] = _NO_NUMBERS

    def text(self) -> str:
        """Return the description as JSON for the metadata of a file."""
        values = self._asdict() | {"low": self.low.tolist(), "high": self.high.tolist()}
        values |= {key: dict(values[key]) for key in _TABLES}
        return json.dumps({"version": VERSION, **values})


def _place() -> bytes:
    """Return the bytes that precede the checksum."""
    return SUM.encode() + _VALUE


def _sum(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


def _metadata(file: LearnedFile) -> str:
    """Return the text of a file from the JSON of its metadata on."""
    start = file.content.find(b'{"version": ')
    return file.content[start:].decode("utf-8", errors="replace") if start >= 0 else ""


def signed(content: bytes) -> bytes:
    """Return the content of a file with its checksum in place of zeros.

    Raises:
        ValueError: The content has no place for a checksum, or several.
    """
    if content.count(_place()) != 1:
        raise ValueError("the metadata have no place for the checksum")
    return content.replace(_place() + ZEROS.encode(), _place() + _sum(content))


def about_in(name: str, text: str) -> About:
    """Parse the description of a model from a text that begins with its JSON.

    Args:
        name: Name of the file for messages.
        text: The text.

    Raises:
        ModelError: The description is missing, incomplete or of another version.
    """
    try:
        fields, _ = json.JSONDecoder().raw_decode(text)
    except (ValueError, RecursionError) as error:
        raise ModelError(f"{name} has no valid description of its model") from error
    if not isinstance(fields, dict):
        raise ModelError(f"{name} has no valid description of its model")
    version = fields.pop("version", None)
    if version != VERSION:
        raise ModelError(
            f"{name} has version {str(version)[:_SHOWN]} of learned models, accepted: {VERSION}; "
            "learn it again"
        )
    try:
        about = About(**fields)
        low, high = (np.array(bound, dtype=np.float64) for bound in (about.low, about.high))
        joints = _names(about.joints)
        tables: dict[str, Any] = {key: _table(getattr(about, key)) for key in _TABLES}
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise ModelError(f"{name} has no valid description of its model: {error}") from error
    if about.kind not in KINDS or not isinstance(about.scene, str):
        raise ModelError(f"{name} has an unknown kind, accepted: {', '.join(KINDS)}")
    is_valid = low.shape == high.shape == (2 * len(joints),) and np.isfinite([low, high]).all()
    if not (is_valid and (low < high).all()):
        raise ModelError(
            f"{name}: low and high must be {2 * len(joints)} finite numbers each, with low < high"
        )
    return about._replace(low=low, high=high, joints=joints, **tables)


def _names(entry: Any) -> tuple[str, ...]:
    """Check that an entry is a list of different names, and return them.

    Raises:
        ValueError: It is not.
    """
    is_list = isinstance(entry, list) and all(isinstance(name, str) for name in entry)
    if not is_list or not entry or len(set(entry)) < len(entry):
        raise ValueError("joints must be a list of different names")
    return tuple(entry)


def _table(entry: Mapping[str, Sequence[float]]) -> dict[str, list[float]]:
    """Check that an entry maps names to finite numbers, and return it.

    Raises:
        ValueError: A number is not finite.
    """
    table = {str(key): [float(x) for x in values] for key, values in entry.items()}
    if not all(np.isfinite(values).all() for values in table.values()):
        raise ValueError("a number is not finite")
    return table


def check_robot(name: str, about: About, robot: Robot) -> None:
    """Check that a model was learned on a robot.

    Args:
        name: Name of the file.
        about: Description of the model.
        robot: The robot of the scene.

    Raises:
        ModelError: It was learned on another robot; the message names the joint or body.
    """
    joints = {joint.name for joint in robot.joints}
    missing = [joint for joint in about.joints if joint not in joints]
    if missing:
        raise ModelError(
            f"{name} was learned on {about.scene}, another robot: it has a joint '{missing[0]}', "
            f"this one has {', '.join(joint.name for joint in robot.joints)}"
        )
    here = numbers_of(robot)
    for key, numbers in about.robot.items():
        if key not in here:
            raise ModelError(f"{name} was learned on {about.scene}, which has a body '{key}'")
        there = np.array(numbers, dtype=np.float64)
        size = max(float(np.abs(there).max(initial=0.0)), 1.0e-12)
        if there.shape != np.shape(here[key]) or np.abs(there - here[key]).max() > _SAME * size:
            what = key if key == "gravity" else f"inertia or place of '{key}'"
            raise ModelError(
                f"{name} was learned on {about.scene} with another {what}: a residual belongs to "
                "the numbers that it was learned on; learn it again, or load that scene"
            )


def check_physics(name: str, about: About, here: Mapping[str, Sequence[float]]) -> None:
    """Check that a model was learned with the forces, couplings and drives of a scene.

    Args:
        name: Name of the file.
        about: Description of the model.
        here: Result of `physics_of` for the scene.

    Raises:
        ModelError: Something differs; the message names it.
    """
    same = _equal_forces(about.physics, here)
    for key in {**about.physics, **here} if about.physics else ():
        if key in same:
            continue
        there, ours = (np.array(p.get(key, ()), dtype=float) for p in (about.physics, here))
        if not len(ours):
            what = f"which had {key}; this scene has not"
        elif not len(there):
            what = f"which had no {key}; this scene has"
        elif there.shape != ours.shape or _differ(there, ours):
            what = f"with another {key}"
        else:
            continue
        raise ModelError(
            f"{name} was learned on {about.scene}, {what}: a residual belongs to the forces "
            "that it was learned beside; learn it again, or load that scene"
        )


def _equal_forces(
    there: Mapping[str, Sequence[float]], here: Mapping[str, Sequence[float]]
) -> set[str]:
    """Return the names of all forces if their sums are equal, whatever their names are."""
    names = [{key for key in physics if key.startswith(_FORCE)} for physics in (there, here)]
    sums = [
        np.sum([physics[key] for key in keys], axis=0)
        for physics, keys in zip((there, here), names, strict=True)
    ]
    is_same = sums[0].shape == sums[1].shape and sums[0].size and not _differ(*sums)
    return names[0] | names[1] if is_same else set()


def _differ(there: Array, here: Array) -> bool:
    return float(np.abs(there - here).max()) > _SAME * float(np.abs(there).max())


def physics_of(
    robot: Robot, couplings: Couplings, forces: Sequence[Load], about: About
) -> dict[str, list[float]]:
    """Return forces of parts, positions of dependent joints, and inertia of drives.

    These identify the physics of a scene: parameters can describe the same force in many forms,
    but the force itself is unique. Forces and positions are evaluated at some states within the
    range of the model.

    Args:
        robot: The robot.
        couplings: Dependent joints.
        forces: Parts without inputs, except the model itself.
        about: Joints and range of the model.

    Returns:
        Values by a readable name, without parts that exert no force.
    """
    parts = [part for part in forces if not part.inputs and not part.internal]
    k, at = Kinematics(robot), [robot.joint(name).v for name in about.joints]
    physics: dict[str, list[float]] = {}
    for q, v in _states(robot, couplings, about):
        k.refresh(q, v, max((part.reads for part in parts), default=Reads.NOTHING))
        for part in parts:
            force = part.force(k, State(0.0, q, v), NONE)[at]
            physics.setdefault(f"{_FORCE}'{part.name}'", []).extend(force.tolist())
        for name in couplings.dependent:
            place = float(q[robot.joint(name).q])
            physics.setdefault(f"coupling of '{name}'", []).append(place)
    physics = {name: values for name, values in physics.items() if np.any(values)}
    return physics | {_ROTORS: robot.model.armature[at].tolist()}


def _states(robot: Robot, couplings: Couplings, about: About) -> list[tuple[Array, Array]]:
    """Return random positions and velocities of all joints, always the same for a range."""
    random, m = np.random.default_rng(0), len(about.joints)
    joints, states = [robot.joint(name) for name in about.joints], []
    for _ in range(_STATES):
        values = random.uniform(about.low, about.high)
        q, v, a = robot.neutral().copy(), *np.zeros((2, robot.model.nv))
        for joint, place, rate in zip(joints, values[:m], values[m:], strict=True):
            q[joint.q], v[joint.v] = place, rate
        couplings.expand(q, v, a)
        states.append((q, v))
    return states


def numbers_of(robot: Robot) -> dict[str, list[float]]:
    """Return the parameters that identify a robot.

    These are gravity, the ten inertial parameters of each body except bases, and the placement of
    its joint if the parent is not a base. A robot with a free base and the same robot with a fixed
    base have the same parameters.
    """
    model, roots = robot.model, {0, *(base.joint for base in robot.bases)}
    parameters: dict[str, list[float]] = {"gravity": model.gravity.linear.tolist()}
    for body in moving_bodies(robot):
        if body.joint in roots:
            continue
        numbers = model.inertias[body.joint].toDynamicParameters().tolist()
        if int(model.parents[body.joint]) not in roots:
            place = model.jointPlacements[body.joint]
            numbers += [*place.translation.tolist(), *place.rotation.ravel().tolist()]
        parameters[body.name] = numbers
    return parameters
