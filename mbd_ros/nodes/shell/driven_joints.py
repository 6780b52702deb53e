"""The joints that the actuators of a scene drive, and their order in commands."""

from collections.abc import Sequence

from mbd_ros.core.contracts.parts import Actuator
from mbd_ros.nodes.shell.parameters import ParameterError


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


def command_order(given: Sequence[str], driven: Sequence[str]) -> tuple[str, ...]:
    """Joints in the order of the values of a command: that of the parameter, or of the actuators.

    Raises:
        ParameterError: The parameter does not name all of them once.
    """
    if given and sorted(given) != sorted(driven):
        raise ParameterError(
            f"parameter 'joints' is {', '.join(given)}; accepted: all actuated joints, each "
            f"once: {', '.join(driven) or 'none'}"
        )
    return tuple(given or driven)
