"""Scene file -> parts. An absent section is an absent feature: not built, not imported."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mbd_ros.errors import SceneError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.models.model_entry import entries_of, with_model
from mbd_ros.scene.origin import Origin
from mbd_ros.scene.reading.building import Prebuilt, build, foreign_keys, present, table_of
from mbd_ros.scene.reading.robot_entry import read_entry
from mbd_ros.scene.schema.locate import find_scene


def load_scene(path: str | Path, description: str | None = None) -> Scene:
    """Read and build a scene.

    Args:
        path: Scene file, `package://<package>/<path>`, a model such as `leg.osim`, or the name of
            an embedded scene.
        description: URDF that arrived on the `description_topic` of the scene.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted; or code of others that
            `permitting` does not allow.
    """
    path = find_scene(path)
    return build_scene(Origin(path, description), entries_of(path))


def load_any(path: str | Path) -> Any:
    """A `Scene` of robots and bodies, or a `ParticleScene`.

    Args:
        path: As for `load_scene`.

    Raises:
        SceneError: As for `load_scene`.
    """
    path = find_scene(path)
    return build_any(Origin(path), entries_of(path))


def build_any(origin: Origin, entries: Mapping[str, Any]) -> Any:
    """Build a scene of robots or particles from entries."""
    if not has_particles(entries):
        return build_scene(origin, entries)
    from mbd_ros.scene.particles.particle_scene import build_particle_scene

    return build_particle_scene(origin, entries)


def is_of_particles(scene: Any) -> bool:
    """Whether a built scene is one of particles; nothing is imported to tell."""
    return not isinstance(scene, Scene)


def has_particles(entries: Mapping[str, Any]) -> bool:
    """Whether these are the sections of a scene of particles."""
    return entries.get("particles") is not None


def build_scene(
    origin: Origin,
    entries: Mapping[str, Any],
    prebuilt: Prebuilt = Prebuilt(),  # noqa: B008, a constant
) -> Scene:
    """A scene of entries that were read.

    Args:
        origin: Where they come from.
        prebuilt: Sections and parts that need not be built again.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    _refuse_particles(origin, entries)
    foreign = foreign_keys(origin, entries)
    origin, entries = with_model(origin, present(entries))
    sections, code = table_of(origin, entries, foreign)
    parts, robot = build(origin, entries, sections, prebuilt)
    assert robot is not None
    scene = Scene(origin, robot, parts, entries, sections, code)
    if any(part.description is not None for part in parts.get("forces", ())):
        from mbd_ros.scene.reading.learned_entries import check_models

        check_models(scene)
    return scene


def description_topic(path: str | Path) -> str | None:
    """Topic from which the scene takes its robot description; None where it names a file.

    Raises:
        SceneError: The file cannot be read, or its robot section is wrong.
    """
    path = find_scene(path)
    origin, entries = Origin(path), entries_of(path)
    _refuse_particles(origin, entries)
    foreign_keys(origin, entries)
    robot = present(entries).get("robot")
    return None if robot is None else read_entry(f"{path}: robot", robot).description_topic


def _refuse_particles(origin: Origin, entries: Mapping[str, Any]) -> None:
    """Refuse particles where a robot is asked for: by nodes, and by most commands.

    Raises:
        SceneError: Says who takes them.
    """
    if has_particles(entries):
        raise SceneError(
            f"{origin.name}: particles: has no joints and no topics; only check, simulate, sample "
            "and bracket take particles"
        )
