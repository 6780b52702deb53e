"""Lines of `mbd-ros check` about robots, bodies and parts, these by texts of their sections."""

import math
from collections.abc import Iterator, Mapping
from itertools import repeat
from typing import Any

import numpy as np

from mbd_ros.core.contracts.parts import Part
from mbd_ros.core.loads.internal_states import Internals
from mbd_ros.core.state import Array
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.building import parts_in


def member_lines(scene: Scene) -> Iterator[str]:
    """The robots and the other bodies."""
    robot, bodies = scene.robot, scene.parts.get("bodies", {})
    if len(robot.recipes) == 1 and not robot.recipes[0].name:
        yield line("robot", f"{robot.name} from {scene.source}, {robot.base_text}")
        return
    for recipe in robot.recipes:
        if recipe.name in bodies:
            how = "free" if recipe.base == "floating" else "placed"
            yield line("body", f"{recipe.name} from {recipe.source}, {how}")
        else:
            name = f"{recipe.name} from " if recipe.name else ""
            yield line("robot", f"{name}{recipe.source}, {recipe.base} base")


def part_lines(scene: Scene) -> Iterator[str]:
    """A line for every part whose section has a text: loads, then rows; then their states."""
    for section in sorted(scene.sections, key=lambda section: "residual" in section.offers):
        if section.check and section.key in scene.parts:
            label, _, text = section.check.partition(":")
            built = scene.parts[section.key]
            keys = built if isinstance(built, Mapping) else repeat("")
            for key, part in zip(keys, parts_in(section, built), strict=False):
                words = {"name": key, **_words(part)}
                yield line(label, text.strip().format(part=part, **words))
    yield from _state_lines(scene.internals, scene.initial.z)


def unused_rubbing(scene: Scene) -> Iterator[str]:
    """Friction and damping of the description that no part of the scene brings in."""
    covered: set[tuple[str, str]] = set()
    for part in (*scene.forces, *scene.constraints):
        joint = getattr(getattr(part, "joint", None), "name", None)
        covered.update((key, joint) for key in getattr(part, "brings", ()) if joint)
    for key in ("friction", "damping"):
        names = [n for n, rub in scene.robot.rubbing.items() if getattr(rub, key)]
        lacking = [name for name in names if (key, name) not in covered]
        if lacking:
            yield f"URDF <dynamics> {key} of {', '.join(lacking)}"


def _state_lines(internals: Internals, z: Array) -> Iterator[str]:
    """A line for every internal state.

    Args:
        internals: Of the scene.
        z: First values, NaN for those that the parts choose.
    """
    for i, first in enumerate(internals.completed(z).tolist()):
        bounds = (internals.lower[i], internals.upper[i])
        unit = f" [{internals.units[i]}]" if internals.units[i] else ""
        text = "starts at equilibrium" if math.isnan(first) else f"starts at {first:g}"
        inside = f", in {bounds[0]:g} .. {bounds[1]:g}" if np.isfinite(bounds).any() else ""
        yield line("state", f"{internals.names[i]}{unit}, {text}{inside}")


def _words(part: Any) -> dict[str, str]:
    """Words for a part that texts of sections may use."""
    where = getattr(part, "joints", None) or [getattr(part, "joint", None)]
    names = ", ".join(str(getattr(joint, "name", joint)) for joint in where if joint)
    words = {"kind": type_name(part), "at": f" at {names}" if names else ""}
    words |= {"rows": "", "law": "", "contact": ""}
    if hasattr(part, "pair") and hasattr(part, "features"):
        from mbd_ros.scene.describe.contact_lines import contact_words

        words["contact"] = contact_words(part)
    if isinstance(part, Part):
        words["name"] = part.name
    if hasattr(part, "rows"):
        words["rows"] = ", ".join(f"{row.name} [{row.unit}]" for row in part.rows)
        words["law"] = part.law.kind.value
    return words


def line(label: str, text: str) -> str:
    """A line of `check`."""
    return f"{label:<12}{text}"


def type_name(part: object) -> str:
    """Name of the class of a part."""
    return type(part).__name__
