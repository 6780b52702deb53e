"""The page of nodes: topics and services of nodes that run, and their parameters."""

import os
import re
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, get_args, get_origin

import rclpy
import scene_reference
from docstrings import body, summary
from tables import code, table

from mbd_ros.jobs.domain_claim import claimed_domain
from mbd_ros.nodes.shell.parameters import PARAMETERS, Parameter
from mbd_ros.nodes.shell.params_file import meaning
from mbd_ros.nodes.table import NODES

PARAMETER_FILES = Path(__file__).parents[2] / "config/nodes"
OTHER_SCENES = ("leg_dropped", "prosthetic_leg_stance")  # a free body, contacts, measured loads
OF_ROS = ("/parameter_events", "/rosout", "/diagnostics", "/clock")
OF_EVERY_NODE = re.compile(
    r"(parameters?(_types|_atomically)?|/(change|get)_state"
    r"|/get_(available_\w+|transition_graph|type_description)|/transition_event)$"
)
_HEAD = """\
# Topics and parameters of the nodes

Made by `make docs` from nodes that ran with their file in `config/nodes`, and with the scenes
{scenes} where they take them: topics depend on the scene. [nodes.md](nodes.md) says what each
means, and what the answer to a fault is. Every node is a life-cycle node, and writes
`/diagnostics` (diagnostic_msgs/DiagnosticArray).
"""


class Entity(NamedTuple):
    """A topic or service of a node."""

    name: str
    kind: str
    direction: str


def page() -> str:
    """The page as Markdown."""
    scenes = ", ".join(map(code, OTHER_SCENES))
    pieces = [_HEAD.format(scenes=scenes)]
    with _silent_domain() as domain:
        for name in NODES:
            pieces += [f"## {name}", *_node(name, domain)]
    pieces += ["## Parameters of every node", _parameters(PARAMETERS)]
    pieces += ["## Control laws", scene_reference.parts_of("controllers")]
    return "\n\n".join(pieces) + "\n"


def entities(name: str, domain: int, scene: str = "") -> list[Entity]:
    """What a node has in ROS while it is active.

    Args:
        name: Of the node.
        domain: Of DDS.
        scene: In place of that of its parameter file.

    Raises:
        RuntimeError: The node does not become active with its own file, with the reason.
    """
    words = ["--ros-args", "--params-file", str(PARAMETER_FILES / f"{name}.yaml")]
    rclpy.init(args=words + (["-p", f"scene:={scene}"] if scene else []), domain_id=domain)
    node = _node_class(name)([])
    try:
        node.get_logger().set_level(50)  # other scenes may not fit: no news
        node.try_start()
        if not node.active and not scene:
            raise RuntimeError(f"node {name} does not start: {node.fault}")
        return list(_entities(node)) if node.active else []
    finally:
        node.close(None)
        node.destroy_node()
        rclpy.shutdown()


def _entities(node: Any) -> Iterator[Entity]:
    found = [(p.topic_name, p.msg_type, "out") for p in node.publishers]
    found += [(s.topic_name, s.msg_type, "in") for s in node.subscriptions]
    found += [(s.srv_name, s.srv_type, "service") for s in node.services]
    for name, kind, direction in found:
        if not name.startswith(OF_ROS) and not OF_EVERY_NODE.search(name):
            own = name.replace(f"{node.get_fully_qualified_name()}/", "~/").removeprefix("/")
            yield Entity(own, f"{kind.__module__.split('.')[0]}/{kind.__name__}", direction)


def _silent_domain() -> Any:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"
    return claimed_domain()


def _node(name: str, domain: int) -> Iterator[str]:
    node_class = _node_class(name)
    yield summary(node_class)
    yield body(node_class)
    found = entities(name, domain)
    if any(parameter.name == "scene" for parameter in node_class.PARAMETERS):
        for scene in OTHER_SCENES:
            found += [e for e in entities(name, domain, scene) if e not in found]
    rows = [(code(e.name), e.kind, e.direction) for e in sorted(found, key=_order)]
    yield table(("topic or service", "type", ""), rows)
    yield _parameters(node_class.PARAMETERS)


def _order(entity: Entity) -> tuple[int, str]:
    return ("in", "out", "service").index(entity.direction), entity.name


def _parameters(parameters: Sequence[Parameter]) -> str:
    rows = ((code(p.name), _kind(p.kind), _default(p.default), meaning(p)) for p in parameters)
    return table(("parameter", "type", "default", "means"), rows)


def _kind(kind: Any) -> str:
    if get_origin(kind) is list:
        return f"list of {get_args(kind)[0].__name__}"
    return str(kind.__name__)


def _default(value: Any) -> str:
    if value is None:
        return "required"
    return code(str(list(value) if isinstance(value, tuple) else value)) or "empty"


def _node_class(name: str) -> Any:
    module, _, node_class = NODES[name].partition(":")
    return getattr(import_module(module), node_class)
