"""Settings of the compiler, and places of elements."""

from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.scene.models.mjcf.item import Item

_AXES = np.eye(3)
_TURNS = ("quat", "axisangle", "xyaxes", "zaxis", "euler")
_NO_LENGTH = 1.0e-14


class Compiler(NamedTuple):
    """Element `<compiler>`.

    Attributes:
        degree: Radians of a unit of angles.
        sequence: Axes of `euler`: small letters turn about the moved axes, capitals about fixed.
        autolimits: Whether what has a range is limited.
        from_geoms: `auto`, `true` or `false`: whether inertia comes from geoms.
        groups: First and last group of geoms that have inertia.
        least_mass: Of a body [kg].
        least_inertia: Of a body, in its principal axes [kg·m^2].
        balances: Whether moments of inertia that no body has become equal.
        total: Mass of the model [kg], negative where it is the sum.
    """

    degree: float
    sequence: str
    autolimits: bool
    from_geoms: str
    groups: tuple[float, float]
    least_mass: float
    least_inertia: float
    balances: bool
    total: float


def compiler_of(root: Element, source: str) -> Compiler:
    """The settings; later elements replace earlier ones.

    Raises:
        SceneError: Names attribute and what is accepted.
    """
    given: dict[str, str] = {}
    for one in root.iterfind("compiler"):
        given.update(one.attrib)
    item = Item(Element("compiler", given), source)
    if item.choice("coordinate", ("local", "global")) == "global":
        raise item.error("coordinate is 'global', accepted: local")
    sequence = item.text("eulerseq", "xyz")
    if len(sequence) != 3 or set(sequence.lower()) - set("xyz"):
        raise item.error(f"eulerseq is '{sequence}', accepted: three of x, y, z, X, Y, Z")
    groups = item.vector("inertiagrouprange", (0.0, 5.0))
    return Compiler(
        1.0 if item.choice("angle", ("degree", "radian")) == "radian" else np.pi / 180.0,
        sequence,
        item.flag("autolimits", default=True),
        item.choice("inertiafromgeom", ("auto", "true", "false")),
        (groups[0], groups[1]),
        item.number("boundmass", 0.0),
        item.number("boundinertia", 0.0),
        item.flag("balanceinertia", default=False),
        item.number("settotalmass", -1.0),
    )


def placed(item: Item, compiler: Compiler) -> Any:
    """`pinocchio.SE3` of an element in what holds it.

    Raises:
        SceneError: Two orientations, or one of no length.
    """
    at = np.array(item.vector("pos", (0.0, 0.0, 0.0)))
    return pin.SE3(_rotation(item, compiler), at)


def unit(item: Item, vector: Array, key: str) -> Array:
    """A vector at length 1.

    Raises:
        SceneError: It has no length.
    """
    length = float(np.linalg.norm(vector))
    if length < _NO_LENGTH:
        raise item.error(f"{key} has no length")
    direction: Array = vector / length
    return direction


def turned_to(direction: Array) -> Array:
    """The smallest rotation that takes z to a direction of length 1, shape (3, 3)."""
    axis = np.cross(_AXES[2], direction)
    sine = float(np.linalg.norm(axis))
    axis = _AXES[0] if sine < 1.0e-10 else axis / sine
    turn: Array = pin.AngleAxis(float(np.arctan2(sine, direction[2])), axis).toRotationMatrix()
    return turn


def _rotation(item: Item, compiler: Compiler) -> Array:
    given = [key for key in _TURNS if key in item]
    if len(given) > 1:
        own = [key for key in given if key in item.element.attrib]
        if len(own) != 1:
            raise item.error(f"orientation is given twice: {', '.join(given)}")
        given = own
    key = given[0] if given else ""
    found: Array = np.eye(3)
    if key == "quat":
        w, *xyz = unit(item, np.array(item.vector(key, [0.0] * 4)), key)
        found = pin.Quaternion(w, *xyz).toRotationMatrix()
    elif key == "axisangle":
        *axis, angle = item.vector(key, [0.0] * 4)
        axis = unit(item, np.array(axis), key)
        found = pin.AngleAxis(angle * compiler.degree, axis).toRotationMatrix()
    elif key == "xyaxes":
        x, y = np.reshape(item.vector(key, [0.0] * 6), (2, 3))
        x = unit(item, x, key)
        y = unit(item, y - x * (x @ y), key)
        found = np.column_stack((x, y, np.cross(x, y)))
    elif key == "zaxis":
        found = turned_to(unit(item, np.array(item.vector(key, [0.0] * 3)), key))
    elif key == "euler":
        for angle, letter in zip(item.vector(key, [0.0] * 3), compiler.sequence, strict=True):
            axis = _AXES["xyz".index(letter.lower())]
            turn = pin.AngleAxis(angle * compiler.degree, axis).toRotationMatrix()
            found = found @ turn if letter.islower() else turn @ found
    return found
