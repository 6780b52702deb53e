"""Small scenes without friction, for a million steps."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from mbd_ros.applications.report.stability.extreme_scenes import mechanism, rod, rods
from mbd_ros.applications.report.stability.scene_text import LoadedScene, joint


class LongScene(NamedTuple):
    """How a scene is run.

    Attributes:
        title: For people.
        dt: Step [s].
    """

    title: str
    dt: float


LONG_SCENES: Mapping[str, LongScene] = {
    "pendulum": LongScene("Pendulum", 0.01),
    "coupled_arm": LongScene("Arm of three joints, the last coupled to the first", 2.0e-3),
    "four_bar": LongScene("Four-bar", 4.0e-3),
}


def _pendulum() -> LoadedScene:
    return mechanism({"initial": {"position": {"j0": -0.5}}}, *rods((1.0,)))()


def _coupled_arm() -> LoadedScene:
    """Hangs near its equilibrium and swings, so that the motion stays regular."""
    sections = {
        "couplings": {"j2": {"parent": "j0", "factor": 0.5, "offset": 0.8}},
        "initial": {"position": {"j0": -1.8, "j1": 0.1}},
    }
    return mechanism(sections, *rods((1.0, 1.0, 1.0)))()


def _four_bar() -> LoadedScene:
    """Crank, coupler and rocker of 1, 2 and 1.5 m on a ground of 2 m, released at rest."""
    elements = [
        *(joint("crank", "continuous", ("world", "crank_link")), rod("crank_link", 1.0, 1.0)),
        joint("coupler", "continuous", ("crank_link", "coupler_link"), (1.0, 0.0, 0.0)),
        rod("coupler_link", 2.0, 2.0),
        joint("rocker", "continuous", ("world", "rocker_link"), (2.0, 0.0, 0.0)),
        rod("rocker_link", 1.5, 1.5),
    ]
    closure = {
        "type": "loop_closure",
        "kind": "point",
        "directions": "xy",
        "frame_a": "coupler_link",
        "point_a": [2.0, 0.0, 0.0],
        "frame_b": "rocker_link",
        "point_b": [1.5, 0.0, 0.0],
    }
    start = {"position": {"crank": -1.6, "coupler": 0.8, "rocker": -1.5}}
    return mechanism({"constraints": [closure], "initial": start}, *elements)()


SCENES: Mapping[str, Callable[[], LoadedScene]] = {
    "pendulum": _pendulum,
    "coupled_arm": _coupled_arm,
    "four_bar": _four_bar,
}
