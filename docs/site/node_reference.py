"""Generate the reference of nodes: topics and services of running nodes, and their parameters."""

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

With this page you can look up the topics, services and parameters of every node. `make docs`
generates it from running nodes with their file in `config/nodes`, and with the scenes {scenes},
since topics depend on the scene. [nodes.md](nodes.md) explains topics and faults. Every node also
publishes `/diagnostics` (diagnostic_msgs/DiagnosticArray).
"""


class Entity(NamedTuple):
    """A topic or service of a node."""

    name: str
    kind: str
    direction: str


def page() -> str:
    """Return the page as Markdown."""
    scenes = ", ".join(map(code, OTHER_SCENES))
    pieces = [_HEAD.format(scenes=scenes)]
    with _silent_domain() as domain:
        for name in NODES:
            pieces += [f"## {name}", *_node(name, domain)]
    pieces += ["## Parameters of every node", _parameters(PARAMETERS)]
    pieces += ["## Control laws", scene_reference.parts_of("controllers")]
    return "\n\n".join(pieces) + "\n"


def entities(name: str, domain: int, scene: str = "") -> list[Entity]:
    """Return the topics and services of a node while it is active.

    Args:
        name: Name of the node.
        domain: Domain of DDS.
        scene: Scene that replaces the one of the parameter file.

    Raises:
        RuntimeError: The node does not become active with its own parameter file.
    """
    arguments = ["--ros-args", "--params-file", str(PARAMETER_FILES / f"{name}.yaml")]
    rclpy.init(args=arguments + (["-p", f"scene:={scene}"] if scene else []), domain_id=domain)
    node = _node_class(name)([])
    try:
        node.get_logger().set_level(50)  # scenes that do not fit the node are no error here
        node.try_start()
        if not node.active and not scene:
            raise RuntimeError(f"node {name} does not start: {node.fault}")
        return list(_entities(node)) if node.active else []
    finally:
        node.close(None)
        node.destroy_node()
        rclpy.shutdown()


def _entities(node: Any) -> Iterator[Entity]:
    endpoints = [(p.topic_name, p.msg_type, "out") for p in node.publishers]
    endpoints += [(s.topic_name, s.msg_type, "in") for s in node.subscriptions]
    endpoints += [(s.srv_name, s.srv_type, "service") for s in node.services]
    for name, kind, direction in endpoints:
        if not name.startswith(OF_ROS) and not OF_EVERY_NODE.search(name):
            relative = name.replace(f"{node.get_fully_qualified_name()}/", "~/").removeprefix("/")
            yield Entity(relative, f"{kind.__module__.split('.')[0]}/{kind.__name__}", direction)


def _silent_domain() -> Any:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"
    return claimed_domain()


def _node(name: str, domain: int) -> Iterator[str]:
    node_class = _node_class(name)
    yield summary(node_class)
    yield body(node_class)
    endpoints = entities(name, domain)
    if any(parameter.name == "scene" for parameter in node_class.PARAMETERS):
        for scene in OTHER_SCENES:
            endpoints += [e for e in entities(name, domain, scene) if e not in endpoints]
    rows = [(code(e.name), e.kind, e.direction) for e in sorted(endpoints, key=_order)]
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
