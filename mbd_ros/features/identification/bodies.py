"""Inertial numbers of bodies as inertias of links."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.inertial_parameters import Body, inertia_of, is_consistent
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError


def inertias_of_links(
    robot: Robot, bodies: Sequence[Body], inertial: Array
) -> tuple[dict[str, Any], list[str]]:
    """Inertias of the links that make bodies with given numbers.

    The heaviest link of a body takes the change; where no body of its own would be left of it,
    it takes all and those that are fixed to it lose theirs.

    Args:
        robot: The robot.
        bodies: Its bodies.
        inertial: Their numbers, shape (bodies, 10).

    Returns:
        Link -> inertia in the axes of the link, and remarks.
    """
    given, found, said = robot.inertias(), dict[str, Any](), list[str]()
    for body, numbers in zip(bodies, inertial, strict=True):
        places = {name: _placement(robot, name) for name in body.links}
        others = [n for n in body.links[1:] if n in given and given[n].mass > 0.0]
        left = numbers.copy()
        for name in others:
            left = left - places[name].act(given[name]).toDynamicParameters()
        if others and not is_consistent(left):
            left = numbers
            found |= {name: pin.Inertia.Zero() for name in others}
            said.append(f"{body.name} takes the inertia of {', '.join(others)}, fixed to it")
        found[body.name] = places[body.name].actInv(inertia_of(left))
    return found, said


def known_numbers(bodies: Sequence[Body], given: Array, known: Sequence[str]) -> Array:
    """Inertial numbers of bodies with links that are known, 0 of others, shape (10 bodies,).

    Raises:
        DataError: No such link.
    """
    found, links = np.zeros_like(given), [set(body.links) for body in bodies]
    for name in known:
        at = [i for i, own in enumerate(links) if name in own]
        if not at:
            names = ", ".join(body.name for body in bodies)
            raise DataError(f"--known {name}: no link that moves; there are {names}")
        found[at[0]] = given[at[0]]
    return found.ravel()


def _placement(robot: Robot, link: str) -> Any:
    """Pose of a link in the axes of its joint."""
    return robot.model.frames[robot.frame(link)].placement
