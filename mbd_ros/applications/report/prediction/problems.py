"""Optimal motions whose least costs are known."""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.from_python import scene_from
from mbd_ros.scene.reader import load_scene

_SLIDE = (
    "<robot name='mass'><link name='ground'/><link name='mass'><inertial><mass value='1'/>"
    "<inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial></link>"
    "<joint name='slide' type='prismatic'><parent link='ground'/><child link='mass'/>"
    "<axis xyz='1 0 0'/><limit lower='-10' upper='10' effort='1000' velocity='1000'/></joint>"
    "</robot>"
)


class Problem(NamedTuple):
    """A task with its least cost.

    Attributes:
        make: Builds the scene.
        task: Of `Scene.predict`, without mesh and tolerance.
        cost: The least one, in the unit of the goals.
        source: Where that is from.
    """

    make: Callable[[], Scene]
    task: Mapping[str, Any]
    cost: float
    source: str


def _mass() -> Scene:
    sections = {
        "robot": {"gravity": [0.0, 0.0, 0.0]},
        "actuators": [{"type": "ideal", "joints": ["slide"]}],
    }
    return scene_from(sections, urdf=_SLIDE)


def _cart_pole() -> Scene:
    return load_scene("package://mbd_ros/config/scenes/cart_pole.yaml")


_EFFORT = {"type": "effort"}
PROBLEMS: Mapping[str, Problem] = {
    "cart_pole": Problem(
        _cart_pole,
        {
            "duration": 2.0,
            "end": {"cart.position": 1.0, "pole.position": math.pi, "*.velocity": 0.0},
            "goals": [_EFFORT],
        },
        58.80766745817,
        "M. Kelly, SIAM Review 59, 2017, solved by multiple shooting of Pontryagin's equations",
    ),
    "bryson_denham": Problem(
        _mass,
        {
            "duration": 1.0,
            "start": {"slide.velocity": 1.0},
            "end": {"slide.position": 0.0, "slide.velocity": -1.0},
            "bounds": {"slide.position": [None, 1.0 / 9.0]},
            "goals": [{**_EFFORT, "weight": 0.5}],
        },
        4.0,
        "A. E. Bryson, Y.-C. Ho, Applied Optimal Control, 1975, sec. 3.11, closed form",
    ),
}
