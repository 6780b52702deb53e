"""Scenes as texts, which a report keeps and which can become files again."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from mbd_ros.api import Scene, load_scene, scene_from
from mbd_ros.scene.origin import NO_FILE
from mbd_ros.scene.schema.strict_yaml import mapping_of

Entry = Mapping[str, Any]
ROBOT = "robot.urdf"


class SceneText(NamedTuple):
    """A scene file and the robot description that it names `robot.urdf`."""

    scene: str
    urdf: str


class LoadedScene(NamedTuple):
    """A scene, and the sections that it was built from.

    Attributes:
        scene: The scene, built.
        entries: Its sections, as read.
    """

    scene: Scene
    entries: Entry


def load(text: SceneText) -> LoadedScene:
    """Build the scene of both texts.

    Raises:
        SceneError: It cannot be built.
    """
    entries = mapping_of(text.scene, NO_FILE)
    robot = {key: value for key, value in entries["robot"].items() if key != "urdf"}
    return LoadedScene(scene_from({**entries, "robot": robot}, urdf=text.urdf), entries)


def load_file(name: str) -> LoadedScene:
    """A scene file, or `package://<package>/<path>`.

    Raises:
        SceneError: It cannot be built.
    """
    scene = load_scene(name)
    return LoadedScene(scene, scene.entries)


def flow(value: Any) -> str:
    """A value as YAML on one line, numbers with all their digits."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {flow(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(flow, value)) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)


def yaml_text(sections: Entry) -> str:
    """A scene file: a line a section, and one an entry of its lists."""
    lines = []
    for key, value in sections.items():
        if isinstance(value, list):
            lines += [f"{key}:", *(f"- {flow(entry)}" for entry in value)]
        else:
            lines.append(f"{key}: {flow(value)}")
    return "\n".join(lines) + "\n"


def link(name: str, mass: float, com: Sequence[float], inertia: Any) -> str:
    """A `<link>`.

    Args:
        mass: [kg].
        com: Mass centre [m], shape (3,).
        inertia: About the mass centre, in the axes of the link [kg·m^2], shape (3, 3).
    """
    axes = "xyz"
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    moments = " ".join(f'i{axes[i]}{axes[j]}="{float(inertia[i][j])!r}"' for i, j in pairs)
    return (
        f'<link name="{name}"><inertial><origin xyz="{words(com)}"/><mass value="{mass!r}"/>'
        f"<inertia {moments}/></inertial></link>"
    )


def joint(
    name: str,
    kind: str,
    ends: tuple[str, str],
    at: Sequence[float] = (0.0, 0.0, 0.0),
    rpy: Sequence[float] = (0.0, 0.0, 0.0),
    axis: Sequence[float] = (0.0, 0.0, 1.0),
) -> str:
    """A `<joint>` with wide limits from a parent link to a child link.

    Args:
        kind: revolute, continuous or prismatic.
        ends: Parent and child.
        at: Origin in the parent [m], shape (3,).
        rpy: Roll, pitch and yaw in the parent [rad], shape (3,).
        axis: In the axes of the joint, shape (3,).
    """
    limit = "" if kind == "continuous" else 'lower="-1e6" upper="1e6" '
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{ends[0]}"/><child link="{ends[1]}"/>'
        f'<origin xyz="{words(at)}" rpy="{words(rpy)}"/><axis xyz="{words(axis)}"/>'
        f'<limit {limit}effort="1000" velocity="1000"/></joint>'
    )


def robot(*elements: str) -> str:
    """A robot description with a link `world` at rest."""
    return '<robot name="mechanism"><link name="world"/>\n' + "\n".join(elements) + "\n</robot>\n"


def words(vector: Sequence[float]) -> str:
    """Numbers with all their digits, for an attribute."""
    return " ".join(repr(float(component)) for component in vector)
