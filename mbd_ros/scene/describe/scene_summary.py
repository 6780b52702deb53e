"""A scene in a few lines, for a prompt and for a notebook, and its words for messages."""

from collections.abc import Iterable, Iterator, Mapping
from textwrap import shorten

from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.schema.sections import Section, parts_in

_WIDTH, _LINES = 90, 9
# Sections that have lines of their own, or none.
_TOLD = [
    "gravity",
    "robot",
    "couplings",
    "stabilization",
    "solver",
    "integrator",
    "dt",
    "initial",
    "safe",
]


def scene_text(scene: Scene) -> str:
    """At most ten lines: the scene, and one for each of its sections."""
    rows = list(_rows(scene))
    if len(rows) > _LINES:
        rest = ", ".join(label for label, _ in rows[_LINES - 1 :])
        rows = [*rows[: _LINES - 1], ("and", shorten(rest, _WIDTH, placeholder=" .."))]
    width = max(len(label) for label, _ in rows) + 2
    return "\n".join([f"Scene {scene.name}", *(f"  {n:<{width}}{text}" for n, text in rows)])


def _rows(scene: Scene) -> Iterator[tuple[str, str]]:
    """Section and its parts."""
    robot, dependent = scene.robot, scene.couplings.dependent
    yield (
        "robot",
        f"{robot.name} from {scene.source}, {robot.base_text}, joints: {len(robot.joints)}",
    )
    if dependent:
        yield "couplings", _listed(dependent)
    for section in scene.sections:
        if section.key in scene.parts and section.key not in _TOLD:
            yield section.key, _listed(_names(scene, section))
    method = type(scene.integrator).__name__ if scene.integrator else "default integrator"
    yield "run", f"{method}, dt {scene.dt:g} s, solver {scene.solver.type}"


def _listed(names: tuple[str, ...]) -> str:
    return shorten(f"{len(names)}: {', '.join(names)}", _WIDTH, placeholder=" ..")


def _names(scene: Scene, section: Section) -> tuple[str, ...]:
    built = scene.parts[section.key]
    if isinstance(built, Mapping):
        return tuple(built)
    return tuple(type(part).__name__ for part in parts_in(section, built))


def scene_html(scene: Scene) -> str:
    """A table element; names are escaped, since they come from files of others."""
    import html  # only a notebook asks for it

    rows = "".join(
        f"<tr><th>{html.escape(label)}</th><td>{html.escape(text)}</td></tr>"
        for label, text in _rows(scene)
    )
    return f"<table><caption>{html.escape(f'Scene {scene.name}')}</caption>{rows}</table>"


def inverse_tier(scene: Scene) -> str:
    """How inverse dynamics is solved."""
    if scene.has_loops:
        return "loops: efforts and multipliers by rank, of smallest norm where undetermined"
    if not scene.couplings.dependent:
        return "rnea: no dependent joint, one call"
    return "reduced: dependent joints eliminated exactly, q = F(z)"


def coordinate_names(robot: Robot, couplings: Couplings) -> list[str]:
    """Joints, and of a free base its name and axis, in the order of y'."""
    return velocity_names(robot, couplings.v_index)


def velocity_names(robot: Robot, chosen: Iterable[int]) -> list[str]:
    """The same of some velocities."""
    names = {int(joint.v): joint.name for joint in robot.joints}
    for base in robot.bases:
        words = (f"{kind}_{axis}" for kind in ("linear", "angular") for axis in "xyz")
        names |= {base.v.start + i: f"{base.name}.{word}" for i, word in enumerate(words)}
    return [names[int(v)] for v in chosen]


class Lines(str):
    """A text that a notebook shows line by line."""

    def __repr__(self) -> str:
        return str(self)
