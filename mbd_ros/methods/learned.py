"""Learned corrections of a model: what a file of them holds, and how far they are trusted.

    tau = Y(q, v, a) p + sum_k c_k tanh(v / v_k) + d v + offset + k (q - q0)

with Y the regressor of inverse dynamics, so that p are ten numbers of each body that come on top
of its own. They need not be those of a body by themselves.
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
FADE = 0.25  # width of a fade, over half of what an entry spans, unless a scene says another
VERSION = 1
FREE, STRUCTURED = "free", "structured"
KINDS = (FREE, STRUCTURED)
_SHOWN = 40  # characters of what is wrong
ABOUT, SUM = "mbd_ros", "mbd_ros.sha256"  # keys of the metadata
ZEROS = "0" * 64
LARGEST = 64_000_000  # bytes
_TABLES = ("robot", "physics", "bodies", "friction", "stiffness", "given")
_VALUE = b"\x12\x40"  # protobuf: field 2, 64 bytes
_STATES = 4
_SAME = 1.0e-6  # of the largest number: what writing and reading a description or scene leaves
_FORCE = "force "  # how names of forces begin
_ROTORS = "inertia of drives"


class Corrections:
    """Torque and inertia of corrections, of all joints.

    Y(q, v, a) p is the difference of two robots: with p on top of some mass in each body, and with
    that mass alone, since numbers of a body without a mass cannot be written down.

    Args:
        bodies: Body -> ten numbers that are added to its own.
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
            raise ModelError("the corrections of stiffness are not stiffness and rest")
        self._sprung = [robot.joint(name).v for name in stiffness]
        self._bent = [robot.joint(name).q for name in stiffness]
        self._k, self._rest_at = np.array([*stiffness.values()]).reshape(-1, 2).T
        self.has_inertia, self._nv = bool(bodies), int(robot.model.nv)
        self._pairs = _pairs(robot, bodies) if bodies else ()
        self._rest = np.zeros(self._nv)
        self._at = [robot.joint(name).v for name in friction]
        if len({len(values) for values in friction.values()}) > 1:
            raise ModelError("the corrections of friction have several lengths")
        table = np.array([*friction.values()], dtype=np.float64)
        if not self._at:
            return
        if table.shape[1] < 2 or table.shape[1] % 2 or not (table[:, 3::2] > 0.0).all():
            raise ModelError("the corrections of friction are not offset, viscous and curves")
        self._offset, self._viscous = table[:, 0], table[:, 1]
        self._size, self._bend = table[:, 2::2], table[:, 3::2]

    def torque(self, q: Array, v: Array) -> Array:
        """Torque without acceleration [N·m or N], shape (nv,)."""
        tau = np.zeros(self._nv)
        if self.has_inertia:
            heavy, light = (np.array(pin.rnea(*pair, q, v, self._rest)) for pair in self._pairs)
            tau += heavy - light
        if self._at:
            rate = v[self._at]
            dry = (self._size * np.tanh(rate[:, None] / self._bend)).sum(axis=1)
            tau[self._at] += dry + self._viscous * rate + self._offset
        if self._sprung:
            tau[self._sprung] += self._k * (q[self._bent] - self._rest_at)
        return tau

    def inertia(self, q: Array) -> Array:
        """What is added to the mass matrix, shape (nv, nv)."""
        heavy, light = (np.array(pin.crba(*pair, q)) for pair in self._pairs)
        upper = np.triu(heavy - light)
        return np.asarray(upper + np.triu(upper, 1).T)

    def potential(self, q: Array) -> float:
        """Energy of the corrections in gravity and of springs [J]."""
        found = 0.5 * float(self._k @ np.square(q[self._bent] - self._rest_at))
        if not self.has_inertia:
            return found
        heavy, light = (float(pin.computePotentialEnergy(*pair, q)) for pair in self._pairs)
        return found + heavy - light


def _pairs(robot: Robot, bodies: Mapping[str, Sequence[float]]) -> tuple[tuple[Any, Any], ...]:
    """Models with some mass in each body, with the corrections and without, and their data."""
    places = {body.name: body.joint for body in moving_bodies(robot)}
    for name, numbers in bodies.items():
        if name not in places:
            raise ModelError(f"the robot has no body '{name}', it has {', '.join(places)}")
        if len(numbers) != COUNT:
            raise ModelError(f"the correction of '{name}' has {len(numbers)} numbers, not {COUNT}")
    largest = max(abs(numbers[0]) for numbers in bodies.values())
    some = (1.0 + 2.0 * largest) * np.eye(COUNT)[0]
    with_them, without = robot.model.copy(), robot.model.copy()
    for joint in range(1, robot.model.njoints):
        without.inertias[joint] = pin.Inertia.FromDynamicParameters(some)
        with_them.inertias[joint] = without.inertias[joint]
    for name, numbers in bodies.items():
        whole = pin.Inertia.FromDynamicParameters(some + np.array(numbers))
        with_them.inertias[places[name]] = whole
    return tuple((model, pin.Data(model)) for model in (with_them, without))


class TrainingRange:
    """A box of positions and velocities, and how trust fades beyond its walls.

    With d the largest distance of an entry beyond its wall, over half of what that entry spans:
    share = 1 for d = 0, 0 from d = `fade` on, and (1 + 2 d / fade) (1 - d / fade)^2 between.

    Args:
        low: Smallest values, shape (n,).
        high: Largest ones, same shape.
        fade: Width in which it fades, over half of what an entry spans.
    """

    def __init__(self, low: Array, high: Array, fade: float = FADE) -> None:
        self._middle, self._half = 0.5 * (low + high), 0.5 * (high - low)
        self._fade = fade

    def beyond(self, values: Array) -> Array:
        """Distance beyond the walls, over half of what an entry spans, shape (n,); 0 inside."""
        found: Array = np.abs(values - self._middle) / self._half - 1.0
        return np.maximum(found, 0.0)

    def share(self, values: Array) -> float:
        """Trust in a force at these values, 0 .. 1."""
        far = float(self.beyond(values).max(initial=0.0)) / self._fade
        return (1.0 + 2.0 * far) * (1.0 - far) ** 2 if far < 1.0 else 0.0

    def shares(self, values: Array) -> Array:
        """The same of many values, one set a row: shape (rows,)."""
        far = np.minimum(self.beyond(values).max(axis=1, initial=0.0) / self._fade, 1.0)
        return np.asarray((1.0 + 2.0 * far) * (1.0 - far) ** 2)


class LearnedFile(NamedTuple):
    """A file with a learned model that a scene names: a network as ONNX.

    Its metadata say for which robot it was learned and within which range, and hold the SHA-256 of
    the file, computed with zeros in the place of the sum. Reading it runs no code.

    Attributes:
        name: For the messages.
    """

    name: str
    content: bytes


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
    return about_in(file.name, _metadata(file))


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
    physics: Mapping[str, Sequence[float]] = _NO_NUMBERS
    bodies: Mapping[str, Sequence[float]] = _NO_NUMBERS
    friction: Mapping[str, Sequence[float]] = _NO_NUMBERS
    stiffness: Mapping[str, Sequence[float]] = _NO_NUMBERS
    given: Mapping[str, Sequence[float]] = _NO_NUMBERS

    def text(self) -> str:
        """As metadata of a file."""
        values = self._asdict() | {"low": self.low.tolist(), "high": self.high.tolist()}
        values |= {key: dict(values[key]) for key in _TABLES}
        return json.dumps({"version": VERSION, **values})


def _place() -> bytes:
    """What stands before the sum."""
    return SUM.encode() + _VALUE


def _sum(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


def _metadata(file: LearnedFile) -> str:
    """The JSON of the metadata, and what is behind it, from the bytes of the file."""
    start = file.content.find(b'{"version": ')
    return file.content[start:].decode("utf-8", errors="replace") if start >= 0 else ""


def signed(content: bytes) -> bytes:
    """A file that holds zeros in the place of its sum, with the sum.

    Raises:
        ValueError: There is no such place, or there are several.
    """
    if content.count(_place()) != 1:
        raise ValueError("the metadata have no place for the sum")
    return content.replace(_place() + ZEROS.encode(), _place() + _sum(content))


def about_in(name: str, text: str) -> About:
    """What a model says of itself, from its JSON, with which the text begins.

    Args:
        name: For the messages.

    Raises:
        ModelError: It is of another version, or does not say it; names it.
    """
    try:
        found, _ = json.JSONDecoder().raw_decode(text)
    except (ValueError, RecursionError) as error:
        raise ModelError(f"{name} does not say what it belongs to") from error
    if not isinstance(found, dict):
        raise ModelError(f"{name} does not say what it belongs to")
    version = found.pop("version", None)
    if version != VERSION:
        raise ModelError(
            f"{name} has version {str(version)[:_SHOWN]} of learned models, accepted: {VERSION}; "
            "learn it again"
        )
    try:
        made = About(**found)
        low, high = (np.array(one, dtype=np.float64) for one in (made.low, made.high))
        joints = _names(made.joints)
        tables: dict[str, Any] = {key: _table(getattr(made, key)) for key in _TABLES}
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise ModelError(f"{name} does not say what it belongs to: {error}") from error
    if made.kind not in KINDS or not isinstance(made.scene, str):
        raise ModelError(f"{name} is of no kind that is known, accepted: {', '.join(KINDS)}")
    is_whole = low.shape == high.shape == (2 * len(joints),) and np.isfinite([low, high]).all()
    if not (is_whole and (low < high).all()):
        raise ModelError(f"{name}: its range is none")
    return made._replace(low=low, high=high, joints=joints, **tables)


def _names(given: Any) -> tuple[str, ...]:
    """Different names.

    Raises:
        ValueError: It holds something else.
    """
    is_list = isinstance(given, list) and all(isinstance(name, str) for name in given)
    if not is_list or not given or len(set(given)) < len(given):
        raise ValueError("joints are not different names")
    return tuple(given)


def _table(given: Mapping[str, Sequence[float]]) -> dict[str, list[float]]:
    """Names and numbers.

    Raises:
        ValueError: A number that is not finite.
    """
    found = {str(key): [float(x) for x in values] for key, values in given.items()}
    if not all(np.isfinite(values).all() for values in found.values()):
        raise ValueError("a number is not finite")
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


def check_physics(name: str, said: About, here: Mapping[str, Sequence[float]]) -> None:
    """Refuse a model that was learned beside other forces, couplings or drives.

    Args:
        name: Of the file.
        said: What it says of itself.
        here: As `physics_of` gives it of the scene.

    Raises:
        ModelError: Names file and what differs.
    """
    same = _forces(said.physics, here)
    for key in {**said.physics, **here} if said.physics else ():
        if key in same:
            continue
        there, own = (np.array(one.get(key, ()), dtype=float) for one in (said.physics, here))
        if not len(own):
            what = f"which had {key}; this scene has not"
        elif not len(there):
            what = f"which had no {key}; this scene has"
        elif there.shape != own.shape or _differ(there, own):
            what = f"with another {key}"
        else:
            continue
        raise ModelError(
            f"{name} was learned on {said.scene}, {what}: a residual belongs to the forces "
            "that it was learned beside; learn it again, or load that scene"
        )


def _forces(said: Mapping[str, Sequence[float]], here: Mapping[str, Sequence[float]]) -> set[str]:
    """Names of forces, where they exert the same in all whatever they are called."""
    names = [{key for key in one if key.startswith(_FORCE)} for one in (said, here)]
    sums = [
        np.sum([one[key] for key in own], axis=0)
        for one, own in zip((said, here), names, strict=True)
    ]
    is_same = sums[0].shape == sums[1].shape and sums[0].size and not _differ(*sums)
    return names[0] | names[1] if is_same else set()


def _differ(there: Array, own: Array) -> bool:
    return float(np.abs(there - own).max()) > _SAME * float(np.abs(there).max())


def physics_of(
    robot: Robot, couplings: Couplings, forces: Sequence[Load], said: About
) -> dict[str, list[float]]:
    """Forces of each part, places of dependent joints, and inertia of drives.

    By these a learned model knows its scene again: numbers in a file can say the same in many
    ways, forces cannot. So parts are asked for their forces at some states within the range of the
    model, and dependent joints for where they are.

    Args:
        couplings: Its dependent joints.
        forces: Parts that act by themselves, without the model itself.
        said: Joints and range of the model.

    Returns:
        By words for people, what exerts nothing left out.
    """
    asked = [part for part in forces if not part.inputs and not part.internal]
    k, at = Kinematics(robot), [robot.joint(name).v for name in said.joints]
    found: dict[str, list[float]] = {}
    for q, v in _states(robot, couplings, said):
        k.refresh(q, v, max((part.reads for part in asked), default=Reads.NOTHING))
        for part in asked:
            force = part.force(k, State(0.0, q, v), NONE)[at]
            found.setdefault(f"{_FORCE}'{part.name}'", []).extend(force.tolist())
        for name in couplings.dependent:
            place = float(q[robot.joint(name).q])
            found.setdefault(f"coupling of '{name}'", []).append(place)
    found = {name: values for name, values in found.items() if np.any(values)}
    return found | {_ROTORS: robot.model.armature[at].tolist()}


def _states(robot: Robot, couplings: Couplings, said: About) -> list[tuple[Array, Array]]:
    """Positions and velocities of all joints, the same for the same range."""
    random, m = np.random.default_rng(0), len(said.joints)
    joints, found = [robot.joint(name) for name in said.joints], []
    for _ in range(_STATES):
        values = random.uniform(said.low, said.high)
        q, v, a = robot.neutral().copy(), *np.zeros((2, robot.model.nv))
        for joint, place, rate in zip(joints, values[:m], values[m:], strict=True):
            q[joint.q], v[joint.v] = place, rate
        couplings.expand(q, v, a)
        found.append((q, v))
    return found


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
