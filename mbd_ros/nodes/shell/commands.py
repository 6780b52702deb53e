"""Commands of the actuators and muscles of a scene: their names and their order in messages."""

from collections.abc import Sequence

from mbd_ros.core.contracts import Actuator
from mbd_ros.core.loads.inputs import command_names
from mbd_ros.nodes.shell.parameters import ParameterError
from mbd_ros.scene.built_scene import Scene
from msg_adapters.commands import CommandReader


def command_reader(scene: Scene, order: Sequence[str]) -> CommandReader:
    """Return the reader of the commands of a scene; a joint stands for its only actuator.

    Args:
        order: Of the values in vectors, by input or joint; empty: actuators, then muscles.

    Raises:
        ParameterError: The order does not name every input once.
    """
    names = scene.inputs.names[: sum(len(part.inputs) for part in scene.commanded)]
    joints, takes = _joints(scene), {}
    for part in scene.commanded:
        if part.takes:
            takes |= dict.fromkeys(names[part.u], part.takes)
    columns = [joints.get(name, name) for name in order or names]
    if sorted(columns) != sorted(names):
        label = {name: joint for joint, name in joints.items()}
        accepted = ", ".join(label.get(name, name) for name in names) or "none"
        raise ParameterError(
            f"parameter 'joints' is {', '.join(order)}; accepted: all actuated joints, each once: "
            f"{accepted}"
        )
    units = {name: scene.inputs.channels[i].unit for i, name in enumerate(names)}
    positions = [name for name, unit in units.items() if unit in ("rad", "m")]
    return CommandReader(columns, names, joints, takes, positions)


def _joints(scene: Scene) -> dict[str, str]:
    """Joint -> the input that it stands for."""
    called = [name for names in command_names(scene.actuators) for name in names]
    pairs = zip(called, scene.inputs.names[: len(called)], strict=True)
    return {joint: name for joint, name in pairs if joint != name}


def driven_joints(actuators: Sequence[Actuator]) -> tuple[str, ...]:
    """Joints in the order of the actuators.

    Raises:
        ParameterError: Two actuators drive one joint.
    """
    driven = tuple(name for actuator in actuators for name in actuator.joints)
    twice = sorted({name for name in driven if driven.count(name) > 1})
    if twice:
        raise ParameterError(
            f"actuators: {', '.join(twice)} driven twice: a command by name would be ambiguous"
        )
    return driven


def command_order(chosen: Sequence[str], driven: Sequence[str]) -> tuple[str, ...]:
    """Joints in the order of the values of a command: that of the parameter, or of the actuators.

    Raises:
        ParameterError: The parameter does not name all of them once.
    """
    if chosen and sorted(chosen) != sorted(driven):
        raise ParameterError(
            f"parameter 'joints' is {', '.join(chosen)}; accepted: all actuated joints, each "
            f"once: {', '.join(driven) or 'none'}"
        )
    return tuple(chosen or driven)
