"""The sections of a scene and of a task file, a line each.

A package of somebody else adds sections by an entry point of the group `mbd_ros.sections`: the
name is the key, the value `module:NAME` of a `Section`. See `foreign_sections`.
"""

from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from typing import Any, NamedTuple

from mbd_ros.errors import SceneError

_NOTHING: Mapping[str, Any] = {}
_MEMBERS = "mbd_ros.scene.reading.robot_entry"
_PARTS, _ENTRIES = "mbd_ros.scene.reading.part_entries", "mbd_ros.scene.reading.single_entries"


class Form(Enum):
    """Contents of a section in YAML."""

    SINGLE = "one entry"
    LIST = "a list of entries"
    NAMED = "entries by name"


class Section(NamedTuple):
    """A line of the table.

    Attributes:
        key: Its key in the file.
        form: One entry, a list, or entries by name.
        build: `module:function`, imported when there is something to build. It gets a
            `building.Site` and what the file holds, and returns what `Scene.parts` keeps under
            the key. The default builds parts by their `type`.
        after: Keys of sections that must be built before, where the file has them.
        offers: Methods that a class named by `type` must have, or one of two: `a or b`. Parts with
            `force` are forces of the scene, with `residual` constraints and with `command`
            actuators, in any section.
        check: Line of `check` for every part: a label, a colon and a text with {kind}, {name},
            {at}, {law}, {rows} and {part.attribute}. Empty: `check` says it elsewhere.
        parts: Where `registry.PARTS` keeps its types; empty for entries without types.
        types: Type -> `module:Class`, for a section that `registry.PARTS` does not know.
        absent: Entry to build where the file leaves the section out; None builds nothing.
    """

    key: str
    form: Form
    build: str = f"{_PARTS}:build_section"
    after: tuple[str, ...] = ("robot", "couplings", "actuators", "paths")
    offers: tuple[str, ...] = ()
    check: str = ""
    parts: str = ""
    types: Mapping[str, str] = _NOTHING
    absent: Any = None

    @property
    def has_types(self) -> bool:
        """Whether `type` in an entry chooses a class."""
        return bool(self.parts or self.types or self.offers)


_WRENCH = "wrench: {name} on {part.frame}, expressed in {part.expressed_in}, topic {part.heard_on}"
_EVERY_ROBOT = ("robot", "actuators")  # with the inertia of its drives

SECTIONS = (
    Section(
        "robot",
        Form.SINGLE,
        f"{_MEMBERS}:build_robot",
        ("gravity", "robots", "bodies"),
        absent=_NOTHING,
    ),
    Section("robots", Form.NAMED, f"{_MEMBERS}:build_robots", ()),
    Section("bodies", Form.NAMED, f"{_MEMBERS}:build_bodies", ()),
    Section("gravity", Form.SINGLE, f"{_MEMBERS}:build_gravity", ()),
    Section(
        "couplings",
        Form.NAMED,
        "mbd_ros.scene.reading.coupling_entries:build_couplings",
        ("robot",),
        absent=_NOTHING,
    ),
    Section(
        "paths",
        Form.NAMED,
        f"{_PARTS}:build_paths",
        ("robot",),
        check="path: {name} over {part.over}",
    ),
    Section(
        "external_wrenches",
        Form.NAMED,
        f"{_PARTS}:build_wrenches",
        _EVERY_ROBOT,
        check=_WRENCH,
    ),
    Section(
        "constraints",
        Form.LIST,
        f"{_PARTS}:build_constraints",
        (*_EVERY_ROBOT, "paths"),
        ("residual",),
        "constraint: {name}, {kind}, {law}: {rows}",
        "constraints",
    ),
    Section(
        "contacts",
        Form.LIST,
        "mbd_ros.scene.reading.contact_entries:build_contacts",
        (*_EVERY_ROBOT, "bodies"),
        ("residual or force",),
        "contact: {name}, {kind} {contact}",
        "contacts",
    ),
    Section(
        "forces",
        Form.LIST,
        after=(*_EVERY_ROBOT, "paths"),
        offers=("force",),
        check="force: {name}, {kind}{at}",
        parts="forces",
    ),
    Section(
        "actuators",
        Form.LIST,
        after=("robot", "paths"),
        offers=("command", "force"),
        check="actuator: {name}, {kind}{at}",
        parts="actuators",
    ),
    Section(
        "muscles",
        Form.LIST,
        after=(*_EVERY_ROBOT, "paths"),
        offers=("force", "active_force"),
        check="muscle: {name}, {kind}, {part.tendon} tendon over {part.path.over}",
        parts="muscles",
    ),
    Section(
        "sensors",
        Form.NAMED,
        after=_EVERY_ROBOT,
        offers=("measure",),
        check="sensor: {name}, {kind} on {part.frame}",
        parts="sensors",
    ),
    Section(
        "phases",
        Form.NAMED,
        "mbd_ros.scene.reading.phase_entries:build_phases",
        (*_EVERY_ROBOT, "couplings", "constraints", "contacts"),
        check="phase: {name}, {part.on}; {part.summary}",
    ),
    Section(
        "stabilization",
        Form.SINGLE,
        f"{_PARTS}:build_method",
        (),
        ("correct",),
        parts="stabilization",
    ),
    Section("solver", Form.SINGLE, f"{_ENTRIES}:build_solver", (), absent=_NOTHING),
    Section(
        "integrator",
        Form.SINGLE,
        f"{_PARTS}:build_method",
        (),
        ("prepare",),
        parts="integrators",
    ),
    Section("dt", Form.SINGLE, f"{_ENTRIES}:build_step", (), absent=1.0e-3),  # s
    Section(
        "initial",
        Form.SINGLE,
        f"{_ENTRIES}:build_initial",
        (*_EVERY_ROBOT, "couplings", "phases"),
        absent=_NOTHING,
    ),
    Section("safe", Form.SINGLE, f"{_ENTRIES}:build_safe", (), absent=_NOTHING),
)
_PARTICLES = "mbd_ros.scene.particles.particles_entry"
PARTICLES = (  # of a scene that has the section `particles`, and no others
    Section(
        "units",
        Form.SINGLE,
        "mbd_ros.scene.particles.particles_entry:build_units",
        (),
        absent="si",
    ),
    Section("particles", Form.SINGLE, f"{_PARTICLES}:build_particles", ("units",)),
    Section(
        "initial",
        Form.SINGLE,
        f"{_PARTICLES}:build_start",
        ("units", "particles"),
        absent=_NOTHING,
    ),
    Section(
        "integrator",
        Form.SINGLE,
        "mbd_ros.scene.particles.particle_scene:build_method",
        (),
        absent={"type": "rattle"},
    ),
    Section("solver", Form.SINGLE, f"{_PARTICLES}:build_solver", (), absent=_NOTHING),
    Section("dt", Form.SINGLE, f"{_PARTICLES}:build_time_step", (), absent=1.0e-3),
    Section("record", Form.SINGLE, f"{_PARTICLES}:build_record", (), absent=_NOTHING),
)
TASKS = (
    Section("simulate", Form.SINGLE, "mbd_ros.features.simulation.task:build_task", ()),
    Section("kinematics", Form.SINGLE, "mbd_ros.features.markers.kinematics_task:build_task", ()),
    Section("scale", Form.SINGLE, "mbd_ros.features.markers.scale.task:build_task", ()),
    Section("muscles", Form.SINGLE, "mbd_ros.features.muscles.task:build_task", ()),
    Section("estimate", Form.SINGLE, "mbd_ros.features.estimation.task:build_task", ()),
    Section("gait", Form.SINGLE, "mbd_ros.features.gait.task:build_task", ()),
    Section("predict", Form.SINGLE, "mbd_ros.features.prediction.task:build_task", ()),
    Section("sample", Form.SINGLE, "mbd_ros.features.sampling.task:build_task", ()),
)


def keys(table: Iterable[Section]) -> tuple[str, ...]:
    """Keys of a table, in its order."""
    return tuple(section.key for section in table)


def parts_in(section: Section, built: Any) -> tuple[Any, ...]:
    """The parts of a section, whatever its form."""
    if section.form is Form.LIST:
        return tuple(built)
    if section.form is Form.NAMED and isinstance(built, Mapping):
        return tuple(built.values())
    return (built,)


def ordered(table: Sequence[Section]) -> list[Section]:
    """The sections in the order of building: each after those it names, else as in the table.

    Raises:
        SceneError: A section waits for one that is not in the table, or for itself.
    """
    known = set(keys(table))
    for section in table:
        unknown = [name for name in section.after if name not in known]
        if unknown:
            raise SceneError(
                f"section '{section.key}' comes after unknown {', '.join(unknown)}; there are "
                f"{', '.join(keys(table))}"
            )
    left, done = list(table), list[Section]()
    while left:
        ready = (s for s in left if not any(name in s.after for name in keys(left)))
        following = next(ready, None)
        if following is None:
            raise SceneError(f"sections wait for each other: {', '.join(keys(left))}")
        left.remove(following)
        done.append(following)
    return done
