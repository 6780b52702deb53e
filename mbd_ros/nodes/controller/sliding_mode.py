"""Node `sliding_mode_controller`: see `controller`."""

from mbd_ros.nodes.controller.node import ControllerNode
from mbd_ros.nodes.controller.parameters import SLIDING_MODE


class SlidingModeControllerNode(ControllerNode):
    """Sliding mode, super-twisting and their simpler relatives."""

    NAME = "sliding_mode_controller"
    PARAMETERS = SLIDING_MODE
